"""Figures over the level: what is shared and missed, and what attacks leave."""

from __future__ import annotations

import re
from functools import partial
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.analysis.families import FID, FIXED, RAW
from evaluation.analysis.keys import AS_SHARED, ORACLE, Source, is_attack
from evaluation.analysis.metrics import EXPOSURE, METRICS, MISSED_RATE
from evaluation.analysis.paper import DATASET, PREDICTOR, PUBLISHED
from evaluation.analysis.strongest import most_knowing
from evaluation.experiment.presets import IDENTITY, SHARED
from evaluation.reporting import rows as picked
from evaluation.reporting.figures import drawing
from evaluation.reporting.figures.drawing import LOOKS, Drawing, Line, Look
from evaluation.reporting.result_tables import after_attack, sources_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FILES = {FID: "fid_threshold", FIXED: "fixed_error"}
_EXPOSURE_LABEL = "Exposure, shared (s)"
_MOST_BANDS = 2
_MOST_CHARACTERS = 80
"""Of a file's name."""
_SHARED_LOOK = Look("#000000", "o", "-")
# Apart from the looks of the predictors, with which they share a legend.
_SWEPT_LOOKS = {
    EXPOSURE: _SHARED_LOOK,
    "ael": Look("#56B4E9", "v", "-"),
    "mel": Look("#000000", "D", "--"),
}
# The oracle is set apart: grey, thin and hollow.
_ORACLE: dict[str, Any] = {"linewidth": 0.8, "markerfacecolor": "white"}
_ORACLE_LOOKS = Look("#777777", "D", (0, (2, 1.5))), Look("#999999", "v", (0, (4, 1.5)))


def drawings(run: picked.Results) -> list[Drawing]:
    """Return that after attack, and one of each swept mechanism."""
    every = "PLR as shared and after each attack, over the level"
    found = [
        Drawing("after_attack", "after", every, _attack_figure, _attack_words),
    ]
    for swept, of in groupby(picked.schemes(run.ours), key=attrgetter("name")):
        known = list(of)
        plain = f"sweep-{re.sub(r'[^A-Za-z0-9=.-]+', '_', swept)[:_MOST_CHARACTERS]}"
        name = _FILES.get(swept, plain)
        name += f"-{known[0].place}" * any(one.name == name for one in found)
        title = f"Missed conflicts, PLR and exposure over the level: {known[0].title}"
        draw, words = partial(_sweep_figure, known=known), partial(_sweep_words, known=known)
        found.append(Drawing(name, "figures", title, draw, words))
    return found


def _sweep_figure(run: picked.Results, *, known: Sequence[picked.Scheme]) -> Figure | None:
    """Return a column for each adding rule, a row for each quantity; None without levels."""
    lines = {
        of: line for of, line in _swept_lines(run).items() if picked.shown_in(known, line.rows)
    }
    known = picked.shown_in(known, *(line.rows for line in lines.values()))
    if not known:
        return None
    labels = list(dict.fromkeys(_axis(metric) for _, metric in lines))
    is_papers = run.dataset == DATASET and known[0].name in _FILES
    of_paper = [one for one in known if is_papers and "linear" in one.rules]
    figure, panels = drawing.panels(
        len(labels), len(known), height_in=1.35 * len(labels) + 0.9, sharex=True, sharey="row"
    )
    for scheme, axes in zip(known, panels.T, strict=True):
        axes[0].set_title(scheme.rule_text)
        axes[-1].set_xlabel(scheme.label)
        for (consumer, metric), line in lines.items():
            ax = axes[labels.index(_axis(metric))]
            line.draw(ax, scheme)
            if scheme in of_paper and consumer in (SHARED, PREDICTOR):
                _draw_paper(ax, metric, look=line.look, scheme=scheme)
    drawing.level_axis(panels[0, 0], log=known[0].log)
    for label, ax in zip(labels, panels[:, 0], strict=True):
        ax.set_ylabel(label)
        drawn = [line for (_, metric), line in lines.items() if _axis(metric) == label]
        values = [line.shown.scale * one.of(line.rows)["value"] for line in drawn for one in known]
        alone = [one for line in drawn for one in line.alone(RAW)]
        drawing.value_axis(ax, [*values, alone], log=label == _EXPOSURE_LABEL)
    predictors = [line for (_, metric), line in lines.items() if metric == MISSED_RATE]
    # An only predictor is in the title, and PLR has its own axis.
    named = predictors if len(predictors) > 1 else []
    named += [line for (_, metric), line in lines.items() if metric in ("ael", "mel")]
    banded = "" if all(line.has_band for line in predictors) else predictors[0].label
    handles = [
        *(line.handle for line in named),
        any(line.alone(RAW) for line in lines.values()) and drawing.black_handle("raw", dashes=":"),
        drawing.band_handle("95 % interval" + f" (predictors: {banded})" * bool(banded)),
        bool(of_paper) and drawing.black_handle("paper (raw at the edge)", marker="o", hollow=True),
    ]
    what = f", predictor {predictors[0].label}" if len(predictors) == 1 else ""
    return drawing.finish(figure, handles, dataset=run.dataset, what=f"{known[0].title}{what}")


def _sweep_words(run: picked.Results, *, known: Sequence[picked.Scheme]) -> str:
    lines = _swept_lines(run)
    first = next(consumer for consumer, _ in lines)
    told = {
        f"{'missed conflicts of ' * (metric == MISSED_RATE)}{line.label} from": line
        for (consumer, metric), line in lines.items()
        if consumer in (first, SHARED)
    }
    said = _ends({one.rule_text: one for one in known}, told)
    return f"Panels over the level, with 95 % bands. {said}"


def _ends(named: Mapping[str, picked.Scheme], lines: Mapping[str, Line]) -> str:
    """Return the ends of lines in words, as `NAME: PLR 18.7 % at η = 1 to 51.9 % at η = 1000; ...`.

    The names of `lines` are the words before their ends; what has no rows is left out.
    """
    parts = []
    for name, scheme in named.items():
        found = []
        for before, line in lines.items():
            of, shown = scheme.of(line.rows).to_dict("records"), line.shown
            ends = " to ".join(
                f"{shown.scale * row['value']:.{shown.digits}f} {shown.unit} "
                f"at {scheme.at(row['level'])}"
                for row in of[:1] + of[1:][-1:]
            )
            found += [f"{before} {ends}"] * bool(ends)
        parts += [f"{name}: {'; '.join(found)}."] * bool(found)
    return " ".join(parts)


def _axis(metric: str) -> str:
    return _EXPOSURE_LABEL if metric in ("ael", "mel") else drawing.label(metric)


def _swept_lines(run: picked.Results) -> dict[tuple[str, str], Line]:
    """Return what may be drawn, by consumer and metric."""
    known = run.ours[~is_attack(run.ours) & np.isfinite(run.ours["value"])]
    predictors = list(known.loc[known["metric"] == MISSED_RATE, "consumer"].unique())[: len(LOOKS)]
    # The bands of many predictors would hide each other.
    n_bands = len(predictors) if len(predictors) <= _MOST_BANDS else 1
    looks = {(name, MISSED_RATE): look for name, look in zip(predictors, LOOKS, strict=False)}
    looks |= {(SHARED, metric): look for metric, look in _SWEPT_LOOKS.items()}
    return {
        (consumer, metric): Line(
            METRICS[metric].head if consumer == SHARED else consumer,
            look,
            known[(known["consumer"] == consumer) & (known["metric"] == metric)],
            METRICS[metric],
            has_band=metric != MISSED_RATE or consumer in predictors[:n_bands],
            is_raw_across=True,
        )
        for (consumer, metric), look in looks.items()
    }


def _draw_paper(ax: Axes, metric: str, *, look: Look, scheme: picked.Scheme) -> None:
    """Mark the paper's numbers; raw, which has no level, goes to the edge next to it."""
    for mechanism, level, of, value in PUBLISHED:
        if of == metric and mechanism in ("raw", scheme.name):
            transform = ax.get_yaxis_transform() if level is None else ax.transData
            at = [float(scheme.log) if level is None else level], [value * METRICS[metric].scale]
            mark: dict[str, Any] = {"marker": look.marker, "markersize": 5, "clip_on": False}
            mark |= {"markerfacecolor": "white", "markeredgecolor": "black", "zorder": 5}
            ax.plot(*at, **mark, transform=transform)


def _attack_figure(run: picked.Results) -> Figure | None:
    """Return PLR over the level, as shared and after each attack; None without attacks or levels.

    Of each attack the adversary is drawn that knows most short of the oracle; an attack that only
    the oracle can run is drawn as a reference. The control, which repeats what was shared, is left
    out, and so is what lies beyond the looks that there are.
    """
    rows = _exposure(after_attack(run.ours))
    known = picked.schemes(rows)
    lines = {
        of: line for of, line in _attack_lines(rows).items() if picked.shown_in(known, line.rows)
    }
    if not lines.keys() - {AS_SHARED}:
        return None
    known = picked.shown_in(known, *(line.rows for line in lines.values()))
    swept = [list(of) for _, of in groupby(known, key=attrgetter("name"))]
    columns, height_in = picked.rules_of(known), 2.0 * len(swept) + 0.9
    figure, panels = drawing.panels(
        len(swept), len(columns), height_in=height_in, sharex="row", sharey=True
    )
    for of, axes in zip(swept, panels, strict=True):
        for rule, ax in zip(columns, axes, strict=True):
            scheme = next((one for one in of if rule in one.rules), None)
            if scheme is None:
                ax.set_axis_off()
                continue
            ax.set(title=f"{scheme.title}, {scheme.rule_text}", xlabel=scheme.label)
            for line in lines.values():
                line.draw(ax, scheme)
        drawing.level_axis(axes[0], log=of[0].log)
        axes[0].set_ylabel("PLR, shared or attacked (%)")
    # A share: the whole axis, with a little room for markers at its ends.
    panels[0, 0].set_ylim(-3.0, 103.0)
    has_raw = any(line.alone(RAW) for line in lines.values())
    handles = [
        *(line.handle for line in lines.values()),
        has_raw and drawing.black_handle("raw (attacks: at its edge)", dashes=":"),
        drawing.band_handle("95 % interval"),
    ]
    what = "what an adversary who filters gets back"
    return drawing.finish(figure, handles, dataset=run.dataset, what=what)


def _attack_words(run: picked.Results) -> str:
    strongest, rows = run.strongest.get(""), _exposure(after_attack(run.ours))
    if strongest is None:
        return ""
    of = {"as shared": AS_SHARED, f"after {strongest.label}": strongest}
    told = {name: Line("", _SHARED_LOOK, picked.of_source(rows, one)) for name, one in of.items()}
    known = {f"{one.title}, {one.rule_text}": one for one in picked.schemes(run.ours)}
    return f"Lines of PLR over the level. {_ends(known, told)}"


def _exposure(rows: pd.DataFrame) -> pd.DataFrame:
    found: pd.DataFrame = rows[(rows["metric"] == EXPOSURE) & np.isfinite(rows["value"])]
    return found


def _attack_lines(rows: pd.DataFrame) -> dict[Source, Line]:
    """Return what is drawn, with its looks."""
    chosen = [source for source in most_knowing(sources_of(rows)) if source.consumer != IDENTITY]
    oracle = [source for source in chosen if source.knowledge == ORACLE]
    others = [source for source in chosen if source.knowledge and source not in oracle]
    # Raw after attacks would crowd each other.
    shared = Line("as shared", _SHARED_LOOK, picked.of_source(rows, AS_SHARED), is_raw_across=True)
    lines = {AS_SHARED: shared} if AS_SHARED in chosen else {}
    for of, look in zip(others, LOOKS, strict=False):
        lines[of] = Line(of.label, look, picked.of_source(rows, of))
    for of, look in zip(oracle, _ORACLE_LOOKS, strict=False):
        label = f"{of.label}, a reference"
        lines[of] = Line(label, look, picked.of_source(rows, of), apart=_ORACLE)
    return lines
