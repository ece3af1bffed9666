"""Rank 1 of linkage over the level, task by task: the figure of who is found again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.ticker import MaxNLocator

from attacks.tasks.task_list import TASKS
from evaluation.analysis.levels import linked_tasks, remarks, shortened
from evaluation.analysis.linkability import CLEAN, dataset_of
from evaluation.analysis.matching import ADDING_SUFFIX
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.style import LOOKS, Look
from evaluation.reporting.figures.sweeps import FID, FIXED

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evaluation.analysis.keys import Source
    from evaluation.analysis.levels import LinkedTask
    from evaluation.reporting.figures.sweeps import Scheme

LABEL = "rank 1 (%)"
_PERCENT = 100.0
_ESTIMATE = ["rank1", "ci_low", "ci_high"]
_CHANCE_LOOK = Look("#777777", "", "-")
_CEILING_LOOK = Look("#000000", "", (0, (6, 2)))
# What is near chance gets a shorter axis: on a whole one it would be a line at the bottom.
_LIMITS = (10.0, 30.0, 100.0)
_MOST_BANDS = 2
_NOTES = {"rerelease": "upper bound"}


@dataclass(frozen=True, slots=True)
class _Panel:
    """A column of the figure: a way of adding error, and its adding rule."""

    scheme: Scheme
    adding: str

    @property
    def mechanism(self) -> str:
        return f"{self.scheme.name}{ADDING_SUFFIX[self.adding]}"


@dataclass(frozen=True, eq=False, slots=True)
class _Row:
    """A row of the figure: a task."""

    task: LinkedTask
    series: Mapping[tuple[_Panel, Source], pd.DataFrame]
    """Level, rank 1 and interval in %, and whether it links, by rising level."""

    def alone(self, mechanism: str) -> dict[Source, float]:
        """Return rank 1 in % at a mechanism without levels, of the attacks that are drawn."""
        block = self.task.cells.get((mechanism, None), {})
        drawn = dict.fromkeys(source for _, source in self.series)
        return {
            source: _PERCENT * block[source]["rank1"]
            for source in drawn
            if source in block and np.isfinite(block[source]["rank1"])
        }

    @property
    def banded(self) -> list[Source]:
        """The strongest: the bands of many would hide each other."""
        drawn = dict.fromkeys(source for _, source in self.series)
        return sorted(drawn, key=lambda source: -_mean(self.task, source))[:_MOST_BANDS]

    @property
    def limit(self) -> float:
        """End of the axis."""
        known = [*self.alone("raw").values(), *self.alone(CLEAN).values(), 0.0]
        known += [float(np.nanmax(found[_ESTIMATE])) for found in self.series.values()]
        highest = max(known)
        return next((limit for limit in _LIMITS if highest <= limit), _LIMITS[-1])


def linkage_figure(linkability: pd.DataFrame, *, dataset: str) -> Figure | None:
    """Return rank 1 over the level, one row for each task; None without linkage or levels.

    One column for each way of adding error and adding rule. At most five attacks are drawn: the
    strongest of each task by mean rank 1 over all levels, then the second strongest of each, and
    so on. An attack looks the same in every task.
    """
    tasks = linked_tasks(ours(linkability, dataset=dataset))
    drawn = _strongest(tasks)
    rows = [row for task in tasks if (row := _row(task, drawn)).series]
    if not rows:
        return None
    panels = [
        panel for panel in _panels() if any(panel == key[0] for row in rows for key in row.series)
    ]
    looks = dict(zip(drawn, LOOKS, strict=False))
    figure = figure_style.empty_figure(
        width_in=figure_style.SINGLE_COLUMN_IN
        if len(panels) == 1
        else figure_style.DOUBLE_COLUMN_IN,
        height_in=1.05 * len(rows) + 1.3,
    )
    axes = figure.subplots(len(rows), len(panels), sharex="col", sharey="row", squeeze=False)
    for row, in_row in zip(rows, axes, strict=True):
        in_row[0].set_ylabel(_label(row.task))
        in_row[0].set_ylim(-0.03 * row.limit, 1.03 * row.limit)
        if row.limit < _PERCENT:
            _say_short(in_row[0], limit=row.limit)
        for panel, ax in zip(panels, in_row, strict=True):
            _draw(ax, row, panel=panel, looks=looks)
    for panel, in_column in zip(panels, axes.T, strict=True):
        in_column[0].set_title(f"{panel.scheme.title},\n{panel.adding} adding")
        in_column[-1].set_xlabel(panel.scheme.label)
        figure_style.level_axis(in_column[0], log=panel.scheme.log)
        if not panel.scheme.log:
            # Few, lest those of two panels meet.
            in_column[0].xaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 5, 10]))
    _legend(figure, rows, looks)
    _title(figure, [row.task for row in rows], dataset=dataset)
    return figure


def ours(linkability: pd.DataFrame, *, dataset: str) -> pd.DataFrame:
    """Return the rows of a run's data set and of the tasks that have their own."""
    expected = linkability["consumer"].map(lambda name: dataset_of(name, dataset=dataset))
    return linkability[linkability["dataset"] == expected]


def _panels() -> list[_Panel]:
    return [_Panel(scheme, adding) for scheme in (FID, FIXED) for adding in ADDING_SUFFIX]


def _strongest(tasks: Sequence[LinkedTask]) -> list[Source]:
    """Return the attacks that are drawn: of each task the strongest, then the second, and so on."""
    ranked = [sorted(task.attacks, key=lambda source: -_mean(task, source)) for task in tasks]
    turns = [
        attacks[place]
        for place in range(max(map(len, ranked), default=0))
        for attacks in ranked
        if place < len(attacks)
    ]
    return list(dict.fromkeys(turns))[: len(LOOKS)]


def _mean(task: LinkedTask, source: Source) -> float:
    """Return mean rank 1 over the levels; neither raw nor the ceiling has one."""
    values = [
        block[source]["rank1"]
        for (_, level), block in task.cells.items()
        if level is not None and source in block and np.isfinite(block[source]["rank1"])
    ]
    return float(np.mean(values)) if values else -1.0


def _row(task: LinkedTask, drawn: Sequence[Source]) -> _Row:
    series = {}
    for panel in _panels():
        for source in drawn:
            points = [
                [
                    level,
                    *(_PERCENT * block[source][key] for key in _ESTIMATE),
                    not remarks(block[source]),
                ]
                for (mechanism, level), block in task.cells.items()
                if mechanism == panel.mechanism
                and level is not None
                and (level > 0 or not panel.scheme.log)
                and source in block
                and np.isfinite(block[source]["rank1"])
            ]
            if points:
                series[panel, source] = pd.DataFrame(points, columns=["level", *_ESTIMATE, "links"])
    return _Row(task=task, series=series)


def _draw(ax: Axes, row: _Row, *, panel: _Panel, looks: Mapping[Source, Look]) -> None:
    chances = [cell["chance"] for block in row.task.cells.values() for cell in block.values()]
    ax.axhline(_PERCENT * chances[0], color=_CHANCE_LOOK.colour, linewidth=0.8, zorder=1.5)
    ceilings = row.alone(CLEAN)
    if ceilings:
        ax.axhline(
            max(ceilings.values()),
            color=_CEILING_LOOK.colour,
            linestyle=_CEILING_LOOK.dashes,
            linewidth=0.8,
            zorder=1.6,
        )
    at_edge = (0.95, 1.0) if panel.scheme.log else (0.0, 0.06)
    for source, value in row.alone("raw").items():
        ax.plot(
            at_edge,
            [value, value],
            transform=ax.get_yaxis_transform(),
            color=looks[source].colour,
            linestyle=":",
            zorder=2.6,
        )
    for source, look in looks.items():
        found = row.series.get((panel, source))
        if found is None:
            continue
        level, *estimate = (found[key].to_numpy() for key in ("level", *_ESTIMATE))
        ax.plot(level, estimate[0], color=look.colour, marker=look.marker, linestyle=look.dashes)
        silent = found[~found["links"]]
        ax.plot(
            silent["level"],
            silent["rank1"],
            look.marker,
            color=look.colour,
            markerfacecolor="white",
            markeredgewidth=0.6,
            markersize=4.2,
            zorder=2.7,
        )
        if source in row.banded:
            figure_style.band(ax, x=level, low=estimate[1], high=estimate[2], look=look)


def _say_short(ax: Axes, *, limit: float) -> None:
    ax.text(0.03, 0.97, f"axis ends at {limit:g} %", transform=ax.transAxes, va="top")


def _label(task: LinkedTask) -> str:
    is_simulated = task.name in TASKS and TASKS[task.name].simulated
    note = "simulated" if is_simulated else _NOTES.get(task.name, "")
    return "\n".join([task.name, *filter(None, [note and f"({note})"]), LABEL])


def _name(source: Source) -> str:
    return shortened(source.label, room=figure_style.NAME_LENGTH)


def _legend(figure: Figure, rows: Sequence[_Row], looks: Mapping[Source, Look]) -> None:
    drawn = {source for row in rows for _, source in row.series}
    handles: list[Any] = [
        figure_style.line_handle(_name(source), look)
        for source, look in looks.items()
        if source in drawn
    ]
    if any(row.alone("raw") for row in rows):
        handles.append(figure_style.black_handle("raw (at its edge)", dashes=":"))
    if any(row.alone(CLEAN) for row in rows):
        handles.append(figure_style.line_handle("ceiling (no error at all)", _CEILING_LOOK))
    if any(not found["links"].all() for row in rows for found in row.series.values()):
        handles.append(
            figure_style.black_handle("does not link, or is invalid", marker="o", hollow=True)
        )
    handles.append(figure_style.line_handle("chance", _CHANCE_LOOK))
    crowded = any(len(row.banded) < len({source for _, source in row.series}) for row in rows)
    only = f" (the {_MOST_BANDS} strongest)" if crowded else ""
    handles.append(figure_style.band_handle(f"95 % interval{only}"))
    figure_style.legend(figure, handles)


def _title(figure: Figure, tasks: Sequence[LinkedTask], *, dataset: str) -> None:
    """Say whose walks they are: a simulated task has people of its own."""
    of = {dataset_of(f"{task.name}/", dataset=dataset): task.name for task in tasks}
    others = [f"{name}: {other}" for other, name in of.items() if other != dataset]
    name = dataset if dataset in of else next(iter(of))
    what = "linkage, the strongest attacks of each task by mean rank 1"
    if dataset in of and others:
        what += f" ({', '.join(others)})"
    figure_style.title(figure, dataset=name, what=what)
