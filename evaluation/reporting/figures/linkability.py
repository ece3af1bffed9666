"""Rank 1 of linkage over the level, task by task: the figure of who is found again."""

from __future__ import annotations

from itertools import zip_longest
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.ticker import MaxNLocator

from attacks.tasks.task_list import TASKS
from evaluation.analysis.families import CLEAN, RAW
from evaluation.analysis.linkability import dataset_of
from evaluation.reporting.figures import style
from evaluation.reporting.figures.drawing import Drawing
from evaluation.reporting.figures.style import LOOKS, PERCENT, Line, Look
from evaluation.reporting.rows import ENDS, rank1_rows, schemes

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evaluation.analysis.keys import Source
    from evaluation.analysis.linkability import LinkedTask
    from evaluation.reporting.rows import Results, Scheme

_CHANCE_LOOK = Look("#777777", "", "-")
_CEILING_LOOK = Look("#000000", "", (0, (6, 2)))
# What is near chance gets a shorter axis: on a whole one it would be a line at the bottom.
_LIMITS = (10.0, 30.0, 100.0)
_MOST_BANDS = 2
_NOTES = {"rerelease": "(upper bound)"}


class _Row(NamedTuple):
    """A row of the figure: a task, and the lines of those who are drawn."""

    task: LinkedTask
    lines: Mapping[Source, Line]
    points: pd.DataFrame
    """Of all lines, over the levels that are shown."""

    def alone(self, mechanism: str) -> list[float]:
        """Return rank 1 in % at a mechanism without levels."""
        every = (line.rows for line in self.lines.values())
        return [PERCENT * one for of in every for one in of["value"][of["mechanism"] == mechanism]]


def drawings(_: Results) -> list[Drawing]:
    """Return the figure of all tasks."""
    title = "Rank 1 of the strongest attacks over the level, task by task"
    return [Drawing("linkability", "linkability", title, linkage_figure, _words)]


def linkage_figure(run: Results) -> Figure | None:
    """Return rank 1 over the level, one row for each task; None without linkage or levels.

    One column for each way of adding error and adding rule. At most five attacks are drawn, each
    alike in every task.
    """
    known = [(scheme, rule) for scheme in schemes(run.summary) for rule in scheme.rules]
    looks = dict(zip(_strongest(run.tasks), LOOKS, strict=False))
    rows = [row for task in run.tasks if (row := _row(task, looks, known)).lines]
    if not rows:
        return None
    columns = [
        (scheme, rule)
        for scheme, rule in known
        if scheme.of(pd.concat(row.points for row in rows), rule).size
    ]
    figure, panels = style.panels(
        len(rows), len(columns), height_in=1.05 * len(rows) + 1.3, sharex="col", sharey="row"
    )
    for row, in_row in zip(rows, panels, strict=True):
        name = row.task.name
        is_simulated = name in TASKS and TASKS[name].simulated
        note = "(simulated)" if is_simulated else _NOTES.get(name, "")
        in_row[0].set_ylabel("\n".join(filter(None, [name, note, "rank 1 (%)"])))
        ends = PERCENT * row.points[ENDS].to_numpy(dtype=float)
        highest = max([float(np.nanmax(ends)), *row.alone(RAW), *row.alone(CLEAN)])
        limit = next((limit for limit in _LIMITS if highest <= limit), _LIMITS[-1])
        in_row[0].set_ylim(-0.03 * limit, 1.03 * limit)
        if limit < PERCENT:
            ends_at = f"axis ends at {limit:g} %"
            in_row[0].text(0.03, 0.97, ends_at, transform=in_row[0].transAxes, va="top")
        for (scheme, rule), ax in zip(columns, in_row, strict=True):
            _draw(ax, row, scheme=scheme, rule=rule)
    for (scheme, rule), in_column in zip(columns, panels.T, strict=True):
        in_column[0].set_title(f"{scheme.title},\n{scheme.rule_text(rule)}")
        in_column[-1].set_xlabel(scheme.label)
        style.level_axis(in_column[0], log=scheme.log)
        if not scheme.log:
            # Few, lest those of two panels meet.
            in_column[0].xaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 5, 10]))
    name, what = _title(run.dataset, rows)
    return style.finish(figure, _handles(rows, looks), dataset=name, what=what)


def _words(run: Results) -> str:
    parts = []
    for task in run.tasks:
        source = run.link_of(task)
        rows = rank1_rows(task, source)
        if rows.empty:
            continue
        noisy = PERCENT * rows.loc[rows["level"].notna(), "value"]
        said = [
            f"{PERCENT * row['value']:.0f} % at {row['mechanism']}"
            for row in rows[rows["level"].isna()].to_dict("records")
        ]
        said += [f"{noisy.min():.0f} to {noisy.max():.0f} % with noise"] if len(noisy) else []
        chance = PERCENT * rows["chance"].iloc[0]
        parts.append(f"{task.name}: {source.label} {', '.join(said)}; chance {chance:.1f} %.")
    return f"Lines of rank 1, a row for each task. {' '.join(parts)}"


def _strongest(tasks: Sequence[LinkedTask]) -> list[Source]:
    """Return who is drawn: of each task the strongest, then the second of each, and so on."""
    ranked = [
        sorted(task.attacks, key=lambda source: -_mean(rank1_rows(task, source))) for task in tasks
    ]
    turns = (source for turn in zip_longest(*ranked) for source in turn if source is not None)
    return list(dict.fromkeys(turns))[: len(LOOKS)]


def _mean(rows: pd.DataFrame) -> float:
    """Return mean rank 1 over the levels; neither raw nor the ceiling has one."""
    values = rows.loc[rows["level"].notna(), "value"].to_numpy()
    return float(np.mean(values)) if values.size else -1.0


def _row(
    task: LinkedTask, looks: Mapping[Source, Look], columns: Sequence[tuple[Scheme, str]]
) -> _Row:
    drawn: dict[Source, pd.DataFrame] = {}
    points = []
    for source in looks:
        rows = rank1_rows(task, source)
        series = [of for scheme, rule in columns if len(of := scheme.of(rows, rule))]
        points += series
        drawn |= {source: rows} if series else {}
    # The strongest: the bands of many would hide each other.
    banded = sorted(drawn, key=lambda source: -_mean(drawn[source]))[:_MOST_BANDS]
    lines = {
        of: Line(style.short(of), looks[of], rows, has_band=of in banded)
        for of, rows in drawn.items()
    }
    return _Row(task, lines, pd.concat(points) if points else pd.DataFrame())


def _draw(ax: Axes, row: _Row, *, scheme: Scheme, rule: str) -> None:
    chance = next(cell["chance"] for block in row.task.cells.values() for cell in block.values())
    ax.axhline(PERCENT * chance, color=_CHANCE_LOOK.colour, linewidth=0.8, zorder=1.5)
    if ceilings := row.alone(CLEAN):
        colour, dashes = _CEILING_LOOK.colour, _CEILING_LOOK.dashes
        ax.axhline(max(ceilings), color=colour, linestyle=dashes, linewidth=0.8, zorder=1.6)
    for line in row.lines.values():
        line.draw(ax, scheme, rule)
        found = scheme.of(line.rows, rule)
        silent = found[~found["links"]]
        look: dict[str, Any] = {"color": line.look.colour, "markerfacecolor": "white"}
        look |= {"markeredgewidth": 0.6, "markersize": 4.2, "zorder": 2.7}
        ax.plot(silent["level"], PERCENT * silent["value"], line.look.marker, **look)


def _handles(rows: Sequence[_Row], looks: Mapping[Source, Look]) -> list[Any]:
    """Return what stands in the legend."""
    lines = {source: line for row in rows for source, line in row.lines.items()}
    has_raw, has_ceiling = (any(row.alone(name) for row in rows) for name in (RAW, CLEAN))
    has_silent = not all(row.points["links"].all() for row in rows)
    is_banded = all(line.has_band for row in rows for line in row.lines.values())
    only = "" if is_banded else f" (the {_MOST_BANDS} strongest)"
    return [
        *(lines[source].handle for source in looks if source in lines),
        has_raw and style.black_handle("raw (at its edge)", dashes=":"),
        has_ceiling and style.handle("ceiling (no error at all)", _CEILING_LOOK),
        has_silent and style.black_handle("does not link, or is invalid", marker="o", hollow=True),
        style.handle("chance", _CHANCE_LOOK),
        style.band_handle(f"95 % interval{only}"),
    ]


def _title(dataset: str, rows: Sequence[_Row]) -> tuple[str, str]:
    """Return whose walks they are: a simulated task has people of its own."""
    of = {dataset_of(f"{row.task.name}/", dataset=dataset): row.task.name for row in rows}
    others = [f"{name}: {other}" for other, name in of.items() if other != dataset]
    name = dataset if dataset in of else next(iter(of))
    what = "linkage, the strongest attacks of each task by mean rank 1"
    if dataset in of and others:
        what += f" ({', '.join(others)})"
    return name, what
