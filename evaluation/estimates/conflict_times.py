"""Times to a conflict: `conflict_times.csv`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from evaluation.estimates.summary import bootstrap_weights, clusters
from evaluation.plan.address import Address
from evaluation.plan.world import World
from evaluation.store.cell_files import read_rows
from evaluation.store.entries import Entry, horizons_in
from isac_track.intervals import cluster_sums, ratio_estimates

N_TIMES: Final = 25  # Points of a distribution, from now to its last conflict.
TIME_COLUMNS: Final = ["dataset", "by_s", "value", "ci_low", "ci_high", "n"]
_COLUMNS: Final = ["group", "conflict", "time_to_conflict_s"]


def conflict_times(out: Path, manifest: Mapping[str, Any]) -> pd.DataFrame:
    """Return the share of conflicts that have begun by each time, at every horizon.

    `TIME_COLUMNS`: `by_s` is the time from now in s; at 0 are the conflicts in which a
    person is inside already; `value` is the share. All predictors and levels have the
    same scenes: those of the first are read. Raises DataError as `read_rows`.
    """
    frames = [pd.DataFrame(columns=TIME_COLUMNS, dtype=float)]
    name, robots = manifest["dataset"]["name"], dict[World, Entry]()
    for entry in manifest["cells"]:
        if entry.kind == "predictor":
            robots.setdefault(entry.address.world, entry)
    horizons_s = (None, *horizons_in(manifest["cells"]))
    for world in (World(horizon_s=horizon_s) for horizon_s in horizons_s):
        if world in robots:
            frame = _distribution(out, robots[world], manifest)
            dataset = Address(recording=name, world=world).dataset
            frames.append(frame.assign(dataset=dataset))
    return pd.concat(frames[1:] or frames, ignore_index=True)[TIME_COLUMNS]


def _distribution(out: Path, entry: Entry, manifest: Mapping[str, Any]) -> pd.DataFrame:
    table, weights = (
        read_rows(out, entry, columns=_COLUMNS),
        bootstrap_weights(manifest),
    )
    conflict, time_s = (table[column].to_numpy() for column in _COLUMNS[1:])
    by_s = np.linspace(0.0, np.nanmax(time_s, initial=0.0), N_TIMES)
    # The last time is the largest of all: rounding must not leave it out.
    inside = conflict & (time_s <= by_s[:, None] + 1e-9)
    cluster = clusters(table, manifest)
    conflicts, *sums = (
        cluster_sums(values=values * 1.0, cluster=cluster, n_clusters=weights.shape[1])
        for values in (conflict, *inside)
    )
    shares = ratio_estimates(
        numerator=np.array(sums),
        denominator=np.tile(conflicts, (N_TIMES, 1)),
        weights=weights,
        is_share=[True] * N_TIMES,
    )
    rows = [
        [time, share.value, share.ci_low, share.ci_high, share.n]
        for time, share in zip(by_s, shares, strict=True)
    ]
    # By the last time all conflicts have begun, by construction.
    rows[-1][2:4] = [np.nan, np.nan]
    return pd.DataFrame(rows, columns=TIME_COLUMNS[1:])
