"""Cells of tracks.

They have how well trackers track, what robots miss with tracks, and whom an adversary
follows. Everything is drawn anew for each seed of sensing. Rows are per seed and block of the
recording, which intervals draw.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from attacks.following.tracks import TrackFollowing, follow_tracks
from evaluation.compute.current_cell import note_cell
from evaluation.compute.sharing import copy_for_user_plugin, guarded
from evaluation.compute.tables import ROWS
from isac_track.config import LINK
from isac_track.patrols import horizon_scans, make_patrol, query_scans, sense_people
from isac_track.patrols.knowledge import guesses_from_map
from isac_track.patrols.utility import first_entries, true_conflicts
from isac_track.plugins import parse
from isac_track.protocols import knowing
from isac_track.sharing import Raw
from isac_track.tracking.association import Likelihood
from isac_track.tracking.counts import (
    GOSPA_CUTOFF_M,
    BlockCounts,
    Blocks,
    RobotCounts,
    hota_blocks,
    robot_counts,
    track_counts,
)
from isac_track.tracking.detections import (
    DetectionSettings,
    clutter_density,
    detect_people,
)
from isac_track.tracking.hota import HotaScans, hota_scans
from isac_track.tracking.knowledge import TRACK_ESTIMATORS, known_instants
from isac_track.tracking.methods import track_patrol
from isac_track.tracking.metrics import GospaScans, gospa_scans
from isac_track.tracking.sharing import SharedTracks, perturb_detections, share_tracks
from isac_track.tracking.utility import Foresight, foresee_from_tracks

if TYPE_CHECKING:
    from evaluation.compute.tables import Rows
    from evaluation.plan.consumer import Consumer
    from isac_track.config import StageSettings
    from isac_track.patrols import Patrol
    from isac_track.plugins import Plugin
    from isac_track.tracking.detections import DetectedPatrol
    from isac_track.tracking.trackers import Tracked
    from isac_track.types import Floats, Ints, Tracks

CountsByHorizon: TypeAlias = "dict[int, RobotCounts]"
"""What robots miss, by horizon in scans."""
ALARMS: Final = "alarms"  # Further table of a robot's cell.
FOLLOWED: Final = "followed"  # Further table of a cell of tracks.
HOTA: Final = "hota"  # Further table of a cell of tracks.
_LEAST_DENSITY_PER_M2: Final = 0.005  # Of new people, assumed without clutter.
# A tracker that is certain of a detection ends a track at the first miss.
_ASSUMED: Final = (0.1, 0.99)
_USUAL_PROBABILITY: Final = 0.9  # That a tracker assumes with the link budget.


@dataclass(frozen=True, eq=False, slots=True)
class TrackedSeed:
    """The tracks of a tracker from the detections of a seed."""

    tracked: Tracked
    scans: GospaScans
    hota: HotaScans


@dataclass(frozen=True, eq=False, slots=True)
class SharedSeed:
    """The tracks that a mechanism shares, of a seed."""

    shared: SharedTracks
    scans: GospaScans
    hota: HotaScans
    # The same tracks with the detections as their tracker got them.
    raw: SharedTracks


@dataclass(frozen=True, eq=False)
class TrackingSetup:
    """A patrol, the detections of each seed, and what the consumers of tracks share.

    Detections and tracks without added noise are held as long as this object.
    """

    patrol: Patrol
    stages: StageSettings
    seed: int
    detected: dict[int, DetectedPatrol] = field(default_factory=dict)
    tracked: dict[tuple[str, int], TrackedSeed] = field(default_factory=dict)
    references: dict[str, list[CountsByHorizon]] = field(default_factory=dict)

    @property
    def seeds(self) -> range:
        """Seeds of sensing."""
        return range(self.seed, self.seed + self.stages.tracking.seeds)

    @cached_property
    def blocks(self) -> Blocks:
        """Blocks of the recording."""
        return Blocks(self.patrol, self.stages.tracking.block_s)

    @cached_property
    def guesses(self) -> Floats:
        """Guesses from the map of where people stand, (N, 2) m."""
        epsilon_m = self.stages.privacy.epsilon_m
        return guesses_from_map(self.patrol, epsilon_m=epsilon_m)

    @cached_property
    def actual(self) -> Ints:
        """Scans until each true conflict, (E, R)."""
        radius_m = self.stages.conflict.safety_radius_m
        return true_conflicts(self.patrol, safety_radius_m=radius_m)

    @cached_property
    def entries(self) -> Ints:
        """Scans of the first true entries, (N, R)."""
        radius_m = self.stages.conflict.safety_radius_m
        return first_entries(self.patrol, safety_radius_m=radius_m)

    @cached_property
    def likelihood(self) -> Likelihood:
        """What trackers assume about detections."""
        rules = self.stages.tracking
        probability = rules.detection_probability
        if probability == LINK:
            probability = _USUAL_PROBABILITY
        density = clutter_density(self.patrol, settings=_detection(self.stages))
        return Likelihood(
            detection_probability=float(np.clip(float(probability), *_ASSUMED)),
            density_per_m2=max(density, _LEAST_DENSITY_PER_M2),
        )

    def detections(self, seed: int) -> DetectedPatrol:
        """Return the detections of a seed; made at first use."""
        if seed not in self.detected:
            stages = self.stages
            self.detected[seed] = detect_people(
                self.patrol,
                sense_people(self.patrol, settings=stages, seed=seed),
                settings=_detection(stages),
                sensing=stages.sensing,
                seed=seed,
            )
        return self.detected[seed]

    def tracks(self, tracker: Plugin, seed: int) -> TrackedSeed:
        """Return the tracks of a seed's detections; made at first use."""
        key = tracker.name, seed
        if key not in self.tracked:
            self.tracked[key] = self.track(tracker, self.detections(seed))
        return self.tracked[key]

    def track(self, tracker: Plugin, detected: DetectedPatrol) -> TrackedSeed:
        """Track detections; PluginError names a tracker that fails."""
        tracked = guarded(
            f"tracker {tracker.name!r}",
            lambda: track_patrol(
                tracker.instance, detected, likelihood=self.likelihood
            ),
        )
        scans = gospa_scans(self.patrol, tracked, cutoff_m=GOSPA_CUTOFF_M)
        return TrackedSeed(tracked, scans, hota_scans(self.patrol, tracked))


def _detection(stages: StageSettings) -> DetectionSettings:
    """Return how the network of a run detects people."""
    rules, probability = stages.tracking, stages.tracking.detection_probability
    return DetectionSettings(
        probability=None if probability == LINK else float(probability),
        false_alarm_probability=rules.p_false_alarm,
        clutter_per_scan=rules.clutter_per_scan,
    )


def tracking_setup(
    recorded: Tracks, *, stages: StageSettings, seed: int
) -> TrackingSetup:
    """Make the patrol through a recording; DataError if nobody is present at a scan."""
    return TrackingSetup(
        make_patrol(recorded, settings=stages, seed=seed), stages, seed
    )


def share_tracked(
    mechanism: Plugin, tracker: Plugin, setup: TrackingSetup
) -> list[SharedSeed]:
    """Return the tracks that a mechanism shares, a release for each seed.

    With `tracking.noise=before` it acts on detections, which are tracked anew.
    PluginError names a mechanism or tracker that fails.
    """
    return [_share_seed(mechanism, tracker, setup, seed=seed) for seed in setup.seeds]


def _share_seed(
    mechanism: Plugin, tracker: Plugin, setup: TrackingSetup, *, seed: int
) -> SharedSeed:
    detected, name = setup.detections(seed), f"mechanism {mechanism.spec!r}"
    instance = mechanism.instance
    if instance == Raw():
        made = setup.tracks(tracker, seed)
        shared = share_tracks(detected, made.tracked, seed=seed)
        return SharedSeed(shared, made.scans, made.hota, raw=shared)
    own = replace(detected, sensed=copy_for_user_plugin(detected.sensed, mechanism))
    if setup.stages.tracking.noise == "before":
        noisy = guarded(
            name, lambda: perturb_detections(own, mechanism=instance, seed=seed)
        )
        made = setup.track(tracker, noisy)
        shared = share_tracks(noisy, made.tracked, seed=seed)
        return SharedSeed(shared, made.scans, made.hota, raw=shared)
    made = setup.tracks(tracker, seed)
    shared = guarded(
        name,
        lambda: share_tracks(own, made.tracked, seed=seed, mechanism=instance),
    )
    raw = share_tracks(detected, made.tracked, seed=seed)
    return SharedSeed(shared, made.scans, made.hota, raw=raw)


def release_rows(
    consumers: Iterable[Consumer],
    releases: list[SharedSeed],
    setup: TrackingSetup,
    *,
    mechanism: Plugin,
) -> Iterator[tuple[Consumer, dict[str, Rows]]]:
    """Yield the consumers of a tracker's releases, each with the rows of its tables.

    Forecasts of a robot are made once for all horizons, and held as long as this runs.
    """
    by_robot: dict[str, list[CountsByHorizon]] = {}
    for consumer in consumers:
        note_cell(mechanism.spec, consumer.label)
        robot = consumer.plugin
        if robot is None:
            yield consumer, track_tables(releases, setup)
            continue
        if robot.spec not in by_robot:
            by_robot[robot.spec] = [
                _robot_seed(robot, release.shared, setup, mechanism=mechanism)
                for release in releases
            ]
        yield consumer, robot_tables(consumer, by_robot[robot.spec], setup)


def _reference(robot: Plugin, setup: TrackingSetup) -> list[CountsByHorizon]:
    """Return what a robot misses with raw tracks of the oracle, for each seed.

    At its false alarms all others are compared.
    """
    if robot.spec not in setup.references:
        raw, oracle = parse("mechanisms", "raw")[0], parse("trackers", "oracle")[0]
        setup.references[robot.spec] = [
            _robot_seed(robot, release.shared, setup, mechanism=raw)
            for release in share_tracked(raw, oracle, setup)
        ]
    return setup.references[robot.spec]


def _horizon(consumer: Consumer, stages: StageSettings) -> int:
    """Return the horizon of a consumer's world, in scans."""
    own, *further = horizon_scans(stages)
    horizon_s = consumer.world.horizon_s
    if horizon_s is None:
        return own
    return further[stages.conflict.horizons_s.index(horizon_s)]


def _robot_seed(
    robot: Plugin, shared: SharedTracks, setup: TrackingSetup, *, mechanism: Plugin
) -> CountsByHorizon:
    """Return what robots miss, by horizon; PluginError names a predictor that fails."""
    foresight = guarded(
        f"predictor {robot.spec!r}",
        lambda: foresee_from_tracks(
            setup.patrol,
            shared,
            predictor=knowing(robot.instance, mechanism.instance),
            safety_radius_m=setup.stages.conflict.safety_radius_m,
            horizons=horizon_scans(setup.stages),
        ),
    )
    return count_horizons(foresight, setup)


def count_horizons(foresight: Foresight, setup: TrackingSetup) -> CountsByHorizon:
    """Return what robots miss of what they foresee, by horizon in scans."""
    return {
        horizon: robot_counts(
            setup.blocks,
            foresight,
            actual=setup.actual,
            entries=setup.entries,
            horizon=horizon,
            query_scans=query_scans(setup.stages.patrol),
        )
        for horizon in horizon_scans(setup.stages)
    }


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
FOLLOWED_COLUMNS: Final = (*_PLACE, "present_s", "followed_s", "until_s", "ending")
ROBOT_COLUMNS: Final = (
    *_PLACE,
    *(f"{name}_{part}" for name in ROBOT_SHARES for part in ("sum", "over")),
    "false_alarms_sum",
    "false_alarms_over",
    "allowed",
)
ALARM_COLUMNS: Final = (*_PLACE, "step", "alarms", "warned")
HOTA_COLUMNS: Final = (*_PLACE, "step", "association", "pairs")
"""Columns of the cells of tracks and of robots with tracks.

The table `ALARMS` has a row for each seed, block and alarm distance, the table `HOTA`
for each seed, block and least similarity, the table `FOLLOWED` for each seed and
person, who counts in the block of the first sample.
"""


def track_tables(releases: list[SharedSeed], setup: TrackingSetup) -> dict[str, Rows]:
    """Return the tables of tracks: `TRACK_COLUMNS`, `FOLLOWED_COLUMNS`, `HOTA_COLUMNS`."""
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
    return _count_columns("rejoined_share", counts)


def _hota_rows(releases: list[SharedSeed], blocks: Blocks) -> Rows:
    """Return the parts of HOTA by seed, block and level, (S B A,)."""
    seeds = [hota_blocks(blocks, release.hota) for release in releases]
    n_levels = len(seeds[0].pairs)
    rows = {
        name: np.repeat(column, n_levels)
        for name, column in place_rows(len(seeds), blocks.n).items()
    }
    rows["step"] = np.tile(np.arange(n_levels, dtype=np.int32), len(seeds) * blocks.n)
    for name in ("association", "pairs"):
        rows[name] = np.concatenate([getattr(seed, name).T.ravel() for seed in seeds])
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


def track_rows(releases: list[SharedSeed], setup: TrackingSetup) -> Rows:
    """Return the counts of tracks by seed and block, (S B,)."""
    blocks, grid = setup.blocks, setup.patrol.grid
    rows = place_rows(len(releases), blocks.n)
    counts = [
        track_counts(blocks, release.shared, release.scans) for release in releases
    ]
    for name in TRACK_METRICS:
        rows |= _count_columns(name, [by_name[name] for by_name in counts])
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


def robot_tables(
    consumer: Consumer, seeds: list[CountsByHorizon], setup: TrackingSetup
) -> dict[str, Rows]:
    """Return the tables of a robot by seed and block: `ROBOT_COLUMNS`, `ALARM_COLUMNS`.

    Its horizon is that of the consumer's world. Robots are compared at the false alarms
    that they have with raw tracks of the oracle.
    """
    assert consumer.plugin is not None
    horizon = _horizon(consumer, setup.stages)
    counts = [by_horizon[horizon] for by_horizon in seeds]
    reference = [
        by_horizon[horizon] for by_horizon in _reference(consumer.plugin, setup)
    ]
    n_steps, n_blocks = counts[0].by_distance.warned.shape
    rows = place_rows(len(counts), n_blocks)
    for name in ROBOT_SHARES:
        rows |= _count_columns(name, [seed.shares[name] for seed in counts])
    rows |= _count_columns("false_alarms", [seed.false_alarms for seed in counts])
    rows["allowed"] = np.concatenate(
        [seed.false_queries.numerator for seed in reference]
    )
    alarms = {
        name: np.repeat(column, n_steps)
        for name, column in place_rows(len(counts), n_blocks).items()
    }
    alarms["step"] = np.tile(np.arange(n_steps, dtype=np.int32), rows["seed"].size)
    # Beyond the largest distance nothing more alarms: its row repeats the last.
    repeated = [
        np.append(seed.by_distance.alarms, seed.by_distance.alarms[-1:], axis=0)
        for seed in counts
    ]
    alarms["alarms"] = np.concatenate([alarm.T.ravel() for alarm in repeated])
    alarms["warned"] = np.concatenate(
        [seed.by_distance.warned.T.ravel() for seed in counts]
    )
    return {ROWS: rows, ALARMS: alarms}


def place_rows(n_seeds: int, n_blocks: int) -> Rows:
    """Return the columns that identify a seed and a block, (S B,)."""
    return {
        "seed": np.repeat(np.arange(n_seeds, dtype=np.int32), n_blocks),
        "block": np.tile(np.arange(n_blocks, dtype=np.int32), n_seeds),
    }


def _count_columns(name: str, seeds: list[BlockCounts]) -> Rows:
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
