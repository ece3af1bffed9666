"""Rank 1 of linkage over the level, task by task: the figure of who is found again."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.ticker import MaxNLocator

from attacks.tasks.task_list import TASKS
from evaluation.analysis.families import CLEAN, RAW
from evaluation.analysis.linkability import dataset_of, remarks
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.drawing import Drawing
from evaluation.reporting.figures.style import LOOKS, Look
from evaluation.reporting.schemes import schemes
from evaluation.reporting.texts import shortened

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evaluation.analysis.keys import Source
    from evaluation.analysis.linkability import LinkedTask
    from evaluation.reporting.run_results import Results
    from evaluation.reporting.schemes import Scheme

LABEL = "rank 1 (%)"
_PERCENT = 100.0
_ESTIMATE = ["rank1", "ci_low", "ci_high"]
_CHANCE_LOOK = Look("#777777", "", "-")
_CEILING_LOOK = Look("#000000", "", (0, (6, 2)))
# What is near chance gets a shorter axis: on a whole one it would be a line at the bottom.
_LIMITS = (10.0, 30.0, 100.0)
_MOST_BANDS = 2
_MOST_TICKS = 4
_NOTES = {"rerelease": "upper bound"}


@dataclass(frozen=True, slots=True)
class _Panel:
    """A column of the figure: a way of adding error, and its adding rule."""

    scheme: Scheme
    rule: str


@dataclass(frozen=True, eq=False, slots=True)
class _Row:
    """A row of the figure: a task."""

    task: LinkedTask
    series: Mapping[tuple[_Panel, Source], pd.DataFrame]
    """Level, rank 1 and interval in %, and whether it links, by rising level."""

    @property
    def drawn(self) -> list[Source]:
        """Who is drawn."""
        return list(dict.fromkeys(source for _, source in self.series))

    def alone(self, mechanism: str) -> dict[Source, float]:
        """Return rank 1 in % at a mechanism without levels, of the attacks that are drawn."""
        block = self.task.cells.get((mechanism, None), {})
        return {
            source: _PERCENT * block[source]["rank1"]
            for source in self.drawn
            if source in block and np.isfinite(block[source]["rank1"])
        }

    @property
    def banded(self) -> list[Source]:
        """The strongest: the bands of many would hide each other."""
        return sorted(self.drawn, key=lambda source: -_mean(self.task, source))[:_MOST_BANDS]

    @property
    def limit(self) -> float:
        """End of the axis."""
        known = [*self.alone(RAW).values(), *self.alone(CLEAN).values(), 0.0]
        known += [float(np.nanmax(found[_ESTIMATE])) for found in self.series.values()]
        highest = max(known)
        return next((limit for limit in _LIMITS if highest <= limit), _LIMITS[-1])


def drawings(run: Results) -> list[Drawing]:
    """Return the figure of all tasks."""
    return [
        Drawing(
            name="linkability",
            section="linkability",
            title="Rank 1 of the strongest attacks over the level, task by task",
            draw=partial(linkage_figure, run),
            words=partial(_words, run),
        )
    ]


def linkage_figure(run: Results) -> Figure | None:
    """Return rank 1 over the level, one row for each task; None without linkage or levels.

    One column for each way of adding error and adding rule. At most five attacks are drawn: the
    strongest of each task by mean rank 1 over all levels, then the second strongest of each, and
    so on. An attack looks the same in every task.
    """
    known = [_Panel(scheme, rule) for scheme in schemes(run.summary) for rule in scheme.rules]
    drawn = _strongest(run.tasks)
    rows = [row for task in run.tasks if (row := _row(task, drawn, known)).series]
    if not rows:
        return None
    panels = [
        panel for panel in known if any((panel, one) in row.series for row in rows for one in drawn)
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
            in_row[0].text(
                0.03,
                0.97,
                f"axis ends at {row.limit:g} %",
                transform=in_row[0].transAxes,
                va="top",
            )
        for panel, ax in zip(panels, in_row, strict=True):
            _draw(ax, row, panel=panel, looks=looks)
    for panel, in_column in zip(panels, axes.T, strict=True):
        in_column[0].set_title(f"{panel.scheme.title},\n{panel.scheme.rule_text(panel.rule)}")
        in_column[-1].set_xlabel(panel.scheme.label)
        figure_style.level_axis(in_column[0], log=panel.scheme.log)
        if not panel.scheme.log:
            # Few, lest those of two panels meet.
            locator = MaxNLocator(nbins=_MOST_TICKS, steps=[1, 5, 10])
            in_column[0].xaxis.set_major_locator(locator)
    _legend(figure, rows, looks)
    _title(figure, [row.task for row in rows], dataset=run.dataset)
    return figure


def _words(run: Results) -> str:
    parts = []
    for task in run.tasks:
        source = run.link_of(task)
        levels = {
            where: block[source]
            for where, block in task.cells.items()
            if source in block and np.isfinite(block[source]["rank1"])
        }
        if not levels:
            continue
        said = [
            f"{_PERCENT * row['rank1']:.0f} % at {name}"
            for (name, level), row in levels.items()
            if level is None
        ]
        noisy = [_PERCENT * row["rank1"] for (_, level), row in levels.items() if level is not None]
        if noisy:
            said.append(f"{min(noisy):.0f} to {max(noisy):.0f} % with noise")
        chance = _PERCENT * next(iter(levels.values()))["chance"]
        parts.append(f"{task.name}: {source.label} {', '.join(said)}; chance {chance:.1f} %.")
    return f"Lines of rank 1, a row for each task. {' '.join(parts)}"


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


def _row(task: LinkedTask, drawn: Sequence[Source], panels: Sequence[_Panel]) -> _Row:
    series = {}
    for source in drawn:
        points = pd.DataFrame(
            [
                [
                    mechanism,
                    np.nan if level is None else level,
                    *(_PERCENT * block[source][key] for key in _ESTIMATE),
                    not remarks(block[source]),
                ]
                for (mechanism, level), block in task.cells.items()
                if source in block and np.isfinite(block[source]["rank1"])
            ],
            columns=["mechanism", "level", *_ESTIMATE, "links"],
        )
        for panel in panels:
            found = panel.scheme.of(points, panel.rule)
            if len(found):
                series[panel, source] = found
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
    for source, value in row.alone(RAW).items():
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


def _label(task: LinkedTask) -> str:
    is_simulated = task.name in TASKS and TASKS[task.name].simulated
    note = "simulated" if is_simulated else _NOTES.get(task.name, "")
    return "\n".join([task.name, *filter(None, [note and f"({note})"]), LABEL])


def _legend(figure: Figure, rows: Sequence[_Row], looks: Mapping[Source, Look]) -> None:
    drawn = {source for row in rows for source in row.drawn}
    handles: list[Any] = [
        figure_style.line_handle(shortened(source.label, room=figure_style.NAME_LENGTH), look)
        for source, look in looks.items()
        if source in drawn
    ]
    if any(row.alone(RAW) for row in rows):
        handles.append(figure_style.black_handle("raw (at its edge)", dashes=":"))
    if any(row.alone(CLEAN) for row in rows):
        handles.append(figure_style.line_handle("ceiling (no error at all)", _CEILING_LOOK))
    if any(not found["links"].all() for row in rows for found in row.series.values()):
        handles.append(
            figure_style.black_handle("does not link, or is invalid", marker="o", hollow=True)
        )
    handles.append(figure_style.line_handle("chance", _CHANCE_LOOK))
    crowded = any(len(row.banded) < len(row.drawn) for row in rows)
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
