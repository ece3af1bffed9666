"""Rows of the cells of tracks by seed and block, which intervals draw."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from attacks.following.tracks import TrackFollowing, follow_tracks
from evaluation.compute.tables import ROWS
from isac_track.tracking.counts import BlockCounts, Blocks, hota_blocks, track_counts
from isac_track.tracking.knowledge import TRACK_ESTIMATORS, known_instants

if TYPE_CHECKING:
    from evaluation.compute.tables import Rows
    from evaluation.compute.tracking_setup import SeedRelease, TrackingSetup
    from isac_track.types import Floats

ALARMS: Final = "alarms"  # Further table of a robot's cell.
# Further tables of a cell of tracks.
FOLLOWED: Final = "followed"
HOTA: Final = "hota"


TRACK_METRICS: Final = (
    "gospa",
    "ospa",
    "purity",
    "id_switches",
    "fragments",
)
"""Metrics of the tracking field in the cells of tracks."""
ROBOT_SHARES: Final = (
    "missed_conflict_rate",
    "missed_future_rate",
    "missed_encounter_rate",
)
_PLACE: Final = ("seed", "block")
TRACK_COLUMNS: Final = (
    *_PLACE,
    *(f"{name}_{part}" for name in TRACK_METRICS for part in ("sum", "over")),
    *(f"known_{estimator}" for estimator in TRACK_ESTIMATORS),
    "instants",
    "rejoined_share_sum",
    "rejoined_share_over",
)
"""Columns of the cells of tracks."""
FOLLOWED_COLUMNS: Final = (*_PLACE, "present_s", "followed_s", "until_s", "ending")
"""Columns of `FOLLOWED`: a row for each seed and person, in the block of the start."""
ROBOT_COLUMNS: Final = (
    *_PLACE,
    *(f"{name}_{part}" for name in ROBOT_SHARES for part in ("sum", "over")),
    "false_alarms_sum",
    "false_alarms_over",
    "allowed",
)
"""Columns of the cells of robots with tracks."""
ALARM_COLUMNS: Final = (*_PLACE, "step", "alarms", "warned")
"""Columns of `ALARMS`: a row for each seed, block and alarm distance."""
HOTA_COLUMNS: Final = (*_PLACE, "step", "association", "pairs")
"""Columns of `HOTA`: a row for each seed, block and least similarity."""


def track_tables(releases: list[SeedRelease], setup: TrackingSetup) -> dict[str, Rows]:
    """Return the tables of tracks: `TRACK_COLUMNS`, and those of further tables."""
    followed = [follow_tracks(setup.patrol, release.shared) for release in releases]
    return {
        ROWS: track_rows(releases, setup) | _rejoined_columns(followed, setup.blocks),
        FOLLOWED: _followed_rows(followed, setup),
        HOTA: _hota_rows(releases, setup.blocks),
    }


def _rejoined_columns(followed: list[TrackFollowing], blocks: Blocks) -> Rows:
    """Return breaks of tracks, and those that the adversary joins, (S B,)."""
    counts = [
        BlockCounts(
            blocks.count(each.break_s[each.is_joined]), blocks.count(each.break_s)
        )
        for each in followed
    ]
    return count_columns("rejoined_share", counts)


def _hota_rows(releases: list[SeedRelease], blocks: Blocks) -> Rows:
    """Return the parts of HOTA by seed, block and level, (S B A,)."""
    seeds = [hota_blocks(blocks, release.hota) for release in releases]
    n_levels = len(seeds[0].n_union)
    rows = {
        name: np.repeat(column, n_levels)
        for name, column in seed_block_columns(len(seeds), blocks.n).items()
    }
    rows["step"] = np.tile(np.arange(n_levels, dtype=np.int32), len(seeds) * blocks.n)
    rows["association"] = np.concatenate([seed.association.T.ravel() for seed in seeds])
    rows["pairs"] = np.concatenate([seed.n_union.T.ravel() for seed in seeds])
    return rows


def _followed_rows(followed: list[TrackFollowing], setup: TrackingSetup) -> Rows:
    """Return the rows of followed people, (S N,)."""
    people = setup.patrol.people
    block = setup.blocks.numbers(people.t[people.offsets[:-1]])
    seeds = np.arange(len(followed), dtype=np.int32)
    return {
        "seed": np.repeat(seeds, block.size),
        "block": np.tile(block.astype(np.int32), seeds.size),
        **{
            name: np.concatenate([getattr(each, name) for each in followed])
            for name in ("present_s", "followed_s", "until_s")
        },
        "ending": np.concatenate([each.ending for each in followed]).astype(np.int32),
    }


def track_rows(releases: list[SeedRelease], setup: TrackingSetup) -> Rows:
    """Return the counts of tracks by seed and block, (S B,)."""
    blocks, grid = setup.blocks, setup.patrol.grid
    rows = seed_block_columns(len(releases), blocks.n)
    counts = [
        track_counts(blocks, release.shared, release.scans) for release in releases
    ]
    for name in TRACK_METRICS:
        rows |= count_columns(name, [by_name[name] for by_name in counts])
    known = [
        known_instants(
            setup.patrol,
            release.shared,
            guesses=setup.guesses,
            epsilon_m=setup.stages.privacy.epsilon_m,
            estimators=TRACK_ESTIMATORS,
        )
        for release in releases
    ]
    for number, estimator in enumerate(TRACK_ESTIMATORS):
        rows[f"known_{estimator}"] = np.concatenate(
            [blocks.count(grid.t[flags[number]]) for flags in known]
        )
    rows["instants"] = np.tile(blocks.count(grid.t), len(releases))
    return rows


def seed_block_columns(n_seeds: int, n_blocks: int) -> Rows:
    """Return the columns that identify a seed and a block, (S B,)."""
    return {
        "seed": np.repeat(np.arange(n_seeds, dtype=np.int32), n_blocks),
        "block": np.tile(np.arange(n_blocks, dtype=np.int32), n_seeds),
    }


def count_columns(name: str, seeds: list[BlockCounts]) -> Rows:
    """Return the columns of a metric's counts, (S B,)."""
    return {
        f"{name}_sum": np.concatenate([seed.numerator for seed in seeds]),
        f"{name}_over": np.concatenate([seed.denominator for seed in seeds]),
    }


def by_seed(rows: Mapping[str, Floats], column: str) -> Floats:
    """Return a column of rows by block and seed, (B, S)."""
    n_seeds = int(rows["seed"].max()) + 1
    return np.asarray(rows[column].reshape(n_seeds, -1).T)


def by_step(alarms: Mapping[str, Floats], column: str) -> Floats:
    """Return a column of `ALARMS`, (1 + D, B, S), or of `HOTA`, (A, B, S)."""
    n_seeds, n_steps = (int(alarms[name].max()) + 1 for name in ("seed", "step"))
    return np.asarray(
        np.moveaxis(alarms[column].reshape(n_seeds, -1, n_steps), 0, -1).swapaxes(0, 1)
    )
