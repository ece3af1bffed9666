"""Power of the decision on a spread: how surely it would be right, and with how many.

It comes from the run's own replicates, moved to a supposed truth.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Final, TypeAlias

import numpy as np

from evaluation.verdict import rules
from evaluation.verdict.contrasts import Contrasts
from evaluation.verdict.curves import BOTH
from evaluation.verdict.spread import ANSWERS, IntervalWidths, decide
from isac_track.types import Floats

EQUAL: Final = "all equal"
# Truths with a difference.
PLANTED: Final = {
    "10 points in one family": 0.10,
    "15 points in one family": 0.15,
}
WANTED: Final = 0.8  # Probability with which true equality should be shown.
AnswerProbabilities: TypeAlias = "Mapping[str, Mapping[str, float]]"
"""By truth (`EQUAL` and those of `PLANTED`), the probability of each decision."""


def answer_probabilities(
    contrasts: Contrasts, widths: IntervalWidths, families: Sequence[str]
) -> AnswerProbabilities:
    """Return the probability of each answer under some truths.

    It comes from the run's own replicates, moved to the truth: theta + (D_b - D). At
    the observed effect it would tell no more than a p-value (Hoenig and Heisey, The
    American Statistician 55, 2001). A difference is planted in one family at a time,
    more and fewer; the case that is detected least often is returned. `families` are
    those of the contrasts, (K,).
    """
    around = contrasts.gaps[1:] - contrasts.gaps[0]
    family_names = np.array(families)

    def probabilities(truth: Floats) -> dict[str, float]:
        codes = decide(
            contrasts,
            widths,
            gaps=around + truth,
            fall=contrasts.fixed.fall[1:],
            span=contrasts.fixed.span[1:],
        ).codes
        shares = np.bincount(codes, minlength=len(ANSWERS)) / max(codes.size, 1)
        return dict(zip(ANSWERS, shares.tolist(), strict=True))

    no_difference = np.zeros(family_names.size)
    table = {EQUAL: probabilities(no_difference)}
    planted = sorted(set(family_names[contrasts.decides].tolist()))
    for name, size in PLANTED.items():
        cases = [
            probabilities(sign * size * (family_names == family))
            for family, sign in product(planted, (-1, 1))
        ]
        if cases:
            table[name] = min(cases, key=lambda case: case[rules.DOES_NOT])
    return table


def decision_power(table: AnswerProbabilities) -> dict[str, float]:
    """Return the probability of each right decision: all equal, or 10 points apart."""
    apart = table.get(next(iter(PLANTED)), {}).get(rules.DOES_NOT, 0.0)
    return {rules.TRACKS: table[EQUAL][rules.TRACKS], rules.DOES_NOT: apart}


def clusters_needed(contrasts: Contrasts, widths: IntervalWidths, n: int) -> int | None:
    """Return the clusters at which a true equal is shown with probability `WANTED`.

    All errors shrink with the root of the number of clusters, each of which brings its
    own noise; the gallery stays. None where no number suffices: a contrast cannot be
    tested, or linkage falls too little. `n` is the present number of clusters.
    """
    fixed_fall = contrasts.fixed.fall
    room = float(fixed_fall[0]) - rules.LEAST_FALL
    if not contrasts.is_whole or (contrasts.side != BOTH).any() or room <= 0:
        return None
    around = np.abs(contrasts.gaps[1:] - contrasts.gaps[0]) + widths.up
    far = float(np.quantile(around.max(axis=1), WANTED)) / rules.SUCCESS_MARGIN
    down = fixed_fall[0] - fixed_fall[1:] + widths.fall
    return int(np.ceil(n * max(far, float(np.quantile(down, WANTED)) / room) ** 2))
