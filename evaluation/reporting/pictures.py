"""The pictures of the page: one for each question, the plane of privacy and utility, and tracks."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from evaluation.estimates.families import RAW
from evaluation.estimates.keys import Measure, Where
from evaluation.estimates.metrics import MISSED_RATE
from evaluation.reporting import takeaways
from evaluation.reporting.answers import reference
from evaluation.reporting.charts import (
    LOOKS,
    PERCENT,
    Chart,
    Look,
    Point,
    looks_of,
    plane_chart,
    rows_chart,
)
from evaluation.reporting.glossary import definition
from evaluation.reporting.headline import Headline, Shown, levels_of
from evaluation.reporting.names import (
    INDEPENDENT_MARK,
    INDEPENDENT_NOTE,
    family_name,
    robot_name,
    short_mechanism_name,
    spec_text,
    task_phrase,
)
from evaluation.reporting.takeaways import level_name
from evaluation.verdict.what_to_share import MOST_PLR
from isac_track.types import Bools, Floats

_MISSED: Final = "missed conflicts (%)"
_ATTACKED: Final = "PLR after attack (%)"
_REIDENTIFIED: Final = "re-identified people (rank 1, %)"
_SERIES: Final = tuple(Look(place) for place in range(LOOKS))
SIZE: Final = (180.0, 135.0)  # Of a panel of the gallery, in its own units.
_BAR_M: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


class Picture(NamedTuple):
    """A chart, and what stands around it."""

    title: str  # What it shows: a phrase.
    caption: str  # What its numbers say: a sentence.
    chart: Chart
    key: Mapping[str, Look]  # What each mark is of.
    note: str = ""  # What a sign in it means.


def pictures(table: Headline) -> list[Picture | None]:
    """Return the picture of each of the five answers; None where a run has nothing to draw."""
    where = reference(table)
    known = {"as sent": table.shared}
    if table.attacked:
        known["after attack"] = table.attacked
    return [
        _levels(
            table,
            "Conflicts that a robot misses",
            {robot_name(robot.measure.consumer): robot for robot in table.robots},
            x_label=_MISSED,
            caption=takeaways.missed(table, where),
        ),
        _levels(
            table,
            f"Positions known to {table.epsilon_m:g} m",
            known,
            x_label=f"positions known to {table.epsilon_m:g} m (%)",
            caption=takeaways.known(table, where),
            law=table.attacked,
        ),
        _levels(
            table,
            "People re-identified by the strongest attack",
            {task_phrase(task.measure.source.task): task for task in table.linked},
            x_label=_REIDENTIFIED,
            caption=takeaways.linked(table, where),
        ),
        _telling(table),
        _chosen(table),
    ]


def _telling(table: Headline) -> Picture | None:
    """Return re-identification over PLR as shared, at all levels; None without linkage."""
    if not table.linked:
        return None
    linked = table.linked[-1]
    curves = _curves(table, table.shared, linked)
    title = (
        f"Re-identified {task_phrase(linked.measure.source.task)}, over PLR as shared"
    )
    return _plane(
        table,
        curves,
        title=title,
        caption=takeaways.unequal_pair(_points(curves)),
        x_label="PLR as shared (%)",
        y_label=_REIDENTIFIED,
    )


def _chosen(table: Headline) -> Picture | None:
    """Return PLR after attack over what a robot misses, with the limit; None without both."""
    if not (table.attacked and table.robots):
        return None
    robot = table.robots[0]
    curves = _curves(table, robot, table.attacked, among=levels_of(table)[0])
    noisy = [point for point in _points(curves) if point.look != looks_of([])[RAW]]
    name = robot_name(robot.measure.consumer)
    return _plane(
        table,
        curves,
        title=(
            f"PLR after attack, over what {name} misses; dashed: {100 * MOST_PLR:g} %"
        ),
        caption=takeaways.within_limit(noisy, MOST_PLR) if noisy else "",
        x_label=_MISSED,
        y_label=_ATTACKED,
        limit=MOST_PLR,
    )


def planes(table: Headline) -> dict[str, list[Picture]]:
    """Return missed conflicts against privacy, by the name of each robot: all levels of the run."""
    robots = dict.fromkeys(
        key.consumer for key in table.numbers if key.metric == MISSED_RATE
    )
    privacy = [shown for shown in (table.attacked, *table.linked[-1:]) if shown]
    return {
        robot_name(robot): drawn
        for robot in robots
        if (drawn := [x for shown in privacy if (x := _front(table, robot, shown))])
    }


def _front(table: Headline, robot: str, privacy: Shown) -> Picture | None:
    """Return all levels in the plane of a robot's misses and a privacy metric, with the front."""
    task = privacy.measure.source.task
    curves = _curves(table, Shown("", "", Measure(robot, MISSED_RATE)), privacy)
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
    shown: Mapping[str, Shown],
    *,
    x_label: str,
    caption: str,
    law: Shown | None = None,
) -> Picture | None:
    """Return the levels of the first table as rows, a mark for each number.

    With `law` its number under the isotropic error law stands beside it, where the run
    has it.
    """
    every, _ = levels_of(table)
    levels = [
        where for where in every if any(table.at(where, one) for one in shown.values())
    ]
    if not levels:
        return None
    found = {
        name: [table.at(where, one) for where in levels] for name, one in shown.items()
    }
    if law and table.other_law:
        isotropic = [table.at(where, law, other_law=True) for where in levels]
        found["after attack, isotropic errors"] = isotropic
    looks = dict(zip(found, _SERIES, strict=False))
    chart = rows_chart(
        [short_mechanism_name(table.known[where[0]], where[1]) for where in levels],
        {name: (look, found[name]) for name, look in looks.items()},
        x_label=x_label,
        across=[
            (look, shown[name].chance) for name, look in looks.items() if name in shown
        ],
    )
    families = {where: table.known[where[0]] for where in levels}
    chart.hints = {
        text: (
            f"{spec_text(families[where], where[1])}:"
            f" {definition(families[where].family)}"
        )
        for (_, text), where in zip(chart.y_ticks, levels, strict=True)
    }
    is_marked = any(text.endswith(INDEPENDENT_MARK) for _, text in chart.y_ticks)
    note = INDEPENDENT_NOTE if is_marked else ""
    return Picture(title, caption, chart, looks, note)


def _curves(
    table: Headline, x: Shown, y: Shown, *, among: Collection[Where] = ()
) -> list[list[Point]]:
    """Return the levels, all or those `among` them, at which both are known: by mechanism."""
    ordered = sorted(among or table.wheres, key=lambda where: where[1] or 0.0)
    curves = list[list[Point]]()
    for mechanism, look in looks_of(table.known.values()).items():
        of_mechanism = [where for where in ordered if where[0] == mechanism]
        pairs = [
            (where, table.at(where, x), table.at(where, y)) for where in of_mechanism
        ]
        points = [
            Point(look, level_name(table, where), left, right)
            for where, left, right in pairs
            if left and right
        ]
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
        family_name(table.known[mechanism]): look
        for mechanism, look in looks_of(table.known.values()).items()
        if look in drawn
    }
    return Picture(title, caption, chart, key)


class Panel(NamedTuple):
    """One person under one mechanism, in the gallery of tracks."""

    person: int
    mechanism: str
    shared: float
    rebuilt: float  # Shares of samples that leak.
    paths: Sequence[
        tuple[str, Sequence[Floats]]
    ]  # Class and lines, (L, 2) each, of each layer.
    bar: tuple[float, str]  # How long a metre or a few are.


def walks_takeaway(walks: Sequence[Panel]) -> str:
    """Return how much of the walks leaks as sent and rebuilt, under noise; empty without noise."""
    noisy = [walk for walk in walks if walk.mechanism != RAW]
    if not noisy:
        return ""
    sent = PERCENT * float(np.mean([walk.shared for walk in noisy]))
    rebuilt = PERCENT * float(np.mean([walk.rebuilt for walk in noisy]))
    return (
        f"Under noise these walks leak {sent:.0f} % as sent and {rebuilt:.0f} %"
        " rebuilt."
    )


def panels(rows: pd.DataFrame) -> list[Panel]:
    """Return a panel for each person and mechanism of `gallery.parquet`, person by person."""
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
    """Return the layers of a panel from below: the class of each, and its lines in its units."""
    true, shared, rebuilt = (
        (walk[[f"x_{name}", f"y_{name}"]].to_numpy() - low) * unit * [1.0, -1.0]
        + [0.0, SIZE[1]]
        for name in ("true", "shared", "rec")
    )
    leaks_shared, leaks_rebuilt = (
        walk[f"leaked_{name}"].to_numpy() for name in ("shared", "rec")
    )
    return [
        ("shared", [*shared[~leaks_shared, None]]),
        ("rebuilt leak", _runs(rebuilt, leaks_rebuilt)),
        ("rebuilt", [rebuilt]),
        ("shared leak", [*shared[leaks_shared, None]]),
        ("true", [true]),
    ]


def _window(walks: pd.DataFrame) -> tuple[Floats, float]:
    """Return the lower left corner in m, and units of a panel in a metre."""
    # Not all shared samples: a few far ones would make the walk tiny.
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
