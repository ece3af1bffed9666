"""Section c of the verdict: whether FID has the advantage over fixed noise at equal missed rate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.analysis.families import FID
from evaluation.analysis.keys import AS_SHARED
from evaluation.analysis.matching import AT_EQUAL_ALARMS, MISSED
from evaluation.analysis.metrics import DESCRIPTORS, METRICS, SUCCESS
from evaluation.verdict.items import NAME, Draft, known, with_interval
from evaluation.verdict.rules import (
    CLAIM,
    HOLDS,
    REVERSED,
    UNDECIDED,
    Option,
    is_known,
    p_above,
    p_below,
)
from isac_track.intervals import estimate_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from evaluation.analysis.families import Family
    from evaluation.analysis.keys import Source
    from evaluation.analysis.matching import Comparison

_CRITERIA: Final = {
    MISSED: "equal missed-conflict rate",
    AT_EQUAL_ALARMS: "equal missed-conflict rate and equal false alarms",
}
AS_IS, AFTER, LINKED = "as-shared", "after-attack", "linkage"
"""What is compared."""


def claims(
    compared: Iterable[Comparison],
    known_ones: Mapping[str, Family],
    *,
    success: Mapping[str, Source],
    attack: Source | None,
) -> Iterator[Draft]:
    """Yield an item for everything that is compared at an equal missed rate.

    Descriptors as shared, after the strongest reconstruction, and what the strongest linkers
    achieve; of any other mechanism of the run that has levels as of FID.

    Parameters
    ----------
    compared : iterable of Comparison
        By one predictor.
    known_ones : mapping
        The mechanisms of the run, from `families`.
    success : mapping
        By task its strongest linker.
    attack : Source or None
        The strongest reconstruction.
    """
    wanted = {AS_SHARED.measure(descriptor): AS_IS for descriptor in DESCRIPTORS}
    if attack is not None:
        wanted |= {attack.measure(descriptor): AFTER for descriptor in DESCRIPTORS}
    wanted |= {linker.measure(SUCCESS): LINKED for linker in success.values()}
    for one in compared:
        if one.criterion in _CRITERIA and one.measure in wanted:
            yield _claim(one, known_ones[one.mechanism], of=wanted[one.measure])


def _claim(one: Comparison, mechanism: Family, *, of: str) -> Draft:
    found = estimate_of(one.mean_difference, n=one.n)
    source = one.measure.source
    descriptor = "" if of == LINKED else one.measure.metric
    unit = METRICS[one.measure.metric].summary_unit
    where = f"At {_CRITERIA[one.criterion]} ({one.adding} adding)"
    who = "FID" if mechanism.name == FID else mechanism.name
    what = {
        AS_IS: f"{NAME.get(descriptor, '')} as shared",
        AFTER: f"{NAME.get(descriptor, '')} after {source.consumer}",
        LINKED: f"the share of people linked in {source.task}",
    }[of]
    gap = with_interval(found, unit, signed=True)
    relative = found.value / one.mean_fixed if one.mean_fixed else np.nan
    share = f", {100 * relative:+.0f} % of fixed noise's" if np.isfinite(relative) else ""
    reached = one.at[np.isfinite(one.difference[1])]
    return Draft(
        section=CLAIM,
        adding=one.adding,
        descriptor=descriptor,
        task=source.task,
        subject="" if of == AS_IS else source.attack.label,
        criterion=one.criterion,
        effect=found,
        unit=unit,
        options=(Option(HOLDS, p_below(found, 0.0)), Option(REVERSED, p_above(found, 0.0))),
        sentences={
            decision: f"{where}, {what} is {word} under {who} than under fixed noise: {gap}{share}."
            for decision, word in ((HOLDS, "lower"), (REVERSED, "higher"))
        }
        | {
            UNDECIDED: f"{where}, {who} less fixed noise in {what} is {gap}."
            if is_known(found)
            else f"{where}, {what} cannot be compared.",
        },
        why_undecided="the interval, adjusted, holds zero"
        if is_known(found)
        else "the two mechanisms have no range in common that enough replicates reach",
        details={
            "of": of,
            "relative": known(float(relative)),
            "range": [known(float(reached.min())), known(float(reached.max()))]
            if reached.size
            else None,
        }
        | ({} if mechanism.name == FID else {"mechanism": mechanism.name}),
    )
