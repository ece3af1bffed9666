"""Patrols of a mechanism: what robots miss, and what the log of a fleet reveals.

A level is shared once, and each policy answers once; all consumers of a policy share
its answers. Rows are per person and route, or fleet, so that intervals draw both.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.random import Generator

from attacks.following.logs import Following, follow_fleets
from evaluation.compute.current_cell import note_cell
from evaluation.compute.guards import copy_for_user_plugin, guarded
from evaluation.compute.patrol_rows import followed_rows, known_rows, utility_tables
from evaluation.compute.tables import ROWS
from evaluation.plan.constants import ORACLE
from evaluation.plan.origins import is_user_plugin
from isac_track.errors import PluginError, SettingsError
from isac_track.patrols import horizon_scans, make_patrol
from isac_track.patrols.answers import Disclosure, disclose, disclose_each
from isac_track.patrols.estimators import ESTIMATORS
from isac_track.patrols.knowledge import Known, guesses_from_map, known_places
from isac_track.patrols.metrics import (
    RobotTask,
    count_utility,
    foresee,
    is_by_construction,
    robot_task,
)
from isac_track.patrols.network import (
    Network,
    SensedPatrol,
    make_network,
    sense_patrol,
    share_each,
    share_sensed,
)
from isac_track.policies.samples import Everything
from isac_track.sharing import Raw
from isac_track.types import Floats, Release, Sensed, Tracks
from predictors.kalman import KalmanCV

if TYPE_CHECKING:
    from evaluation.compute.tables import Rows
    from evaluation.plan.consumer import Consumer
    from isac_track.config import StageSettings
    from isac_track.patrols import Patrol
    from isac_track.patrols.utility import Foreseen
    from isac_track.plugins import Plugin

_ALL: Final = "everything"  # Answers that hold all samples, for `withheld_share`.


@dataclass(frozen=True, eq=False)
class PatrolSetup:
    """A patrol as its network senses it, and what its consumers share."""

    sensed: SensedPatrol
    stages: StageSettings
    seed: int

    @property
    def patrol(self) -> Patrol:
        """The patrol."""
        return self.sensed.patrol

    @cached_property
    def guesses(self) -> Floats:
        """Guesses from the map of where people stand, (N, 2) m; made at first use."""
        epsilon_m = self.stages.privacy.epsilon_m
        return guesses_from_map(self.patrol, epsilon_m=epsilon_m)

    @cached_property
    def reference(self) -> SharedPatrol:
        """Raw samples of everybody: at its false alarms robots are compared."""
        network = share_sensed(self.sensed, mechanism=Raw())
        return SharedPatrol(self, network, {_ALL: disclose(network, Everything())})


def patrol_setup(recorded: Tracks, *, stages: StageSettings, seed: int) -> PatrolSetup:
    """Make the patrol through a recording, and sense everybody once.

    The network forecasts by `kalman_cv`, whatever robots a run has. DataError if nobody
    is present when a robot asks.
    """
    patrol = make_patrol(recorded, settings=stages, seed=seed)
    sensed = sense_patrol(patrol, forecaster=KalmanCV(), settings=stages, seed=seed)
    return PatrolSetup(sensed, stages, seed)


@dataclass(frozen=True, eq=False, slots=True)
class SharedPatrol:
    """A patrol shared with a mechanism, the answers of policies, and robots' tasks.

    Both are held as long as this object. A task is made when its robot first reads, and
    so are the answers of a user's policy: it fails alone.
    """

    setup: PatrolSetup
    network: Network
    disclosures: dict[str, Disclosure]  # By SPEC of the policy, and `_ALL`.
    tasks: dict[str, RobotTask] = field(default_factory=dict)

    def disclosure(self, policy: Plugin) -> Disclosure:
        """Return the answers of a policy."""
        if policy.spec not in self.disclosures:
            self.disclosures[policy.spec] = disclose(
                self.network, policy.instance, name=policy.spec
            )
        return self.disclosures[policy.spec]

    def task(self, robot: Plugin) -> RobotTask:
        """Return the task of a robot."""
        if robot.spec not in self.tasks:
            reference = None
            if self.network is not self.setup.reference.network:
                reference = self.setup.reference.task(robot)
            self.tasks[robot.spec] = guarded(
                f"predictor {robot.spec!r}",
                lambda: robot_task(
                    self.network,
                    self.disclosures[_ALL],
                    predictor=robot.instance,
                    settings=self.setup.stages,
                    reference=reference,
                ),
            )
        return self.tasks[robot.spec]


def share_level(
    mechanism: Plugin, setup: PatrolSetup, policies: Iterable[Plugin]
) -> SharedPatrol:
    """Share a patrol with a mechanism, and let the built-in policies answer.

    PluginError if the mechanism raises or breaks its contract; the message names it.
    """
    built_in = {
        policy.spec: policy.instance
        for policy in policies
        if not is_user_plugin(policy)
    }
    if mechanism.instance == Raw():
        reference = setup.reference
        answers = disclose_each(reference.network, built_in)
        # A task of a robot serves both.
        return SharedPatrol(
            setup, reference.network, reference.disclosures | answers, reference.tasks
        )
    name = f"mechanism {mechanism.spec!r}"

    def share(sensed: Sensed, rng: Generator) -> Release:
        own = copy_for_user_plugin(sensed, mechanism)
        release = guarded(name, lambda: mechanism.instance.share(own, rng))
        if not isinstance(release, Release):
            got = type(release).__name__
            raise PluginError(f"{name} must return a Release, got {got}")
        return release

    releases = share_each(setup.sensed, share)
    try:
        network = make_network(
            setup.sensed, mechanism=mechanism.instance, releases=releases
        )
    except SettingsError as error:
        raise PluginError(
            f"{name} leaves samples out, which on patrols a policy does; declare"
            " `withholds = True` in its class"
        ) from error
    answers = disclose_each(network, {_ALL: Everything()} | built_in)
    return SharedPatrol(setup, network, answers)


def policy_rows(
    consumers: Iterable[Consumer], shared: SharedPatrol, *, mechanism: Plugin
) -> Iterator[tuple[Consumer, dict[str, Rows]]]:
    """Yield the consumers of one policy, each with the rows of its tables, by name.

    What several of them need is computed once, and held as long as this runs.
    """
    foreseen: dict[str, Foreseen] = {}
    known: Known | None = None
    for consumer in consumers:
        note_cell(mechanism.spec, consumer.label)
        assert consumer.policy is not None
        disclosure = shared.disclosure(consumer.policy)
        if (robot := consumer.plugin) is not None:
            task = shared.task(robot)
            if robot.spec not in foreseen and disclosure is shared.disclosures[_ALL]:
                foreseen[robot.spec] = task.from_all
            if robot.spec not in foreseen:
                foreseen[robot.spec] = _foresee(robot, task, disclosure)
            yield consumer, _robot_tables(consumer, task, foreseen[robot.spec])
            continue
        known = known or known_places(
            shared.network,
            disclosure,
            guesses=shared.setup.guesses,
            epsilon_m=shared.setup.stages.privacy.epsilon_m,
        )
        if consumer.adversary == ORACLE:
            yield consumer, {ROWS: known_rows(known)}
        else:
            following = _follow(consumer, shared, known=known)
            yield consumer, {ROWS: followed_rows(following)}


def _foresee(robot: Plugin, task: RobotTask, disclosure: Disclosure) -> Foreseen:
    """Return what a robot foresees; PluginError names a predictor that fails."""
    foreseen: Foreseen = guarded(
        f"predictor {robot.spec!r}", lambda: foresee(task, disclosure)
    )
    return foreseen


def _robot_tables(
    consumer: Consumer, task: RobotTask, foreseen: Foreseen
) -> dict[str, Rows]:
    """Return the tables of a robot at the horizon of its world."""
    stages = task.settings
    horizon_s = consumer.world.horizon_s
    horizon, *further = horizon_scans(stages)
    if horizon_s is not None:
        horizon = further[stages.conflict.horizons_s.index(horizon_s)]
    counts = count_utility(task, foreseen, horizon=horizon)
    assert consumer.policy is not None
    assert consumer.plugin is not None
    # A plug-in may decide by the robot's forecast and still withhold: that is a result.
    is_built_in = not counts.hits["withheld_share"].any() and is_by_construction(
        task.network, consumer.policy.instance, consumer.plugin.instance
    )
    tables = utility_tables(counts)
    rows = tables[ROWS]
    claims_protection = bool(getattr(consumer.policy.instance, "protects", True))
    for name, value in (
        ("by_construction", is_built_in),
        ("protects", claims_protection),
    ):
        rows[name] = np.full(rows["route"].size, value)
    return tables


def _follow(consumer: Consumer, shared: SharedPatrol, *, known: Known) -> Following:
    """Follow people through the logs, with the estimator that knows most."""
    setup, policy = shared.setup, consumer.policy
    assert policy is not None
    return follow_fleets(
        shared.network,
        shared.disclosure(policy),
        estimator=ESTIMATORS[known.best],
        guesses=setup.guesses,
        epsilon_m=setup.stages.privacy.epsilon_m,
        seed=setup.seed,
        pseudonyms=setup.stages.patrol.pseudonyms,
        knows_policy=policy.instance if consumer.adversary == "informed" else None,
    )
