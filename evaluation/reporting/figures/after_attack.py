"""PLR as shared and after each attack, over the level: the figure of what filtering brings back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.analysis.keys import AS_SHARED, ORACLE, Source
from evaluation.analysis.metrics import EXPOSURE
from evaluation.analysis.strongest import most_knowing
from evaluation.experiment.presets import IDENTITY
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.drawing import Drawing
from evaluation.reporting.figures.style import LOOKS, Look
from evaluation.reporting.schemes import rules_of, schemes
from evaluation.reporting.summary_tables import after_attack, sources_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evaluation.reporting.run_results import Results
    from evaluation.reporting.schemes import Scheme

LABEL = "PLR, shared or attacked (%)"
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

    @property
    def apart(self) -> dict[str, Any]:
        return {"linewidth": 0.8, "markerfacecolor": "white"} if self.is_oracle else {}

    def of(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Return its rows in percent."""
        rows = rows[
            (rows["consumer"] == self.source.consumer)
            & (rows["knowledge"] == self.source.knowledge)
        ]
        numbers = rows[["value", "ci_low", "ci_high"]] * _PERCENT
        found: pd.DataFrame = rows[["mechanism", "level"]].join(numbers)
        return found


def drawings(run: Results) -> list[Drawing]:
    """Return the figure of what is left after attack."""
    return [
        Drawing(
            name="after_attack",
            section="after",
            title="PLR as shared and after each attack, over the level",
            draw=partial(attack_figure, run.ours, dataset=run.dataset),
            words=partial(_words, run.ours, strongest=run.strongest.get("")),
        )
    ]


def attack_figure(summary: pd.DataFrame, *, dataset: str) -> Figure | None:
    """Return PLR over the level, as shared and after each attack; None without attacks or levels.

    One column for each adding rule, one row for each way of adding error. Of each attack the
    adversary is drawn that knows most short of the oracle; an attack that only the oracle can
    run is drawn as a reference. The control, which repeats what was shared, is left out, and so
    is what lies beyond the looks that there are.
    """
    rows = _exposure(summary)
    known = schemes(rows)
    series = {
        (scheme, rule, line): found
        for scheme in known
        for rule in scheme.mechanisms
        for line in _lines(rows)
        if not (found := scheme.of(line.of(rows), rule)).empty
    }
    drawn = [line for line in _lines(rows) if any(key[2] == line for key in series)]
    if not any(line.source != AS_SHARED for line in drawn):
        return None
    known = [scheme for scheme in known if any(key[0] is scheme for key in series)]
    columns = rules_of(known)
    figure = figure_style.empty_figure(
        width_in=figure_style.SINGLE_COLUMN_IN
        if len(columns) == 1
        else figure_style.DOUBLE_COLUMN_IN,
        height_in=2.0 * len(known) + 0.9,
    )
    panels = figure.subplots(len(known), len(columns), sharex="row", sharey=True, squeeze=False)
    raws = {
        line: float(raw["value"].iloc[0])
        for line in drawn
        if len(raw := line.of(rows[rows["mechanism"] == "raw"]))
    }
    for scheme, axes in zip(known, panels, strict=True):
        for rule, ax in zip(columns, axes, strict=True):
            if rule not in scheme.mechanisms:
                ax.set_axis_off()
                continue
            ax.set_title(f"{scheme.title}, {scheme.rule_text(rule)}")
            ax.set_xlabel(scheme.label)
            for line in drawn:
                if (scheme, rule, line) in series:
                    _draw(ax, series[scheme, rule, line], line=line)
                if line in raws:
                    _draw_raw(ax, raws[line], line=line, scheme=scheme)
        figure_style.level_axis(axes[0], log=scheme.log)
        axes[0].set_ylabel(LABEL)
    # A share: the whole axis, with a little room for markers at its ends.
    panels[0, 0].set_ylim(-3.0, 103.0)
    _legend(figure, drawn, has_raw=bool(raws))
    figure_style.title(figure, dataset=dataset, what="what an adversary who filters gets back")
    return figure


def _words(summary: pd.DataFrame, *, strongest: Source | None) -> str:
    if strongest is None:
        return ""
    rows = _exposure(summary)
    shared, after = (
        rows[(rows["consumer"] == one.consumer) & (rows["knowledge"] == one.knowledge)]
        for one in (AS_SHARED, strongest)
    )
    parts = []
    for scheme in schemes(summary):
        for rule in scheme.rules:
            before, left = (scheme.ends(of, rule, EXPOSURE) for of in (shared, after))
            if before:
                parts.append(
                    f"{scheme.title}, {scheme.rule_text(rule)}: as shared {before}; after "
                    f"{strongest.label} {left}."
                )
    return f"Lines of PLR over the level. {' '.join(parts)}"


def _exposure(summary: pd.DataFrame) -> pd.DataFrame:
    rows = after_attack(summary)
    found: pd.DataFrame = rows[(rows["metric"] == EXPOSURE) & np.isfinite(rows["value"])]
    return found


def _lines(rows: pd.DataFrame) -> list[_Line]:
    """Return what is drawn, with its looks."""
    chosen = [source for source in most_knowing(sources_of(rows)) if source.consumer != IDENTITY]
    oracle = [source for source in chosen if source.knowledge == ORACLE]
    others = [source for source in chosen if source.knowledge and source not in oracle]
    return [
        *(_Line(source, _SHARED_LOOK) for source in chosen if source == AS_SHARED),
        *(_Line(source, look) for source, look in zip(others, LOOKS, strict=False)),
        *(_Line(source, look) for source, look in zip(oracle, _ORACLE_LOOKS, strict=False)),
    ]


def _draw(ax: Axes, found: pd.DataFrame, *, line: _Line) -> None:
    look = line.look
    level, value, low, high = (found[k].to_numpy() for k in ("level", "value", "ci_low", "ci_high"))
    ax.plot(
        level,
        value,
        color=look.colour,
        marker=look.marker,
        linestyle=look.dashes,
        **line.apart,
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


def _legend(figure: Figure, lines: list[_Line], *, has_raw: bool) -> None:
    handles: list[Any] = []
    for line in lines:
        handle = figure_style.line_handle(line.label, line.look)
        handle.set(**line.apart)
        handles.append(handle)
    if has_raw:
        handles.append(figure_style.black_handle("raw (attacks: at its edge)", dashes=":"))
    handles.append(figure_style.band_handle("95 % interval"))
    figure_style.legend(figure, handles)
