"""From finished cells to numbers with intervals: `summary.csv`.

The unit is the source track, or the group that walks together: every interval draws whole
clusters, the same ones for every mechanism, so that differences are paired.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pandas as pd

from evaluation.analysis.keys import Key
from evaluation.analysis.linkability import Cards, dataset_of
from evaluation.analysis.metrics import METRICS, RECONSTRUCTION
from evaluation.runs.cell_files import read_rows
from isac_track.intervals import Estimate, cluster_sums, cluster_weights, ratio_estimate

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pyarrow as pa

    from evaluation.analysis.families import Family
    from isac_track.types import Floats, Ints

N_REPLICATES = 1000
COLUMNS = [
    *("dataset", "mechanism", "level", "consumer", "knowledge", "metric"),
    *("value", "ci_low", "ci_high", "n", "unit", "family", "adding"),
]
_POSITIONS = [METRICS[name] for name in RECONSTRUCTION]
_SHARED = ["group", *(one.column for one in _POSITIONS if not one.over)]
_COLUMNS_OF = {
    "shared": _SHARED,
    "attack": [*_SHARED, *(one.over for one in _POSITIONS if one.over)],
    "predictor": [
        *("group", "conflict", "predicted"),
        *("separation_m", "predicted_separation_m", "probability"),
    ],
}


Scored: TypeAlias = "tuple[Mapping[str, Any], Ints, Mapping[str, Any]]"
"""What a predictor said of every scene of one mechanism level: the cell's entry in the manifest,
the scenes' clusters, (S,), and its columns as in `_COLUMNS_OF`."""


def estimates(
    out: Path, manifest: Mapping[str, Any]
) -> tuple[dict[Key, Estimate], tuple[Scored, ...]]:
    """Return every metric of the scenes with its interval and replicates, and the scores.

    Raises DataError if a cell cannot be read.
    """
    weights = weights_of(manifest)
    found: dict[Key, Estimate] = {}
    scored: list[Scored] = []
    for entry in manifest["cells"]:
        if entry["kind"] not in _COLUMNS_OF:
            continue
        table = read_rows(out, entry, columns=_COLUMNS_OF[entry["kind"]])
        cluster = clusters(table, manifest)
        if entry["kind"] == "predictor":
            columns = {name: table[name].to_numpy() for name in _COLUMNS_OF["predictor"][1:]}
            scored.append((entry, cluster, columns))
        for metric, ratio in ratios(entry["kind"], table).items():
            found[key_of(entry, metric)] = estimate(
                metric, *ratio, cluster=cluster, weights=weights
            )
    return found, tuple(scored)


def key_of(entry: Mapping[str, Any], metric: str) -> Key:
    """Return what a metric of a cell of the manifest is about."""
    return Key(entry["mechanism"], entry["level"], entry["consumer"], metric, entry["knowledge"])


def estimate(
    metric: str, numerator: Floats, denominator: Floats, *, cluster: Ints, weights: Floats
) -> Estimate:
    """Return a metric that is a ratio of sums over rows, (R,), or the root of one.

    `cluster`, (R,), is the column of a row's cluster in `weights`, (B, C).
    """
    above, below = (
        cluster_sums(values=values, cluster=cluster, n_clusters=weights.shape[1])
        for values in (numerator, denominator)
    )
    about = METRICS[metric]
    one = ratio_estimate(
        numerator=above, denominator=below, weights=weights, is_share=about.is_share
    )
    if not about.is_root:
        return one
    value, low, high = (float(np.sqrt(number)) for number in (one.value, one.ci_low, one.ci_high))
    return Estimate(value, low, high, one.n, np.sqrt(one.replicates))


def linkage_estimates(read: Cards) -> dict[Key, Estimate]:
    """Return every metric of the linkage cells; `read` is what `linkability.cards` returns."""
    return {
        key_of(entry, metric): one for entry, card in read for metric, one in card.estimates.items()
    }


def weights_of(manifest: Mapping[str, Any]) -> Floats:
    """Return the bootstrap weights of a run, (B, C): the same for everything in it."""
    return cluster_weights(
        n_clusters=len(manifest["groups"]),
        n_replicates=N_REPLICATES,
        seed=manifest["identity"]["seed"],
    )


def clusters(table: pa.Table, manifest: Mapping[str, Any]) -> Ints:
    """Return the cluster of each row, (R,): its row in the run's list of groups."""
    row_of = {group: row for row, group in enumerate(manifest["groups"])}
    column = table["group"].combine_chunks()
    to_row = np.array([row_of[name] for name in column.dictionary.to_pylist()], dtype=np.int64)
    found: Ints = to_row[column.indices.to_numpy()]
    return found


def to_frame(
    found: Mapping[Key, Estimate], *, known: Mapping[str, Family], dataset: str
) -> pd.DataFrame:
    """Return the tidy summary; the first six columns are unique together.

    `known` are the mechanisms of the run, from `families`.
    """
    rows = [
        (
            *(dataset_of(key.consumer, dataset=dataset), key.mechanism),
            *(np.nan if key.level is None else key.level, key.consumer, key.knowledge, key.metric),
            *(one.value, one.ci_low, one.ci_high, one.n, METRICS[key.metric].summary_unit),
            *(known[key.mechanism].family, known[key.mechanism].adding),
        )
        for key, one in found.items()
    ]
    return pd.DataFrame(rows, columns=COLUMNS)


def ratios(kind: str, table: pa.Table) -> dict[str, tuple[Floats, Floats]]:
    """Return numerator and denominator of each metric, (R,), of the R rows of a cell of this kind.

    Of an attack also the ratio to the linear benchmark: sums over the same tracks.
    """
    if kind == "predictor":
        conflict, predicted, ours, truth = (
            table[name].to_numpy()
            for name in ("conflict", "predicted", "predicted_separation_m", "separation_m")
        )
        return {
            "missed_conflict_rate": ((conflict & ~predicted) * 1.0, conflict * 1.0),
            "false_alarm_rate": ((~conflict & predicted) * 1.0, ~conflict * 1.0),
            "distance_mae": (np.abs(ours - truth), np.ones_like(ours)),
        }
    found = {}
    for metric in _POSITIONS:
        if metric.over and metric.over not in table.column_names:
            continue
        values = table[metric.column].to_numpy()
        over = table[metric.over].to_numpy() if metric.over else np.ones_like(values)
        # A one-sample track that leaks has no exposure length (NaN): it does not count there.
        known = ~np.isnan(over if metric.over else values)
        found[metric.name] = (
            np.where(known & ~np.isnan(values), values, 0.0),
            np.where(known, over, 0.0),
        )
    return found
