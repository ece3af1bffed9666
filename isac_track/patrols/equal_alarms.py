"""Missed conflicts of a robot that raises as many false alarms as a reference.

A robot that is sent less may warn from a larger distance, at the cost of false alarms.
To compare policies, the alarm distance of each robot is set so that it has as many
queries with a false alarm as the reference at the safety radius. The reference is the
same robot, sent everything, without noise.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from isac_track.intervals import (
    LEAST_CLUSTERS,
    Estimate,
    effective_clusters,
    estimate_from_replicates,
)
from isac_track.patrols.intervals import FEWEST_ROUTES, sum_clusters, two_way_weights
from isac_track.patrols.patrol import Patrol
from isac_track.patrols.utility import NEVER, false_alarm_queries
from isac_track.types import Floats, Ints

_DISTANCES_M: Final = np.linspace(0.0, 3.0, 31)  # Alarm distances that are tried.


@dataclass(frozen=True, eq=False, slots=True)
class AlarmCurve:
    """False alarms and missed conflicts of R robots at D alarm distances."""

    alarms: Floats  # (D, R) queries with a false alarm.
    missed: Floats  # (D, C, R) future conflicts, by cluster of people.
    trials: Floats  # (C, R) future conflicts.


def alarm_curve(
    patrol: Patrol, *, actual: Ints, gaps_m: Floats, horizon: int, cluster: Ints
) -> AlarmCurve:
    """Return false alarms and misses of robots over the alarm distance.

    `gaps_m`, (E, R) m, are the least forecast distances (`least_gaps`), `actual`, (E,
    R), the scans until a true conflict. `cluster`, (E,), numbers the people who walk
    together.
    """
    is_future = (actual > 0) & (actual <= horizon)
    alarms, missed = [], []
    for distance_m in _DISTANCES_M:
        is_alarm = gaps_m < distance_m
        foreseen = np.where(is_alarm, 0, NEVER)
        alarms.append(false_alarm_queries(patrol, actual, foreseen, horizon=horizon))
        missed.append(sum_clusters(is_future & ~is_alarm, cluster))
    return AlarmCurve(
        alarms=np.array(alarms, dtype=np.float64),
        missed=np.array(missed),
        trials=sum_clusters(is_future, cluster),
    )


def missed_at_equal_alarms(
    curve: AlarmCurve, *, reference: Floats, seed: int
) -> Estimate:
    """Return the share of future conflicts missed at the false alarms of a reference.

    `reference`, (R,), are queries with a false alarm on the same routes. The alarm
    distance is the largest at which the robot does not exceed it; between two distances
    alarms and misses are interpolated. A robot that stays below the reference at every
    distance gets the largest. Every replicate of the two-way interval sets a distance
    of its own.
    """
    n_clusters, n_routes = curve.trials.shape
    people, routes = two_way_weights(
        n_clusters=n_clusters, n_routes=n_routes, seed=seed
    )
    values = drawn_misses(curve, reference=reference, people=people, routes=routes)
    effective = effective_clusters(curve.trials.sum(axis=1))
    n = int((curve.trials.sum(axis=1) > 0).sum())
    n_used_routes = (curve.trials.sum(axis=0) > 0).sum()
    if n_used_routes < FEWEST_ROUTES or effective < LEAST_CLUSTERS:
        return Estimate(
            float(values[0]), n=n, replicates=values[1:], effective=effective
        )
    return estimate_from_replicates(values, n=n, effective=effective)


def drawn_misses(
    curve: AlarmCurve, *, reference: Floats, people: Floats, routes: Floats
) -> Floats:
    """Return the misses of `missed_at_equal_alarms` under each row of weights, (B,).

    `people`, (B, C), and `routes`, (B, R), say how often each is drawn. Weights of 0
    leave people out of the misses, but not out of the false alarms, which nobody owns.
    """
    alarms, allowed = routes @ curve.alarms.T, routes @ reference
    missed = np.stack(
        [((people @ part) * routes).sum(axis=1) for part in curve.missed], axis=1
    )
    trials = ((people @ curve.trials) * routes).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(_interpolate_misses(missed, alarms, allowed) / trials)


def _interpolate_misses(missed: Floats, alarms: Floats, allowed: Floats) -> Floats:
    """Return the misses where the alarms, (B, D), first exceed those allowed, (B,)."""
    exceeds = alarms > allowed[:, None]
    after = np.where(exceeds.any(axis=1), exceeds.argmax(axis=1), alarms.shape[1] - 1)
    before = np.maximum(after - 1, 0)
    rows = np.arange(len(alarms))
    low, high = alarms[rows, before], alarms[rows, after]
    share = np.ones(len(alarms))
    np.divide(allowed - low, high - low, out=share, where=high > low)
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(
        (1.0 - share) * missed[rows, before] + share * missed[rows, after]
    )
