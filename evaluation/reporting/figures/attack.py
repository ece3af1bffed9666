"""PLR as shared and after each attack, over the level: the figure of what filtering brings back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.analysis.keys import AS_SHARED, ORACLE, Source
from evaluation.analysis.levels import is_attack, most_knowing
from evaluation.analysis.matching import ADDING_SUFFIX
from evaluation.experiment.presets import IDENTITY
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.style import LOOKS, Look
from evaluation.reporting.figures.sweeps import FID, FIXED

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evaluation.reporting.figures.sweeps import Scheme

LABEL = "PLR, shared or attacked (%)"
_METRIC = "plr"
_PERCENT = 100.0
_SHARED_LOOK = Look("#000000", "o", "-")
# The oracle is set apart: grey, thin and hollow.
_ORACLE_LOOKS = (
    Look("#777777", "D", (0, (2, 1.5))),
    Look("#999999", "v", (0, (4, 1.5))),
)


@dataclass(frozen=True, slots=True)
class _Line:
    source: Source
    look: Look

    @property
    def is_oracle(self) -> bool:
        return self.source.knowledge == ORACLE

    @property
    def label(self) -> str:
        if self.source == AS_SHARED:
            return "as shared"
        return f"{self.source.label}, a reference" if self.is_oracle else self.source.label


def attack_figure(summary: pd.DataFrame, *, dataset: str) -> Figure | None:
    """Return PLR over the level, as shared and after each attack; None without attacks or levels.

    One column for each adding rule, one row for each way of adding error. Of each attack the
    adversary is drawn that knows most short of the oracle; an attack that only the oracle can
    run is drawn as a reference. The control, which repeats what was shared, is left out, and so
    is what lies beyond the looks that there are.
    """
    ours = summary.loc[
        (summary["dataset"] == dataset)
        & (summary["metric"] == _METRIC)
        & (is_attack(summary) | (summary["consumer"] == AS_SHARED.consumer))
        & np.isfinite(summary["value"])
    ]
    ours = ours.assign(knowledge=ours["knowledge"].where(is_attack(ours), ""))
    lines = _lines(ours)
    series = {
        (scheme, adding, line): found
        for scheme in (FID, FIXED)
        for adding, suffix in ADDING_SUFFIX.items()
        for line in lines
        if not (found := _series(ours, f"{scheme.name}{suffix}", line, log=scheme.log)).empty
    }
    drawn = [line for line in lines if any(key[2] == line for key in series)]
    if not any(line.source != AS_SHARED for line in drawn):
        return None
    schemes = [scheme for scheme in (FID, FIXED) if any(key[0] == scheme for key in series)]
    columns = [adding for adding in ADDING_SUFFIX if any(key[1] == adding for key in series)]
    figure = figure_style.empty_figure(
        width_in=figure_style.SINGLE_COLUMN_IN
        if len(columns) == 1
        else figure_style.DOUBLE_COLUMN_IN,
        height_in=2.0 * len(schemes) + 0.9,
    )
    panels = figure.subplots(len(schemes), len(columns), sharex="row", sharey=True, squeeze=False)
    raws = {line: raw for line in drawn if (raw := _raw(ours, line)) is not None}
    for scheme, axes in zip(schemes, panels, strict=True):
        for adding, ax in zip(columns, axes, strict=True):
            ax.set_title(f"{scheme.title}, {adding} adding")
            ax.set_xlabel(scheme.label)
            for line in drawn:
                if (scheme, adding, line) in series:
                    _draw(ax, series[scheme, adding, line], line=line)
                if line in raws:
                    _draw_raw(ax, raws[line], line=line, scheme=scheme)
        figure_style.level_axis(axes[0], log=scheme.log)
        axes[0].set_ylabel(LABEL)
    # A share: the whole axis, with a little room for markers at its ends.
    panels[0, 0].set_ylim(-3.0, 103.0)
    _legend(figure, drawn, has_raw=bool(raws))
    figure_style.title(figure, dataset=dataset, what="what an adversary who filters gets back")
    return figure


def _lines(summary: pd.DataFrame) -> list[_Line]:
    """Return what is drawn, with its looks."""
    pairs = summary[["consumer", "knowledge"]].drop_duplicates().itertuples(index=False, name=None)
    chosen = [
        source
        for source in most_knowing(Source(consumer, knowledge) for consumer, knowledge in pairs)
        if source.consumer != IDENTITY
    ]
    oracle = [source for source in chosen if source.knowledge == ORACLE]
    others = [source for source in chosen if source.knowledge and source not in oracle]
    return [
        *(_Line(source, _SHARED_LOOK) for source in chosen if source == AS_SHARED),
        *(_Line(source, look) for source, look in zip(others, LOOKS, strict=False)),
        *(_Line(source, look) for source, look in zip(oracle, _ORACLE_LOOKS, strict=False)),
    ]


def _of(summary: pd.DataFrame, mechanism: str, source: Source) -> pd.DataFrame:
    return summary.loc[
        (summary["mechanism"] == mechanism)
        & (summary["consumer"] == source.consumer)
        & (summary["knowledge"] == source.knowledge)
    ]


def _series(summary: pd.DataFrame, mechanism: str, line: _Line, *, log: bool) -> pd.DataFrame:
    rows = _of(summary, mechanism, line.source)
    rows = rows[rows["level"] > 0 if log else rows["level"].notna()].sort_values("level")
    found: pd.DataFrame = rows[["level"]].join(rows[["value", "ci_low", "ci_high"]] * _PERCENT)
    return found


def _raw(summary: pd.DataFrame, line: _Line) -> float | None:
    rows = _of(summary, "raw", line.source)
    return None if rows.empty else float(rows["value"].iloc[0]) * _PERCENT


def _draw(ax: Axes, found: pd.DataFrame, *, line: _Line) -> None:
    look = line.look
    level, value, low, high = (
        found[key].to_numpy() for key in ("level", "value", "ci_low", "ci_high")
    )
    ax.plot(
        level,
        value,
        color=look.colour,
        marker=look.marker,
        linestyle=look.dashes,
        **_apart(line),
    )
    figure_style.band(ax, x=level, low=low, high=high, look=look)


def _draw_raw(ax: Axes, value: float, *, line: _Line, scheme: Scheme) -> None:
    """Draw raw as a dotted line; for attacks, which would crowd each other, at raw's edge only."""
    whole, at_edge = (0.0, 1.0), (0.95, 1.0) if scheme.log else (0.0, 0.06)
    ax.plot(
        whole if line.source == AS_SHARED else at_edge,
        [value, value],
        transform=ax.get_yaxis_transform(),
        color=line.look.colour,
        linestyle=":",
        zorder=2.6,
    )


def _apart(line: _Line) -> dict[str, Any]:
    return {"linewidth": 0.8, "markerfacecolor": "white"} if line.is_oracle else {}


def _legend(figure: Figure, lines: list[_Line], *, has_raw: bool) -> None:
    handles: list[Any] = []
    for line in lines:
        handle = figure_style.line_handle(line.label, line.look)
        handle.set(**_apart(line))
        handles.append(handle)
    if has_raw:
        handles.append(figure_style.black_handle("raw (attacks: at its edge)", dashes=":"))
    handles.append(figure_style.band_handle("95 % interval"))
    figure_style.legend(figure, handles)
