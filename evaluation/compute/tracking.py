"""Cells of tracks: how well trackers track, and what robots miss with tracks.

Everything is drawn anew for each seed of sensing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from evaluation.compute.current_cell import note_cell
from evaluation.compute.guards import guarded
from evaluation.compute.tables import ROWS
from evaluation.compute.track_rows import (
    ALARMS,
    ROBOT_SHARES,
    count_columns,
    seed_block_columns,
    track_tables,
)
from evaluation.compute.tracking_setup import (
    CountsByHorizon,
    SeedRelease,
    TrackingSetup,
    share_tracked,
)
from isac_track.patrols import horizon_scans, scans_per_query
from isac_track.plugins import parse
from isac_track.protocols import knowing
from isac_track.tracking.counts import robot_counts
from isac_track.tracking.utility import Foresight, foresee_from_tracks

if TYPE_CHECKING:
    from evaluation.compute.tables import Rows
    from evaluation.plan.consumer import Consumer
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin
    from isac_track.tracking.sharing import SharedTracks


def release_rows(
    consumers: Iterable[Consumer],
    releases: list[SeedRelease],
    setup: TrackingSetup,
    *,
    mechanism: Plugin,
) -> Iterator[tuple[Consumer, dict[str, Rows]]]:
    """Yield the consumers of a tracker's releases, each with the rows of its tables.

    A robot foresees once for all horizons. Its counts are held as long as this runs.
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
                _count_release(robot, release.shared, setup, mechanism=mechanism)
                for release in releases
            ]
        yield consumer, robot_tables(consumer, by_robot[robot.spec], setup)


def _reference(robot: Plugin, setup: TrackingSetup) -> list[CountsByHorizon]:
    """Return the counts of a robot with raw tracks of the oracle, for each seed.

    All other tracks are compared at the false alarms that the robot has with these.
    `setup.references` holds them for the next mechanism, as long as the setup lives.
    """
    if robot.spec not in setup.references:
        raw, oracle = parse("mechanisms", "raw")[0], parse("trackers", "oracle")[0]
        setup.references[robot.spec] = [
            _count_release(robot, release.shared, setup, mechanism=raw)
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


def _count_release(
    robot: Plugin, shared: SharedTracks, setup: TrackingSetup, *, mechanism: Plugin
) -> CountsByHorizon:
    """Return the counts of robots with one release, by horizon in scans.

    Conflicts, misses and alarms are counted. PluginError names a predictor that fails.
    """
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
    """Return the conflicts, misses and alarms of robots, by horizon in scans."""
    return {
        horizon: robot_counts(
            setup.blocks,
            foresight,
            actual=setup.actual,
            entries=setup.entries,
            horizon=horizon,
            scans_per_query=scans_per_query(setup.stages.patrol),
        )
        for horizon in horizon_scans(setup.stages)
    }


def robot_tables(
    consumer: Consumer, seeds: list[CountsByHorizon], setup: TrackingSetup
) -> dict[str, Rows]:
    """Return the tables of a robot by seed and block: `ROBOT_COLUMNS`, `ALARM_COLUMNS`.

    Its horizon is that of the consumer's world. Robots are compared at the false alarms
    that they have with raw tracks of the oracle. So `allowed` is the number of queries
    with a false alarm there. `alarms` is that number here, if the robot alarms below
    the distance of `step`. `warned` is the number of future conflicts of which this
    distance, and no shorter, warns.
    """
    assert consumer.plugin is not None
    horizon = _horizon(consumer, setup.stages)
    counts = [by_horizon[horizon] for by_horizon in seeds]
    reference = [
        by_horizon[horizon] for by_horizon in _reference(consumer.plugin, setup)
    ]
    n_steps, n_blocks = counts[0].by_distance.warned.shape
    rows = seed_block_columns(len(counts), n_blocks)
    for name in ROBOT_SHARES:
        rows |= count_columns(name, [seed.shares[name] for seed in counts])
    rows |= count_columns("false_alarms", [seed.false_alarms for seed in counts])
    rows["allowed"] = np.concatenate(
        [seed.false_queries.numerator for seed in reference]
    )
    alarms = {
        name: np.repeat(column, n_steps)
        for name, column in seed_block_columns(len(counts), n_blocks).items()
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
