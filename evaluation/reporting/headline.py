"""The first table: missed conflicts, known positions and re-identified people, by level."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Final

import numpy as np
import pandas as pd

from evaluation.estimates.bounds import Gap, gaps
from evaluation.estimates.families import CLEAN, SWEPT, Family, families_in
from evaluation.estimates.keys import AS_SHARED, Key, Measure, Source, Where, worlds_of
from evaluation.estimates.metrics import (
    ASSIGNED,
    EXPOSURE,
    MISSED_FUTURE,
    MISSED_RATE,
    SUCCESS,
    SUCCESS_OF_100,
    WORST_TENTH,
)
from evaluation.estimates.strongest import against_each, by_task, rules_of, strongest
from evaluation.estimates.strongest_table import ONE_RELEASE
from evaluation.estimates.worst_off import LEAST_PEOPLE, LEAST_RELEASES
from evaluation.plan.constants import OTHER_LAW_WORLD, horizon_of, horizon_world
from evaluation.plan.presets import BASELINE
from evaluation.reporting import table as make
from evaluation.reporting.lookups import HEADLINE, estimates, family_of
from evaluation.reporting.names import mechanism_name, robot_name, task_head
from evaluation.reporting.table import Cell, Column, Table
from isac_track.config import PrivacySettings
from isac_track.intervals import Estimate
from isac_track.linkability import GALLERY

ROBOTS: Final = ("least_squares", "kalman_cv", "kalman_cv:aware=true")
"""Predictors that are shown if a run has them, in this order."""
_BESIDE: Final = ("kalman_ca", "kalman_imm", BASELINE)
"""Predictors that only the tables show where a run has two of those."""
_MOST_ROBOTS: Final = 3
TASKS: Final = ("handover-1s", "handover-5s", "cross_session", "rerelease")
"""Tasks that are shown if a run has them, in this order."""
MOST_LEVELS: Final = 14
_MISSED, _LINKED = "missed conflicts", "re-identified"
_METRICS = (
    MISSED_RATE,
    MISSED_FUTURE,
    EXPOSURE,
    WORST_TENTH,
    SUCCESS,
    ASSIGNED,
    SUCCESS_OF_100,
    "chance",
)


@dataclass(frozen=True, slots=True)
class Shown:
    """A column of the first table: one number of every level."""

    above: str  # What several columns share, such as `re-identified`.
    name: str
    measure: Measure
    chance: float = math.nan
    candidates: float = math.nan  # Mean size of the gallery, where people are linked.
    is_later: bool = False  # Whether it is read at the further horizon.
    is_joint: bool = False  # Whether all probes are matched at once.

    @property
    def title(self) -> str:
        """Heading of a column with room for all."""
        title = f"{self.above}, {self.name}"
        return f"{title}, joint matching" if self.is_joint else title


@dataclass(frozen=True, eq=False, slots=True)
class Headline:
    """The columns of the first table, and the numbers of a run that fill them."""

    known: Mapping[str, Family]
    numbers: Mapping[Key, Estimate]
    other_law: Mapping[
        Key, Estimate
    ]  # The same under the other error law, where the run has it.
    gaps: Sequence[Gap]  # From the optimum, in model worlds.
    robots: Sequence[Shown]
    shared: Shown
    attacked: Shown | None  # After the strongest reconstruction.
    worst: Shown | None  # The same of the most exposed tenth of the people.
    linked: Sequence[Shown]  # By the strongest linker of each task.
    wheres: Sequence[Where]  # All levels of the run: the ceiling comes last.
    epsilon_m: float  # A position that is closer to the truth is known.
    horizon_s: float | None = None  # The longest further horizon of the run.
    later: Mapping[Key, Estimate] = field(
        default_factory=dict
    )  # Numbers at that horizon.

    @property
    def columns(self) -> list[Shown]:
        """All columns, in order."""
        robots = [*self.robots[:2], *self.future[:2]]
        return [*robots, self.shared, *filter(None, [self.attacked]), *self.linked[-3:]]

    @property
    def future(self) -> list[Shown]:
        """Conflicts that are still to come at the further horizon, as the robots miss them."""
        above = (
            ""
            if self.horizon_s is None
            else f"missed future conflicts, {self.horizon_s:g} s"
        )
        robots = [
            replace(
                robot, above=above, measure=robot.measure._replace(metric=MISSED_FUTURE)
            )
            for robot in self.robots
        ]
        later = [replace(robot, is_later=True) for robot in robots]
        return [
            robot
            for robot in later
            if any(self.at(where, robot) for where in self.wheres)
        ]

    def at(
        self, where: Where, column: Shown, *, other_law: bool = False
    ) -> Estimate | None:
        """Return a number at a level; None where it is not known."""
        numbers = self.numbers
        if other_law:
            numbers = self.other_law
        elif column.is_later:
            numbers = self.later
        estimate = numbers.get(column.measure.at(*where))
        return (
            estimate if estimate is not None and math.isfinite(estimate.value) else None
        )

    def cost(self, where: Where) -> Estimate | None:
        """Return the missed conflicts of the first robot at a level; None where unknown."""
        return self.at(where, self.robots[0]) if self.robots else None

    def name(self, where: Where) -> str:
        """Return the plain name of a level."""
        return mechanism_name(family_of(self.known, where[0]), where[1])


def headline(
    summary: pd.DataFrame,
    *,
    attacks: Mapping[str, Source] | None = None,
    linkability: pd.DataFrame | None = None,
    attacked: pd.DataFrame | None = None,
    epsilon_m: float = PrivacySettings().epsilon_m,
) -> Headline:
    """Return what comes first of a summary; `attacks` are the strongest, by default of its own.

    `attacked` are the numbers of the strongest against each mechanism, as in
    `strongest.csv`. Without them the strongest against each is read off the summary,
    without cross-fitting. `epsilon_m` is the run's `privacy.epsilon_m`.
    """
    rows = summary[summary["metric"].isin(_METRICS)]
    world = worlds_of(rows)
    own = rows[world == ""]
    numbers, known = estimates(own), families_in(own)
    if attacks is None:
        attacks = {
            task: source.attack for task, source in strongest(numbers, known).items()
        }
    further = [
        seconds for name in world.unique() if (seconds := horizon_of(name)) is not None
    ]
    horizon_s = max(further, default=None)
    able = own.loc[own["metric"] == MISSED_RATE, "consumer"].unique().tolist()
    known_to = f"known to {epsilon_m:g} m"
    best, wheres = attacks.get(""), dict.fromkeys(key.where for key in numbers)
    against = _own_strongest(numbers, known, attacks)
    if attacked is not None and not attacked.empty:
        # The worst tenth is cross-fitted over releases already, and has no row of its
        # own there.
        worst = {
            key: number for key, number in against.items() if key.metric == WORST_TENTH
        }
        against = worst | _cross_fitted(attacked, attacks)
    return Headline(
        known=known,
        numbers=numbers | against,
        other_law=estimates(rows[world == OTHER_LAW_WORLD]),
        gaps=gaps(summary),
        robots=_robots(able),
        shared=Shown(known_to, "as sent", AS_SHARED.measure(EXPOSURE)),
        attacked=Shown(known_to, "attacked", best.measure(EXPOSURE)) if best else None,
        worst=(
            Shown(known_to, "worst tenth", best.measure(WORST_TENTH)) if best else None
        ),
        linked=_linked(attacks, numbers, linkability),
        horizon_s=horizon_s,
        later=(
            {}
            if horizon_s is None
            else estimates(rows[world == horizon_world(horizon_s)])
        ),
        wheres=sorted(wheres, key=lambda where: known[where[0]].family == CLEAN),
        epsilon_m=epsilon_m,
    )


def _robots(able: Sequence[str]) -> list[Shown]:
    """Return the predictors that are shown: after the first of `ROBOTS` comes a user's own."""
    usual = [name for name in ROBOTS if name in able]
    others = [name for name in able if name not in ROBOTS]
    added = [name for name in others if name not in _BESIDE]
    names = list(dict.fromkeys([*usual[:1], *added, *(usual[1:] or others)]))[
        :_MOST_ROBOTS
    ]
    return [
        Shown(_MISSED, robot_name(name), Measure(name, MISSED_RATE)) for name in names
    ]


def _cross_fitted(
    attacked: pd.DataFrame, attacks: Mapping[str, Source]
) -> dict[Key, Estimate]:
    """Return, under the headline's name, the strongest against each mechanism, cross-fitted."""
    rows = attacked[attacked["adversary"] == ONE_RELEASE]
    tasks = rows["task"].astype(object).fillna("")
    return {
        _headline(task, attacks).measure(key.metric).at(*key.where): estimate
        for task, (key, estimate) in zip(tasks, estimates(rows).items(), strict=True)
        if task in attacks
    }


def _own_strongest(
    numbers: Mapping[Key, Estimate],
    known: Mapping[str, Family],
    attacks: Mapping[str, Source],
) -> dict[Key, Estimate]:
    """Return, under the headline's name, who is strongest against each other mechanism.

    Of rank 1 it is that of the better of both ways to name mates.
    """
    # The headline is chosen over raw, fixed noise and FID: others it would flatter.
    own: dict[Key, Estimate] = {}
    rules = rules_of(numbers)
    for by, metrics in (
        (EXPOSURE, (EXPOSURE, WORST_TENTH)),
        (SUCCESS, (SUCCESS, SUCCESS_OF_100)),
    ):
        for task, blocks in by_task(numbers, metric=by).items():
            if task not in attacks:
                continue
            best, headline = against_each(blocks), _headline(task, attacks)
            for where, metric in product(blocks, metrics):
                is_usual = known[where[0]].family in (*SWEPT, CLEAN)
                source = headline if is_usual else best.get(where[0], headline)
                rule = rules.get(source, SUCCESS) if metric == SUCCESS else metric
                if (key := source.measure(rule).at(*where)) in numbers:
                    own[headline.measure(metric).at(*where)] = numbers[key]
    return own


def _headline(task: str, attacks: Mapping[str, Source]) -> Source:
    consumer, knowledge = attacks[task]
    return Source(f"{task}/{consumer}" if task else consumer, knowledge)


def _linked(
    attacks: Mapping[str, Source],
    numbers: Mapping[Key, Estimate],
    linkability: pd.DataFrame | None,
) -> list[Shown]:
    """Return a column for each task that is shown, of the run's tasks if it has none of these."""
    values = {
        key.measure: number.value
        for key, number in numbers.items()
        if math.isfinite(number.value)
    }
    rules, columns = rules_of(numbers), []
    for task in [name for name in TASKS if name in attacks] or [
        task for task in attacks if task
    ][:3]:
        source, head = _headline(task, attacks), task_head(task)
        column = Shown(
            _LINKED, head, source.measure(SUCCESS_OF_100), 1.0 / GALLERY, GALLERY
        )
        if column.measure not in values:
            chance, sizes = values.get(source.measure("chance"), math.nan), [math.nan]
            if linkability is not None:
                rows = linkability.loc[
                    linkability["consumer"] == source.consumer, "gallery_mean"
                ]
                sizes = rows.dropna().to_list() or sizes
            measure, is_joint = source.measure(SUCCESS), rules.get(source) == ASSIGNED
            size = float(np.mean(sizes))
            column = Shown(_LINKED, head, measure, chance, size, is_joint=is_joint)
        columns.append(column)
    return columns


def levels_of(
    table: Headline, *, most: int = MOST_LEVELS, named: Collection[Where] = ()
) -> tuple[list[Where], int]:
    """Return the levels that have a row, and how many mechanisms have none.

    All levels where there is room; else the headline levels, then one of every other
    mechanism: a headline level of its family, or that which costs a robot about as much
    as the strictest FID. Of these the `named` levels come first; the first of them has
    a row in any case.
    """
    first = [where for where in HEADLINE if where in table.wheres]
    rest = [where for where in table.wheres if where not in first]
    if len(table.wheres) <= most:
        return [*first, *rest], 0
    cost = {at: missed.value for at in rest if (missed := table.cost(at))}
    strict = table.cost(("fid", 1.0))
    target = strict.value if strict else max(cost.values(), default=0.0)
    others = [where for where in rest if where in named]
    first = first[: max(1, most - len(others[:1]))]
    shown = {name for name, _ in [*first, *others]}
    for name in dict.fromkeys(name for name, _ in rest if name not in shown):
        usual = [
            (name, at) for family, at in HEADLINE if family == table.known[name].name
        ]
        ats = [where for where in rest if where[0] == name]
        closest = min(ats, key=lambda where: abs(cost.get(where, math.inf) - target))
        others.append(next((where for where in usual if where in ats), closest))
    room = max(0, most - len(first))
    return [*first, *others[:room]], len(others[room:])


def headline_table(first: Headline) -> Table:
    """Return the first table with its intervals, all levels and both laws."""
    columns = [make.said("what is shared", first.name)]
    for shown in first.columns:
        columns.append(Column(shown.title, partial(_cell, first, shown), "%"))
        if shown is not first.attacked:
            continue
        if first.other_law:
            isotropic = partial(_cell, first, shown, other_law=True)
            columns.append(Column(f"{shown.title}, isotropic error", isotropic, "%"))
        worst = first.worst
        if worst and any(first.at(where, worst) for where in first.wheres):
            name = f"{shown.title}, worst tenth of people"
            columns.append(Column(name, partial(_cell, first, worst), "%"))
    wheres = levels_of(first, most=len(first.wheres))[0]
    return make.built("headline", "", wheres, columns, notes=_worst_notes(first))


def _worst_notes(table: Headline) -> list[str]:
    """Return how many people the worst tenth is chosen from, or why there is none."""
    metric = table.worst and table.worst.measure
    people = [
        estimate.n for key, estimate in table.numbers.items() if key.measure == metric
    ]
    if not people:
        return []
    n, enough = max(people), f"people with at least {LEAST_RELEASES} releases"
    if n < LEAST_PEOPLE:
        refused = f"refused, since it takes {LEAST_PEOPLE} {enough}"
        return [f"Worst tenth: {refused}; there are {n}."]
    how = "chosen on every other release, PLR of the releases between"
    return [f"Worst tenth: the most exposed tenth of {n} {enough}, {how}."]


def _cell(
    first: Headline, column: Shown, where: Where, *, other_law: bool = False
) -> Cell:
    return make.estimated(
        column.measure.metric, first.at(where, column, other_law=other_law)
    )
