"""Spread of linkage between mechanisms at equal descriptor value, and its decision.

D_k is the rank 1 under mechanism level k less that under fixed noise at the same
descriptor value. The spread is theta = max |D_k| over a panel. Its naive estimate is
far too high (the largest of several noisy numbers). This module has the ends of its
interval, a value that is as often too low as too high where all are equal
(Chernozhukov, Lee and Rosen, Econometrica 81, 2013), the decision, and its power. Rows
are draws of people (the estimate first), columns are contrasts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from scipy.special import betaincinv, ndtr, stdtrit

from evaluation.estimates.interpolation import (
    CurvePositions,
    interpolated,
    isotonic_rows,
    nearest_positions,
)
from evaluation.verdict import rules
from isac_track.intervals import CONFIDENCE, FEWEST_EFFECTIVE
from isac_track.types import Bools, Floats, Ints

# Quartiles of the common range of the logarithm, at which FID is read.
QUARTILES: Final = (0.25, 0.5, 0.75)
BOTH, ONLY_MORE, ONLY_FEWER, NEITHER = 0, 1, -1, 2  # Testable sides of a contrast.
ANSWERS: Final = (rules.NOT_TESTABLE, rules.DOES_NOT, rules.TRACKS, rules.BETWEEN)
"""Answers in the order of the codes of `decided`."""
_NOT_TESTABLE, _DOES_NOT, _TRACKS, _BETWEEN = range(len(ANSWERS))
_TAIL: Final = 0.5 + CONFIDENCE / 2
EQUAL: Final = "all equal"
# Truths with a difference.
PLANTED: Final = {
    "10 points in one family": 0.10,
    "15 points in one family": 0.15,
}
WANTED: Final = 0.8  # Probability with which true equality should be shown.
LEAST_SHARE: Final = 0.01  # Of the descriptor at raw: the least value for a logarithm.


@dataclass(frozen=True, eq=False, slots=True)
class Contrasts:
    """Linkage gaps to fixed noise at equal descriptor, by mechanism; shares of people."""

    gaps: Floats  # (1 + B, K) D_k and its bootstrap replicates
    errors: Floats  # (K,) standard error of D_k; NaN where nothing is known
    # (K,) `BOTH`, `ONLY_MORE` below the fixed sweep, `ONLY_FEWER` above raw, `NEITHER`
    side: Ints
    # (K,) effective clusters less one, the least over the levels behind a contrast
    degrees: Floats
    people: Ints  # (K,) clusters, the least over the levels behind a contrast
    discordant: Floats
    """(3, K) shares of people linked more and less often than under fixed noise, and
    the number of these people"""
    decides: Bools  # (K,) false for a difference by construction
    fall: Floats  # (1 + B,) of linkage, from raw to the strongest fixed error
    span: Floats  # (1 + B,) logarithm of the descriptor, raw over strongest fixed error
    fall_error: float
    span_error: float
    fall_degrees: float
    is_whole: bool  # The panel is complete, a dissociation control among its contrasts.

    @property
    def is_exact(self) -> Bools:
        """(K,) whether so few people differ that the interval is that of counts."""
        return np.asarray(self.discordant[2] < rules.FEWEST_DISCORDANT)

    @property
    def furthest(self) -> Floats:
        """(B,) largest deviation of a replicate, in standard errors; 0 if empty."""
        used = (self.side != NEITHER) & ~self.is_exact
        deviation = np.abs(self.gaps[1:, used] - self.gaps[0, used])
        return np.asarray((deviation / self.errors[used]).max(axis=1, initial=0.0))


@dataclass(frozen=True, slots=True)
class Widths:
    """Distances from |D_k| to the ends of its interval."""

    down: Floats  # (K,) over all contrasts of the section at once
    up: Floats  # (K,) each by itself: all are small only if each of them is
    fall: float
    span: float


class Decided(NamedTuple):
    """Answers of R draws, and the ends of the spread."""

    codes: Ints  # (R,) rows of `ANSWERS`
    low: Floats  # (R,) at least 0
    high: Floats  # (R,) at most 1


def ratios(sums: Floats, counts: Floats, weights: Floats) -> Floats:
    """Return ratios of sums to counts, (L, C) each, under cluster weights, (R, L)."""
    over, under = weights @ sums.T, weights @ counts.T
    ratio = np.full(over.shape, np.nan)
    np.divide(over, under, out=ratio, where=under > 0)
    return ratio


def standard_error(drawn: Floats, left_out: Floats) -> Floats:
    """Return the standard error of each column: the larger of jackknife and bootstrap.

    The jackknife holds with few clusters; where a curve is flat it can miss a variation
    that the replicates, `drawn`, (B, K), show. `left_out`, (C, K), is the estimate with
    one cluster left out.
    """
    n = len(left_out)
    jackknife = np.sqrt(
        (n - 1.0) / n * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0)
    )
    return np.asarray(np.maximum(jackknife, drawn.std(axis=0, ddof=1)))


@dataclass(frozen=True, eq=False, slots=True)
class AtQuartiles:
    """A sweep read at the quartiles of the range that it shares with fixed noise."""

    descriptor: Floats  # (R, 3)
    success: Floats  # (R, 3)
    places: CurvePositions  # Of the quartiles among the sweep's levels.


def at_quartiles(descriptor: Floats, success: Floats, fixed: Floats) -> AtQuartiles:
    """Read a sweep's descriptor and success at the quartiles.

    The quartiles are of the range of the logarithm that sweep and fixed noise have in
    common; they are set by the estimate, as a share of the descriptor at raw.
    `descriptor` and `success`, (R, E), go from the noisiest level to raw, and so does
    the descriptor of `fixed` noise, (R, F).
    """
    scale = isotonic_rows(descriptor)
    raw = scale[:, -1:]
    least = max(scale[0, 0], isotonic_rows(fixed[:1])[0, 0], LEAST_SHARE * raw[0, 0])
    common = least / raw[0, 0] if raw[0, 0] > 0 else 1.0
    at = raw * common ** (1.0 - np.array(QUARTILES))
    position = nearest_positions(at, scale)
    reached = interpolated(position, isotonic_rows(success), log=False)
    return AtQuartiles(at, reached, position)


@dataclass(frozen=True, eq=False, slots=True)
class BesideFixed:
    """K levels against fixed noise at the same descriptor value."""

    gaps: Floats  # (R, K) success less that of fixed noise
    side: Ints  # (K,) the direction that can be shown
    places: CurvePositions  # Of the levels among those of fixed noise.


def beside_fixed(
    descriptor: Floats, success: Floats, fixed: tuple[Floats, Floats]
) -> BesideFixed:
    """Compare success with that of fixed noise at the same descriptor value.

    Beyond an end of the sweep, fixed noise is taken at this end. Below its least value
    it links no more than there, above raw no less. So one direction can still be shown.
    `descriptor` and `success` are (R, K), those of `fixed` noise (R, F) from the
    noisiest level to raw.
    """
    scale, achieved = (isotonic_rows(curve) for curve in fixed)
    span, below = scale[0, -1] - scale[0, 0], scale[0, -1] - descriptor[0]
    tolerance = rules.REACH * span
    side = np.select(
        [below < -tolerance, below > span + tolerance], [ONLY_FEWER, ONLY_MORE], BOTH
    )
    position = nearest_positions(descriptor, scale)
    gaps = success - interpolated(position, achieved, log=False)
    return BesideFixed(gaps, side, position)


def mixture(position: CurvePositions, n_levels: int) -> Floats:
    """Return the shares of the levels, noisiest first, behind the estimate, (K, L)."""
    right, share = position.right[0], np.nan_to_num(position.share[0])
    shares, rows = np.zeros((right.size, n_levels)), np.arange(right.size)
    shares[rows, n_levels - right] = 1.0 - share
    shares[rows, n_levels - 1 - right] += share
    return shares


def exact_ends(
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


def critical(contrasts: Contrasts, furthest: Floats, level: float) -> Floats:
    """Return the quantile of the largest deviation, taken to Student's t, (K,).

    The quantile at `level` of the bootstrap's `furthest` is that of known standard
    errors; those of few people are estimated, which Student's t allows for.
    """
    normal = float(np.quantile(furthest, level)) if furthest.size else 0.0
    return np.asarray(stdtrit(np.maximum(contrasts.degrees, 1.0), ndtr(normal)))


def widths(contrasts: Contrasts, section: Floats) -> Widths:
    """Return the distances to the ends; `section`, (B,), is its `furthest`."""
    t = stdtrit(np.maximum(contrasts.degrees, 1.0), _TAIL)
    # Where counts give every interval there is no q; the descriptor is still uncertain.
    q = np.maximum(critical(contrasts, section, _TAIL), t)
    down, up = q * contrasts.errors, t * contrasts.errors
    if contrasts.is_exact.any():
        size, n = np.abs(contrasts.gaps[0]), contrasts.degrees + 1.0
        more, fewer = contrasts.discordant[:2]
        low, high = exact_ends(more, fewer, n, 1.0 - _TAIL)
        up = np.where(
            contrasts.is_exact, np.maximum(up, np.maximum(high, -low) - size), up
        )
        low, high = exact_ends(
            more, fewer, n, float(ndtr(-np.quantile(section, _TAIL)))
        )
        nearest = np.maximum(np.maximum(low, -high), 0.0)
        down = np.where(contrasts.is_exact, np.maximum(down, size - nearest), down)
    t_fall = float(stdtrit(max(contrasts.fall_degrees, 1.0), _TAIL))
    return Widths(
        down, up, t_fall * contrasts.fall_error, t_fall * contrasts.span_error
    )


def intervals(contrasts: Contrasts) -> tuple[Floats, Floats]:
    """Return each contrast's own interval, (K,); of counts where few people differ."""
    half = stdtrit(np.maximum(contrasts.degrees, 1.0), _TAIL) * contrasts.errors
    low, high = contrasts.gaps[0] - half, contrasts.gaps[0] + half
    more, fewer = contrasts.discordant[:2]
    least, most = exact_ends(more, fewer, contrasts.degrees + 1.0, 1.0 - _TAIL)
    np.minimum(low, least, out=low, where=contrasts.is_exact)
    np.maximum(high, most, out=high, where=contrasts.is_exact)
    return low, high


def ends(contrasts: Contrasts, wide: Widths, gaps: Floats) -> tuple[Floats, Floats]:
    """Return lower ends of |D_k|, at least 0, and upper ends, (R, K) each."""
    high = np.where(contrasts.side == BOTH, _sizes(contrasts, gaps) + wide.up, np.inf)
    return _lower_ends(contrasts, wide.down, gaps), high


def _lower_ends(contrasts: Contrasts, down: Floats, gaps: Floats) -> Floats:
    """Return lower ends of |D_k|, (R, K), at a distance `down`, (K,); at least 0."""
    low = np.maximum(_sizes(contrasts, gaps) - down, 0.0)
    return np.where(contrasts.side == NEITHER, 0.0, low)


def _sizes(contrasts: Contrasts, gaps: Floats) -> Floats:
    """Return |D_k|, (R, K); of a one-sided contrast only its own direction counts.

    Callers leave out contrasts without a testable side.
    """
    return np.where(contrasts.side == BOTH, np.abs(gaps), gaps * contrasts.side)


def decided(
    contrasts: Contrasts, wide: Widths, *, gaps: Floats, fall: Floats, span: Floats
) -> Decided:
    """Return each row's answer and the spread's ends.

    `gaps` are (R, K), `fall` and `span` (R,).
    """
    low, high = ends(contrasts, wide, gaps)
    lower = low[:, contrasts.decides].max(axis=1, initial=0.0)
    # Two shares differ by no more than all people.
    upper = np.minimum(high.max(axis=1, initial=0.0), 1.0)
    if (
        contrasts.fall_degrees + 1.0 < FEWEST_EFFECTIVE
        or not contrasts.fall_error > rules.NO_SPREAD
    ):
        return Decided(np.full(len(gaps), _NOT_TESTABLE), lower, upper)
    falls = fall - wide.fall
    is_flat = np.abs(span) + wide.span < np.log(rules.LEAST_SPAN)
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
    return Decided(codes, lower, upper)


def shown(contrasts: Contrasts) -> float:
    """Return the shown value of the spread: half-median-unbiased, at least 0."""
    q = critical(contrasts, contrasts.furthest, 0.5)
    low = _lower_ends(contrasts, q * contrasts.errors, contrasts.gaps[:1])
    return float(low[:, contrasts.decides].max(initial=0.0))


def furthest_together(section: Sequence[Contrasts]) -> Floats:
    """Return the largest deviation over all contrasts of a section, (B,)."""
    return (
        np.max([contrasts.furthest for contrasts in section], axis=0)
        if section
        else np.zeros(0)
    )


def answer_probabilities(
    contrasts: Contrasts, wide: Widths, families: Sequence[str]
) -> dict[str, dict[str, float]]:
    """Return the probability of each answer under some truths, by truth and answer.

    It comes from the run's own replicates, moved to the truth: theta + (D_b - D). At
    the observed effect it would tell no more than a p-value (Hoenig and Heisey, The
    American Statistician 55, 2001). A difference is planted in one family at a time,
    more and fewer; the case that is detected least often is returned. `families` are
    those of the contrasts, (K,).
    """
    around = contrasts.gaps[1:] - contrasts.gaps[0]
    family_names = np.array(families)

    def probabilities(truth: Floats) -> dict[str, float]:
        codes = decided(
            contrasts,
            wide,
            gaps=around + truth,
            fall=contrasts.fall[1:],
            span=contrasts.span[1:],
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


def decision_power(table: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Return the probability of each right decision: all equal, or 10 points apart."""
    apart = table.get(next(iter(PLANTED)), {}).get(rules.DOES_NOT, 0.0)
    return {rules.TRACKS: table[EQUAL][rules.TRACKS], rules.DOES_NOT: apart}


def clusters_needed(contrasts: Contrasts, wide: Widths, n: int) -> int | None:
    """Return the clusters at which a true equal is shown with probability `WANTED`.

    All errors shrink with the root of the number of clusters, each of which brings its
    own noise; the gallery stays. None where no number suffices: a contrast cannot be
    tested, or linkage falls too little. `n` is the present number of clusters.
    """
    room = float(contrasts.fall[0]) - rules.LEAST_FALL
    if not contrasts.is_whole or (contrasts.side != BOTH).any() or room <= 0:
        return None
    around = np.abs(contrasts.gaps[1:] - contrasts.gaps[0]) + wide.up
    far = float(np.quantile(around.max(axis=1), WANTED)) / rules.SUCCESS_MARGIN
    down = contrasts.fall[0] - contrasts.fall[1:] + wide.fall
    return int(np.ceil(n * max(far, float(np.quantile(down, WANTED)) / room) ** 2))
