"""Tables about patrols: what robots miss, what the log of a fleet tells."""

from collections.abc import Iterable, Mapping
from typing import Any, Final

import pandas as pd

from evaluation.estimates.keys import row_dicts
from evaluation.estimates.metrics import FUTURE_EQUAL_ALARMS, METRICS, WITHHELD
from evaluation.estimates.patrols import MAP
from evaluation.plan.address import parse_dataset
from evaluation.reporting import table as make
from evaluation.reporting.amounts import tenth_percent
from evaluation.reporting.names import robot_name
from evaluation.reporting.patrol_words import shared_name
from evaluation.reporting.rows import Results
from evaluation.reporting.table import Cell, Table

_LOG: Final = {
    "disclosed": ("shared", "", "disclosed_share"),
    "known, true identities": ("log", "oracle", "known_share"),
    "... worst tenth": ("log", "oracle", "known_worst_tenth"),
    "known, own chains": ("log", "blind", "known_share"),
    "followed": ("log", "blind", "followed_s"),
    "followed 10 s": ("log", "blind", "followed_10s"),
    "time to confusion": ("log", "blind", "time_to_confusion_s"),
    "PLR of walks": ("shared", "", "plr_walk"),
}
"""Columns about a log: consumer, adversary and metric."""
_ROBOT: Final = (
    "missed_conflict_rate",
    "missed_future_rate",
    FUTURE_EQUAL_ALARMS,
    "missed_encounter_rate",
    WITHHELD,
    "false_alarms_per_min",
)
_BUILT_IN: Final = "*"
_FEW: Final = (
    "No intervals: they draw people and routes, and take 20 routes"
    " (--set patrol.fleets=20) and 15 effective clusters of people."
)


_MEETING_METRICS: Final = (*_ROBOT, "time_to_confusion_s")
_NOBODY: Final = (
    "Empty: a robot met nobody, had no warning that could be withheld, or its log has"
    " nobody. Longer patrols (--set patrol.segment_s=600) or more routes meet more."
)


def patrol_tables(run: Results) -> list[Table]:
    """Return the tables of patrols: of logs, and of each robot; empty without any."""
    rows = run.patrols
    if rows.empty:
        return []
    notes = [] if rows["ci_low"].notna().any() else [_FEW]
    if rows.loc[rows["metric"].isin(_MEETING_METRICS), "value"].isna().any():
        notes.append(_NOBODY)
    return [_log_table(run, rows, notes), _robot_table(run, rows, notes)]


def _log_table(run: Results, rows: pd.DataFrame, notes: list[str]) -> Table:
    """Return what logs disclose and reveal, a row for each policy and mechanism."""
    cells: dict[tuple[str, str], dict[str, Cell]] = {}
    for row in row_dicts(rows):
        place = row["consumer"], row["knowledge"] or "", row["metric"]
        for title, column in _LOG.items():
            if place == column:
                own = cells.setdefault((row["policy"], _shared(run, row)), {})
                own[title] = _cell(row)
    stages = run.manifest["settings"]["stages"]
    about = (
        f"{stages['patrol.fleets']} fleets of {stages['patrol.robots']}; known: stated"
        f" within {stages['privacy.epsilon_m']:g} m, % of person-time."
    )
    for share in rows.loc[rows["consumer"] == MAP, "value"].unique()[:1]:
        about += f" A map without a log knows {tenth_percent(share)}."
    return make.build_table(
        "patrol-logs",
        "Patrols: what the log of a fleet tells, by disclosure policy",
        _records(cells),
        [
            make.text_column("policy"),
            make.text_column("mechanism"),
            *(
                make.cell_column(title, unit=METRICS[metric].unit)
                for title, (_, _, metric) in _LOG.items()
            ),
        ],
        notes=[
            about,
            "Own chains: an adversary that joins answers without identities.",
            *notes,
        ],
        n_keys=2,
    )


def _robot_table(run: Results, rows: pd.DataFrame, notes: list[str]) -> Table:
    """Return what robots miss, a row for each robot, horizon, policy and mechanism."""
    places = run.verdict.get("patrols", {}).get("by_construction", ())
    known = {_place(place) for place in places}
    cells: dict[tuple[str, ...], dict[str, Cell]] = {}
    for row in row_dicts(rows):
        if row["metric"] not in _ROBOT or row["knowledge"]:
            continue
        world = parse_dataset(row["dataset"]).world
        place = _place(row | {"world": world.text})
        is_built_in = row["metric"] == WITHHELD and place in known
        seconds = world.horizon_s
        key = (
            robot_name(row["consumer"]),
            "paper's" if seconds is None else f"{seconds:g} s",
            row["policy"],
            _shared(run, row),
        )
        own = cells.setdefault(key, {})
        own[METRICS[row["metric"]].head] = _cell(
            row, mark=_BUILT_IN if is_built_in else ""
        )
    heads = ("robot", "horizon", "policy", "mechanism")
    records = [dict(zip(heads, key, strict=True)) | own for key, own in cells.items()]
    return make.build_table(
        "patrol-robots",
        "Patrols: what robots miss, by disclosure policy",
        records,
        [
            *map(make.text_column, heads),
            *(
                make.cell_column(METRICS[name].head, unit=METRICS[name].unit)
                for name in _ROBOT
            ),
        ],
        marks={
            _BUILT_IN: (
                "by construction: policy and robot use the same forecast, no result"
            )
        },
        notes=notes,
        n_keys=4,
    )


def _records(
    cells: Mapping[tuple[str, str], Mapping[str, Cell]],
) -> Iterable[dict[str, Any]]:
    return (
        {"policy": policy, "mechanism": mechanism} | dict(own)
        for (policy, mechanism), own in cells.items()
    )


def _shared(run: Results, row: Mapping[str, Any]) -> str:
    """Return the name of the mechanism of a row."""
    level = None if pd.isna(row["level"]) else row["level"]
    return shared_name(row["mechanism"], level, run.families)


def _cell(row: Mapping[str, Any], *, mark: str = "") -> Cell:
    return make.metric_cell(
        row["metric"], row["value"], row["ci_low"], row["ci_high"], mark=mark
    )


def _place(row: Mapping[str, Any]) -> tuple[Any, ...]:
    level = None if pd.isna(row["level"]) else float(row["level"])
    return row["mechanism"], level, row["policy"], row["consumer"], row["world"]
