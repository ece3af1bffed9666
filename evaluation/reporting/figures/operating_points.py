"""The privacy-utility plane: what is shared over what it costs a robot."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.analysis.families import FID, FIXED
from evaluation.analysis.keys import is_attack
from evaluation.analysis.matching import MISSED
from evaluation.analysis.metrics import DESCRIPTORS, EXPOSURE, METRICS, MISSED_RATE
from evaluation.experiment.presets import SHARED
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.drawing import Drawing
from evaluation.reporting.schemes import Scheme, rules_of, schemes

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evaluation.reporting.run_results import Results


def drawings(run: Results) -> list[Drawing]:
    """Return the plane of the first predictor."""
    return [
        Drawing(
            name="operating_points",
            section="plane",
            title="Operating points: each descriptor as shared against missed conflicts",
            caption="Down and to the left is better.",
            draw=partial(operating_figure, run.ours, run.matched, dataset=run.dataset),
            words=partial(_words, run.ours),
        )
    ]


def operating_figure(
    summary: pd.DataFrame, matched: pd.DataFrame, *, dataset: str
) -> Figure | None:
    """Return the privacy-utility plane of the first predictor; None if it has no points.

    One row for each adding rule, one column for each descriptor. Markers are measured; the
    curves are those that `matching` compares.
    """
    ours = summary[~is_attack(summary) & np.isfinite(summary["value"])]
    rates = ours[ours["metric"] == MISSED_RATE]
    known = schemes(ours)
    if rates.empty or not known:
        return None
    predictor = str(rates["consumer"].iloc[0])
    planes = {metric: _plane(ours, predictor, metric) for metric in DESCRIPTORS}
    points = {
        (rule, metric, scheme): found
        for rule in rules_of(known)
        for metric in DESCRIPTORS
        for scheme in known
        if not (found := scheme.of(planes[metric], rule)).empty
    }
    if not points:
        return None
    rules = [rule for rule in rules_of(known) if any(key[0] == rule for key in points)]
    raws = {metric: plane[plane["mechanism"] == "raw"] for metric, plane in planes.items()}
    curves = matched[
        (matched["dataset"] == dataset)
        & (matched["predictor"] == predictor)
        & (matched["criterion"] == MISSED)
        & (matched["consumer"] == SHARED)
    ]
    figure = figure_style.empty_figure(
        width_in=figure_style.DOUBLE_COLUMN_IN, height_in=1.75 * len(rules) + 0.8
    )
    panels = figure.subplots(len(rules), len(DESCRIPTORS), sharex=True, sharey="col", squeeze=False)
    for rule, axes in zip(rules, panels, strict=True):
        axes[0].set_title(f"{rule} adding")
        for metric, ax in zip(DESCRIPTORS, axes, strict=True):
            ax.set_ylabel(figure_style.label(metric))
            part = curves[(curves["adding"] == rule) & (curves["metric"] == metric)]
            for scheme in known:
                _draw_matched(ax, part, scheme=scheme, rule=rule, metric=metric)
                measured = points.get((rule, metric, scheme))
                if measured is not None:
                    _draw_points(ax, measured, scheme=scheme, named=metric == EXPOSURE)
            ax.plot(
                raws[metric]["x"], raws[metric]["y"], "*", color="black", markersize=6, zorder=4
            )
    for metric, axes in zip(DESCRIPTORS, panels.T, strict=True):
        axes[-1].set_xlabel(figure_style.label(MISSED_RATE))
        values = [found["y"].to_numpy() for key, found in points.items() if key[1] == metric]
        if values:
            values.append(raws[metric]["y"].to_numpy())
            figure_style.value_axis(axes[0], values, log=metric != EXPOSURE)
    drawn = [scheme for scheme in known if any(key[2] is scheme for key in points)]
    has_raw = any(not raw.empty for raw in raws.values())
    _legend(figure, drawn, has_raw=has_raw, has_curve=not curves.empty)
    what = f"operating points, predictor {predictor}"
    figure_style.title(figure, dataset=dataset, what=what)
    return figure


def _words(summary: pd.DataFrame) -> str:
    raw = summary[(summary["mechanism"] == "raw") & ~is_attack(summary)]
    said = [
        f"{METRICS[metric].head} {METRICS[metric].scale * value:.{METRICS[metric].digits}f} "
        f"{METRICS[metric].unit}"
        for metric in (MISSED_RATE, *DESCRIPTORS)
        for value in raw.loc[raw["metric"] == metric, "value"].head(1)
    ]
    return (
        "PLR, AEL and MEL over the missed-conflict rate, a curve for each of "
        f"{', '.join(scheme.title for scheme in schemes(summary))}, all ending at raw "
        f"({', '.join(said)}). Lower and further left is better. "
        "The table of matched points has the differences."
    )


def _plane(summary: pd.DataFrame, predictor: str, metric: str) -> pd.DataFrame:
    """Return missed-conflict rate x and descriptor y of every level, in the units of the axes."""
    x = summary[(summary["consumer"] == predictor) & (summary["metric"] == MISSED_RATE)]
    y = summary[(summary["consumer"] == SHARED) & (summary["metric"] == metric)]
    keys = ["mechanism", "level"]
    both = x[[*keys, "value"]].merge(y[[*keys, "value"]], on=keys, suffixes=("_x", "_y"))
    found: pd.DataFrame = both.assign(
        x=both["value_x"] * METRICS[MISSED_RATE].scale, y=both["value_y"] * METRICS[metric].scale
    )
    return found


def _draw_matched(ax: Axes, part: pd.DataFrame, *, scheme: Scheme, rule: str, metric: str) -> None:
    """Draw the curve of a mechanism, or of the fixed noise that it is held against."""
    is_fixed = scheme.name == FIXED
    mechanism = next(iter(part["mechanism"]), "") if is_fixed else scheme.mechanisms.get(rule)
    rows = part[part["mechanism"] == mechanism].sort_values(MISSED_RATE)
    if rows.empty:
        return
    look, scale = figure_style.look_of(scheme), METRICS[metric].scale
    column = FIXED if is_fixed else FID
    x = rows[MISSED_RATE].to_numpy() * METRICS[MISSED_RATE].scale
    ax.plot(x, rows[column] * scale, color=look.colour, linestyle=look.dashes)
    low, high = (rows[f"{column}_{end}"].to_numpy() * scale for end in ("low", "high"))
    figure_style.band(ax, x=x, low=low, high=high, look=look)


def _draw_points(ax: Axes, found: pd.DataFrame, *, scheme: Scheme, named: bool) -> None:
    """Mark the measured points; the level that costs most gives the curve a direction."""
    look = figure_style.look_of(scheme)
    ax.plot(
        found["x"],
        found["y"],
        look.marker,
        color=look.colour,
        markersize=4.2,
        markeredgecolor="white",
        markeredgewidth=0.4,
    )
    if named:
        noisiest = found.sort_values("x", kind="stable").iloc[-1]
        ax.annotate(
            scheme.at(float(noisiest["level"])),
            (noisiest["x"], noisiest["y"]),
            xytext=(0, -9 if scheme.log else 5),
            textcoords="offset points",
            horizontalalignment="center",
            color=look.colour,
        )


def _legend(figure: Figure, drawn: list[Scheme], *, has_raw: bool, has_curve: bool) -> None:
    handles: list[Any] = [
        figure_style.line_handle(scheme.title, figure_style.look_of(scheme)) for scheme in drawn
    ]
    if has_raw:
        handles.append(figure_style.black_handle("raw", marker="*"))
    if has_curve:
        handles.append(figure_style.band_handle("95 % interval at matched rates"))
    figure_style.legend(figure, handles)
