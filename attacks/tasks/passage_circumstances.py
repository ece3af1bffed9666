"""Circumstances of passages: properties of the session, and not of the person.

The controls of `returns` compare them: whoever is linked by them is linked by the place
in the queue or the hour, not by the walk.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from isac_track.types import Floats, Ints, Tracks, lengths, read_only

CIRCUMSTANCES: Final = (
    "queue place",
    "density",
    "speed",
    "length",
    "time of day",
    "neighbours",
)
"""Names of the circumstances: a control for each."""
_TOGETHER_S = 1.0  # Starts within it are simultaneous: the queue is on a ring.


@dataclass(frozen=True, eq=False, slots=True)
class _Circumstances:
    """How each of T tracks was walked, apart from the person."""

    place: Floats  # (T,) place in the queue of its session, 0 to 1
    ahead: Ints  # (T,) person in front in the queue, or -1
    behind: Ints  # (T,) person behind in the queue, or -1
    scalars: Mapping[str, Floats]  # (T,) by name: logarithms, and a time in s.


def compare_circumstances(
    tracks: Tracks, person: Ints, session: Ints, rows: Ints
) -> dict[str, Floats]:
    """Return the closeness of the tracks in `rows` by each circumstance, (N, N) each.

    `person` and `session`, (T,), number the people and sessions of all tracks.
    """
    walked = _measure_circumstances(tracks, person, session)
    place, ahead, behind = walked.place[rows], walked.ahead[rows], walked.behind[rows]
    apart = np.abs(place[:, None] - place)
    same_ahead = (ahead[:, None] == ahead) & (ahead >= 0)
    same_behind = (behind[:, None] == behind) & (behind >= 0)
    closeness = {
        "queue place": -np.minimum(apart, 1.0 - apart),
        "neighbours": same_ahead.astype(float) + same_behind,
    }
    for name, values in walked.scalars.items():
        chosen = values[rows]
        scale = float(chosen.std()) or 1.0
        closeness[name] = -np.abs(chosen[:, None] - chosen) / scale
    return {name: read_only(closeness[name]) for name in CIRCUMSTANCES}


def _measure_circumstances(
    tracks: Tracks, person: Ints, session: Ints
) -> _Circumstances:
    """Measure the circumstances of all tracks, session by session."""
    n = len(tracks)
    place, ahead, behind = np.empty(n), np.empty(n, np.int64), np.empty(n, np.int64)
    density, time_s = np.empty((2, n))
    begin_s = tracks.t[tracks.offsets[:-1]]
    end_s = tracks.t[tracks.offsets[1:] - 1]
    for number in np.unique(session):
        here = np.flatnonzero(session == number)
        order = here[_queue_order(tracks, here)]
        ahead[order] = np.append(-1, person[order[:-1]])
        behind[order] = np.append(person[order[1:]], -1)
        place[here] = _queue_places(person[order])[person[here]]
        time_s[here] = begin_s[here] - begin_s[here].min()
        density[here] = _density(begin_s[here], end_s[here])
    lasts_s = end_s - begin_s
    scalars = {
        "density": np.log(density),
        "speed": np.log(np.maximum(_speeds(tracks, lasts_s), 1e-3)),
        "length": np.log(np.maximum(lasts_s, 1e-3)),
        "time of day": time_s,
    }
    return _Circumstances(place, ahead, behind, scalars)


def _queue_order(tracks: Tracks, here: Ints) -> Ints:
    """Return the order of a session's tracks in the queue; `here` are their rows.

    It is that of entry. Where most people are there from the start, on a ring, it is
    that of their bearing from the middle of the session.
    """
    first = tracks.offsets[:-1][here]
    begin_s = tracks.t[first]
    if (begin_s <= begin_s.min() + _TOGETHER_S).mean() > 0.5:  # noqa: PLR2004 - most
        samples = [_samples(tracks, row) for row in here.tolist()]
        middle_m = np.concatenate([tracks.xy[part] for part in samples]).mean(axis=0)
        bearing = tracks.xy[first] - middle_m
        return np.argsort(np.arctan2(bearing[:, 1], bearing[:, 0]), kind="stable")
    return np.argsort(begin_s, kind="stable")


def _queue_places(queue: Ints) -> Floats:
    """Return the place in a queue by person, 0 to 1: that of the first track.

    `queue` has the person of each of a session's tracks, in order. People who are not
    in it have no place: their value is arbitrary.
    """
    firsts = np.unique(queue, return_index=True)[1]
    place = np.empty(queue.max() + 1)
    place[queue[np.sort(firsts)]] = np.arange(firsts.size) / firsts.size
    return place


def _density(begin_s: Floats, end_s: Floats) -> Floats:
    """Return the mean number of people present during each track, (N,), itself too."""
    shared_s = np.minimum(end_s[:, None], end_s) - np.maximum(begin_s[:, None], begin_s)
    lasts_s = np.maximum(end_s - begin_s, 1e-9)
    return np.asarray(np.maximum(shared_s, 0.0).sum(axis=1) / lasts_s)


def _speeds(tracks: Tracks, lasts_s: Floats) -> Floats:
    """Return the mean speed of each track, (T,) m/s, along steps of a second."""
    speed = np.empty(len(tracks))
    for row in range(len(tracks)):
        part = _samples(tracks, row)
        direct_m = lengths(tracks.xy[part][-1] - tracks.xy[part][0])
        way_m = lengths(np.diff(_every_second(tracks, part), axis=0)).sum()
        speed[row] = max(direct_m, way_m) / max(lasts_s[row], 1e-9)
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
