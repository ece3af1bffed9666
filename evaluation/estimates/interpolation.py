"""Monotone curves over levels: isotonic regression, and reading between levels."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from isac_track.intervals import percentile_intervals
from isac_track.types import Bools, Floats, Ints

# Share of replicates that must reach a point for it to have an interval.
MIN_DEFINED = 0.975
_SMALLEST = 1e-12
_ROUNDING = 1e-9


def with_ends(
    names: tuple[str, str, str], values: Floats, can_say: Bools
) -> dict[str, Floats]:
    """Return value and interval, (P,) each, from estimate and replicates, (1 + B, P).

    `can_say`, (P,), tells where there may be an interval.
    """
    drawn = values[1:].T.copy()
    has_ends = can_say & has_interval(values)
    ends = np.where(has_ends, percentile_intervals(drawn), np.nan)
    # Copy: a view would keep all replicates in memory.
    return dict(zip(names, (values[0].copy(), *ends), strict=True))


def has_interval(values: Floats) -> Bools:
    """Return where enough replicates are known, (P,), of estimates, (1 + B, P)."""
    n_known = np.isfinite(values[1:]).sum(axis=0)
    is_enough = n_known >= MIN_DEFINED * (len(values) - 1)
    return np.asarray(is_enough & np.isfinite(values[0]))


def isotonic_rows(values: Floats) -> Floats:
    """Return each row made to rise from left to right by isotonic regression, (R, L).

    By the min-max formula (Barlow et al. 1972): the largest over all beginnings of the
    smallest over all ends of the mean between them. SciPy's function would need a loop
    over the replicates.
    """
    is_broken = ~(np.diff(values, axis=1) >= 0.0).all(axis=1)
    # About half of the replicates rise by themselves.
    if not is_broken.all():
        monotone = values.copy()
        if is_broken.any():
            monotone[is_broken] = isotonic_rows(values[is_broken])
        return monotone
    # Levels on the first axis: there are few of them and many replicates.
    n_levels = values.shape[1]
    sums = np.zeros((n_levels + 1, values.shape[0]))
    np.cumsum(values.T, axis=0, out=sums[1:])
    best: Floats = np.full((n_levels, values.shape[0]), -np.inf)
    for first in range(n_levels):
        counts = np.arange(1, n_levels - first + 1)[:, None]
        means = (sums[first + 1 :] - sums[first]) / counts
        smallest = np.minimum.accumulate(means[::-1], axis=0)[::-1]
        np.maximum(best[first:], smallest, out=best[first:])
    return np.ascontiguousarray(best.T)


def isotonic_joined(curves: Sequence[Floats], *, increasing: bool) -> list[Floats]:
    """Return curves that end in one raw, their last column, made monotone together.

    Isotonic regression over all curves, (R, L) each, in which raw counts once. Each
    curve is first made monotone by itself; then raw and the values above it are pooled
    to their mean (isotonic regression within bounds; Barlow et al. 1972).
    """
    if not increasing:
        return [
            -curve
            for curve in isotonic_joined([-curve for curve in curves], increasing=True)
        ]
    own = [isotonic_rows(curve[:, :-1]) for curve in curves]
    highest = -np.sort(-np.concatenate(own, axis=1), axis=1)
    sums = np.cumsum(np.append(curves[0][:, -1:], highest, axis=1), axis=1)
    raw = (sums / np.arange(1, sums.shape[1] + 1)).max(axis=1, keepdims=True)
    return [np.append(np.minimum(curve, raw), raw, axis=1) for curve in own]


class CurvePositions(NamedTuple):
    """Positions between levels, whose columns are taken from right to left, raw first."""

    right: Ints  # (R, P) column right of each position, at least 1.
    share: Floats  # (R, P) of the way from the column before; NaN out of reach.


def positions_at_change(at: Floats, change: Floats) -> CurvePositions:
    """Return the position at which each row has changed by `at` from raw, (R, P) each.

    A position is the level to the right (left of it is raw), and the distance from the
    level to the left, 0..1; NaN out of reach. `at` is (P,) for all rows, or (R, P);
    `change`, (R, L), falls from left to right, to 0 at raw.
    """
    x = change[:, ::-1]
    # Rounding must not put the end of a curve out of its own reach.
    targets = np.maximum(
        np.broadcast_to(at, (x.shape[0], at.shape[-1])) - _ROUNDING, 0.0
    )
    right = np.zeros(targets.shape, dtype=np.int64)
    for level in x.T:
        right += level[:, None] < targets
    in_reach = right < x.shape[1]
    right = np.clip(right, 1, x.shape[1] - 1)
    low, high = (np.take_along_axis(x, place, axis=1) for place in (right - 1, right))
    share = np.zeros_like(low)
    np.divide(targets - low, high - low, out=share, where=high > low)
    return CurvePositions(right, np.where(in_reach, np.clip(share, 0.0, 1.0), np.nan))


def nearest_positions(at: Floats, scale: Floats) -> CurvePositions:
    """Return the positions of values, (R, P), on a scale that rises to raw, clipped."""
    change = scale[:, -1:] - scale
    return positions_at_change(np.clip(scale[:, -1:] - at, 0.0, change[:, :1]), change)


def interpolated(at: CurvePositions, values: Floats, *, log: bool) -> Floats:
    """Return the values, (R, L), of each row at its positions, (R, P); NaN if out of reach.

    If the numbers of rows differ, the first rows of both are used. With `log` the
    logarithm is interpolated: a descriptor falls about exponentially with the rate, so
    that this stays close to its curve over a wide step.
    """
    n_rows = min(len(at.right), len(values))
    right, share = at.right[:n_rows], at.share[:n_rows]
    y = values[:n_rows, ::-1]
    y = np.log(np.maximum(y, _SMALLEST)) if log else y
    low, high = (np.take_along_axis(y, place, axis=1) for place in (right - 1, right))
    between: Floats = low + share * (high - low)
    return np.exp(between) if log else between
