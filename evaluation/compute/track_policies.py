"""Disclosure policies that answer from tracks: what logs reveal and robots miss.

Rows are per seed of sensing and block of the recording, as those of tracks.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.compute.current_cell import note_cell
from evaluation.compute.guards import guarded
from evaluation.compute.tables import ROWS
from evaluation.compute.track_rows import seed_block_columns
from evaluation.compute.tracking import count_horizons, robot_tables
from isac_track.patrols import horizon_scans
from isac_track.patrols.answers import disclose
from isac_track.tracking.answers import (
    disclosed_instants,
    forecasts_by_robot,
    logged_tracks,
    track_network,
)
from isac_track.tracking.knowledge import TRACK_ESTIMATORS, known_instants
from isac_track.tracking.utility import foresee_from_forecasts
from predictors.kalman import KalmanCV

if TYPE_CHECKING:
    from evaluation.compute.tables import Rows
    from evaluation.compute.tracking_setup import (
        CountsByHorizon,
        SeedRelease,
        TrackingSetup,
    )
    from evaluation.plan.consumer import Consumer
    from isac_track.patrols.answers import Disclosure
    from isac_track.plugins import Plugin
    from isac_track.tracking.answers import TrackNetwork
    from isac_track.types import Floats

LOG_COLUMNS: Final = (
    "seed",
    "block",
    *(f"known_{estimator}" for estimator in TRACK_ESTIMATORS),
    "disclosed",
    "instants",
)
"""Columns of the cells of logs, in instants of all people and fleets."""


@dataclass(frozen=True, eq=False, slots=True)
class _Answers:
    """A policy's answers from the tracks of a seed."""

    tracks: TrackNetwork
    disclosure: Disclosure


def answer_rows(
    consumers: Iterable[Consumer],
    releases: list[SeedRelease],
    setup: TrackingSetup,
    *,
    mechanism: Plugin,
) -> Iterator[tuple[Consumer, dict[str, Rows]]]:
    """Yield the consumers of one policy's answers, each with the rows of its tables.

    The answers, and a robot's forecasts for all horizons, are held as long as this
    runs.
    """
    seeds: list[_Answers] = []
    by_robot: dict[str, list[CountsByHorizon]] = {}
    for consumer in consumers:
        note_cell(mechanism.spec, consumer.label)
        policy, robot = consumer.policy, consumer.plugin
        assert policy is not None
        seeds = seeds or [
            _answer(policy, release, setup, mechanism=mechanism, seed=seed)
            for seed, release in zip(setup.seeds, releases, strict=True)
        ]
        if robot is None:
            yield consumer, {ROWS: _log_rows(seeds, setup)}
            continue
        if robot.spec not in by_robot:
            by_robot[robot.spec] = [_miss(robot, each, setup) for each in seeds]
        yield consumer, robot_tables(consumer, by_robot[robot.spec], setup)


def _answer(
    policy: Plugin,
    release: SeedRelease,
    setup: TrackingSetup,
    *,
    mechanism: Plugin,
    seed: int,
) -> _Answers:
    """Return a policy's answers; PluginError names a policy that fails."""
    tracks = track_network(
        setup.patrol,
        release.raw,
        release.shared,
        mechanism=mechanism.instance,
        forecaster=KalmanCV(),
        law=setup.stages.sensing.law,
        seed=seed,
    )
    return _Answers(tracks, disclose(tracks.network, policy.instance, name=policy.spec))


def _miss(robot: Plugin, answers: _Answers, setup: TrackingSetup) -> CountsByHorizon:
    """Return what robots miss, by horizon; PluginError names a predictor that fails."""
    forecasts = guarded(
        f"predictor {robot.spec!r}",
        lambda: forecasts_by_robot(
            answers.tracks, answers.disclosure, predictor=robot.instance
        ),
    )
    foresight = foresee_from_forecasts(
        setup.patrol,
        forecasts,
        safety_radius_m=setup.stages.conflict.safety_radius_m,
        horizons=horizon_scans(setup.stages),
    )
    return count_horizons(foresight, setup)


def _log_rows(seeds: list[_Answers], setup: TrackingSetup) -> Rows:
    """Return what logs disclose and reveal by seed and block: `LOG_COLUMNS`."""
    rows = seed_block_columns(len(seeds), setup.blocks.n)
    counts = [_count_logs(answers, setup) for answers in seeds]
    for place, name in enumerate(LOG_COLUMNS[2:]):
        rows[name] = np.concatenate([part[place] for part in counts])
    return rows


def _count_logs(answers: _Answers, setup: TrackingSetup) -> Floats:
    """Return the counts of all fleets in blocks, the rows as in `LOG_COLUMNS`."""
    patrol, blocks = setup.patrol, setup.blocks
    by_log: dict[bytes, Floats] = {}  # Fleets often hold equal logs.
    total = np.zeros((len(LOG_COLUMNS[2:]), blocks.n))
    for fleet in range(patrol.n_fleets):
        robots = np.arange(patrol.robots_per_fleet) + fleet * patrol.robots_per_fleet
        sent = answers.disclosure.sent_mask(
            answers.tracks.network.patrol, robots=robots
        )
        key = np.packbits(sent).tobytes()
        if answers.disclosure.form == "state":
            key = answers.disclosure.key(robots=robots)  # A sample has several states.
        if key not in by_log:
            log = logged_tracks(answers.tracks, answers.disclosure, robots=robots)
            known = known_instants(
                patrol,
                log,
                guesses=setup.guesses,
                epsilon_m=setup.stages.privacy.epsilon_m,
                estimators=TRACK_ESTIMATORS,
            )
            flags = [*known, disclosed_instants(answers.tracks, sent)]
            t = patrol.grid.t
            by_log[key] = np.stack(
                [*(blocks.count(t[flag]) for flag in flags), blocks.count(t)]
            )
        total += by_log[key]
    return total
