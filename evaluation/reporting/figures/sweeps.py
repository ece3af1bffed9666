"""What the figures show: sweeps over the level, and the privacy-utility plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.analysis.levels import is_attack
from evaluation.analysis.matching import ADDING_SUFFIX, MISSED
from evaluation.analysis.metrics import DESCRIPTORS
from evaluation.analysis.paper import DATASET, PREDICTOR, PUBLISHED
from evaluation.experiment.presets import SHARED
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.style import LOOKS, Look, band, number

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RATE = "missed_conflict_rate"
LABELS = {
    RATE: "Missed conflicts (%)",
    "plr": "PLR, shared (%)",
    "ael": "AEL, shared (s)",
    "mel": "MEL, shared (s)",
}
EXPOSURE_LABEL = "Exposure, shared (s)"
_SCALE = {RATE: 100.0, "plr": 100.0, "ael": 1.0, "mel": 1.0}
_MOST_BANDS = 2
# Apart from the looks of the predictors, with which they share a legend.
_PLR_LOOK = Look("#000000", "o", "-")
_AEL_LOOK = Look("#56B4E9", "v", "-")
_MEL_LOOK = Look("#000000", "D", "--")


@dataclass(frozen=True, slots=True)
class Scheme:
    """A way of adding error, and the axis of its level."""

    name: str
    title: str
    label: str
    log: bool


FID = Scheme("fid", "FID-controlled sharing", "FID threshold η (1/(m² s))", log=True)
FIXED = Scheme("fixed", "fixed added error", "Added error Δσ (m)", log=False)

_SCHEMES = {FID: LOOKS[0], FIXED: LOOKS[1]}


@dataclass(frozen=True, slots=True)
class Line:
    """What a line of a panel shows."""

    label: str
    consumer: str
    metric: str
    look: Look
    has_band: bool = True


def sweep_figure(summary: pd.DataFrame, *, scheme: Scheme, dataset: str) -> Figure | None:
    """Return missed conflicts, PLR and exposure lengths over the level; None without levels.

    One column for each adding rule, one row for each quantity. Of more than five predictors the
    first five are drawn.
    """
    ours = _without_attacks(summary, dataset)
    predictors = _predictors(ours)[: len(LOOKS)]
    series = {
        (adding, line): found
        for adding, suffix in ADDING_SUFFIX.items()
        for lines in _rows(predictors).values()
        for line in lines
        if not (found := _series(ours, f"{scheme.name}{suffix}", line, log=scheme.log)).empty
    }
    if not series:
        return None
    columns = [adding for adding in ADDING_SUFFIX if any(key[0] == adding for key in series)]
    known = {line for _, line in series}
    rows = {
        label: drawn
        for label, lines in _rows(predictors).items()
        if (drawn := [line for line in lines if line in known])
    }
    figure = figure_style.empty_figure(
        width_in=figure_style.SINGLE_COLUMN_IN
        if len(columns) == 1
        else figure_style.DOUBLE_COLUMN_IN,
        height_in=1.35 * len(rows) + 0.9,
    )
    panels = figure.subplots(len(rows), len(columns), sharex=True, sharey="row", squeeze=False)
    for adding, axes in zip(columns, panels.T, strict=True):
        axes[0].set_title(f"{adding} adding")
        axes[-1].set_xlabel(scheme.label)
        for lines, ax in zip(rows.values(), axes, strict=True):
            for line in lines:
                if (adding, line) in series:
                    _draw_series(ax, series[adding, line], line=line)
                _draw_raw(ax, _raw(ours, line), line=line)
                if dataset == DATASET and adding == "linear":
                    _draw_paper(ax, line=line, scheme=scheme)
    figure_style.level_axis(panels[0, 0], log=scheme.log)
    for (label, lines), ax in zip(rows.items(), panels[:, 0], strict=True):
        ax.set_ylabel(label)
        values = [found["value"].to_numpy() for (_, line), found in series.items() if line in lines]
        raws = [np.array([raw]) for line in lines if (raw := _raw(ours, line)) is not None]
        figure_style.value_axis(ax, values + raws, log=label == EXPOSURE_LABEL)
    _sweep_legend(
        figure,
        lines=[line for lines in rows.values() for line in lines],
        has_raw=any(_raw(ours, line) is not None for line in known),
        has_paper=dataset == DATASET and "linear" in columns,
    )
    figure_style.title(figure, dataset=dataset, what=_what(scheme.title, predictors))
    return figure


def operating_figure(
    summary: pd.DataFrame, matched: pd.DataFrame, *, dataset: str
) -> Figure | None:
    """Return the privacy-utility plane of the first predictor; None if it has no points.

    One row for each adding rule, one column for each descriptor. Markers are measured; the
    curves are those that `matching` compares.
    """
    ours = _without_attacks(summary, dataset)
    predictors = _predictors(ours)[:1]
    points = {
        (adding, metric, scheme): found
        for predictor in predictors
        for adding, suffix in ADDING_SUFFIX.items()
        for metric in DESCRIPTORS
        for scheme in _SCHEMES
        if not (found := _points(ours, f"{scheme.name}{suffix}", predictor, metric)).empty
    }
    if not points:
        return None
    addings = [adding for adding in ADDING_SUFFIX if any(key[0] == adding for key in points)]
    raw = {metric: _points(ours, "raw", predictors[0], metric) for metric in DESCRIPTORS}
    curves = _of(matched, dataset)
    curves = curves[
        (curves["predictor"] == predictors[0])
        & (curves["criterion"] == MISSED)
        & (curves["consumer"] == SHARED)
    ]

    figure = figure_style.empty_figure(
        width_in=figure_style.DOUBLE_COLUMN_IN, height_in=1.75 * len(addings) + 0.8
    )
    panels = figure.subplots(
        len(addings), len(DESCRIPTORS), sharex=True, sharey="col", squeeze=False
    )
    for adding, axes in zip(addings, panels, strict=True):
        axes[0].set_title(f"{adding} adding")
        for metric, ax in zip(DESCRIPTORS, axes, strict=True):
            ax.set_ylabel(LABELS[metric])
            part = curves[(curves["adding"] == adding) & (curves["metric"] == metric)]
            for scheme, look in _SCHEMES.items():
                _draw_matched(ax, part, scheme=scheme, look=look)
                measured = points.get((adding, metric, scheme))
                if measured is not None:
                    _draw_points(ax, measured, scheme=scheme, look=look, named=metric == "plr")
            ax.plot(raw[metric]["x"], raw[metric]["y"], "*", color="black", markersize=6, zorder=4)
    for metric, axes in zip(DESCRIPTORS, panels.T, strict=True):
        axes[-1].set_xlabel(LABELS[RATE])
        values = [found["y"].to_numpy() for key, found in points.items() if key[1] == metric]
        if values:
            figure_style.value_axis(
                axes[0], [*values, raw[metric]["y"].to_numpy()], log=metric != "plr"
            )
    _plane_legend(
        figure,
        schemes=[scheme for scheme in _SCHEMES if any(key[2] == scheme for key in points)],
        has_raw=any(not found.empty for found in raw.values()),
        has_curve=not curves.empty,
    )
    figure_style.title(figure, dataset=dataset, what=_what("operating points", predictors))
    return figure


def _rows(predictors: list[str]) -> dict[str, list[Line]]:
    """Return the lines of a sweep's panels under the label of their axis."""
    # The bands of many predictors would hide each other.
    n_bands = len(predictors) if len(predictors) <= _MOST_BANDS else 1
    return {
        LABELS[RATE]: [
            Line(name, name, RATE, LOOKS[n], has_band=n < n_bands)
            for n, name in enumerate(predictors)
        ],
        LABELS["plr"]: [Line("PLR", SHARED, "plr", _PLR_LOOK)],
        EXPOSURE_LABEL: [
            Line("AEL", SHARED, "ael", _AEL_LOOK),
            Line("MEL", SHARED, "mel", _MEL_LOOK),
        ],
    }


def _of(frame: pd.DataFrame, dataset: str) -> pd.DataFrame:
    return frame.loc[frame["dataset"] == dataset]


def _without_attacks(summary: pd.DataFrame, dataset: str) -> pd.DataFrame:
    ours = _of(summary, dataset)
    return ours.loc[~is_attack(ours)]


def _what(text: str, predictors: list[str]) -> str:
    return f"{text}, predictor {predictors[0]}" if len(predictors) == 1 else text


def _predictors(summary: pd.DataFrame) -> list[str]:
    rows = summary[(summary["metric"] == RATE) & summary["value"].notna()]
    return [str(name) for name in rows["consumer"].unique()]


def _series(summary: pd.DataFrame, mechanism: str, line: Line, *, log: bool) -> pd.DataFrame:
    """Return level, value and interval in the units of the axes, by rising level."""
    rows = summary.loc[
        (summary["mechanism"] == mechanism)
        & (summary["consumer"] == line.consumer)
        & (summary["metric"] == line.metric)
        & (summary["level"] > 0 if log else summary["level"].notna())
        & np.isfinite(summary["value"])
    ].sort_values("level")
    found: pd.DataFrame = rows[["level"]].join(
        rows[["value", "ci_low", "ci_high"]] * _SCALE[line.metric]
    )
    return found


def _raw(summary: pd.DataFrame, line: Line) -> float | None:
    rows = summary.loc[
        (summary["mechanism"] == "raw")
        & (summary["consumer"] == line.consumer)
        & (summary["metric"] == line.metric)
        & np.isfinite(summary["value"]),
        "value",
    ]
    return None if rows.empty else float(rows.iloc[0]) * _SCALE[line.metric]


def _points(summary: pd.DataFrame, mechanism: str, predictor: str, metric: str) -> pd.DataFrame:
    """Return level, missed-conflict rate x and descriptor y, in the units of the axes."""
    rows = summary[(summary["mechanism"] == mechanism) & np.isfinite(summary["value"])]
    if mechanism != "raw":
        rows = rows[rows["level"].notna()]
    x = rows[(rows["consumer"] == predictor) & (rows["metric"] == RATE)]
    y = rows[(rows["consumer"] == SHARED) & (rows["metric"] == metric)]
    x, y = x[["level", "value"]], y[["level", "value"]]
    both = x.merge(y, on="level", suffixes=("_x", "_y")).sort_values("level")
    found: pd.DataFrame = both.assign(
        x=both["value_x"] * _SCALE[RATE], y=both["value_y"] * _SCALE[metric]
    )
    return found


def _draw_series(ax: Axes, found: pd.DataFrame, *, line: Line) -> None:
    look = line.look
    ax.plot(
        found["level"],
        found["value"],
        color=look.colour,
        marker=look.marker,
        linestyle=look.dashes,
    )
    if line.has_band:
        level, low, high = (found[key].to_numpy() for key in ("level", "ci_low", "ci_high"))
        band(ax, x=level, low=low, high=high, look=look)


def _draw_raw(ax: Axes, value: float | None, *, line: Line) -> None:
    if value is not None:
        # Above the axis itself, where the value is zero.
        ax.axhline(value, color=line.look.colour, linestyle=":", zorder=2.6)


def _draw_paper(ax: Axes, *, line: Line, scheme: Scheme) -> None:
    """Mark the paper's numbers; raw, which has no level, goes to the edge next to it."""
    if line.consumer not in (SHARED, PREDICTOR):
        return
    for mechanism, level, metric, value in PUBLISHED:
        if metric == line.metric and mechanism in ("raw", scheme.name):
            edge = 1.0 if scheme.log else 0.0
            ax.plot(
                [edge if level is None else level],
                [value * _SCALE[metric]],
                transform=ax.get_yaxis_transform() if level is None else ax.transData,
                marker=line.look.marker,
                markersize=5,
                markerfacecolor="white",
                markeredgecolor="black",
                clip_on=False,
                zorder=5,
            )


def _draw_matched(ax: Axes, part: pd.DataFrame, *, scheme: Scheme, look: Look) -> None:
    for metric, rows in part.sort_values(RATE).groupby("metric"):
        scale = _SCALE[str(metric)]
        x = rows[RATE].to_numpy() * _SCALE[RATE]
        ax.plot(x, rows[scheme.name] * scale, color=look.colour, linestyle=look.dashes)
        low, high = (rows[f"{scheme.name}_{end}"].to_numpy() * scale for end in ("low", "high"))
        band(ax, x=x, low=low, high=high, look=look)


def _draw_points(ax: Axes, found: pd.DataFrame, *, scheme: Scheme, look: Look, named: bool) -> None:
    """Mark the measured points; the level with the most error gives the curve a direction."""
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
        noisiest = found.iloc[0 if scheme.log else -1]
        level = number(float(noisiest["level"]))
        ax.annotate(
            f"η = {level}" if scheme.log else f"{level} m",
            (noisiest["x"], noisiest["y"]),
            xytext=(0, -9 if scheme.log else 5),
            textcoords="offset points",
            horizontalalignment="center",
            color=look.colour,
        )


def _sweep_legend(figure: Figure, *, lines: list[Line], has_raw: bool, has_paper: bool) -> None:
    predictors = [line for line in lines if line.metric == RATE]
    # An only predictor is in the title, and PLR has its own axis.
    named = (predictors if len(predictors) > 1 else []) + [
        line for line in lines if line.metric in ("ael", "mel")
    ]
    handles: list[Any] = [figure_style.line_handle(line.label, line.look) for line in named]
    if has_raw:
        handles.append(figure_style.black_handle("raw", dashes=":"))
    only = "" if all(line.has_band for line in lines) else f" (predictors: {lines[0].label})"
    handles.append(figure_style.band_handle(f"95 % interval{only}"))
    if has_paper:
        handles.append(
            figure_style.black_handle("paper (raw at the edge)", marker="o", hollow=True)
        )
    figure_style.legend(figure, handles)


def _plane_legend(figure: Figure, *, schemes: list[Scheme], has_raw: bool, has_curve: bool) -> None:
    handles: list[Any] = [figure_style.line_handle(s.title, _SCHEMES[s]) for s in schemes]
    if has_raw:
        handles.append(figure_style.black_handle("raw", marker="*"))
    if has_curve:
        handles.append(figure_style.band_handle("95 % interval at matched rates"))
    figure_style.legend(figure, handles)
