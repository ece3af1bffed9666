"""What it costs a robot: operating points of privacy and utility, and misses over false alarms."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.analysis.families import FID, FIXED, RAW
from evaluation.analysis.keys import Where, is_attack, level_text
from evaluation.analysis.matching import MISSED
from evaluation.analysis.metrics import DESCRIPTORS, EXPOSURE, METRICS, MISSED_RATE
from evaluation.experiment.presets import SHARED
from evaluation.reporting import rows as picked
from evaluation.reporting.figures import drawing
from evaluation.reporting.figures.drawing import LOOKS, PERCENT, Dashes, Drawing

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FALSE_ALARMS = "false_alarm_rate"
_DASHES: dict[str, Dashes] = {"separation": "-", "probability": (0, (3, 1.5))}


def drawings(_: picked.Results) -> list[Drawing]:
    """Return the plane of the first predictor, and misses over false alarms of all."""
    points = "Operating points: each descriptor as shared against missed conflicts"
    better, curves = "Down and to the left is better.", "Missed conflicts against false alarms"
    return [
        Drawing("operating_points", "plane", points, _operating_figure, _operating_words, better),
        Drawing("false_alarms", "alarms", curves, _curves_figure, _curves_words),
    ]


def _operating_figure(run: picked.Results) -> Figure | None:
    """Return the privacy-utility plane of the first predictor: points, and curves as matched."""
    ours = run.ours[~is_attack(run.ours) & np.isfinite(run.ours["value"])]
    known = picked.schemes(ours)
    predictor = next(iter(ours["consumer"][ours["metric"] == MISSED_RATE]), "")
    planes = {metric: _plane(ours, predictor, metric) for metric in DESCRIPTORS}
    drawn = picked.shown_in(known, *planes.values())
    rules = picked.rules_of(drawn)
    if not drawn:
        return None
    wanted = {"dataset": run.dataset, "predictor": predictor, "criterion": MISSED}
    wanted |= {"consumer": SHARED}
    curves = run.matched[(run.matched[list(wanted)] == list(wanted.values())).all(axis=1)]
    figure, panels = drawing.panels(
        len(rules), len(planes), height_in=1.75 * len(rules) + 0.8, sharex=True, sharey="col"
    )
    for rule, axes in zip(rules, panels, strict=True):
        axes[0].set_title(f"{rule} adding")
        for (metric, plane), ax in zip(planes.items(), axes, strict=True):
            ax.set_ylabel(drawing.label(metric))
            part = curves[(curves["adding"] == rule) & (curves["metric"] == metric)]
            for scheme in known:
                if rule in scheme.rules:
                    _draw(ax, part, plane, scheme, metric)
            raw = plane[plane["mechanism"] == RAW]
            ax.plot(raw["x"], raw["y"], "*", color="black", markersize=6, zorder=4)
    for (metric, plane), axes in zip(planes.items(), panels.T, strict=True):
        axes[-1].set_xlabel(drawing.label(MISSED_RATE))
        values = [scheme.of(plane)["y"] for scheme in drawn]
        if any(map(len, values)):
            values.append(plane["y"][plane["mechanism"] == RAW])
            drawing.value_axis(axes[0], values, log=metric != EXPOSURE)
    has_raw = any((plane["mechanism"] == RAW).any() for plane in planes.values())
    handles = [
        *drawing.handles_of(drawn),
        has_raw and drawing.black_handle("raw", marker="*"),
        not curves.empty and drawing.band_handle("95 % interval at matched rates"),
    ]
    what = f"operating points, predictor {predictor}"
    return drawing.finish(figure, handles, dataset=run.dataset, what=what)


def _operating_words(run: picked.Results) -> str:
    raw = run.ours[(run.ours["mechanism"] == RAW) & ~is_attack(run.ours)]
    said = [
        f"{shown.head} {shown.scale * value:.{shown.digits}f} {shown.unit}"
        for shown in (METRICS[metric] for metric in (MISSED_RATE, *DESCRIPTORS))
        for value in raw.loc[raw["metric"] == shown.name, "value"].head(1)
    ]
    return (
        "PLR, AEL and MEL over the missed-conflict rate, a curve for each of "
        f"{', '.join(picked.by_title(picked.schemes(run.ours)))}, all ending at raw "
        f"({', '.join(said)}). Lower and further left is better. "
        "The table of matched points has the differences."
    )


def _plane(summary: pd.DataFrame, predictor: str, metric: str) -> pd.DataFrame:
    """Return missed-conflict rate x and descriptor y of every level, in the units of the axes."""
    x = summary[(summary["consumer"] == predictor) & (summary["metric"] == MISSED_RATE)]
    y = summary[(summary["consumer"] == SHARED) & (summary["metric"] == metric)]
    keys = ["mechanism", "level"]
    x = x[keys].assign(x=x["value"] * METRICS[MISSED_RATE].scale)
    return x.merge(y[keys].assign(y=y["value"] * METRICS[metric].scale), on=keys)


def _draw(
    ax: Axes, curves: pd.DataFrame, plane: pd.DataFrame, scheme: picked.Scheme, metric: str
) -> None:
    """Draw a mechanism, or the fixed noise that it is held against: matched curve and points."""
    look, scale, is_fixed = drawing.look_of(scheme), METRICS[metric].scale, scheme.name == FIXED
    mechanism = next(iter(curves["mechanism"]), "") if is_fixed else scheme.mechanism
    rows = curves[curves["mechanism"] == mechanism].sort_values(MISSED_RATE)
    if len(rows):
        column = FIXED if is_fixed else FID
        x = rows[MISSED_RATE].to_numpy() * METRICS[MISSED_RATE].scale
        ax.plot(x, rows[column] * scale, color=look.colour, linestyle=look.dashes)
        ends = (rows[f"{column}_{end}"].to_numpy() * scale for end in ("low", "high"))
        drawing.band(ax, x, *ends, look=look)
    points = scheme.of(plane).sort_values("x", kind="stable")
    edge: dict[str, Any] = {"markersize": 4.2, "markeredgecolor": "white", "markeredgewidth": 0.4}
    ax.plot(points["x"], points["y"], look.marker, color=look.colour, **edge)
    if metric == EXPOSURE and len(points):
        # The level that costs most gives the curve a direction.
        noisiest = points.iloc[-1]
        at, offset = (noisiest["x"], noisiest["y"]), (0.0, -9.0 if scheme.log else 5.0)
        text: dict[str, Any] = {"textcoords": "offset points", "color": look.colour}
        ax.annotate(scheme.at(float(noisiest["level"])), at, offset, ha="center", **text)


def _curves_figure(run: picked.Results) -> Figure | None:
    """Return misses against false alarms of every predictor, marked where the paper's robot is."""
    of = run.curves[run.curves["dataset"] == run.dataset]
    wheres = [where for where in picked.compared_levels(run.ours) if not _at(of, where).empty]
    if not wheres:
        return None
    columns = min(3, len(wheres))
    n_rows = -(-len(wheres) // columns)
    figure, panels = drawing.panels(
        *(n_rows, columns),
        height_in=1.85 * n_rows + 0.95,
        margins_in=(0.45, 0.1, 0.5, 0.75, 0.18, 0.28),
        sharex=True,
        sharey=True,
    )
    looks = dict(zip(of["consumer"].unique(), LOOKS, strict=False))
    known = {scheme.mechanism: scheme for scheme in picked.schemes(run.ours)}
    for where, ax in zip(wheres, panels.flat, strict=False):
        ax.set_title(where[0])
        if where[1] is not None:
            scheme = known[where[0]]
            ax.set_title(f"{scheme.name}, {scheme.at(where[1])}, {scheme.rule_text}")
        found, operating = _at(of, where), _at(run.ours, where)
        for name, look in looks.items():
            rows = found[found["consumer"] == name]
            for score, part in rows.groupby("score", sort=False):
                look_of = {"color": look.colour, "linestyle": _DASHES[str(score)]}
                x, y = PERCENT * part[_FALSE_ALARMS], PERCENT * part[MISSED_RATE]
                ax.plot(x, y, linewidth=0.9, **look_of)
            rows = operating[operating["consumer"] == name].drop_duplicates("metric")
            value = PERCENT * rows.set_index("metric")["value"]
            mark = {"color": look.colour, "markerfacecolor": "white", "markersize": 4.5}
            at = ([one] for one in value.reindex([_FALSE_ALARMS, MISSED_RATE]))
            ax.plot(*at, look.marker, **mark, zorder=3)
    for ax in panels.flat[len(wheres) :]:
        ax.set_axis_off()
    for ax in panels[:, 0]:
        ax.set_ylabel(drawing.label(MISSED_RATE))
    for ax in panels.flat[max(0, len(wheres) - columns) : len(wheres)]:
        ax.set_xlabel("False alarms (%)")
        ax.tick_params(labelbottom=True)
    panels[0, 0].set(xlim=(-2.0, 102.0), ylim=(-2.0, 102.0))
    handles = [
        *(drawing.handle(name, replace(look, dashes="-")) for name, look in looks.items()),
        drawing.black_handle("by predicted separation", dashes=_DASHES["separation"]),
        drawing.black_handle("by conflict probability", dashes=_DASHES["probability"]),
        drawing.black_handle("as the paper's robot decides", marker="o", hollow=True),
    ]
    what = "misses against false alarms"
    return drawing.finish(figure, handles, dataset=run.dataset, what=what, columns=4)


def _curves_words(run: picked.Results) -> str:
    parts = []
    for where in picked.compared_levels(run.ours):
        rows = _at(run.ours[~is_attack(run.ours)], where)
        said = []
        for consumer in rows.loc[rows["metric"] == MISSED_RATE, "consumer"].unique():
            value = rows[rows["consumer"] == consumer].set_index("metric")["value"]
            said.append(
                f"{consumer} misses {PERCENT * value[MISSED_RATE]:.0f} % at "
                f"{PERCENT * value.get(_FALSE_ALARMS, np.nan):.0f} % false alarms"
            )
        parts.append(f"{where[0]} {level_text(where[1])}".strip() + f": {', '.join(said)}.")
    return f"Curves of misses over false alarms, closer to the corner is better. {' '.join(parts)}"


def _at(frame: pd.DataFrame, where: Where) -> pd.DataFrame:
    mechanism, level = where
    at = frame["level"].isna() if level is None else np.isclose(frame["level"], level)
    return frame[(frame["mechanism"] == mechanism) & at]
