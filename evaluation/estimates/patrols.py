"""Estimates of patrols: what robots miss and what logs reveal, by disclosure policy.

Intervals draw people and routes, both with replacement. The numbers are rows of
`summary.csv` with a value in its last column, `policy`, empty for other numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import pandas as pd

from attacks.following.followed import following_metrics
from evaluation.compute.patrol_rows import (
    ALARM_COLUMNS,
    ALARMS,
    CONFLICT_COLUMNS,
    CONFLICTS,
    FOLLOWED_COLUMNS,
    KNOWN_COLUMNS,
    ROBOT_COLUMNS,
    followed_from_rows,
    known_from_rows,
    utility_counts,
)
from evaluation.compute.tables import ROWS
from evaluation.estimates.metrics import KNOWN_SHARE, METRICS, WITHHELD
from evaluation.plan.constants import ORACLE, SHARED
from evaluation.plan.consumer import PATROL_KINDS
from evaluation.store.cell_files import read_rows
from isac_track.patrols.metrics import estimate_utility, knowledge_metrics

if TYPE_CHECKING:
    import pyarrow as pa

    from evaluation.compute.tables import Rows
    from evaluation.plan.address import Address
    from evaluation.store.entries import Entry
    from isac_track.intervals import Estimate

MAP: Final = "map"
"""Consumer: an adversary without a log, that knows where people stand."""
_PEOPLE: Final = ("source", "group")
_ROBOT_BESIDE: Final = (
    *_PEOPLE,
    *ROBOT_COLUMNS,
    *CONFLICT_COLUMNS,
    *ALARM_COLUMNS,
)
"""Columns of all tables of a robot."""
_ANSWER_METRICS: Final = ("disclosed_share", "people_seen", "plr_walk")
"""Metrics of the answers themselves, which no adversary changes."""
_LOG_METRICS: Final = ("known_share", "known_worst_tenth", "known_undisclosed")


class PatrolNumber(NamedTuple):
    """A metric of a policy with a mechanism, of a robot or of an adversary."""

    address: Address  # Without the recording, which all numbers of a run share.
    estimate: Estimate
    # Whether it follows from how policy and robot are built: then it is no result.
    is_by_construction: bool = False
    claims_protection: bool = True  # Whether the policy does; of a robot's number.


def patrol_numbers(out: Path, manifest: Mapping[str, Any]) -> list[PatrolNumber]:
    """Return all metrics of the patrols of a run; DataError if a cell is broken."""
    seed = int(manifest["identity"]["seed"])
    numbers: list[PatrolNumber] = []
    for entry in manifest["cells"]:
        if entry.kind in PATROL_KINDS:
            numbers += _numbers(out, entry, seed=seed)
    return numbers


def _numbers(out: Path, entry: Entry, *, seed: int) -> list[PatrolNumber]:
    """Return the numbers of a cell of a robot, or of an adversary with a log."""
    reader = entry.address
    if entry.kind == "patrol":
        rows, group = _read(out, entry, ROBOT_COLUMNS, beside=_ROBOT_BESIDE)
        is_by_construction = bool(rows["by_construction"].all())
        counts = utility_counts({ROWS: rows} | _read_alarms(out, entry, group))
        metrics = estimate_utility(counts, group=group, seed=seed)
        return [
            PatrolNumber(
                reader.measured(name),
                estimate,
                is_by_construction=is_by_construction and name == WITHHELD,
                claims_protection=bool(rows["protects"].all()),
            )
            for name, estimate in metrics.items()
        ]
    if reader.adversary != ORACLE:
        rows, group = _read(out, entry, FOLLOWED_COLUMNS)
        metrics = following_metrics(followed_from_rows(rows), group=group, seed=seed)
        return [
            PatrolNumber(reader.measured(name), estimate)
            for name, estimate in metrics.items()
            if name in METRICS
        ]
    rows, group = _read(out, entry, KNOWN_COLUMNS)
    metrics = knowledge_metrics(known_from_rows(rows), group=group, seed=seed)
    answers, by_map = (
        replace(reader, plugin=name, adversary="") for name in (SHARED, MAP)
    )
    return [
        *(
            PatrolNumber(answers.measured(name), metrics[name])
            for name in _ANSWER_METRICS
        ),
        *(PatrolNumber(reader.measured(name), metrics[name]) for name in _LOG_METRICS),
        PatrolNumber(by_map.measured(KNOWN_SHARE), metrics["known_by_map"]),
    ]


def _read(
    out: Path, entry: Entry, columns: Sequence[str], *, beside: Sequence[str] = ()
) -> tuple[Rows, tuple[str, ...]]:
    """Return the rows of a cell, and the cluster of each person."""
    table = read_rows(out, entry, columns=[*_PEOPLE, *columns], beside=beside)
    rows = {name: table[name].to_numpy() for name in columns}
    # The rows of a person, one for each route, follow each other.
    n_routes = int(rows["route"].max()) + 1
    return rows, tuple(_clusters(table)[::n_routes])


def _read_alarms(out: Path, entry: Entry, group: Sequence[str]) -> dict[str, Rows]:
    """Return the further tables of a robot's cell; `group` is the people's cluster.

    A conflict names the first person of its cluster, for any other: only the cluster
    matters to estimates.
    """
    first = {name: row for row, name in reversed([*enumerate(group)])}
    read = partial(read_rows, out, entry, beside=_ROBOT_BESIDE)
    conflicts = read(columns=["group", *CONFLICT_COLUMNS], table=CONFLICTS)
    alarms = read(columns=ALARM_COLUMNS, table=ALARMS)
    track = np.array([first[name] for name in _clusters(conflicts)], dtype=np.int64)
    rows = {name: conflicts[name].to_numpy() for name in CONFLICT_COLUMNS}
    return {
        CONFLICTS: rows | {"track": track},
        ALARMS: {name: alarms[name].to_numpy() for name in ALARM_COLUMNS},
    }


def _clusters(table: pa.Table) -> list[str]:
    """Return the cluster of each row."""
    coded = table["group"].combine_chunks()
    names = coded.dictionary.to_pylist()
    return [names[code] for code in coded.indices.to_pylist()]


def patrol_frame(
    numbers: Iterable[PatrolNumber],
    *,
    families: Mapping[str, Any],
    dataset: str,
    columns: Sequence[str],
) -> pd.DataFrame:
    """Return rows of `summary.csv`; its first six columns and `policy` are unique."""
    rows = list(_frame_rows(numbers, families=families, dataset=dataset))
    return pd.DataFrame(rows, columns=list(columns))


def _frame_rows(
    numbers: Iterable[PatrolNumber], *, families: Mapping[str, Any], dataset: str
) -> Iterator[dict[str, Any]]:
    for number in numbers:
        address, estimate = number.address, number.estimate
        family = families[address.mechanism]
        yield {
            **address.within(dataset, address.world).to_columns(),
            "value": estimate.value,
            "ci_low": estimate.ci_low,
            "ci_high": estimate.ci_high,
            "n": estimate.n,
            "unit": METRICS[address.metric].summary_unit,
            "family": family.family,
            "adding": family.adding,
            "policy": address.policy,
        }
