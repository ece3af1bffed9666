"""The pictures of the page: one for each question, and the plane of privacy and utility."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from evaluation.analysis.families import CLEAN, FID, FIXED, RAW
from evaluation.analysis.keys import AS_SHARED, Measure
from evaluation.analysis.matching import MISSED
from evaluation.analysis.metrics import EXPOSURE, MISSED_RATE
from evaluation.reporting.charts import LOOKS, Chart, Look, Point, plane_chart, rows_chart
from evaluation.reporting.headline import ROBOTS
from evaluation.reporting.rows import of_source
from isac_track.intervals import Estimate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from evaluation.analysis.keys import Where
    from evaluation.reporting.headline import Headline, Shown
    from evaluation.reporting.rows import Results

_SERIES: Final = tuple(Look(place) for place in range(LOOKS))


class Picture(NamedTuple):
    """A chart, and what stands around it."""

    title: str
    chart: Chart
    key: Mapping[str, Look]
    """What each mark is of."""


def pictures(run: Results, of: Headline) -> list[Picture | None]:
    """Return the picture of each of the five answers; None where a run has nothing to draw."""
    after = [of.attacked] if of.attacked else []
    missed = {_robot(one.measure.consumer): one for one in of.robots}
    known = {"as shared": of.shared} | {f"after {one.measure.source.label}": one for one in after}
    found = {one.measure.source.task: one for one in of.linked}
    return [
        _levels(of, "Conflicts that a robot misses", missed, "missed conflicts (%)"),
        _levels(of, "Positions known to 0.3 m", known, "positions known (%)"),
        _levels(of, "People found again by the strongest attack", found, "rank 1 (%)"),
        _telling(of),
        _prices(run, of),
    ]


def planes(of: Headline) -> dict[str, list[Picture]]:
    """Return missed conflicts against what is left, for each robot: all mechanisms of the run."""
    robots = [one.consumer for one in _measures(of) if one.metric == MISSED_RATE]
    looks, found = _looks(of), {}
    for robot in dict.fromkeys(robots):
        for one in [*([of.attacked] if of.attacked else []), *of.linked[-1:]]:
            points = _points(of, Measure(robot, MISSED_RATE), one.measure, looks)
            if points:
                title, label = _left(one)
                chart = plane_chart(
                    [point for curve in points for point in curve],
                    x_label="missed conflicts (%)",
                    y_label=label,
                    curves=[curve for curve in points if len(curve) > 1],
                    has_front=True,
                )
                found.setdefault(_robot(robot), []).append(Picture(title, chart, _key(of, looks)))
    return found


def _levels(of: Headline, title: str, shown: Mapping[str, Shown], x_label: str) -> Picture | None:
    """Return the levels of the first table as rows, a mark for each number."""
    series = {
        name: (look, [of.at(where, one) for where in of.levels])
        for (name, one), look in zip(shown.items(), _SERIES, strict=False)
    }
    if not any(one for _, values in series.values() for one in values):
        return None
    rows = [of.name(where) for where in of.levels]
    chances = {
        f"chance, {name}: {100 * one.chance:.1f} %": (look, one.chance)
        for (name, one), look in zip(shown.items(), _SERIES, strict=False)
        if np.isfinite(one.chance)
    }
    chart = rows_chart(rows, series, x_label=x_label, across=chances)
    return Picture(title, chart, {name: look for name, (look, _) in series.items()})


def _telling(of: Headline) -> Picture | None:
    """Return rank 1 over PLR as shared: on one line, the descriptor would tell."""
    looks = {name: look for name, look in _looks(of).items() if not look.hollow}
    points = [
        curve
        for one in of.linked[-1:]
        for curve in _points(of, AS_SHARED.measure(EXPOSURE), one.measure, looks)
    ]
    if not points:
        return None
    title, label = _left(of.linked[-1])
    chart = plane_chart(
        [point for curve in points for point in curve],
        x_label="PLR as shared (%)",
        y_label=label,
        curves=[curve for curve in points if len(curve) > 1],
    )
    title = f"{title}, over PLR as shared: did PLR tell, all would lie on one line"
    return Picture(title, chart, _key(of, looks))


def _prices(run: Results, of: Headline) -> Picture | None:
    """Return what is left after attack where a robot misses so many conflicts more."""
    if of.attacked is None or not of.robots:
        return None
    robot = of.robots[0].measure.consumer
    rows = of_source(run.frontier, of.attacked.measure.source)
    rows = rows[(rows["robot"] == robot) & (rows["criterion"] == MISSED)]
    targets, looks = sorted(rows["target"].unique()), _looks(of)
    series = {}
    for name in rows["mechanism"].unique():
        at = rows[rows["mechanism"] == name].set_index("target")[["value", "ci_low", "ci_high"]]
        values = [Estimate(*(float(end) for end in at.loc[target])) for target in targets]
        known = [one if np.isfinite(one.value) else None for one in values]
        if name in looks and any(known):
            series[of.name((name, None))] = looks[name], known
    if not series:
        return None
    names = [f"+{100 * target:g} points" for target in targets]
    chart = rows_chart(names, series, x_label="PLR after attack (%)")
    title = f"PLR after attack where {_robot(robot)} misses 3 to 10 points more than on raw"
    return Picture(title, chart, {name: look for name, (look, _) in series.items()})


def _points(of: Headline, x: Measure, y: Measure, looks: Mapping[str, Look]) -> list[list[Point]]:
    """Return the levels of each mechanism at which both are known, levels rising."""
    wheres: dict[str, list[Where]] = {}
    for where in dict.fromkeys(key.where for key in of.found):
        wheres.setdefault(where[0], []).append(where)
    found = []
    for name, look in looks.items():
        ordered = sorted(wheres.get(name, ()), key=lambda where: where[1] or 0.0)
        pairs = [(at, of.found.get(x.at(*at)), of.found.get(y.at(*at))) for at in ordered]
        points = [
            Point(look, of.name(at), one, other)
            for at, one, other in pairs
            if one and other and np.isfinite([one.value, other.value]).all()
        ]
        found += [points] * bool(points)
    return found


def _looks(of: Headline) -> dict[str, Look]:
    """Return the look of every mechanism: its rule is hollow or not, raw is a star."""
    names = [one.name for one in of.known.values() if one.family not in (RAW, CLEAN, FID, FIXED)]
    places = {name: place for place, name in enumerate(dict.fromkeys([FID, FIXED, *names]))}
    return {
        mechanism: Look(places[one.name] % (LOOKS - 1), one.adding == "independent")
        if one.family != RAW
        else Look(LOOKS - 1)
        for mechanism, one in of.known.items()
        if one.family != CLEAN
    }


def _key(of: Headline, looks: Mapping[str, Look]) -> dict[str, Look]:
    return {of.name((name, None)): look for name, look in looks.items()}


def _left(one: Shown) -> tuple[str, str]:
    source = one.measure.source
    if source.task:
        return f"{source.task}: found again by {source.attack.label}", "rank 1 (%)"
    return f"PLR after {source.label}", "PLR after attack (%)"


def _robot(consumer: str) -> str:
    return ROBOTS.get(consumer, consumer)


def _measures(of: Headline) -> Sequence[Measure]:
    return list(dict.fromkeys(key.measure for key in of.found))
