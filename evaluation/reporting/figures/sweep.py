"""Missed conflicts, PLR and exposure lengths over the level, a figure for each mechanism."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.analysis.families import FID, FIXED
from evaluation.analysis.keys import is_attack
from evaluation.analysis.metrics import DESCRIPTORS, EXPOSURE, METRICS, MISSED_RATE
from evaluation.analysis.paper import DATASET, PREDICTOR, PUBLISHED
from evaluation.experiment.presets import SHARED
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.drawing import Drawing
from evaluation.reporting.figures.style import LOOKS, Look
from evaluation.reporting.schemes import Scheme, schemes

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evaluation.reporting.run_results import Results

_FILES = {FID: "fid_threshold", FIXED: "fixed_error"}
_EXPOSURE_LABEL = "Exposure, shared (s)"
_MOST_BANDS = 2
_MOST_CHARACTERS = 80
"""Of a file's name."""
# Apart from the looks of the predictors, with which they share a legend.
_LOOKS = {
    EXPOSURE: Look("#000000", "o", "-"),
    "ael": Look("#56B4E9", "v", "-"),
    "mel": Look("#000000", "D", "--"),
}


@dataclass(frozen=True, slots=True)
class _Line:
    """What a line of a panel shows."""

    consumer: str
    metric: str
    look: Look
    has_band: bool = True

    @property
    def label(self) -> str:
        return METRICS[self.metric].head if self.consumer == SHARED else self.consumer

    def of(self, frame: pd.DataFrame) -> pd.DataFrame:
        """Return its rows in the units of the axes."""
        rows = frame[
            (frame["consumer"] == self.consumer)
            & (frame["metric"] == self.metric)
            & np.isfinite(frame["value"])
        ]
        numbers = rows[["value", "ci_low", "ci_high"]] * METRICS[self.metric].scale
        found: pd.DataFrame = rows[["mechanism", "level"]].join(numbers)
        return found


def drawings(run: Results) -> list[Drawing]:
    """Return a figure for each mechanism that is swept."""
    return [
        Drawing(
            name=name,
            section="figures",
            title=f"Missed conflicts, PLR and exposure over the level: {scheme.title}",
            draw=partial(sweep_figure, run.ours, scheme=scheme, dataset=run.dataset),
            words=partial(_words, run.ours, scheme=scheme),
        )
        for name, scheme in _named(schemes(run.ours)).items()
    ]


def _named(known: Sequence[Scheme]) -> dict[str, Scheme]:
    """Return the mechanisms under plain names of files, each another."""
    found: dict[str, Scheme] = {}
    for one in known:
        plain = f"sweep-{re.sub(r'[^A-Za-z0-9=.-]+', '_', one.name)[:_MOST_CHARACTERS]}"
        name = _FILES.get(one.name, plain)
        found[f"{name}-{one.place}" if name in found else name] = one
    return found


def sweep_figure(summary: pd.DataFrame, *, scheme: Scheme, dataset: str) -> Figure | None:
    """Return missed conflicts, PLR and exposure lengths over the level; None without levels.

    One column for each adding rule, one row for each quantity. Of more than five predictors the
    first five are drawn.
    """
    ours = summary[~is_attack(summary)]
    predictors = _predictors(ours)[: len(LOOKS)]
    series = {
        (rule, line): found
        for rule in scheme.rules
        for lines in _rows(predictors).values()
        for line in lines
        if not (found := scheme.of(line.of(ours), rule)).empty
    }
    if not series:
        return None
    columns = [rule for rule in scheme.rules if any(key[0] == rule for key in series)]
    known = {line for _, line in series}
    rows = {
        label: drawn
        for label, lines in _rows(predictors).items()
        if (drawn := [line for line in lines if line in known])
    }
    raws = {
        line: float(raw["value"].iloc[0])
        for line in known
        if len(raw := line.of(ours[ours["mechanism"] == "raw"]))
    }
    has_paper = dataset == DATASET and scheme.name in _FILES and "linear" in columns
    figure = figure_style.empty_figure(
        width_in=figure_style.SINGLE_COLUMN_IN
        if len(columns) == 1
        else figure_style.DOUBLE_COLUMN_IN,
        height_in=1.35 * len(rows) + 0.9,
    )
    panels = figure.subplots(len(rows), len(columns), sharex=True, sharey="row", squeeze=False)
    for rule, axes in zip(columns, panels.T, strict=True):
        axes[0].set_title(scheme.rule_text(rule))
        axes[-1].set_xlabel(scheme.label)
        for lines, ax in zip(rows.values(), axes, strict=True):
            for line in lines:
                if (rule, line) in series:
                    _draw(ax, series[rule, line], line=line)
                if line in raws:
                    # Above the axis itself, where the value is zero.
                    ax.axhline(raws[line], color=line.look.colour, linestyle=":", zorder=2.6)
                if has_paper and rule == "linear":
                    _draw_paper(ax, line=line, scheme=scheme)
    figure_style.level_axis(panels[0, 0], log=scheme.log)
    for (label, lines), ax in zip(rows.items(), panels[:, 0], strict=True):
        ax.set_ylabel(label)
        values = [found["value"].to_numpy() for (_, line), found in series.items() if line in lines]
        values += [np.array([raws[line]]) for line in lines if line in raws]
        figure_style.value_axis(ax, values, log=label == _EXPOSURE_LABEL)
    lines = [line for of in rows.values() for line in of]
    _legend(figure, lines=lines, has_raw=bool(raws), has_paper=has_paper)
    only = f", predictor {predictors[0]}" if len(predictors) == 1 else ""
    figure_style.title(figure, dataset=dataset, what=f"{scheme.title}{only}")
    return figure


def _words(summary: pd.DataFrame, *, scheme: Scheme) -> str:
    of = summary[~is_attack(summary)]
    first = of.loc[of["metric"] == MISSED_RATE, "consumer"].head(1)
    parts = []
    for rule in scheme.rules:
        said = []
        for metric in (MISSED_RATE, *DESCRIPTORS):
            rows = of[of["metric"] == metric]
            is_rate = metric == MISSED_RATE
            consumer = next(iter(first), "") if is_rate else SHARED
            name = f"missed conflicts of {consumer}" if is_rate else METRICS[metric].head
            ends = scheme.ends(rows[rows["consumer"] == consumer], rule, metric)
            said += [f"{name} from {ends}"] if ends else []
        parts += [f"{scheme.rule_text(rule)}: {'; '.join(said)}."] if said else []
    return f"Panels over the level, with 95 % bands. {' '.join(parts)}"


def _rows(predictors: list[str]) -> dict[str, list[_Line]]:
    """Return the lines of the panels under the label of their axis."""
    # The bands of many predictors would hide each other.
    n_bands = len(predictors) if len(predictors) <= _MOST_BANDS else 1
    return {
        figure_style.label(MISSED_RATE): [
            _Line(name, MISSED_RATE, LOOKS[n], has_band=n < n_bands)
            for n, name in enumerate(predictors)
        ],
        figure_style.label(EXPOSURE): [_Line(SHARED, EXPOSURE, _LOOKS[EXPOSURE])],
        _EXPOSURE_LABEL: [_Line(SHARED, metric, _LOOKS[metric]) for metric in ("ael", "mel")],
    }


def _predictors(summary: pd.DataFrame) -> list[str]:
    rows = summary[(summary["metric"] == MISSED_RATE) & summary["value"].notna()]
    return [str(name) for name in rows["consumer"].unique()]


def _draw(ax: Axes, found: pd.DataFrame, *, line: _Line) -> None:
    look = line.look
    level, value, low, high = (found[k].to_numpy() for k in ("level", "value", "ci_low", "ci_high"))
    ax.plot(level, value, color=look.colour, marker=look.marker, linestyle=look.dashes)
    if line.has_band:
        figure_style.band(ax, x=level, low=low, high=high, look=look)


def _draw_paper(ax: Axes, *, line: _Line, scheme: Scheme) -> None:
    """Mark the paper's numbers; raw, which has no level, goes to the edge next to it."""
    if line.consumer not in (SHARED, PREDICTOR):
        return
    for mechanism, level, metric, value in PUBLISHED:
        if metric == line.metric and mechanism in ("raw", scheme.name):
            edge = 1.0 if scheme.log else 0.0
            ax.plot(
                [edge if level is None else level],
                [value * METRICS[metric].scale],
                transform=ax.get_yaxis_transform() if level is None else ax.transData,
                marker=line.look.marker,
                markersize=5,
                markerfacecolor="white",
                markeredgecolor="black",
                clip_on=False,
                zorder=5,
            )


def _legend(figure: Figure, *, lines: list[_Line], has_raw: bool, has_paper: bool) -> None:
    predictors = [line for line in lines if line.metric == MISSED_RATE]
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
