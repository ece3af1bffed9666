"""Figures that the paper does not have: the headline, what tells what, misses over false alarms.

They are placed by hand: finding a layout for so many panels would take longer than drawing them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.collections import LineCollection
from matplotlib.ticker import FixedLocator, NullLocator

from evaluation.analysis.keys import ORACLE, Source
from evaluation.analysis.levels import SHOWN, is_attack, linked_tasks, shortened
from evaluation.analysis.linkability import CLEAN
from evaluation.analysis.matching import ADDING_SUFFIX
from evaluation.analysis.metrics import DESCRIPTORS
from evaluation.experiment.presets import IDENTITY, SHARED
from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.linkage import ours
from evaluation.reporting.figures.style import LOOKS, Look
from evaluation.reporting.figures.sweeps import FID, FIXED, LABELS, RATE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evaluation.analysis.keys import Where
    from evaluation.analysis.levels import LinkedTask
    from evaluation.reporting.figures.sweeps import Scheme

_PERCENT = 100.0
SWEPT = (FID.name, FIXED.name)
"""Mechanisms that are lines over their level."""
NO_ERROR = (CLEAN, "raw")
"""Mechanisms that add nothing."""
_SCHEME_LOOKS = {FID: LOOKS[0], FIXED: LOOKS[1]}
# Apart from every line, and from each other in grey.
_CONTROL_MARKERS = ("D", "^", "P", "v", "X", "p", "h")
_CONTROL_COLOURS = ("#CC79A7", "#009E73", "#E69F00", "#56B4E9")
_HEADLINE_LOOKS = {
    "shared": Look("#000000", "o", "-"),
    "after": Look("#0072B2", "s", "--"),
    "linked": Look("#D55E00", "^", "-."),
}
_MOST_LABELS = 12
_RIGHT = 0.6
"""Share of an axis behind which labels stand on the left of their marker."""
_SECONDS = [0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0]


def family(mechanism: str) -> str:
    """Return a mechanism's name without its parameters."""
    return mechanism.partition(":")[0]


def rule_of(mechanism: str) -> str:
    """Return the adding rule of a mechanism; empty for one that has none."""
    parameters = mechanism.partition(":")[2].split(",")
    if "adding=independent" in parameters:
        return "independent"
    adds = mechanism != "thin" and family(mechanism) not in (*NO_ERROR, "offset")
    return "linear" if adds else ""


def is_control(mechanism: str) -> bool:
    """Whether a mechanism is there to tear a descriptor and linkability apart."""
    return family(mechanism) not in (*SWEPT, *NO_ERROR)


def parameters_of(mechanism: str) -> str:
    """Return a mechanism's parameters without its adding rule, short."""
    parameters = mechanism.partition(":")[2].split(",")
    kept = ", ".join(one for one in parameters if one and not one.startswith("adding="))
    return kept.replace("d_sigma=", "Δσ=").replace("tau_s=", "τ=")


def headline_rule(summary: pd.DataFrame) -> str | None:
    """Return the adding rule of the headline: the paper's, if it was run."""
    names = set(summary["mechanism"])
    for rule, suffix in ADDING_SUFFIX.items():
        if any(f"{scheme}{suffix}" in names for scheme in SWEPT):
            return rule
    return None


def strongest_reconstruction(summary: pd.DataFrame, *, dataset: str) -> Source | None:
    """Return the attack that leaves the highest mean PLR, of those short of the oracle.

    The mean is over raw, FID and fixed noise, as in the verdict.
    """
    rows = summary[
        (summary["dataset"] == dataset)
        & (summary["metric"] == "plr")
        & is_attack(summary)
        & ~summary["mechanism"].map(is_control).astype(bool)
        & (summary["knowledge"] != ORACLE)
        & (summary["consumer"] != IDENTITY)
        & np.isfinite(summary["value"])
    ]
    means = rows.groupby(["consumer", "knowledge"], sort=False)["value"].mean()
    return Source(*means.idxmax()) if len(means) else None


def tasks_of(linkability: pd.DataFrame, *, dataset: str) -> list[LinkedTask]:
    """Return the tasks of a run in which somebody links; everybody, without the cohorts."""
    rows = ours(linkability, dataset=dataset)
    return linked_tasks(rows[rows["cohort"] == "all"])


def strongest_link(task: LinkedTask) -> Source:
    """Return the attack with the highest mean rank 1 in a task, short of the oracle.

    The mean is over raw, FID and fixed noise, as in the verdict; over all that there is without.
    """
    values: dict[Source, list[float]] = {}
    for (mechanism, _), block in task.cells.items():
        counts = not is_control(mechanism) and mechanism != CLEAN
        for source, row in block.items():
            values.setdefault(source, []).extend([row["rank1"]] * counts)
    attacks = [source for source in values if source.knowledge != ORACLE] or list(values)

    def mean(source: Source) -> float:
        known = [value for value in values[source] if np.isfinite(value)]
        return float(np.mean(known)) if known else -1.0

    return max(attacks, key=mean)


def headline_figure(
    summary: pd.DataFrame, tasks: Sequence[LinkedTask], *, dataset: str
) -> Figure | None:
    """Return PLR as shared, after the strongest attack, and the strongest link, over the level.

    One panel for each way of adding error, under the paper's adding rule if it was run. None
    without levels.
    """
    rule = headline_rule(summary)
    if rule is None:
        return None
    lines = headline_lines(summary, tasks, dataset=dataset)
    schemes = [
        scheme for scheme in (FID, FIXED) if not _on(lines["shared"][1], scheme, rule=rule).empty
    ]
    if not schemes:
        return None
    figure = figure_style.placed_figure(width_in=figure_style.SINGLE_COLUMN_IN, height_in=2.6)
    panels = figure_style.placed(
        figure, rows=1, columns=len(schemes), left_in=0.5, right_in=0.08, top_in=0.42,
        bottom_in=0.36 + 0.15 * len(lines) + 0.2, gap_in=0.22, sharey=True,
    )[0]  # fmt: skip
    for scheme, ax in zip(schemes, panels, strict=True):
        ax.set_title(scheme.title)
        ax.set_xlabel(scheme.label)
        for key, (_, rows) in lines.items():
            look = _HEADLINE_LOOKS[key]
            found = _on(rows, scheme, rule=rule)
            x = found["level"].to_numpy()
            y, low, high = (
                _PERCENT * found[end].to_numpy() for end in ("value", "ci_low", "ci_high")
            )
            ax.plot(x, y, color=look.colour, marker=look.marker, linestyle=look.dashes)
            figure_style.band(ax, x=x, low=low, high=high, look=look)
            at_edge = (0.93, 1.0) if scheme.log else (0.0, 0.07)
            for value in rows.loc[rows["mechanism"] == "raw", "value"]:
                ax.plot(
                    at_edge,
                    [_PERCENT * value] * 2,
                    transform=ax.get_yaxis_transform(),
                    color=look.colour,
                    linestyle=":",
                )
        figure_style.level_axis(ax, log=scheme.log)
    panels[0].set_ylim(0.0, 103.0)
    panels[0].set_ylabel("%")
    figure_style.legend_in_rows(
        figure,
        [
            *(
                figure_style.line_handle(label, _HEADLINE_LOOKS[key])
                for key, (label, _) in lines.items()
            ),
            figure_style.black_handle("raw (at its edge); bands: 95 % intervals", dashes=":"),
        ],
        columns=1,
    )
    figure_style.title(figure, dataset=dataset, what=f"{rule} adding", one_line=True)
    return figure


def headline_lines(
    summary: pd.DataFrame, tasks: Sequence[LinkedTask], *, dataset: str
) -> dict[str, tuple[str, pd.DataFrame]]:
    """Return label and rows (mechanism, level, value, interval) of the headline's lines."""
    plr = summary[(summary["dataset"] == dataset) & (summary["metric"] == "plr")]
    lines = {"shared": ("PLR as shared: the descriptor", plr[plr["consumer"] == SHARED])}
    attack = strongest_reconstruction(summary, dataset=dataset)
    if attack is not None:
        rows = plr[(plr["consumer"] == attack.consumer) & (plr["knowledge"] == attack.knowledge)]
        lines["after"] = (f"PLR after {_short(attack)}", rows)
    # A walk that was shared twice, or whatever was linked first.
    for task in sorted(tasks, key=lambda one: one.name != "rerelease")[:1]:
        source = strongest_link(task)
        lines["linked"] = (
            f"found again ({task.name}, rank 1): {_short(source)}",
            pd.DataFrame(
                [
                    [mechanism, np.nan if level is None else level]
                    + [block[source][key] for key in ("rank1", "ci_low", "ci_high")]
                    for (mechanism, level), block in task.cells.items()
                    if source in block
                ],
                columns=["mechanism", "level", "value", "ci_low", "ci_high"],
            ),
        )
    return lines


def dissociation_figure(summary: pd.DataFrame, task: LinkedTask, *, dataset: str) -> Figure | None:
    """Return rank 1 of the strongest attack of a task over PLR, AEL and MEL as shared.

    One row for each adding rule. FID and fixed noise are lines over their levels; a dissociation
    control is a marker with its level. None without two levels of either.
    """
    points = dissociation_points(summary, task, dataset=dataset)
    if points.empty:
        return None
    rules = [
        rule
        for rule, suffix in ADDING_SUFFIX.items()
        if (points["mechanism"].isin([f"{scheme}{suffix}" for scheme in SWEPT])).sum() > 1
    ]
    if not rules:
        return None
    controls = list(dict.fromkeys(family(name) for name in points["mechanism"] if is_control(name)))
    figure = figure_style.placed_figure(
        width_in=figure_style.DOUBLE_COLUMN_IN, height_in=1.75 * len(rules) + 1.0
    )
    panels = figure_style.placed(
        figure, rows=len(rules), columns=len(DESCRIPTORS), left_in=0.45, right_in=0.1, top_in=0.5,
        bottom_in=0.85, gap_in=0.18, between_in=0.3, sharex="col", sharey=True,
    )  # fmt: skip
    for rule, in_row in zip(rules, panels, strict=True):
        in_row[0].set_title(f"{rule} adding")
        in_row[0].set_ylabel("rank 1 (%)")
        for metric, ax in zip(DESCRIPTORS, in_row, strict=True):
            _draw_dissociation(ax, points, rule=rule, metric=metric, controls=controls)
    for metric, ax in zip(DESCRIPTORS, panels[-1], strict=True):
        ax.set_xlabel(LABELS[metric])
        if metric == "plr":
            ax.set_xlim(left=-2.0)
        else:
            _second_axis(ax, points[metric].to_numpy())
    panels[0, 0].set_ylim(-3.0, min(103.0, 1.12 * _PERCENT * float(points["ci_high"].max())))
    _dissociation_legend(figure, points, controls)
    figure_style.title(
        figure, dataset=dataset, what=f"{task.name}, {_short(strongest_link(task))}", one_line=True
    )
    return figure


def dissociation_points(summary: pd.DataFrame, task: LinkedTask, *, dataset: str) -> pd.DataFrame:
    """Return the descriptors as shared with rank 1 of the strongest attack, a row for each level.

    Columns: mechanism, level, rank1, ci_low, ci_high, and for each descriptor its value, `_low`
    and `_high`.
    """
    source = strongest_link(task)
    of = summary[(summary["dataset"] == dataset) & (summary["consumer"] == SHARED)]
    shared = of[of["metric"].isin(DESCRIPTORS)]
    by_level: dict[Where, dict[str, float]] = {}
    for mechanism, level, metric, value, low, high in shared[
        ["mechanism", "level", "metric", "value", "ci_low", "ci_high"]
    ].itertuples(index=False, name=None):
        where = mechanism, None if np.isnan(level) else float(level)
        by_level.setdefault(where, {}).update(
            {metric: value, f"{metric}_low": low, f"{metric}_high": high}
        )
    rows = []
    for (mechanism, level), cell in task.cells.items():
        row = cell.get(source)
        at = by_level.get((mechanism, level), {})
        if row is None or not np.isfinite(row["rank1"]) or not set(DESCRIPTORS) <= at.keys():
            continue
        rows.append(
            {"mechanism": mechanism, "level": np.nan if level is None else level}
            | {key: row[key] for key in ("rank1", "ci_low", "ci_high")}
            | at
        )
    return pd.DataFrame(rows)


def curves_figure(curves: pd.DataFrame, summary: pd.DataFrame, *, dataset: str) -> Figure | None:
    """Return misses against false alarms of every predictor, at raw, FID and alike fixed noise.

    A marker is where a robot stands that decides as the paper's. None without curves.
    """
    of = curves[curves["dataset"] == dataset]
    wheres = [
        where
        for where in compared_levels(summary, dataset=dataset)
        if not _level_rows(of, where).empty
    ]
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
        ax.set_title(_where_title(where))
        for name, look in zip(predictors, LOOKS, strict=False):
            rows = _level_rows(of, where)
            rows = rows[rows["consumer"] == name]
            for score, part in rows.groupby("score", sort=False):
                ax.plot(
                    _PERCENT * part["false_alarm_rate"],
                    _PERCENT * part["missed_conflict_rate"],
                    color=look.colour,
                    linestyle="-" if score == "separation" else (0, (3, 1.5)),
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
        figure_style.black_handle("by predicted separation", dashes="-"),
        figure_style.black_handle("by conflict probability", dashes=(0, (3, 1.5))),
        figure_style.black_handle("as the paper's robot decides", marker="o", hollow=True),
    ]
    figure_style.legend_in_rows(figure, handles, columns=4)
    figure_style.title(figure, dataset=dataset, what="misses against false alarms", one_line=True)
    return figure


def compared_levels(summary: pd.DataFrame, *, dataset: str) -> list[Where]:
    """Return raw, the strictest FID level and the fixed one that costs as much, for each rule."""
    rates = summary[(summary["dataset"] == dataset) & (summary["metric"] == RATE)]
    rates = rates[rates["value"].notna()]
    if rates.empty:
        return []
    rates = rates[rates["consumer"] == rates["consumer"].iloc[0]]
    wheres: list[Where] = [("raw", None)] if (rates["mechanism"] == "raw").any() else []
    for suffix in ADDING_SUFFIX.values():
        fid, fixed = (rates[rates["mechanism"] == f"{name}{suffix}"] for name in SWEPT)
        target = None
        if not fid.empty:
            strictest = fid.loc[fid["level"].idxmin()]
            target = float(strictest["value"])
            wheres.append((f"{FID.name}{suffix}", float(strictest["level"])))
        if not fixed.empty:
            distance = (fixed["value"] - (fixed["value"].max() if target is None else target)).abs()
            wheres.append((f"{FIXED.name}{suffix}", float(fixed.loc[distance.idxmin(), "level"])))
    return wheres


def _short(source: Source) -> str:
    return shortened(source.label, room=figure_style.NAME_LENGTH)


def _on(rows: pd.DataFrame, scheme: Scheme, *, rule: str) -> pd.DataFrame:
    named = rows["mechanism"] == f"{scheme.name}{ADDING_SUFFIX[rule]}"
    positive = rows["level"] > 0 if scheme.log else rows["level"].notna()
    found: pd.DataFrame = rows[named & positive & np.isfinite(rows["value"])].sort_values("level")
    return found


def _level_rows(frame: pd.DataFrame, where: Where) -> pd.DataFrame:
    mechanism, level = where
    at = frame["level"].isna() if level is None else np.isclose(frame["level"], level)
    return frame[(frame["mechanism"] == mechanism) & at]


def _where_title(where: Where) -> str:
    mechanism, level = where
    if level is None:
        return mechanism
    name = {FID.name: f"FID, η = {level:g}", FIXED.name: f"fixed, {level:g} m"}
    rule = rule_of(mechanism)
    return f"{name.get(family(mechanism), f'{mechanism} {level:g}')}, {rule}"


def _mark_operating(
    ax: Axes, summary: pd.DataFrame, where: Where, *, predictor: str, look: Look
) -> None:
    rows = _level_rows(summary[summary["consumer"] == predictor], where)
    value = rows.drop_duplicates("metric").set_index("metric")["value"]
    if {"false_alarm_rate", RATE} <= set(value.index):
        ax.plot(
            [_PERCENT * float(value["false_alarm_rate"])],
            [_PERCENT * float(value[RATE])],
            look.marker,
            color=look.colour,
            markerfacecolor="white",
            markersize=4.5,
            zorder=3,
        )


def _draw_dissociation(
    ax: Axes, points: pd.DataFrame, *, rule: str, metric: str, controls: Sequence[str]
) -> None:
    scale = SHOWN[metric].scale
    for scheme, look in _SCHEME_LOOKS.items():
        name = f"{scheme.name}{ADDING_SUFFIX[rule]}"
        rows = points[points["mechanism"] == name].sort_values("level")
        ax.plot(
            scale * rows[metric],
            _PERCENT * rows["rank1"],
            color=look.colour,
            marker=look.marker,
            linestyle=look.dashes,
            zorder=2.5,
        )
        _bars(ax, rows, metric=metric, colour=look.colour)
    raw = points[points["mechanism"] == "raw"]
    ax.plot(
        scale * raw[metric], _PERCENT * raw["rank1"], "*", color="black", markersize=7, zorder=4
    )
    _bars(ax, raw, metric=metric, colour="black")
    labelled = 0
    for place, name in enumerate(controls):
        colour = _CONTROL_COLOURS[place % len(_CONTROL_COLOURS)]
        of = points["mechanism"].map(family) == name
        rows = points[of & points["mechanism"].map(rule_of).isin([rule, ""])]
        _bars(ax, rows, metric=metric, colour=colour)
        ax.plot(
            scale * rows[metric],
            _PERCENT * rows["rank1"],
            _CONTROL_MARKERS[place % len(_CONTROL_MARKERS)],
            color=colour,
            markersize=6.5,
            markeredgecolor="black",
            markeredgewidth=0.6,
            zorder=5,
        )
        for row in rows.to_dict("records"):
            labelled += 1
            if labelled > _MOST_LABELS or np.isnan(row["level"]):
                continue
            # To the side where there is room.
            is_right = row[metric] > _RIGHT * float(points[metric].max())
            ax.annotate(
                ", ".join(
                    filter(
                        None,
                        [figure_style.number(row["level"]), parameters_of(row["mechanism"])],
                    )
                ),
                (scale * row[metric], _PERCENT * row["rank1"]),
                xytext=(-4.5 if is_right else 4.5, 3.0),
                textcoords="offset points",
                horizontalalignment="right" if is_right else "left",
                zorder=6,
            )


def _bars(ax: Axes, rows: pd.DataFrame, *, metric: str, colour: str) -> None:
    """Draw the intervals both ways."""
    scale = SHOWN[metric].scale
    x, left, right = (scale * rows[name] for name in (metric, f"{metric}_low", f"{metric}_high"))
    y, low, high = (_PERCENT * rows[name] for name in ("rank1", "ci_low", "ci_high"))
    segments = [
        *([(a, b), (c, b)] for a, b, c in zip(left, y, right, strict=True)),
        *([(a, b), (a, c)] for a, b, c in zip(x, low, high, strict=True)),
    ]
    known = [one for one in segments if np.isfinite(one).all()]
    ax.add_collection(LineCollection(known, colors=colour, linewidths=0.5, alpha=0.7, zorder=2))


def _second_axis(ax: Axes, values: Any) -> None:  # noqa: ANN401 - (n,) s
    """Give seconds a logarithmic axis that has a zero: who never leaks belongs on it."""
    positive = values[values > 0]
    if not positive.size:
        return
    threshold = 0.7 * float(positive.min())
    has_zero = bool((values <= 0).any())
    ax.set_xscale("symlog", linthresh=threshold, linscale=0.3)
    ax.set_xlim(-0.3 * threshold if has_zero else threshold, 1.5 * float(values.max()))
    ax.xaxis.set_major_locator(FixedLocator([0.0] * has_zero + _SECONDS))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(lambda value, _: figure_style.number(value))


def _dissociation_legend(figure: Figure, points: pd.DataFrame, controls: Sequence[str]) -> None:
    handles: list[Any] = [
        figure_style.line_handle(scheme.title, look) for scheme, look in _SCHEME_LOOKS.items()
    ]
    if (points["mechanism"] == "raw").any():
        handles.append(figure_style.black_handle("raw", marker="*"))
    for place, name in enumerate(controls):
        handle = figure_style.line_handle(
            f"control: {name}",
            Look(
                _CONTROL_COLOURS[place % len(_CONTROL_COLOURS)],
                _CONTROL_MARKERS[place % len(_CONTROL_MARKERS)],
                "",
            ),
        )
        handle.set(markersize=6, markeredgecolor="black", markeredgewidth=0.6)
        handles.append(handle)
    handles.append(figure_style.black_handle("bars: 95 % intervals; number: level", dashes="-"))
    figure_style.legend_in_rows(figure, handles, columns=4)
