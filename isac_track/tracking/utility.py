"""Conflicts that a robot foresees from tracks that break and swap.

A track says who it is about by its last sample: the person behind that detection. So a
warning counts for the person whom it rests on, not by coincidence.
"""

from collections.abc import Mapping, Sequence
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
    """What R robots foresee from tracks at Q queries.

    `gaps_m` and `ghost_gaps_m` have the least forecast distance within each horizon, in
    scans, up to leaving; infinite without a track.
    """

    foreseen: Ints  # (E, R) scans until a conflict with the person, or `NEVER`.
    ghost: Ints  # (Q, R) the same with a track of nobody present, or `NEVER`.
    gaps_m: Mapping[int, Floats]  # (E, R) from the person.
    ghost_gaps_m: Mapping[int, Floats]  # (Q, R) from a track of nobody present.

    def alarms(self, patrol: Patrol, *, horizon: int) -> Bools:
        """Return the queries at which a robot foresees any conflict, (Q, R)."""
        alarm = self.ghost <= horizon
        np.logical_or.at(alarm, patrol.presences.query, self.foreseen <= horizon)
        return alarm

    def nearest_m(self, patrol: Patrol, *, horizon: int) -> Floats:
        """Return the least forecast distance from anybody at each query, (Q, R)."""
        nearest_m = self.ghost_gaps_m[horizon].copy()
        np.minimum.at(nearest_m, patrol.presences.query, self.gaps_m[horizon])
        return nearest_m


def foresee_from_tracks(
    patrol: Patrol,
    shared: SharedTracks,
    *,
    predictor: Predictor,
    safety_radius_m: float,
    horizons: Sequence[int] = (),
) -> Foresight:
    """Return what robots foresee from the tracks that are alive at each query.

    A track is released from its confirmation on, with its earlier samples. Of several
    tracks about a person the first warning counts, and the least distance within each
    of the `horizons`, in scans.
    """
    n_pairs, n_queries = len(patrol.presences), patrol.query_scan.size
    near, far = (n_pairs, patrol.n_robots), (n_queries, patrol.n_robots)
    foresight = Foresight(
        foreseen=np.full(near, NEVER),
        ghost=np.full(far, NEVER),
        gaps_m={horizon: np.full(near, np.inf) for horizon in horizons},
        ghost_gaps_m={horizon: np.full(far, np.inf) for horizon in horizons},
    )
    query, track = _live_tracks(patrol, shared)
    if not query.size:
        return foresight
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
    row = np.where(is_ghost, query, presence)
    stay = np.where(is_ghost, NEVER, scans_left(patrol)[presence])
    after_leaving = np.arange(patrol.ahead_s.size) > stay[:, None]
    for robot in range(patrol.n_robots):
        square = squared_lengths(mean - patrol.robot_xy[robot, now])
        square[after_leaving] = np.inf
        wait = _first_conflict(square, safety_radius_m)
        np.minimum.at(foresight.foreseen[:, robot], row[~is_ghost], wait[~is_ghost])
        np.minimum.at(foresight.ghost[:, robot], row[is_ghost], wait[is_ghost])
        for horizon in horizons:
            gap_m = np.sqrt(square[:, : horizon + 1].min(axis=1))
            near_m, ghost_m = foresight.gaps_m[horizon], foresight.ghost_gaps_m[horizon]
            np.minimum.at(near_m[:, robot], row[~is_ghost], gap_m[~is_ghost])
            np.minimum.at(ghost_m[:, robot], row[is_ghost], gap_m[is_ghost])
    return foresight


def _first_conflict(square: Floats, radius_m: float) -> Ints:
    """Return the scans until a forecast comes inside the radius, (U,), or `NEVER`."""
    inside = square < radius_m**2
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
