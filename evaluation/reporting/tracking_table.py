"""Tracks of a network's detections: the table, and the sentence of the first screen."""

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from evaluation.estimates.families import RAW
from evaluation.estimates.keys import row_dicts
from evaluation.estimates.metrics import (
    DISCLOSED,
    FUTURE_EQUAL_ALARMS,
    KNOWN_SHARE,
    METRICS,
    MISSED_FUTURE,
)
from evaluation.plan.address import parse_dataset, parse_policy
from evaluation.plan.constants import SHARED
from evaluation.plan.consumer import LOG, ORACLE_TRACKER, TRACKER
from evaluation.reporting import table as make
from evaluation.reporting.amounts import whole_percent
from evaluation.reporting.names import robot_name, robot_subject
from evaluation.reporting.patrol_words import ahead_text, shared_name
from evaluation.reporting.rows import Results
from evaluation.reporting.table import Cell, Table, plugin_label
from isac_track.types import Bools

_TRACKS: Final = (
    (LOG, KNOWN_SHARE),
    (SHARED, DISCLOSED),
    *((TRACKER, name) for name in ("purity", "id_switches", "fragments", "gospa")),
    *((LOG, name) for name in ("followed_s", "rejoined_share", "time_to_confusion_s")),
)
"""Columns about tracks: consumer and metric, the headline first."""
_ROBOT: Final = (
    MISSED_FUTURE,
    FUTURE_EQUAL_ALARMS,
    "missed_encounter_rate",
    "false_alarms_per_min",
)
_FEW: Final = (
    "No intervals: they take 15 blocks of equal size. Longer patrols"
    " (--set patrol.segment_s=inf) or --set tracking.block_s=5 give more."
)


def tracking_table(run: Results) -> Table:
    """Return what trackers make of detections; without rows in a run without tracks.

    It has a row for each release and mechanism. The robot is that which misses least,
    at the farthest horizon.
    """
    rows = run.tracks
    robot, horizon_s = _best_robot(rows), _farthest_s(rows)
    cells: dict[tuple[str, str], dict[str, Cell]] = {}
    for row in row_dicts(rows):
        title = _title(row, robot, horizon_s=horizon_s)
        if title:
            key = row["policy"], _shared(run, row)
            cells.setdefault(key, {})[title] = make.metric_cell(
                row["metric"], row["value"], row["ci_low"], row["ci_high"]
            )
    is_answered = bool(_are_answered(rows).any())
    about_tracks = [name for _, name in _TRACKS if is_answered or name != DISCLOSED]
    shown = [*about_tracks, *(_ROBOT if robot else ())]
    return make.build_table(
        "tracking",
        "Tracks of a network that associates detections by itself",
        [
            {"release": release, "mechanism": mechanism} | own
            for (release, mechanism), own in cells.items()
        ],
        [
            make.text_column("release"),
            make.text_column("mechanism"),
            *(
                make.cell_column(METRICS[name].head, unit=METRICS[name].unit)
                for name in shown
            ),
        ],
        notes=_notes(run, rows, robot, horizon_s) if len(rows) else [],
        n_keys=2,
    )


def _notes(
    run: Results, rows: pd.DataFrame, robot: str, horizon_s: float | None
) -> list[str]:
    stages = run.manifest["settings"]["stages"]
    sensing = (
        f"Detection probability {stages['tracking.detection_probability']},"
        f" {stages['tracking.clutter_per_scan']:g} points of clutter a scan. Intervals"
        f" draw blocks of {stages['tracking.block_s']:g} s and"
        f" {stages['tracking.seeds']} seeds of sensing: they are conditional on this"
        " recording."
    )
    readers = (
        f"Known: stated within {stages['privacy.epsilon_m']:g} m, of all person-time, by"
        " an adversary that knows to whom each track belongs. Followed: by an attack"
        " that joins tracks by predicted places; rejoined: breaks of a track that it mends."
    )
    notes = [sensing, readers]
    if robot:
        notes.append(
            f"The robot is {robot_name(robot)}, which misses least with perfect"
            f" association; future conflicts{ahead_text(horizon_s)}. Equal false alarms"
            " are its own with raw tracks of the oracle. Other robots: summary.csv."
        )
    return notes if rows["ci_low"].notna().any() else [*notes, _FEW]


def tracking_sentence(run: Results) -> str:
    """Return what the run's tracker costs and reveals; empty without tracks.

    It compares raw tracks of the tracker with those of perfect association.
    """
    rows = run.tracks
    rows = rows[(rows["mechanism"] == RAW) & ~_are_answered(rows)]
    releases = [name for name in rows["policy"].unique() if not _is_perfect(name)]
    robot, horizon_s = _best_robot(rows), _farthest_s(rows)
    if not releases or not robot:
        return ""
    release = releases[-1]
    oracle = next(name for name in rows["policy"].unique() if _is_perfect(name))
    tracked = _release_shares(rows, release, robot)
    perfect = _release_shares(rows, oracle, robot)
    if any(map(math.isnan, (*tracked, *perfect))):
        return ""
    form, _, tracker = release.partition(":")
    by = "of" if form == "tracks" else "tracked by"
    return (
        f"Raw {form} {by} {plugin_label(tracker)} reveal {whole_percent(tracked.known)} of"
        f" person-time (perfect association {whole_percent(perfect.known)}), and"
        f" {robot_subject(robot)} misses {whole_percent(tracked.missed)} of future"
        f" conflicts{ahead_text(horizon_s)} ({whole_percent(perfect.missed)} with"
        " perfect association)."
    )


class ReleaseShares(NamedTuple):
    """What a release of tracks reveals and costs; NaN where it is unknown."""

    known: float  # Of person-time.
    missed: float  # Of the future conflicts at the farthest horizon, by a robot.


def _release_shares(rows: pd.DataFrame, release: str, robot: str) -> ReleaseShares:
    """Return the shares of a release."""
    at_horizon = _at_horizon(rows, _farthest_s(rows))
    return ReleaseShares(
        known=_value(rows, release, LOG, KNOWN_SHARE),
        missed=_value(at_horizon, release, robot, MISSED_FUTURE),
    )


def _are_answered(rows: pd.DataFrame) -> Bools:
    """Return which rows are of a policy's answers from tracks."""
    return np.array(
        [all(parse_policy(str(text))) for text in rows["policy"]], dtype=bool
    )


def _value(rows: pd.DataFrame, policy: str, consumer: str, metric: str) -> float:
    """Return the value of a metric; NaN without a row."""
    chosen = rows[
        (rows["policy"] == policy)
        & (rows["consumer"] == consumer)
        & (rows["metric"] == metric)
    ]
    return float(chosen["value"].iloc[0]) if len(chosen) else float("nan")


def _is_perfect(release: str) -> bool:
    """Whether a release is of all tracks of the oracle."""
    tracker = release.partition(":")[2].partition(",noise=")[0]
    return tracker == ORACLE_TRACKER


def _best_robot(rows: pd.DataFrame) -> str:
    """Return the robot that misses least with raw tracks of the oracle; or ""."""
    if rows.empty:
        return ""
    rows = _at_horizon(rows, _farthest_s(rows))
    is_raw_oracle = (rows["mechanism"] == RAW) & rows["policy"].map(_is_perfect)
    missed = rows[is_raw_oracle & (rows["metric"] == MISSED_FUTURE)]
    missed = missed.dropna(subset=["value"])
    return str(missed.sort_values("value")["consumer"].iloc[0]) if len(missed) else ""


def _horizon_s(dataset: str) -> float | None:
    return parse_dataset(dataset).world.horizon_s


def _at_horizon(rows: pd.DataFrame, horizon_s: float | None) -> pd.DataFrame:
    """Return the rows of a horizon."""
    own = [_horizon_s(name) == horizon_s for name in rows["dataset"]]
    return rows[np.array(own, dtype=bool)]


def _farthest_s(rows: pd.DataFrame) -> float | None:
    """Return the farthest horizon of some rows, s; None: the run's own."""
    horizons = [_horizon_s(str(name)) for name in rows["dataset"].unique()]
    return max((seconds for seconds in horizons if seconds is not None), default=None)


def _title(row: Mapping[str, Any], robot: str, *, horizon_s: float | None) -> str:
    """Return the column of a row; empty: it is in none."""
    if (row["consumer"], row["metric"]) in _TRACKS:
        return METRICS[row["metric"]].head
    is_shown = row["consumer"] == robot and row["metric"] in _ROBOT
    if not is_shown or _horizon_s(row["dataset"]) != horizon_s:
        return ""
    return METRICS[row["metric"]].head


def _shared(run: Results, row: Mapping[str, Any]) -> str:
    """Return the name of the mechanism of a row."""
    level = None if pd.isna(row["level"]) else row["level"]
    return shared_name(row["mechanism"], level, run.families)
