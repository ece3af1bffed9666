"""Sections c and d of the verdict: what FID is worth, and what an attack makes of a descriptor.

The paper's *claim* is that FID has the advantage over fixed noise at equal missed rate. *Inflation*
is how much higher each descriptor is after the strongest attack than as shared.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.analysis.families import ADDING_RULES, FID
from evaluation.analysis.keys import AS_SHARED, Measure, Source
from evaluation.analysis.matching import AT_EQUAL_ALARMS, MISSED, Comparison, Sweeps
from evaluation.analysis.metrics import DESCRIPTORS, METRICS, SUCCESS
from evaluation.verdict import rules
from evaluation.verdict.rules import NAME, UNDECIDED, Draft, known, with_interval
from isac_track.intervals import estimate_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

_CRITERIA: Final = {
    MISSED: "equal missed-conflict rate",
    AT_EQUAL_ALARMS: "equal missed-conflict rate and equal false alarms",
}
AS_IS, AFTER, LINKED = "as-shared", "after-attack", "linkage"
"""What is compared."""


def claims(
    compared: Iterable[Comparison],
    sweeps: Sweeps,
    *,
    success: Mapping[str, Source],
    attack: Source | None,
) -> Iterator[Draft]:
    """Yield an item for everything that is compared at an equal missed rate.

    Descriptors as shared, after the strongest reconstruction, and what the strongest linkers
    achieve; of any other mechanism of the run that has levels as of FID. `compared` is by one
    predictor; `success` is by task its strongest linker.
    """
    wanted = {AS_SHARED.measure(descriptor): AS_IS for descriptor in DESCRIPTORS}
    if attack is not None:
        wanted |= {attack.measure(descriptor): AFTER for descriptor in DESCRIPTORS}
    wanted |= {linker.measure(SUCCESS): LINKED for linker in success.values()}
    for one in compared:
        if one.criterion in _CRITERIA and one.measure in wanted:
            of, name = wanted[one.measure], sweeps.known[one.mechanism].name
            yield _claim(one, of=of, mechanism="" if name == FID else name)


def _claim(one: Comparison, *, of: str, mechanism: str) -> Draft:
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
    gap = with_interval(found, unit, signed=True)
    relative = found.value / one.mean_fixed if one.mean_fixed else np.nan
    share = f", {100 * relative:+.0f} % of fixed noise's" if np.isfinite(relative) else ""
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
            **{
                decision: f"{where}, {what} is {word} under {who} than under fixed noise: "
                f"{gap}{share}."
                for decision, word in ((rules.HOLDS, "lower"), (rules.REVERSED, "higher"))
            },
        },
        why_undecided=why,
        details={
            "of": of,
            "relative": known(float(relative)),
            "range": [float(reached.min()), float(reached.max())] if reached.size else None,
            **({"mechanism": mechanism} if mechanism else {}),
        },
    )


def inflation(sweeps: Sweeps, *, attack: Source | None) -> Iterator[Draft]:
    """Yield an item for every adding rule, mechanism with levels, and descriptor.

    `attack` is the strongest reconstruction; without one there are no items.
    """
    if attack is None:
        return
    for adding in ADDING_RULES:
        for mechanism in sweeps.swept(adding):
            for descriptor in DESCRIPTORS:
                yield from _inflated(sweeps, mechanism, adding, attack.measure(descriptor))


def _inflated(sweeps: Sweeps, mechanism: str, adding: str, attacked: Measure) -> Iterator[Draft]:
    attack, descriptor = attacked.source, attacked.metric
    measures = attacked, AS_SHARED.measure(descriptor)
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
        f"{with_interval(ratio, 'ratio')} what it was as shared"
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
