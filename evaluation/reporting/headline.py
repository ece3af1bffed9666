"""The first table: what noise costs a robot, what is known, and who is found again, by level."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Final

import numpy as np
import pandas as pd

from evaluation.analysis.bounds import Gap, gaps
from evaluation.analysis.families import CLEAN, SWEPT, Family, families_in
from evaluation.analysis.keys import AS_SHARED, Key, Measure, Source, Where, worlds_of
from evaluation.analysis.metrics import (
    ASSIGNED,
    EXPOSURE,
    MISSED_FUTURE,
    MISSED_RATE,
    SUCCESS,
    SUCCESS_OF_100,
    WORST_TENTH,
)
from evaluation.analysis.strongest import against_each, by_task, rule_of, strongest
from evaluation.analysis.strongest_table import ONE_RELEASE
from evaluation.analysis.worst_off import LEAST_PEOPLE, LEAST_RELEASES
from evaluation.experiment.constants import OTHER_LAW_WORLD, horizon_of, horizon_world
from evaluation.experiment.presets import BASELINE
from evaluation.reporting import table as make
from evaluation.reporting.rows import HEADLINE, estimates, short_name
from evaluation.reporting.table import Cell, Column, Table, spoken
from isac_track.config import PrivacySettings
from isac_track.intervals import Estimate
from isac_track.linkability import GALLERY

ROBOTS: Final = {
    "least_squares": "the paper's line",
    "kalman_cv": "Kalman",
    "kalman_cv:aware=true": "Kalman that is aware",
}
"""Predictors that are shown if a run has them; their last word stands over a column, of two."""
_BESIDE: Final = ("kalman_ca", "kalman_imm", BASELINE)
"""Predictors that stand in the tables alone where there are two of those."""
_MOST_ROBOTS: Final = 3
TASKS: Final = {
    "handover-1s": ("1 s", "after 1 s"),
    "handover-5s": ("5 s", "after 5 s"),
    "cross_session": ("back", "in another session"),
    "rerelease": ("rerel.", "in a re-release"),
}
"""Tasks that are shown if a run has them: over a column, of the last three, and in a sentence."""
MOST_LEVELS: Final = 14
_MISSED, _FOUND = "missed", "found again"
_METRICS = (
    *(MISSED_RATE, MISSED_FUTURE, EXPOSURE, WORST_TENTH),
    *(SUCCESS, ASSIGNED, SUCCESS_OF_100, "chance"),
)


@dataclass(frozen=True, slots=True)
class Shown:
    """A number that is shown of every level."""

    above: str
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
    """What the first table shows, and the numbers that it is made of."""

    known: Mapping[str, Family]
    found: Mapping[Key, Estimate]
    other_law: Mapping[Key, Estimate]  # The same under the other error law, where the run has it.
    gaps: Sequence[Gap]  # From the optimum, in model worlds.
    robots: Sequence[Shown]
    shared: Shown
    attacked: Shown | None  # After the strongest reconstruction.
    worst: Shown | None  # The same of the most exposed tenth of the people.
    linked: Sequence[Shown]  # By the strongest linker of each task.
    wheres: Sequence[Where]  # All levels of the run: the ceiling comes last.
    epsilon_m: float  # A position that is closer to the truth is known.
    horizon_s: float | None = None  # The longest further horizon of the run.
    later: Mapping[Key, Estimate] = field(default_factory=dict)  # What is known there.

    @property
    def columns(self) -> list[Shown]:
        """All that is tabled, in order."""
        robots = [*self.robots[:2], *self.future[:2]]
        return [*robots, self.shared, *filter(None, [self.attacked]), *self.linked[-3:]]

    @property
    def future(self) -> list[Shown]:
        """Conflicts that are still to come at the further horizon, as the robots miss them."""
        above = "" if self.horizon_s is None else f"future, {self.horizon_s:g} s"
        robots = [
            replace(robot, above=above, measure=robot.measure._replace(metric=MISSED_FUTURE))
            for robot in self.robots
        ]
        later = [replace(robot, is_later=True) for robot in robots]
        return [robot for robot in later if any(self.at(where, robot) for where in self.wheres)]

    @property
    def column_choices(self) -> Iterator[list[Shown]]:
        """All that is tabled, and less and less of it, for who has less room.

        First go the later tasks, then future conflicts, those of the first robot before.
        """
        columns = self.columns
        yield columns
        for dropped in (*self.linked[-3:][1:], *self.future[:2]):
            columns = [shown for shown in columns if shown != dropped]
            yield columns

    def at(self, where: Where, one: Shown, *, other_law: bool = False) -> Estimate | None:
        """Return a number at a level; None where it is not known."""
        of = self.other_law if other_law else self.later if one.is_later else self.found
        found = of.get(one.measure.at(*where))
        return found if found is not None and math.isfinite(found.value) else None

    def cost(self, where: Where) -> Estimate | None:
        """Return what the first robot misses at a level; None where it is not known."""
        return self.at(where, self.robots[0]) if self.robots else None

    def name(self, where: Where) -> str:
        """Return a level as it is asked for, its rule short and last."""
        return short_name(self.known, where)


def robot_name(consumer: str) -> str:
    """Return what a predictor is called."""
    return ROBOTS.get(consumer, spoken(consumer))


def headline(
    summary: pd.DataFrame,
    *,
    attacks: Mapping[str, Source] | None = None,
    linkability: pd.DataFrame | None = None,
    attacked: pd.DataFrame | None = None,
    epsilon_m: float = PrivacySettings().epsilon_m,
) -> Headline:
    """Return what comes first of a summary; `attacks` are the strongest, by default of its own.

    `attacked` are the numbers of the strongest against each mechanism, as in `strongest.csv`.
    Without them who is strongest against each is read off the summary, without cross-fitting.
    `epsilon_m` is the run's `privacy.epsilon_m`.
    """
    rows = summary[summary["metric"].isin(_METRICS)]
    world = worlds_of(rows)
    own = rows[world == ""]
    found, known = estimates(own), families_in(own)
    if attacks is None:
        attacks = {task: one.attack for task, one in strongest(found, known).items()}
    further = [seconds for name in world.unique() if (seconds := horizon_of(name)) is not None]
    horizon_s = max(further, default=None)
    able = own.loc[own["metric"] == MISSED_RATE, "consumer"].unique().tolist()
    known_in = f"known in {epsilon_m:g} m"
    best, wheres = attacks.get(""), dict.fromkeys(key.where for key in found)
    return Headline(
        known=known,
        found=found
        | (
            _own_strongest(found, known, attacks)
            if attacked is None or attacked.empty
            else _cross_fitted(attacked, attacks)
        ),
        other_law=estimates(rows[world == OTHER_LAW_WORLD]),
        gaps=gaps(summary),
        robots=_robots(able),
        shared=Shown(known_in, "shared", AS_SHARED.measure(EXPOSURE)),
        attacked=Shown(known_in, "attack", best.measure(EXPOSURE)) if best else None,
        worst=Shown(known_in, "worst tenth", best.measure(WORST_TENTH)) if best else None,
        linked=_linked(attacks, found, linkability),
        horizon_s=horizon_s,
        later={} if horizon_s is None else estimates(rows[world == horizon_world(horizon_s)]),
        wheres=sorted(wheres, key=lambda where: known[where[0]].family == CLEAN),
        epsilon_m=epsilon_m,
    )


def _robots(able: Sequence[str]) -> list[Shown]:
    """Return the predictors that are shown: after the first of `ROBOTS` comes what a user adds."""
    known = [one for one in ROBOTS if one in able]
    others = [one for one in able if one not in ROBOTS]
    added = [one for one in others if one not in _BESIDE]
    names = list(dict.fromkeys([*known[:1], *added, *(known[1:] or others)]))[:_MOST_ROBOTS]
    return [Shown(_MISSED, robot_name(of).split()[-1], Measure(of, MISSED_RATE)) for of in names]


def _cross_fitted(attacked: pd.DataFrame, attacks: Mapping[str, Source]) -> dict[Key, Estimate]:
    """Return, under the headline's name, the strongest against each mechanism, cross-fitted."""
    rows = attacked[attacked["adversary"] == ONE_RELEASE]
    tasks = rows["task"].astype(object).fillna("")
    return {
        _headline(task, attacks).measure(key.metric).at(*key.where): estimate
        for task, (key, estimate) in zip(tasks, estimates(rows).items(), strict=True)
        if task in attacks
    }


def _own_strongest(
    found: Mapping[Key, Estimate], known: Mapping[str, Family], attacks: Mapping[str, Source]
) -> dict[Key, Estimate]:
    """Return, under the headline's name, who is strongest against each other mechanism.

    Of rank 1 it is that of the better of both ways to name mates.
    """
    # The headline is chosen over raw, fixed noise and FID: others it would flatter.
    own: dict[Key, Estimate] = {}
    for by, metrics in ((EXPOSURE, (EXPOSURE, WORST_TENTH)), (SUCCESS, (SUCCESS, SUCCESS_OF_100))):
        for task, blocks in by_task(found, metric=by).items():
            if task not in attacks:
                continue
            best, headline = against_each(blocks), _headline(task, attacks)
            for where, metric in product(blocks, metrics):
                is_usual = known[where[0]].family in (*SWEPT, CLEAN)
                source = headline if is_usual else best.get(where[0], headline)
                rule = rule_of(found, source) if metric == SUCCESS else metric
                if (key := source.measure(rule).at(*where)) in found:
                    own[headline.measure(metric).at(*where)] = found[key]
    return own


def _headline(task: str, attacks: Mapping[str, Source]) -> Source:
    consumer, knowledge = attacks[task]
    return Source(f"{task}/{consumer}" if task else consumer, knowledge)


def _linked(
    attacks: Mapping[str, Source], found: Mapping[Key, Estimate], linkability: pd.DataFrame | None
) -> list[Shown]:
    """Return a column for each task that is shown, of the run's tasks if it has none of these."""
    values = {key.measure: one.value for key, one in found.items() if math.isfinite(one.value)}
    columns = []
    for task in [one for one in TASKS if one in attacks] or [one for one in attacks if one][:3]:
        source, head = _headline(task, attacks), TASKS.get(task, (task,))[0]
        one = Shown(_FOUND, head, source.measure(SUCCESS_OF_100), 1.0 / GALLERY, GALLERY)
        if one.measure not in values:
            chance, sizes = values.get(source.measure("chance"), math.nan), [math.nan]
            if linkability is not None:
                is_it = linkability["consumer"] == source.consumer
                sizes = linkability.loc[is_it, "gallery_mean"].dropna().to_list() or sizes
            measure, is_joint = source.measure(SUCCESS), rule_of(found, source) == ASSIGNED
            one = Shown(_FOUND, head, measure, chance, float(np.mean(sizes)), is_joint=is_joint)
        columns.append(one)
    return columns


def levels_of(
    of: Headline, *, most: int = MOST_LEVELS, named: Collection[Where] = ()
) -> tuple[list[Where], int]:
    """Return the levels that have a row, and how many mechanisms have none.

    All levels where there is room; else the headline levels, then one of every other mechanism: a
    headline level of its family, or that which costs a robot about as much as the strictest FID.
    Of these the `named` levels come first; the first of them has a row in any case.
    """
    first = [where for where in HEADLINE if where in of.wheres]
    rest = [where for where in of.wheres if where not in first]
    if len(of.wheres) <= most:
        return [*first, *rest], 0
    cost = {at: one.value for at in rest if (one := of.cost(at))}
    strict = of.cost(("fid", 1.0))
    target = strict.value if strict else max(cost.values(), default=0.0)
    others = [where for where in rest if where in named]
    first = first[: max(1, most - len(others[:1]))]
    shown = {name for name, _ in [*first, *others]}
    for name in dict.fromkeys(name for name, _ in rest if name not in shown):
        usual = [(name, at) for family, at in HEADLINE if family == of.known[name].name]
        ats = [where for where in rest if where[0] == name]
        closest = min(ats, key=lambda where: abs(cost.get(where, math.inf) - target))
        others.append(next((where for where in usual if where in ats), closest))
    room = max(0, most - len(first))
    return [*first, *others[:room]], len(others[room:])


def headline_table(of: Headline) -> Table:
    """Return the first table with its intervals, all levels and both laws."""
    columns = [make.said("sharing (ind.: independent adding)", of.name)]
    for one in of.columns:
        columns.append(Column(one.title, partial(_cell, of, one), "%"))
        if one is of.attacked and of.other_law:
            isotropic = partial(_cell, of, one, other_law=True)
            columns.append(Column(f"{one.above}, attack, isotropic error", isotropic, "%"))
        if one is of.attacked and of.worst and any(of.at(where, of.worst) for where in of.wheres):
            name = f"{one.above}, attack, worst tenth of people"
            columns.append(Column(name, partial(_cell, of, of.worst), "%"))
    wheres = levels_of(of, most=len(of.wheres))[0]
    return make.built("headline", "", wheres, columns, notes=_worst_notes(of))


def _worst_notes(table: Headline) -> list[str]:
    """Return how many people the worst tenth is chosen from, or why there is none."""
    metric = table.worst and table.worst.measure
    people = [estimate.n for key, estimate in table.found.items() if key.measure == metric]
    if not people:
        return []
    n, enough = max(people), f"people with at least {LEAST_RELEASES} releases"
    if n < LEAST_PEOPLE:
        return [f"Worst tenth: refused, since it takes {LEAST_PEOPLE} {enough}; there are {n}."]
    how = "chosen on every other release, PLR of the releases between"
    return [f"Worst tenth: the most exposed tenth of {n} {enough}, {how}."]


def screen_table(of: Headline, levels: Sequence[Where], shown: Sequence[Shown]) -> Table:
    """Return the first table without intervals, with chance and their typical half-width below."""
    rows = [
        [make.word(of.name(where)), *(replace(_cell(of, one, where), low="") for one in shown)]
        for where in levels
    ]
    sizes = [f"{one.candidates:.0f}" for one in shown if math.isfinite(one.candidates)]
    known = [[x for where in levels if (x := of.at(where, one))] for one in shown]
    widths = (pd.Series([0.5 * (x.ci_high - x.ci_low) for x in some]) for some in known)
    below = {
        "chance" + f" of {', '.join(sizes)}" * bool(sizes): [one.chance for one in shown],
        "+- (95 %, typical)": [some.median() for some in widths],
    }
    for name, values in below.items():
        if np.isfinite(values).any():
            rows.append([make.word(name), *(make.number(one, scale=100.0) for one in values)])
    columns = [Column("sharing"), *(Column(one.name, above=one.above) for one in shown)]
    return Table("screen", "", columns, rows)


def _cell(of: Headline, one: Shown, where: Where, *, other_law: bool = False) -> Cell:
    return make.estimated(one.measure.metric, of.at(where, one, other_law=other_law))
