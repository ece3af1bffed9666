"""Robots that surely miss more conflicts than standing still."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from evaluation.estimates.keys import EstimatesByAddress
from evaluation.estimates.metrics import MISSED_RATE
from evaluation.plan.address import parse_consumer
from evaluation.plan.presets import BASELINE
from isac_track.intervals import FEWEST_EFFECTIVE, Estimate, difference


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
            still = at_horizon.get(
                parse_consumer(BASELINE).at(*key.mechanism_level, MISSED_RATE)
            )
            if (
                key.metric == MISSED_RATE
                and key.consumer != BASELINE
                and still is not None
            ):
                compared = _miss_record(missed, still)
                about = {"mechanism": key.mechanism, "level": key.level}
                robots.setdefault(key.consumer, []).append(about | compared)
        for robot, levels in robots.items():
            loses = [level for level in levels if level["ci_low"] > 0]
            about = {"robot": robot, "horizon_s": horizon_s, "levels": len(levels)}
            records.append(about | {"loses": loses})
    return records


def _miss_record(missed: Estimate, still: Estimate) -> dict[str, float]:
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
