"""What the people of a run could show at all: how probable each answer is, and how many it takes.

From the run's own replicates, moved to where the truth is supposed to be: D* = theta + (D_b - D).
It is not the power at the observed effect, which says nothing beyond the p-value (Hoenig and
Heisey, The American Statistician 55, 2001).
"""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Final

import numpy as np

from evaluation.verdict import rules
from evaluation.verdict.spread import ANSWERS, BOTH, Contrasts, Widths, decided
from isac_track.types import Floats

EQUAL: Final = "all equal"
PLANTED: Final = {"10 points in one family": 0.10, "15 points in one family": 0.15}
"""Truths beside that all are equal."""
WANTED: Final = 0.8  # Probability with which a true equal is to be shown.


def answers(one: Contrasts, wide: Widths, families: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return how probable each answer is if the truth were such: truth, answer, probability.

    A difference is planted in one family at a time, more and fewer; told is the one found least
    often. `families` are those of the contrasts, (K,).
    """
    around = one.gaps[1:] - one.gaps[0]
    told = np.array(families)

    def found(truth: Floats) -> dict[str, float]:
        codes, *_ = decided(one, wide, gaps=around + truth, fall=one.fall[1:], span=one.span[1:])
        shares = np.bincount(codes, minlength=len(ANSWERS)) / max(codes.size, 1)
        return dict(zip(ANSWERS, shares.tolist(), strict=True))

    table = {EQUAL: found(np.zeros(told.size))}
    planted = sorted(set(told[one.decides].tolist()))
    for name, size in PLANTED.items():
        cases = [found(sign * size * (told == of)) for of, sign in product(planted, (-1, 1))]
        if cases:
            table[name] = min(cases, key=lambda case: case[rules.DOES_NOT])
    return table


def of_each(table: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Return how probable each decision is where it is right: all equal, or 10 points apart."""
    apart = table.get(next(iter(PLANTED)), {}).get(rules.DOES_NOT, 0.0)
    return {rules.TRACKS: table[EQUAL][rules.TRACKS], rules.DOES_NOT: apart}


def clusters_needed(one: Contrasts, wide: Widths, n: int) -> int | None:
    """Return the clusters at which a true equal is shown with probability `WANTED`.

    All errors shrink with the root of the number of clusters, each of which brings its own noise;
    the gallery stays. None where no number would do: something cannot be tested, or linkage falls
    too little. `n` is how many there are.
    """
    room = float(one.fall[0]) - rules.LEAST_FALL
    if not one.is_whole or (one.side != BOTH).any() or room <= 0:
        return None
    around = np.abs(one.gaps[1:] - one.gaps[0]) + wide.up
    far = float(np.quantile(around.max(axis=1), WANTED)) / rules.SUCCESS_MARGIN
    down = one.fall[0] - one.fall[1:] + wide.fall
    return int(np.ceil(n * max(far, float(np.quantile(down, WANTED)) / room) ** 2))
