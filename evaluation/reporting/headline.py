"""The first table: missed conflicts, known positions, re-identified people by level."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Final

import numpy as np
import pandas as pd

from evaluation.estimates.bounds import ClosestAttack, gaps
from evaluation.estimates.families import (
    CLEAN,
    FID,
    PAPER_FAMILIES,
    Family,
    families_in,
)
from evaluation.estimates.keys import row_worlds
from evaluation.estimates.metrics import (
    MISSED_FUTURE,
    MISSED_RATE,
    PLR,
    RANK1,
    RANK1_AMONG_100,
    RANK1_JOINT,
    WORST_TENTH,
)
from evaluation.estimates.strongest import (
    NO_TASK,
    by_task,
    naming_rules,
    strongest_by_mechanism,
    strongest_by_task,
)
from evaluation.estimates.strongest_table import SINGLE_RELEASE
from evaluation.estimates.worst_off import LEAST_PEOPLE, LEAST_RELEASES
from evaluation.plan.address import AS_SHARED, Address, MechanismLevel, parse_consumer
from evaluation.plan.presets import BASELINE
from evaluation.plan.world import OTHER_LAW_WORLD, OWN_WORLD, World
from evaluation.reporting import table as make
from evaluation.reporting.lookups import MAIN_LEVELS, estimates, find_family
from evaluation.reporting.names import (
    mechanism_name,
    mechanism_phrase,
    robot_name,
    short_mechanism_name,
    task_head,
)
from evaluation.reporting.table import Cell, Column, Table
from isac_track.config import PrivacySettings
from isac_track.intervals import Estimate
from isac_track.linkability import GALLERY

SHOWN_ROBOTS: Final = ("least_squares", "kalman_cv", "kalman_cv:aware=true")
"""Predictors that are shown if a run has them, in this order."""

_BESIDE: Final = ("kalman_ca", "kalman_imm", BASELINE)
"""Predictors that only the tables show if a run has two of `SHOWN_ROBOTS`."""

_MOST_ROBOTS: Final = 3
SHOWN_TASKS: Final = ("handover-1s", "handover-5s", "cross_session", "rerelease")
"""Tasks that are shown if a run has them, in this order."""
MOST_LEVELS: Final = 14
_MISSED, _LINKED = "missed conflicts", "re-identified"
_METRICS = (
    MISSED_RATE,
    MISSED_FUTURE,
    PLR,
    WORST_TENTH,
    RANK1,
    RANK1_JOINT,
    RANK1_AMONG_100,
    "chance",
)


@dataclass(frozen=True, slots=True)
class HeadlineColumn:
    """A column of the first table: a number for every level."""

    subject: str  # What several columns are about, such as `re-identified`.
    name: str
    measure: Address
    chance: float = math.nan
    candidates: float = math.nan  # Mean size of the gallery, where people are linked.
    horizon_s: float | None = None  # The further horizon at which it is read, if any.
    is_joint: bool = False  # Whether all probes are matched at once.

    @property
    def is_later(self) -> bool:
        """Whether it is read at the further horizon."""
        return self.horizon_s is not None

    @property
    def above(self) -> str:
        """The heading of several columns."""
        if self.horizon_s is None:
            return self.subject
        return f"{self.subject}, {self.horizon_s:g} s"

    @property
    def title(self) -> str:
        """The full heading of the column."""
        title = f"{self.above}, {self.name}"
        return f"{title}, joint matching" if self.is_joint else title


@dataclass(frozen=True, eq=False, slots=True)
class Headline:
    """The columns of the first table, and the numbers of a run that fill them."""

    families: Mapping[str, Family]  # By mechanism.
    numbers: Mapping[Address, Estimate]
    # The same under the other error law, where the run has it.
    other_law: Mapping[Address, Estimate]
    gaps: Sequence[ClosestAttack]  # From the optimum, in model worlds.
    robots: Sequence[HeadlineColumn]
    shared: HeadlineColumn
    attacked: HeadlineColumn | None  # After the strongest reconstruction.
    worst: HeadlineColumn | None  # The same of the most exposed tenth of the people.
    linked: Sequence[HeadlineColumn]  # By the strongest linker of each task.
    # All levels of the run: clean positions come last.
    levels: Sequence[MechanismLevel]
    epsilon_m: float  # A position that is closer to the truth is known.
    horizon_s: float | None = None  # The longest further horizon of the run.
    # Numbers at that horizon.
    later: Mapping[Address, Estimate] = field(default_factory=dict)

    @property
    def columns(self) -> list[HeadlineColumn]:
        """All columns, in order."""
        attacked = [self.attacked] if self.attacked else []
        return [
            *self.robots[:2],
            *self.future[:2],
            self.shared,
            *attacked,
            *self.linked[-3:],
        ]

    @property
    def future(self) -> list[HeadlineColumn]:
        """The robots' missed rates of future conflicts, at the further horizon."""
        if self.horizon_s is None:
            return []
        columns = [
            replace(
                robot,
                subject="missed future conflicts",
                measure=robot.measure.measured(MISSED_FUTURE),
                horizon_s=self.horizon_s,
            )
            for robot in self.robots
        ]
        return [
            column
            for column in columns
            if any(self.at(where, column) for where in self.levels)
        ]

    def at(
        self, where: MechanismLevel, column: HeadlineColumn, *, other_law: bool = False
    ) -> Estimate | None:
        """Return the number of a column at a level; None if it is unknown."""
        numbers = self.numbers
        if other_law:
            numbers = self.other_law
        elif column.is_later:
            numbers = self.later
        estimate = numbers.get(column.measure.at(*where))
        if estimate is None or not math.isfinite(estimate.value):
            return None
        return estimate

    def cost(self, where: MechanismLevel) -> Estimate | None:
        """Return the first robot's missed conflicts at a level; None if unknown."""
        return self.at(where, self.robots[0]) if self.robots else None

    def name(self, where: MechanismLevel) -> str:
        """Return the plain name of a level."""
        return mechanism_name(find_family(self.families, where.mechanism), where.level)

    def short_name(self, where: MechanismLevel) -> str:
        """Return the name of a level for a narrow column."""
        family = find_family(self.families, where.mechanism)
        return short_mechanism_name(family, where.level)

    def phrase(self, where: MechanismLevel) -> str:
        """Return the name of a level for the middle of a sentence."""
        family = find_family(self.families, where.mechanism)
        return mechanism_phrase(family, where.level)


def headline(
    summary: pd.DataFrame,
    *,
    attacks: Mapping[str, Address] | None = None,
    linkability: pd.DataFrame | None = None,
    attacked: pd.DataFrame | None = None,
    epsilon_m: float = PrivacySettings().epsilon_m,
) -> Headline:
    """Return the first table of a summary.

    `attacks` are the strongest attack of each task; by default those of the summary.
    `attacked` are the numbers of the strongest attack on each mechanism, as in
    `strongest.csv`. By default they are read off the summary, without cross-fitting.
    `epsilon_m` is the run's `privacy.epsilon_m`.
    """
    rows = summary[summary["metric"].isin(_METRICS)]
    world = row_worlds(rows)
    own = rows[world == OWN_WORLD]
    numbers, families = estimates(own), families_in(own)
    if attacks is None:
        best = strongest_by_task(numbers, families)
        attacks = {task: reader.without_task for task, reader in best.items()}
    horizons_s = {other.horizon_s for other in world.unique()} - {None}
    horizon_s = max(horizons_s, default=None)
    later: dict[Address, Estimate] = {}
    if horizon_s is not None:
        later = estimates(rows[world == World(horizon_s=horizon_s)])
    predictors = own.loc[own["metric"] == MISSED_RATE, "consumer"].unique().tolist()
    by_mechanism = _own_strongest(numbers, families, attacks)
    if attacked is not None and not attacked.empty:
        worst_tenths = _only_metric(by_mechanism, WORST_TENTH)
        by_mechanism = worst_tenths | _cross_fitted(attacked, attacks)
    above = f"known to {epsilon_m:g} m"
    after_attack: HeadlineColumn | None = None
    worst: HeadlineColumn | None = None
    if reconstruction := attacks.get(NO_TASK):
        after_attack = HeadlineColumn(above, "attacked", reconstruction.measured(PLR))
        worst = HeadlineColumn(
            above, "worst tenth", reconstruction.measured(WORST_TENTH)
        )
    levels = dict.fromkeys(key.mechanism_level for key in numbers)
    return Headline(
        families=families,
        numbers=numbers | by_mechanism,
        other_law=estimates(rows[world == OTHER_LAW_WORLD]),
        gaps=gaps(summary),
        robots=_robots(predictors),
        shared=HeadlineColumn(above, "as sent", AS_SHARED.measured(PLR)),
        attacked=after_attack,
        worst=worst,
        linked=_linked(attacks, numbers, linkability),
        horizon_s=horizon_s,
        later=later,
        levels=sorted(
            levels, key=lambda where: families[where.mechanism].family == CLEAN
        ),
        epsilon_m=epsilon_m,
    )


def _robots(predictors: Sequence[str]) -> list[HeadlineColumn]:
    """Return the predictors that are shown; a user's own come second."""
    usual = [name for name in SHOWN_ROBOTS if name in predictors]
    others = [name for name in predictors if name not in SHOWN_ROBOTS]
    added = [name for name in others if name not in _BESIDE]
    ordered = dict.fromkeys([*usual[:1], *added, *(usual[1:] or others)])
    return [
        HeadlineColumn(
            _MISSED, robot_name(name), parse_consumer(name).measured(MISSED_RATE)
        )
        for name in list(ordered)[:_MOST_ROBOTS]
    ]


def _only_metric(
    numbers: Mapping[Address, Estimate], metric: str
) -> dict[Address, Estimate]:
    """Return the numbers of a metric."""
    return {key: number for key, number in numbers.items() if key.metric == metric}


def _cross_fitted(
    attacked: pd.DataFrame, attacks: Mapping[str, Address]
) -> dict[Address, Estimate]:
    """Return the cross-fitted numbers of `attacked`; keys name the headline attack.

    The worst tenth has no row there: it is cross-fitted over releases already.
    """
    rows = attacked[attacked["adversary"] == SINGLE_RELEASE]
    tasks = rows["task"].astype(object).fillna("")
    numbers = estimates(rows).items()
    return {
        replace(attacks[task], task=task).at(*key.mechanism_level, key.metric): estimate
        for task, (key, estimate) in zip(tasks, numbers, strict=True)
        if task in attacks
    }


def _own_strongest(
    numbers: Mapping[Address, Estimate],
    families: Mapping[str, Family],
    attacks: Mapping[str, Address],
) -> dict[Address, Estimate]:
    """Return the numbers of the strongest attack on each mechanism.

    Their keys name the headline attack of the task. Rank 1 is by the better of the two
    rules that name mates.
    """
    # The headline attack is the strongest against raw, fixed noise and FID. It would
    # flatter other mechanisms, so that each of them has its own strongest attack.
    own: dict[Address, Estimate] = {}
    rules = naming_rules(numbers)
    for criterion, metrics in (
        (PLR, (PLR, WORST_TENTH)),
        (RANK1, (RANK1, RANK1_AMONG_100)),
    ):
        for task, blocks in by_task(numbers, metric=criterion).items():
            if task not in attacks:
                continue
            best, headline = (
                strongest_by_mechanism(blocks),
                replace(attacks[task], task=task),
            )
            for where, metric in product(blocks, metrics):
                is_usual = families[where.mechanism].family in (*PAPER_FAMILIES, CLEAN)
                reader = headline if is_usual else best.get(where.mechanism, headline)
                rule = rules.get(reader, RANK1) if metric == RANK1 else metric
                if (key := reader.at(*where, rule)) in numbers:
                    own[headline.at(*where, metric)] = numbers[key]
    return own


def _linked(
    attacks: Mapping[str, Address],
    numbers: Mapping[Address, Estimate],
    linkability: pd.DataFrame | None,
) -> list[HeadlineColumn]:
    """Return a column for each linkage task that is shown.

    These are the tasks of `SHOWN_TASKS`; if the run has none of them, its first three.
    """
    values = {
        key.measure: estimate.value
        for key, estimate in numbers.items()
        if math.isfinite(estimate.value)
    }
    rules, columns = naming_rules(numbers), []
    own_tasks = [task for task in attacks if task]
    for task in [name for name in SHOWN_TASKS if name in attacks] or own_tasks[:3]:
        reader, head = replace(attacks[task], task=task), task_head(task)
        column = HeadlineColumn(
            _LINKED,
            head,
            reader.measured(RANK1_AMONG_100),
            chance=1.0 / GALLERY,
            candidates=GALLERY,
        )
        if column.measure not in values:
            column = HeadlineColumn(
                _LINKED,
                head,
                reader.measured(RANK1),
                chance=values.get(reader.measured("chance"), math.nan),
                candidates=_mean_candidates(reader, linkability),
                is_joint=rules.get(reader) == RANK1_JOINT,
            )
        columns.append(column)
    return columns


def _mean_candidates(reader: Address, linkability: pd.DataFrame | None) -> float:
    """Return the mean size of the gallery of a linker; NaN if it is unknown."""
    if linkability is None:
        return math.nan
    is_reader = linkability["consumer"] == reader.consumer
    sizes = linkability.loc[is_reader, "gallery_mean"].dropna().to_list()
    return float(np.mean(sizes)) if sizes else math.nan


def choose_levels(
    table: Headline, *, most: int = MOST_LEVELS, named: Collection[MechanismLevel] = ()
) -> list[MechanismLevel]:
    """Return the levels that have a row: all of them if there are at most `most`.

    Otherwise these are the headline levels and one level of every other mechanism. That
    is a headline level of its family, or the level that costs a robot about as much as
    the strictest FID. Of these the `named` levels come first; the first of them has a
    row in any case.
    """
    first = [where for where in MAIN_LEVELS if where in table.levels]
    rest = [where for where in table.levels if where not in first]
    if len(table.levels) <= most:
        return [*first, *rest]
    cost = {where: missed.value for where in rest if (missed := table.cost(where))}
    strict = table.cost(MechanismLevel(FID, 1.0))
    target = strict.value if strict else max(cost.values(), default=0.0)
    others = [where for where in rest if where in named]
    first = first[: max(1, most - len(others[:1]))]
    shown = {name for name, _ in [*first, *others]}
    for name in dict.fromkeys(name for name, _ in rest if name not in shown):
        family = table.families[name].name
        usual = [
            MechanismLevel(name, level)
            for mechanism, level in MAIN_LEVELS
            if mechanism == family
        ]
        levels = [where for where in rest if where.mechanism == name]
        closest = min(levels, key=lambda where: abs(cost.get(where, math.inf) - target))
        others.append(next((where for where in usual if where in levels), closest))
    room = max(0, most - len(first))
    return [*first, *others[:room]]


def headline_table(first: Headline) -> Table:
    """Return the first table with its intervals, all levels and both laws."""
    columns = [make.text_column("what is shared", first.name)]
    for column in first.columns:
        columns.append(Column(column.title, partial(_cell, first, column), "%"))
        if column is not first.attacked:
            continue
        if first.other_law:
            isotropic = partial(_cell, first, column, other_law=True)
            columns.append(Column(f"{column.title}, isotropic error", isotropic, "%"))
        worst = first.worst
        if worst and any(first.at(where, worst) for where in first.levels):
            name = f"{column.title}, worst tenth of people"
            columns.append(Column(name, partial(_cell, first, worst), "%"))
    levels = choose_levels(first, most=len(first.levels))
    return make.build_table("headline", "", levels, columns, notes=_worst_notes(first))


def _worst_notes(table: Headline) -> list[str]:
    """Return how many people the worst tenth is chosen from, or why there is none."""
    metric = table.worst and table.worst.measure
    people = [
        estimate.n for key, estimate in table.numbers.items() if key.measure == metric
    ]
    if not people:
        return []
    n, condition = max(people), f"people with at least {LEAST_RELEASES} releases"
    if n < LEAST_PEOPLE:
        reason = f"refused, since it takes {LEAST_PEOPLE} {condition}"
        return [f"Worst tenth: {reason}; there are {n}."]
    how = "chosen on every other release, PLR of the releases between"
    return [f"Worst tenth: the most exposed tenth of {n} {condition}, {how}."]


def _cell(
    first: Headline,
    column: HeadlineColumn,
    where: MechanismLevel,
    *,
    other_law: bool = False,
) -> Cell:
    """Return the cell of a level in a column."""
    estimate = first.at(where, column, other_law=other_law)
    return make.estimate_cell(column.measure.metric, estimate)
