"""Where a recording stands relative to the base station: geometry is of the experiment.

The origin of a file is an accident of whoever annotated it, and the noise depends on
the distance from the station. A recording is therefore moved, as a whole, until the
middle of its crowd lies where the robots start; station and robots have places of their
own (`sensing.bs_x_m`, `scenes.robot_x_m`). Nothing is turned: the crowd keeps its
orientation.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from isac_track.config import StageSettings
from isac_track.types import Bools, Floats, Ints, Tracks, derived, squared_lengths

ROUNDED_OFF_M: Final = 1e-3
"""Distances r are taken as sqrt(r^2 + this^2): so the median is unique, on a line, too."""
_CLOSE_M: Final = 1e-10  # Steps below end the search.
_MOST_STEPS: Final = 500


def geometric_median(points: Floats) -> Floats:
    """Return the point with the least sum of distances to `points`, (K, 2) m -> (2,) m.

    Whatever shifts, turns or mirrors the points does the same to it. The distances are
    rounded off within `ROUNDED_OFF_M`, without which an even number of points on a line
    has many medians.
    """
    (median,) = geometric_medians(points, np.array([0, len(points)]))
    return np.asarray(median)


def geometric_medians(xy: Floats, offsets: Ints) -> Floats:
    """Return the geometric median of the samples of each of N tracks, (M, 2) m -> (N, 2) m.

    Newton's step where it brings the sum of distances down further than Weiszfeld's
    (Tohoku Math. J. 43, 1937), which always does.
    """
    sizes = np.diff(offsets)
    origin = xy[offsets[:-1]]  # Nothing is lost of coordinates far from the file's own.
    points = xy - np.repeat(origin, sizes, axis=0)
    median: Floats = np.add.reduceat(points, offsets[:-1]) / sizes[:, None]
    left: Bools = np.ones(sizes.size, dtype=bool)
    for _ in range(_MOST_STEPS):
        rows = np.flatnonzero(left)
        own, start = (
            points[np.repeat(left, sizes)],
            np.cumsum(sizes[left]) - sizes[left],
        )
        nearer = _step(own, median[left], start, sizes[left])
        left[rows] = np.sqrt(squared_lengths(nearer - median[left])) > _CLOSE_M
        median[rows] = nearer
        if not left.any():
            break
    return origin + median


def _step(points: Floats, median: Floats, start: Ints, sizes: Ints) -> Floats:
    """Return better medians, (N, 2), of the samples that begin at `start`, (N,)."""
    gap = np.repeat(median, sizes, axis=0) - points
    weight = 1.0 / np.sqrt(squared_lengths(gap) + ROUNDED_OFF_M**2)
    slope = np.add.reduceat(weight[:, None] * gap, start)
    total = np.add.reduceat(weight, start)
    # The matrix of second derivatives, symmetric and positive definite.
    xx, yy, xy = (
        np.add.reduceat(weight**3 * part, start)
        for part in (gap[:, 0] ** 2, gap[:, 1] ** 2, gap[:, 0] * gap[:, 1])
    )
    a, d = total - xx, total - yy
    across = np.column_stack(
        [d * slope[:, 0] + xy * slope[:, 1], xy * slope[:, 0] + a * slope[:, 1]]
    )
    newton = median - across / (a * d - xy**2)[:, None]
    weiszfeld = median - slope / total[:, None]
    sums = (_distances(points, at, start, sizes) for at in (newton, weiszfeld))
    is_better = np.less_equal(*sums)
    return np.where(is_better[:, None], newton, weiszfeld)


def _distances(points: Floats, median: Floats, start: Ints, sizes: Ints) -> Floats:
    square = (
        squared_lengths(np.repeat(median, sizes, axis=0) - points) + ROUNDED_OFF_M**2
    )
    return np.asarray(np.add.reduceat(np.sqrt(square), start))


def placed(tracks: Tracks, *, settings: StageSettings) -> Tracks:
    """Return the tracks of a recording where they are sensed: see `placed_together`."""
    return placed_together([tracks], settings=settings)[0]


def placed_together(
    sessions: Sequence[Tracks], *, settings: StageSettings
) -> tuple[Tracks, ...]:
    """Return sessions where they are sensed, all in one frame.

    With `sensing.place` *centred* the geometric median of the tracks' own medians comes
    to lie where the robots start. It is that of all recorded tracks, however short,
    each of which counts once: who stands for an hour weighs no more than who passes by.
    With *file* they stay.
    """
    if settings.sensing.place == "file":
        return tuple(sessions)
    origin = sessions[0].xy[
        0
    ]  # Before anything else: far from it coordinates lose digits.
    near = [one.xy - origin for one in sessions]
    medians = [
        geometric_medians(xy, one.offsets)
        for xy, one in zip(near, sessions, strict=True)
    ]
    start_m = np.array([settings.scenes.robot_x_m, settings.scenes.robot_y_m])
    shift_m = start_m - geometric_median(np.concatenate(medians))
    return tuple(
        derived(one, xy=xy + shift_m) for xy, one in zip(near, sessions, strict=True)
    )
