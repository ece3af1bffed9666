"""Circumstances of windows: properties of the session in which a person walked.

The controls of `cross_session` compare them. They tell when and in which place of the
queue somebody walked, not who it is.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from attacks.tasks.queues import Queue, find_queue
from attacks.tasks.windows import Windows
from isac_track.types import Complexes, Floats, Ints, Tracks

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

    - 0, 1: the place in the queue, on a circle: cosine and sine. A ring fills the
      circle; a line fills half of it, so that its ends are farthest apart;
    - 2: the direction of walking round the session's middle, -1 to 1;
    - 3: the number of tracks present;
    - 4: the time in the session, s since its first track;
    - 5: the duration of the whole track, s.
    """
    assert tracks.session is not None
    assert tracks.person is not None
    session = np.array(tracks.session)
    person = np.unique(tracks.person, return_inverse=True)[1]
    first, last = tracks.offsets[:-1], tracks.offsets[1:] - 1
    angle = np.empty(len(tracks))
    for name in np.unique(session[rows]):
        in_session = np.flatnonzero(session == name)
        queue = find_queue(tracks, in_session, person[in_session])
        angle[in_session] = _queue_angles(queue)
    values = np.empty((rows.size, 6))
    for number, row in enumerate(rows.tolist()):
        in_session = np.flatnonzero(session == session[row])
        begin_s, end_s = tracks.t[first[in_session]], tracks.t[last[in_session]]
        samples = slice(first[in_session[0]], last[in_session[-1]] + 1)
        middle_m = tracks.xy[samples].mean(axis=0)
        t = windows.t[windows.offsets[number] : windows.offsets[number + 1]]
        walk = slice(first[row], last[row] + 1)
        x = np.interp(t, tracks.t[walk], tracks.xy[walk, 0])
        y = np.interp(t, tracks.t[walk], tracks.xy[walk, 1])
        values[number] = (
            np.cos(angle[row]),
            np.sin(angle[row]),
            _turning_direction(x + 1j * y, complex(*middle_m)),
            ((begin_s <= t.mean()) & (end_s >= t.mean())).sum(),
            t.mean() - begin_s.min(),
            tracks.t[last[row]] - tracks.t[first[row]],
        )
    return values


def _queue_angles(queue: Queue) -> Floats:
    """Return the places of tracks in a queue as angles, (N,), 0 to 2 pi or to pi."""
    whole = 2.0 * np.pi if queue.is_ring else np.pi
    return whole * queue.place


def _turning_direction(position_m: Complexes, middle_m: complex) -> float:
    """Return how far a way goes round a middle: 1 counterclockwise, -1 clockwise."""
    radius, step = (position_m - middle_m)[:-1], np.diff(position_m)
    most = max(float(np.abs(radius * step).sum()), 1e-9)
    return float((radius.conj() * step).imag.sum() / most)
