"""Compiled loops over windows that slide along a track: of means and of parabolas."""

import numpy as np

from isac_track.compiling import compiled, part_of_loop, read, written
from isac_track.types import Floats, Ints


@compiled(read(1), read(2), read(1, "int64"), read(1, "int64"), written(2))
def centred_means(
    _: Floats, xy: Floats, offsets: Ints, half: Ints, out: Floats
) -> None:
    """Fill `out` with means over up to `half` neighbours on each side.

    Near the ends of a track there are fewer, as many on either side.
    """
    total = np.zeros((np.diff(offsets).max() + 1 if half.size > 0 else 1, 2))
    for i in range(half.size):
        own, means = xy[offsets[i] : offsets[i + 1]], out[offsets[i] : offsets[i + 1]]
        last = len(own) - 1
        # Sums of small numbers lose less precision: positions count from the first.
        for k in range(len(own)):
            for axis in range(2):
                total[k + 1, axis] = total[k, axis] + (own[k, axis] - own[0, axis])
        for k in range(len(own)):
            side = min(half[i], k, last - k)
            for axis in range(2):
                within = total[k + side + 1, axis] - total[k - side, axis]
                means[k, axis] = within / (2 * side + 1) + own[0, axis]


@part_of_loop
def _to_grid(t: Floats, xy: Floats, step_s: float, grid: Floats) -> None:
    """Interpolate onto as many instants at the mean interval, (2, n).

    Positions are relative to the first sample.
    """
    last = t.size - 1
    k = 0
    for i in range(t.size):
        instant = t[0] + i * step_s
        while k < last - 1 and t[k + 1] <= instant:
            k += 1
        share = min((instant - t[k]) / (t[k + 1] - t[k]), 1.0)
        for axis in range(2):
            grid[axis, i] = (
                xy[k, axis] - xy[0, axis] + share * (xy[k + 1, axis] - xy[k, axis])
            )


@part_of_loop
def _from_grid(
    t: Floats, grid: Floats, step_s: float, origin: Floats, out: Floats
) -> None:
    """Interpolate back onto the samples' own instants."""
    last = t.size - 1
    for i in range(t.size):
        place = min((t[i] - t[0]) / step_s, float(last))
        k = min(int(place), last - 1)
        for axis in range(2):
            before = grid[axis, k]
            out[i, axis] = (
                origin[axis] + before + (place - k) * (grid[axis, k + 1] - before)
            )


@part_of_loop
def _slide(grid: Floats, half: int, fitted: Floats) -> None:
    """Fit a parabola to each window of 2 half + 1 values, from running moments.

    With j counted from the middle of the window, s0, s1 and s2 are the sums of the
    values times 1, j and j^2. At either end the outermost window's parabola is carried
    on.
    """
    n, m = grid.size, half
    count = 2.0 * m + 1.0
    j2 = m * (m + 1.0) * count / 3.0
    j4 = j2 * (3.0 * m * m + 3.0 * m - 1.0) / 5.0
    over_spread = 1.0 / (j4 - j2 * j2 / count)
    over_count, over_j2 = 1.0 / count, 1.0 / j2
    s0 = s1 = s2 = 0.0
    for middle in range(m, n - m):
        # Summed up afresh once a window: rounding errors of running sums grow with the
        # square of their number.
        if (middle - m) % (2 * m + 1) == 0:
            s0 = s1 = s2 = 0.0
            for j in range(-m, m + 1):
                value = grid[middle + j]
                s0 += value
                s1 += j * value
                s2 += j * j * value
        else:
            oldest, newest = grid[middle - m - 1], grid[middle + m]
            s0 -= oldest
            s1 += m * oldest
            s2 -= m * m * oldest
            s2 += s0 - 2.0 * s1  # j is one less, seen from the next middle
            s1 -= s0
            s0 += newest
            s1 += m * newest
            s2 += m * m * newest
        bend = (s2 - s0 * j2 * over_count) * over_spread
        level = (s0 - bend * j2) * over_count
        before, after = (m if middle == m else 0), (m if middle == n - 1 - m else 0)
        for j in range(-before, after + 1):
            fitted[middle + j] = level + j * (s1 * over_j2 + j * bend)


@compiled(read(1), read(2), read(1, "int64"), read(1, "int64"), written(2))
def fit_parabolas(
    t: Floats, xy: Floats, offsets: Ints, half: Ints, out: Floats
) -> None:
    """Smooth every track over windows of ``2 half + 1`` samples.

    A track with half 0 stays as it is.
    """
    for i in range(offsets.size - 1):
        first, end = offsets[i], offsets[i + 1]
        n = end - first
        if half[i] == 0:
            out[first:end] = xy[first:end]
            continue
        clock, places = t[first:end], xy[first:end]
        step_s = (clock[n - 1] - clock[0]) / (n - 1)
        grid, fitted = np.empty((2, n)), np.empty((2, n))
        _to_grid(clock, places, step_s, grid)
        for axis in range(2):
            _slide(grid[axis], half[i], fitted[axis])
        _from_grid(clock, fitted, step_s, places[0], out[first:end])
