"""Times to a conflict, `conflict_times.csv`, and robots that lose to standing still."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from evaluation.estimates.keys import EstimatesByAddress
from evaluation.estimates.metrics import MISSED_RATE
from evaluation.estimates.summary import bootstrap_weights, clusters
from evaluation.plan.address import Address, parse_consumer
from evaluation.plan.presets import BASELINE
from evaluation.plan.world import World
from evaluation.store.cell_files import read_rows
from evaluation.store.entries import Entry, horizons_in
from isac_track.intervals import (
    FEWEST_EFFECTIVE,
    Estimate,
    cluster_sums,
    difference,
    ratio_estimates,
)

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


def beaten_by_standing_still(
    own: EstimatesByAddress, later: Mapping[float, EstimatesByAddress]
) -> list[dict[str, Any]]:
    """Return the levels where a robot surely misses more than `BASELINE`, by horizon.

    There is a record for each robot and horizon. `own` is of the run's own horizon,
    `later` of longer horizons. The comparison is paired, same scenes and draws, at the
    same level; fewer than `FEWEST_EFFECTIVE` effective clusters decide nothing.
    `levels` counts the levels compared, `loses` lists those where the robot loses.
    """
    records = []
    for horizon_s, at_horizon in ((None, own), *later.items()):
        robots: dict[str, list[dict[str, Any]]] = {}
        for key, missed in at_horizon.items():
            still = at_horizon.get(parse_consumer(BASELINE).at(*key.where, MISSED_RATE))
            if (
                key.metric == MISSED_RATE
                and key.consumer != BASELINE
                and still is not None
            ):
                compared = _compared(missed, still)
                about = {"mechanism": key.mechanism, "level": key.level}
                robots.setdefault(key.consumer, []).append(about | compared)
        for robot, levels in robots.items():
            loses = [level for level in levels if level["ci_low"] > 0]
            about = {"robot": robot, "horizon_s": horizon_s, "levels": len(levels)}
            records.append(about | {"loses": loses})
    return records


def _compared(missed: Estimate, still: Estimate) -> dict[str, float]:
    rise = difference(missed, still)
    effective = min(missed.n_effective, still.n_effective)
    is_known = effective >= FEWEST_EFFECTIVE
    return {
        "missed": missed.value,
        "standing_still": still.value,
        "difference": rise.value,
        "ci_low": rise.ci_low if is_known else np.nan,
        "ci_high": rise.ci_high if is_known else np.nan,
        "n": missed.n,
    }
