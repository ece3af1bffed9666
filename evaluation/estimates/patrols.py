"""Estimates of patrols: what robots miss and what logs reveal, by disclosure policy.

Intervals draw people and routes, both with replacement. The numbers are rows of
`summary.csv` with a value in its last column, `policy`; no other number has one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import pandas as pd

from attacks.following.followed import following_metrics
from evaluation.compute.patrols import (
    FOLLOWED_COLUMNS,
    KNOWN_COLUMNS,
    ROBOT_COLUMNS,
    followed_from_rows,
    known_from_rows,
    utility_counts,
)
from evaluation.estimates.metrics import METRICS
from evaluation.plan.constants import ORACLE, SHARED
from evaluation.store.cell_files import read_rows
from isac_track.patrols.metrics import estimate_utility, knowledge_metrics

if TYPE_CHECKING:
    import pyarrow as pa

    from evaluation.compute.tables import Rows
    from evaluation.store.entries import Entry
    from isac_track.intervals import Estimate

MAP: Final = "map"
"""Consumer: an adversary without a log, that knows where people stand."""
_PEOPLE: Final = ["source", "group"]
_SHARED_METRICS: Final = ("disclosed_share", "people_seen", "plr_walk")
"""Metrics of the answers themselves, which no adversary changes."""
_ORACLE_METRICS: Final = ("known_share", "known_worst_tenth", "known_undisclosed")


class PatrolNumber(NamedTuple):
    """A metric of a policy with a mechanism, of a robot or of an adversary."""

    mechanism: str
    level: float | None
    consumer: str
    knowledge: str
    metric: str
    policy: str
    world: str
    estimate: Estimate
    # Whether it follows from how policy and robot are built: then it is no result.
    is_built_in: bool = False


def patrol_numbers(out: Path, manifest: Mapping[str, Any]) -> list[PatrolNumber]:
    """Return all metrics of the patrols of a run; DataError if a cell is broken."""
    seed = int(manifest["identity"]["seed"])
    numbers: list[PatrolNumber] = []
    for entry in manifest["cells"]:
        if entry.address.policy:
            numbers += _numbers(out, entry, seed=seed)
    return numbers


def _numbers(out: Path, entry: Entry, *, seed: int) -> list[PatrolNumber]:
    """Return the numbers of a cell of a robot, or of an adversary with a log."""
    address = entry.address

    def number(
        metric: str, estimate: Estimate, consumer: str, knowledge: str = ""
    ) -> PatrolNumber:
        return PatrolNumber(
            mechanism=address.mechanism,
            level=address.level,
            consumer=consumer,
            knowledge=knowledge,
            metric=metric,
            policy=address.policy,
            world=address.world.text,
            estimate=estimate,
        )

    consumer, knowledge = address.consumer, address.adversary
    if entry.kind == "patrol":
        rows, group = _read(out, entry, ROBOT_COLUMNS)
        is_built_in = bool(rows["by_construction"].all())
        metrics = estimate_utility(utility_counts(rows), group=group, seed=seed)
        return [
            number(name, estimate, consumer)._replace(
                is_built_in=is_built_in and name == "withheld_share"
            )
            for name, estimate in metrics.items()
        ]
    if knowledge != ORACLE:
        rows, group = _read(out, entry, FOLLOWED_COLUMNS)
        metrics = following_metrics(followed_from_rows(rows), group=group, seed=seed)
        return [
            number(name, estimate, consumer, knowledge)
            for name, estimate in metrics.items()
            if name in METRICS
        ]
    rows, group = _read(out, entry, KNOWN_COLUMNS)
    metrics = knowledge_metrics(known_from_rows(rows), group=group, seed=seed)
    by_map = metrics["known_by_map"]
    return [
        *(number(name, metrics[name], SHARED) for name in _SHARED_METRICS),
        *(number(name, metrics[name], consumer, knowledge) for name in _ORACLE_METRICS),
        number("known_share", by_map, MAP),
    ]


def _read(
    out: Path, entry: Entry, columns: Sequence[str]
) -> tuple[Rows, tuple[str, ...]]:
    """Return the rows of a cell, and the cluster of each person."""
    table = read_rows(out, entry, columns=[*_PEOPLE, *columns])
    rows = {name: table[name].to_numpy() for name in columns}
    n_routes = int(rows["route"].max()) + 1
    return rows, tuple(_names(table)[::n_routes])


def _names(table: pa.Table) -> list[str]:
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
        estimate, family = number.estimate, families[number.mechanism]
        yield {
            "dataset": f"{dataset}:{number.world}" if number.world else dataset,
            "mechanism": number.mechanism,
            "level": np.nan if number.level is None else number.level,
            "consumer": number.consumer,
            "knowledge": number.knowledge,
            "metric": number.metric,
            "value": estimate.value,
            "ci_low": estimate.ci_low,
            "ci_high": estimate.ci_high,
            "n": estimate.n,
            "unit": METRICS[number.metric].summary_unit,
            "family": family.family,
            "adding": family.adding,
            "policy": number.policy,
        }
