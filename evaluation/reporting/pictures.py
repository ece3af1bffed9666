"""Pictures of the page: answers, planes of privacy and utility, and tracks."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from evaluation.estimates.families import RAW
from evaluation.estimates.metrics import MISSED_RATE
from evaluation.plan.address import MechanismLevel, parse_consumer
from evaluation.reporting import takeaways
from evaluation.reporting.amounts import PERCENT, whole_percent
from evaluation.reporting.answers import reference_level
from evaluation.reporting.charts import (
    LOOKS,
    Chart,
    Look,
    Point,
    mechanism_looks,
    plane_chart,
    rows_chart,
)
from evaluation.reporting.glossary import definition
from evaluation.reporting.headline import Headline, HeadlineColumn, choose_levels
from evaluation.reporting.names import (
    INDEPENDENT_MARK,
    INDEPENDENT_NOTE,
    family_name,
    robot_name,
    spec_text,
    task_phrase,
)
from evaluation.verdict.question import MOST_PLR
from isac_track.types import Bools, Floats

_MISSED: Final = "missed conflicts (%)"
_ATTACKED: Final = "PLR after attack (%)"
_REIDENTIFIED: Final = "re-identified people (rank 1, %)"
_SERIES: Final = tuple(Look(place) for place in range(LOOKS))
SIZE: Final = (180.0, 135.0)  # Of a panel of the gallery, in its own units.
_BAR_M: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


class Picture(NamedTuple):
    """A chart with its title, caption, key and note."""

    title: str  # Its subject: a phrase.
    caption: str  # Its finding: a sentence.
    chart: Chart
    key: Mapping[str, Look]  # Look of each named mark.
    note: str = ""  # Meaning of a sign in it.


def pictures(table: Headline) -> list[Picture | None]:
    """Return the picture of each of the five answers; None for an empty picture."""
    where = reference_level(table)
    known = {"as sent": table.shared}
    if table.attacked:
        known["after attack"] = table.attacked
    return [
        _levels(
            table,
            "Conflicts that a robot misses",
            {robot_name(robot.measure.consumer): robot for robot in table.robots},
            x_label=_MISSED,
            caption=takeaways.missed_conflicts(table, where),
        ),
        _levels(
            table,
            f"Positions known to {table.epsilon_m:g} m",
            known,
            x_label=f"positions known to {table.epsilon_m:g} m (%)",
            caption=takeaways.known_positions(table, where),
            law=table.attacked,
        ),
        _levels(
            table,
            "People re-identified by the strongest attack",
            {task_phrase(task.measure.reader.task): task for task in table.linked},
            x_label=_REIDENTIFIED,
            caption=takeaways.linked_people(table, where),
        ),
        _linkage_plane(table),
        _choice_plane(table),
    ]


def _linkage_plane(table: Headline) -> Picture | None:
    """Return re-identification over PLR as shared; None without linkage."""
    if not table.linked:
        return None
    linked = table.linked[-1]
    curves = _curves(table, table.shared, linked)
    title = (
        f"Re-identified {task_phrase(linked.measure.reader.task)}, over PLR as shared"
    )
    return _plane(
        table,
        curves,
        title=title,
        caption=takeaways.unequal_pair(_points(curves)),
        x_label="PLR as shared (%)",
        y_label=_REIDENTIFIED,
    )


def _choice_plane(table: Headline) -> Picture | None:
    """Return PLR after attack over missed conflicts, with the limit on PLR.

    None without attacks or robots.
    """
    if not (table.attacked and table.robots):
        return None
    robot = table.robots[0]
    curves = _curves(table, robot, table.attacked, among=choose_levels(table))
    raw = mechanism_looks([])[RAW]
    noisy = [point for point in _points(curves) if point.look != raw]
    name = robot_name(robot.measure.consumer)
    return _plane(
        table,
        curves,
        title=(
            f"PLR after attack, over what {name} misses; dashed: {PERCENT * MOST_PLR:g} %"
        ),
        caption=takeaways.within_limit(noisy, MOST_PLR) if noisy else "",
        x_label=_MISSED,
        y_label=_ATTACKED,
        limit=MOST_PLR,
    )


def planes(table: Headline) -> dict[str, list[Picture]]:
    """Return the planes of missed conflicts and privacy, by the name of each robot."""
    robots = dict.fromkeys(
        key.consumer for key in table.numbers if key.metric == MISSED_RATE
    )
    metrics = [column for column in (table.attacked, *table.linked[-1:]) if column]
    by_robot: dict[str, list[Picture]] = {}
    for robot in robots:
        drawn = [_front(table, robot, column) for column in metrics]
        if any(drawn):
            by_robot[robot_name(robot)] = [picture for picture in drawn if picture]
    return by_robot


def _front(table: Headline, robot: str, privacy: HeadlineColumn) -> Picture | None:
    """Return all levels over a robot's misses and a privacy metric, with the front."""
    task = privacy.measure.reader.task
    missed = HeadlineColumn("", "", parse_consumer(robot).measured(MISSED_RATE))
    curves = _curves(table, missed, privacy)
    points = _points(curves)
    noun = "share of re-identified people" if task else "PLR after attack"
    title = (
        f"Re-identified {task_phrase(task)}"
        if task
        else "PLR after the strongest attack"
    )
    return _plane(
        table,
        curves,
        title=f"{title}, over what {robot_name(robot)} misses",
        caption=takeaways.on_the_front(points, noun) if points else "",
        x_label=_MISSED,
        y_label=_REIDENTIFIED if task else _ATTACKED,
        has_front=True,
    )


def _levels(
    table: Headline,
    title: str,
    shown: Mapping[str, HeadlineColumn],
    *,
    x_label: str,
    caption: str,
    law: HeadlineColumn | None = None,
) -> Picture | None:
    """Return the levels of the first table as rows, a mark for each number.

    With `law` its number under the isotropic error law stands beside it, where the run
    has it.
    """
    chosen = choose_levels(table)
    levels = [
        where
        for where in chosen
        if any(table.at(where, column) for column in shown.values())
    ]
    if not levels:
        return None
    series = {
        name: [table.at(where, column) for where in levels]
        for name, column in shown.items()
    }
    if law and table.other_law:
        isotropic = [table.at(where, law, other_law=True) for where in levels]
        series["after attack, isotropic errors"] = isotropic
    looks = dict(zip(series, _SERIES, strict=False))
    chart = rows_chart(
        [table.short_name(where) for where in levels],
        {name: (look, series[name]) for name, look in looks.items()},
        x_label=x_label,
        guides=[
            (look, shown[name].chance) for name, look in looks.items() if name in shown
        ],
    )
    families = {where: table.families[where.mechanism] for where in levels}
    chart.hints = {
        text: (
            f"{spec_text(families[where], where.level)}:"
            f" {definition(families[where].family)}"
        )
        for (_, text), where in zip(chart.y_ticks, levels, strict=True)
    }
    is_marked = any(text.endswith(INDEPENDENT_MARK) for _, text in chart.y_ticks)
    note = INDEPENDENT_NOTE if is_marked else ""
    return Picture(title, caption, chart, looks, note)


def _curves(
    table: Headline,
    x: HeadlineColumn,
    y: HeadlineColumn,
    *,
    among: Collection[MechanismLevel] = (),
) -> list[list[Point]]:
    """Return a curve for each mechanism, of the levels at which both numbers are known.

    `among` are the levels to draw, by default all.
    """
    ordered = sorted(among or table.levels, key=lambda where: where.level or 0.0)
    curves = list[list[Point]]()
    for mechanism, look in mechanism_looks(table.families.values()).items():
        points = []
        for where in ordered:
            x_value, y_value = table.at(where, x), table.at(where, y)
            if where.mechanism == mechanism and x_value and y_value:
                points.append(Point(look, table.name(where), x_value, y_value))
        if points:
            curves.append(points)
    return curves


def _points(curves: Iterable[Sequence[Point]]) -> list[Point]:
    return [point for curve in curves for point in curve]


def _plane(
    table: Headline,
    curves: Sequence[Sequence[Point]],
    *,
    title: str,
    caption: str,
    x_label: str,
    y_label: str,
    has_front: bool = False,
    limit: float | None = None,
) -> Picture | None:
    """Return the curves on two axes with their key; None without any."""
    if not curves:
        return None
    chart = plane_chart(
        curves, x_label=x_label, y_label=y_label, has_front=has_front, limit=limit
    )
    drawn = {curve[0].look for curve in curves}
    key = {
        family_name(table.families[mechanism]): look
        for mechanism, look in mechanism_looks(table.families.values()).items()
        if look in drawn
    }
    return Picture(title, caption, chart, key)


class Panel(NamedTuple):
    """One person under one mechanism, in the gallery of tracks."""

    person: int
    mechanism: str
    shared: float
    rebuilt: float  # Shares of samples that leak.
    # Class and lines, (L, 2) each, of each layer.
    paths: Sequence[tuple[str, Sequence[Floats]]]
    bar: tuple[float, str]  # Length and text of the scale bar.


def walks_takeaway(walks: Sequence[Panel]) -> str:
    """Return the leaked shares of the walks under noise, as sent and as rebuilt.

    Empty without noise.
    """
    noisy = [walk for walk in walks if walk.mechanism != RAW]
    if not noisy:
        return ""
    sent = float(np.mean([walk.shared for walk in noisy]))
    rebuilt = float(np.mean([walk.rebuilt for walk in noisy]))
    return (
        f"Under noise these walks leak {whole_percent(sent)} as sent and"
        f" {whole_percent(rebuilt)} rebuilt."
    )


def panels(rows: pd.DataFrame) -> list[Panel]:
    """Return a panel for each person and mechanism of `gallery.parquet`, by person."""
    drawn = []
    for person, walks in rows.groupby("track", sort=False):
        low, unit = _window(walks)
        length = max(
            (bar for bar in _BAR_M if bar * unit < 0.3 * SIZE[0]), default=_BAR_M[0]
        )
        for mechanism, walk in walks.groupby("mechanism", sort=False):
            drawn.append(
                Panel(
                    person=int(str(person)) + 1,
                    mechanism=str(mechanism),
                    shared=float(walk["leaked_shared"].mean()),
                    rebuilt=float(walk["leaked_rec"].mean()),
                    paths=_paths(walk, low, unit),
                    bar=(length * unit, f"{length:g} m"),
                )
            )
    return drawn


def _paths(
    walk: pd.DataFrame, low: Floats, unit: float
) -> list[tuple[str, Sequence[Floats]]]:
    """Return the layers of a panel from below: class and lines, in its units."""

    def positions(name: str) -> Floats:
        places = walk[[f"x_{name}", f"y_{name}"]].to_numpy() - low
        scaled: Floats = places * unit * [1.0, -1.0] + [0.0, SIZE[1]]
        return scaled

    true, shared, rebuilt = positions("true"), positions("shared"), positions("rec")
    leaks_shared = walk["leaked_shared"].to_numpy()
    leaks_rebuilt = walk["leaked_rec"].to_numpy()
    return [
        ("shared", [*shared[~leaks_shared, None]]),
        ("rebuilt leak", _runs(rebuilt, leaks_rebuilt)),
        ("rebuilt", [rebuilt]),
        ("shared leak", [*shared[leaks_shared, None]]),
        ("true", [true]),
    ]


def _window(walks: pd.DataFrame) -> tuple[Floats, float]:
    """Return the lower left corner in m, and units of a panel per metre."""
    # Not all shared samples: a few far samples would make the walk tiny.
    ends = [
        np.percentile(walks[["x_shared", "y_shared"]].to_numpy(), [5.0, 95.0], axis=0)
    ]
    for name in ("true", "rec"):
        walk = walks[[f"x_{name}", f"y_{name}"]].to_numpy()
        ends.append(np.stack([walk.min(axis=0), walk.max(axis=0)]))
    low, high = np.min(ends, axis=0)[0] - 0.2, np.max(ends, axis=0)[1] + 0.2
    unit = float(np.min(np.array(SIZE) / np.maximum(high - low, 1.0)))
    corner: Floats = 0.5 * (low + high) - 0.5 * np.array(SIZE) / unit
    return corner, unit


def _runs(places: Floats, drawn: Bools) -> list[Floats]:
    """Return the lines through the drawn points, with gaps at the others."""
    edges = np.flatnonzero(np.diff(drawn)) + 1
    runs = zip(np.split(places, edges), np.split(drawn, edges), strict=True)
    return [run for run, on in runs if on[0]]
