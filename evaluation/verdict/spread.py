"""How far apart mechanisms lie in linkage at one value of a descriptor, and what follows from it.

With D_k, how much more often people are linked under mechanism level k than under fixed
noise at one descriptor value, the spread is theta = max |D_k| over a panel. Its naive
estimate is far too high (the largest of several noisy numbers); here are its ends, a
value that is as often too low as too high where all are equal (Chernozhukov, Lee and
Rosen, Econometrica 81, 2013), the decision, and what people could show at all. Rows are
draws of them (the estimate first), columns contrasts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from scipy.special import betaincinv, ndtr, stdtrit

from evaluation.estimates.matching import interpolated, nearest_places, rising
from evaluation.verdict import rules
from isac_track.intervals import CONFIDENCE, FEWEST_EFFECTIVE
from isac_track.types import Bools, Floats, Ints

QUARTILES: Final = (
    0.25,
    0.5,
    0.75,
)  # Of the common range of the logarithm: where FID is read.
BOTH, ONLY_MORE, ONLY_FEWER, NEITHER = 0, 1, -1, 2  # What can be tested of a contrast.
ANSWERS: Final = (rules.NOT_TESTABLE, rules.DOES_NOT, rules.TRACKS, rules.BETWEEN)
"""By the codes of `decided`."""
_TAIL: Final = 0.5 + CONFIDENCE / 2
EQUAL: Final = "all equal"
PLANTED: Final = {
    "10 points in one family": 0.10,
    "15 points in one family": 0.15,
}  # Other truths.
WANTED: Final = 0.8  # Probability with which a true equal is to be shown.
LEAST_SHARE: Final = 0.01  # Of the descriptor at raw: logarithms are taken of no less.


@dataclass(frozen=True, eq=False, slots=True)
class Contrasts:
    """What the spread of one descriptor in one task is read from; fractions of people."""

    gaps: Floats  # (1 + B, K) D_k and its bootstrap replicates
    errors: Floats  # (K,) standard error of D_k; NaN where nothing is known
    # (K,) `BOTH`, `ONLY_MORE` below the fixed sweep, `ONLY_FEWER` above raw, `NEITHER`
    side: Ints
    # (K,) effective clusters less one, the least over all that a contrast rests on
    degrees: Floats
    people: Ints  # (K,) clusters, likewise
    discordant: Floats
    """(3, K) shares of people linked more and less often than under fixed noise; how many in all"""
    decides: Bools  # (K,) not where a difference is there by construction
    fall: Floats  # (1 + B,) of linkage, from raw to the strongest fixed error
    span: Floats  # (1 + B,) logarithm of the descriptor, raw over strongest fixed error
    fall_error: float
    span_error: float
    fall_degrees: float
    is_whole: bool  # The panel is complete, a dissociation control among its contrasts.

    @property
    def is_exact(self) -> Bools:
        """(K,) so few people differ that the interval is that of counts."""
        return np.asarray(self.discordant[2] < rules.FEWEST_DISCORDANT)

    @property
    def furthest(self) -> Floats:
        """(B,) largest deviation of a replicate in standard errors; 0 without any contrast."""
        used = (self.side != NEITHER) & ~self.is_exact
        away = np.abs(self.gaps[1:, used] - self.gaps[0, used]) / self.errors[used]
        return np.asarray(away.max(axis=1, initial=0.0))


@dataclass(frozen=True, slots=True)
class Widths:
    """How far the ends of |D_k| lie from it."""

    down: Floats  # (K,) over all contrasts of the section at once
    up: Floats  # (K,) each by itself: that all are small needs every one to be
    fall: float
    span: float


def ratios(sums: Floats, counts: Floats, weights: Floats) -> Floats:
    """Return sum over sum of levels, (L, C) each, under weights of clusters: (R, L)."""
    over, under = weights @ sums.T, weights @ counts.T
    found = np.full(over.shape, np.nan)
    np.divide(over, under, out=found, where=under > 0)
    return found


def standard_error(drawn: Floats, left_out: Floats) -> Floats:
    """Return the standard error of each column: of the jackknife, or of the bootstrap if larger.

    The jackknife holds with few clusters; where a curve is flat it can miss what
    replicates, `drawn`, (B, K), show. `left_out`, (C, K), is the estimate with one
    cluster left out.
    """
    n = len(left_out)
    jackknife = np.sqrt(
        (n - 1.0) / n * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0)
    )
    return np.asarray(np.maximum(jackknife, drawn.std(axis=0, ddof=1)))


def at_quartiles(
    descriptor: Floats, success: Floats, fixed: Floats
) -> tuple[Floats, Floats, tuple[Ints, Floats]]:
    """Return a sweep's descriptor and success at three fixed quartiles, (R, 3), and its places.

    The quartiles are of the range of the logarithm that sweep and fixed noise have in
    common; they are set by the estimate, as a share of the descriptor at raw.
    `descriptor` and `success`, (R, E), go from the noisiest level to raw, and so does
    that of `fixed` noise, (R, F).
    """
    scale = rising(descriptor)
    raw = scale[:, -1:]
    least = max(scale[0, 0], rising(fixed[:1])[0, 0], LEAST_SHARE * raw[0, 0])
    common = least / raw[0, 0] if raw[0, 0] > 0 else 1.0
    at = raw * common ** (1.0 - np.array(QUARTILES))
    where = nearest_places(at, scale)
    return at, interpolated(where, rising(success), log=False), where


def beside_fixed(
    descriptor: Floats, success: Floats, fixed: tuple[Floats, Floats]
) -> tuple[Floats, Ints, tuple[Ints, Floats]]:
    """Return success less that of fixed noise at the same descriptor value, (R, K).

    And of each what can be tested, (K,), and where it is read. Beyond an end of the
    sweep fixed noise is taken at this end: below its least value it links no more than
    there, above raw no less, so that one direction can still be shown. `descriptor` and
    `success` are (R, K), those of `fixed` noise (R, F) from the noisiest level to raw.
    """
    scale, achieved = map(rising, fixed)
    span, below = scale[0, -1] - scale[0, 0], scale[0, -1] - descriptor[0]
    hair = rules.REACH * span
    side = np.select(
        [below < -hair, below > span + hair], [ONLY_FEWER, ONLY_MORE], BOTH
    )
    where = nearest_places(descriptor, scale)
    return success - interpolated(where, achieved, log=False), side, where


def mixture(where: tuple[Ints, Floats], n_levels: int) -> Floats:
    """Return the shares of the levels, noisiest first, that the estimate is read from: (K, L)."""
    right, share = where[0][0], np.nan_to_num(where[1][0])
    found, rows = np.zeros((right.size, n_levels)), np.arange(right.size)
    found[rows, n_levels - right] = 1.0 - share
    found[rows, n_levels - 1 - right] += share
    return found


def exact_ends(
    more: Floats, fewer: Floats, n: Floats, tail: float
) -> tuple[Floats, Floats]:
    """Return the ends of a difference of two shares of the same `n` people, each missed by `tail`.

    Those linked more often and those linked less often have Clopper and Pearson's
    interval each, at half the tail: exact, and somewhat too wide.
    """

    def lowest(hits: Floats) -> Floats:
        found = betaincinv(np.maximum(hits, rules.NO_SPREAD), n - hits + 1.0, tail / 2)
        return np.where(hits > 0, found, 0.0)

    low = [lowest(share * n) for share in (more, fewer)]
    high = [1.0 - lowest(n - share * n) for share in (more, fewer)]
    return low[0] - high[1], high[0] - low[1]


def critical(one: Contrasts, furthest: Floats, level: float) -> Floats:
    """Return the quantile of the largest deviation as one of t, (K,): errors of few people vary."""
    normal = float(np.quantile(furthest, level)) if furthest.size else 0.0
    return np.asarray(stdtrit(np.maximum(one.degrees, 1.0), ndtr(normal)))


def widths(one: Contrasts, section: Floats) -> Widths:
    """Return how far the ends lie; `section`, (B,), is `furthest` of all tested together."""
    t = stdtrit(np.maximum(one.degrees, 1.0), _TAIL)
    # Where counts give every interval there is no q, and the descriptor is uncertain
    # all the same.
    q = np.maximum(critical(one, section, _TAIL), t)
    down, up = q * one.errors, t * one.errors
    if one.is_exact.any():
        size, n = np.abs(one.gaps[0]), one.degrees + 1.0
        more, fewer = one.discordant[:2]
        low, high = exact_ends(more, fewer, n, 1.0 - _TAIL)
        up = np.where(one.is_exact, np.maximum(up, np.maximum(high, -low) - size), up)
        low, high = exact_ends(
            more, fewer, n, float(ndtr(-np.quantile(section, _TAIL)))
        )
        nearest = np.maximum(np.maximum(low, -high), 0.0)
        down = np.where(one.is_exact, np.maximum(down, size - nearest), down)
    of_fall = float(stdtrit(max(one.fall_degrees, 1.0), _TAIL))
    return Widths(down, up, of_fall * one.fall_error, of_fall * one.span_error)


def intervals(one: Contrasts) -> tuple[Floats, Floats]:
    """Return the ends of each contrast's own interval, (K,): of counts where few people differ."""
    half = stdtrit(np.maximum(one.degrees, 1.0), _TAIL) * one.errors
    low, high = one.gaps[0] - half, one.gaps[0] + half
    more, fewer = one.discordant[:2]
    least, most = exact_ends(more, fewer, one.degrees + 1.0, 1.0 - _TAIL)
    np.minimum(low, least, out=low, where=one.is_exact)
    np.maximum(high, most, out=high, where=one.is_exact)
    return low, high


def ends(one: Contrasts, wide: Widths, gaps: Floats) -> tuple[Floats, Floats]:
    """Return lower ends of |D_k|, at least 0, and upper ends, (R, K) each."""
    # Of a contrast that is one-sided only its own direction counts.
    size = np.where(one.side == BOTH, np.abs(gaps), gaps * one.side)
    low = np.where(one.side == NEITHER, 0.0, np.maximum(size - wide.down, 0.0))
    return low, np.where(one.side == BOTH, size + wide.up, np.inf)


def decided(
    one: Contrasts, wide: Widths, *, gaps: Floats, fall: Floats, span: Floats
) -> tuple[Ints, Floats, Floats]:
    """Return what is decided of each row, as a place in `ANSWERS`, and both ends of the spread.

    `gaps` are (R, K), `fall` and `span` (R,).
    """
    low, high = ends(one, wide, gaps)
    lower = low[:, one.decides].max(axis=1, initial=0.0)
    # Two shares differ by no more than all people.
    upper = np.minimum(high.max(axis=1, initial=0.0), 1.0)
    if (
        one.fall_degrees + 1.0 < FEWEST_EFFECTIVE
        or not one.fall_error > rules.NO_SPREAD
    ):
        return np.zeros(len(gaps), dtype=np.int64), lower, upper
    falls = fall - wide.fall
    is_flat = np.abs(span) + wide.span < np.log(rules.LEAST_SPAN)
    fails = (lower > rules.SUCCESS_MARGIN) | (is_flat & (falls > rules.SUCCESS_MARGIN))
    can_track = one.is_whole & (one.side == BOTH).all() & (falls >= rules.LEAST_FALL)
    tracks = can_track & (upper < rules.SUCCESS_MARGIN)
    codes = np.select([fails, tracks, can_track], [1, 2, 3], 0)
    return codes, lower, upper


def shown(one: Contrasts) -> float:
    """Return the value of the spread that is shown: half-median-unbiased, at least 0."""
    q = critical(one, one.furthest, 0.5)
    low = ends(one, Widths(q * one.errors, q, 0.0, 0.0), one.gaps[:1])[0]
    return float(low[:, one.decides].max(initial=0.0))


def together(every: Sequence[Contrasts]) -> Floats:
    """Return the largest deviation over all contrasts of a section, (B,)."""
    return np.max([one.furthest for one in every], axis=0) if every else np.zeros(0)


def answers(
    one: Contrasts, wide: Widths, families: Sequence[str]
) -> dict[str, dict[str, float]]:
    """Return how probable each answer is if the truth were such: truth, answer, probability.

    From the run's own replicates, moved to the truth: theta + (D_b - D). At the
    observed effect it would say no more than a p-value (Hoenig and Heisey, The American
    Statistician 55, 2001). A difference is planted in one family at a time, more and
    fewer; told is the one found least often. `families` are those of the contrasts,
    (K,).
    """
    around = one.gaps[1:] - one.gaps[0]
    told = np.array(families)

    def found(truth: Floats) -> dict[str, float]:
        codes, *_ = decided(
            one, wide, gaps=around + truth, fall=one.fall[1:], span=one.span[1:]
        )
        shares = np.bincount(codes, minlength=len(ANSWERS)) / max(codes.size, 1)
        return dict(zip(ANSWERS, shares.tolist(), strict=True))

    table = {EQUAL: found(np.zeros(told.size))}
    planted = sorted(set(told[one.decides].tolist()))
    for name, size in PLANTED.items():
        cases = [
            found(sign * size * (told == of)) for of, sign in product(planted, (-1, 1))
        ]
        if cases:
            table[name] = min(cases, key=lambda case: case[rules.DOES_NOT])
    return table


def of_each(table: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Return how probable each decision is where it is right: all equal, or 10 points apart."""
    apart = table.get(next(iter(PLANTED)), {}).get(rules.DOES_NOT, 0.0)
    return {rules.TRACKS: table[EQUAL][rules.TRACKS], rules.DOES_NOT: apart}


def clusters_needed(one: Contrasts, wide: Widths, n: int) -> int | None:
    """Return the clusters at which a true equal is shown with probability `WANTED`.

    All errors shrink with the root of the number of clusters, each of which brings its
    own noise; the gallery stays. None where no number would do: something cannot be
    tested, or linkage falls too little. `n` is how many there are.
    """
    room = float(one.fall[0]) - rules.LEAST_FALL
    if not one.is_whole or (one.side != BOTH).any() or room <= 0:
        return None
    around = np.abs(one.gaps[1:] - one.gaps[0]) + wide.up
    far = float(np.quantile(around.max(axis=1), WANTED)) / rules.SUCCESS_MARGIN
    down = one.fall[0] - one.fall[1:] + wide.fall
    return int(np.ceil(n * max(far, float(np.quantile(down, WANTED)) / room) ** 2))
