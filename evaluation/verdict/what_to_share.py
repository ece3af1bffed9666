"""Which levels a site may be told to share: decided here alone, from `levels.csv`.

First screen, page, `evaluation.design` and the notebook read what `recommend` returns.
A limit is met only if the upper end of the interval meets it; what was not tried is not
met. Nothing is interpolated.
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
from evaluation.estimates.keys import AS_SHARED, Source, Where
from evaluation.estimates.metrics import (
    DESCRIPTORS,
    EQUAL_ALARMS,
    EXPOSURE,
    FALSE_ALARMS,
    FUTURE_EQUAL_ALARMS,
    LINKAGE_SHARE,
    MEDIAN,
    METRICS,
    MISSED_RATE,
    SUCCESS,
    SUCCESS_OF_100,
    WIDE,
)
from evaluation.estimates.strongest import BEYOND
from evaluation.estimates.strongest_table import ONE_RELEASE
from isac_track.errors import SettingsError, did_you_mean
from isac_track.intervals import FEWEST_EFFECTIVE, Estimate

MOST_PLR: Final = 0.5  # After attack: below it most positions are kept.
MOST_LINKAGE_SHARE: Final = 0.5  # Of raw's rank 1 above chance.
HORIZON_S: Final = 3.0
MOST_PROPOSALS: Final = 5
# So many times the scenes of a run still bring people who were in none.
MOST_TIMES: Final = 10.0
LEADING: Final = "handover-1s"
MISSED, LINKED = "missed", "linkage_share"
LIMITS: Final = {  # By name in a question and in an answer: the metric.
    MISSED: MISSED_RATE,
    "false_alarm": FALSE_ALARMS,
    **dict(zip(DESCRIPTORS, DESCRIPTORS, strict=True)),
    SUCCESS: SUCCESS,
    LINKED: SUCCESS,
}
"""What may be limited; `rank1` is of every task of the recording."""
USUAL: Final[Mapping[str, float]] = {EXPOSURE: MOST_PLR, LINKED: MOST_LINKAGE_SHARE}
"""Limits that are asked where nobody names others."""
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
"""Why something cannot be said."""
WEAK: Final = "attack too weak"
UNKNOWN: Final = Estimate(math.nan)


@dataclass(frozen=True, slots=True)
class Criterion:
    """The conflicts that levels are chosen by, at raw's false-alarm rate."""

    conflicts: Literal["missed_future", "missed"] = "missed_future"  # To come, or all.
    horizon_s: float | None = HORIZON_S  # None: the run's own.

    @property
    def metric(self) -> str:
        """The metric of `levels.csv`."""
        return (
            FUTURE_EQUAL_ALARMS if self.conflicts == "missed_future" else EQUAL_ALARMS
        )

    @property
    def world(self) -> str:
        """What stands behind the data set's name; empty for the run's own horizon."""
        return "" if self.horizon_s is None else f"horizon={self.horizon_s:.12g}s"


@dataclass(frozen=True, slots=True)
class Question:
    """What a level must hold; SettingsError for a limit out of range or an unknown adversary."""

    limits: Mapping[str, float] = field(default_factory=lambda: dict(USUAL))
    """By name of `LIMITS`: fractions or s. A linkage share of 1 asks nothing."""
    against: tuple[str, ...] = ()  # Adversaries beyond one release that count as well.
    criterion: Criterion = Criterion()
    robot: str = ""  # Predictor; empty: the best robot of the run, cross-fitted.
    adding: tuple[str, ...] = ADDING_RULES  # All of them must hold.
    only: tuple[str, ...] = ()  # Families; empty: every one.
    as_shared: bool = False  # Descriptors are limited as shared, not as reconstructed.

    def __post_init__(self) -> None:
        for name, limit in self.limits.items():
            is_share = METRICS[LIMITS[name]].is_share
            if not 0.0 <= limit <= (1.0 if is_share else sys.float_info.max):
                kind = (
                    "fraction from 0 to 1 (0.2 for 20 %)"
                    if is_share
                    else "time in s, 0 or more"
                )
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
    """Return what the first screen asks: of a run of a single adding rule that alone."""
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
    source: Source | None = None  # Whose positions, or which linker, it is of.
    adversary: str = ""  # `ONE_RELEASE` or a name, of what an attack leaves.
    scenes: int = 0  # That it was measured on; 0: it is not about scenes.
    missing: Unknown | None = None

    @property
    def unknown(self) -> Unknown | None:
        """Why it cannot be said; None if it can."""
        if self.missing is not None:
            return self.missing
        if math.isnan(self.measured.value):
            return "no value"
        is_few = 0 < self.measured.n < FEWEST_EFFECTIVE
        return (
            "too few people"
            if is_few or not math.isfinite(self.measured.ci_high)
            else None
        )

    @property
    def status(self) -> str:
        """Whether the upper end is at or below the limit: met, not met, or cannot say."""
        if self.unknown:
            return "cannot say"
        return "met" if self.measured.ci_high <= self.limit else "not met"

    @property
    def excess(self) -> float:
        """How far the upper end, or the value without one, is above the limit, relative to it."""
        ends = (self.measured.ci_high, self.measured.value)
        upper = next((end for end in ends if math.isfinite(end)), self.limit)
        if not upper > self.limit:
            return 0.0
        return upper / self.limit - 1.0 if self.limit > 0.0 else math.inf

    @property
    def times_more(self) -> float:
        """How many times the data would tell the value from its limit; NaN unless that is within.

        An interval narrows with the root of it.
        """
        value, low, high = (
            self.measured.value,
            self.measured.ci_low,
            self.measured.ci_high,
        )
        if self.status != "not met" or not low < self.limit:
            return math.nan
        side = high - value if value <= self.limit else value - low
        return (side / gap) ** 2 if (gap := abs(self.limit - value)) > 0.0 else math.inf

    @property
    def asks(self) -> str:
        """What more would tell: ever more scenes of the same people would not."""
        return "scenes" if self.scenes and self.times_more <= MOST_TIMES else "people"


@dataclass(frozen=True, slots=True)
class Attacked:
    """What the strongest attack of an adversary leaves at a level."""

    adversary: str  # `ONE_RELEASE`, or a name.
    source: Source | None = None  # None: it was not tried.
    numbers: Mapping[str, Estimate] = field(default_factory=dict)  # By metric.

    def value(self, metric: str) -> Estimate:
        """Return a number, unknown if there is none."""
        return self.numbers.get(metric, UNKNOWN)

    def breaks(self, limit: float) -> bool | None:
        """Return whether it is above a limit of PLR, at epsilon or beyond; None: not tried."""
        if self.source is None:
            return None
        return not all(self.value(name).ci_high <= limit for name in (EXPOSURE, WIDE))


@dataclass(frozen=True, slots=True)
class Linked:
    """What the strongest linker finds in a task."""

    task: str
    source: Source | None = None  # None: it was not run at this level.
    metric: str = SUCCESS  # Rank 1, or that of 100 candidates.
    rank1: Estimate = UNKNOWN
    chance: float = math.nan
    share: Estimate = UNKNOWN  # Of raw's rank 1 above chance.
    missing: Unknown | None = None


@dataclass(frozen=True, slots=True)
class Offer:
    """What one level costs and leaves, and which limits it meets."""

    where: Where
    family: Family
    cost: Estimate  # Missed conflicts of the robot, by the criterion.
    robots: Mapping[str, Estimate]  # The same of every robot of the run by its name.
    shared: Attacked
    attacked: Attacked  # After one release.
    beyond: tuple[Attacked, ...]  # After each adversary who knows more, tried or not.
    linked: Linked | None  # In the leading handover; None: the run has none.
    tasks: tuple[Linked, ...]
    checks: tuple[Check, ...] = ()
    lacks_rule: str = ""  # Adding rule under which its mechanism does not hold.

    @property
    def met(self) -> bool:
        """Whether every limit holds."""
        return all(check.status == "met" for check in self.checks)

    @property
    def failing(self) -> tuple[Check, ...]:
        """Limits that do not hold, or of which it cannot be said."""
        return tuple(check for check in self.checks if check.status != "met")

    @property
    def coordinates(self) -> tuple[float, float, float]:
        """Cost, PLR after attack, and linkage: less is better; what is unknown counts alike."""
        left = self.attacked if self.attacked.source else self.shared
        linked = self.linked.rank1.value if self.linked else math.nan
        numbers = np.nan_to_num([self.cost.value, left.value(EXPOSURE).value, linked])
        cost, plr, rank1 = numbers.tolist()
        return cost, plr, rank1


@dataclass(frozen=True, slots=True)
class Recommendation:
    """The answer: which levels hold, or which is nearest, and by how much it does not."""

    question: Question
    robots: tuple[str, ...]
    """The robot named, or the best of the run: that which the first half of the people chose, and
    that of the second. Either is scored on the other half. Empty: none has the
    criterion."""
    raw: Offer | None
    proposals: tuple[Offer, ...]  # Non-dominated, cheapest first.
    refused: tuple[Offer, ...]  # All that do not hold, nearest first.
    missing: tuple[Unknown, ...]  # What the run cannot say of any level.
    task: str  # The leading handover; empty without one.

    @property
    def robot(self) -> str:
        """The robot that costs are of; two names where the halves of the people chose two."""
        return " or ".join(dict.fromkeys(self.robots))

    @property
    def met(self) -> bool:
        """Whether some level holds everything that was asked for."""
        return bool(self.proposals)

    @property
    def nearest(self) -> Offer | None:
        """The level that comes closest, of a run in which none holds."""
        return None if self.proposals or not self.refused else self.refused[0]

    @property
    def unsettled(self) -> tuple[Offer, ...]:
        """Levels that hold all that is known of them, the few best; where none holds all."""
        some = [
            offer
            for offer in self.refused
            if not offer.lacks_rule
            and all(check.status != "not met" for check in offer.checks)
        ]
        return () if self.proposals else tuple(cheapest(non_dominated(some)))

    @property
    def candidates(self) -> tuple[Offer, ...]:
        """Levels that adversaries who know more should be tried on."""
        return self.proposals or self.unsettled or self.refused[:1]


def recommend(
    table: pd.DataFrame,
    question: Question,
    *,
    dataset: str,
    scenes: tuple[int, int] = (0, 0),
) -> Recommendation:
    """Return the levels that hold what a question asks, or the nearest.

    `table` is `levels.csv` of a run, `scenes` are how many were attacked and how many
    robots were in. Raises SettingsError for a family or a robot that the run does not
    have.
    """
    known = _levels(table, dataset)
    raw_rows = next((level for level in known if level.family.family == RAW), None)
    rivals = [
        level for level in known if level.family.protects and level.family.is_added
    ]
    _check_names(rivals, question)
    robots = _robots_of(known)
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
        missing=_missing_of(offers),
        task=task,
    )


def non_dominated(offers: Sequence[Offer]) -> list[Offer]:
    """Return the offers that no other one beats: at most as large in all three, less in one.

    Only what is there under the same adding rules can beat: a network that cannot add
    linearly has no use for a level that does. Of several that are equal in all the
    first stays.
    """
    front: list[Offer] = []
    for at, offer in enumerate(offers):
        rules, place = {*offer.family.rules}, np.array(offer.coordinates)
        rivals = [
            (order, np.array(other.coordinates))
            for order, other in enumerate(offers)
            if order != at and rules <= {*other.family.rules}
        ]
        is_beaten = any(
            (rival <= place).all() and (rival < place).any() for _, rival in rivals
        )
        is_again = any(order < at and (rival == place).all() for order, rival in rivals)
        if not is_beaten and not is_again:
            front.append(offer)
    return front


def cheapest(offers: Sequence[Offer]) -> list[Offer]:
    """Return the few offers that cost least, in order of cost."""
    return sorted(offers, key=lambda offer: offer.coordinates)[:MOST_PROPOSALS]


def _distance(offer: Offer) -> tuple[int, float, float]:
    """Return how far an offer is from what was asked: limits missed, the worst excess, cost."""
    excess = [check.excess for check in offer.checks]
    n_missed = sum(
        check.status == "not met" or check.excess > 0.0 for check in offer.checks
    )
    return n_missed, max(excess, default=0.0), offer.coordinates[0]


def _under_all_rules(offers: Sequence[Offer], adding: Sequence[str]) -> list[Offer]:
    """Return offers, each with the rule under which its mechanism holds nowhere, if any."""
    held: dict[str, set[str]] = {}
    for offer in offers:
        if offer.met:
            held.setdefault(offer.family.name, set()).update(offer.family.rules)
    marked = []
    for offer in offers:
        needed = () if offer.family.has_one_rule or not offer.family.adding else adding
        lacking = [
            rule for rule in needed if rule not in held.get(offer.family.name, set())
        ]
        rule = lacking[0] if offer.met and lacking else ""
        marked.append(replace(offer, lacks_rule=rule))
    return marked


def _missing_of(offers: Sequence[Offer]) -> tuple[Unknown, ...]:
    """Return why a limit can be judged at no level at all."""
    by_name: dict[tuple[str, str], list[Unknown | None]] = {}
    for offer in offers:
        for check in offer.checks:
            by_name.setdefault((check.name, check.adversary), []).append(check.unknown)
    codes = (code for some in by_name.values() if all(some) for code in some if code)
    return tuple(dict.fromkeys(codes))


@dataclass(frozen=True, slots=True)
class _Row:
    """A number of a level."""

    world: str
    adversary: str
    source: Source
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
        name = str(row["dataset"])
        if name != dataset and not name.startswith(f"{dataset}:"):
            continue  # of simulated people beside a recording
        world = name.removeprefix(dataset).removeprefix(":")
        where = (
            row["mechanism"],
            None if math.isnan(row["level"]) else float(row["level"]),
        )
        families[where] = Family(
            row["mechanism"],
            row["family"],
            row["adding"],
            protects=bool(row["protects"]),
        )
        number = Estimate(row["value"], row["ci_low"], row["ci_high"], int(row["n"]))
        source = Source(row["consumer"], row["knowledge"])
        about = (
            row["adversary"],
            source,
            row["metric"],
            number,
            row["outcome"],
            row["invalid"],
        )
        by_halves = row["first_choice"], row["second_choice"]
        rows.setdefault(where, []).append(_Row(world, *about, chosen=by_halves))
    return [_Level(where, families[where], tuple(some)) for where, some in rows.items()]


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


def _robots_of(levels: Sequence[_Level]) -> tuple[str, ...]:
    """Return the predictors of a run by name."""
    every = (
        row.source.consumer
        for metric in (EQUAL_ALARMS, FALSE_ALARMS)
        for level in levels
        for row in level.rows
        if row.metric == metric
    )
    return tuple(name for name in dict.fromkeys(every) if name not in BEST.values())


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
    """Return which of some tasks linkage is judged by; empty if none is a handover."""
    handovers = [
        name for name, task in TASKS.items() if task.gap_s > 0.0 and name in names
    ]
    return LEADING if LEADING in handovers else next(iter(handovers), "")


@dataclass(frozen=True, slots=True)
class _Frame:
    """What every level of a run is held against."""

    question: Question
    robot: str  # Whose costs count: a name, or one of `BEST`.
    task: str
    scenes: tuple[int, int]
    robots: tuple[str, ...]

    def offer(self, level: _Level) -> Offer:
        """Return what a level costs and leaves, with its checks."""
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
            attacked=_attacked(level, ONE_RELEASE),
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
        limits, criterion, n = (
            self.question.limits,
            self.question.criterion,
            self.scenes[1],
        )
        worlds = {row.world for row in level.rows}
        missing: Unknown | None = None
        if not self.robots:
            missing = "no robot"
        elif criterion.world not in worlds:
            missing = "no horizon"
        elif math.isnan(offer.cost.value):
            missing = "no value"
        source, most = Source(self.robot), limits.get(MISSED, math.inf)
        checks = [Check(MISSED, most, offer.cost, source, scenes=n, missing=missing)]
        if "false_alarm" in limits:
            rates = (
                row.measured
                for row in level.rows
                if row.metric == FALSE_ALARMS
                and row.source == source
                and row.world == criterion.world
            )
            rate = next(rates, UNKNOWN)
            limit = limits["false_alarm"]
            checks.append(
                Check("false_alarm", limit, rate, source, scenes=n, missing=missing)
            )
        if MISSED not in limits and not missing:
            # Any cost will do, with an interval or without.
            return checks[1:]
        return checks

    def _exposure(self, offer: Offer) -> list[Check]:
        question, checks = self.question, list[Check]()
        sides = [offer.shared if question.as_shared else offer.attacked]
        sides += [side for side in offer.beyond if side.adversary in question.against]
        for side in sides:
            # Of what was not tried it is said once.
            for name in (*DESCRIPTORS, WIDE) if side.source else DESCRIPTORS:
                limit = question.limits.get(EXPOSURE if name == WIDE else name)
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
            linked = offer.linked or Linked("", missing="no handover")
            limit = question.limits[LINKED]
            source, missing = linked.source, linked.missing
            checks.append(Check(LINKED, limit, linked.share, source, missing=missing))
        if SUCCESS in question.limits:
            limit = question.limits[SUCCESS]
            for task in offer.tasks or (Linked("", missing="no task"),):
                name = f"{SUCCESS}/{task.task}"
                checks.append(
                    Check(name, limit, task.rank1, task.source, missing=task.missing)
                )
        return checks


def _tasks(level: _Level) -> list[str]:
    return [*dict.fromkeys(row.source.task for row in level.rows if row.source.task)]


def _attacked(
    level: _Level, adversary: str, *, source: Source | None = None
) -> Attacked:
    """Return what an adversary leaves; the attack named is the strongest by PLR."""
    rows = [
        row
        for row in level.rows
        if row.adversary == adversary
        and not row.source.task
        and (source is None or row.source == source)
        and row.metric in {*DESCRIPTORS, WIDE, MEDIAN}
    ]
    by_plr = next((row.source for row in rows if row.metric == EXPOSURE), None)
    return Attacked(adversary, by_plr, {row.metric: row.measured for row in rows})


def _linked(level: _Level, task: str) -> Linked:
    """Return what the strongest linker finds in a task at a level."""
    rows = {row.metric: row for row in level.rows if row.source.task == task}
    metric = SUCCESS_OF_100 if SUCCESS_OF_100 in rows else SUCCESS
    if metric not in rows:
        return Linked(task, missing="no attack")
    rank1 = rows[metric]
    missing: Unknown | None = None
    if rank1.invalid:
        missing = "shortcut"
    elif rank1.outcome == WEAK:
        missing = "attack too weak"
    numbers = {name: row.measured for name, row in rows.items()}
    share = numbers.get(LINKAGE_SHARE, UNKNOWN)
    chance = numbers.get("chance", UNKNOWN).value
    return Linked(task, rank1.source, metric, rank1.measured, chance, share, missing)
