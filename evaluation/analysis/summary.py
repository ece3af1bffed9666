"""From finished cells to numbers with intervals: `summary.csv`.

The unit is the source track, or the group that walks together: every interval draws whole
clusters, the same ones for every mechanism, so that differences are paired.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from evaluation.analysis.keys import Key
from evaluation.analysis.linkability import dataset_of
from evaluation.analysis.metrics import METRICS, RECONSTRUCTION
from evaluation.runs.cell_files import read_rows
from isac_track.errors import DataError
from isac_track.intervals import cluster_sums, cluster_weights, ratio_estimate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import pyarrow as pa

    from evaluation.analysis.families import Family
    from evaluation.runs.cell_files import LinkageOutcome
    from isac_track.intervals import Estimate
    from isac_track.types import Bools, Floats, Ints

N_REPLICATES = 1000

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
]
_POSITIONS = [METRICS[name] for name in RECONSTRUCTION]
_SHARED_COLUMNS = ["group", *(one.column for one in _POSITIONS if not one.over)]
_ATTACK_COLUMNS = [*_SHARED_COLUMNS, *(one.over for one in _POSITIONS if one.over)]
_PREDICTOR_COLUMNS = [
    "group",
    "conflict",
    "predicted",
    "separation_m",
    "predicted_separation_m",
    "probability",
]


_COLUMNS_OF = {
    "shared": _SHARED_COLUMNS,
    "attack": _ATTACK_COLUMNS,
    "predictor": _PREDICTOR_COLUMNS,
}


@dataclass(frozen=True, eq=False, slots=True)
class Scored:
    """What a predictor said of every scene of one mechanism level: the material of its curves."""

    mechanism: str
    level: float | None
    consumer: str
    cluster: Ints
    """(S,)"""
    conflict: Bools
    """(S,)"""
    separation_m: Floats
    """(S,) m, predicted"""
    probability: Floats
    """(S,) of a conflict; NaN without a covariance"""


def estimates(
    out: Path, manifest: Mapping[str, Any]
) -> tuple[dict[Key, Estimate], tuple[Scored, ...]]:
    """Return every metric of the scenes with its interval and replicates, and the scores.

    Raises
    ------
    DataError
        If a cell cannot be read.
    """
    weights = weights_of(manifest)
    n_clusters = weights.shape[1]
    found: dict[Key, Estimate] = {}
    scored: list[Scored] = []
    for entry in manifest["cells"]:
        if entry["kind"] not in _COLUMNS_OF:
            continue
        table = read_rows(out, entry, columns=_COLUMNS_OF[entry["kind"]])
        cluster = clusters(table, manifest)
        if entry["kind"] == "predictor":
            scored.append(
                Scored(
                    mechanism=entry["mechanism"],
                    level=entry["level"],
                    consumer=entry["consumer"],
                    cluster=cluster,
                    conflict=table["conflict"].to_numpy(),
                    separation_m=table["predicted_separation_m"].to_numpy(),
                    probability=table["probability"].to_numpy(),
                )
            )
            ratios = _predictor_ratios(table)
        else:
            ratios = _descriptor_ratios(table)
        for metric, (numerator, denominator) in ratios.items():
            estimate = ratio_estimate(
                numerator=cluster_sums(values=numerator, cluster=cluster, n_clusters=n_clusters),
                denominator=cluster_sums(
                    values=denominator, cluster=cluster, n_clusters=n_clusters
                ),
                weights=weights,
                is_share=METRICS[metric].is_share,
            )
            if METRICS[metric].is_root:
                estimate = _root(estimate)
            key = Key(
                entry["mechanism"], entry["level"], entry["consumer"], metric, entry["knowledge"]
            )
            found[key] = estimate
    return found, tuple(scored)


def linkage_estimates(
    read: Sequence[tuple[Mapping[str, Any], LinkageOutcome]],
) -> dict[Key, Estimate]:
    """Return every metric of the linkage cells; `read` is what `linkability.cards` returns."""
    return {
        Key(entry["mechanism"], entry["level"], entry["consumer"], metric, entry["knowledge"]): one
        for entry, card in read
        for metric, one in card.estimates.items()
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
    names = column.dictionary.to_pylist()
    unknown = [name for name in names if name not in row_of]
    if unknown:
        raise DataError(
            f"the manifest does not name group {unknown[0]!r} of the cells: it is damaged; run the "
            "matrix again with --fresh"
        )
    to_row = np.array([row_of[name] for name in names], dtype=np.int64)
    found: Ints = to_row[column.indices.to_numpy()]
    return found


def to_frame(
    found: Mapping[Key, Estimate], *, known: Mapping[str, Family], dataset: str
) -> pd.DataFrame:
    """Return the tidy summary; the first six columns are unique together.

    Parameters
    ----------
    found : mapping
    known : mapping
        The mechanisms of the run, from `families`.
    dataset : str
        Of the run.
    """
    rows = [
        {
            "dataset": dataset_of(key.consumer, dataset=dataset),
            "mechanism": key.mechanism,
            "level": np.nan if key.level is None else key.level,
            "consumer": key.consumer,
            "knowledge": key.knowledge,
            "metric": key.metric,
            "value": estimate.value,
            "ci_low": estimate.ci_low,
            "ci_high": estimate.ci_high,
            "n": estimate.n,
            "unit": METRICS[key.metric].summary_unit,
            "family": known[key.mechanism].family,
            "adding": known[key.mechanism].adding,
        }
        for key, estimate in found.items()
    ]
    return pd.DataFrame(rows, columns=COLUMNS)


def _descriptor_ratios(table: pa.Table) -> dict[str, tuple[Floats, Floats]]:
    """Return numerator and denominator of each metric, (R,): of what was shared, or of an attack.

    Of an attack also the ratio to the linear benchmark: sums over the same tracks.
    """
    ratios = {}
    for metric in _POSITIONS:
        if metric.over and metric.over not in table.column_names:
            continue
        values = table[metric.column].to_numpy()
        over = table[metric.over].to_numpy() if metric.over else np.ones_like(values)
        # A one-sample track that leaks has no exposure length (NaN): it does not count there.
        known = ~np.isnan(values if not metric.over else over)
        ratios[metric.name] = (
            np.where(known & ~np.isnan(values), values, 0.0),
            np.where(known, over, 0.0),
        )
    return ratios


def _predictor_ratios(table: pa.Table) -> dict[str, tuple[Floats, Floats]]:
    conflict = table["conflict"].to_numpy()
    predicted = table["predicted"].to_numpy()
    error_m = np.abs(table["predicted_separation_m"].to_numpy() - table["separation_m"].to_numpy())
    return {
        "missed_conflict_rate": (
            (conflict & ~predicted).astype(np.float64),
            conflict.astype(np.float64),
        ),
        "false_alarm_rate": (
            (~conflict & predicted).astype(np.float64),
            (~conflict).astype(np.float64),
        ),
        "distance_mae": (error_m, np.ones_like(error_m)),
    }


def _root(estimate: Estimate) -> Estimate:
    return type(estimate)(
        value=float(np.sqrt(estimate.value)),
        ci_low=float(np.sqrt(estimate.ci_low)),
        ci_high=float(np.sqrt(estimate.ci_high)),
        n=estimate.n,
        replicates=np.sqrt(estimate.replicates),
    )
