"""Conflicts that a robot foresees from tracks that break and swap.

A track says who it is about by its last sample: the person behind that detection. So a
warning counts for the person whom it rests on, not by coincidence.
"""

from dataclasses import dataclass

import numpy as np

from isac_track.patrols.answers import forecast_runs
from isac_track.patrols.patrol import Patrol
from isac_track.patrols.utility import NEVER, scans_left
from isac_track.protocols import Predictor
from isac_track.tracking.detections import CLUTTER
from isac_track.tracking.sharing import SharedTracks
from isac_track.types import Bools, Floats, Ints, squared_lengths


@dataclass(frozen=True, eq=False, slots=True)
class Foresight:
    """What R robots foresee from tracks at Q queries."""

    foreseen: Ints  # (E, R) scans until a conflict with the person, or `NEVER`.
    ghost: Ints  # (Q, R) the same with a track of nobody present, or `NEVER`.

    def alarms(self, patrol: Patrol, *, horizon: int) -> Bools:
        """Return the queries at which a robot foresees any conflict, (Q, R)."""
        alarm = self.ghost <= horizon
        np.logical_or.at(alarm, patrol.presences.query, self.foreseen <= horizon)
        return alarm


def foresee_from_tracks(
    patrol: Patrol,
    shared: SharedTracks,
    *,
    predictor: Predictor,
    safety_radius_m: float,
) -> Foresight:
    """Return what robots foresee from the tracks that are alive at each query.

    A track is released from its confirmation on, with its earlier samples. Of several
    tracks about a person the first warning counts.
    """
    n_pairs, n_queries = len(patrol.presences), patrol.query_scan.size
    foreseen = np.full((n_pairs, patrol.n_robots), NEVER)
    ghost = np.full((n_queries, patrol.n_robots), NEVER)
    query, track = _live_tracks(patrol, shared)
    if not query.size:
        return Foresight(foreseen, ghost)
    first = shared.release.offsets[track]
    end = _samples_by(shared, track, patrol.query_scan[query])
    now = patrol.query_scan[query][:, None] + np.arange(patrol.ahead_s.size)
    mean = forecast_runs(
        shared.release,
        first=first,
        end=end,
        track=np.arange(track.size),
        t_future=patrol.scan_s[now],
        predictor=predictor,
    ).mean
    presence = _presence_at(patrol, query, shared.person[end - 1])
    is_ghost = presence < 0
    stay = np.where(is_ghost, NEVER, scans_left(patrol)[presence])
    for robot in range(patrol.n_robots):
        wait = _first_conflict(mean, patrol.robot_xy[robot, now], safety_radius_m)
        wait = np.where(wait <= stay, wait, NEVER)
        np.minimum.at(foreseen[:, robot], presence[~is_ghost], wait[~is_ghost])
        np.minimum.at(ghost[:, robot], query[is_ghost], wait[is_ghost])
    return Foresight(foreseen, ghost)


def _first_conflict(mean: Floats, route: Floats, radius_m: float) -> Ints:
    """Return the scans until a forecast comes inside the radius, (U,), or `NEVER`."""
    inside = squared_lengths(mean - route) < radius_m**2
    return np.where(inside.any(axis=1), inside.argmax(axis=1), NEVER)


def _live_tracks(patrol: Patrol, shared: SharedTracks) -> tuple[Ints, Ints]:
    """Return each query with each track that is released then and goes on, (U,)."""
    now = patrol.query_scan[:, None]
    query, track = np.nonzero((shared.confirmed <= now) & (now <= shared.last))
    return query, track


def _samples_by(shared: SharedTracks, track: Ints, scan: Ints) -> Ints:
    """Return the end of the samples of tracks up to a scan each, (U,)."""
    sizes = np.diff(shared.release.offsets)
    n_scans = int(max(shared.scan.max(), scan.max())) + 1
    key = np.repeat(np.arange(sizes.size), sizes) * n_scans + shared.scan
    return np.searchsorted(key, track * n_scans + scan, side="right")


def _presence_at(patrol: Patrol, query: Ints, person: Ints) -> Ints:
    """Return the presence of a person at a query each, (U,), or -1 if there is none."""
    pairs = patrol.presences
    table = np.full((patrol.query_scan.size, len(patrol.people) + 1), CLUTTER)
    table[pairs.query, pairs.person] = np.arange(len(pairs))
    return np.asarray(table[query, person])  # Clutter reads the empty last column.
