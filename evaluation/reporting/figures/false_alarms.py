"""Misses over false alarms of every predictor, where all mechanisms cost alike."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.analysis.keys import is_attack, level_text
from evaluation.analysis.metrics import MISSED_RATE
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.drawing import Drawing
from evaluation.reporting.figures.style import LOOKS, Look
from evaluation.reporting.schemes import compared_levels, schemes

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evaluation.analysis.keys import Where
    from evaluation.reporting.figures.style import Dashes
    from evaluation.reporting.run_results import Results

_PERCENT = 100.0
_FALSE_ALARMS = "false_alarm_rate"
_DASHES: dict[str, Dashes] = {"separation": "-", "probability": (0, (3, 1.5))}


def drawings(run: Results) -> list[Drawing]:
    """Return the figure of all predictors."""
    return [
        Drawing(
            name="false_alarms",
            section="alarms",
            title="Missed conflicts against false alarms",
            draw=partial(curves_figure, run.curves, run.ours, dataset=run.dataset),
            words=partial(_words, run.ours),
        )
    ]


def curves_figure(curves: pd.DataFrame, summary: pd.DataFrame, *, dataset: str) -> Figure | None:
    """Return misses against false alarms of every predictor, at levels that cost alike.

    A marker is where a robot stands that decides as the paper's. None without curves.
    """
    of = curves[curves["dataset"] == dataset]
    wheres = [where for where in compared_levels(summary) if not _at(of, where).empty]
    if not wheres:
        return None
    predictors = list(of["consumer"].unique())[: len(LOOKS)]
    columns = min(3, len(wheres))
    n_rows = -(-len(wheres) // columns)
    figure = figure_style.placed_figure(
        width_in=figure_style.DOUBLE_COLUMN_IN, height_in=1.85 * n_rows + 0.95
    )
    panels = figure_style.placed(
        figure, rows=n_rows, columns=columns, left_in=0.45, right_in=0.1, top_in=0.5,
        bottom_in=0.75, gap_in=0.18, between_in=0.28, sharex=True, sharey=True,
    )  # fmt: skip
    for where, ax in zip(wheres, panels.flat, strict=False):
        ax.set_title(_title(where, summary))
        for name, look in zip(predictors, LOOKS, strict=False):
            rows = _at(of, where)
            rows = rows[rows["consumer"] == name]
            for score, part in rows.groupby("score", sort=False):
                ax.plot(
                    _PERCENT * part[_FALSE_ALARMS],
                    _PERCENT * part[MISSED_RATE],
                    color=look.colour,
                    linestyle=_DASHES[str(score)],
                    linewidth=0.9,
                )
            _mark_operating(ax, summary, where, predictor=name, look=look)
    for ax in panels.flat[len(wheres) :]:
        ax.set_axis_off()
    for ax in panels[:, 0]:
        ax.set_ylabel("Missed conflicts (%)")
    for ax in panels.flat[max(0, len(wheres) - columns) : len(wheres)]:
        ax.set_xlabel("False alarms (%)")
        ax.tick_params(labelbottom=True)
    panels[0, 0].set_xlim(-2.0, 102.0)
    panels[0, 0].set_ylim(-2.0, 102.0)
    handles: list[Any] = [
        figure_style.line_handle(name, Look(look.colour, look.marker, "-"))
        for name, look in zip(predictors, LOOKS, strict=False)
    ]
    handles += [
        figure_style.black_handle("by predicted separation", dashes=_DASHES["separation"]),
        figure_style.black_handle("by conflict probability", dashes=_DASHES["probability"]),
        figure_style.black_handle("as the paper's robot decides", marker="o", hollow=True),
    ]
    figure_style.legend_in_rows(figure, handles, columns=4)
    figure_style.title(figure, dataset=dataset, what="misses against false alarms", one_line=True)
    return figure


def _words(summary: pd.DataFrame) -> str:
    parts = []
    for where in compared_levels(summary):
        rows = _at(summary[~is_attack(summary)], where)
        said = []
        for consumer in rows.loc[rows["metric"] == MISSED_RATE, "consumer"].unique():
            value = rows[rows["consumer"] == consumer].set_index("metric")["value"]
            said.append(
                f"{consumer} misses {_PERCENT * value[MISSED_RATE]:.0f} % at "
                f"{_PERCENT * value.get(_FALSE_ALARMS, np.nan):.0f} % false alarms"
            )
        parts.append(f"{where[0]} {level_text(where[1])}".strip() + f": {', '.join(said)}.")
    return f"Curves of misses over false alarms, closer to the corner is better. {' '.join(parts)}"


def _at(frame: pd.DataFrame, where: Where) -> pd.DataFrame:
    mechanism, level = where
    at = frame["level"].isna() if level is None else np.isclose(frame["level"], level)
    return frame[(frame["mechanism"] == mechanism) & at]


def _title(where: Where, summary: pd.DataFrame) -> str:
    mechanism, level = where
    for scheme in schemes(summary):
        for rule in scheme.rules:
            if scheme.mechanisms[rule] == mechanism and level is not None:
                return f"{scheme.name}, {scheme.at(level)}, {scheme.rule_text(rule)}"
    return mechanism


def _mark_operating(
    ax: Axes, summary: pd.DataFrame, where: Where, *, predictor: str, look: Look
) -> None:
    rows = _at(summary[summary["consumer"] == predictor], where)
    value = rows.drop_duplicates("metric").set_index("metric")["value"]
    if {_FALSE_ALARMS, MISSED_RATE} <= set(value.index):
        ax.plot(
            [_PERCENT * float(value[_FALSE_ALARMS])],
            [_PERCENT * float(value[MISSED_RATE])],
            look.marker,
            color=look.colour,
            markerfacecolor="white",
            markersize=4.5,
            zorder=3,
        )
