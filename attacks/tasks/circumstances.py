"""What is not the person, but the run: where, when, in which crowd and for how long one walks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from isac_track.types import Floats, Ints, Tracks

if TYPE_CHECKING:
    from attacks.tasks.sessions import Windows

COLUMNS: Final[Mapping[str, tuple[int, ...]]] = {
    "queue_place": (0, 1),
    "walking_direction": (2,),
    "run_density": (3,),
    "run_time": (4,),
    "walk_length": (5,),
}
"""Of `circumstances`, by control."""


def circumstances(tracks: Tracks, rows: Ints, windows: Windows) -> Floats:
    """Return what goes with each window beside its person, (N, 6).

    Of the tracks that they are cut from, `rows`, (N,): the place in the queue when the session
    begins, on a circle (cosine and sine of the rank by bearing from its middle); which way round
    that middle one walks, -1 to 1; how many people are there; when it is, s from the session's
    start; and how long the whole track lasts, s.
    """
    assert tracks.session is not None
    session = np.array(tracks.session)
    first, last = tracks.offsets[:-1], tracks.offsets[1:] - 1
    found = np.empty((rows.size, 6))
    for n, row in enumerate(rows.tolist()):
        of_run = np.flatnonzero(session == session[row])
        middle_m = tracks.xy[first[of_run[0]] : last[of_run[-1]] + 1].mean(axis=0)
        bearing = np.arctan2(*(tracks.xy[first[of_run]] - middle_m).T)
        turn = 2.0 * np.pi * float((bearing < bearing[of_run == row]).mean())
        t, walk = windows.t[slice(*windows.offsets[n : n + 2])], slice(first[row], last[row] + 1)
        x, y = (np.interp(t, tracks.t[walk], tracks.xy[walk, axis]) for axis in (0, 1))
        out, step = (x + 1j * y - complex(*middle_m))[:-1], np.diff(x + 1j * y)
        there = (tracks.t[first[of_run]] <= t.mean()) & (tracks.t[last[of_run]] >= t.mean())
        found[n] = (
            *(np.cos(turn), np.sin(turn)),
            (out.conj() * step).imag.sum() / max(float(np.abs(out * step).sum()), 1e-9),
            there.sum(),
            t.mean() - tracks.t[first[of_run]].min(),
            tracks.t[last[row]] - tracks.t[first[row]],
        )
    return found
