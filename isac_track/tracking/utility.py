"""Conflicts that a robot foresees from tracks that break and swap.

A track says who it is about by its last sample: the person behind that detection. So a
warning counts for the person whom it rests on, not by coincidence.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from isac_track.patrols.forecasts import forecast_runs
from isac_track.patrols.patrol import Patrol
from isac_track.patrols.utility import NEVER, scans_left
from isac_track.protocols import Predictor
from isac_track.tracking.detections import CLUTTER
from isac_track.tracking.sharing import SharedTracks
from isac_track.types import Bools, Floats, Ints, Prediction, Release, squared_lengths


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


@dataclass(frozen=True, eq=False, slots=True)
class LiveTracks:
    """E pairs of a query and a track that is released then and goes on, by query."""

    query: Ints  # (E,)
    track: Ints  # (E,)
    sample: Ints  # (E,) last sample of the track up to the query.


@dataclass(frozen=True, eq=False, slots=True)
class TrackForecasts:
    """B forecasts that a robot has about tracks, and the truth about each track."""

    mean: Floats  # (B, H, 2) m
    query: Ints  # (B,)
    person: Ints  # (B,) row of the person behind the last sample, or `CLUTTER`.


def foresee_from_tracks(
    patrol: Patrol,
    shared: SharedTracks,
    *,
    predictor: Predictor,
    safety_radius_m: float,
    horizons: Sequence[int] = (),
) -> Foresight:
    """Return what robots foresee from the tracks that are alive at each query.

    A track is released from its confirmation on, with its earlier samples; otherwise as
    `foresee_from_forecasts`.
    """
    live = live_tracks(patrol, shared)
    forecasts: list[TrackForecasts] = []
    if live.query.size:
        mean = forecast_live_tracks(
            patrol, live, shared.release, predictor=predictor
        ).mean
        person = shared.person[live.sample]
        forecasts = [TrackForecasts(mean, live.query, person)] * patrol.n_robots
    return foresee_from_forecasts(
        patrol, forecasts, safety_radius_m=safety_radius_m, horizons=horizons
    )


def foresee_from_forecasts(
    patrol: Patrol,
    forecasts: Sequence[TrackForecasts],
    *,
    safety_radius_m: float,
    horizons: Sequence[int] = (),
) -> Foresight:
    """Return what robots foresee from their forecasts about tracks, one of each robot.

    Of several tracks about a person the first warning counts, and the least distance
    within each of the `horizons`, in scans.
    """
    n_pairs, n_queries = len(patrol.presences), patrol.query_scan.size
    near, far = (n_pairs, patrol.n_robots), (n_queries, patrol.n_robots)
    foresight = Foresight(
        foreseen=np.full(near, NEVER),
        ghost=np.full(far, NEVER),
        gaps_m={horizon: np.full(near, np.inf) for horizon in horizons},
        ghost_gaps_m={horizon: np.full(far, np.inf) for horizon in horizons},
    )
    for robot, own in enumerate(forecasts):
        _foresee(patrol, foresight, own, robot=robot, radius_m=safety_radius_m)
    return foresight


def _foresee(
    patrol: Patrol,
    foresight: Foresight,
    forecasts: TrackForecasts,
    *,
    robot: int,
    radius_m: float,
) -> None:
    """Write what a robot foresees from its forecasts."""
    query = forecasts.query
    presence = _presence_at(patrol, query, forecasts.person)
    is_ghost = presence < 0
    row = np.where(is_ghost, query, presence)
    stay = np.where(is_ghost, NEVER, scans_left(patrol)[presence])
    steps = np.arange(patrol.ahead_s.size)
    now = patrol.query_scan[query][:, None] + steps
    square = squared_lengths(forecasts.mean - patrol.robot_xy[robot, now])
    square[steps > stay[:, None]] = np.inf
    wait = _first_conflict(square, radius_m)
    np.minimum.at(foresight.foreseen[:, robot], row[~is_ghost], wait[~is_ghost])
    np.minimum.at(foresight.ghost[:, robot], row[is_ghost], wait[is_ghost])
    for horizon, near_m in foresight.gaps_m.items():
        gap_m = np.sqrt(square[:, : horizon + 1].min(axis=1))
        ghost_m = foresight.ghost_gaps_m[horizon]
        np.minimum.at(near_m[:, robot], row[~is_ghost], gap_m[~is_ghost])
        np.minimum.at(ghost_m[:, robot], row[is_ghost], gap_m[is_ghost])


def _first_conflict(square: Floats, radius_m: float) -> Ints:
    """Return the scans until a forecast comes inside the radius, (U,), or `NEVER`."""
    inside = square < radius_m**2
    return np.where(inside.any(axis=1), inside.argmax(axis=1), NEVER)


def live_tracks(patrol: Patrol, shared: SharedTracks) -> LiveTracks:
    """Return each query with each track that is released then and goes on."""
    now = patrol.query_scan[:, None]
    query, track = np.nonzero((shared.confirmed <= now) & (now <= shared.last))
    if not query.size:
        return LiveTracks(query, track, query)
    end = _samples_by(shared, track, patrol.query_scan[query])
    return LiveTracks(query, track, end - 1)


def forecast_live_tracks(
    patrol: Patrol, live: LiveTracks, release: Release, *, predictor: Predictor
) -> Prediction:
    """Return forecasts of live tracks from their whole histories, (E, H)."""
    now = patrol.query_scan[live.query][:, None] + np.arange(patrol.ahead_s.size)
    return forecast_runs(
        release,
        first=release.offsets[live.track],
        end=live.sample + 1,
        track=np.arange(live.track.size),
        t_future=patrol.scan_s[now],
        predictor=predictor,
    )


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
