"""Circumstances of passages: properties of the session more than of the person.

The controls of `returns` compare them: whoever is linked by them is linked by the place
in the queue or the hour, not by the walk. The speed is partly of the person. As a
control it is held against the attack, which is conservative.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from attacks.tasks.queues import NOBODY, find_queue
from isac_track.types import Bools, Floats, Ints, Tracks, lengths, read_only

CIRCUMSTANCES: Final = (
    "queue place",
    "density",
    "speed",
    "length",
    "time of day",
    "neighbours",
)
"""Names of the circumstances: a control for each. Files of results use them.

The length is the logarithm of the duration. The time of day is the time in the session:
seconds since its first track.
"""


@dataclass(frozen=True, eq=False, slots=True)
class _Circumstances:
    """How each of T tracks was walked, apart from the person."""

    on_ring: Bools  # (T,) whether the queue of its session is a ring.
    place: Floats  # (T,) place in the queue of its session, 0 to 1
    ahead: Ints  # (T,) person in front in the queue, or `NOBODY`
    behind: Ints  # (T,) person behind in the queue, or `NOBODY`
    scalars: Mapping[str, Floats]  # (T,) by name: logarithms, and a time in s.


def compare_circumstances(
    tracks: Tracks, person: Ints, session: Ints, rows: Ints
) -> dict[str, Floats]:
    """Return the closeness of the tracks in `rows` by each circumstance, (N, N) each.

    `person` and `session`, (T,), number the people and sessions of all tracks.
    """
    walked = _measure_circumstances(tracks, person, session)
    ahead, behind = walked.ahead[rows], walked.behind[rows]
    same_ahead = (ahead[:, None] == ahead) & (ahead != NOBODY)
    same_behind = (behind[:, None] == behind) & (behind != NOBODY)
    closeness = {
        "queue place": -_places_apart(walked.place[rows], walked.on_ring[rows]),
        "neighbours": same_ahead.astype(float) + same_behind,
    }
    for name, values in walked.scalars.items():
        chosen = values[rows]
        scale = float(chosen.std()) or 1.0
        closeness[name] = -np.abs(chosen[:, None] - chosen) / scale
    return {name: read_only(closeness[name]) for name in CIRCUMSTANCES}


def _places_apart(place: Floats, on_ring: Bools) -> Floats:
    """Return how far places in queues are apart, (N, N), round the ring if on rings."""
    apart = np.abs(place[:, None] - place)
    both_on_ring = on_ring[:, None] & on_ring
    return np.where(both_on_ring, np.minimum(apart, 1.0 - apart), apart)


def _measure_circumstances(
    tracks: Tracks, person: Ints, session: Ints
) -> _Circumstances:
    """Measure the circumstances of all tracks, session by session."""
    n = len(tracks)
    on_ring, place = np.empty(n, dtype=bool), np.empty(n)
    ahead, behind = np.empty((2, n), dtype=np.int64)
    density, in_session_s = np.empty((2, n))
    begin_s = tracks.t[tracks.offsets[:-1]]
    end_s = tracks.t[tracks.offsets[1:] - 1]
    for number in np.unique(session):
        in_session = np.flatnonzero(session == number)
        queue = find_queue(tracks, in_session, person[in_session])
        on_ring[in_session], place[in_session] = queue.is_ring, queue.place
        ahead[in_session], behind[in_session] = queue.ahead, queue.behind
        in_session_s[in_session] = begin_s[in_session] - begin_s[in_session].min()
        density[in_session] = _density(begin_s[in_session], end_s[in_session])
    duration_s = end_s - begin_s
    scalars = {
        "density": np.log(density),
        "speed": np.log(np.maximum(_speeds(tracks, duration_s), 1e-3)),
        "length": np.log(np.maximum(duration_s, 1e-3)),
        "time of day": in_session_s,
    }
    return _Circumstances(on_ring, place, ahead, behind, scalars)


def _density(begin_s: Floats, end_s: Floats) -> Floats:
    """Return the mean number of tracks present during each, (N,), itself too.

    Two tracks of a person at the same time count twice.
    """
    shared_s = np.minimum(end_s[:, None], end_s) - np.maximum(begin_s[:, None], begin_s)
    duration_s = np.maximum(end_s - begin_s, 1e-9)
    return np.asarray(np.maximum(shared_s, 0.0).sum(axis=1) / duration_s)


def _speeds(tracks: Tracks, duration_s: Floats) -> Floats:
    """Return the mean speed of each track, (T,) m/s, along steps of a second."""
    speed = np.empty(len(tracks))
    for row in range(len(tracks)):
        part = _samples(tracks, row)
        direct_m = lengths(tracks.xy[part][-1] - tracks.xy[part][0])
        way_m = lengths(np.diff(_every_second(tracks, part), axis=0)).sum()
        speed[row] = max(direct_m, way_m) / max(duration_s[row], 1e-9)
    return speed


def _every_second(tracks: Tracks, part: slice) -> Floats:
    """Return the positions at every full second of a walk, (K, 2) m."""
    t = tracks.t[part]
    wanted = np.arange(t[0], t[-1] + 1e-9, 1.0)
    return np.column_stack(
        [np.interp(wanted, t, tracks.xy[part, axis]) for axis in (0, 1)]
    )


def _samples(tracks: Tracks, row: int) -> slice:
    """Return the samples of a track."""
    return slice(int(tracks.offsets[row]), int(tracks.offsets[row + 1]))
