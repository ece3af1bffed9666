"""The robot that misses least, without the bias of its choice.

The least of several noisy rates is too low. Here each half of the people chooses a
robot, by its mean over all levels, and the choice is scored on the other half
(`cross_fit`). Each half has its own curve, its own false-alarm rate at raw and hence
its own threshold, so that choice and score share nothing. Every replicate of an
interval repeats all of that.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from evaluation.estimates.cross_fit import (
    best_rival,
    interval_of_choice,
    needs_jackknife,
    ratio_of_sums,
)
from evaluation.estimates.decisions import decision_curve
from evaluation.estimates.families import AT_RAW
from evaluation.estimates.keys import EstimatesByAddress
from evaluation.estimates.metrics import EQUAL_ALARMS, FALSE_ALARMS, FUTURE_EQUAL_ALARMS
from evaluation.estimates.strongest import first_half
from evaluation.estimates.summary import PredictorAnswers, bootstrap_weights
from evaluation.plan.address import Address, MechanismLevel, parse_consumer
from isac_track.intervals import Estimate, cluster_sums, effective_clusters
from isac_track.types import Bools, Floats, Ints

BEST: Final = {EQUAL_ALARMS: "best(missed)", FUTURE_EQUAL_ALARMS: "best(missed_future)"}
"""Name of the best robot, by the metric of its choice; no plug-in has it."""
_NUMBERS: Final = (*BEST, FALSE_ALARMS)


@dataclass(frozen=True, eq=False, slots=True)
class BestRobots:
    """Missed conflicts and false alarms of the best robot of a run."""

    # Under the names of `BEST`.
    estimates: dict[Address, Estimate] = field(default_factory=dict)
    choices: dict[str, tuple[str, str]] = field(default_factory=dict)
    """Robot that either half chose; each half is scored by the other half's choice."""


@dataclass(frozen=True, eq=False, slots=True)
class _People:
    """Clusters of people in two halves, and R rows of weights for them.

    The first row is the people themselves, the next B rows are replicates, each further
    row lacks a cluster.
    """

    rows: Floats  # (R, C)
    is_first: Bools  # (C,)
    n_drawn: int  # 1 + B

    @property
    def halves(self) -> tuple[Bools, Bools]:
        """Whether a cluster is in the first half, and in the second, (C,) each."""
        return self.is_first, ~self.is_first


@dataclass(frozen=True, eq=False, slots=True)
class _Trials:
    """Trials of every cluster, (C,), for each number of `_NUMBERS`."""

    by_number: dict[str, Floats]

    def estimate(self, number: str, value: float) -> Estimate:
        """Return a value with the number of its clusters, without an interval."""
        n = int((self.by_number[number] > 0.0).sum())
        return Estimate(value, n=n, effective=self.effective(number))

    def effective(self, number: str) -> float:
        """Return the effective clusters behind a number."""
        return effective_clusters(self.by_number[number])

    @property
    def needs_deletions(self) -> bool:
        """Whether some interval is a jackknife's."""
        return any(
            needs_jackknife(effective_clusters(trials))
            for trials in self.by_number.values()
        )


def best_robots(
    scored: Sequence[PredictorAnswers],
    manifest: Mapping[str, Any],
    estimates: EstimatesByAddress,
    *,
    among: Collection[str],
) -> BestRobots:
    """Return the best robots at one horizon: by all conflicts, and by those to come.

    `scored` has the predictors' answers for every scene, `estimates` their numbers at
    raw's false-alarm rate. The choice and the score use the levels of the mechanisms
    `among`. Those robots compete that ran at the most of these levels. A single robot
    is the best without a choice, and keeps its estimates.
    """
    robots: dict[str, dict[MechanismLevel, PredictorAnswers]] = {}
    for robot in scored:
        address = robot.entry.address
        if address.mechanism in among:
            robots.setdefault(address.consumer, {})[address.mechanism_level] = robot
    most = max(map(len, robots.values()), default=0)
    rivals = {
        name: levels
        for name, levels in robots.items()
        if len(levels) == most and AT_RAW in levels
    }
    if len(rivals) == 1:
        return _only_robot(next(iter(rivals)), estimates)
    return _chosen(rivals, manifest) if rivals else BestRobots()


def _only_robot(name: str, estimates: EstimatesByAddress) -> BestRobots:
    best = BestRobots()
    for metric, consumer in BEST.items():
        best.choices[consumer] = name, name
        for key, estimate in estimates.items():
            if key.consumer == name and key.metric in (metric, FALSE_ALARMS):
                best.estimates[replace(key, plugin=consumer)] = estimate
    return best


def _chosen(
    rivals: Mapping[str, Mapping[MechanismLevel, PredictorAnswers]],
    manifest: Mapping[str, Any],
) -> BestRobots:
    """Return the best of two robots or more."""
    names, mechanism_levels = list(rivals), list(next(iter(rivals.values())))
    weights = bootstrap_weights(manifest)
    trials = [_count_trials(rivals[name][AT_RAW], weights.shape[1]) for name in names]
    people = _people(weights, first_half(tuple(manifest["groups"])), trials)
    sums = np.array(
        [_sums_of_robot(rivals[name], mechanism_levels, people) for name in names]
    )
    sums = _equally_weighted(sums)
    best = BestRobots()
    for metric, consumer in BEST.items():
        choice = _choices(sums[:, :, _NUMBERS.index(metric)])
        by_first, by_second = choice[:, 0].tolist()
        best.choices[consumer] = names[by_first], names[by_second]
        chosen = trials[by_first], trials[by_second]
        for place, where in enumerate(mechanism_levels):
            for number in (metric, FALSE_ALARMS):
                counted = sums[:, place, _NUMBERS.index(number)]
                # A costly robot is judged in fewer scenes: take the fewer clusters.
                fewer = min(chosen, key=lambda robot: robot.effective(number))
                estimate = _estimate(counted, choice, people, fewer, number=number)
                best.estimates[parse_consumer(consumer).at(*where, number)] = estimate
    return best


def _equally_weighted(sums: Floats) -> Floats:
    """Return robots' sums, (K, L, 3, 2, 2, R), as if all were judged in as many scenes.

    A half of the people then has the same weight whichever robot is chosen. The rates
    do not change.
    """
    under = sums[:, :, :, 1]
    most = under.max(axis=0)
    times = np.divide(most, under, out=np.zeros_like(under), where=under > 0.0)
    return np.asarray(sums * times[:, :, :, None])


def _count_trials(robot: PredictorAnswers, n_clusters: int) -> _Trials:
    """Return the trials of a robot within each cluster, the same at all levels."""
    conflict = robot.columns["conflict"]
    has_trial = {
        EQUAL_ALARMS: conflict,
        FUTURE_EQUAL_ALARMS: conflict & ~robot.columns["inside_now"],
        FALSE_ALARMS: ~conflict,
    }
    return _Trials(
        {
            number: cluster_sums(
                values=trials * 1.0, cluster=robot.cluster, n_clusters=n_clusters
            )
            for number, trials in has_trial.items()
        }
    )


def _people(weights: Floats, is_first: Bools, trials: Sequence[_Trials]) -> _People:
    n_clusters = weights.shape[1]
    rows = [np.ones((1, n_clusters)), weights]
    if any(robot.needs_deletions for robot in trials):
        # People without a conflict still set the false-alarm rate.
        counted = [number for robot in trials for number in robot.by_number.values()]
        has_trial = np.sum(counted, axis=0) > 0.0
        rows.append(1.0 - np.eye(n_clusters)[has_trial])
    return _People(np.concatenate(rows), is_first, n_drawn=1 + len(weights))


def _sums_of_robot(
    levels: Mapping[MechanismLevel, PredictorAnswers],
    mechanism_levels: Sequence[MechanismLevel],
    people: _People,
) -> Floats:
    """Return numerators and denominators of a robot's numbers, (L, 3, 2, 2, R).

    The axes are: level, number (`_NUMBERS`), numerator or denominator, half of the
    people, row of weights.
    """
    sums = np.zeros((len(mechanism_levels), len(_NUMBERS), 2, 2, len(people.rows)))
    raw = levels[AT_RAW]
    for half, in_half in enumerate(people.halves):
        at_raw = ratio_of_sums(_alarms(raw, in_half, people.rows))
        for place, where in enumerate(mechanism_levels):
            *missed, alarms = sums[place, :, :, half]
            alarms[:] = _alarms(levels[where], in_half, people.rows)
            for number, half_sums in zip(BEST, missed, strict=True):
                half_sums[:] = _misses(
                    levels[where], in_half, people.rows, at_raw, number=number
                )
    return sums


def _alarms(robot: PredictorAnswers, in_half: Bools, rows: Floats) -> Floats:
    """Return false alarms and conflict-free scenes of a half of the people, (2, R)."""
    _, cluster, columns = robot
    is_free = ~columns["conflict"] & in_half[cluster]
    false = is_free & columns["predicted"]
    return _weighted([false, is_free], cluster, rows)


def _misses(
    robot: PredictorAnswers,
    in_half: Bools,
    rows: Floats,
    false_alarm: Floats,
    *,
    number: str,
) -> Floats:
    """Return missed conflicts of a half of the people, and all its conflicts, (2, R).

    Conflicts are missed at the false-alarm rate `false_alarm`, (R,). Both are 0 where
    the rate or the curve is unknown.
    """
    _, cluster, columns = robot
    in_question = in_half[cluster]
    if number == FUTURE_EQUAL_ALARMS:
        in_question &= ~(columns["conflict"] & columns["inside_now"])
    conflict = columns["conflict"][in_question]
    score = -columns["predicted_separation_m"][in_question]
    # `decision_curve` itself puts the row of the people before the weights.
    rates = decision_curve(
        score=score, conflict=conflict, cluster=cluster[in_question], weights=rows[1:]
    )
    if rates is None:
        return np.zeros((2, len(rows)))
    (conflicts,) = _weighted([columns["conflict"] & in_question], cluster, rows)
    missed = rates.missed_at(false_alarm)
    is_known = np.isfinite(missed)
    return np.where(is_known, [np.nan_to_num(missed) * conflicts, conflicts], 0.0)


def _weighted(scenes: Sequence[Bools], cluster: Ints, rows: Floats) -> Floats:
    """Return the size of K sets of scenes under each row of weights, (K, R)."""
    n_clusters = rows.shape[1]
    sums = [
        cluster_sums(
            values=is_in_set.astype(np.float64), cluster=cluster, n_clusters=n_clusters
        )
        for is_in_set in scenes
    ]
    return np.asarray(np.array(sums) @ rows.T)


def _choices(sums: Floats) -> Ints:
    """Return the robot that either half chooses, (2, R), from sums (K, L, 2, 2, R)."""
    over, under = np.moveaxis(sums, 2, 0)
    everybody = best_rival(over.sum(axis=2), under.sum(axis=2), least=True, otherwise=0)
    return np.stack(
        [
            best_rival(
                over[:, :, half],
                under[:, :, half],
                least=True,
                otherwise=int(everybody[0]),
            )
            for half in (0, 1)
        ]
    )


def _cross_scored_rate(sums: Floats, choice: Ints) -> Floats:
    """Return a rate, (R,), each half scored by the other's choice of K robots.

    `sums`, (K, 2, 2, R), are those of the robots.
    """
    row, (by_first, by_second) = np.arange(sums.shape[-1]), choice
    return ratio_of_sums((sums[by_second, :, 0, row] + sums[by_first, :, 1, row]).T)


def _estimate(
    sums: Floats, choice: Ints, people: _People, trials: _Trials, *, number: str
) -> Estimate:
    values = _cross_scored_rate(sums, choice)
    drawn, deleted = values[: people.n_drawn], values[people.n_drawn :]
    fixed = _cross_scored_rate(sums, np.broadcast_to(choice[:, :1], choice.shape))
    return interval_of_choice(
        trials.estimate(number, float(values[0])),
        rechosen=drawn,
        fixed_choice=fixed[1 : people.n_drawn],
        leave_one_out=deleted,
        is_share=True,
    )
