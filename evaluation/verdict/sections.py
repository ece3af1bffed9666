"""The verdict: do PLR, AEL and MEL track real linkability? `verdict.json`.

Four sections, each under both adding rules: *validity* across mechanisms, validity *within* a
level, the paper's *claim* at equal missed rate, and the *inflation* of the descriptors by an
attack. What decides is in `decision_rules`, in words in docs/verdict.md.
"""

from __future__ import annotations

import json
from collections import Counter
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.analysis.matching import ADDING_SUFFIX, AT_EQUAL_ALARMS, MISSED, Measure, Sweeps
from evaluation.analysis.metrics import DESCRIPTORS
from evaluation.analysis.strongest import strongest_linkers, strongest_reconstruction
from evaluation.experiment.presets import SHARED
from evaluation.verdict.answer import answer
from evaluation.verdict.items import NAME, UNIT, Draft, known, to_json, with_interval
from evaluation.verdict.rules import (
    ALPHA,
    DEFLATED,
    HOLDS,
    INFLATED,
    LEAST_CLUSTERS,
    LEAST_CORRELATION,
    LEAST_SPAN,
    REVERSED,
    SECTION_ALPHA,
    SECTIONS,
    SUCCESS_MARGIN,
    UNDECIDED,
    WEAK_MARGIN,
    Option,
    decide,
    effect,
    p_above,
    p_below,
)
from evaluation.verdict.validity import validity
from evaluation.verdict.within_level import within
from isac_track.intervals import CONFIDENCE

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from evaluation.analysis.matching import Comparison
    from evaluation.analysis.summary import Key
    from evaluation.verdict.within_level import LevelTracks
    from isac_track.intervals import Estimate

_CRITERIA: Final = {
    MISSED: "equal missed-conflict rate",
    AT_EQUAL_ALARMS: "equal missed-conflict rate and equal false alarms",
}


def verdict(
    found: Mapping[Key, Estimate],
    compared: Iterable[Comparison],
    levels: Mapping[str, Sequence[LevelTracks]],
    *,
    manifest: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the verdict of a run as in `verdict.json`.

    Parameters
    ----------
    found : mapping
        Every metric of the run.
    compared : iterable of Comparison
        FID against fixed noise; the claim is read with the first predictor of the run.
    levels : mapping
        By task: who is linked at each level by its strongest linker.
    manifest : mapping
        As in `manifest.json`.
    """
    success = strongest_linkers(found)
    attack = strongest_reconstruction(found)
    drafts = (
        *validity(Sweeps(found), success=success, chance=_chances(found, success)),
        *within(levels, success=success),
        *_claims(_of_reference(compared, manifest), success=success, attack=attack),
        *_inflation(found, attack=attack),
    )
    items: list[dict[str, Any]] = []
    for section in SECTIONS:
        mine = [draft for draft in drafts if draft.section == section]
        if not mine:
            continue
        decided = decide([draft.options for draft in mine])
        items += [
            to_json(draft, decision=decision, p_value=p_value, p_adjusted=p_adjusted)
            for draft, (decision, p_value, p_adjusted) in zip(mine, decided, strict=True)
        ]
    dataset = manifest["dataset"]
    said = {
        "dataset": dataset["name"],
        "simulated": bool(dataset.get("simulated", False)),
        "seed": manifest["identity"]["seed"],
        "preset": manifest["settings"]["preset"],
        "scenes": manifest["settings"]["scenes"],
        "rules": rules(),
        "counts": {
            section: dict(Counter(one["decision"] for one in items if one["section"] == section))
            for section in SECTIONS
        },
        "items": items,
    }
    return {"answer": answer(items, dataset=dataset["name"]), **said}


def rules() -> dict[str, Any]:
    """Return the rules of decision, as numbers and in a sentence."""
    return {
        "confidence": CONFIDENCE,
        "alpha": ALPHA,
        "section_alpha": SECTION_ALPHA,
        "margins": {
            "success": SUCCESS_MARGIN,
            "success_weak": WEAK_MARGIN,
            "correlation": LEAST_CORRELATION,
            "span": LEAST_SPAN,
            "clusters": LEAST_CLUSTERS,
        },
        "text": "Decided is what passes its test after Holm's adjustment over the section, each "
        f"section at {100 * SECTION_ALPHA:g} %; all else is undecided, which is no statement "
        "either way. Intervals are at 95 % and not adjusted.",
    }


def to_bytes(said: Mapping[str, Any]) -> bytes:
    """Return the content of `verdict.json`."""
    text = json.dumps(said, indent=1, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode()


def _chances(found: Mapping[Key, Estimate], success: Mapping[str, Measure]) -> dict[str, float]:
    chances = {}
    for task, measure in success.items():
        known_ones = [
            one.value
            for key, one in found.items()
            if (key.consumer, key.knowledge, key.metric)
            == (measure.consumer, measure.knowledge, "chance")
        ]
        chances[task] = max(known_ones, default=0.0)
    return chances


def _of_reference(compared: Iterable[Comparison], manifest: Mapping[str, Any]) -> list[Comparison]:
    """Return the comparisons by the first predictor of the run."""
    every = [one for one in compared if one.predictor]
    predictors = manifest["settings"].get("predictors") or [one.predictor for one in every]
    return [one for one in every if one.predictor in predictors[:1]]


def _claims(
    compared: Iterable[Comparison], *, success: Mapping[str, Measure], attack: Measure | None
) -> Iterator[Draft]:
    """Yield whether FID has the advantage over fixed noise at equal missed rate.

    As shared, after the strongest reconstruction, and in what the strongest linkers achieve; for
    the comparisons of one predictor.
    """
    wanted: dict[Measure, tuple[str, str]] = {}
    for descriptor in DESCRIPTORS:
        wanted[Measure(SHARED, descriptor)] = "as shared", ""
        if attack is not None:
            wanted[Measure(attack.consumer, descriptor, attack.knowledge)] = "after attack", ""
    for task, measure in success.items():
        wanted[measure] = "linkage", task
    for one in compared:
        if one.criterion in _CRITERIA and one.measure in wanted:
            yield _claim(one, *wanted[one.measure])


def _claim(one: Comparison, of: str, task: str) -> Draft:
    found = effect(one.mean_difference, n=one.n)
    descriptor = "" if task else one.measure.metric
    unit = UNIT.get(descriptor, "fraction")
    where = f"At {_CRITERIA[one.criterion]} ({one.adding} adding)"
    what = {
        "as shared": f"{NAME.get(descriptor, '')} as shared",
        "after attack": f"{NAME.get(descriptor, '')} after {one.measure.consumer}",
        "linkage": f"the share of people linked in {task}",
    }[of]
    gap = with_interval(found, unit, signed=True)
    relative = found.value / one.mean_fixed if one.mean_fixed else np.nan
    share = f", {100 * relative:+.0f} % of fixed noise's" if np.isfinite(relative) else ""
    reached = one.at[np.isfinite(one.difference[1])]
    return Draft(
        section="claim",
        adding=one.adding,
        descriptor=descriptor,
        task=task,
        subject="" if of == "as shared" else _named(one.measure),
        criterion=one.criterion,
        effect=found,
        unit=unit,
        options=(Option(HOLDS, p_below(found, 0.0)), Option(REVERSED, p_above(found, 0.0))),
        sentences={
            HOLDS: f"{where}, {what} is lower under FID than under fixed noise: {gap}{share}.",
            REVERSED: f"{where}, {what} is higher under FID than under fixed noise: {gap}{share}.",
            UNDECIDED: f"{where}, FID less fixed noise in {what} is {gap}."
            if found.is_known
            else f"{where}, {what} cannot be compared.",
        },
        why_undecided="the interval, adjusted, holds zero"
        if found.is_known
        else "the two mechanisms have no range in common that enough replicates reach",
        details={
            "of": of.replace(" ", "-"),
            "relative": known(float(relative)),
            "range": [known(float(reached.min())), known(float(reached.max()))]
            if reached.size
            else None,
        },
    )


def _inflation(found: Mapping[Key, Estimate], *, attack: Measure | None) -> Iterator[Draft]:
    """Yield how much higher each descriptor is after the strongest reconstruction."""
    if attack is None:
        return
    sweeps = Sweeps(found)
    for adding, suffix in ADDING_SUFFIX.items():
        for family in ("fid", "fixed"):
            for descriptor in DESCRIPTORS:
                after = Measure(attack.consumer, descriptor, attack.knowledge)
                before = Measure(SHARED, descriptor)
                ratios = []
                for level in sweeps.levels(family + suffix):
                    pair = [sweeps.point(family + suffix, level, one) for one in (after, before)]
                    if pair[0] is not None and pair[1] is not None:
                        with np.errstate(divide="ignore", invalid="ignore"):
                            ratios.append(np.log(pair[0] / pair[1]))
                if not ratios:
                    continue
                found_log = effect(np.mean(ratios, axis=0), n=sweeps.n(family + suffix, after))
                ratio = effect(np.exp(np.mean(ratios, axis=0)), n=found_log.n)
                what = f"{NAME[descriptor]} under {family} ({adding} adding)"
                said = (
                    f"After {_named(attack)} {what} is "
                    f"{with_interval(ratio, 'ratio')} what it was as shared"
                )
                yield Draft(
                    section="inflation",
                    adding=adding,
                    descriptor=descriptor,
                    task="",
                    subject=_named(attack),
                    criterion="",
                    effect=ratio,
                    unit="ratio",
                    options=(
                        Option(INFLATED, p_above(found_log, 0.0)),
                        Option(DEFLATED, p_below(found_log, 0.0)),
                    ),
                    sentences={UNDECIDED: f"{said} (geometric mean over the levels)."},
                    why_undecided="the interval, adjusted, holds 1",
                    details={"of": family, "levels": len(ratios)},
                )


def _named(measure: Measure) -> str:
    name = measure.consumer.partition("/")[2] or measure.consumer
    return f"{name} ({measure.knowledge})"
