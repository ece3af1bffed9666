"""Place a recording relative to the base station.

The origin of a file is arbitrary, but the noise depends on the distance from the
station. A recording is therefore shifted as a whole until the middle of its crowd lies
where the robots start. Station and robots have places of their own (`sensing.bs_x_m`,
`scenes.robot_x_m`). Nothing is turned: the crowd keeps its orientation.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from isac_track.config import StageSettings
from isac_track.types import Bools, Floats, Ints, Tracks, derived, squared_lengths

ROUNDED_OFF_M: Final = 1e-3
"""Distances r count as sqrt(r^2 + this^2), so that the median is unique on a line."""
_CLOSE_M: Final = 1e-10  # A step below this ends the search.
_MOST_STEPS: Final = 500


def geometric_median(points: Floats) -> Floats:
    """Return the point with the least sum of distances to `points`, (K, 2) m -> (2,) m.

    It moves with the points when they are shifted, turned or mirrored. The distances
    are rounded off within `ROUNDED_OFF_M`, without which an even number of points on a
    line has many medians.
    """
    (median,) = geometric_medians(points, np.array([0, len(points)]))
    return np.asarray(median)


def geometric_medians(xy: Floats, offsets: Ints) -> Floats:
    """Return the geometric median of each track, (M, 2) m -> (N, 2) m.

    Each iteration takes the step of Newton or of Weiszfeld (Tohoku Math. J. 43, 1937),
    whichever lowers the sum of distances further; Weiszfeld's always lowers it.
    """
    sizes = np.diff(offsets)
    origin = xy[offsets[:-1]]  # Relative to it, coordinates lose no digits.
    points = xy - np.repeat(origin, sizes, axis=0)
    median: Floats = np.add.reduceat(points, offsets[:-1]) / sizes[:, None]
    is_moving: Bools = np.ones(sizes.size, dtype=bool)
    for _ in range(_MOST_STEPS):
        rows = np.flatnonzero(is_moving)
        own_points = points[np.repeat(is_moving, sizes)]
        start = np.cumsum(sizes[rows]) - sizes[rows]
        nearer = _improve_medians(own_points, median[rows], start, sizes[rows])
        is_moving[rows] = np.sqrt(squared_lengths(nearer - median[rows])) > _CLOSE_M
        median[rows] = nearer
        if not is_moving.any():
            break
    return origin + median


def _improve_medians(
    points: Floats, median: Floats, start: Ints, sizes: Ints
) -> Floats:
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
    newton_m = _distance_sums(points, newton, start, sizes)
    weiszfeld_m = _distance_sums(points, weiszfeld, start, sizes)
    return np.where((newton_m <= weiszfeld_m)[:, None], newton, weiszfeld)


def _distance_sums(points: Floats, median: Floats, start: Ints, sizes: Ints) -> Floats:
    """Return the sum of rounded-off distances of each track's points, (N,) m."""
    square = (
        squared_lengths(np.repeat(median, sizes, axis=0) - points) + ROUNDED_OFF_M**2
    )
    return np.asarray(np.add.reduceat(np.sqrt(square), start))


def placed(tracks: Tracks, *, settings: StageSettings) -> Tracks:
    """Return the tracks of a recording at the place where they are sensed.

    See `placed_together`.
    """
    return placed_together([tracks], settings=settings)[0]


def placed_together(
    sessions: Sequence[Tracks], *, settings: StageSettings
) -> tuple[Tracks, ...]:
    """Return sessions at the place where they are sensed, all in one frame.

    With `sensing.place` *centred* the geometric median of the tracks' own medians comes
    to lie where the robots start. All recorded tracks count once, however short: a
    person who stands for an hour weighs no more than a passer-by. With *file* the
    sessions stay where they are.
    """
    if settings.sensing.place == "file":
        return tuple(sessions)
    # First of all: coordinates far from the origin lose digits.
    origin = sessions[0].xy[0]
    near = [session.xy - origin for session in sessions]
    medians = [
        geometric_medians(xy, session.offsets)
        for xy, session in zip(near, sessions, strict=True)
    ]
    start_m = np.array([settings.scenes.robot_x_m, settings.scenes.robot_y_m])
    shift_m = start_m - geometric_median(np.concatenate(medians))
    return tuple(
        derived(session, xy=xy + shift_m)
        for xy, session in zip(near, sessions, strict=True)
    )
