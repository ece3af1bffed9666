"""Figures of linkage: rank 1 over the level, and over each descriptor with the controls marked."""

from __future__ import annotations

from functools import partial
from itertools import cycle, zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.collections import LineCollection
from matplotlib.ticker import FixedLocator, MaxNLocator

from attacks.tasks.task_list import TASKS
from evaluation.analysis.families import CLEAN, RAW, families_in
from evaluation.analysis.keys import Source, level_text
from evaluation.analysis.linkability import LinkedTask, dataset_of
from evaluation.analysis.metrics import DESCRIPTORS, EXPOSURE, METRICS
from evaluation.experiment.presets import SHARED
from evaluation.reporting import rows as picked
from evaluation.reporting.figures import drawing
from evaluation.reporting.figures.drawing import LOOKS, PERCENT, Drawing, Line, Look

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CHANCE_LOOK = Look("#777777", "", "-")
_CEILING_LOOK = Look("#000000", "", (0, (6, 2)))
# What is near chance gets a shorter axis: on a whole one it would be a line at the bottom.
_LIMITS = (10.0, 30.0, 100.0)
_MOST_BANDS = 2
_NOTES = {"rerelease": "(upper bound)"}
_DISSOCIATED = "rerelease"
# Apart from every line, and from each other in grey.
_MARKERS = ("D", "^", "P", "v", "X", "p", "h")
_COLOURS = ("#CC79A7", "#009E73", "#E69F00", "#56B4E9")
_EDGE: dict[str, Any] = {"markeredgecolor": "black", "markeredgewidth": 0.6}
_MOST_LABELS = 12
_RIGHT = 0.6
"""Share of an axis behind which labels stand on the left of their marker."""
_SECONDS = [0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0]


def drawings(run: picked.Results) -> list[Drawing]:
    """Return the figure of all tasks, and that of rerelease over the descriptors."""
    title = "Rank 1 of the strongest attacks over the level, task by task"
    return [
        Drawing("linkability", "linkability", title, _linkage_figure, _level_words),
        *(
            Drawing(
                *(f"dissociation-{task.name}", "against"),
                f"{task.name}: rank 1 over each descriptor, controls marked",
                *(partial(_dissociation_figure, task=task), partial(_descriptor_words, task=task)),
                task=task.name,
            )
            for task in run.tasks
            if task.name == _DISSOCIATED
        ),
    ]


def _linkage_figure(run: picked.Results) -> Figure | None:
    """Return rank 1 over the level, a row for each task; at most five attacks, alike everywhere."""
    looks = dict(zip(_strongest(run.tasks), LOOKS, strict=False))
    known = picked.schemes(run.summary)
    rows = {task: lines for task in run.tasks if (lines := _lines(task, looks, known))}
    every = rows.values()
    if not rows:
        return None
    known = picked.shown_in(known, *(line.rows for of in every for line in of.values()))
    figure, panels = drawing.panels(
        len(rows), len(known), height_in=1.05 * len(rows) + 1.3, sharex="col", sharey="row"
    )
    for (task, lines), in_row in zip(rows.items(), panels, strict=True):
        is_simulated = task.name in TASKS and TASKS[task.name].simulated
        note = "(simulated)" if is_simulated else _NOTES.get(task.name, "")
        in_row[0].set_ylabel("\n".join(filter(None, [task.name, note, "rank 1 (%)"])))
        ends = PERCENT * _points(lines, known)[picked.ENDS].to_numpy(dtype=float)
        highest = max([float(np.nanmax(ends)), *_alone(lines, RAW), *_alone(lines, CLEAN)])
        limit = next((limit for limit in _LIMITS if highest <= limit), _LIMITS[-1])
        in_row[0].set_ylim(-0.03 * limit, 1.03 * limit)
        if limit < PERCENT:
            ends_at = f"axis ends at {limit:g} %"
            in_row[0].text(0.03, 0.97, ends_at, transform=in_row[0].transAxes, va="top")
        for scheme, ax in zip(known, in_row, strict=True):
            _draw(ax, task, lines, scheme=scheme)
    for scheme, in_column in zip(known, panels.T, strict=True):
        in_column[0].set_title(f"{scheme.title},\n{scheme.rule_text}")
        in_column[-1].set_xlabel(scheme.label)
        drawing.level_axis(in_column[0], log=scheme.log)
        if not scheme.log:
            # Few, lest those of two panels meet.
            in_column[0].xaxis.set_major_locator(MaxNLocator(nbins=4, steps=[1, 5, 10]))
    # Whose walks they are: a simulated task has people of its own.
    of = {dataset_of(f"{task.name}/", dataset=run.dataset): task.name for task in rows}
    name = run.dataset if run.dataset in of else next(iter(of))
    others = ", ".join(f"{task}: {one}" for one, task in of.items() if one != name)
    has_raw, has_ceiling = (any(_alone(of, name) for of in every) for name in (RAW, CLEAN))
    has_silent = not all(_points(of, known)["links"].all() for of in every)
    is_banded = all(line.has_band for of in every for line in of.values())
    named = {source: line for of in every for source, line in of.items()}
    handles = [
        *(named[source].handle for source in looks if source in named),
        has_raw and drawing.black_handle("raw (at its edge)", dashes=":"),
        has_ceiling and drawing.handle("ceiling (no error at all)", _CEILING_LOOK),
        has_silent
        and drawing.black_handle("does not link, or is invalid", marker="o", hollow=True),
        drawing.handle("chance", _CHANCE_LOOK),
        drawing.band_handle("95 % interval" + f" (the {_MOST_BANDS} strongest)" * (not is_banded)),
    ]
    what = "linkage, the strongest attacks of each task by mean rank 1"
    what += f" ({others})" if others and name == run.dataset else ""
    return drawing.finish(figure, handles, dataset=name, what=what)


def _level_words(run: picked.Results) -> str:
    parts = []
    for task in run.tasks:
        source = run.link_of(task)
        rows = picked.rank1_rows(task, source)
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
        sorted(task.attacks, key=lambda source: -_mean(picked.rank1_rows(task, source)))
        for task in tasks
    ]
    turns = (source for turn in zip_longest(*ranked) for source in turn if source is not None)
    return list(dict.fromkeys(turns))[: len(LOOKS)]


def _mean(rows: pd.DataFrame) -> float:
    """Return mean rank 1 over the levels; neither raw nor the ceiling has one."""
    return float(np.nan_to_num(rows.loc[rows["level"].notna(), "value"].mean(), nan=-1.0))


def _lines(
    task: LinkedTask, looks: Mapping[Source, Look], known: Sequence[picked.Scheme]
) -> dict[Source, Line]:
    """Return what is drawn of a task, with its looks."""
    found = {
        of: rows for of in looks if picked.shown_in(known, rows := picked.rank1_rows(task, of))
    }
    # The strongest: the bands of many would hide each other.
    banded = sorted(found, key=lambda source: -_mean(found[source]))[:_MOST_BANDS]
    return {
        of: Line(drawing.short(of), looks[of], rows, has_band=of in banded)
        for of, rows in found.items()
    }


def _points(lines: Mapping[Source, Line], known: Sequence[picked.Scheme]) -> pd.DataFrame:
    """Return the rows of all lines, over the levels that are shown."""
    return pd.concat(scheme.of(line.rows) for line in lines.values() for scheme in known)


def _alone(lines: Mapping[Source, Line], mechanism: str) -> list[float]:
    """Return rank 1 in % at a mechanism without levels."""
    return [one for line in lines.values() for one in line.alone(mechanism)]


def _draw(
    ax: Axes, task: LinkedTask, lines: Mapping[Source, Line], *, scheme: picked.Scheme
) -> None:
    chance = next(cell["chance"] for block in task.cells.values() for cell in block.values())
    ax.axhline(PERCENT * chance, color=_CHANCE_LOOK.colour, linewidth=0.8, zorder=1.5)
    for ceiling in sorted(_alone(lines, CLEAN))[-1:]:
        colour, dashes = _CEILING_LOOK.colour, _CEILING_LOOK.dashes
        ax.axhline(ceiling, color=colour, linestyle=dashes, linewidth=0.8, zorder=1.6)
    for line in lines.values():
        line.draw(ax, scheme)
        found = scheme.of(line.rows)
        silent = found[~found["links"]]
        look: dict[str, Any] = {"color": line.look.colour, "markerfacecolor": "white"}
        look |= {"markeredgewidth": 0.6, "markersize": 4.2, "zorder": 2.7}
        ax.plot(silent["level"], PERCENT * silent["value"], line.look.marker, **look)


def _dissociation_figure(run: picked.Results, *, task: LinkedTask) -> Figure | None:
    """Return rank 1 over each descriptor: a line for what is swept, a marker for each control."""
    source = run.link_of(task)
    points = _beside(run.ours, task, source=source)
    known = picked.schemes(points) if len(points) else []
    under = {rule: [one for one in known if rule in one.rules] for rule in picked.rules_of(known)}
    rules = [rule for rule, of in under.items() if sum(len(one.of(points)) for one in of) > 1]
    if not rules:
        return None
    controls = dict.fromkeys(
        one.family for one in families_in(points).values() if picked.is_control(one)
    )
    marks = (Look(*mark, "") for mark in zip(cycle(_COLOURS), cycle(_MARKERS), strict=False))
    looks = dict(zip(controls, marks, strict=False))
    figure, panels = drawing.panels(
        *(len(rules), len(DESCRIPTORS)),
        height_in=1.75 * len(rules) + 1.0,
        margins_in=(0.45, 0.1, 0.5, 0.85, 0.18, 0.3),
        sharex="col",
        sharey=True,
    )
    for metric, in_column in zip(DESCRIPTORS, panels.T, strict=True):
        # Descriptor x and rank 1 y with their intervals, in the units of the axes.
        scale = METRICS[metric].scale
        axes = {f"x{end}": scale * points[f"{metric}{end}"] for end in ("", "_low", "_high")}
        for name, end in zip(("y", "y_low", "y_high"), picked.ENDS, strict=True):
            axes[name] = PERCENT * points[end]
        shown = points.assign(**axes)
        for rule, ax in zip(rules, in_column, strict=True):
            for scheme in under[rule]:
                rows, look = scheme.of(shown), drawing.look_of(scheme)
                ax.plot(rows["x"], rows["y"], **look.line, zorder=2.5)
                _bars(ax, rows, colour=look.colour)
            _draw_controls(ax, shown, rule=rule, looks=looks)
        in_column[-1].set_xlabel(drawing.label(metric))
        x, ax = shown["x"], in_column[-1]
        if metric == EXPOSURE:
            ax.set_xlim(left=-2.0)
        elif (x > 0).any():
            # Logarithmic seconds that have a zero: who never leaks belongs on the axis.
            threshold, zero = 0.7 * float(x[x > 0].min()), [0.0] * bool((x <= 0).any())
            ax.set_xscale("symlog", linthresh=threshold, linscale=0.3)
            ax.set_xlim(-0.3 * threshold if zero else threshold, 1.5 * float(x.max()))
            drawing.plain_ticks(ax.xaxis, FixedLocator(zero + _SECONDS))
    for rule, in_row in zip(rules, panels, strict=True):
        in_row[0].set(title=f"{rule} adding", ylabel="rank 1 (%)")
    panels[0, 0].set_ylim(-3.0, min(103.0, 1.12 * PERCENT * float(points["ci_high"].max())))
    has_raw = bool((points["mechanism"] == RAW).any())
    handles = [
        *drawing.handles_of(known),
        has_raw and drawing.black_handle("raw", marker="*"),
        *(
            drawing.handle(f"control: {name}", look, markersize=6, **_EDGE)
            for name, look in looks.items()
        ),
        drawing.black_handle("bars: 95 % intervals; number: level", dashes="-"),
    ]
    what = f"{task.name}, {drawing.short(source)}"
    return drawing.finish(figure, handles, dataset=run.dataset, what=what, columns=4)


def _beside(summary: pd.DataFrame, task: LinkedTask, *, source: Source) -> pd.DataFrame:
    """Return the descriptors as shared (with `_low` and `_high`) beside `rank1_rows`."""
    points = picked.rank1_rows(task, source)
    for metric in DESCRIPTORS:
        rows = summary[(summary["consumer"] == SHARED) & (summary["metric"] == metric)]
        names = dict(zip(picked.ENDS, (metric, f"{metric}_low", f"{metric}_high"), strict=True))
        rows = rows[["mechanism", "level", *picked.ENDS]].rename(columns=names)
        points = points.merge(rows, on=["mechanism", "level"])
    about = summary[["mechanism", "family", "adding"]].drop_duplicates("mechanism").fillna("")
    return points.merge(about, on="mechanism")


def _descriptor_words(run: picked.Results, *, task: LinkedTask) -> str:
    source = run.link_of(task)
    points = _beside(run.ours, task, source=source)
    known = families_in(points)
    marked = points["mechanism"].map(lambda name: picked.is_control(known[name]) or name == RAW)
    said = [
        f"{row['mechanism']} {level_text(row['level'])}".rstrip()
        + f": PLR {PERCENT * row['plr']:.0f} %, rank 1 {PERCENT * row['value']:.0f} %"
        for row in points[marked].to_dict("records")
    ]
    lines = points[points["level"].notna() & ~marked]
    return (
        f"Rank 1 of {source.label} over PLR, AEL and MEL as shared. "
        f"{', '.join(picked.by_title(picked.schemes(points)))} are lines from rank 1 of "
        f"{PERCENT * lines['value'].min():.0f} to {PERCENT * lines['value'].max():.0f} %. Did a "
        "descriptor tell linkability by itself, the controls would lie on the lines. "
        f"{'; '.join(said)}."
    )


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
            parts = drawing.number(row["level"]), picked.parameters_text(known[row["mechanism"]])
            text = ", ".join(filter(None, parts))
            # To the side where there is room.
            is_right = row["x"] > _RIGHT * float(shown["x"].max())
            offset, side = ((-4.5, 3.0), "right") if is_right else ((4.5, 3.0), "left")
            where: dict[str, Any] = {"textcoords": "offset points", "ha": side}
            ax.annotate(text, (row["x"], row["y"]), offset, **where, zorder=6)


def _bars(ax: Axes, rows: pd.DataFrame, *, colour: str) -> None:
    """Draw the intervals both ways."""
    low = rows[["x_low", "y", "x", "y_low"]].to_numpy().reshape(-1, 2)
    high = rows[["x_high", "y", "x", "y_high"]].to_numpy().reshape(-1, 2)
    segments = np.stack([low, high], axis=1)
    known = segments[np.isfinite(segments).all(axis=(1, 2))]
    ax.add_collection(LineCollection(known, colors=colour, linewidths=0.5, alpha=0.7, zorder=2))
