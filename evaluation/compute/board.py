"""The scores of a card: what robots miss, what each adversary knows, who is followed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from attacks.following.followed import following_metrics
from attacks.following.logs import follow_fleets
from attacks.reconstruction.low_digits import Message, read_message
from evaluation.compute.log_attacks import Logs, known_by_attack
from evaluation.compute.patrols import PatrolSetup, SharedPatrol, patrol_setup
from isac_track.patrols import horizon_scans
from isac_track.patrols.estimators import ESTIMATORS
from isac_track.patrols.intervals import cluster_numbers, sum_clusters, two_way_ratio
from isac_track.patrols.knowledge import known_places
from isac_track.patrols.metrics import utility_metrics
from isac_track.place import placed
from isac_track.types import Ints, Release

if TYPE_CHECKING:
    from evaluation.compute.log_attacks import LogAttack
    from isac_track.config import StageSettings
    from isac_track.intervals import Estimate
    from isac_track.plugins import Plugin
    from isac_track.types import Tracks

KNOWN: Final = "known_share"
LOG, CHAINS, MAP = "log", "chains", "map"
"""Readers of a log: estimators with true identities, own chains, and none at all."""
_UTILITY: Final = (
    "missed_future_rate",
    "missed_future_at_equal_false_alarms",
    "missed_encounter_rate",
    "false_alarms_per_min",
)
_FOLLOWED: Final = (KNOWN, "followed_10s", "followed_s")


@dataclass(frozen=True, eq=False, slots=True)
class Score:
    """A metric of a card, with its reader: a robot, an adversary, or an attack."""

    metric: str
    by: str
    estimate: Estimate


def board_setup(recorded: Tracks, *, stages: StageSettings, seed: int) -> PatrolSetup:
    """Return the patrols through a recording, placed, as its network senses them."""
    return patrol_setup(placed(recorded, settings=stages), stages=stages, seed=seed)


def policy_scores(
    shared: SharedPatrol,
    policy: Plugin,
    *,
    robots: Iterable[Plugin],
    attacks: Iterable[LogAttack],
) -> list[Score]:
    """Return all scores of a mechanism with a policy.

    PluginError names a plug-in that fails.
    """
    scores = [*_robot_scores(shared, policy, robots), *_log_scores(shared, policy)]
    return scores + attack_scores(shared, policy, attacks)


def attack_scores(
    shared: SharedPatrol, policy: Plugin, attacks: Iterable[LogAttack]
) -> list[Score]:
    """Return the knowledge of each attack on the log."""
    setup = shared.setup
    logs = Logs(
        network=shared.network,
        disclosure=shared.disclosure(policy),
        guesses=setup.guesses,
        epsilon_m=setup.stages.privacy.epsilon_m,
        seed=setup.seed,
    )
    return [
        _known_score(setup, attack.plugin.spec, known_by_attack(logs, attack))
        for attack in attacks
    ]


def _robot_scores(
    shared: SharedPatrol, policy: Plugin, robots: Iterable[Plugin]
) -> Iterator[Score]:
    horizon = horizon_scans(shared.setup.stages)[-1]
    disclosure = shared.disclosure(policy)
    for robot in robots:
        task = shared.task(robot)
        metrics = utility_metrics(
            task, disclosure, horizon=horizon, seed=shared.setup.seed
        )
        for name in _UTILITY:
            yield Score(name, robot.spec, metrics[name])


def _log_scores(shared: SharedPatrol, policy: Plugin) -> Iterator[Score]:
    """Yield the knowledge of the map, of all estimators, and of own chains."""
    setup, disclosure = shared.setup, shared.disclosure(policy)
    epsilon_m = setup.stages.privacy.epsilon_m
    known = known_places(
        shared.network, disclosure, guesses=setup.guesses, epsilon_m=epsilon_m
    )
    by_map = np.repeat(known.known_by_map[:, None], known.disclosed.shape[1], axis=1)
    yield _known_score(setup, MAP, by_map)
    for name, counts in zip(ESTIMATORS, known.known, strict=True):
        yield _known_score(setup, f"{LOG}:{name}", counts)
    following = follow_fleets(
        shared.network,
        disclosure,
        estimator=ESTIMATORS[known.best],
        guesses=setup.guesses,
        epsilon_m=epsilon_m,
        seed=setup.seed,
        pseudonyms=setup.stages.patrol.pseudonyms,
    )
    metrics = following_metrics(
        following, group=setup.patrol.people.group, seed=setup.seed
    )
    for name in _FOLLOWED:
        yield Score(name, CHAINS, metrics[name])


def _known_score(setup: PatrolSetup, by: str, known: Ints) -> Score:
    """Return the share of person-time that is known, of instants known, (N, F)."""
    people = setup.patrol.people
    cluster = cluster_numbers(people.group)
    instants = np.diff(setup.patrol.grid.offsets)[:, None] * np.ones(known.shape[1])
    estimate = two_way_ratio(
        numerator=sum_clusters(known, cluster),
        denominator=sum_clusters(instants, cluster),
        seed=setup.seed,
    )
    return Score(KNOWN, by, estimate)


def hidden_message(shared: SharedPatrol) -> Message | None:
    """Return what the low-order digits of a release say of what was sensed.

    Half of the people teach it, and the other half judges it. None if too few people
    were sensed.
    """
    release: Release = shared.network.release
    return read_message(release.xy, shared.network.sensed.xy, offsets=release.offsets)
