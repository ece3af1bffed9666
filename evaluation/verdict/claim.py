"""Section c of the verdict: the paper's claim that FID has the advantage over fixed noise.

At equal missed rate: descriptors as shared, the same after attack, and who is linked. Of FID, and
of any other mechanism of the run that has levels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from evaluation.analysis.families import ADDING_RULES, FID
from evaluation.analysis.keys import AS_SHARED, Source
from evaluation.analysis.matching import AT_EQUAL_ALARMS, MISSED, Comparison, Sweeps
from evaluation.analysis.metrics import DESCRIPTORS, METRICS, SUCCESS
from evaluation.verdict import rules
from evaluation.verdict.rules import NAME, UNDECIDED, Draft, listed
from isac_track.intervals import estimate_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    Items = Sequence[dict[str, Any]]

_CRITERIA: Final = {
    MISSED: "equal missed-conflict rate",
    AT_EQUAL_ALARMS: "equal missed-conflict rate and equal false alarms",
}
AS_IS, AFTER, LINKED = "as-shared", "after-attack", "linkage"
"""What a claim compares."""


def claims(
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


def answer(items: Items) -> str:
    """Return what is said of the paper's mechanism."""
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
        said = f"{UNDECIDED} throughout" if is_open else listed(words)
        parts += [f"under {adding} adding it is {said}"] * bool(words)
    return "FID against fixed noise at equal missed-conflict rate: " + "; ".join(parts) + "."


def _fares(items: Items) -> str:
    parts = []
    for decision, word in ((rules.HOLDS, "better"), (rules.REVERSED, "worse")):
        found = [one for one in items if one["decision"] == decision]
        if names := [str(NAME.get(one["descriptor"], one["task"])) for one in found]:
            all_of = "" if len(names) < len(items) or len(names) == 1 else "all of "
            parts.append(f"{word} in {all_of}{listed(names)}")
    return " but ".join(parts) or UNDECIDED
