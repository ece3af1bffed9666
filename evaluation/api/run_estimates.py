"""The estimates of a finished run: of scenes, of linkage, and the strongest attacks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from evaluation.estimates import linkability, summary
from evaluation.estimates.best_robot import BestRobots, best_robots
from evaluation.estimates.bounds import with_linkage_gaps
from evaluation.estimates.decisions import decisions
from evaluation.estimates.families import RAW, Family, entry_families
from evaluation.estimates.galleries import TPR
from evaluation.estimates.levels import levels
from evaluation.estimates.linked_people import PAPER_MECHANISMS, Choices
from evaluation.estimates.metrics import (
    LINKAGE_COMPARED,
    PLR,
    RANK1,
    RANK1_AMONG_100,
    RANK1_JOINT,
)
from evaluation.estimates.strongest import (
    HEADLINE,
    NO_TASK,
    CrossFitted,
    cross_fitted,
    strongest_by_task,
)
from evaluation.estimates.strongest_table import StrongestAttack, strongest_attacks
from evaluation.estimates.sweeps import Sweeps
from evaluation.plan.address import Address
from evaluation.plan.world import OWN_WORLD, WORLDS, World
from evaluation.store.entries import horizons_in
from evaluation.store.linkage_outcomes import ClusterSums
from isac_track.intervals import Estimate

_DRAWN: Final = (*LINKAGE_COMPARED, RANK1_JOINT, RANK1_AMONG_100)
"""Metrics of linkers that are compared, and so have replicates."""
_PEOPLE_METRICS: Final = (PLR, RANK1, RANK1_JOINT, TPR)
"""Metrics of the tables about linked people."""


@dataclass(frozen=True, eq=False, slots=True)
class LinkEstimates:
    """Estimates from the cells of linkage."""

    estimates: dict[Address, Estimate]
    sums: dict[Address, ClusterSums]
    table: pd.DataFrame  # `linkability.csv`


def link_estimates(out: Path, manifest: Mapping[str, Any]) -> LinkEstimates:
    """Return the estimates of linkage; DataError if a cell cannot be read."""
    outcomes = linkability.linkage_outcomes(out, manifest, drawn=_DRAWN)
    return LinkEstimates(
        estimates=summary.linkage_estimates(outcomes),
        sums=summary.linkage_sums(outcomes),
        table=linkability.linkability(outcomes, dataset=manifest["dataset"]["name"]),
    )


@dataclass(frozen=True, eq=False, slots=True)
class RobotEstimates:
    """Robots judged at a horizon: their metrics, and misses against false alarms."""

    estimates: Mapping[Address, Estimate]
    at_raw_alarms: Mapping[Address, Estimate]  # At raw's false-alarm rate.
    best: BestRobots  # Over the levels that a site may choose, and raw.
    curves: pd.DataFrame
    decided: pd.DataFrame

    @property
    def all_estimates(self) -> dict[Address, Estimate]:
        """All estimates, those at raw's false-alarm rate among them."""
        return {**self.estimates, **self.at_raw_alarms}


@dataclass(frozen=True, eq=False, slots=True)
class SceneEstimates:
    """Estimates from the cells of scenes."""

    attacked: dict[Address, ClusterSums]
    worlds: Mapping[World, Mapping[Address, Estimate]]
    """Estimates in other worlds, further horizons among them."""
    own_horizon: RobotEstimates
    further_horizons: Mapping[float, RobotEstimates]  # By s, ascending.

    @property
    def estimates(self) -> Mapping[Address, Estimate]:
        """The metrics at the run's own horizon."""
        return self.own_horizon.estimates

    @property
    def further_estimates(self) -> dict[float, Mapping[Address, Estimate]]:
        """The metrics at further horizons."""
        return {
            horizon_s: robots.estimates
            for horizon_s, robots in self.further_horizons.items()
        }

    @property
    def decided(self) -> pd.DataFrame:
        """The robots at every horizon, the run's own first: `decisions.csv`."""
        robots = (self.own_horizon, *self.further_horizons.values())
        return pd.concat([judged.decided for judged in robots], ignore_index=True)

    @property
    def curves(self) -> pd.DataFrame:
        """Their misses over false alarms: `curves.csv`."""
        robots = (self.own_horizon, *self.further_horizons.values())
        return pd.concat([judged.curves for judged in robots], ignore_index=True)


def scene_estimates(out: Path, manifest: Mapping[str, Any]) -> SceneEstimates:
    """Return the estimates of scenes in all worlds; DataError if a cell cannot be read."""
    numbers = summary.scene_numbers(out, manifest)
    dataset = manifest["dataset"]["name"]
    further = dict[float, RobotEstimates]()
    worlds: dict[World, Mapping[Address, Estimate]] = {}
    for horizon_s in horizons_in(manifest["cells"]):
        world = World(horizon_s=horizon_s)
        at_horizon = summary.scene_numbers(out, manifest, world=world)
        worlds[world] = at_horizon.estimates
        name = Address(recording=dataset, world=world).dataset
        further[horizon_s] = _judge_robots(at_horizon, manifest, dataset=name)
    for world in WORLDS:
        outcomes = linkability.linkage_outcomes(
            out, manifest, drawn=_DRAWN, world=world
        )
        in_world = summary.scene_numbers(out, manifest, world=world).estimates
        in_world |= with_linkage_gaps(summary.linkage_estimates(outcomes))
        # Without replicates, as large as a run's own: no comparison pairs with them.
        worlds[world] = {
            key: replace(estimate, replicates=np.zeros(0))
            for key, estimate in in_world.items()
        }
    return SceneEstimates(
        attacked=numbers.attacked,
        worlds=worlds,
        own_horizon=_judge_robots(numbers, manifest, dataset=dataset),
        further_horizons=further,
    )


def _judge_robots(
    numbers: summary.SceneNumbers, manifest: Mapping[str, Any], *, dataset: str
) -> RobotEstimates:
    """Return the robots at the horizon of some numbers, named `dataset` in the tables.

    The best is chosen over raw and the mechanisms that claim to protect.
    """
    robots = decisions(numbers, manifest, dataset=dataset)
    candidates = {
        name
        for name, family in entry_families(manifest["cells"]).items()
        if family.protects or family.family == RAW
    }
    estimates = {**numbers.estimates, **robots.at_raw_alarms}
    best = best_robots(numbers.scored, manifest, estimates, among=candidates)
    return RobotEstimates(
        estimates=numbers.estimates,
        at_raw_alarms=robots.at_raw_alarms,
        best=best,
        curves=robots.curves,
        decided=robots.decided,
    )


@dataclass(frozen=True, eq=False, slots=True)
class AttackComparison:
    """All estimates of a run, and the strongest attacks among them."""

    sweeps: Sweeps
    families: Mapping[str, Family]  # The mechanisms of the run, by name.
    sums: Mapping[Address, ClusterSums]  # Of attacks.
    strongest_by_task: Mapping[str, Address]
    """The strongest linker of each task, and the strongest reconstruction as `NO_TASK`."""
    cross_fitted_by_task: Mapping[str, CrossFitted]
    """Their success without the bias of the choice."""
    by_mechanism: tuple[StrongestAttack, ...]

    @property
    def choices(self) -> dict[tuple[str, str], Choices]:
        """Choices of the strongest linkers, by task and mechanism.

        Those of the strongest of the run are under `PAPER_MECHANISMS`.
        """
        choices: dict[tuple[str, str], Choices] = {
            (task, PAPER_MECHANISMS): crossed.choices
            for task, crossed in self.cross_fitted_by_task.items()
            if task != NO_TASK
        }
        for attack in self.by_mechanism:
            if attack.reader.task and attack.among == HEADLINE:
                key = attack.reader.task, attack.mechanism
                choices[key] = attack.crossed.choices
        return choices

    def people_sweeps(self) -> Sweeps:
        """Return the sweeps of the metrics that linked people are described by."""
        estimates = {
            key: estimate
            for key, estimate in self.sweeps.estimates.items()
            if key.metric in _PEOPLE_METRICS
        }
        return Sweeps(estimates, self.families)

    def judged_sweeps(self) -> Sweeps:
        """Return all sweeps, with cross-fitted estimates of the strongest attacks."""
        estimates = {**self.sweeps.estimates}
        for crossed in self.cross_fitted_by_task.values():
            estimates |= crossed.estimates
        return Sweeps(estimates, self.families)


def compare_attacks(
    scenes: SceneEstimates, links: LinkEstimates, families: Mapping[str, Family]
) -> AttackComparison:
    """Find the strongest attacks of a run, at all levels and against each mechanism."""
    sums = links.sums | scenes.attacked
    estimates = {
        **scenes.estimates,
        **scenes.own_horizon.at_raw_alarms,
        **links.estimates,
    }
    sweeps = Sweeps(estimates, families)
    strongest = strongest_by_task(sweeps.estimates, families)
    return AttackComparison(
        sweeps=sweeps,
        families=families,
        sums=sums,
        strongest_by_task=strongest,
        cross_fitted_by_task={
            task: cross_fitted(
                sums, families, reader, by=PLR if task == NO_TASK else RANK1
            )
            for task, reader in strongest.items()
        },
        by_mechanism=strongest_attacks(sweeps.estimates, sums, families),
    )


def level_table(
    manifest: Mapping[str, Any],
    scenes: SceneEstimates,
    links: LinkEstimates,
    *,
    attacks: Sequence[StrongestAttack],
) -> pd.DataFrame:
    """Return privacy and utility of a site at each level: `levels.csv`."""
    further = {
        World(horizon_s=horizon_s): robots
        for horizon_s, robots in scenes.further_horizons.items()
    }
    return levels(
        {**scenes.estimates, **scenes.own_horizon.at_raw_alarms, **links.estimates},
        attacks=attacks,
        horizons={world: robots.all_estimates for world, robots in further.items()},
        best={OWN_WORLD: scenes.own_horizon.best}
        | {world: robots.best for world, robots in further.items()},
        linked=links.table,
        families=entry_families(manifest["cells"]),
        dataset=manifest["dataset"]["name"],
    )
