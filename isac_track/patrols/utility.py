"""Conflicts that a robot on patrol foresees and misses, and its false alarms.

Time is counted in scans. Truth and forecast are compared until a person leaves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from isac_track.patrols.answers import Disclosure
from isac_track.patrols.forecasts import forecast_runs
from isac_track.patrols.network import Network
from isac_track.patrols.patrol import Patrol
from isac_track.protocols import Predictor, knowing
from isac_track.types import Bools, Floats, Ints, squared_lengths, stretches

NEVER: Final = np.iinfo(np.int64).max // 2  # Scans until an event that does not happen.
_LEAST_HISTORY: Final = 2  # Least number of samples for a forecast.


@dataclass(frozen=True, eq=False, slots=True)
class Counts:
    """Hits and trials of a share; the last axis holds the R robots."""

    hits: Bools
    trials: Bools

    @property
    def rate(self) -> float:
        """Share of hits among all trials; NaN without a trial."""
        n_trials = int(self.trials.sum())
        n_hits = int((self.hits & self.trials).sum())
        return n_hits / n_trials if n_trials else float("nan")


def true_conflicts(patrol: Patrol, *, safety_radius_m: float) -> Ints:
    """Return the scans until a person is truly inside the safety radius, (E, R).

    0: the person is inside at the query. `NEVER`: not before the person leaves, or only
    beyond the reach of all forecasts.
    """
    sample, reach = patrol.presences.sample, patrol.ahead_s.size - 1
    stay = np.minimum(scans_left(patrol), reach)
    conflicts = np.full((sample.size, patrol.n_robots), NEVER)
    for robot in range(patrol.n_robots):
        inside = _is_inside(patrol, robot=robot, safety_radius_m=safety_radius_m)
        following = np.where(inside, np.arange(inside.size), NEVER)
        wait = np.minimum.accumulate(following[::-1])[::-1][sample] - sample
        conflicts[:, robot] = np.where(wait <= stay, wait, NEVER)
    return conflicts


def first_entries(patrol: Patrol, *, safety_radius_m: float) -> Ints:
    """Return the scan at which a person is first inside, (N, R), or `NEVER`."""
    entries = np.full((len(patrol.people), patrol.n_robots), NEVER)
    for robot in range(patrol.n_robots):
        inside = _is_inside(patrol, robot=robot, safety_radius_m=safety_radius_m)
        scan = np.where(inside, patrol.scan, NEVER)
        entries[:, robot] = np.minimum.reduceat(scan, patrol.people.offsets[:-1])
    return entries


def scans_left(patrol: Patrol) -> Ints:
    """Return the scans for which a person stays after each presence, (E,)."""
    pairs = patrol.presences
    return np.asarray(patrol.people.offsets[pairs.person + 1] - 1 - pairs.sample)


def _is_inside(patrol: Patrol, *, robot: int, safety_radius_m: float) -> Bools:
    """Return the samples with a person truly inside the safety radius, (M,)."""
    gap = patrol.people.xy - patrol.robot_xy[robot, patrol.scan]
    return np.asarray(squared_lengths(gap) < safety_radius_m**2)


def foreseen_conflicts(
    network: Network,
    disclosure: Disclosure,
    *,
    predictor: Predictor,
    safety_radius_m: float,
) -> Ints:
    """Return the scans until a robot foresees a person inside, (E, R).

    `NEVER` for people who are not in the answer, and after a person has left. With
    samples the robot forecasts by its `predictor`; a state or a flag is the network's
    forecast, which the robot uses as it is. A flag is scored for each person by the
    forecasts that it summarises.
    """
    answers = answer_forecasts(network, disclosure, predictor)
    return conflicts_in(network.patrol, answers, safety_radius_m=safety_radius_m)


@dataclass(frozen=True, eq=False, slots=True)
class AnswerForecasts:
    """U forecasts, and the forecast of each of B answers about a person."""

    mean: Floats  # (U, H, 2) m
    row: Ints  # (B,) forecast of the answer.
    robot: Ints  # (B,)
    presence: Ints  # (B,)


@dataclass(frozen=True, eq=False, slots=True)
class Foreseen:
    """What R robots foresee from their answers about E presences."""

    conflicts: Ints  # (E, R) scans until a person is foreseen inside, or `NEVER`.
    gaps_m: Mapping[int, Floats]
    """(E, R) least forecast distance within each horizon, in scans, up to leaving;
    infinite without an answer."""


def foresee_from(
    patrol: Patrol,
    answers: AnswerForecasts,
    *,
    safety_radius_m: float,
    horizons: Sequence[int] = (),
) -> Foreseen:
    """Return what forecasts say about each person until the person leaves."""
    stay, shape = scans_left(patrol), (len(patrol.presences), patrol.n_robots)
    conflicts = np.full(shape, NEVER)
    gaps_m = {horizon: np.full(shape, np.inf) for horizon in horizons}
    scans = np.arange(patrol.ahead_s.size)
    for robot in range(patrol.n_robots):
        is_ours = answers.robot == robot
        presence = answers.presence[is_ours]
        gap = answers.mean[answers.row[is_ours]] - patrol.robot_ahead(robot, presence)
        square = squared_lengths(gap)
        square[scans > stay[presence][:, None]] = np.inf
        inside = square < safety_radius_m**2
        conflicts[presence, robot] = np.where(
            inside.any(axis=1), inside.argmax(axis=1), NEVER
        )
        for horizon, gaps in gaps_m.items():
            gaps[presence, robot] = np.sqrt(square[:, : horizon + 1].min(axis=1))
    return Foreseen(conflicts, gaps_m)


def conflicts_in(
    patrol: Patrol, answers: AnswerForecasts, *, safety_radius_m: float
) -> Ints:
    """Return the scans until forecasts come inside the radius, (E, R), or `NEVER`."""
    return foresee_from(patrol, answers, safety_radius_m=safety_radius_m).conflicts


def answer_forecasts(
    network: Network, disclosure: Disclosure, predictor: Predictor
) -> AnswerForecasts:
    """Return the forecasts from each answer, by the robot or by the network.

    The form of the answer decides which, as in `foreseen_conflicts`.
    """
    if disclosure.form == "samples":
        adapted = knowing(predictor, network.mechanism)
        return _forecast_samples(network, disclosure, adapted)
    if disclosure.form == "state":
        mean, presence = network.shared_forecast.mean, disclosure.presence
        return AnswerForecasts(mean, presence, disclosure.robot, presence)
    n_pairs, n_robots = len(network.patrol.presences), network.patrol.n_robots
    robot = np.repeat(np.arange(n_robots), n_pairs)
    presence = np.tile(np.arange(n_pairs), n_robots)
    mean = network.forecast(disclosure.select_on).mean
    return AnswerForecasts(mean, presence, robot, presence)


def _forecast_samples(
    network: Network, disclosure: Disclosure, predictor: Predictor
) -> AnswerForecasts:
    """Return robots' forecasts; robots that were sent the same samples share them."""
    robot, presence = disclosure.robot, disclosure.presence
    is_new = np.ones(robot.size, dtype=bool)
    is_new[1:] = (np.diff(robot) != 0) | (np.diff(presence) != 0)
    begin = np.flatnonzero(is_new)
    n_runs = np.diff(np.append(begin, robot.size))
    # Answers of one run are equal if their samples are; answers of several runs are
    # never merged.
    own_key = np.where(n_runs == 1, -1, np.arange(begin.size))
    last = begin + n_runs - 1
    keys = np.stack(
        [presence[begin], disclosure.first[begin], disclosure.end[last], own_key]
    )
    _, chosen, row = np.unique(keys, axis=1, return_index=True, return_inverse=True)
    runs, starts = stretches(begin[chosen], n_runs[chosen])
    begins = network.sent_rows(presence[runs], disclosure.first[runs])
    forecast = forecast_runs(
        network.sent_release,
        first=begins,
        end=begins + disclosure.end[runs] - disclosure.first[runs],
        track=np.repeat(np.arange(chosen.size), np.diff(starts)),
        t_future=network.patrol.t_ahead(presence[begin[chosen]]),
        predictor=predictor,
    )
    return AnswerForecasts(
        forecast.mean, row.reshape(-1), robot[begin], presence[begin]
    )


def missed_conflicts(actual: Ints, foreseen: Ints, *, horizon: int) -> Counts:
    """Count conflicts within a horizon, in scans, that a robot did not foresee."""
    return Counts(hits=foreseen > horizon, trials=actual <= horizon)


def missed_futures(actual: Ints, foreseen: Ints, *, horizon: int) -> Counts:
    """Count as `missed_conflicts`, without people who are inside at the query."""
    return Counts(hits=foreseen > horizon, trials=(actual > 0) & (actual <= horizon))


def withheld_conflicts(
    actual: Ints, foreseen: Ints, everything: Ints, *, horizon: int
) -> Counts:
    """Count the future conflicts that a policy withheld from a robot.

    Trials are the conflicts that the robot foresees under `everything`, with the same
    mechanism and draws; hits are those that it does not foresee under the policy.
    """
    is_future = (actual > 0) & (actual <= horizon)
    return Counts(hits=foreseen > horizon, trials=is_future & (everything <= horizon))


def missed_encounters(
    patrol: Patrol, entries: Ints, foreseen: Ints, *, lead: int, scans_per_query: int
) -> Counts:
    """Count encounters of which a robot was not warned `lead` scans ahead, (N, R).

    An encounter is the first time that a person is inside. The warning is the answer to
    the last query at least `lead` scans before: a forecast over ``lead + scans_per_query``
    scans that foresees the person inside. A person does not count if the network had
    too few samples for a forecast by then.
    """
    pairs = patrol.presences
    wait = entries[pairs.person] - patrol.query_scan[pairs.query][:, None]
    next_query = np.append(
        patrol.query_scan[1:], patrol.query_scan[-1] + scans_per_query
    )
    gap = (next_query - patrol.query_scan)[pairs.query][:, None]
    is_last = (wait >= lead) & (wait - gap < lead)
    is_known = pairs.sample + 1 - patrol.people.offsets[pairs.person] >= _LEAST_HISTORY
    rows, robots = np.nonzero(is_last & is_known[:, None])
    trials = np.zeros(entries.shape, dtype=bool)
    hits = np.zeros(entries.shape, dtype=bool)
    trials[pairs.person[rows], robots] = True
    hits[pairs.person[rows], robots] = foreseen[rows, robots] > lead + scans_per_query
    return Counts(hits=hits, trials=trials)


def false_alarms(patrol: Patrol, actual: Ints, foreseen: Ints, *, horizon: int) -> Ints:
    """Return the number of false alarms of each robot, (R,).

    An alarm is a run of queries at which the robot foresees a person inside within the
    horizon, in scans. It is false if nobody truly comes inside at any of them.
    """
    query, n_queries = patrol.presences.query, patrol.query_scan.size
    is_alarm = _any_person(foreseen <= horizon, query, n_queries)
    is_conflict = _any_person(actual <= horizon, query, n_queries)
    return np.asarray(false_alarm_starts(is_alarm, is_conflict).sum(axis=0))


def false_alarm_starts(alarm: Bools, conflict: Bools) -> Bools:
    """Return the queries at which a false alarm of a robot begins, (Q, R).

    `alarm` and `conflict`, (Q, R), are the queries with a warning, and with a true
    conflict within the horizon. An alarm is a run of queries with a warning. It is
    false without a conflict at any of them.
    """
    begins = alarm.copy()
    begins[1:] &= ~alarm[:-1]
    is_false = np.zeros_like(alarm)
    for robot in range(alarm.shape[1]):
        run = np.cumsum(begins[:, robot]) - 1
        first = np.flatnonzero(begins[:, robot])
        is_justified = np.zeros(first.size, dtype=bool)
        is_justified[run[alarm[:, robot] & conflict[:, robot]]] = True
        is_false[first[~is_justified], robot] = True
    return is_false


def false_alarm_queries(
    patrol: Patrol, actual: Ints, foreseen: Ints, *, horizon: int
) -> Ints:
    """Return the number of queries with a false alarm of each robot, (R,).

    The robot foresees a person inside within the horizon, in scans, and nobody comes. A
    longer alarm distance never lowers this number, but may lower that of
    `false_alarms`.
    """
    query, n_queries = patrol.presences.query, patrol.query_scan.size
    is_alarm = _any_person(foreseen <= horizon, query, n_queries)
    is_conflict = _any_person(actual <= horizon, query, n_queries)
    return np.asarray((is_alarm & ~is_conflict).sum(axis=0))


def _any_person(flags: Bools, query: Ints, n_queries: int) -> Bools:
    """Return whether a flag holds for any person at each query, (E, R) -> (Q, R)."""
    total = np.zeros((n_queries, flags.shape[1]), dtype=bool)
    np.logical_or.at(total, query, flags)
    return total
