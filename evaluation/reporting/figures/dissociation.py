"""Descriptor against linkability: rank 1 over PLR, AEL and MEL as shared, controls marked."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.ticker import FixedLocator, NullLocator

from evaluation.analysis.families import RAW, families_in
from evaluation.analysis.keys import level_text
from evaluation.analysis.metrics import DESCRIPTORS, EXPOSURE, METRICS
from evaluation.experiment.presets import SHARED
from evaluation.reporting.figures import style
from evaluation.reporting.figures.drawing import Drawing
from evaluation.reporting.figures.style import PERCENT, Look
from evaluation.reporting.rows import (
    ENDS,
    family_of,
    is_control,
    parameters_text,
    rank1_rows,
    rules_of,
    schemes,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evaluation.analysis.keys import Source
    from evaluation.analysis.linkability import LinkedTask
    from evaluation.reporting.rows import Results

_DISSOCIATED = ("rerelease", "handover")
# Apart from every line, and from each other in grey.
_MARKERS = ("D", "^", "P", "v", "X", "p", "h")
_COLOURS = ("#CC79A7", "#009E73", "#E69F00", "#56B4E9")
_EDGE: dict[str, Any] = {"markeredgecolor": "black", "markeredgewidth": 0.6}
_MOST_LABELS = 12
_RIGHT = 0.6
"""Share of an axis behind which labels stand on the left of their marker."""
_SECONDS = [0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0]


def drawings(run: Results) -> list[Drawing]:
    """Return a figure for each task in which the same walk is found again."""
    return [
        Drawing(
            *(f"dissociation-{task.name}", "against"),
            f"{task.name}: rank 1 over each descriptor, controls marked",
            *(partial(dissociation_figure, task=task), partial(_words, task=task)),
            task=task.name,
        )
        for task in run.tasks
        if task.name.startswith(_DISSOCIATED)
    ]


def dissociation_figure(run: Results, *, task: LinkedTask) -> Figure | None:
    """Return rank 1 of the strongest attack of a task over PLR, AEL and MEL as shared.

    One row for each adding rule. What is swept is a line over its levels; a dissociation control
    is a marker with its level. None without two levels of anything swept.
    """
    source = run.link_of(task)
    points = dissociation_points(run.ours, task, source=source)
    known = schemes(points) if len(points) else []
    n_levels = {rule: sum(len(one.of(points, rule)) for one in known) for rule in rules_of(known)}
    rules = [rule for rule, n in n_levels.items() if n > 1]
    if not rules:
        return None
    controls = dict.fromkeys(one.family for one in families_in(points).values() if is_control(one))
    looks = {
        name: Look(_COLOURS[place % len(_COLOURS)], _MARKERS[place % len(_MARKERS)], "")
        for place, name in enumerate(controls)
    }
    figure, panels = style.panels(
        *(len(rules), len(DESCRIPTORS)),
        height_in=1.75 * len(rules) + 1.0,
        margins_in=(0.45, 0.1, 0.5, 0.85),
        gaps_in=(0.18, 0.3),
        sharex="col",
        sharey=True,
    )
    for metric, in_column in zip(DESCRIPTORS, panels.T, strict=True):
        shown = _on_axes(points, metric)
        for rule, ax in zip(rules, in_column, strict=True):
            for scheme in known:
                rows, look = scheme.of(shown, rule), style.look_of(scheme)
                ax.plot(rows["x"], rows["y"], **look.line, zorder=2.5)
                _bars(ax, rows, colour=look.colour)
            _draw_controls(ax, shown, rule=rule, looks=looks)
        in_column[-1].set_xlabel(style.label(metric))
        if metric == EXPOSURE:
            in_column[-1].set_xlim(left=-2.0)
        elif (shown["x"] > 0).any():
            # Logarithmic seconds that have a zero: who never leaks belongs on the axis.
            x, ax = shown["x"], in_column[-1]
            threshold, zero = 0.7 * float(x[x > 0].min()), [0.0] * bool((x <= 0).any())
            ax.set_xscale("symlog", linthresh=threshold, linscale=0.3)
            ax.set_xlim(-0.3 * threshold if zero else threshold, 1.5 * float(x.max()))
            ax.xaxis.set_major_locator(FixedLocator(zero + _SECONDS))
            ax.xaxis.set_minor_locator(NullLocator())
            ax.xaxis.set_major_formatter(lambda value, _: style.number(value))
    for rule, in_row in zip(rules, panels, strict=True):
        in_row[0].set_title(f"{rule} adding")
        in_row[0].set_ylabel("rank 1 (%)")
    panels[0, 0].set_ylim(-3.0, min(103.0, 1.12 * PERCENT * float(points["ci_high"].max())))
    has_raw = bool((points["mechanism"] == RAW).any())
    handles = [
        *(style.handle(one.title, style.look_of(one)) for one in known),
        has_raw and style.black_handle("raw", marker="*"),
        *(
            style.handle(f"control: {name}", look, markersize=6, **_EDGE)
            for name, look in looks.items()
        ),
        style.black_handle("bars: 95 % intervals; number: level", dashes="-"),
    ]
    what = f"{task.name}, {style.short(source)}"
    return style.finish(figure, handles, dataset=run.dataset, what=what, columns=4)


def dissociation_points(summary: pd.DataFrame, task: LinkedTask, *, source: Source) -> pd.DataFrame:
    """Return the descriptors as shared with rank 1 of an attack, a row for each level.

    Columns: mechanism, level, family, adding; value, ci_low and ci_high of rank 1; and for each
    descriptor its value, `_low` and `_high`.
    """
    known = families_in(summary)
    points = rank1_rows(task, source)
    for metric in DESCRIPTORS:
        rows = summary[(summary["consumer"] == SHARED) & (summary["metric"] == metric)]
        names = dict(zip(ENDS, (metric, f"{metric}_low", f"{metric}_high"), strict=True))
        rows = rows[["mechanism", "level", *ENDS]].rename(columns=names)
        points = points.merge(rows, on=["mechanism", "level"])
    of = [family_of(known, name) for name in points["mechanism"]]
    return points.assign(family=[one.family for one in of], adding=[one.adding for one in of])


def _words(run: Results, *, task: LinkedTask) -> str:
    source = run.link_of(task)
    points = dissociation_points(run.ours, task, source=source)
    known = families_in(points)
    marked = points["mechanism"].map(lambda name: is_control(known[name]) or name == RAW)
    said = [
        f"{row['mechanism']} {level_text(row['level'])}".rstrip()
        + f": PLR {PERCENT * row['plr']:.0f} %, rank 1 {PERCENT * row['value']:.0f} %"
        for row in points[marked].to_dict("records")
    ]
    lines = points[points["level"].notna() & ~marked]
    titles = ", ".join(scheme.title for scheme in schemes(points))
    return (
        f"Rank 1 of {source.label} over PLR, AEL and MEL as shared. {titles} are lines from rank 1 "
        f"of {PERCENT * lines['value'].min():.0f} to {PERCENT * lines['value'].max():.0f} %. Did "
        f"a descriptor tell linkability by itself, the controls would lie on the lines. "
        f"{'; '.join(said)}."
    )


def _on_axes(points: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Return descriptor x and rank 1 y with their intervals, in the units of the axes."""
    scale = METRICS[metric].scale
    x = {f"x{end}": scale * points[f"{metric}{end}"] for end in ("", "_low", "_high")}
    y = zip(("y", "y_low", "y_high"), ENDS, strict=True)
    return points.assign(**x, **{name: PERCENT * points[end] for name, end in y})


def _draw_controls(ax: Axes, shown: pd.DataFrame, *, rule: str, looks: Mapping[str, Look]) -> None:
    """Draw raw as a star, and every control with its level."""
    known = families_in(shown)
    raw = shown[shown["mechanism"] == RAW]
    ax.plot(raw["x"], raw["y"], "*", color="black", markersize=7, zorder=4)
    _bars(ax, raw, colour="black")
    labelled = 0
    for name, look in looks.items():
        rows = shown[(shown["family"] == name) & shown["adding"].isin([rule, ""])]
        _bars(ax, rows, colour=look.colour)
        at: dict[str, Any] = {"color": look.colour, "markersize": 6.5, "zorder": 5}
        ax.plot(rows["x"], rows["y"], look.marker, **at, **_EDGE)
        for row in rows.to_dict("records"):
            labelled += 1
            if labelled > _MOST_LABELS or np.isnan(row["level"]):
                continue
            parameters = parameters_text(known[row["mechanism"]])
            text = ", ".join(filter(None, [style.number(row["level"]), parameters]))
            # To the side where there is room.
            is_right = row["x"] > _RIGHT * float(shown["x"].max())
            ax.annotate(
                text,
                (row["x"], row["y"]),
                xytext=(-4.5 if is_right else 4.5, 3.0),
                textcoords="offset points",
                horizontalalignment="right" if is_right else "left",
                zorder=6,
            )


def _bars(ax: Axes, rows: pd.DataFrame, *, colour: str) -> None:
    """Draw the intervals both ways."""
    low = rows[["x_low", "y", "x", "y_low"]].to_numpy().reshape(-1, 2)
    high = rows[["x_high", "y", "x", "y_high"]].to_numpy().reshape(-1, 2)
    segments = np.stack([low, high], axis=1)
    known = segments[np.isfinite(segments).all(axis=(1, 2))]
    ax.add_collection(LineCollection(known, colors=colour, linewidths=0.5, alpha=0.7, zorder=2))
