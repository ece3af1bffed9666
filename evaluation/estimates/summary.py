"""From finished cells to numbers with intervals: `summary.csv`.

The unit is the source track, or the group that walks together: every interval draws
whole clusters, the same ones for every mechanism, so that differences are paired.
"""

from collections.abc import Mapping
from functools import lru_cache
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import pyarrow as pa

from evaluation.estimates.families import Family
from evaluation.estimates.keys import Found, Key
from evaluation.estimates.linkability import Cards, dataset_of
from evaluation.estimates.metrics import (
    BOUNDS,
    DESCRIPTORS,
    DISTANCE,
    EXPOSURE,
    GAP,
    METRICS,
    OF_ROBOT,
    RECONSTRUCTION,
    WORST_TENTH,
)
from evaluation.estimates.worst_off import person_means, worst_tenth
from evaluation.plan.constants import MODEL
from evaluation.store.cell_files import Summed, read_rows
from isac_track.intervals import (
    Estimate,
    cluster_sums,
    cluster_weights,
    ratio_estimates,
)
from isac_track.types import Floats, Ints, read_only

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
_POSITIONS = [
    METRICS[name] for name in (*RECONSTRUCTION, *DISTANCE) if METRICS[name].column
]
_SHARED = ["group", "scene", *(one.column for one in _POSITIONS if not one.over)]
_BOUNDS = [METRICS[name] for name in BOUNDS]
_COLUMNS_OF = {
    "shared": _SHARED,
    "attack": [*_SHARED, *(one.over for one in _POSITIONS if one.over)],
    "bound": ["group", *(one.column for one in _BOUNDS)],
    "predictor": [
        "group",
        "conflict",
        "inside_now",
        "predicted",
        "separation_m",
        "predicted_separation_m",
        "probability",
        OF_ROBOT,
    ],
}
_DECIDED = (
    "conflict",
    "inside_now",
    "predicted",
    "predicted_separation_m",
    "probability",
)
Scored: TypeAlias = "tuple[Mapping[str, Any], Ints, Mapping[str, Any]]"
"""What a predictor said of every scene of one mechanism level: the cell's entry in the manifest,
the scenes' clusters, (S,), and its columns `_DECIDED`."""


def estimates(
    out: Path, manifest: Mapping[str, Any], *, world: str = ""
) -> tuple[dict[Key, Estimate], tuple[Scored, ...], dict[Key, Summed]]:
    """Return every metric of the scenes with its interval and replicates, and the scores.

    The last are the descriptors after each attack, summed by cluster. All in the run's
    own world, or in another one. Raises DataError if a cell cannot be read.
    """
    weights = weights_of(manifest)
    n, names = weights.shape[1], tuple(manifest["groups"])
    found: dict[Key, Estimate] = {}
    scored: list[Scored] = []
    attacked: dict[Key, Summed] = {}
    able = (entry for entry in manifest["cells"] if entry["kind"] in _COLUMNS_OF)
    entries = [entry for entry in able if entry.get("world", "") == world]
    gap = [GAP] if MODEL in world else []
    every = {name for columns in (*_COLUMNS_OF.values(), gap) for name in columns}
    for _, of in groupby(entries, key=itemgetter("files")):
        keys, sums = [], []
        for entry in of:
            columns = [
                *_COLUMNS_OF[entry["kind"]],
                *(gap if entry["kind"] == "attack" else []),
            ]
            table = read_rows(out, entry, columns=columns, beside=every)
            cluster = clusters(table, manifest)
            if entry["kind"] == "predictor":
                told = {name: table[name].to_numpy() for name in _DECIDED}
                scored.append((entry, cluster, told))
            elif entry["kind"] != "bound":
                found[key_of(entry, WORST_TENTH)] = _worst_tenth(
                    table, cluster, weights
                )
            for metric, ratio in ratios(entry["kind"], table).items():
                keys.append(key_of(entry, metric))
                sums.append(
                    [
                        cluster_sums(values=x, cluster=cluster, n_clusters=n)
                        for x in ratio
                    ]
                )
        of_clusters = np.array(sums)
        used = np.flatnonzero(
            of_clusters.any(axis=(0, 1))
        )  # of thousands, hundreds are in scenes
        of_clusters = of_clusters[:, :, used]
        over, under, drawn = of_clusters[:, 0], of_clusters[:, 1], weights[:, used]
        shares = [METRICS[key.metric].is_share for key in keys]
        told_of = ratio_estimates(
            numerator=over, denominator=under, weights=drawn, is_share=shares
        )
        for key, one in zip(keys, told_of, strict=True):
            found[key] = one
            if METRICS[key.metric].is_root:
                value, low, high = np.sqrt(
                    [one.value, one.ci_low, one.ci_high]
                ).tolist()
                roots = np.sqrt(one.replicates)
                found[key] = Estimate(
                    value, low, high, one.n, roots, effective=one.effective
                )
        attacked |= {
            key: Summed(one, weights, used, names=names)
            for key, one in zip(keys, of_clusters, strict=True)
            if key.knowledge and key.metric in {*DESCRIPTORS, *DISTANCE}
        }
    return found, tuple(scored), attacked


def _worst_tenth(table: pa.Table, cluster: Ints, weights: Floats) -> Estimate:
    """Return PLR of the worst-off tenth of the people, of the rows of one consumer at one level."""
    values, scene = (
        table[name].to_numpy() for name in (METRICS[EXPOSURE].column, "scene")
    )
    n_clusters = weights.shape[1]
    means = person_means(
        values=values, scene=scene, cluster=cluster, n_clusters=n_clusters
    )
    return worst_tenth(means, weights=weights)


def key_of(entry: Mapping[str, Any], metric: str) -> Key:
    """Return what a metric of a cell of the manifest is about."""
    return Key(
        entry["mechanism"],
        entry["level"],
        entry["consumer"],
        metric,
        entry["knowledge"],
    )


def linkage_estimates(read: Cards) -> dict[Key, Estimate]:
    """Return every metric of the linkage cells; `read` is what `linkability.cards` returns."""
    return {
        key_of(entry, of): one
        for entry, card in read
        for of, one in card.estimates.items()
    }


def linkage_sums(read: Cards) -> dict[Key, Summed]:
    """Return the rank metrics of the attacks, summed by cluster."""
    return {
        key_of(entry, metric): one
        for entry, card in read
        for metric, one in card.sums.items()
    }


def weights_of(manifest: Mapping[str, Any]) -> Floats:
    """Return the bootstrap weights of a run, (B, C): the same for everything in it."""
    return _weights(len(manifest["groups"]), manifest["identity"]["seed"])


@lru_cache(maxsize=1)  # of thousands of people they take 60 MB
def _weights(n_clusters: int, seed: int) -> Floats:
    return read_only(
        cluster_weights(n_clusters=n_clusters, n_replicates=N_REPLICATES, seed=seed)
    )


def clusters(table: pa.Table, manifest: Mapping[str, Any]) -> Ints:
    """Return the cluster of each row, (R,): its row in the run's list of groups."""
    column = table["group"].combine_chunks()
    row_of = {group: row for row, group in enumerate(manifest["groups"])}
    to_row = np.array(
        [row_of[name] for name in column.dictionary.to_pylist()], dtype=np.int64
    )
    found: Ints = to_row[column.indices.to_numpy()]
    return found


def to_frame(
    found: Found,
    *,
    worlds: Mapping[str, Found],
    known: Mapping[str, Family],
    dataset: str,
) -> pd.DataFrame:
    """Return the tidy summary, `COLUMNS`; the first six of them are unique together.

    `worlds` is what was found in others, whose data sets say so; `known` are the run's
    mechanisms.
    """
    every = {dataset: found} | {
        f"{dataset}:{world}": other for world, other in worlds.items()
    }
    rows = [
        (
            dataset_of(key.consumer, dataset=name),
            key.mechanism,
            np.nan if key.level is None else key.level,
            key.consumer,
            key.knowledge,
            key.metric,
            one.value,
            one.ci_low,
            one.ci_high,
            one.n,
            METRICS[key.metric].summary_unit,
            known[key.mechanism].family,
            known[key.mechanism].adding,
        )
        for name, of in every.items()
        for key, one in of.items()
    ]
    return pd.DataFrame(rows, columns=COLUMNS)


def columns_of(kind: str) -> list[str]:
    """Return the columns of a cell of scenes that its metrics are made of."""
    return _COLUMNS_OF[kind]


def ratios(kind: str, table: pa.Table) -> dict[str, tuple[Floats, Floats]]:
    """Return numerator and denominator of each metric, (R,), of the R rows of a cell of this kind.

    Of an attack also the ratio to the linear benchmark: sums over the same tracks.
    """
    if kind == "predictor":
        _, *names = _COLUMNS_OF[kind]
        conflict, inside, predicted, truth, ours, _, own = (
            table[name].to_numpy() for name in names
        )
        known, future = ~np.isnan(own), conflict & ~inside
        return {
            "missed_conflict_rate": ((conflict & ~predicted) * 1.0, conflict * 1.0),
            "missed_future_rate": ((future & ~predicted) * 1.0, future * 1.0),
            "false_alarm_rate": ((~conflict & predicted) * 1.0, ~conflict * 1.0),
            "distance_mae": (np.abs(ours - truth), np.ones_like(ours)),
            **({OF_ROBOT: (np.nan_to_num(own), known * 1.0)} if known.any() else {}),
        }
    found = {}
    for metric in _BOUNDS if kind == "bound" else [*_POSITIONS, METRICS[GAP]]:
        if (metric.over or metric.column) not in table.column_names:
            continue
        values = table[metric.column].to_numpy()
        over = table[metric.over].to_numpy() if metric.over else np.ones_like(values)
        # A one-sample track that leaks has no exposure length (NaN): it does not count
        # there.
        known = ~np.isnan(over if metric.over else values)
        if known.any() or metric.name not in {*BOUNDS, GAP}:
            values = np.where(known & ~np.isnan(values), values, 0.0)
            found[metric.name] = values, np.where(known, over, 0.0)
    return found
