"""The recommended levels of a site: decided only here, from `levels.csv`.

First screen, page, `evaluation.design` and the notebook read the result of `recommend`.
A limit is met only if the upper end of the interval meets it; a limit that was not
tried is not met. Nothing is interpolated.
"""

import math
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal, TypeAlias

import numpy as np
import pandas as pd

from attacks.tasks.task_list import TASKS
from evaluation.estimates.best_robot import BEST
from evaluation.estimates.families import ADDING_RULES, RAW, Family
from evaluation.estimates.metrics import (
    CHANCE,
    DESCRIPTORS,
    EQUAL_ALARMS,
    FALSE_ALARMS,
    FUTURE_EQUAL_ALARMS,
    LINKAGE_SHARE,
    MEDIAN_ERROR,
    METRICS,
    MISSED_RATE,
    PLR,
    PLR_WIDE,
    RANK1,
    RANK1_AMONG_100,
)
from evaluation.estimates.pareto import beats
from evaluation.estimates.strongest import BEYOND
from evaluation.estimates.strongest_table import SINGLE_RELEASE
from evaluation.plan.address import AS_SHARED, Address, Where, parse_consumer, parse_row
from evaluation.plan.world import World
from isac_track.errors import SettingsError, did_you_mean
from isac_track.intervals import FEWEST_EFFECTIVE, Estimate

MOST_PLR: Final = 0.5  # After attack: below it most positions stay private.
MOST_LINKAGE_SHARE: Final = 0.5  # Of raw's rank 1 above chance.
HORIZON_S: Final = 3.0
MOST_PROPOSALS: Final = 5
# Up to so many times the scenes of a run, new scenes still show new people.
MOST_TIMES: Final = 10.0
LEADING: Final = "handover-1s"
MISSED, LINKED = "missed", "linkage_share"
# Metric by the name of a limit, in a question and in an answer.
LIMITS: Final = {
    MISSED: MISSED_RATE,
    "false_alarm": FALSE_ALARMS,
    **dict(zip(DESCRIPTORS, DESCRIPTORS, strict=True)),
    RANK1: RANK1,
    LINKED: RANK1,
}
"""Metrics that may be limited; `rank1` is of every task of the recording."""
USUAL: Final[Mapping[str, float]] = {PLR: MOST_PLR, LINKED: MOST_LINKAGE_SHARE}
"""Default limits."""
Unknown: TypeAlias = Literal[
    "no horizon",
    "no robot",
    "no attack",
    "no handover",
    "no task",
    "adversary not tried",
    "shortcut",
    "attack too weak",
    "no value",
    "too few people",
]
"""Reason that a check has no answer."""
WEAK: Final = "attack too weak"
UNKNOWN: Final = Estimate(math.nan)


@dataclass(frozen=True, slots=True)
class Criterion:
    """The conflicts by which levels are chosen, at raw's false-alarm rate."""

    conflicts: Literal["missed_future", "missed"] = "missed_future"  # To come, or all.
    horizon_s: float | None = HORIZON_S  # None: the run's own.

    @property
    def metric(self) -> str:
        """The metric of `levels.csv`."""
        return (
            FUTURE_EQUAL_ALARMS if self.conflicts == "missed_future" else EQUAL_ALARMS
        )

    @property
    def world(self) -> World:
        """The world of the robots' numbers."""
        return World(horizon_s=self.horizon_s)


@dataclass(frozen=True, slots=True)
class Question:
    """Limits that a level must hold, against which adversaries, and for which robot.

    Raises SettingsError for a limit out of range or an unknown adversary.
    """

    limits: Mapping[str, float] = field(default_factory=lambda: dict(USUAL))
    """By name of `LIMITS`: fractions or s. A linkage share of 1 is no limit."""
    against: tuple[str, ...] = ()  # Adversaries beyond one release that also count.
    criterion: Criterion = Criterion()
    robot: str = ""  # Predictor; empty: the best robot of the run, cross-fitted.
    adding: tuple[str, ...] = ADDING_RULES  # All of them must hold.
    only: tuple[str, ...] = ()  # Families; empty: all.
    as_shared: bool = False  # Descriptors are limited as shared, not as reconstructed.

    def __post_init__(self) -> None:
        for name, limit in self.limits.items():
            is_share = METRICS[LIMITS[name]].is_share
            if not 0.0 <= limit <= (1.0 if is_share else sys.float_info.max):
                kind = "time in s, 0 or more"
                if is_share:
                    kind = "fraction from 0 to 1 (0.2 for 20 %)"
                option = f"--max-{name.replace('_', '-')}"
                raise SettingsError(f"{option} is a {kind}, got {limit:g}")
        for name in self.against:
            if name not in BEYOND:
                hint = (
                    did_you_mean(name, BEYOND, quote="'")
                    or f"; known: {', '.join(BEYOND)}"
                )
                raise SettingsError(f"--against {name}: no such adversary{hint}")

    @property
    def asks_linkage(self) -> bool:
        """Whether linkage after a silence is limited."""
        return self.limits.get(LINKED, 1.0) < 1.0


def default_question(known: Mapping[str, Family]) -> Question:
    """Return the first screen's question; it asks only for adding rules of the run."""
    rules = {
        family.adding for family in known.values() if family.adding and family.protects
    }
    usual = Question()
    fitting = tuple(rule for rule in usual.adding if rule in rules)
    return Question(adding=fitting or usual.adding)


@dataclass(frozen=True, slots=True)
class Check:
    """One limit at one level."""

    name: str  # As in `LIMITS`, `plr_wide`, or `rank1/TASK`.
    limit: float  # Infinite: the number must be known.
    measured: Estimate
    source: Address | None = None  # The positions, or the linker, that it is of.
    adversary: str = ""  # `SINGLE_RELEASE` or a name, for a number after attack.
    scenes: int = 0  # Number of scenes behind it; 0: it is not about scenes.
    missing: Unknown | None = None

    @property
    def unknown(self) -> Unknown | None:
        """Reason that there is no answer; None with an answer."""
        if self.missing is not None:
            return self.missing
        if math.isnan(self.measured.value):
            return "no value"
        is_few = 0 < self.measured.n < FEWEST_EFFECTIVE
        if is_few or not math.isfinite(self.measured.ci_high):
            return "too few people"
        return None

    @property
    def status(self) -> str:
        """Answer: met (the upper end is at most the limit), not met, or cannot say."""
        if self.unknown:
            return "cannot say"
        return "met" if self.measured.ci_high <= self.limit else "not met"

    @property
    def excess(self) -> float:
        """Relative excess of the upper end, or else of the value, over the limit."""
        ends = (self.measured.ci_high, self.measured.value)
        upper = next((end for end in ends if math.isfinite(end)), self.limit)
        if not upper > self.limit:
            return 0.0
        return upper / self.limit - 1.0 if self.limit > 0.0 else math.inf

    @property
    def times_more(self) -> float:
        """Factor of data that would part the value from its limit.

        An interval narrows with the root of the factor. NaN unless the limit is within
        the interval.
        """
        measured = self.measured
        value, low, high = measured.value, measured.ci_low, measured.ci_high
        if self.status != "not met" or not low < self.limit:
            return math.nan
        side = high - value if value <= self.limit else value - low
        gap = abs(self.limit - value)
        return (side / gap) ** 2 if gap > 0.0 else math.inf

    @property
    def asks(self) -> str:
        """Data that would give an answer: more scenes, or other people."""
        return "scenes" if self.scenes and self.times_more <= MOST_TIMES else "people"


@dataclass(frozen=True, slots=True)
class AttackNumbers:
    """Numbers after the strongest attack of an adversary at a level."""

    adversary: str  # `SINGLE_RELEASE`, or a name.
    source: Address | None = None  # None: it was not tried.
    numbers: Mapping[str, Estimate] = field(default_factory=dict)  # By metric.

    def value(self, metric: str) -> Estimate:
        """Return a number, unknown if there is none."""
        return self.numbers.get(metric, UNKNOWN)

    def breaks(self, limit: float) -> bool | None:
        """Return whether PLR, at epsilon or wider, breaks a limit.

        None: the adversary was not tried, or too few people tell.
        """
        statuses = {
            Check(name, limit, self.value(name)).status for name in (PLR, PLR_WIDE)
        }
        if "not met" in statuses:
            return True
        return None if "cannot say" in statuses else False


@dataclass(frozen=True, slots=True)
class TaskLinkage:
    """Success of the strongest linker in a task."""

    task: str
    source: Address | None = None  # None: it was not run at this level.
    metric: str = RANK1  # Rank 1, or that of 100 candidates.
    rank1: Estimate = UNKNOWN
    chance: float = math.nan
    share: Estimate = UNKNOWN  # Of raw's rank 1 above chance.
    missing: Unknown | None = None


@dataclass(frozen=True, slots=True)
class Offer:
    """Cost and privacy of a level, and its checks against the limits."""

    where: Where
    family: Family
    cost: Estimate  # Missed conflicts of the robot, by the criterion.
    robots: Mapping[str, Estimate]  # Cost of every robot of the run by its name.
    shared: AttackNumbers
    attacked: AttackNumbers  # After one release.
    beyond: tuple[
        AttackNumbers, ...
    ]  # After each adversary that knows more, tried or not.
    linked: TaskLinkage | None  # In the leading handover; None: the run has none.
    tasks: tuple[TaskLinkage, ...]
    checks: tuple[Check, ...] = ()
    lacks_rule: str = ""  # Adding rule under which its mechanism does not hold.

    @property
    def met(self) -> bool:
        """Whether every limit holds."""
        return all(check.status == "met" for check in self.checks)

    @property
    def failing(self) -> tuple[Check, ...]:
        """Limits that do not hold, or have no answer."""
        return tuple(check for check in self.checks if check.status != "met")

    @property
    def coordinates(self) -> tuple[float, float, float]:
        """Cost, PLR after attack, and linkage: less is better.

        An unknown number is infinite: it beats no known number, and equals another
        unknown one. A level with an unknown limit is never proposed (`met`).
        """
        exposed = self.attacked if self.attacked.source else self.shared
        linked = self.linked.rank1.value if self.linked else math.nan
        plr = exposed.value(PLR).value
        cost, plr, rank1 = (
            math.inf if math.isnan(value) else value
            for value in (self.cost.value, plr, linked)
        )
        return cost, plr, rank1


@dataclass(frozen=True, slots=True)
class Recommendation:
    """The answer: the levels that hold all limits, or the nearest."""

    question: Question
    robots: tuple[str, ...]
    """The robot named, or the best of the run: the choices of the first and the second
    half of the people, each scored on the other half. Empty: no robot has the
    criterion."""
    raw: Offer | None
    proposals: tuple[Offer, ...]  # Non-dominated, cheapest first.
    refused: tuple[Offer, ...]  # Levels that do not hold, nearest first.
    missing: tuple[Unknown, ...]  # Reasons that no level has an answer to some limit.
    task: str  # The leading handover; empty if there is none.

    @property
    def robot(self) -> str:
        """The robot behind the costs; two names if the halves chose two robots."""
        return " or ".join(dict.fromkeys(self.robots))

    @property
    def met(self) -> bool:
        """Whether some level holds all limits."""
        return bool(self.proposals)

    @property
    def nearest(self) -> Offer | None:
        """The level that comes closest, if none holds."""
        return None if self.proposals or not self.refused else self.refused[0]

    @property
    def unsettled(self) -> tuple[Offer, ...]:
        """The few best levels with no limit broken, if no level holds all of them."""
        undecided = [
            offer
            for offer in self.refused
            if not offer.lacks_rule
            and all(check.status != "not met" for check in offer.checks)
        ]
        return () if self.proposals else tuple(cheapest(non_dominated(undecided)))

    @property
    def candidates(self) -> tuple[Offer, ...]:
        """Levels on which adversaries that know more should be tried."""
        return self.proposals or self.unsettled or self.refused[:1]


def recommend(
    table: pd.DataFrame,
    question: Question,
    *,
    dataset: str,
    scenes: tuple[int, int] = (0, 0),
) -> Recommendation:
    """Return the levels that hold the limits of a question, or the nearest.

    `table` is `levels.csv` of a run, `scenes` the number of scenes for attacks and the
    number for robots. Raises SettingsError for a family or a robot that the run does
    not have.
    """
    known = _levels(table, dataset)
    raw_rows = next((level for level in known if level.family.family == RAW), None)
    rivals = [
        level for level in known if level.family.protects and level.family.is_added
    ]
    _check_names(rivals, question)
    robots = _robot_names(known)
    if question.robot and question.robot not in robots:
        raise SettingsError(
            f"--predictor {question.robot}: the run has {', '.join(robots) or 'none'};"
            " name one of these or add it with the command of the run"
        )
    robot = question.robot or BEST[question.criterion.metric]
    task = leading_handover({row.source.task for level in known for row in level.rows})
    frame = _Frame(question, robot, task, scenes, robots=robots)
    asked = [
        level
        for level in rivals
        if (
            not question.only
            or {level.family.family, level.family.name} & {*question.only}
        )
        and {*level.family.rules} & {*question.adding}
    ]
    offers = _under_all_rules([frame.offer(level) for level in asked], question.adding)
    fitting = [offer for offer in offers if offer.met and not offer.lacks_rule]
    proposals = cheapest(non_dominated(fitting))
    refused = sorted(
        (offer for offer in offers if not offer.met or offer.lacks_rule), key=_distance
    )
    return Recommendation(
        question=question,
        robots=(
            (robot,) if question.robot else _chosen_robots(known, question.criterion)
        ),
        raw=frame.offer(raw_rows) if raw_rows else None,
        proposals=tuple(proposals),
        refused=tuple(refused),
        missing=_missing_everywhere(offers),
        task=task,
    )


def non_dominated(offers: Sequence[Offer]) -> list[Offer]:
    """Return the offers that no other beats: as low in all coordinates, lower in any.

    Only an offer under the same adding rules can beat another: a network that cannot
    add linearly has no use for a level that does. Of equal offers the first stays.
    """
    values = np.array([offer.coordinates for offer in offers]).reshape(len(offers), 3)
    rules = [{*offer.family.rules} for offer in offers]
    is_rival = np.array(
        [[own <= others for own in rules] for others in rules], dtype=bool
    ).reshape(len(offers), len(offers))
    is_beaten = (beats(values) & is_rival).any(axis=0)
    is_equal = (values[:, None] == values[None]).all(axis=2)
    # Above the diagonal: of an earlier offer.
    is_repeated = np.triu(is_equal & is_rival, k=1).any(axis=0)
    is_out = (is_beaten | is_repeated).tolist()
    return [offer for offer, out in zip(offers, is_out, strict=True) if not out]


def cheapest(offers: Sequence[Offer]) -> list[Offer]:
    """Return the few cheapest offers, in order of cost."""
    return sorted(offers, key=lambda offer: offer.coordinates)[:MOST_PROPOSALS]


def _distance(offer: Offer) -> tuple[int, float, float]:
    """Return an offer's distance: number of limits missed, worst excess, and cost."""
    excess = [check.excess for check in offer.checks]
    n_missed = sum(
        check.status == "not met" or check.excess > 0.0 for check in offer.checks
    )
    return n_missed, max(excess, default=0.0), offer.coordinates[0]


def _under_all_rules(offers: Sequence[Offer], adding: Sequence[str]) -> list[Offer]:
    """Return offers, each with a rule under which its mechanism holds nowhere."""
    rules_met: dict[str, set[str]] = {}
    for offer in offers:
        if offer.met:
            rules_met.setdefault(offer.family.name, set()).update(offer.family.rules)
    marked = []
    for offer in offers:
        needed = (
            () if offer.family.has_fixed_rule or not offer.family.adding else adding
        )
        lacking = [
            rule
            for rule in needed
            if rule not in rules_met.get(offer.family.name, set())
        ]
        rule = lacking[0] if offer.met and lacking else ""
        marked.append(replace(offer, lacks_rule=rule))
    return marked


def _missing_everywhere(offers: Sequence[Offer]) -> tuple[Unknown, ...]:
    """Return the reasons of limits that can be judged at no level at all."""
    by_name: dict[tuple[str, str], list[Unknown | None]] = {}
    for offer in offers:
        for check in offer.checks:
            by_name.setdefault((check.name, check.adversary), []).append(check.unknown)
    codes = (
        code
        for unknowns in by_name.values()
        if all(unknowns)
        for code in unknowns
        if code
    )
    return tuple(dict.fromkeys(codes))


@dataclass(frozen=True, slots=True)
class _Row:
    """A number of a level."""

    world: World
    adversary: str
    source: Address
    metric: str
    measured: Estimate
    outcome: str
    invalid: str
    chosen: tuple[str, str]  # By either half of the people.


@dataclass(frozen=True, slots=True)
class _Level:
    """All numbers of a level."""

    where: Where
    family: Family
    rows: tuple[_Row, ...]


def _levels(table: pd.DataFrame, dataset: str) -> list[_Level]:
    """Return the levels of a table, each with its numbers."""
    rows: dict[Where, list[_Row]] = {}
    families: dict[Where, Family] = {}
    chosen = ("first_choice", "second_choice")
    texts = (*chosen, "outcome", "invalid", "adversary", "knowledge", "adding")
    tidy = table.assign(
        **{name: table[name].astype(object).fillna("") for name in texts}
    )
    for row in tidy.to_dict("records"):
        address = parse_row(row)
        if address.recording != dataset:
            # Simulated people beside a recording.
            continue
        where = address.where
        families[where] = Family(
            row["mechanism"],
            row["family"],
            row["adding"],
            protects=bool(row["protects"]),
        )
        number = Estimate(row["value"], row["ci_low"], row["ci_high"], int(row["n"]))
        about = (
            row["adversary"],
            address.source,
            row["metric"],
            number,
            row["outcome"],
            row["invalid"],
        )
        by_halves = row["first_choice"], row["second_choice"]
        rows.setdefault(where, []).append(_Row(address.world, *about, chosen=by_halves))
    return [
        _Level(where, families[where], tuple(numbers))
        for where, numbers in rows.items()
    ]


def _check_names(levels: Iterable[_Level], question: Question) -> None:
    families = [level.family for level in levels]
    known = dict.fromkeys(
        text for family in families for text in (family.family, family.name)
    )
    for name in question.only:
        if name not in known:
            hint = (
                did_you_mean(name, known, quote="'") or f"; it has {', '.join(known)}"
            )
            raise SettingsError(
                f"--family {name}: the run has no such family that protects{hint}"
            )


def _robot_names(levels: Sequence[_Level]) -> tuple[str, ...]:
    """Return the predictors of a run by name."""
    names = (
        row.source.consumer
        for metric in (EQUAL_ALARMS, FALSE_ALARMS)
        for level in levels
        for row in level.rows
        if row.metric == metric
    )
    return tuple(name for name in dict.fromkeys(names) if name not in BEST.values())


def _chosen_robots(levels: Iterable[_Level], criterion: Criterion) -> tuple[str, ...]:
    """Return the predictor that either half of the people chose; empty without any."""
    best = BEST[criterion.metric]
    chosen = (
        row.chosen
        for level in levels
        for row in level.rows
        if row.source.consumer == best and row.world == criterion.world
    )
    return next(chosen, ())


def leading_handover(names: Collection[str]) -> str:
    """Return the task by which linkage is judged; empty if there is no handover."""
    handovers = [
        name for name, task in TASKS.items() if task.gap_s > 0.0 and name in names
    ]
    return LEADING if LEADING in handovers else next(iter(handovers), "")


@dataclass(frozen=True, slots=True)
class _Frame:
    """The question and the run, against which every level is checked."""

    question: Question
    robot: str  # Whose costs count: a name, or one of `BEST`.
    task: str
    scenes: tuple[int, int]
    robots: tuple[str, ...]

    def offer(self, level: _Level) -> Offer:
        """Return cost and privacy of a level, with its checks."""
        criterion = self.question.criterion
        robots = {
            row.source.consumer: row.measured
            for row in level.rows
            if row.world == criterion.world and row.metric == criterion.metric
        }
        cost = robots.get(self.robot, UNKNOWN)
        tasks = tuple(_linked(level, task) for task in _tasks(level))
        offer = Offer(
            where=level.where,
            family=level.family,
            cost=cost,
            robots={name: rate for name, rate in robots.items() if name in self.robots},
            shared=_attacked(level, "", source=AS_SHARED),
            attacked=_attacked(level, SINGLE_RELEASE),
            beyond=tuple(_attacked(level, name) for name in BEYOND),
            linked=_linked(level, self.task) if self.task else None,
            tasks=tasks,
        )
        checks = (
            *self._costs(offer, level),
            *self._exposure(offer),
            *self._linkage(offer),
        )
        return replace(offer, checks=checks)

    def _costs(self, offer: Offer, level: _Level) -> list[Check]:
        limits, criterion = self.question.limits, self.question.criterion
        n_scenes = self.scenes[1]
        worlds = {row.world for row in level.rows}
        missing: Unknown | None = None
        if not self.robots:
            missing = "no robot"
        elif criterion.world not in worlds:
            missing = "no horizon"
        elif math.isnan(offer.cost.value):
            missing = "no value"
        source, most = parse_consumer(self.robot), limits.get(MISSED, math.inf)
        checks = [
            Check(MISSED, most, offer.cost, source, scenes=n_scenes, missing=missing)
        ]
        if "false_alarm" in limits:
            rates = (
                row.measured
                for row in level.rows
                if row.metric == FALSE_ALARMS
                and row.source == source
                and row.world == criterion.world
            )
            rate = next(rates, UNKNOWN)
            checks.append(
                Check(
                    "false_alarm",
                    limits["false_alarm"],
                    rate,
                    source,
                    scenes=n_scenes,
                    missing=missing,
                )
            )
        if MISSED not in limits and not missing:
            # Without a limit any known cost is fine, even without an interval.
            return checks[1:]
        return checks

    def _exposure(self, offer: Offer) -> list[Check]:
        question, checks = self.question, list[Check]()
        sides = [offer.shared if question.as_shared else offer.attacked]
        sides += [side for side in offer.beyond if side.adversary in question.against]
        for side in sides:
            # An adversary that was not tried gets no further check.
            for name in (*DESCRIPTORS, PLR_WIDE) if side.source else DESCRIPTORS:
                limit = question.limits.get(PLR if name == PLR_WIDE else name)
                if limit is None:
                    continue
                untried: Unknown = (
                    "adversary not tried" if side.adversary in BEYOND else "no attack"
                )
                checks.append(
                    Check(
                        name,
                        limit,
                        side.value(name),
                        side.source,
                        side.adversary,
                        scenes=self.scenes[0],
                        missing=untried if side.source is None else None,
                    )
                )
        return checks

    def _linkage(self, offer: Offer) -> list[Check]:
        question, checks = self.question, list[Check]()
        if question.asks_linkage:
            linked = offer.linked or TaskLinkage("", missing="no handover")
            limit = question.limits[LINKED]
            source, missing = linked.source, linked.missing
            checks.append(Check(LINKED, limit, linked.share, source, missing=missing))
        if RANK1 in question.limits:
            limit = question.limits[RANK1]
            for task in offer.tasks or (TaskLinkage("", missing="no task"),):
                name = f"{RANK1}/{task.task}"
                checks.append(
                    Check(name, limit, task.rank1, task.source, missing=task.missing)
                )
        return checks


def _tasks(level: _Level) -> list[str]:
    return [*dict.fromkeys(row.source.task for row in level.rows if row.source.task)]


def _attacked(
    level: _Level, adversary: str, *, source: Address | None = None
) -> AttackNumbers:
    """Return the numbers after an adversary's attack, the strongest by PLR."""
    rows = [
        row
        for row in level.rows
        if row.adversary == adversary
        and not row.source.task
        and (source is None or row.source == source)
        and row.metric in {*DESCRIPTORS, PLR_WIDE, MEDIAN_ERROR}
    ]
    by_plr = next((row.source for row in rows if row.metric == PLR), None)
    return AttackNumbers(adversary, by_plr, {row.metric: row.measured for row in rows})


def _linked(level: _Level, task: str) -> TaskLinkage:
    """Return the success of a task's strongest linker at a level."""
    rows = {row.metric: row for row in level.rows if row.source.task == task}
    metric = RANK1_AMONG_100 if RANK1_AMONG_100 in rows else RANK1
    if metric not in rows:
        return TaskLinkage(task, missing="no attack")
    rank1 = rows[metric]
    missing: Unknown | None = None
    if rank1.invalid:
        missing = "shortcut"
    elif rank1.outcome == WEAK:
        missing = WEAK
    numbers = {name: row.measured for name, row in rows.items()}
    share = numbers.get(LINKAGE_SHARE, UNKNOWN)
    chance = numbers.get(CHANCE, UNKNOWN).value
    return TaskLinkage(
        task, rank1.source, metric, rank1.measured, chance, share, missing
    )
