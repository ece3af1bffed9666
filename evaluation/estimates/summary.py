"""From finished cells to numbers with intervals: `summary.csv`.

The unit is the source track, or the group that walks together: every interval draws
whole clusters, the same for every mechanism, so that differences are paired.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa

from evaluation.estimates.families import Family
from evaluation.estimates.keys import EstimatesByAddress
from evaluation.estimates.linkability import LinkageOutcomes
from evaluation.estimates.metrics import (
    BOUNDS,
    DESCRIPTORS,
    DISTANCE,
    METRICS,
    PLR,
    PLR_GAP,
    RECONSTRUCTION,
    ROBOT_PLR,
    WORST_TENTH,
)
from evaluation.estimates.recordings import in_run
from evaluation.estimates.worst_off import person_means, worst_tenth
from evaluation.plan.address import Address
from evaluation.plan.world import OWN_WORLD, World
from evaluation.store.cell_files import read_rows
from evaluation.store.entries import Entry, entries_in
from evaluation.store.linkage_outcomes import ClusterSums, LinkageOutcome
from isac_track.intervals import (
    Estimate,
    cluster_sums,
    cluster_weights,
    ratio_estimates,
)
from isac_track.types import Floats, Ints, read_only

N_REPLICATES = 1000
_NUMBERS = ("value", "ci_low", "ci_high", "n")
COLUMNS = [
    "dataset",
    "mechanism",
    "level",
    "consumer",
    "knowledge",
    "metric",
    "value",
    "ci_low",
    "ci_high",
    "n",
    "unit",
    "family",
    "adding",
    "policy",
]
_POSITIONS = [
    METRICS[name] for name in (*RECONSTRUCTION, *DISTANCE) if METRICS[name].column
]
_SHARED = ["group", "scene", *(row.column for row in _POSITIONS if not row.over)]
_BOUNDS = [METRICS[name] for name in BOUNDS]
_CELL_COLUMNS = {
    "shared": _SHARED,
    "attack": [*_SHARED, *(row.over for row in _POSITIONS if row.over)],
    "bound": ["group", *(row.column for row in _BOUNDS)],
    "predictor": [
        "group",
        "conflict",
        "inside_now",
        "predicted",
        "separation_m",
        "predicted_separation_m",
        "probability",
        ROBOT_PLR,
    ],
}
_DECIDED = (
    "conflict",
    "inside_now",
    "predicted",
    "predicted_separation_m",
    "probability",
)


class PredictorAnswers(NamedTuple):
    """A predictor's answers for every scene of one mechanism level."""

    entry: Entry  # Of the cell in the manifest.
    cluster: Ints  # (S,) of the scenes
    columns: Mapping[str, Any]  # (S,) each: `_DECIDED`


@dataclass(frozen=True, eq=False, slots=True)
class SceneNumbers:
    """Numbers of the scenes of a run in one world."""

    # Of every metric, with intervals and replicates.
    estimates: dict[Address, Estimate]
    scored: tuple[PredictorAnswers, ...]  # Of every predictor at every level.
    attacked: dict[Address, ClusterSums]  # Descriptors after each attack.


def scene_numbers(
    out: Path, manifest: Mapping[str, Any], *, world: World = OWN_WORLD
) -> SceneNumbers:
    """Return the numbers of a run's scenes, in its own world or in another.

    Raises DataError if a cell cannot be read.
    """
    weights = bootstrap_weights(manifest)
    n, names = weights.shape[1], tuple(manifest["groups"])
    numbers: dict[Address, Estimate] = {}
    scored: list[PredictorAnswers] = []
    attacked: dict[Address, ClusterSums] = {}
    entries = entries_in(manifest["cells"], world, kinds=_CELL_COLUMNS)
    gap = [PLR_GAP] if world.is_model else []
    every_column = {
        name for columns in (*_CELL_COLUMNS.values(), gap) for name in columns
    }
    for _, level_entries in groupby(entries, key=attrgetter("spec", "files")):
        keys, sums = [], []
        for entry in level_entries:
            kind, address = entry.kind, entry.address.within()
            columns = [*_CELL_COLUMNS[kind], *(gap if kind == "attack" else [])]
            table = read_rows(out, entry, columns=columns, beside=every_column)
            cluster = clusters(table, manifest)
            if kind == "predictor":
                decided = {name: table[name].to_numpy() for name in _DECIDED}
                scored.append(PredictorAnswers(entry, cluster, decided))
            elif kind != "bound":
                worst = _worst_tenth(table, cluster, weights)
                numbers[address.measured(WORST_TENTH)] = worst
            for metric, parts in ratios(kind, table).items():
                keys.append(address.measured(metric))
                sums.append(
                    [
                        cluster_sums(values=values, cluster=cluster, n_clusters=n)
                        for values in parts
                    ]
                )
        totals = np.array(sums)
        # Of thousands of clusters, hundreds are in scenes.
        used = np.flatnonzero(totals.any(axis=(0, 1)))
        totals = totals[:, :, used]
        numbers.update(_estimate_ratios(keys, totals, weights[:, used]))
        attacked |= {
            key: ClusterSums(summed, weights, used, names=names)
            for key, summed in zip(keys, totals, strict=True)
            if key.adversary and key.metric in {*DESCRIPTORS, *DISTANCE}
        }
    return SceneNumbers(numbers, tuple(scored), attacked)


def _estimate_ratios(
    keys: Sequence[Address], totals: Floats, weights: Floats
) -> dict[Address, Estimate]:
    """Return the estimates of K ratios from their sums by cluster, (K, 2, C)."""
    estimated = ratio_estimates(
        numerator=totals[:, 0],
        denominator=totals[:, 1],
        weights=weights,
        is_share=[METRICS[key.metric].is_share for key in keys],
    )
    return {
        key: _root(estimate) if METRICS[key.metric].is_root else estimate
        for key, estimate in zip(keys, estimated, strict=True)
    }


def _root(square: Estimate) -> Estimate:
    """Return the square root of an estimate, of its interval and its replicates."""
    value, low, high = np.sqrt([square.value, square.ci_low, square.ci_high]).tolist()
    roots = np.sqrt(square.replicates)
    return Estimate(value, low, high, square.n, roots, effective=square.effective)


def _worst_tenth(table: pa.Table, cluster: Ints, weights: Floats) -> Estimate:
    """Return PLR of the worst-off tenth of the people for a consumer at a level."""
    values, scene = (table[name].to_numpy() for name in (METRICS[PLR].column, "scene"))
    n_clusters = weights.shape[1]
    means = person_means(
        values=values, scene=scene, cluster=cluster, n_clusters=n_clusters
    )
    return worst_tenth(means, weights=weights)


def linkage_estimates(outcomes: LinkageOutcomes) -> dict[Address, Estimate]:
    """Return every metric of the linkage cells, from their outcomes."""
    return {
        address.measured(metric): estimate
        for address, outcome in _addressed(outcomes)
        for metric, estimate in outcome.estimates.items()
    }


def linkage_sums(outcomes: LinkageOutcomes) -> dict[Address, ClusterSums]:
    """Return the rank metrics of linkage attacks, summed by cluster."""
    return {
        address.measured(metric): summed
        for address, outcome in _addressed(outcomes)
        for metric, summed in outcome.sums.items()
    }


def _addressed(outcomes: LinkageOutcomes) -> Iterator[tuple[Address, LinkageOutcome]]:
    return ((entry.address.within(), outcome) for entry, outcome in outcomes)


def bootstrap_weights(manifest: Mapping[str, Any]) -> Floats:
    """Return the bootstrap weights of a run, (B, C): the same for everything in it."""
    return _weights(len(manifest["groups"]), manifest["identity"]["seed"])


# Holds the weights of the last run: with thousands of people they take 60 MB.
@lru_cache(maxsize=1)
def _weights(n_clusters: int, seed: int) -> Floats:
    if not n_clusters:  # A run without scenes.
        return read_only(np.zeros((N_REPLICATES, 0)))
    return read_only(
        cluster_weights(n_clusters=n_clusters, n_replicates=N_REPLICATES, seed=seed)
    )


def clusters(table: pa.Table, manifest: Mapping[str, Any]) -> Ints:
    """Return the cluster of each row, (R,): its row in the run's list of groups."""
    column = table["group"].combine_chunks()
    row_by_group = {group: row for row, group in enumerate(manifest["groups"])}
    to_row = np.array(
        [row_by_group[name] for name in column.dictionary.to_pylist()], dtype=np.int64
    )
    cluster: Ints = to_row[column.indices.to_numpy()]
    return cluster


def to_frame(
    estimates: EstimatesByAddress,
    *,
    worlds: Mapping[World, EstimatesByAddress],
    families: Mapping[str, Family],
    dataset: str,
) -> pd.DataFrame:
    """Return the tidy summary, `COLUMNS`; the first six of them are unique together.

    No row has a policy: those of patrols are of `evaluation.estimates.patrols`.

    `worlds` are the estimates in other worlds, which the data set's name shows;
    `families` are the run's mechanisms.
    """
    estimates_by_world = {OWN_WORLD: estimates, **worlds}
    rows = [
        {
            **in_run(address, dataset=dataset, world=world).to_columns(),
            **{name: getattr(estimate, name) for name in _NUMBERS},
            "unit": METRICS[address.metric].summary_unit,
            "family": families[address.mechanism].family,
            "adding": families[address.mechanism].adding,
            "policy": address.policy,
        }
        for world, in_world in estimates_by_world.items()
        for address, estimate in in_world.items()
    ]
    return pd.DataFrame(rows, columns=COLUMNS)


def cell_columns(kind: str) -> list[str]:
    """Return the columns of a scene cell from which its metrics are computed."""
    return _CELL_COLUMNS[kind]


def ratios(kind: str, table: pa.Table) -> dict[str, tuple[Floats, Floats]]:
    """Return numerator and denominator of each metric, (R,), for the R rows of a cell.

    An attack also has the ratio to the linear benchmark: sums over the same tracks.
    """
    if kind == "predictor":
        _, *names = _CELL_COLUMNS[kind]
        conflict, inside, predicted, truth, ours, _, robot_plr = (
            table[name].to_numpy() for name in names
        )
        known, future = ~np.isnan(robot_plr), conflict & ~inside
        return {
            "missed_conflict_rate": ((conflict & ~predicted) * 1.0, conflict * 1.0),
            "missed_future_rate": ((future & ~predicted) * 1.0, future * 1.0),
            "false_alarm_rate": ((~conflict & predicted) * 1.0, ~conflict * 1.0),
            "distance_mae": (np.abs(ours - truth), np.ones_like(ours)),
            **(
                {ROBOT_PLR: (np.nan_to_num(robot_plr), known * 1.0)}
                if known.any()
                else {}
            ),
        }
    ratio_by_metric = {}
    for metric in _BOUNDS if kind == "bound" else [*_POSITIONS, METRICS[PLR_GAP]]:
        if (metric.over or metric.column) not in table.column_names:
            continue
        values = table[metric.column].to_numpy()
        over = table[metric.over].to_numpy() if metric.over else np.ones_like(values)
        # A one-sample track that leaks has no exposure length (NaN): skip it there.
        known = ~np.isnan(over if metric.over else values)
        if known.any() or metric.name not in {*BOUNDS, PLR_GAP}:
            values = np.where(known & ~np.isnan(values), values, 0.0)
            ratio_by_metric[metric.name] = values, np.where(known, over, 0.0)
    return ratio_by_metric
