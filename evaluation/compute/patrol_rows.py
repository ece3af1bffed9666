"""Rows of the cells of patrols, per person and route or fleet, and back again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from attacks.following.logs import Following
from evaluation.compute.tables import ROWS
from isac_track.patrols.equal_alarms import AlarmCounts
from isac_track.patrols.estimators import ESTIMATORS
from isac_track.patrols.knowledge import Known
from isac_track.patrols.metrics import SHARES, UtilityCounts

if TYPE_CHECKING:
    from evaluation.compute.tables import Rows


_Array: TypeAlias = "np.ndarray[Any, np.dtype[Any]]"
CONFLICTS, ALARMS = "conflicts", "alarms"  # Further tables of a robot's cell.


def utility_tables(counts: UtilityCounts) -> dict[str, Rows]:
    """Return the tables of a robot: rows by person and route, (N R,), and its alarms.

    `utility_counts` reads them.
    """
    n_people, n_routes = counts.trials[SHARES[0]].shape
    rows = _person_route_columns(n_people, n_routes)
    for name in SHARES:
        rows[f"{name}_hits"] = counts.hits[name].astype(np.int32).ravel()
        rows[f"{name}_trials"] = counts.trials[name].astype(np.int32).ravel()
    # Those of a route, in the rows of all people.
    rows["false_alarms"] = np.tile(counts.false_alarms.astype(np.int32), n_people)
    rows["walked_s"] = np.full(n_people * n_routes, counts.walked_s)
    by_distance = counts.by_distance
    n_steps = len(by_distance.alarms)
    conflicts: Rows = {
        "track": by_distance.person,
        "route": by_distance.route.astype(np.int32),
        "step": by_distance.step.astype(np.int32),
    }
    alarms: Rows = {
        "route": np.repeat(np.arange(n_routes, dtype=np.int32), n_steps),
        "step": np.tile(np.arange(n_steps, dtype=np.int32), n_routes),
        "alarms": by_distance.alarms.T.astype(np.int32).ravel(),
        "allowed": np.repeat(counts.allowed.astype(np.int32), n_steps),
    }
    return {ROWS: rows, CONFLICTS: conflicts, ALARMS: alarms}


def utility_counts(tables: Mapping[str, Rows]) -> UtilityCounts:
    """Return the counts of the tables of `utility_tables`.

    The conflicts name the row of a person as `track`.
    """
    rows, conflicts, alarms = (tables[name] for name in (ROWS, CONFLICTS, ALARMS))
    n_routes = int(rows["route"].max()) + 1
    return UtilityCounts(
        hits={name: rows[f"{name}_hits"].reshape(-1, n_routes) for name in SHARES},
        trials={name: rows[f"{name}_trials"].reshape(-1, n_routes) for name in SHARES},
        false_alarms=rows["false_alarms"][:n_routes].astype(np.int64),
        walked_s=float(rows["walked_s"][0]),
        by_distance=AlarmCounts(
            alarms=alarms["alarms"].reshape(n_routes, -1).T,
            person=conflicts["track"],
            route=conflicts["route"],
            step=conflicts["step"],
        ),
        allowed=alarms["allowed"].reshape(n_routes, -1)[:, 0],
    )


_KNOWN_ROWS: Final = ("disclosed", "leaked", "seen")  # (N, F) of `Known`.
_KNOWN_PEOPLE: Final = ("instants", "known_by_map")  # (N,)
_KNOWN_ESTIMATORS: Final = ("known", "known_undisclosed")  # (K, N, F)


def known_rows(known: Known) -> Rows:
    """Return rows of knowledge by person and fleet, (N F,); see `known_from_rows`."""
    n_people, n_fleets = known.disclosed.shape
    rows = _person_route_columns(n_people, n_fleets)
    for name in _KNOWN_PEOPLE:
        rows[name] = np.repeat(getattr(known, name).astype(np.int32), n_fleets)
    for name in _KNOWN_ROWS:
        rows[name] = _as_int32(getattr(known, name)).ravel()
    for name in _KNOWN_ESTIMATORS:
        for estimator, counts in zip(ESTIMATORS, getattr(known, name), strict=True):
            rows[f"{name}_{estimator}"] = _as_int32(counts).ravel()
    return rows


def known_from_rows(rows: Rows) -> Known:
    """Return the knowledge of the rows of `known_rows`."""
    n_fleets = int(rows["route"].max()) + 1
    by_estimator = {
        name: np.stack(
            [
                rows[f"{name}_{estimator}"].reshape(-1, n_fleets)
                for estimator in ESTIMATORS
            ]
        )
        for name in _KNOWN_ESTIMATORS
    }
    return Known(
        **{name: rows[name].reshape(-1, n_fleets) for name in _KNOWN_ROWS},
        **{name: rows[name][::n_fleets] for name in _KNOWN_PEOPLE},
        **by_estimator,
    )


_FOLLOWED_ROWS: Final = ("ceiling_s", "followed_s", "until_s", "ending", "known")
_FOLLOWED_PEOPLE: Final = ("present_s", "instants")


def followed_rows(following: Following) -> Rows:
    """Return rows of being followed by person and fleet; see `followed_from_rows`."""
    n_people, n_fleets = following.followed_s.shape
    rows = _person_route_columns(n_people, n_fleets)
    for name in _FOLLOWED_PEOPLE:
        rows[name] = np.repeat(_as_int32(getattr(following, name)), n_fleets)
    for name in _FOLLOWED_ROWS:
        rows[name] = _as_int32(getattr(following, name)).ravel()
    return rows


def followed_from_rows(rows: Rows) -> Following:
    """Return what the rows of `followed_rows` say."""
    n_fleets = int(rows["route"].max()) + 1
    return Following(
        **{name: rows[name].reshape(-1, n_fleets) for name in _FOLLOWED_ROWS},
        **{name: rows[name][::n_fleets] for name in _FOLLOWED_PEOPLE},
    )


ROBOT_COLUMNS: Final = (
    "route",
    *(f"{name}_{part}" for name in SHARES for part in ("hits", "trials")),
    "false_alarms",
    "walked_s",
    "by_construction",
    "protects",
)
"""Columns of the cells of robots, beside source and group."""
CONFLICT_COLUMNS: Final = ("route", "step")
"""Columns of `CONFLICTS`: a row for each true future conflict."""
ALARM_COLUMNS: Final = ("route", "step", "alarms", "allowed")
"""Columns of `ALARMS`: a row for each route and alarm distance."""
KNOWN_COLUMNS: Final = (
    "route",
    *_KNOWN_PEOPLE,
    *_KNOWN_ROWS,
    *(f"{name}_{estimator}" for name in _KNOWN_ESTIMATORS for estimator in ESTIMATORS),
)
"""Columns of the cells of logs with true identities, beside source and group."""
FOLLOWED_COLUMNS: Final = ("route", *_FOLLOWED_PEOPLE, *_FOLLOWED_ROWS)
"""Columns of the cells of people followed through logs, beside source and group."""


def _person_route_columns(n_people: int, n_routes: int) -> Rows:
    """Return the columns that identify a person and a route, or a fleet."""
    return {
        "track": np.repeat(np.arange(n_people), n_routes),
        "route": np.tile(np.arange(n_routes, dtype=np.int32), n_people),
    }


def _as_int32(values: _Array) -> _Array:
    """Return whole numbers in four bytes, and all others as they are."""
    return values.astype(np.int32) if values.dtype.kind == "i" else values
