"""Sweeps read between their levels, and success compared at an equal descriptor value.

A *sweep* is a mechanism at several levels: a curve from descriptor to linkage success.
Rows are draws of people (the estimate first), columns are levels or contrasts.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from evaluation.estimates.interpolation import (
    CurvePositions,
    interpolated,
    isotonic_rows,
    nearest_positions,
)
from evaluation.verdict import rules
from isac_track.types import Floats, Ints

# Quarter points of the common range of the logarithm, at which FID is read.
QUARTER_POINTS: Final = (0.25, 0.5, 0.75)
BOTH, ONLY_MORE, ONLY_FEWER, NEITHER = 0, 1, -1, 2  # Testable sides of a contrast.
LEAST_SHARE: Final = 0.01  # Of the descriptor at raw: the least value for a logarithm.


@dataclass(frozen=True, eq=False, slots=True)
class FixedNoise:
    """The yardstick: fixed noise, from the noisiest level to raw."""

    descriptor: Floats  # (R, F)
    success: Floats  # (R, F) share of people linked


@dataclass(frozen=True, eq=False, slots=True)
class QuarterReadings:
    """A sweep read at the quarter points of the range shared with fixed noise."""

    descriptor: Floats  # (R, 3)
    success: Floats  # (R, 3)
    places: CurvePositions  # Of the quarter points among the sweep's levels.


@dataclass(frozen=True, eq=False, slots=True)
class FixedNoiseComparison:
    """K levels against fixed noise at the same descriptor value."""

    gaps: Floats  # (R, K) success less that of fixed noise
    side: Ints  # (K,) the direction that can be shown
    places: CurvePositions  # Of the levels among those of fixed noise.


def rates_by_draw(sums: Floats, counts: Floats, weights: Floats) -> Floats:
    """Return rates of L levels under R draws, (R, L).

    `sums` and `counts`, (L, C), are by cluster; `weights`, (R, C), are those of the
    clusters in each draw.
    """
    numerators, denominators = weights @ sums.T, weights @ counts.T
    rates = np.full(numerators.shape, np.nan)
    np.divide(numerators, denominators, out=rates, where=denominators > 0)
    return rates


def read_at_quarter_points(
    descriptor: Floats, success: Floats, fixed_descriptor: Floats
) -> QuarterReadings:
    """Read a sweep's descriptor and success at the quarter points.

    They are of the range of the logarithm that sweep and fixed noise have in common.
    The points are fixed shares of the descriptor at raw, computed from row 0; in each
    replicate they are these shares of its raw. `descriptor` and `success`, (R, E), go
    from the noisiest level to raw, and so does the descriptor of fixed noise, (R, F).
    """
    scale = isotonic_rows(descriptor)
    raw = scale[:, -1:]
    fixed_least = isotonic_rows(fixed_descriptor[:1])[0, 0]
    least = max(scale[0, 0], fixed_least, LEAST_SHARE * raw[0, 0])
    common = least / raw[0, 0] if raw[0, 0] > 0 else 1.0
    at = raw * common ** (1.0 - np.array(QUARTER_POINTS))
    position = nearest_positions(at, scale)
    reached = interpolated(position, isotonic_rows(success), log=False)
    return QuarterReadings(at, reached, position)


def compare_with_fixed(
    descriptor: Floats, success: Floats, fixed: FixedNoise
) -> FixedNoiseComparison:
    """Compare success, (R, K), with that of fixed noise at the same descriptor, (R, K).

    Beyond an end of the sweep, fixed noise is taken at this end. Below its least value
    it links no more than there, above raw no less. So one direction can still be shown.
    """
    scale, achieved = isotonic_rows(fixed.descriptor), isotonic_rows(fixed.success)
    span = scale[0, -1] - scale[0, 0]
    drop = scale[0, -1] - descriptor[0]  # From raw, (K,).
    tolerance = rules.REACH * span
    side = np.full(drop.size, BOTH)
    # Above raw fixed noise would link no less: only fewer links can be shown.
    side[drop < -tolerance] = ONLY_FEWER
    # Below its noisiest level it would link no more: only more links can be shown.
    side[drop > span + tolerance] = ONLY_MORE
    position = nearest_positions(descriptor, scale)
    gaps = success - interpolated(position, achieved, log=False)
    return FixedNoiseComparison(gaps, side, position)


def level_shares(position: CurvePositions, n_levels: int) -> Floats:
    """Return the shares of the levels, noisiest first, behind the estimate, (K, L).

    A value read between two levels has a share of either.
    """
    right, share = position.right[0], np.nan_to_num(position.share[0])
    shares, rows = np.zeros((right.size, n_levels)), np.arange(right.size)
    shares[rows, n_levels - right] = 1.0 - share
    shares[rows, n_levels - 1 - right] += share
    return shares
