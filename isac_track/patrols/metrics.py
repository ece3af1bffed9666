"""Metrics of a policy on a patrol: numbers with intervals.

`docs/explanation/need-to-know.md` explains them. Rates and shares are fractions, 0 to
1.
"""

from dataclasses import dataclass

import numpy as np

from isac_track.config import StageSettings
from isac_track.intervals import Estimate, cluster_weights, ratio_estimates
from isac_track.patrols.answers import Disclosure, Network
from isac_track.patrols.equal_alarms import alarm_curve, missed_at_equal_alarms
from isac_track.patrols.intervals import (
    FEWEST_ROUTES,
    REPLICATES,
    cluster_numbers,
    sum_clusters,
    two_way_ratio,
)
from isac_track.patrols.knowledge import Known
from isac_track.patrols.patrol import horizon_scans, query_scans
from isac_track.patrols.utility import (
    Counts,
    answer_forecasts,
    conflicts_in,
    false_alarm_queries,
    false_alarms,
    first_entries,
    least_gaps,
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
from isac_track.types import Floats, Ints


@dataclass(frozen=True, eq=False, slots=True)
class RobotTask:
    """True conflicts on a patrol, and a robot's forecasts if all samples are sent."""

    network: Network
    predictor: Predictor
    settings: StageSettings
    actual: Ints  # (E, R) scans until a true conflict.
    entries: Ints  # (N, R) scan of the first true entry.
    everything: Ints  # (E, R) scans until a conflict is foreseen from all samples.
    allowed: dict[int, Ints]
    """Queries with a false alarm of the reference, (R,), by horizon in scans."""


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
    answers = answer_forecasts(network, everything, predictor)
    foreseen = conflicts_in(patrol, answers, safety_radius_m=radius_m)
    actual = true_conflicts(patrol, safety_radius_m=radius_m)
    allowed = {
        horizon: false_alarm_queries(patrol, actual, foreseen, horizon=horizon)
        for horizon in horizon_scans(settings)
    }
    return RobotTask(
        network=network,
        predictor=predictor,
        settings=settings,
        actual=actual,
        entries=first_entries(network.patrol, safety_radius_m=radius_m),
        everything=foreseen,
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
    return is_on_shared or np.array_equal(network.release.xy, network.sensed.xy)


def utility_metrics(
    task: RobotTask, disclosure: Disclosure, *, horizon: int, seed: int
) -> dict[str, Estimate]:
    """Return the metrics of utility of a policy at a horizon, in scans, by name.

    `missed_conflict_rate`, `missed_future_rate`, `missed_future_at_equal_alarms`,
    `withheld_share`, `missed_encounter_rate` and `false_alarms_per_min`. The horizon is
    one of the settings. Without an encounter a rate has no value and `n` is 0.
    """
    patrol, actual = task.network.patrol, task.actual
    answers = answer_forecasts(task.network, disclosure, task.predictor)
    radius_m = task.settings.conflict.safety_radius_m
    foreseen = conflicts_in(patrol, answers, safety_radius_m=radius_m)
    person = patrol.presences.person
    everybody = np.arange(len(patrol.people))
    missed = missed_conflicts(actual, foreseen, horizon=horizon)
    futures = missed_futures(actual, foreseen, horizon=horizon)
    withheld = withheld_conflicts(actual, foreseen, task.everything, horizon=horizon)
    encounters = missed_encounters(
        patrol,
        task.entries,
        foreseen,
        lead=horizon,
        query_scans=query_scans(task.settings.patrol),
    )
    alarms = false_alarms(patrol, actual, foreseen, horizon=horizon)
    cluster = cluster_numbers(patrol.people.group)
    curve = alarm_curve(
        patrol,
        actual=actual,
        gaps_m=least_gaps(patrol, answers, horizon=horizon),
        horizon=horizon,
        cluster=cluster[person],
    )
    allowed = task.allowed[horizon].astype(np.float64)
    return {
        "missed_future_at_equal_alarms": missed_at_equal_alarms(
            curve, reference=allowed, seed=seed
        ),
        "missed_conflict_rate": _share_estimate(missed, cluster[person], seed=seed),
        "missed_future_rate": _share_estimate(futures, cluster[person], seed=seed),
        "withheld_share": _share_estimate(withheld, cluster[person], seed=seed),
        "missed_encounter_rate": _share_estimate(
            encounters, cluster[everybody], seed=seed
        ),
        "false_alarms_per_min": _rate_per_minute(alarms, patrol.duration_s, seed=seed),
    }


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


def _share_estimate(counts: Counts, cluster: Ints, *, seed: int) -> Estimate:
    return two_way_ratio(
        numerator=sum_clusters(counts.hits & counts.trials, cluster),
        denominator=sum_clusters(counts.trials, cluster),
        seed=seed,
    )


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
