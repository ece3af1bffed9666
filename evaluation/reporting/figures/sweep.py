"""Missed conflicts, PLR and exposure lengths over the level, a figure for each mechanism."""

from __future__ import annotations

import re
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
from evaluation.reporting.figures.style import LOOKS, Line, Look
from evaluation.reporting.rows import Scheme, schemes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evaluation.reporting.rows import Results

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


def drawings(run: Results) -> list[Drawing]:
    """Return a figure for each mechanism that is swept, under plain names of files."""
    found: dict[str, Drawing] = {}
    for one in schemes(run.ours):
        plain = f"sweep-{re.sub(r'[^A-Za-z0-9=.-]+', '_', one.name)[:_MOST_CHARACTERS]}"
        name = _FILES.get(one.name, plain)
        name += f"-{one.place}" * (name in found)
        title = f"Missed conflicts, PLR and exposure over the level: {one.title}"
        draw, words = partial(sweep_figure, scheme=one), partial(_words, scheme=one)
        found[name] = Drawing(name, "figures", title, draw, words)
    return list(found.values())


def sweep_figure(run: Results, *, scheme: Scheme) -> Figure | None:
    """Return missed conflicts, PLR and exposure lengths over the level; None without levels.

    One column for each adding rule, one row for each quantity. Of more than five predictors the
    first five are drawn.
    """
    lines = {of: line for of, line in _lines(run).items() if scheme.rules_in(line.rows)}
    rules = scheme.rules_in(*(line.rows for line in lines.values()))
    if not rules:
        return None
    labels = list(dict.fromkeys(_axis(metric) for _, metric in lines))
    has_paper = run.dataset == DATASET and scheme.name in _FILES and "linear" in rules
    figure, panels = figure_style.panels(
        len(labels), len(rules), height_in=1.35 * len(labels) + 0.9, sharex=True, sharey="row"
    )
    for rule, axes in zip(rules, panels.T, strict=True):
        axes[0].set_title(scheme.rule_text(rule))
        axes[-1].set_xlabel(scheme.label)
        for (consumer, metric), line in lines.items():
            ax = axes[labels.index(_axis(metric))]
            line.draw(ax, scheme, rule)
            if has_paper and rule == "linear" and consumer in (SHARED, PREDICTOR):
                _draw_paper(ax, metric, look=line.look, scheme=scheme)
    figure_style.level_axis(panels[0, 0], log=scheme.log)
    for label, ax in zip(labels, panels[:, 0], strict=True):
        ax.set_ylabel(label)
        drawn = [line for (_, metric), line in lines.items() if _axis(metric) == label]
        values = [
            line.scale * scheme.of(line.rows, rule)["value"].to_numpy()
            for line in drawn
            for rule in rules
        ]
        values += [np.array([line.raw]) for line in drawn if line.raw is not None]
        figure_style.value_axis(ax, values, log=label == _EXPOSURE_LABEL)
    predictors = [line for (_, metric), line in lines.items() if metric == MISSED_RATE]
    # An only predictor is in the title, and PLR has its own axis.
    named = predictors if len(predictors) > 1 else []
    named += [line for (_, metric), line in lines.items() if metric in ("ael", "mel")]
    banded = "" if all(line.has_band for line in predictors) else predictors[0].label
    handles: list[Any] = [line.handle for line in named]
    if any(line.raw is not None for line in lines.values()):
        handles.append(figure_style.black_handle("raw", dashes=":"))
    only = f" (predictors: {banded})" if banded else ""
    handles.append(figure_style.band_handle(f"95 % interval{only}"))
    if has_paper:
        text = "paper (raw at the edge)"
        handles.append(figure_style.black_handle(text, marker="o", hollow=True))
    what = f", predictor {predictors[0].label}" if len(predictors) == 1 else ""
    return figure_style.finish(figure, handles, dataset=run.dataset, what=f"{scheme.title}{what}")


def _words(run: Results, *, scheme: Scheme) -> str:
    of = run.ours[~is_attack(run.ours)]
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


def _axis(metric: str) -> str:
    return _EXPOSURE_LABEL if metric in ("ael", "mel") else figure_style.label(metric)


def _lines(run: Results) -> dict[tuple[str, str], Line]:
    """Return what may be drawn, by consumer and metric."""
    known = run.ours[~is_attack(run.ours) & np.isfinite(run.ours["value"])]
    predictors = list(known.loc[known["metric"] == MISSED_RATE, "consumer"].unique())[: len(LOOKS)]
    # The bands of many predictors would hide each other.
    n_bands = len(predictors) if len(predictors) <= _MOST_BANDS else 1
    looks = {(name, MISSED_RATE): look for name, look in zip(predictors, LOOKS, strict=False)}
    looks |= {(SHARED, metric): look for metric, look in _LOOKS.items()}
    return {
        (consumer, metric): Line(
            METRICS[metric].head if consumer == SHARED else consumer,
            look,
            known[(known["consumer"] == consumer) & (known["metric"] == metric)],
            METRICS[metric].scale,
            has_band=metric != MISSED_RATE or consumer in predictors[:n_bands],
            is_raw_across=True,
        )
        for (consumer, metric), look in looks.items()
    }


def _draw_paper(ax: Axes, metric: str, *, look: Look, scheme: Scheme) -> None:
    """Mark the paper's numbers; raw, which has no level, goes to the edge next to it."""
    for mechanism, level, of, value in PUBLISHED:
        if of == metric and mechanism in ("raw", scheme.name):
            edge = 1.0 if scheme.log else 0.0
            transform = ax.get_yaxis_transform() if level is None else ax.transData
            ax.plot(
                *([edge if level is None else level], [value * METRICS[metric].scale]),
                marker=look.marker,
                markersize=5,
                zorder=5,
                clip_on=False,
                markerfacecolor="white",
                markeredgecolor="black",
                transform=transform,
            )
