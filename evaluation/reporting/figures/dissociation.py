"""Descriptor against linkability: rank 1 over PLR, AEL and MEL as shared, controls marked."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.collections import LineCollection
from matplotlib.ticker import FixedLocator, NullLocator

from evaluation.analysis.families import RAW, families_in
from evaluation.analysis.keys import level_text
from evaluation.analysis.metrics import DESCRIPTORS, EXPOSURE, METRICS
from evaluation.experiment.presets import SHARED
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.drawing import Drawing
from evaluation.reporting.figures.style import Look
from evaluation.reporting.rows import by_level, family_of, is_control, parameters_text
from evaluation.reporting.schemes import rules_of, schemes
from evaluation.reporting.texts import shortened

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evaluation.analysis.families import Family
    from evaluation.analysis.keys import Source
    from evaluation.analysis.linkability import LinkedTask
    from evaluation.reporting.run_results import Results
    from evaluation.reporting.schemes import Scheme

_PERCENT = 100.0
_DISSOCIATED = ("rerelease", "handover")
# Apart from every line, and from each other in grey.
_MARKERS = ("D", "^", "P", "v", "X", "p", "h")
_COLOURS = ("#CC79A7", "#009E73", "#E69F00", "#56B4E9")
_MOST_LABELS = 12
_RIGHT = 0.6
"""Share of an axis behind which labels stand on the left of their marker."""
_SECONDS = [0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0]


def drawings(run: Results) -> list[Drawing]:
    """Return a figure for each task in which the same walk is found again."""
    return [
        Drawing(
            name=f"dissociation-{task.name}",
            section="against",
            title=f"{task.name}: rank 1 over each descriptor, controls marked",
            draw=partial(dissociation_figure, run, task),
            words=partial(_words, run, task),
            task=task.name,
        )
        for task in run.tasks
        if task.name.startswith(_DISSOCIATED)
    ]


def dissociation_figure(run: Results, task: LinkedTask) -> Figure | None:
    """Return rank 1 of the strongest attack of a task over PLR, AEL and MEL as shared.

    One row for each adding rule. What is swept is a line over its levels; a dissociation control
    is a marker with its level. None without two levels of anything swept.
    """
    source = run.link_of(task)
    points = dissociation_points(run.ours, task, source=source)
    known = schemes(points) if len(points) else []
    rules = [
        rule
        for rule in rules_of(known)
        if sum(len(scheme.of(points, rule)) for scheme in known) > 1
    ]
    if not rules:
        return None
    controls = list(
        dict.fromkeys(one.family for one in families_in(points).values() if is_control(one))
    )
    figure = figure_style.placed_figure(
        width_in=figure_style.DOUBLE_COLUMN_IN, height_in=1.75 * len(rules) + 1.0
    )
    panels = figure_style.placed(
        figure, rows=len(rules), columns=len(DESCRIPTORS), left_in=0.45, right_in=0.1, top_in=0.5,
        bottom_in=0.85, gap_in=0.18, between_in=0.3, sharex="col", sharey=True,
    )  # fmt: skip
    for rule, in_row in zip(rules, panels, strict=True):
        in_row[0].set_title(f"{rule} adding")
        in_row[0].set_ylabel("rank 1 (%)")
        for metric, ax in zip(DESCRIPTORS, in_row, strict=True):
            for scheme in known:
                _draw_line(ax, scheme.of(points, rule), metric=metric, scheme=scheme)
            _draw_controls(ax, points, rule=rule, metric=metric, controls=controls)
    for metric, ax in zip(DESCRIPTORS, panels[-1], strict=True):
        ax.set_xlabel(figure_style.label(metric))
        if metric == EXPOSURE:
            ax.set_xlim(left=-2.0)
        else:
            _second_axis(ax, points[metric].to_numpy())
    panels[0, 0].set_ylim(-3.0, min(103.0, 1.12 * _PERCENT * float(points["ci_high"].max())))
    _legend(figure, points, schemes=known, controls=controls)
    who = shortened(source.label, room=figure_style.NAME_LENGTH)
    figure_style.title(figure, dataset=run.dataset, what=f"{task.name}, {who}", one_line=True)
    return figure


def dissociation_points(summary: pd.DataFrame, task: LinkedTask, *, source: Source) -> pd.DataFrame:
    """Return the descriptors as shared with rank 1 of an attack, a row for each level.

    Columns: mechanism, level, family, adding, rank1, ci_low, ci_high, and for each descriptor its
    value, `_low` and `_high`.
    """
    known = families_in(summary)
    shared = summary[(summary["consumer"] == SHARED) & summary["metric"].isin(DESCRIPTORS)]
    rows = []
    for where, of in by_level(shared).items():
        row = task.cells.get(where, {}).get(source)
        if row is None or not np.isfinite(row["rank1"]) or len(of) < len(DESCRIPTORS):
            continue
        one = family_of(known, where[0])
        ends = (("", "value"), ("_low", "ci_low"), ("_high", "ci_high"))
        rows.append(
            {"mechanism": where[0], "level": np.nan if where[1] is None else where[1]}
            | {"family": one.family, "adding": one.adding}
            | {key: row[key] for key in ("rank1", "ci_low", "ci_high")}
            | {f"{of_one['metric']}{end}": of_one[key] for of_one in of for end, key in ends}
        )
    return pd.DataFrame(rows)


def _words(run: Results, task: LinkedTask) -> str:
    source = run.link_of(task)
    points = dissociation_points(run.ours, task, source=source)
    known = families_in(points)
    marked = points["mechanism"].map(lambda name: is_control(known[name]) or name == RAW)
    said = [
        f"{row['mechanism']} {level_text(row['level'])}".rstrip()
        + f": PLR {_PERCENT * row['plr']:.0f} %, rank 1 {_PERCENT * row['rank1']:.0f} %"
        for row in points[marked].to_dict("records")
    ]
    lines = points[points["level"].notna() & ~marked]
    titles = ", ".join(scheme.title for scheme in schemes(points))
    return (
        f"Rank 1 of {source.label} over PLR, AEL and MEL as shared. {titles} are lines from rank 1 "
        f"of {_PERCENT * lines['rank1'].min():.0f} to {_PERCENT * lines['rank1'].max():.0f} %. Did "
        f"a descriptor tell linkability by itself, the controls would lie on the lines. "
        f"{'; '.join(said)}."
    )


def _draw_line(ax: Axes, rows: pd.DataFrame, *, metric: str, scheme: Scheme) -> None:
    look = figure_style.look_of(scheme)
    ax.plot(
        METRICS[metric].scale * rows[metric],
        _PERCENT * rows["rank1"],
        color=look.colour,
        marker=look.marker,
        linestyle=look.dashes,
        zorder=2.5,
    )
    _bars(ax, rows, metric=metric, colour=look.colour)


def _draw_controls(
    ax: Axes, points: pd.DataFrame, *, rule: str, metric: str, controls: Sequence[str]
) -> None:
    """Draw raw as a star, and every control with its level."""
    known, scale = families_in(points), METRICS[metric].scale
    raw = points[points["mechanism"] == RAW]
    ax.plot(
        scale * raw[metric], _PERCENT * raw["rank1"], "*", color="black", markersize=7, zorder=4
    )
    _bars(ax, raw, metric=metric, colour="black")
    labelled = 0
    for name in controls:
        look = _look(name, controls)
        rows = points[(points["family"] == name) & points["adding"].isin([rule, ""])]
        _bars(ax, rows, metric=metric, colour=look.colour)
        ax.plot(
            scale * rows[metric],
            _PERCENT * rows["rank1"],
            look.marker,
            color=look.colour,
            markersize=6.5,
            markeredgecolor="black",
            markeredgewidth=0.6,
            zorder=5,
        )
        for row in rows.to_dict("records"):
            labelled += 1
            if labelled > _MOST_LABELS or np.isnan(row["level"]):
                continue
            # To the side where there is room.
            is_right = row[metric] > _RIGHT * float(points[metric].max())
            ax.annotate(
                _control_text(row, known),
                (scale * row[metric], _PERCENT * row["rank1"]),
                xytext=(-4.5 if is_right else 4.5, 3.0),
                textcoords="offset points",
                horizontalalignment="right" if is_right else "left",
                zorder=6,
            )


def _control_text(row: Mapping[Any, Any], known: Mapping[str, Family]) -> str:
    parameters = parameters_text(family_of(known, row["mechanism"]))
    return ", ".join(filter(None, [figure_style.number(row["level"]), parameters]))


def _look(name: str, controls: Sequence[str]) -> Look:
    place = controls.index(name)
    return Look(_COLOURS[place % len(_COLOURS)], _MARKERS[place % len(_MARKERS)], "")


def _bars(ax: Axes, rows: pd.DataFrame, *, metric: str, colour: str) -> None:
    """Draw the intervals both ways."""
    scale = METRICS[metric].scale
    x, left, right = (scale * rows[name] for name in (metric, f"{metric}_low", f"{metric}_high"))
    y, low, high = (_PERCENT * rows[name] for name in ("rank1", "ci_low", "ci_high"))
    segments = [
        *([(a, b), (c, b)] for a, b, c in zip(left, y, right, strict=True)),
        *([(a, b), (a, c)] for a, b, c in zip(x, low, high, strict=True)),
    ]
    known = [one for one in segments if np.isfinite(one).all()]
    ax.add_collection(LineCollection(known, colors=colour, linewidths=0.5, alpha=0.7, zorder=2))


def _second_axis(ax: Axes, values: Any) -> None:  # noqa: ANN401 - (n,) s
    """Give seconds a logarithmic axis that has a zero: who never leaks belongs on it."""
    positive = values[values > 0]
    if not positive.size:
        return
    threshold = 0.7 * float(positive.min())
    has_zero = bool((values <= 0).any())
    ax.set_xscale("symlog", linthresh=threshold, linscale=0.3)
    ax.set_xlim(-0.3 * threshold if has_zero else threshold, 1.5 * float(values.max()))
    ax.xaxis.set_major_locator(FixedLocator([0.0] * has_zero + _SECONDS))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(lambda value, _: figure_style.number(value))


def _legend(
    figure: Figure, points: pd.DataFrame, *, schemes: Sequence[Scheme], controls: Sequence[str]
) -> None:
    handles: list[Any] = [
        figure_style.line_handle(scheme.title, figure_style.look_of(scheme)) for scheme in schemes
    ]
    if (points["mechanism"] == RAW).any():
        handles.append(figure_style.black_handle("raw", marker="*"))
    for name in controls:
        handle = figure_style.line_handle(f"control: {name}", _look(name, controls))
        handle.set(markersize=6, markeredgecolor="black", markeredgewidth=0.6)
        handles.append(handle)
    handles.append(figure_style.black_handle("bars: 95 % intervals; number: level", dashes="-"))
    figure_style.legend_in_rows(figure, handles, columns=4)
