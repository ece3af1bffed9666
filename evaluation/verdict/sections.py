"""The verdict: do PLR, AEL and MEL track real linkability? `verdict.json`.

Four sections, each under both adding rules: *validity* across mechanisms, validity *within* a
level, the paper's *claim* that FID has the advantage over fixed noise at equal missed rate, and
*inflation*: how much higher each descriptor is after the strongest attack than as shared. What
decides is in `rules`, in words in docs/verdict.md.
"""

from __future__ import annotations

import json
from collections import Counter
from itertools import product
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.analysis.families import ADDING_RULES, FID
from evaluation.analysis.keys import AS_SHARED, Source
from evaluation.analysis.matching import AT_EQUAL_ALARMS, MISSED, Comparison, Sweeps
from evaluation.analysis.metrics import DESCRIPTORS, METRICS, SUCCESS
from evaluation.verdict import rules
from evaluation.verdict.rules import DOES_NOT, NAME, TRACKS, UNDECIDED, WEAKLY, Draft
from evaluation.verdict.validity import validity
from evaluation.verdict.within_level import LevelTracks, within
from isac_track.intervals import CONFIDENCE, estimate_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

    Items = Sequence[dict[str, Any]]

_PLURAL: Final = {
    DOES_NOT: ("does not track", "do not track"),
    WEAKLY: ("tracks weakly", "track weakly"),
    TRACKS: ("tracks", "track"),
}
"""From the worst: that is said of a descriptor that fares differently in different tasks."""
_CRITERIA: Final = {
    MISSED: "equal missed-conflict rate",
    AT_EQUAL_ALARMS: "equal missed-conflict rate and equal false alarms",
}
AS_IS, AFTER, LINKED = "as-shared", "after-attack", "linkage"
"""What a claim compares."""


def verdict(
    sweeps: Sweeps,
    compared: Iterable[Comparison],
    levels: Mapping[str, Sequence[LevelTracks]],
    *,
    strongest: Mapping[str, Source],
    manifest: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the verdict of a run as in `verdict.json`.

    `compared` is with fixed noise: the claim is read with the first predictor of the run. `levels`
    are by task who is linked at each level by its strongest linker, which `strongest` names; under
    "" that is the strongest reconstruction.
    """
    success = {task: linker for task, linker in strongest.items() if task}
    attacks = [attack for task, attack in strongest.items() if not task]
    predictors = manifest["settings"]["predictors"]
    of_first = [one for one in compared if one.predictor in predictors[:1]]
    drafts = {
        rules.VALIDITY: validity(sweeps, success=success),
        rules.WITHIN: within(levels, sweeps, success=success),
        rules.CLAIM: _claims(of_first, sweeps, strongest),
        rules.INFLATION: (
            draft
            for attack, adding in product(attacks, ADDING_RULES)
            for mechanism, descriptor in product(sweeps.swept(adding), DESCRIPTORS)
            for draft in _inflated(sweeps, mechanism, adding, attack, descriptor)
        ),
    }
    items: list[dict[str, Any]] = []
    for section in rules.SECTIONS:
        mine = list(drafts[section])
        decided = rules.decide([draft.options for draft in mine])
        for draft, (decision, p_value, p_adjusted) in zip(mine, decided, strict=True):
            about = ("adding", "descriptor", "task", "subject", "criterion")
            items.append(
                {
                    "id": "/".join([section, *draft.names]),
                    "section": section,
                    **{name: getattr(draft, name) for name in about},
                    "decision": decision,
                    "sign": rules.SIGN[decision],
                    **rules.numbers(draft.effect),
                    "unit": draft.unit,
                    "n": draft.effect.n,
                    "p_value": p_value,
                    "p_adjusted": p_adjusted,
                    "sentence": draft.sentences.get(decision, draft.sentences[UNDECIDED]),
                    "why_undecided": draft.why_undecided if decision == UNDECIDED else "",
                    **draft.details,
                }
            )
    dataset = manifest["dataset"]
    of = {name: [one for one in items if one["section"] == name] for name in rules.SECTIONS}
    fid = {sweeps.named(FID, adding=adding) for adding in ADDING_RULES}
    return {
        "answer": [
            _tracking(of[rules.VALIDITY], dataset=dataset["name"], fid=fid),
            _compared(of[rules.CLAIM]),
            _raised(of[rules.INFLATION]),
        ],
        "dataset": dataset["name"],
        "simulated": bool(dataset.get("simulated", False)),
        "seed": manifest["identity"]["seed"],
        "preset": manifest["settings"]["preset"],
        "scenes": manifest["settings"]["scenes"],
        "rules": {
            "confidence": CONFIDENCE,
            "alpha": rules.ALPHA,
            "section_alpha": rules.SECTION_ALPHA,
            "margins": {
                "success": rules.SUCCESS_MARGIN,
                "success_weak": rules.WEAK_MARGIN,
                "correlation": rules.LEAST_CORRELATION,
                "span": rules.LEAST_SPAN,
                "clusters": rules.LEAST_CLUSTERS,
            },
            "text": "Decided is what passes its test after Holm's adjustment over the section, "
            f"each section at {100 * rules.SECTION_ALPHA:g} %; all else is undecided, which is no "
            "statement either way. Intervals are at 95 % and not adjusted.",
        },
        "counts": {
            name: dict(Counter(one["decision"] for one in mine)) for name, mine in of.items()
        },
        "items": items,
    }


def _claims(
    compared: Iterable[Comparison], sweeps: Sweeps, strongest: Mapping[str, Source]
) -> Iterator[Draft]:
    """Yield an item for everything that is compared at an equal missed rate.

    Of FID, and of any other mechanism of the run that has levels.
    """
    wanted = {AS_SHARED.measure(descriptor): AS_IS for descriptor in DESCRIPTORS}
    for task, source in strongest.items():
        metrics, of = ((SUCCESS,), LINKED) if task else (DESCRIPTORS, AFTER)
        wanted |= dict.fromkeys(map(source.measure, metrics), of)
    for one in compared:
        if one.criterion in _CRITERIA and one.measure in wanted:
            name = sweeps.known[one.mechanism].name
            yield _claim(one, wanted[one.measure], "" if name == FID else name)


def _claim(one: Comparison, of: str, mechanism: str) -> Draft:
    """Return an item; the paper's mechanism has no name."""
    found = estimate_of(one.mean_difference, n=one.n)
    source = one.measure.source
    descriptor = "" if of == LINKED else one.measure.metric
    unit = METRICS[one.measure.metric].summary_unit
    where = f"At {_CRITERIA[one.criterion]} ({one.adding} adding)"
    who = mechanism or "FID"
    what = {
        AS_IS: f"{NAME.get(descriptor, '')} as shared",
        AFTER: f"{NAME.get(descriptor, '')} after {source.consumer}",
        LINKED: f"the share of people linked in {source.task}",
    }[of]
    gap = rules.with_interval(found, unit, signed=True)
    relative = found.value / one.mean_fixed if one.mean_fixed else np.nan
    share = f", {100 * relative:+.0f} % of fixed noise's" if np.isfinite(relative) else ""
    than = f"under {who} than under fixed noise: {gap}{share}."
    reached = one.points["at"][np.isfinite(one.points["ci_low"])]
    undecided = f"{where}, {who} less fixed noise in {what} is {gap}."
    why = "the interval, adjusted, holds zero"
    if not rules.is_known(found):
        undecided = f"{where}, {what} cannot be compared."
        why = "the two mechanisms have no range in common that enough replicates reach"
    return Draft(
        adding=one.adding,
        descriptor=descriptor,
        task=source.task,
        subject="" if of == AS_IS else source.attack.label,
        criterion=one.criterion,
        effect=found,
        unit=unit,
        options={rules.HOLDS: rules.p_below(found, 0.0), rules.REVERSED: rules.p_above(found, 0.0)},
        sentences={
            UNDECIDED: undecided,
            rules.HOLDS: f"{where}, {what} is lower {than}",
            rules.REVERSED: f"{where}, {what} is higher {than}",
        },
        why_undecided=why,
        details={
            "of": of,
            "relative": rules.known(float(relative)),
            "range": [float(reached.min()), float(reached.max())] if reached.size else None,
            **({"mechanism": mechanism} if mechanism else {}),
        },
    )


def _inflated(
    sweeps: Sweeps, mechanism: str, adding: str, attack: Source, descriptor: str
) -> Iterator[Draft]:
    """Yield an item, if any level of a mechanism was attacked."""
    measures = attack.measure(descriptor), AS_SHARED.measure(descriptor)
    ratios = []
    for level in sweeps.levels(mechanism):
        after, before = (sweeps.point(mechanism, level, one) for one in measures)
        if after is not None and before is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                ratios.append(np.log(after / before))
    if not ratios:
        return
    mean = np.mean(ratios, axis=0)
    n = sweeps.n(mechanism, measures[0])
    in_logarithms, ratio = estimate_of(mean, n=n), estimate_of(np.exp(mean), n=n)
    name = sweeps.known[mechanism].name
    said = (
        f"After {attack.label} {NAME[descriptor]} under {name} ({adding} adding) is "
        f"{rules.with_interval(ratio, 'ratio')} what it was as shared"
    )
    yield Draft(
        adding=adding,
        descriptor=descriptor,
        subject=attack.label,
        effect=ratio,
        unit="ratio",
        options={
            rules.INFLATED: rules.p_above(in_logarithms, 0.0),
            rules.DEFLATED: rules.p_below(in_logarithms, 0.0),
        },
        sentences={UNDECIDED: f"{said} (geometric mean over the levels)."},
        why_undecided="the interval, adjusted, holds 1",
        details={"of": name, "levels": len(ratios)},
    )


def to_bytes(said: Mapping[str, Any]) -> bytes:
    """Return the content of `verdict.json`."""
    text = json.dumps(said, indent=1, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode()


def _tracking(items: Items, *, dataset: str, fid: Collection[str]) -> str:
    """Return what is said of the descriptors; `fid` is FID under either rule, by name."""
    if not items:
        return (
            f"Whether PLR, AEL and MEL track linkability in {dataset} was not tested: the run "
            "has no sweep of fixed noise, or nobody links."
        )
    named: dict[str, list[str]] = {decision: [] for decision in (*_PLURAL, UNDECIDED)}
    for descriptor in DESCRIPTORS:
        decided = {one["decision"] for one in items if one["descriptor"] == descriptor}
        worst = next((decision for decision in _PLURAL if decision in decided), UNDECIDED)
        named[worst].append(NAME[descriptor])
    open_ones = named.pop(UNDECIDED)
    parts = [
        f"{_listed(names)} {_PLURAL[decision][len(names) > 1]} how linkable people are"
        for decision, names in named.items()
        if names
    ]
    if open_ones and parts:
        parts.append(f"for {_listed(open_ones)} that is undecided")
    elif open_ones:
        parts = [f"whether {_listed(open_ones)} track how linkable people are is undecided"]
    against = [one for one in items if one["decision"] == DOES_NOT]
    why = f": {_evidence(against, fid=fid)}" if against else ""
    return f"In {dataset}, {'; '.join(parts)}{why}."


def _evidence(against: Items, *, fid: Collection[str]) -> str:
    """Return what speaks most against a descriptor: the largest differences either way."""
    differing = [
        {gap["effect"]: gap for gap in reversed(one["contrasts"]) if gap["reading"] == "differs"}
        for one in against
    ]
    furthest = [max(map(abs, effects), default=0.0) for effects in differing]
    if not any(furthest):
        return f"they fall with the noise, success in {against[0]['task']} hardly does"
    place = furthest.index(max(furthest))
    surest, effects, words = against[place], differing[place], []
    for effect, word in ((max(effects), "more"), (min(effects), "fewer")):
        if (effect > 0) == (word == "more"):
            name, level = effects[effect]["mechanism"], effects[effect]["level"]
            where = name if level is None else f"{name} {level:g}"
            words.append(f"{where} lets {100 * abs(effect):.0f} of 100 people {word} be linked")
    alike = any(
        gap["mechanism"] in fid and gap["reading"] == "equal" for gap in surest["contrasts"]
    )
    margin = f"{100 * rules.SUCCESS_MARGIN:.0f} of 100"
    return (
        f"at equal {NAME[surest['descriptor']]}, {_listed(words)} than fixed noise "
        f"({surest['task']}, {surest['adding']} adding"
        + (f"; FID and fixed noise alone are alike to within {margin})" if alike else ")")
    )


def _compared(items: Items) -> str:
    mine = [one for one in items if one["criterion"] == MISSED and "mechanism" not in one]
    if not mine:
        return "The run does not compare FID with fixed noise."
    compared = {AS_IS: "as shared", AFTER: "after the strongest smoother", LINKED: "in linkage"}
    parts = []
    for adding in ADDING_RULES:
        words = [
            f"{where} {_fares(one_rule)}"
            for of, where in compared.items()
            if (one_rule := [one for one in mine if (one["adding"], one["of"]) == (adding, of)])
        ]
        is_open = all(word.endswith(UNDECIDED) for word in words)
        said = f"{UNDECIDED} throughout" if is_open else _listed(words)
        parts += [f"under {adding} adding it is {said}"] * bool(words)
    return "FID against fixed noise at equal missed-conflict rate: " + "; ".join(parts) + "."


def _fares(items: Items) -> str:
    parts = []
    for decision, word in ((rules.HOLDS, "better"), (rules.REVERSED, "worse")):
        found = [one for one in items if one["decision"] == decision]
        if names := [str(NAME.get(one["descriptor"], one["task"])) for one in found]:
            all_of = "" if len(names) < len(items) or len(names) == 1 else "all of "
            parts.append(f"{word} in {all_of}{_listed(names)}")
    return " but ".join(parts) or UNDECIDED


def _raised(items: Items) -> str:
    mine = [one for one in items if one["decision"] == rules.INFLATED]
    if not items:
        return "What an attack makes of the descriptors was not tested: no attack was run."
    if not mine:
        return "That an attack raises the descriptors is undecided."
    subject = mine[0]["subject"]
    parts = []
    for descriptor in DESCRIPTORS:
        ratios = [one["effect"] for one in mine if one["descriptor"] == descriptor]
        if ratios:
            low, high = min(ratios), max(ratios)
            span = f"{low:.1f}" if f"{low:.1f}" == f"{high:.1f}" else f"{low:.1f} to {high:.1f}"
            parts.append(f"{NAME[descriptor]} by {span} times")
    return (
        f"The values as shared understate what is left to an adversary: {subject} raises "
        f"{_listed(parts)}."
    )


def _listed(words: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))
