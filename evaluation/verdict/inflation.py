"""Section d of the verdict: how much higher each descriptor is after the strongest attack."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from evaluation.analysis.families import ADDING_RULES
from evaluation.analysis.keys import AS_SHARED
from evaluation.analysis.metrics import DESCRIPTORS
from evaluation.verdict.items import NAME, Draft, with_interval
from evaluation.verdict.rules import (
    DEFLATED,
    INFLATED,
    INFLATION,
    UNDECIDED,
    Option,
    p_above,
    p_below,
)
from isac_track.intervals import estimate_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from evaluation.analysis.keys import Source
    from evaluation.analysis.sweeps import Sweeps


def inflation(sweeps: Sweeps, *, attack: Source | None) -> Iterator[Draft]:
    """Yield an item for every adding rule, mechanism with levels, and descriptor.

    Parameters
    ----------
    sweeps : Sweeps
        Of everything in the run.
    attack : Source or None
        The strongest reconstruction; without one there are no items.
    """
    if attack is None:
        return
    for adding in ADDING_RULES:
        for mechanism in sweeps.swept(adding):
            for descriptor in DESCRIPTORS:
                draft = _item(
                    sweeps, mechanism, adding=adding, descriptor=descriptor, attack=attack
                )
                if draft is not None:
                    yield draft


def _item(
    sweeps: Sweeps, mechanism: str, *, adding: str, descriptor: str, attack: Source
) -> Draft | None:
    after, before = attack.measure(descriptor), AS_SHARED.measure(descriptor)
    ratios = []
    for level in sweeps.levels(mechanism):
        pair = [sweeps.point(mechanism, level, one) for one in (after, before)]
        if pair[0] is not None and pair[1] is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                ratios.append(np.log(pair[0] / pair[1]))
    if not ratios:
        return None
    mean = np.mean(ratios, axis=0)
    n = sweeps.n(mechanism, after)
    in_logarithms, ratio = estimate_of(mean, n=n), estimate_of(np.exp(mean), n=n)
    name = sweeps.known[mechanism].name
    said = (
        f"After {attack.label} {NAME[descriptor]} under {name} ({adding} adding) is "
        f"{with_interval(ratio, 'ratio')} what it was as shared"
    )
    return Draft(
        section=INFLATION,
        adding=adding,
        descriptor=descriptor,
        subject=attack.label,
        effect=ratio,
        unit="ratio",
        options=(
            Option(INFLATED, p_above(in_logarithms, 0.0)),
            Option(DEFLATED, p_below(in_logarithms, 0.0)),
        ),
        sentences={UNDECIDED: f"{said} (geometric mean over the levels)."},
        why_undecided="the interval, adjusted, holds 1",
        details={"of": name, "levels": len(ratios)},
    )
