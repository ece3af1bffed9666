"""Patrols: robots walk through a whole recording and ask where people are.

All people are present at their true times and places, in long tracks and short. All
share a scan clock; every `query_s` each robot asks. People do not give way to robots.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from isac_track.config import PatrolSettings, StageSettings
from isac_track.errors import DataError, SettingsError
from isac_track.patrols.routes import draw_waypoints, places_along, walked_cells
from isac_track.policies.samples import HORIZON_S
from isac_track.resample import Walk, walk
from isac_track.rng import stream
from isac_track.sensing import draw_walk_channel, recorded_walk, sense, walked_within
from isac_track.types import Floats, Ints, Sensed, Tracks, stretches

_ROUNDING: Final = 1e-6  # Rounding of a recorded instant, in steps of a clock.


@dataclass(frozen=True, eq=False, slots=True)
class Presences:
    """E pairs of a query and a person who is present then, in the order of queries."""

    query: Ints  # (E,) number of the query.
    person: Ints  # (E,) row of the person's track.
    sample: Ints  # (E,) the person's sample at the instant of the query.

    def __len__(self) -> int:
        """Return the number of pairs."""
        return self.query.size


@dataclass(frozen=True, eq=False, slots=True)
class Patrol:
    """N people with M samples on one clock of K scans, and R robots that ask Q times.

    The robots of a fleet have the numbers from ``fleet * robots_per_fleet`` on. The
    scans continue after the last sample to the end of the longest forecast.
    """

    people: Tracks  # The truth at the scans.
    scan: Ints  # (M,) number of the scan of each sample.
    scan_s: Floats  # (K,) s, times of the scans.
    grid: Tracks  # The truth of the same people on the grid of instants.
    robot_xy: Floats  # (R, K, 2) m, places of the robots at the scans.
    query_scan: Ints  # (Q,) scans at which the robots ask.
    query_s: float  # Time between two queries.
    # (H,) s, instants of a forecast after now, one a scan; the first is 0.
    ahead_s: Floats
    presences: Presences
    robots_per_fleet: int
    # Recorded people who are left out: of a single sample, or present at no scan, or at
    # no instant of the grid.
    n_left_out: int

    @property
    def n_robots(self) -> int:
        """Number of robots."""
        return len(self.robot_xy)

    @property
    def n_fleets(self) -> int:
        """Number of fleets."""
        return self.n_robots // self.robots_per_fleet

    @property
    def duration_s(self) -> float:
        """Time that a robot walks and asks, s."""
        return self.query_s * self.query_scan.size

    def t_ahead(self, presence: Ints) -> Floats:
        """Return the instants of the forecasts of some presences, (..., H) s."""
        now = self.query_scan[self.presences.query[presence]]
        return np.asarray(self.scan_s[now[:, None] + np.arange(self.ahead_s.size)])

    def robot_ahead(self, robot: int, presence: Ints) -> Floats:
        """Return the places of a robot at the instants of `t_ahead`, (..., H, 2) m."""
        now = self.query_scan[self.presences.query[presence]]
        return np.asarray(
            self.robot_xy[robot, now[:, None] + np.arange(self.ahead_s.size)]
        )


def horizon_scans(settings: StageSettings) -> tuple[int, ...]:
    """Return the horizons of conflicts in scans: the paper's, then all further.

    The paper counts steps of its history, here scans: 11 last 0.92 s at the usual
    `patrol.scan_s`, and longer with longer scans. Further horizons are in seconds.
    """
    further_s = settings.conflict.horizons_s
    scan_s = settings.patrol.scan_s
    steps = (
        settings.conflict.horizon_steps - 1,
        *(round(s / scan_s) for s in further_s),
    )
    return tuple(max(1, step) for step in steps)


def forecast_instants(settings: StageSettings) -> Floats:
    """Return the instants of a forecast after now, (H,) s, one a scan from 0 on.

    They reach a query interval beyond the farthest horizon of conflicts, and beyond the
    usual horizon of policies: these must work in a run without further horizons.
    """
    usual_scans = round(HORIZON_S / settings.patrol.scan_s)
    farthest = max(usual_scans, *horizon_scans(settings))
    n_ahead = 1 + farthest + scans_per_query(settings.patrol)
    return settings.patrol.scan_s * np.arange(float(n_ahead))


def make_patrol(recorded: Tracks, *, settings: StageSettings, seed: int) -> Patrol:
    """Return the patrol through a recording.

    `recorded` are placed tracks (`isac_track.place.placed`). Each robot draws its route
    from a random stream of its own. DataError if nobody is present at a scan, or at a
    query, and SettingsError without a fleet or a segment.
    """
    rules = settings.patrol
    if not rules.fleets:
        raise SettingsError("patrol.fleets is 0: name the number of fleets")
    if not rules.segment_s:
        raise SettingsError("patrol.segment_s is 0: name the length of the segment")
    start_s = float(recorded.t.min())
    end_s = min(float(recorded.t.max()), start_s + rules.segment_s)
    walks = _present_walks(recorded, settings=settings, start_s=start_s, end_s=end_s)
    people = _on_clock(
        recorded, walks, start_s=start_s, end_s=end_s, step_s=rules.scan_s
    )
    grid = _on_clock(recorded, walks, start_s=start_s, end_s=end_s, step_s=rules.grid_s)
    scan = np.rint((people.t - start_s) / rules.scan_s).astype(np.int64)
    n_scans = int(scan.max()) + 1
    ahead_s = forecast_instants(settings)
    query_scan = _find_query_scans(n_scans, rules)
    clock_s = start_s + rules.scan_s * np.arange(float(n_scans + ahead_s.size))
    return Patrol(
        people=people,
        scan=scan,
        scan_s=clock_s,
        grid=grid,
        robot_xy=_walk_robots(
            people.xy, clock_s - start_s, settings=settings, seed=seed
        ),
        query_scan=query_scan,
        query_s=rules.query_s,
        ahead_s=ahead_s,
        presences=_find_presences(scan, people.offsets, query_scan),
        robots_per_fleet=rules.robots,
        n_left_out=len(recorded) - len(people),
    )


def scans_per_query(rules: PatrolSettings) -> int:
    """Return the largest number of scans between two queries."""
    return int(np.ceil(rules.query_s / rules.scan_s - _ROUNDING))


def sense_people(patrol: Patrol, *, settings: StageSettings, seed: int) -> Sensed:
    """Sense all people: one error for each person and sample.

    The lasting part of a link belongs to the recorded walk; beam and error are drawn
    for the patrol.
    """
    return _sense_tracks(patrol.people, "patrol", settings=settings, seed=seed)


def sense_again(
    patrol: Patrol, number: int, *, settings: StageSettings, seed: int
) -> Sensed:
    """Sense all history of the people present at a query, with errors of its own.

    The people are in the order of the query's presences; there is at least one.
    """
    people, pairs = patrol.people, patrol.presences
    rows = slice(*np.searchsorted(pairs.query, [number, number + 1]))
    person = pairs.person[rows]
    first = people.offsets[person]
    sample, offsets = stretches(first, pairs.sample[rows] + 1 - first)
    history = Tracks(
        t=people.t[sample],
        xy=people.xy[sample],
        offsets=offsets,
        source=tuple(people.source[row] for row in person.tolist()),
        group=tuple(people.group[row] for row in person.tolist()),
    )
    return _sense_tracks(
        history, "patrol", "query", number, settings=settings, seed=seed
    )


def _sense_tracks(
    people: Tracks, *names: str | int, settings: StageSettings, seed: int
) -> Sensed:
    """Sense walks; `names` and the recorded walk name the streams of errors."""
    channel = draw_walk_channel(
        walked_m=walked_within(people.xy, people.offsets),
        offsets=people.offsets,
        walks=[recorded_walk(source) for source in people.source],
        keys=[(*names, source) for source in people.source],
        settings=settings.sensing,
        seed=seed,
    )
    return sense(
        t=people.t,
        xy=people.xy,
        offsets=people.offsets,
        channel=channel,
        settings=settings.sensing,
    )


def _instants(track: Tracks, *, start_s: float, end_s: float, step_s: float) -> Ints:
    """Return the ticks of a clock at which a recorded person is present, (K,)."""
    first_s, last_s = max(float(track.t[0]), start_s), min(float(track.t[-1]), end_s)
    first = int(np.ceil((first_s - start_s) / step_s - _ROUNDING))
    last = int(np.floor((last_s - start_s) / step_s + _ROUNDING))
    return np.arange(first, last + 1)


def _present_walks(
    recorded: Tracks, *, settings: StageSettings, start_s: float, end_s: float
) -> dict[int, Walk]:
    """Return the continuous walks of people present on both clocks, by row.

    A person of a single sample has no walk. DataError if nobody is present.
    """
    rules = settings.patrol
    walks: dict[int, Walk] = {}
    for row, track in enumerate(recorded):
        present = [
            _instants(track, start_s=start_s, end_s=end_s, step_s=step_s).size > 0
            for step_s in (rules.scan_s, rules.grid_s)
        ]
        if track.t.size > 1 and all(present):
            overshoot_m = settings.resample.max_overshoot_m
            walks[row] = walk(track, max_overshoot_m=overshoot_m)
    if not walks:
        raise DataError(
            f"nobody of {len(recorded)} people has two samples and is present at a"
            f" scan, every {rules.scan_s:g} s, and at an instant, every"
            f" {rules.grid_s:g} s; record longer, or set patrol.scan_s or"
            " patrol.grid_s lower"
        )
    return walks


def _on_clock(
    recorded: Tracks,
    walks: dict[int, Walk],
    *,
    start_s: float,
    end_s: float,
    step_s: float,
) -> Tracks:
    """Return the walks at the ticks of a clock."""
    times, places = [], []
    for row, continuous in walks.items():
        track = recorded[row]
        ticks = _instants(track, start_s=start_s, end_s=end_s, step_s=step_s)
        t = start_s + step_s * ticks
        times.append(t)
        places.append(continuous(np.clip(t, track.t[0], track.t[-1])))
    return Tracks(
        t=np.concatenate(times),
        xy=np.concatenate(places),
        offsets=np.cumsum([0, *map(len, times)]),
        source=tuple(recorded.source[row] for row in walks),
        group=tuple(recorded.group[row] for row in walks),
    )


def _find_query_scans(n_scans: int, rules: PatrolSettings) -> Ints:
    """Return the scans of the queries: the last scan at or before each query's time."""
    n_queries = int((n_scans - 1) * rules.scan_s / rules.query_s + _ROUNDING) + 1
    asked_s = rules.query_s * np.arange(float(n_queries))
    scan: Ints = np.floor(asked_s / rules.scan_s + _ROUNDING).astype(np.int64)
    return scan


def _find_presences(scan: Ints, offsets: Ints, query_scan: Ints) -> Presences:
    """Return the pairs of a query and a present person, in the order of queries."""
    number = np.full(int(scan.max()) + 1, -1)
    number[query_scan] = np.arange(query_scan.size)
    sample = np.flatnonzero(number[scan] >= 0)
    sample = sample[np.argsort(number[scan[sample]], kind="stable")]
    if not sample.size:
        raise DataError("nobody is present when a robot asks; set patrol.query_s lower")
    person = np.searchsorted(offsets, sample, side="right") - 1
    return Presences(query=number[scan[sample]], person=person, sample=sample)


def _walk_robots(
    people_xy: Floats, elapsed_s: Floats, *, settings: StageSettings, seed: int
) -> Floats:
    """Return the places of all robots at times since the start, (R, K, 2) m."""
    rules, speed_mps = settings.patrol, settings.conflict.robot_speed_mps
    cells, distance_m = walked_cells(people_xy), speed_mps * elapsed_s
    routes = []
    for fleet in range(rules.fleets):
        for robot in range(rules.robots):
            rng = stream(seed, "patrols", "route", fleet, robot)
            waypoints = draw_waypoints(cells, length_m=float(distance_m[-1]), rng=rng)
            routes.append(places_along(waypoints, distance_m))
    return np.stack(routes)
