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
from evaluation.estimates.linked_people import Choices
from evaluation.estimates.metrics import (
    LINKAGE_COMPARED,
    PLR,
    RANK1,
    RANK1_AMONG_100,
    RANK1_JOINT,
)
from evaluation.estimates.strongest import (
    HEADLINE,
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

    estimates: Mapping[Address, Estimate]
    attacked: dict[Address, ClusterSums]
    worlds: Mapping[World, Mapping[Address, Estimate]]
    """Estimates in other worlds, further horizons among them."""
    own_horizon: RobotEstimates
    further_horizons: Mapping[float, RobotEstimates]  # By s, ascending.

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
    """Return the estimates of scenes in all worlds; DataError as above."""
    numbers = summary.scene_numbers(out, manifest)
    dataset = manifest["dataset"]["name"]
    own = _judged(numbers, manifest, dataset=dataset)
    later = dict[float, RobotEstimates]()
    worlds: dict[World, Mapping[Address, Estimate]] = {}
    for horizon_s in horizons_in(manifest["cells"]):
        world = World(horizon_s=horizon_s)
        ahead = summary.scene_numbers(out, manifest, world=world)
        worlds[world] = ahead.estimates
        name = Address(recording=dataset, world=world).dataset
        later[horizon_s] = _judged(ahead, manifest, dataset=name)
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
    return SceneEstimates(numbers.estimates, numbers.attacked, worlds, own, later)


def _judged(
    numbers: summary.SceneNumbers, manifest: Mapping[str, Any], *, dataset: str
) -> RobotEstimates:
    robots = decisions(numbers, manifest, dataset=dataset)
    candidates = {
        name
        for name, family in entry_families(manifest["cells"]).items()
        if family.protects or family.family == RAW
    }
    estimates = {**numbers.estimates, **robots.at_raw_alarms}
    best = best_robots(numbers.scored, manifest, estimates, among=candidates)
    return RobotEstimates(
        numbers.estimates, robots.at_raw_alarms, best, robots.curves, robots.decided
    )


@dataclass(frozen=True, eq=False, slots=True)
class AttackComparison:
    """All estimates of a run, and the strongest attacks among them."""

    sweeps: Sweeps
    families: Mapping[str, Family]  # The mechanisms of the run, by name.
    sums: Mapping[Address, ClusterSums]  # Of attacks.
    best: Mapping[str, Address]  # The strongest linker by task; a reconstruction as "".
    crossed: Mapping[str, CrossFitted]  # Their success without the bias of the choice.
    by_mechanism: tuple[StrongestAttack, ...]

    @property
    def choices(self) -> dict[tuple[str, str], Choices]:
        """Choices of the strongest linkers, by task and mechanism; "": of all."""
        choices: dict[tuple[str, str], Choices] = {
            (task, ""): crossed.choices
            for task, crossed in self.crossed.items()
            if task
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
        for crossed in self.crossed.values():
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
    best = strongest_by_task(sweeps.estimates, families)
    crossed = {
        task: cross_fitted(sums, families, reader, by=RANK1 if task else PLR)
        for task, reader in best.items()
    }
    by_mechanism = strongest_attacks(sweeps.estimates, sums, families)
    return AttackComparison(sweeps, families, sums, best, crossed, by_mechanism)


def level_table(
    manifest: Mapping[str, Any],
    scenes: SceneEstimates,
    links: LinkEstimates,
    *,
    attacks: Sequence[StrongestAttack],
) -> pd.DataFrame:
    """Return privacy and utility of a site at each level: `levels.csv`."""
    later = {
        World(horizon_s=horizon_s): robots
        for horizon_s, robots in scenes.further_horizons.items()
    }
    return levels(
        {**scenes.estimates, **scenes.own_horizon.at_raw_alarms, **links.estimates},
        attacks=attacks,
        horizons={world: robots.all_estimates for world, robots in later.items()},
        best={OWN_WORLD: scenes.own_horizon.best}
        | {world: robots.best for world, robots in later.items()},
        linked=links.table,
        families=entry_families(manifest["cells"]),
        dataset=manifest["dataset"]["name"],
    )
