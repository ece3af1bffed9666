"""Spread of linkage between mechanisms at equal descriptor value, and its decision.

D_k is the rank 1 under mechanism level k less that under fixed noise at the same
descriptor value. The spread is theta = max |D_k| over a panel. Its naive estimate is
far too high (the largest of several noisy numbers). This module has the ends of its
interval, a value that is as often too low as too high where all are equal
(Chernozhukov, Lee and Rosen, Econometrica 81, 2013), and the decision. Rows are draws
of people (the estimate first), columns are contrasts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import betaincinv, ndtr, stdtrit

from evaluation.verdict import rules
from evaluation.verdict.contrasts import Contrasts
from evaluation.verdict.curves import BOTH, NEITHER
from isac_track.intervals import CONFIDENCE, FEWEST_EFFECTIVE
from isac_track.types import Floats, Ints

ANSWERS: Final = (rules.NOT_TESTABLE, rules.DOES_NOT, rules.TRACKS, rules.BETWEEN)
"""Answers in the order of the codes of `decide`."""
_NOT_TESTABLE, _DOES_NOT, _TRACKS, _BETWEEN = range(len(ANSWERS))
_TAIL: Final = 0.5 + CONFIDENCE / 2


@dataclass(frozen=True, eq=False, slots=True)
class IntervalWidths:
    """Distances from an estimate to the ends of its interval; shares of people."""

    down: Floats  # (K,) below |D_k|, over all contrasts of the section at once
    up: Floats  # (K,) above |D_k|, each by itself: all are small if each of them is
    fall: float  # Either way of the fall of fixed noise.
    span: float  # Either way of the logarithm of its descriptor.


@dataclass(frozen=True, eq=False, slots=True)
class SpreadDecisions:
    """Answers of R draws, and the ends of the spread, (R,) each."""

    codes: Ints  # Places in `ANSWERS`.
    low: Floats  # At least 0.
    high: Floats  # At most 1.


def largest_deviation(section: Sequence[Contrasts]) -> Floats:
    """Return the largest deviation over all contrasts of a section, (B,).

    It is in standard errors, and has a value for each bootstrap replicate.
    """
    if not section:
        return np.zeros(0)
    return np.asarray(
        np.max([contrasts.largest_deviation for contrasts in section], axis=0)
    )


def interval_widths(contrasts: Contrasts, deviation: Floats) -> IntervalWidths:
    """Return the distances to the ends; `deviation`, (B,), is the section's largest."""
    t = stdtrit(np.maximum(contrasts.degrees, 1.0), _TAIL)
    # Where counts give every interval there is no q; the descriptor is still uncertain.
    q = np.maximum(_critical_values(contrasts, deviation, _TAIL), t)
    down, up = q * contrasts.errors, t * contrasts.errors
    if contrasts.is_exact.any():
        size, n = np.abs(contrasts.gaps[0]), contrasts.degrees + 1.0
        more, fewer = contrasts.discordant.more, contrasts.discordant.fewer
        low, high = exact_difference_ends(more, fewer, n, 1.0 - _TAIL)
        up = np.where(
            contrasts.is_exact, np.maximum(up, np.maximum(high, -low) - size), up
        )
        section_tail = float(ndtr(-np.quantile(deviation, _TAIL)))
        low, high = exact_difference_ends(more, fewer, n, section_tail)
        nearest = np.maximum(np.maximum(low, -high), 0.0)
        down = np.where(contrasts.is_exact, np.maximum(down, size - nearest), down)
    fixed = contrasts.fixed
    t_fixed = float(stdtrit(max(fixed.degrees, 1.0), _TAIL))
    return IntervalWidths(
        down, up, t_fixed * fixed.fall_error, t_fixed * fixed.span_error
    )


def exact_difference_ends(
    more: Floats, fewer: Floats, n: Floats, tail: float
) -> tuple[Floats, Floats]:
    """Return the ends of a difference of two shares of the same `n` people.

    The probability beyond each end is `tail`. The people linked more often and those
    linked less often have Clopper and Pearson's interval each, at half the tail: exact,
    and somewhat too wide.
    """

    def lowest(hits: Floats) -> Floats:
        root = betaincinv(np.maximum(hits, rules.NO_SPREAD), n - hits + 1.0, tail / 2)
        return np.where(hits > 0, root, 0.0)

    low = [lowest(share * n) for share in (more, fewer)]
    high = [1.0 - lowest(n - share * n) for share in (more, fewer)]
    return low[0] - high[1], high[0] - low[1]


def gap_intervals(contrasts: Contrasts) -> tuple[Floats, Floats]:
    """Return each contrast's own interval, (K,); of counts where few people differ."""
    half = stdtrit(np.maximum(contrasts.degrees, 1.0), _TAIL) * contrasts.errors
    low, high = contrasts.gaps[0] - half, contrasts.gaps[0] + half
    discordant = contrasts.discordant
    least, most = exact_difference_ends(
        discordant.more, discordant.fewer, contrasts.degrees + 1.0, 1.0 - _TAIL
    )
    np.minimum(low, least, out=low, where=contrasts.is_exact)
    np.maximum(high, most, out=high, where=contrasts.is_exact)
    return low, high


def gap_size_ends(
    contrasts: Contrasts, widths: IntervalWidths, gaps: Floats
) -> tuple[Floats, Floats]:
    """Return lower ends of |D_k|, at least 0, and upper ends, (R, K) each."""
    is_two_sided = contrasts.side == BOTH
    high = np.where(is_two_sided, _gap_sizes(contrasts, gaps) + widths.up, np.inf)
    return _lower_ends(contrasts, widths.down, gaps), high


def decide(
    contrasts: Contrasts,
    widths: IntervalWidths,
    *,
    gaps: Floats,
    fall: Floats,
    span: Floats,
) -> SpreadDecisions:
    """Return each row's answer and the spread's ends.

    `gaps`, (R, K), `fall` and `span`, (R,), are as in `Contrasts`: the estimate alone,
    or replicates moved to a supposed truth.
    """
    low, high = gap_size_ends(contrasts, widths, gaps)
    lower = low[:, contrasts.decides].max(axis=1, initial=0.0)
    # Two shares differ by no more than all people.
    upper = np.minimum(high.max(axis=1, initial=0.0), 1.0)
    fixed = contrasts.fixed
    is_few = fixed.degrees + 1.0 < FEWEST_EFFECTIVE
    if is_few or not fixed.fall_error > rules.NO_SPREAD:
        return SpreadDecisions(np.full(len(gaps), _NOT_TESTABLE), lower, upper)
    falls = fall - widths.fall
    is_flat = np.abs(span) + widths.span < np.log(rules.LEAST_SPAN)
    fails = (lower > rules.SUCCESS_MARGIN) | (is_flat & (falls > rules.SUCCESS_MARGIN))
    can_track = (
        contrasts.is_whole
        & (contrasts.side == BOTH).all()
        & (falls >= rules.LEAST_FALL)
    )
    tracks = can_track & (upper < rules.SUCCESS_MARGIN)
    codes = np.select(
        [fails, tracks, can_track], [_DOES_NOT, _TRACKS, _BETWEEN], _NOT_TESTABLE
    )
    return SpreadDecisions(codes, lower, upper)


def median_unbiased_spread(contrasts: Contrasts) -> float:
    """Return the spread to show: too high as often as too low, and at least 0."""
    q = _critical_values(contrasts, contrasts.largest_deviation, 0.5)
    low = _lower_ends(contrasts, q * contrasts.errors, contrasts.gaps[:1])
    return float(low[:, contrasts.decides].max(initial=0.0))


def _critical_values(contrasts: Contrasts, deviation: Floats, level: float) -> Floats:
    """Return the quantile of the largest deviation, taken to Student's t, (K,).

    The quantile at `level` of the bootstrap's `deviation` is that of known standard
    errors; those of few people are estimated, which Student's t allows for.
    """
    normal = float(np.quantile(deviation, level)) if deviation.size else 0.0
    return np.asarray(stdtrit(np.maximum(contrasts.degrees, 1.0), ndtr(normal)))


def _lower_ends(contrasts: Contrasts, down: Floats, gaps: Floats) -> Floats:
    """Return lower ends of |D_k|, (R, K), at a distance `down`, (K,); at least 0."""
    low = np.maximum(_gap_sizes(contrasts, gaps) - down, 0.0)
    return np.where(contrasts.side == NEITHER, 0.0, low)


def _gap_sizes(contrasts: Contrasts, gaps: Floats) -> Floats:
    """Return |D_k|, (R, K); of a one-sided contrast only its own direction counts.

    Callers leave out contrasts without a testable side.
    """
    return np.where(contrasts.side == BOTH, np.abs(gaps), gaps * contrasts.side)
