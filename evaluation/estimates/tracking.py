"""Estimates of tracks: how they are associated, what they reveal, what robots miss.

Intervals draw blocks of the recording and seeds of sensing, both with replacement: they
are conditional on the recording. The numbers are rows of `summary.csv`, whose column
`policy` names release and tracker.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from evaluation.compute.tables import ROWS
from evaluation.compute.tracking import (
    ALARM_COLUMNS,
    ALARMS,
    ROBOT_COLUMNS,
    ROBOT_SHARES,
    TRACK_COLUMNS,
    TRACK_METRICS,
    by_distance,
    by_seed,
)
from evaluation.estimates.metrics import FUTURE_EQUAL_ALARMS, KNOWN_SHARE, METRICS
from evaluation.estimates.patrols import PatrolNumber
from evaluation.plan.axes import LOG, TRACK_KINDS
from evaluation.plan.constants import ORACLE
from evaluation.store.cell_files import read_rows
from isac_track.tracking.blocks import block_missed_at_equal_alarms, block_ratio
from isac_track.tracking.knowledge import TRACK_ESTIMATORS

if TYPE_CHECKING:
    from evaluation.compute.tables import Rows
    from evaluation.plan.address import Address
    from evaluation.store.entries import Entry
    from isac_track.intervals import Estimate

_BESIDE: Final = (*TRACK_COLUMNS, *ROBOT_COLUMNS, *ALARM_COLUMNS)
"""Columns of all tables of tracks in a file."""
_FALSE_ALARMS: Final = "false_alarms_per_min"


def track_numbers(out: Path, manifest: Mapping[str, Any]) -> list[PatrolNumber]:
    """Return all metrics of the tracks of a run; DataError if a cell is broken."""
    seed = int(manifest["identity"]["seed"])
    numbers: list[PatrolNumber] = []
    for entry in manifest["cells"]:
        if entry.kind in TRACK_KINDS:
            read = _track_metrics if entry.kind == "tracks" else _robot_metrics
            metrics = read(out, entry, seed=seed)
            numbers += [
                PatrolNumber(address.measured(name), estimate)
                for (address, name), estimate in metrics.items()
            ]
    return numbers


_Metrics: TypeAlias = "dict[tuple[Address, str], Estimate]"


def _track_metrics(out: Path, entry: Entry, *, seed: int) -> _Metrics:
    """Return the metrics of the tracking field, and the known share of an adversary.

    The adversary knows to whom each track belongs; its estimator is the best of all.
    """
    rows = _read(out, entry, TRACK_COLUMNS)
    metrics = {
        (entry.address, name): _ratio(rows, name, seed=seed) for name in TRACK_METRICS
    }
    known = [by_seed(rows, f"known_{estimator}") for estimator in TRACK_ESTIMATORS]
    best = int(np.argmax([counts.sum() for counts in known]))
    log = replace(entry.address, plugin=LOG, adversary=ORACLE)
    metrics[log, KNOWN_SHARE] = block_ratio(
        numerator=known[best], denominator=by_seed(rows, "instants"), seed=seed
    )
    return metrics


def _robot_metrics(out: Path, entry: Entry, *, seed: int) -> _Metrics:
    """Return what a robot with tracks misses, and its false alarms."""
    rows = _read(out, entry, ROBOT_COLUMNS)
    robot = entry.address
    metrics = {(robot, name): _ratio(rows, name, seed=seed) for name in ROBOT_SHARES}
    alarms = _read(out, entry, ALARM_COLUMNS, table=ALARMS)
    metrics[robot, FUTURE_EQUAL_ALARMS] = block_missed_at_equal_alarms(
        # The last row repeats the one before.
        alarms=by_distance(alarms, "alarms")[:-1],
        warned=by_distance(alarms, "warned"),
        allowed=by_seed(rows, "allowed"),
        seed=seed,
    )
    metrics[robot, _FALSE_ALARMS] = block_ratio(
        numerator=by_seed(rows, "false_alarms_sum"),
        denominator=by_seed(rows, "false_alarms_over"),
        seed=seed,
        is_share=False,
    )
    return metrics


def _ratio(rows: Rows, name: str, *, seed: int) -> Estimate:
    return block_ratio(
        numerator=by_seed(rows, f"{name}_sum"),
        denominator=by_seed(rows, f"{name}_over"),
        seed=seed,
        is_share=METRICS[name].is_share,
    )


def _read(
    out: Path, entry: Entry, columns: tuple[str, ...], *, table: str = ROWS
) -> Rows:
    """Return the columns of a table of a cell."""
    read = partial(read_rows, out, entry, beside=_BESIDE)
    rows = read(columns=columns, table=table)
    return {name: rows[name].to_numpy() for name in columns}
