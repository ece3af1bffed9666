"""Metrics of a policy on a patrol: numbers with intervals.

`docs/explanation/need-to-know.md` explains them. Rates and shares are fractions, 0 to
1.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from isac_track.config import StageSettings
from isac_track.intervals import Estimate, cluster_weights, ratio_estimates
from isac_track.patrols.answers import Disclosure
from isac_track.patrols.equal_alarms import (
    AlarmCounts,
    alarm_curve,
    count_alarms,
    missed_at_equal_alarms,
)
from isac_track.patrols.intervals import (
    FEWEST_ROUTES,
    REPLICATES,
    cluster_numbers,
    sum_clusters,
    two_way_ratio,
)
from isac_track.patrols.knowledge import Known
from isac_track.patrols.network import Network
from isac_track.patrols.patrol import horizon_scans, scans_per_query
from isac_track.patrols.utility import (
    Foreseen,
    answer_forecasts,
    false_alarm_queries,
    false_alarms,
    first_entries,
    foresee_from,
    missed_conflicts,
    missed_encounters,
    missed_futures,
    true_conflicts,
    withheld_conflicts,
)
from isac_track.patrols.worst_off import worst_tenth
from isac_track.policies.samples import Everything
from isac_track.policies.summaries import State
from isac_track.protocols import Policy, Predictor
from isac_track.types import Bools, Floats, Ints


@dataclass(frozen=True, eq=False, slots=True)
class RobotTask:
    """True conflicts on a patrol, and a robot's forecasts if all samples are sent."""

    network: Network
    predictor: Predictor
    settings: StageSettings
    actual: Ints  # (E, R) scans until a true conflict.
    entries: Ints  # (N, R) scan of the first true entry.
    from_all: Foreseen  # What the robot foresees from all samples.
    allowed: Mapping[int, Ints]
    """Queries with a false alarm of the reference, (R,), by horizon in scans."""

    @property
    def everything(self) -> Ints:
        """Scans until a conflict is foreseen from all samples, (E, R)."""
        return self.from_all.conflicts


def robot_task(
    network: Network,
    everything: Disclosure,
    *,
    predictor: Predictor,
    settings: StageSettings,
    reference: "RobotTask | None" = None,
) -> RobotTask:
    """Return the task of a robot; `everything` is the disclosure of that policy.

    `reference` is the task of the same robot without noise: policies are compared at
    its number of false alarms. Without it this task is the reference.
    """
    patrol, radius_m = network.patrol, settings.conflict.safety_radius_m
    foreseen = _foresee(network, everything, predictor=predictor, settings=settings)
    actual = true_conflicts(patrol, safety_radius_m=radius_m)
    allowed = {
        horizon: false_alarm_queries(
            patrol, actual, foreseen.conflicts, horizon=horizon
        )
        for horizon in horizon_scans(settings)
    }
    return RobotTask(
        network=network,
        predictor=predictor,
        settings=settings,
        actual=actual,
        entries=first_entries(network.patrol, safety_radius_m=radius_m),
        from_all=foreseen,
        allowed=allowed if reference is None else reference.allowed,
    )


def is_by_construction(network: Network, policy: Policy, predictor: Predictor) -> bool:
    """Return whether `withheld_share` follows from how policy and robot are built.

    It does under `everything`, and where a policy decides by the robot's own forecast:
    the same predictor, from the same positions of the same history. Then the share is
    no result.
    """
    if isinstance(policy, Everything):
        return True
    if not getattr(policy, "forecasts", False) or predictor != network.forecaster:
        return False
    if getattr(policy, "window_s", None) is not None:
        return False  # The robot reads less history than the network.
    if isinstance(policy, State) and policy.metres is None:
        return True
    is_on_shared = getattr(policy, "select_on", "raw") == "shared"
    return is_on_shared or network.shares_raw_positions


@dataclass(frozen=True, eq=False, slots=True)
class UtilityCounts:
    """Hits and trials of the metrics of a robot, by person and route, (N, R).

    The metrics are `SHARES`; `false_alarms`, (R,), counts those of each route.
    """

    hits: Mapping[str, Ints]
    trials: Mapping[str, Ints]
    false_alarms: Ints
    walked_s: float  # Time that each robot walks.
    by_distance: AlarmCounts  # Over the distance at which a robot alarms.
    allowed: Ints  # (R,) queries with a false alarm of the reference.


SHARES: Final = (
    "missed_conflict_rate",
    "missed_future_rate",
    "withheld_share",
    "missed_encounter_rate",
)
"""Metrics of utility that are shares of trials."""


def foresee(task: RobotTask, disclosure: Disclosure) -> Foreseen:
    """Return what a robot foresees from its answers."""
    return _foresee(
        task.network, disclosure, predictor=task.predictor, settings=task.settings
    )


def _foresee(
    network: Network,
    disclosure: Disclosure,
    *,
    predictor: Predictor,
    settings: StageSettings,
) -> Foreseen:
    return foresee_from(
        network.patrol,
        answer_forecasts(network, disclosure, predictor),
        safety_radius_m=settings.conflict.safety_radius_m,
        horizons=horizon_scans(settings),
    )


def count_utility(
    task: RobotTask, foreseen: Foreseen, *, horizon: int
) -> UtilityCounts:
    """Count what a robot foresees (`foresee`) and misses within a horizon, in scans.

    The horizon is one of the settings.
    """
    patrol, actual, warned = task.network.patrol, task.actual, foreseen.conflicts
    person = patrol.presences.person
    by_presence = {
        "missed_conflict_rate": missed_conflicts(actual, warned, horizon=horizon),
        "missed_future_rate": missed_futures(actual, warned, horizon=horizon),
        "withheld_share": withheld_conflicts(
            actual, warned, task.everything, horizon=horizon
        ),
    }
    encounters = missed_encounters(
        patrol,
        task.entries,
        warned,
        lead=horizon,
        scans_per_query=scans_per_query(task.settings.patrol),
    )
    counts = {
        name: (
            _sum_people(presences.hits & presences.trials, person, len(patrol.people)),
            _sum_people(presences.trials, person, len(patrol.people)),
        )
        for name, presences in by_presence.items()
    }
    counts["missed_encounter_rate"] = (
        (encounters.hits & encounters.trials).astype(np.int64),
        encounters.trials.astype(np.int64),
    )
    return UtilityCounts(
        hits={name: hits for name, (hits, _) in counts.items()},
        trials={name: trials for name, (_, trials) in counts.items()},
        false_alarms=false_alarms(patrol, actual, warned, horizon=horizon),
        walked_s=patrol.duration_s,
        by_distance=count_alarms(
            patrol, actual=actual, gaps_m=foreseen.gaps_m[horizon], horizon=horizon
        ),
        allowed=task.allowed[horizon],
    )


def _sum_people(flags: Bools, person: Ints, n_people: int) -> Ints:
    """Return the sums of the presences of each person, (E, R) -> (N, R)."""
    sums = np.zeros((n_people, flags.shape[1]), dtype=np.int64)
    for robot in range(flags.shape[1]):
        sums[:, robot] = np.bincount(person[flags[:, robot]], minlength=n_people)
    return sums


def estimate_utility(
    counts: UtilityCounts, *, group: tuple[str, ...], seed: int
) -> dict[str, Estimate]:
    """Return the metrics of utility by name.

    They are `SHARES`, `missed_future_at_equal_false_alarms` and `false_alarms_per_min`.
    `group` names the cluster of each person. Without an encounter a rate has no value
    and `n` is 0.
    """
    cluster = cluster_numbers(group)
    metrics = {
        name: two_way_ratio(
            numerator=sum_clusters(counts.hits[name], cluster),
            denominator=sum_clusters(counts.trials[name], cluster),
            seed=seed,
        )
        for name in SHARES
    }
    metrics["missed_future_at_equal_false_alarms"] = missed_at_equal_alarms(
        alarm_curve(counts.by_distance, cluster=cluster),
        reference=counts.allowed.astype(np.float64),
        seed=seed,
    )
    metrics["false_alarms_per_min"] = _rate_per_minute(
        counts.false_alarms, counts.walked_s, seed=seed
    )
    return metrics


def utility_metrics(
    task: RobotTask, disclosure: Disclosure, *, horizon: int, seed: int
) -> dict[str, Estimate]:
    """Return the metrics of `estimate_utility` of a policy at a horizon, in scans.

    The horizon is one of the settings.
    """
    counts = count_utility(task, foresee(task, disclosure), horizon=horizon)
    return estimate_utility(counts, group=task.network.patrol.people.group, seed=seed)


def knowledge_metrics(
    known: Known, *, group: tuple[str, ...], seed: int
) -> dict[str, Estimate]:
    """Return the metrics of the knowledge of an adversary, by name.

    `known_share` and `known_undisclosed` are those of the estimator that knows most,
    with true identities; `known_by_map` is known without a log. `people_seen` is the
    share of people with an entry in the log, `plr_walk` the mean over people of the
    share of their samples that were sent and leak. `known_worst_tenth` is the mean
    known share of the worst-off tenth of people. `group` names the cluster of each
    person.
    """
    n_fleets = known.disclosed.shape[1]
    per_fleet = np.ones((1, n_fleets))
    instants, people = known.instants[:, None] * per_fleet, np.ones(known.leaked.shape)
    ratios = {
        "known_share": (known.known[known.best], instants),
        "known_by_map": (known.known_by_map[:, None] * per_fleet, instants),
        "disclosed_share": (known.disclosed, instants),
        "known_undisclosed": (known.known_undisclosed[known.best], instants),
        "people_seen": (known.seen, people),
        "plr_walk": (known.leaked, people),
    }
    cluster = cluster_numbers(group)
    metrics = {
        name: two_way_ratio(
            numerator=sum_clusters(numerator, cluster),
            denominator=sum_clusters(denominator, cluster),
            seed=seed,
        )
        for name, (numerator, denominator) in ratios.items()
    }
    metrics["known_worst_tenth"] = worst_tenth(
        known=known.known[known.best],
        instants=known.instants,
        cluster=cluster,
        seed=seed,
    )
    return metrics


def _rate_per_minute(alarms: Ints, duration_s: float, *, seed: int) -> Estimate:
    """Return false alarms of a robot per minute, with an interval over routes."""
    minutes: Floats = np.full((1, alarms.size), duration_s / 60.0)
    weights = cluster_weights(
        n_clusters=alarms.size,
        n_replicates=REPLICATES,
        seed=seed,
        stream_names=("routes",),
    )
    numerator = alarms[None].astype(np.float64)
    (estimate,) = ratio_estimates(
        numerator=numerator, denominator=minutes, weights=weights, is_share=[False]
    )
    if alarms.size < FEWEST_ROUTES:
        return Estimate(estimate.value, n=estimate.n, replicates=estimate.replicates)
    return estimate
