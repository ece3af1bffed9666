"""The table that comes first, on the screen and in the README: few levels, few numbers, all kinds.

What noise costs a robot, what is known of positions, and who is found again, level by level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.analysis.families import CLEAN, Family, families_in
from evaluation.analysis.keys import AS_SHARED, Key, Measure, Source, Where, level_text
from evaluation.analysis.linkability import dataset_of
from evaluation.analysis.metrics import EXPOSURE, METRICS, MISSED_RATE, SUCCESS
from evaluation.analysis.strongest import strongest
from evaluation.reporting import table as make
from evaluation.reporting.rows import HEADLINE, family_of
from evaluation.reporting.table import Cell, Column, Table
from isac_track.intervals import Estimate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas as pd

SUCCESS_OF_100: Final = "rank1_g100"
"""Rank 1 in a gallery of 100: what compares over runs, where it is known."""
GALLERY: Final = 100
ROBOTS: Final = {"least_squares": "the paper's line", "kalman_cv": "Kalman"}
"""Predictors that are shown if a run has them, and what they are called."""
TASKS: Final = {
    "handover-1s": ("1 s", "after 1 s"),
    "handover-5s": ("5 s", "after 5 s"),
    "rerelease": ("rerel.", "in a re-release"),
}
"""Tasks that are shown if a run has them: over a column, and in a sentence."""
MOST_LEVELS: Final = 14
_LAW: Final = ":law="
_METRICS = (MISSED_RATE, EXPOSURE, SUCCESS, SUCCESS_OF_100, "chance")


@dataclass(frozen=True, slots=True)
class Shown:
    """A number that is shown of every level."""

    above: str
    name: str
    measure: Measure
    chance: float = math.nan
    candidates: float = math.nan
    """Mean size of the gallery, where people are linked."""


@dataclass(frozen=True, eq=False, slots=True)
class Headline:
    """What the first table shows, and the numbers that it is made of."""

    known: Mapping[str, Family]
    found: Mapping[Key, Estimate]
    """Every estimate that it may need, of the run's own error law."""
    other_law: Mapping[Key, Estimate]
    """The same under the other law, where the run has it."""
    robots: Sequence[Shown]
    shared: Shown
    attacked: Shown | None
    """After the strongest reconstruction."""
    linked: Sequence[Shown]
    """By the strongest linker of each task."""
    wheres: Sequence[Where]
    """All levels of the run: the ceiling comes last."""

    @property
    def columns(self) -> list[Shown]:
        """All that is shown, in order."""
        after = [self.attacked] if self.attacked else []
        return [*self.robots, self.shared, *after, *self.linked]

    def at(self, where: Where, one: Shown, *, other_law: bool = False) -> Estimate | None:
        """Return a number at a level; None where it is not known."""
        of = self.other_law if other_law else self.found
        estimate = of.get(one.measure.at(*where))
        return estimate if estimate is not None and math.isfinite(estimate.value) else None

    def name(self, where: Where) -> str:
        """Return a level as it is asked for, its rule short and last."""
        one = family_of(self.known, where[0])
        level = level_text(where[1])
        name = f"{one.family}:{level}" if level else one.family
        name += f"{',' if level else ':'}{one.parameters}" * bool(one.parameters)
        return f"{name} ind." if one.adding == "independent" else name

    def other_rule(self, where: Where) -> Where | None:
        """Return the same level under the other adding rule; None if the run has none."""
        mine = family_of(self.known, where[0])
        for name, one in self.known.items():
            is_same = (one.family, one.parameters) == (mine.family, mine.parameters)
            if is_same and {one.adding, mine.adding} == {"linear", "independent"}:
                at = name, where[1]
                return at if AS_SHARED.measure(EXPOSURE).at(*at) in self.found else None
        return None


def headline(
    summary: pd.DataFrame,
    *,
    dataset: str,
    attacks: Mapping[str, Source] | None = None,
    linkability: pd.DataFrame | None = None,
) -> Headline:
    """Return what comes first of a run's summary.

    `attacks` are the strongest of the run as in `Results`, by default those of the summary's own
    levels; `linkability` tells the sizes of galleries.
    """
    rows = summary[summary["metric"].isin(_METRICS)]
    datasets = {one: dataset_of(one, dataset=dataset) for one in rows["consumer"].unique()}
    is_own = rows["dataset"] == rows["consumer"].map(datasets)
    found = _estimates(rows[is_own])
    known = families_in(summary)
    if attacks is None:
        best = strongest(found, known)
        attacks = {task: source.attack for task, source in best.items()}
    measures = {key.measure for key in found}
    consumers = dict.fromkeys(one.consumer for one in measures if one.metric == MISSED_RATE)
    order = [one for one in rows["consumer"].unique() if one in consumers]
    robots = [one for one in ROBOTS if one in order] or order[:2]
    linked = _linked(attacks, found, linkability)
    wheres = [where for where in dict.fromkeys(key.where for key in found) if where[0] in known]
    return Headline(
        known=known,
        found=found,
        other_law=_estimates(rows[rows["dataset"].str.startswith(f"{dataset}{_LAW}")]),
        robots=[
            Shown("missed", _ROBOT_HEADS.get(one, one), Measure(one, MISSED_RATE)) for one in robots
        ],
        shared=Shown("known in 0.3 m", "shared", AS_SHARED.measure(EXPOSURE)),
        attacked=Shown("known in 0.3 m", "attack", attacks[""].measure(EXPOSURE))
        if "" in attacks
        else None,
        linked=linked,
        wheres=sorted(wheres, key=lambda where: known[where[0]].family == CLEAN),
    )


_ROBOT_HEADS: Final = {"least_squares": "line", "kalman_cv": "Kalman"}


def _estimates(rows: pd.DataFrame) -> dict[Key, Estimate]:
    """Return the rows of a summary by what they are about."""
    texts = rows["knowledge"].astype(object).fillna("")
    columns = [*(rows[name] for name in ("mechanism", "level", "consumer", "metric")), texts]
    ends = (rows[name] for name in ("value", "ci_low", "ci_high", "n"))
    return {
        Key(name, None if math.isnan(at) else at, *of): Estimate(value, low, high, n)
        for name, at, *of, value, low, high, n in zip(*columns, *ends, strict=True)
    }


def _linked(
    attacks: Mapping[str, Source],
    found: Mapping[Key, Estimate],
    linkability: pd.DataFrame | None,
) -> list[Shown]:
    """Return a column for each task that is shown, of the run's tasks if it has none of these."""
    tasks = [task for task in TASKS if task in attacks] or [task for task in attacks if task][:3]
    columns = []
    for task in tasks:
        source = Source(f"{task}/{attacks[task].consumer}", attacks[task].knowledge)
        own, of_100 = source.measure(SUCCESS), source.measure(SUCCESS_OF_100)
        values = {key.measure: one.value for key, one in found.items() if math.isfinite(one.value)}
        head = TASKS[task][0] if task in TASKS else task
        if of_100 in values:
            columns.append(Shown("found again", head, of_100, 1.0 / GALLERY, GALLERY))
            continue
        size = math.nan
        if linkability is not None:
            of = linkability[linkability["consumer"] == source.consumer]
            size = float(of["gallery_mean"].mean()) if len(of) else math.nan
        chance = values.get(source.measure("chance"), math.nan)
        columns.append(Shown("found again", head, own, chance, size))
    return columns


def levels_of(of: Headline, *, most: int = MOST_LEVELS) -> tuple[list[Where], int]:
    """Return the levels that have a row, and how many mechanisms have none.

    All levels where there is room; else the headline levels, then one of every other mechanism: a
    headline level of its family, or that which costs a robot about as much as the strictest FID.
    """
    names = {where: family_of(of.known, where[0]) for where in of.wheres}
    first = [
        where
        for headline_level in HEADLINE
        for where, one in names.items()
        if (one.name, where[1]) == headline_level and one.adding != "independent"
    ]
    rest = [where for where in of.wheres if where not in first]
    if len(of.wheres) <= most:
        return [*first, *rest], 0
    found = {where: of.at(where, one) for where in of.wheres for one in of.robots[:1]}
    cost = {where: one.value for where, one in found.items() if one}
    target = cost.get(("fid", 1.0), max(cost.values(), default=0.0))
    others: dict[str, Where] = {}
    for name in dict.fromkeys(where[0] for where in rest).keys() - {where[0] for where in first}:
        ats = [where for where in rest if where[0] == name]
        wanted = [(name, at) for one, at in HEADLINE if one == names[ats[0]].name]
        nearest = min(ats, key=lambda where: abs(cost.get(where, math.inf) - target))
        others[name] = next((where for where in wanted if where in ats), nearest)
    room = max(0, most - len(first))
    told = [others[name] for name in dict.fromkeys(where[0] for where in rest) if name in others]
    return [*first, *told[:room]], len(told[room:])


def headline_table(of: Headline, levels: Sequence[Where], *, intervals: bool = True) -> Table:
    """Return the first table; without intervals a last row has their typical half-width."""
    columns = [make.said("sharing", of.name)]
    columns += [
        Column(one.name, partial(_cell, of, one, intervals), "%", above=one.above)
        for one in of.columns
    ]
    found = make.built("headline", "", levels, columns)
    if intervals:
        return found
    last = []
    for label, values in (
        (f"chance{_candidates(of)}", [one.chance for one in of.columns]),
        ("+- (95 %, typical)", [_half_width(of, one, levels) for one in of.columns]),
    ):
        if np.isfinite(values).any():
            cells = [make.number(value, scale=100.0) for value in values]
            last.append([make.word(label), *cells])
    return replace(found, rows=[*found.rows, *last])


def _candidates(of: Headline) -> str:
    sizes = [f"{one.candidates:.0f}" for one in of.linked if math.isfinite(one.candidates)]
    return f" of {', '.join(sizes)}" if sizes else ""


def _cell(of: Headline, one: Shown, intervals: bool, where: Where) -> Cell:  # noqa: FBT001 - bound
    found = of.at(where, one)
    if found is None:
        return Cell()
    cell = make.estimated(one.measure.metric if one.measure.metric in METRICS else SUCCESS, found)
    return cell if intervals else replace(cell, low="", high="")


def _half_width(of: Headline, one: Shown, levels: Sequence[Where]) -> float:
    """Return the median half-width of the intervals that are shown in a column."""
    found = [estimate for where in levels if (estimate := of.at(where, one)) is not None]
    widths = [0.5 * (estimate.ci_high - estimate.ci_low) for estimate in found]
    known = [width for width in widths if math.isfinite(width)]
    return float(np.median(known)) if known else math.nan
