"""Policies against noise at equal misses, and noise on top of policies.

A choice among options is made on half of the people and scored on the other half, and
the reverse: the best of many noisy numbers is good partly by chance. Every replicate of
the two-way bootstrap repeats the choice. All options have the same people, routes and
draws, so that differences are paired.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np

from attacks.following.logs import first_half
from isac_track.intervals import Estimate, effective_clusters, estimate_from_replicates
from isac_track.patrols.equal_alarms import alarm_curve, drawn_misses
from isac_track.patrols.intervals import cluster_numbers, sum_clusters, two_way_weights
from isac_track.patrols.metrics import UtilityCounts

SLACKS: Final = (0.05, 0.10)
"""Rises of the misses over `everything` with raw that a choice may cost."""
SAMPLES: Final = ("window", "near", "ahead")
POSITIONS: Final = (*SAMPLES, "state")
"""Policies that are compared with noise; the control `random` is not."""
PAIRED: Final = ("kalman_cv", "own chains")
PAIRED_POLICIES: Final = ("near:3.5", "ahead:2", "ahead:1.2", "state:2")
"""Robot, adversary and policies whose mechanisms are compared in pairs."""
LEAST_NOISES: Final = 5
"""Mechanisms with `everything` below which a recording is not compared."""
MISSED: Final = "missed_future_rate"
CRITERIA: Final = (MISSED, "missed_future_at_equal_false_alarms")
Array = np.ndarray[Any, np.dtype[Any]]


@dataclass(frozen=True)
class Option:
    """Counts of a policy with a mechanism; robots and adversaries by name."""

    mechanism: str
    policy: str
    group: tuple[str, ...]
    seed: int
    instants: Array  # (N,)
    known: Mapping[str, Array]  # (N, F)
    misses: Mapping[str, UtilityCounts]

    @property
    def family(self) -> str:
        """Name of the policy without its parameters."""
        return self.policy.partition(":")[0]


@dataclass(frozen=True)
class Matched:
    """A choice of options against another, at misses and knowledge of both."""

    dataset: str
    question: str
    robot: str
    criterion: str
    known_by: str
    slack: float | None
    choice: str  # As chosen on either half; or of all people.
    against: str
    missed: float
    missed_low: float
    missed_high: float
    missed_against: float
    missed_more: float
    missed_more_low: float
    missed_more_high: float
    known: float
    known_low: float
    known_high: float
    known_against: float
    known_less: float
    known_less_low: float
    known_less_high: float
    n: int


MATCHED_FIELDS: Final = [field.name for field in fields(Matched)]


@dataclass(frozen=True)
class Scores:
    """Misses and knowledge of K options on some people, under 1 + B draws."""

    missed: Array  # (K, 1 + B)
    known: Array  # (K, 1 + B)

    def at(self, rows: Array) -> "Scores":
        """Return the scores of an option for each draw, (1, 1 + B)."""
        place = rows[None]
        return Scores(
            np.take_along_axis(self.missed, place, axis=0),
            np.take_along_axis(self.known, place, axis=0),
        )

    def only(self, rows: Sequence[int]) -> "Scores":
        """Return the scores of some options."""
        return Scores(self.missed[list(rows)], self.known[list(rows)])


@dataclass(frozen=True)
class Setting:
    """A robot, a criterion and an adversary, with the scores of all options."""

    dataset: str
    robot: str
    criterion: str
    known_by: str
    options: Sequence[Option]
    halves: tuple[Scores, Scores]
    everybody: Scores
    n: int
    effective: float

    @property
    def reference(self) -> int:
        """Row of `everything` with raw."""
        return self.row("raw", "everything")

    def row(self, mechanism: str, policy: str) -> int:
        """Return the row of an option."""
        names = [(option.mechanism, option.policy) for option in self.options]
        return names.index((mechanism, policy))


def compare_options(dataset: str, options: Sequence[Option]) -> Iterator[Matched]:
    """Yield the comparisons of a recording, for each robot, criterion and adversary."""
    noises = {option.mechanism for option in options if option.policy == "everything"}
    if len(noises) < LEAST_NOISES:
        return
    compared = [
        option
        for option in options
        if option.family in POSITIONS or option.policy == "everything"
    ]
    draws = _draws(compared[0])
    known = {
        known_by: _known_totals(compared, known_by, draws)
        for known_by in compared[0].known
    }
    for robot in compared[0].misses:
        for criterion in CRITERIA:
            missed = _missed_totals(compared, robot, criterion, draws)
            for known_by in known:
                setting = _setting(
                    dataset, compared, (robot, criterion, known_by), missed, known
                )
                yield from _against_noise(setting)
                yield from _on_top(setting)


@dataclass(frozen=True)
class Draws:
    """How often people and routes are drawn, and the clusters of either half."""

    cluster: Array  # (N,)
    people: Array  # (1 + B, C)
    routes: Array  # (1 + B, R)
    halves: tuple[Array, Array]  # Numbers of clusters.


@dataclass(frozen=True)
class Totals:
    """Hits and trials of K options on either half of the people, (2, K, 1 + B)."""

    hits: Array
    trials: Array

    def shares(self) -> tuple[Array, Array, Array]:
        """Return the shares of either half and of everybody, (K, 1 + B) each."""
        first, second = self.hits / self.trials
        return first, second, self.hits.sum(axis=0) / self.trials.sum(axis=0)


def _draws(option: Option) -> Draws:
    cluster = cluster_numbers(option.group)
    is_first = np.zeros(int(cluster.max()) + 1, dtype=bool)
    is_first[cluster] = first_half(option.group)
    n_routes = next(iter(option.misses.values())).allowed.size
    people, routes = two_way_weights(
        n_clusters=is_first.size, n_routes=n_routes, seed=option.seed
    )
    halves = np.flatnonzero(is_first), np.flatnonzero(~is_first)
    return Draws(cluster, people, routes, halves)


def _known_totals(options: Sequence[Option], known_by: str, draws: Draws) -> Totals:
    """Return the instants that an adversary knows of all."""
    hits, trials = [], []
    for option in options:
        counted = option.known[known_by]
        instants = option.instants[:, None] * np.ones((1, counted.shape[1]))
        hits.append(_drawn(sum_clusters(counted, draws.cluster), draws))
        trials.append(_drawn(sum_clusters(instants, draws.cluster), draws))
    return Totals(np.swapaxes(hits, 0, 1), np.swapaxes(trials, 0, 1))


def _missed_totals(
    options: Sequence[Option], robot: str, criterion: str, draws: Draws
) -> Totals:
    """Return the future conflicts that a robot misses of all."""
    hits, trials = [], []
    for option in options:
        counts = option.misses[robot]
        total = _drawn(sum_clusters(counts.trials[MISSED], draws.cluster), draws)
        trials.append(total)
        if criterion == MISSED:
            missed = sum_clusters(counts.hits[MISSED], draws.cluster)
            hits.append(_drawn(missed, draws))
            continue
        curve = alarm_curve(counts.by_distance, cluster=draws.cluster)
        shares = [
            drawn_misses(
                replace(curve, missed=curve.missed[:, half], trials=curve.trials[half]),
                reference=counts.allowed.astype(np.float64),
                people=draws.people[:, half],
                routes=draws.routes,
            )
            for half in draws.halves
        ]
        hits.append(np.array(shares) * total)
    return Totals(np.swapaxes(hits, 0, 1), np.swapaxes(trials, 0, 1))


def _drawn(counts: Array, draws: Draws) -> Array:
    """Return the drawn sums of counts by cluster and route, on either half, (2, 1 + B)."""
    return np.stack(
        [
            ((draws.people[:, half] @ counts[half]) * draws.routes).sum(axis=1)
            for half in draws.halves
        ]
    )


def _setting(
    dataset: str,
    options: Sequence[Option],
    names: tuple[str, str, str],
    missed: Totals,
    known: Mapping[str, Totals],
) -> Setting:
    robot, criterion, known_by = names
    scores = [
        Scores(*shares)
        for shares in zip(missed.shares(), known[known_by].shares(), strict=True)
    ]
    cluster = cluster_numbers(options[0].group)
    trials = sum_clusters(options[0].misses[robot].trials[MISSED], cluster).sum(axis=1)
    return Setting(
        dataset=dataset,
        robot=robot,
        criterion=criterion,
        known_by=known_by,
        options=options,
        halves=(scores[0], scores[1]),
        everybody=scores[2],
        n=int((trials > 0).sum()),
        effective=effective_clusters(trials),
    )


def _against_noise(setting: Setting) -> Iterator[Matched]:
    """Yield the best policy without noise against noise at as many misses."""
    noises = _noise_families(setting)
    for question, names in (("positions", POSITIONS), ("samples", SAMPLES)):
        rows = [
            row
            for row, option in enumerate(setting.options)
            if option.mechanism == "raw" and option.family in names
        ]
        for slack in SLACKS:
            ours, theirs, chosen, rivals = [], [], [], []
            for a, b in (setting.halves, setting.halves[::-1]):
                choice = _choose(a, rows, setting.reference, slack)
                policy = a.at(choice)
                at_equal = np.array(
                    [
                        _interpolate(a.only(noise), policy.missed[0])[1]
                        for noise in noises
                    ]
                )
                family = at_equal.argmin(axis=0)
                scored = b.at(choice)
                reached = np.array(
                    [_interpolate(b.only(noise), scored.missed[0]) for noise in noises]
                )
                draws = np.arange(family.size)
                ours.append(scored)
                theirs.append(
                    Scores(
                        reached[family, 0, draws][None], reached[family, 1, draws][None]
                    )
                )
                chosen.append(_name(setting.options[choice[0]]))
                is_raw = scored.missed[0, 0] <= b.missed[setting.reference, 0]
                noise = noises[family[0]][-1]
                rivals.append("raw" if is_raw else _noise_name(setting.options[noise]))
            yield _matched(
                setting,
                f"{question} against noise",
                slack,
                _joined(chosen),
                _joined(rivals),
                _mean(ours),
                _mean(theirs),
            )


def _on_top(setting: Setting) -> Iterator[Matched]:
    """Yield what noise adds on top of policies: chosen by halves, and each pair."""
    policies = [
        row for row, option in enumerate(setting.options) if option.family in POSITIONS
    ]
    plain = [row for row in policies if setting.options[row].mechanism == "raw"]
    for slack in SLACKS:
        sides: list[list[Scores]] = [[], []]
        names: list[list[str]] = [[], []]
        for a, b in (setting.halves, setting.halves[::-1]):
            for side, rows in enumerate((policies, plain)):
                choice = _choose(a, rows, setting.reference, slack)
                sides[side].append(b.at(choice))
                names[side].append(_name(setting.options[choice[0]]))
        yield _matched(
            setting,
            "policies with noise against policies without",
            slack,
            _joined(names[0]),
            _joined(names[1]),
            _mean(sides[0]),
            _mean(sides[1]),
        )
    if (setting.robot, setting.known_by) != PAIRED:
        return
    for row in policies:
        option = setting.options[row]
        if row in plain or option.policy not in PAIRED_POLICIES:
            continue
        other = setting.row("raw", option.policy)
        yield _matched(
            setting,
            "noise on a policy",
            None,
            _name(option),
            _name(setting.options[other]),
            setting.everybody.only([row]),
            setting.everybody.only([other]),
        )


def _choose(scores: Scores, rows: Sequence[int], reference: int, slack: float) -> Array:
    """Return the option of least knowledge within the allowed misses, (1 + B,).

    Without such an option it is the reference.
    """
    within = scores.missed[list(rows)] <= scores.missed[reference] + slack
    known = np.where(within, scores.known[list(rows)], np.inf)
    best = np.asarray(rows)[known.argmin(axis=0)]
    return np.where(np.isfinite(known.min(axis=0)), best, reference)


def _noise_families(setting: Setting) -> list[list[int]]:
    """Return the rows of `everything` by mechanism, from raw to the most misses."""
    families: dict[str, list[int]] = {}
    for row, option in enumerate(setting.options):
        if option.policy == "everything" and option.mechanism != "raw":
            families.setdefault(_noise_name(option), []).append(row)
    missed = setting.everybody.missed[:, 0]
    return [
        [setting.reference, *sorted(rows, key=lambda row: missed[row])]
        for rows in families.values()
    ]


def _interpolate(scores: Scores, missed: Array) -> tuple[Array, Array]:
    """Return misses and knowledge of noise of a level with as many misses, (1 + B,).

    Between two levels both are interpolated; beyond the last level it is the last.
    """
    levels = np.maximum.accumulate(scores.missed, axis=0)
    reached, known = levels[0].copy(), scores.known[0].copy()
    for low, high in zip(range(len(levels) - 1), range(1, len(levels)), strict=True):
        span = levels[high] - levels[low]
        share = np.ones(missed.size)
        np.divide(missed - levels[low], span, out=share, where=span > 0)
        share = np.clip(share, 0.0, 1.0)
        is_beyond = missed > levels[low]
        between = scores.known[low] + share * (scores.known[high] - scores.known[low])
        known = np.where(is_beyond, between, known)
        reached = np.where(is_beyond, levels[low] + share * span, reached)
    return reached, known


def _mean(halves: Sequence[Scores]) -> Scores:
    return Scores(
        np.mean([half.missed for half in halves], axis=0),
        np.mean([half.known for half in halves], axis=0),
    )


def _matched(
    setting: Setting,
    question: str,
    slack: float | None,
    choice: str,
    against: str,
    ours: Scores,
    theirs: Scores,
) -> Matched:
    missed, known = (_estimate(setting, side) for side in (ours.missed, ours.known))
    more = _estimate(setting, ours.missed - theirs.missed)
    less = _estimate(setting, theirs.known - ours.known)
    return Matched(
        dataset=setting.dataset,
        question=question,
        robot=setting.robot,
        criterion=setting.criterion,
        known_by=setting.known_by,
        slack=slack,
        choice=choice,
        against=against,
        missed=missed.value,
        missed_low=missed.ci_low,
        missed_high=missed.ci_high,
        missed_against=float(theirs.missed[0, 0]),
        missed_more=more.value,
        missed_more_low=more.ci_low,
        missed_more_high=more.ci_high,
        known=known.value,
        known_low=known.ci_low,
        known_high=known.ci_high,
        known_against=float(theirs.known[0, 0]),
        known_less=less.value,
        known_less_low=less.ci_low,
        known_less_high=less.ci_high,
        n=setting.n,
    )


def _estimate(setting: Setting, values: Array) -> Estimate:
    return estimate_from_replicates(values[0], n=setting.n, effective=setting.effective)


def _name(option: Option) -> str:
    if option.mechanism == "raw":
        return option.policy
    return f"{option.policy} with {option.mechanism}"


def _noise_name(option: Option) -> str:
    """Return the mechanism without its level."""
    name, _, rest = option.mechanism.partition(":")
    parameters = rest.partition(",")[2]
    return f"{name}:{parameters}" if parameters else name


def _joined(names: Sequence[str]) -> str:
    return " / ".join(dict.fromkeys(names))
