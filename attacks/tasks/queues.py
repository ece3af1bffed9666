"""Queues of sessions: the order of their people, and whether it closes to a ring.

On a ring the last is directly in front of the first; past a line they are farthest
apart.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from isac_track.types import Bools, Floats, Ints, Tracks, end_to_end, sample_runs

NOBODY: Final = -1
"""Stands for a neighbour who is not there, or not recorded."""
_TOGETHER_S = 1.0  # Starts within it are simultaneous.


@dataclass(frozen=True, eq=False, slots=True)
class Queue:
    """The queue of a session with N tracks.

    Attributes
    ----------
    is_ring : bool
        Whether the last person is followed by the first.
    place : Floats
        Place of each track's person in the queue, (N,), 0 to 1: that of the person's
        first track.
    ahead, behind : Ints
        Person of the track in front of each track and behind it, (N,), or `NOBODY`.
    """

    is_ring: bool
    place: Floats
    ahead: Ints
    behind: Ints


def find_queue(tracks: Tracks, rows: Ints, person: Ints) -> Queue:
    """Return the queue of the tracks of a session.

    `rows`, (N,), are these tracks, and `person`, (N,), are numbers of their people.

    Where most tracks are there from the start, people walk on a ring that is in view.
    They are in the order of bearing from the middle of the session. All others are in
    the order of entry. If most people pass again after most others, they come round on
    a ring of which a part is in view. Before the first and after the last entry nobody
    is recorded, so that the neighbour is not known there.
    """
    begin_s = tracks.t[tracks.offsets[:-1][rows]]
    all_in_view = bool(_is_most(begin_s <= begin_s.min() + _TOGETHER_S))
    order = np.argsort(
        _bearings(tracks, rows) if all_in_view else begin_s, kind="stable"
    )
    queue = person[order]
    ahead, behind = np.roll(queue, 1), np.roll(queue, -1)
    if not all_in_view:
        ahead[0] = behind[-1] = NOBODY
    back = np.argsort(order)
    return Queue(
        is_ring=all_in_view or _comes_round(queue),
        place=_places(queue)[back],
        ahead=_others(ahead, queue)[back],
        behind=_others(behind, queue)[back],
    )


def _bearings(tracks: Tracks, rows: Ints) -> Floats:
    """Return the compass bearing of each track's start from the middle of all, (N,)."""
    runs, _ = sample_runs(tracks.offsets, rows)
    middle_m = end_to_end(tracks.xy, runs).mean(axis=0)
    x_m, y_m = (tracks.xy[tracks.offsets[:-1][rows]] - middle_m).T
    return np.asarray(np.arctan2(x_m, y_m))


def _comes_round(queue: Ints) -> bool:
    """Return whether most people pass again after most others have passed.

    `queue`, (N,), has the person of each track, in order. Tracks of a person that
    follow sooner are parts of a walk.
    """
    passes = [np.flatnonzero(queue == person) for person in np.unique(queue)]
    again = [rows.size > 1 and rows[1] - rows[0] > len(passes) / 2.0 for rows in passes]
    return _is_most(np.array(again))


def _is_most(values: Bools) -> bool:
    """Return whether more than half of the values are true."""
    return bool(values.mean() > 0.5)  # noqa: PLR2004 - most


def _places(queue: Ints) -> Floats:
    """Return the place of each track's person, (N,): that of the person's first track.

    `queue`, (N,), has the person of each track, in order.
    """
    _, first, number = np.unique(queue, return_index=True, return_inverse=True)
    return np.asarray(np.argsort(np.argsort(first))[number] / first.size)


def _others(neighbour: Ints, queue: Ints) -> Ints:
    """Return the neighbours, (N,), without people who follow themselves."""
    return np.where(neighbour == queue, NOBODY, neighbour)
