"""Counts of tracks in blocks of a recording: every metric is a ratio of two of them.

Blocks and seeds of sensing are what intervals draw (`isac_track.tracking.blocks`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isac_track.patrols.equal_alarms import DISTANCES_M, first_alarms
from isac_track.patrols.patrol import Patrol
from isac_track.patrols.utility import (
    Counts,
    false_alarm_starts,
    missed_conflicts,
    missed_encounters,
    missed_futures,
)
from isac_track.tracking.blocks import block_numbers
from isac_track.tracking.hota import HotaScans
from isac_track.tracking.metrics import (
    GospaScans,
    fragment_starts,
    identity_switches,
    pure_samples,
)
from isac_track.tracking.sharing import SharedTracks
from isac_track.tracking.utility import Foresight
from isac_track.types import Bools, Floats, Ints

GOSPA_CUTOFF_M = 1.0
_MINUTE_S = 60.0


@dataclass(frozen=True, eq=False, slots=True)
class BlockCounts:
    """Numerator and denominator of a metric in B blocks."""

    numerator: Floats  # (B,)
    denominator: Floats  # (B,)


@dataclass(frozen=True, eq=False)
class Blocks:
    """B blocks of a patrol of `length_s` each; the last may be shorter."""

    patrol: Patrol
    length_s: float

    @cached_property
    def n(self) -> int:
        """Number of blocks."""
        last_s = max(self.patrol.people.t.max(), self.patrol.grid.t.max())
        blocks = (last_s - self.patrol.scan_s[0]) / self.length_s
        return max(1, int(np.ceil(blocks - 1e-9)))

    def numbers(self, t: Floats) -> Ints:
        """Return the block of each instant, (M,)."""
        block = block_numbers(t, start_s=self.patrol.scan_s[0], block_s=self.length_s)
        # The last instant does not begin a block of its own.
        return np.minimum(block, self.n - 1)

    def count(self, t: Floats, values: Floats | Ints | None = None) -> Floats:
        """Sum values, or count instants, in each block, (B,)."""
        sums = np.bincount(self.numbers(t), weights=values, minlength=self.n)
        return sums.astype(np.float64)


def track_counts(
    blocks: Blocks, shared: SharedTracks, scans: GospaScans
) -> dict[str, BlockCounts]:
    """Return the counts of metrics of the tracking field, by name.

    `scans` has the cut-off `GOSPA_CUTOFF_M`. Switches and fragments are per minute of a
    person's presence, missed people and false tracks per person and scan.
    """
    patrol, t = blocks.patrol, shared.release.t
    samples = blocks.count(patrol.people.t)
    minutes = samples * patrol.ahead_s[1] / _MINUTE_S
    is_pure = pure_samples(shared)
    scan_s = patrol.scan_s[: scans.distance.size]
    per_scan = blocks.count(scan_s)
    counts = {
        "gospa": (blocks.count(scan_s, scans.distance), per_scan),
        "ospa": (blocks.count(scan_s, scans.ospa(cutoff_m=GOSPA_CUTOFF_M)), per_scan),
        "purity": (blocks.count(t[is_pure]), blocks.count(t)),
        "id_switches": (_events(blocks, identity_switches(shared)), minutes),
        "fragments": (_events(blocks, fragment_starts(shared)), minutes),
        "missed_people": (blocks.count(scan_s, scans.missed), samples),
        "false_tracks": (blocks.count(scan_s, scans.false), samples),
    }
    return {name: BlockCounts(*pair) for name, pair in counts.items()}


@dataclass(frozen=True, eq=False, slots=True)
class HotaBlocks:
    """Parts of HOTA in B blocks, for A least similarities; see `HotaScans`."""

    association: Floats  # (A, B)
    n_union: Floats  # (A, B)


def hota_blocks(blocks: Blocks, scans: HotaScans) -> HotaBlocks:
    """Sum the parts of HOTA in blocks.

    How well two tracks agree rests on the whole recording: a block has its matches'
    share.
    """
    scan_s = blocks.patrol.scan_s[: len(scans.n_union)]
    association, n_union = (
        np.array([blocks.count(scan_s, level) for level in part.T])
        for part in (scans.association, scans.n_union)
    )
    return HotaBlocks(association, n_union)


def _events(blocks: Blocks, scan: Ints) -> Floats:
    """Count events at scans in each block, (B,)."""
    return blocks.count(blocks.patrol.scan_s[scan])


@dataclass(frozen=True, eq=False, slots=True)
class AlarmBlocks:
    """False alarms and warnings over D alarm distances in B blocks, of all robots."""

    alarms: Floats  # (D, B) queries with a false alarm.
    # (D + 1, B) future conflicts by the shortest distance that warns; last: none does.
    warned: Floats


@dataclass(frozen=True, eq=False, slots=True)
class RobotCounts:
    """What all robots of a patrol foresee from tracks and miss, in B blocks."""

    shares: Mapping[str, BlockCounts]  # Misses, by metric.
    false_alarms: BlockCounts  # Runs of queries; and minutes of all robots.
    false_queries: BlockCounts  # Queries with a false alarm; and queries of all robots.
    by_distance: AlarmBlocks


def robot_counts(
    blocks: Blocks,
    foresight: Foresight,
    *,
    actual: Ints,
    entries: Ints,
    horizon: int,
    scans_per_query: int,
) -> RobotCounts:
    """Count what robots foresee and miss within a horizon, in scans.

    `actual`, (E, R), and `entries`, (N, R), are the true conflicts
    (`true_conflicts`, `first_entries`). A false alarm is a warning without a conflict
    at that query; those of tracks of nobody count.
    """
    patrol, warned = blocks.patrol, foresight.foreseen
    query_s = patrol.scan_s[patrol.query_scan]
    asked_s = query_s[patrol.presences.query]
    per_query = blocks.count(query_s) * patrol.n_robots
    encounters = missed_encounters(
        patrol, entries, warned, lead=horizon, scans_per_query=scans_per_query
    )
    conflict = np.zeros((query_s.size, patrol.n_robots), dtype=bool)
    np.logical_or.at(conflict, patrol.presences.query, actual <= horizon)
    alarm = foresight.alarms(patrol, horizon=horizon)
    minutes = per_query * patrol.query_s / _MINUTE_S
    shares = {
        "missed_conflict_rate": _share(
            blocks, asked_s, missed_conflicts(actual, warned, horizon=horizon)
        ),
        "missed_future_rate": _share(
            blocks, asked_s, missed_futures(actual, warned, horizon=horizon)
        ),
        "missed_encounter_rate": _encounter_share(blocks, entries, encounters),
    }
    return RobotCounts(
        shares=shares,
        false_alarms=BlockCounts(
            blocks.count(query_s, false_alarm_starts(alarm, conflict).sum(axis=1)),
            minutes,
        ),
        false_queries=BlockCounts(
            blocks.count(query_s, (alarm & ~conflict).sum(axis=1)), per_query
        ),
        by_distance=_alarm_blocks(blocks, foresight, actual, conflict, horizon=horizon),
    )


def _share(blocks: Blocks, t: Floats, counts: Counts) -> BlockCounts:
    """Return hits and trials of rows at instants, (E,), by block."""
    hits = (counts.hits & counts.trials).sum(axis=1)
    return BlockCounts(
        blocks.count(t, hits), blocks.count(t, counts.trials.sum(axis=1))
    )


def _encounter_share(blocks: Blocks, entries: Ints, encounters: Counts) -> BlockCounts:
    """Return missed encounters and all, (N, R), by the block of the encounter."""
    person, robot = np.nonzero(encounters.trials)
    t = blocks.patrol.scan_s[entries[person, robot]]
    return BlockCounts(
        blocks.count(t, encounters.hits[person, robot].astype(np.int64)),
        blocks.count(t),
    )


def _alarm_blocks(
    blocks: Blocks,
    foresight: Foresight,
    actual: Ints,
    conflict: Bools,
    *,
    horizon: int,
) -> AlarmBlocks:
    """Count alarms and warnings over the distance at which a robot alarms."""
    patrol, n_steps = blocks.patrol, DISTANCES_M.size
    nearest_m = foresight.nearest_m(patrol, horizon=horizon)
    nearest_m[conflict] = np.inf  # No alarm there is false.
    block = blocks.numbers(patrol.scan_s[patrol.query_scan])
    alarms = np.zeros((n_steps + 1, blocks.n))
    np.add.at(alarms, (first_alarms(nearest_m), block[:, None]), 1.0)
    presence, robot = np.nonzero((actual > 0) & (actual <= horizon))
    step = first_alarms(foresight.gaps_m[horizon][presence, robot])
    warned = np.zeros((n_steps + 1, blocks.n))
    np.add.at(warned, (step, block[patrol.presences.query[presence]]), 1.0)
    return AlarmBlocks(np.cumsum(alarms[:-1], axis=0), warned)
