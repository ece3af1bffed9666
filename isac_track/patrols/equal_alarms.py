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
from isac_track.patrols.intervals import FEWEST_ROUTES, two_way_weights
from isac_track.patrols.patrol import Patrol
from isac_track.types import Floats, Ints

DISTANCES_M: Final = np.linspace(0.0, 3.0, 31)  # Alarm distances that are tried.


@dataclass(frozen=True, eq=False, slots=True)
class AlarmCounts:
    """False alarms of R robots at D alarm distances, and K true future conflicts."""

    alarms: Ints  # (D, R) queries with a false alarm.
    person: Ints  # (K,) person of each conflict.
    route: Ints  # (K,) robot of each conflict.
    # (K,) number of the shortest distance at which the robot alarms; D: at none.
    step: Ints


@dataclass(frozen=True, eq=False, slots=True)
class AlarmCurve:
    """False alarms and missed conflicts of R robots at D alarm distances."""

    alarms: Floats  # (D, R) queries with a false alarm.
    missed: Floats  # (D, C, R) future conflicts, by cluster of people.
    trials: Floats  # (C, R) future conflicts.


def count_alarms(
    patrol: Patrol, *, actual: Ints, gaps_m: Floats, horizon: int
) -> AlarmCounts:
    """Count false alarms over the alarm distance, and when each conflict alarms.

    `gaps_m`, (E, R) m, are the least forecast distances (`foresee_from`), `actual`, (E,
    R), the scans until a true conflict, within a horizon in scans.
    """
    # People are in the order of queries.
    _, starts = np.unique(patrol.presences.query, return_index=True)
    nearest_m = np.minimum.reduceat(gaps_m, starts)
    is_conflict = np.logical_or.reduceat(actual <= horizon, starts)
    nearest_m[is_conflict] = np.inf  # No alarm there is false.
    steps = first_alarms(nearest_m)
    alarms = np.stack(
        [
            np.cumsum(np.bincount(column, minlength=DISTANCES_M.size + 1))
            for column in steps.T
        ],
        axis=1,
    )
    presence, route = np.nonzero((actual > 0) & (actual <= horizon))
    return AlarmCounts(
        alarms=alarms[: DISTANCES_M.size],
        person=patrol.presences.person[presence],
        route=route,
        step=first_alarms(gaps_m[presence, route]),
    )


def first_alarms(gaps_m: Floats) -> Ints:
    """Return the number of the shortest distance above each gap; D without any."""
    return np.asarray(np.searchsorted(DISTANCES_M, gaps_m, side="right"))


def alarm_curve(counts: AlarmCounts, *, cluster: Ints) -> AlarmCurve:
    """Return false alarms and misses of robots over the alarm distance.

    `cluster`, (N,), numbers the people who walk together.
    """
    n_steps, n_routes = counts.alarms.shape
    alarmed = np.zeros((n_steps + 1, int(cluster.max(initial=-1)) + 1, n_routes))
    np.add.at(alarmed, (counts.step, cluster[counts.person], counts.route), 1.0)
    trials = alarmed.sum(axis=0)
    return AlarmCurve(
        alarms=counts.alarms.astype(np.float64),
        missed=trials - np.cumsum(alarmed[:-1], axis=0),
        trials=trials,
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
    place = _alarm_place(alarms, allowed)
    low, high = (
        _misses_at(curve.missed, step, people=people, routes=routes)
        for step in (place.before, place.after)
    )
    trials = ((people @ curve.trials) * routes).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        missed = (1.0 - place.share) * low + place.share * high
        return np.asarray(missed / trials)


@dataclass(frozen=True, eq=False, slots=True)
class _AlarmPlace:
    """Where the alarms of B replicates exceed those allowed."""

    before: Ints  # (B,) number of the last distance with few enough alarms
    after: Ints  # (B,) of the next
    share: Floats  # (B,) place between both, 0 to 1


def _alarm_place(alarms: Floats, allowed: Floats) -> _AlarmPlace:
    """Return where alarms, (B, D), over the distances exceed those allowed, (B,)."""
    exceeds = alarms > allowed[:, None]
    after = np.where(exceeds.any(axis=1), exceeds.argmax(axis=1), alarms.shape[1] - 1)
    before = np.maximum(after - 1, 0)
    rows = np.arange(len(alarms))
    low, high = alarms[rows, before], alarms[rows, after]
    share = np.ones(len(alarms))
    np.divide(allowed - low, high - low, out=share, where=high > low)
    return _AlarmPlace(before, after, np.clip(share, 0.0, 1.0))


def _misses_at(missed: Floats, step: Ints, *, people: Floats, routes: Floats) -> Floats:
    """Return the misses of each replicate at a distance of its own, (B,)."""
    drawn = np.empty(step.size)
    for number in np.unique(step).tolist():  # Replicates agree on a few distances.
        rows = step == number
        drawn[rows] = ((people[rows] @ missed[number]) * routes[rows]).sum(axis=1)
    return drawn
