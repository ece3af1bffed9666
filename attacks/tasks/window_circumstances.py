"""Circumstances of windows: properties of the session in which a person walked.

The controls of `cross_session` compare them. They tell when and in which place of the
queue somebody walked, not who it is.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from attacks.tasks.windows import Windows
from isac_track.types import Bools, Complexes, Floats, Ints, Tracks

CIRCUMSTANCE_COLUMNS: Final[Mapping[str, tuple[int, ...]]] = {
    "queue_place": (0, 1),
    "walking_direction": (2,),
    "run_density": (3,),
    "run_time": (4,),
    "walk_length": (5,),
}
"""By control, the columns of `Windows.circumstances` that it compares."""


def measure_circumstances(tracks: Tracks, rows: Ints, windows: Windows) -> Floats:
    """Return six properties of each window that do not depend on its person, (N, 6).

    `rows`, (N,), are the tracks that the windows are cut from. The columns are:

    - 0, 1: the place in the queue when the session begins, on a circle: cosine and sine
      of the rank by bearing from the session's middle;
    - 2: the direction of walking round that middle, -1 to 1;
    - 3: the number of people present;
    - 4: the time, s from the session's start;
    - 5: how long the whole track lasts, s.
    """
    assert tracks.session is not None
    session = np.array(tracks.session)
    first, last = tracks.offsets[:-1], tracks.offsets[1:] - 1
    values = np.empty((rows.size, 6))
    for number, row in enumerate(rows.tolist()):
        in_session = np.flatnonzero(session == session[row])
        begin_s, end_s = tracks.t[first[in_session]], tracks.t[last[in_session]]
        samples = slice(first[in_session[0]], last[in_session[-1]] + 1)
        middle_m = tracks.xy[samples].mean(axis=0)
        start_m = tracks.xy[first[in_session]] - middle_m
        angle = _queue_angle(start_m, in_session == row)
        t = windows.t[windows.offsets[number] : windows.offsets[number + 1]]
        walk = slice(first[row], last[row] + 1)
        x = np.interp(t, tracks.t[walk], tracks.xy[walk, 0])
        y = np.interp(t, tracks.t[walk], tracks.xy[walk, 1])
        values[number] = (
            np.cos(angle),
            np.sin(angle),
            _turning_direction(x + 1j * y, complex(*middle_m)),
            ((begin_s <= t.mean()) & (end_s >= t.mean())).sum(),
            t.mean() - begin_s.min(),
            tracks.t[last[row]] - tracks.t[first[row]],
        )
    return values


def _queue_angle(start_m: Floats, is_track: Bools) -> float:
    """Return the rank of a track by bearing as an angle, 0 to 2 pi.

    `start_m`, (T, 2), are the starts of a session's tracks from its middle. `is_track`,
    (T,), is true for the track alone.
    """
    bearing = np.arctan2(*start_m.T)
    return 2.0 * np.pi * float((bearing < bearing[is_track]).mean())


def _turning_direction(position_m: Complexes, middle_m: complex) -> float:
    """Return how far a way goes round a middle: 1 counterclockwise, -1 clockwise."""
    radius, step = (position_m - middle_m)[:-1], np.diff(position_m)
    most = max(float(np.abs(radius * step).sum()), 1e-9)
    return float((radius.conj() * step).imag.sum() / most)
