"""PLR over net speed: whether slow people are more exposed; `by_speed.csv`."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa

from evaluation.estimates.families import AT_RAW, FID, FIXED, PAPER_FAMILIES, Family
from evaluation.estimates.keys import EstimatesByAddress
from evaluation.estimates.metrics import METRICS, PLR
from evaluation.estimates.strongest import by_task, strongest_by_mechanism
from evaluation.estimates.summary import bootstrap_weights, clusters
from evaluation.plan.address import AS_SHARED, Address, MechanismLevel
from evaluation.plan.world import OWN_WORLD
from evaluation.store.cell_files import read_rows
from evaluation.store.entries import Entry, entries_in
from isac_track.intervals import cluster_sums, ratio_estimates
from isac_track.types import Floats

SHOWN: Final = (
    AT_RAW,
    MechanismLevel(FID, 1.0),
    MechanismLevel(FIXED, 1.0),
    MechanismLevel("ou", 0.4),
)
"""Mechanisms, without their adding rule, and levels."""
EDGES_MPS: Final = (0.0, 0.05, 0.5, 1.0, 1.5, np.inf)
"""Edges of the bins. People slower than the first inner edge stand. Finer bins would
hold too few people for an interval."""
COLUMNS: Final = [
    "dataset",
    "mechanism",
    "level",
    "consumer",
    "knowledge",
    "speed_low_mps",
    "speed_high_mps",
    "speed_mps",
    "value",
    "ci_low",
    "ci_high",
    "n",
]
_SPEED: Final = "speed_mps"


def by_speed(
    out: Path,
    manifest: Mapping[str, Any],
    estimates: EstimatesByAddress,
    *,
    families: Mapping[str, Family],
    best: Mapping[str, Address],
) -> pd.DataFrame:
    """Return PLR by net speed, as shared and after the strongest attack: `COLUMNS`.

    The net speed of a track is the distance from its first to its last true position
    over its duration. The strongest attack on raw, FID and fixed noise is the run's;
    on another mechanism it is the strongest against that, as in the first table.
    `estimates` are the run's, `best` are its strongest attacks. Raises DataError if a
    cell cannot be read.
    """
    entries = {
        entry.address: entry
        for entry in entries_in(
            manifest["cells"], OWN_WORLD, kinds=("shared", "attack")
        )
    }
    shown = [
        cell.mechanism_level
        for cell in entries
        if cell == AS_SHARED.at(*cell.mechanism_level)
        and _is_shown(families, cell.mechanism_level)
    ]
    if not shown:
        return pd.DataFrame(columns=COLUMNS)
    at_raw = AT_RAW if AT_RAW in shown else shown[0]
    speed_by_source = _speeds(out, entries[AS_SHARED.at(*at_raw)])
    attacks_by_mechanism = strongest_by_mechanism(
        by_task(estimates, metric=PLR).get("", {})
    )
    rows = []
    for where in shown:
        attack = (
            best.get("")
            if families[where.mechanism].family in PAPER_FAMILIES
            else attacks_by_mechanism.get(where.mechanism)
        )
        for reader in filter(None, (AS_SHARED, attack)):
            if entry := entries.get(reader.at(*where)):
                level = np.nan if where.level is None else where.level
                about = (
                    manifest["dataset"]["name"],
                    where.mechanism,
                    level,
                    reader.consumer,
                    reader.adversary,
                )
                rows += [
                    (*about, *numbers)
                    for numbers in _bins(out, manifest, entry, speed_by_source)
                ]
    return pd.DataFrame(rows, columns=COLUMNS)


def _is_shown(families: Mapping[str, Family], where: MechanismLevel) -> bool:
    return (families[where.mechanism].name, where.level) in SHOWN


def _speeds(out: Path, entry: Entry) -> dict[str, float]:
    """Return the net speed of each source track of a cell, m/s."""
    table = read_rows(out, entry, columns=["source", _SPEED])
    sources, speeds = (table[name].to_pylist() for name in ("source", _SPEED))
    return dict(zip(sources, speeds, strict=True))


def _bins(
    out: Path,
    manifest: Mapping[str, Any],
    entry: Entry,
    speed_by_source: Mapping[str, float],
) -> Iterator[tuple[float, ...]]:
    """Yield ends and mean speed of each bin with its PLR, interval, and people."""
    table = read_rows(out, entry, columns=["source", "group", METRICS[PLR].column])
    values = table[METRICS[PLR].column].to_numpy()
    speed_mps = _row_speeds(table, speed_by_source)
    cluster, weights = clusters(table, manifest), bootstrap_weights(manifest)
    for low, high in pairwise(EDGES_MPS):
        inside = (low <= speed_mps) & (speed_mps < high)
        if not inside.any():
            continue
        sums = [
            cluster_sums(values=numbers, cluster=cluster, n_clusters=weights.shape[1])
            for numbers in (np.where(inside, values, 0.0), inside.astype(np.float64))
        ]
        (plr,) = ratio_estimates(
            numerator=sums[0][None],
            denominator=sums[1][None],
            weights=weights,
            is_share=[True],
        )
        mean_mps = float(speed_mps[inside].mean())
        yield low, high, mean_mps, plr.value, plr.ci_low, plr.ci_high, plr.n


def _row_speeds(table: pa.Table, speed_by_source: Mapping[str, float]) -> Floats:
    """Return the net speed of each row's source, (R,) m/s; NaN if unknown."""
    column = table["source"].combine_chunks()
    speeds = np.array(
        [speed_by_source.get(name, np.nan) for name in column.dictionary.to_pylist()]
    )
    return np.asarray(speeds[column.indices.to_numpy()])
