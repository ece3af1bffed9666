"""Estimates of tracks: how they are associated, what they reveal, what robots miss.

Intervals draw blocks of the recording and seeds of sensing, both with replacement: they
are conditional on the recording. The numbers are rows of `summary.csv`, whose column
`policy` names release and tracker.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from attacks.following.followed import restricted_mean_s
from attacks.following.logs import Ending
from evaluation.compute.tables import ROWS
from evaluation.compute.track_links import LINK_COLUMNS
from evaluation.compute.track_policies import LOG_COLUMNS
from evaluation.compute.track_rows import (
    ALARM_COLUMNS,
    ALARMS,
    FOLLOWED,
    FOLLOWED_COLUMNS,
    HOTA,
    HOTA_COLUMNS,
    ROBOT_COLUMNS,
    ROBOT_SHARES,
    TRACK_COLUMNS,
    TRACK_METRICS,
    by_seed,
    by_step,
)
from evaluation.estimates.metrics import (
    CHANCE,
    DISCLOSED,
    FUTURE_EQUAL_ALARMS,
    KNOWN_SHARE,
    METRICS,
    RANK1,
)
from evaluation.estimates.patrols import PatrolNumber
from evaluation.plan.constants import ORACLE, SHARED
from evaluation.plan.consumer import LOG, TRACK_KINDS
from evaluation.store.cell_files import read_rows
from isac_track.tracking.blocks import (
    block_hota,
    block_missed_at_equal_alarms,
    block_ratio,
    block_statistic,
)
from isac_track.tracking.knowledge import TRACK_ESTIMATORS

if TYPE_CHECKING:
    from evaluation.compute.tables import Rows
    from evaluation.plan.address import Address
    from evaluation.store.entries import Entry
    from isac_track.intervals import Estimate
    from isac_track.types import Bools, Floats

_BESIDE: Final = (
    *TRACK_COLUMNS,
    *LOG_COLUMNS,
    *LINK_COLUMNS,
    *FOLLOWED_COLUMNS,
    *ROBOT_COLUMNS,
    *ALARM_COLUMNS,
    *HOTA_COLUMNS,
)
"""Columns of all tables of tracks in a file."""
LINKABLE: Final = "linkable_share"
REJOINED: Final = "rejoined_share"
BLIND: Final = "blind"  # The adversary that joins tracks without identities.
_FALSE_ALARMS_PER_MIN: Final = "false_alarms_per_min"


def track_numbers(out: Path, manifest: Mapping[str, Any]) -> list[PatrolNumber]:
    """Return all metrics of the tracks of a run; DataError if a cell is broken."""
    seed = int(manifest["identity"]["seed"])
    numbers: list[PatrolNumber] = []
    for entry in manifest["cells"]:
        if entry.kind in TRACK_KINDS:
            metrics = _READERS[entry.kind](out, entry, seed=seed)
            numbers += [
                PatrolNumber(address.measured(name), estimate)
                for (address, name), estimate in metrics.items()
            ]
    return numbers


_Metrics: TypeAlias = "dict[tuple[Address, str], Estimate]"


def _track_metrics(out: Path, entry: Entry, *, seed: int) -> _Metrics:
    """Return the metrics of the tracking field, and the known share of an adversary.

    The adversary knows to whom each track belongs; its estimator is the best of all.
    """
    rows = _read(out, entry, TRACK_COLUMNS)
    metrics = {
        (entry.address, name): _ratio(rows, name, seed=seed) for name in TRACK_METRICS
    }
    levels = _read(out, entry, HOTA_COLUMNS, table=HOTA)
    metrics[entry.address, "hota"] = block_hota(
        association=by_step(levels, "association"),
        n_union=by_step(levels, "pairs"),
        seed=seed,
    )
    known = [by_seed(rows, f"known_{estimator}") for estimator in TRACK_ESTIMATORS]
    best = int(np.argmax([counts.sum() for counts in known]))
    log = replace(entry.address, plugin=LOG, adversary=ORACLE)
    metrics[log, KNOWN_SHARE] = block_ratio(
        numerator=known[best], denominator=by_seed(rows, "instants"), seed=seed
    )
    follower = replace(entry.address, plugin=LOG, adversary=BLIND)
    metrics[follower, REJOINED] = _ratio(rows, REJOINED, seed=seed)
    followed = _read(out, entry, FOLLOWED_COLUMNS, table=FOLLOWED)
    n_blocks = by_seed(rows, "instants").shape[0]
    for name, estimate in _followed_metrics(followed, n_blocks, seed=seed).items():
        metrics[follower, name] = estimate
    return metrics


def _log_metrics(out: Path, entry: Entry, *, seed: int) -> _Metrics:
    """Return what logs of a policy's answers disclose, and what they reveal."""
    rows = _read(out, entry, LOG_COLUMNS)
    known = [by_seed(rows, f"known_{estimator}") for estimator in TRACK_ESTIMATORS]
    best = int(np.argmax([counts.sum() for counts in known]))
    answers = replace(entry.address, plugin=SHARED, adversary="")
    counts = {
        (entry.address, KNOWN_SHARE): known[best],
        (answers, DISCLOSED): by_seed(rows, "disclosed"),
    }
    return {
        key: block_ratio(
            numerator=numerator, denominator=by_seed(rows, "instants"), seed=seed
        )
        for key, numerator in counts.items()
    }


def _link_metrics(out: Path, entry: Entry, *, seed: int) -> _Metrics:
    """Return how many people are linked across a rotation of pseudonyms.

    Its denominator is all people who are present on both sides. `LINKABLE` is the share
    with a track of their own on both: no linker links more.
    """
    rows = _read(out, entry, LINK_COLUMNS)
    columns = {RANK1: "hits", CHANCE: "chance", LINKABLE: "linkable"}
    return {
        (entry.address, name): block_ratio(
            numerator=by_seed(rows, column),
            denominator=by_seed(rows, "trials"),
            seed=seed,
        )
        for name, column in columns.items()
    }


def _followed_metrics(rows: Rows, n_blocks: int, *, seed: int) -> dict[str, Estimate]:
    """Return how long an adversary without identities follows people.

    A sure wrong link, or a track that swaps its person, ends no time to confusion: the
    adversary does not notice. It ends the time within one chain.
    """
    n_seeds = int(rows["seed"].max()) + 1
    shape = (n_blocks, n_seeds)

    def sums(values: Floats | Bools) -> Floats:
        total = np.zeros(shape)
        np.add.at(total, (rows["block"], rows["seed"]), values)
        return total

    everybody = np.ones(rows["seed"].size)
    metrics = {
        "followed_s": block_ratio(
            numerator=sums(rows["followed_s"]),
            denominator=sums(everybody),
            seed=seed,
            is_share=False,
        )
    }
    for limit_s in (10, 30):
        is_present = rows["present_s"] >= limit_s
        is_followed = is_present & (rows["followed_s"] >= limit_s)
        metrics[f"followed_{limit_s}s"] = block_ratio(
            numerator=sums(is_followed), denominator=sums(is_present), seed=seed
        )
    seen = rows["ending"] != Ending.UNSEEN
    is_confused = rows["ending"] == Ending.CONFUSED
    metrics["time_to_confusion_s"] = block_statistic(
        lambda weights: restricted_mean_s(rows["until_s"], is_confused, weights * seen),
        block=rows["block"],
        seed_number=rows["seed"],
        counted=sums(seen),
        seed=seed,
    )
    return metrics


def _robot_metrics(out: Path, entry: Entry, *, seed: int) -> _Metrics:
    """Return what a robot with tracks misses, and its false alarms."""
    rows = _read(out, entry, ROBOT_COLUMNS)
    robot = entry.address
    metrics = {(robot, name): _ratio(rows, name, seed=seed) for name in ROBOT_SHARES}
    alarms = _read(out, entry, ALARM_COLUMNS, table=ALARMS)
    metrics[robot, FUTURE_EQUAL_ALARMS] = block_missed_at_equal_alarms(
        # The last row repeats the row before.
        alarms=by_step(alarms, "alarms")[:-1],
        warned=by_step(alarms, "warned"),
        allowed=by_seed(rows, "allowed"),
        seed=seed,
    )
    metrics[robot, _FALSE_ALARMS_PER_MIN] = block_ratio(
        numerator=by_seed(rows, "false_alarms_sum"),
        denominator=by_seed(rows, "false_alarms_over"),
        seed=seed,
        is_share=False,
    )
    return metrics


_READERS: Final = {
    "tracks": _track_metrics,
    "track_log": _log_metrics,
    "tracked": _robot_metrics,
    "track_link": _link_metrics,
}
"""The function that reads the metrics of a cell, by the kind of its consumer."""


def _ratio(rows: Rows, name: str, *, seed: int) -> Estimate:
    return block_ratio(
        numerator=by_seed(rows, f"{name}_sum"),
        denominator=by_seed(rows, f"{name}_over"),
        seed=seed,
        is_share=METRICS[name].is_share,
    )


def _read(
    out: Path, entry: Entry, columns: tuple[str, ...], *, table: str = ROWS
) -> Rows:
    """Return the columns of a table of a cell."""
    read = partial(read_rows, out, entry, beside=_BESIDE)
    rows = read(columns=columns, table=table)
    return {name: rows[name].to_numpy() for name in columns}
