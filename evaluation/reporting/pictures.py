"""The pictures of the page: one for each question, and the plane of privacy and utility."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from evaluation.analysis.keys import AS_SHARED, Measure, Where
from evaluation.analysis.metrics import EXPOSURE, MISSED_RATE
from evaluation.reporting.answers import LIMIT
from evaluation.reporting.charts import LOOKS, Chart, Look, Point, looks_of, plane_chart, rows_chart
from evaluation.reporting.headline import Headline, Shown, levels_of, robot_name

_MISSED: Final = "missed conflicts (%)"
_SERIES: Final = tuple(Look(place) for place in range(LOOKS))


class Picture(NamedTuple):
    """A chart, and what stands around it."""

    title: str
    chart: Chart
    key: Mapping[str, Look]  # What each mark is of.


def pictures(of: Headline) -> list[Picture | None]:
    """Return the picture of each of the five answers; None where a run has nothing to draw."""
    after = [of.attacked] if of.attacked else []
    missed = {robot_name(one.measure.consumer): one for one in of.robots}
    known = {"as shared": of.shared} | {f"after {one.measure.source.label}": one for one in after}
    found = {one.measure.source.task: one for one in of.linked}
    return [
        _levels(of, "Conflicts that a robot misses", missed, _MISSED),
        _levels(of, "Positions known to 0.3 m", known, "positions known (%)", of.attacked),
        _levels(of, "People found again by the strongest attack", found, "found again (rank 1, %)"),
        _telling(of),
        _chosen(of),
    ]


def planes(of: Headline) -> dict[str, list[Picture]]:
    """Return missed conflicts against what is left, for each robot: all mechanisms of the run."""
    robots = [key.consumer for key in of.found if key.metric == MISSED_RATE]
    looks = looks_of(of.known.values())
    found: dict[str, list[Picture]] = {}
    for robot in dict.fromkeys(robots):
        for one in [*([of.attacked] if of.attacked else []), *of.linked[-1:]]:
            curves = _points(of, Measure(robot, MISSED_RATE), one.measure, looks)
            if curves:
                title, label = _left(one)
                chart = plane_chart(curves, x_label=_MISSED, y_label=label, has_front=True)
                picture = Picture(title, chart, _key(of, curves))
                found.setdefault(robot_name(robot), []).append(picture)
    return found


def _levels(
    of: Headline,
    title: str,
    shown: Mapping[str, Shown],
    x_label: str,
    other_law: Shown | None = None,
) -> Picture | None:
    """Return the levels of the first table as rows, a mark for each number."""
    every, _ = levels_of(of)
    levels = [where for where in every if any(of.at(where, one) for one in shown.values())]
    found = {name: [of.at(where, one) for where in levels] for name, one in shown.items()}
    if other_law and of.other_law:
        isotropic = [of.at(where, other_law, other_law=True) for where in levels]
        found["the same, isotropic error"] = isotropic
    series = {
        name: (look, values) for (name, values), look in zip(found.items(), _SERIES, strict=False)
    }
    rows = [of.name(where) for where in levels]
    if not rows:
        return None
    chances = [(look, one.chance) for one, look in zip(shown.values(), _SERIES, strict=False)]
    chart = rows_chart(rows, series, x_label=x_label, across=chances)
    return Picture(title, chart, {name: look for name, (look, _) in series.items()})


def _telling(of: Headline) -> Picture | None:
    """Return rank 1 over PLR as shared: on one line, the descriptor would tell."""
    looks = {name: look for name, look in looks_of(of.known.values()).items() if not look.hollow}
    for one in of.linked[-1:]:
        if curves := _points(of, AS_SHARED.measure(EXPOSURE), one.measure, looks):
            title, label = _left(one)
            chart = plane_chart(curves, x_label="PLR as shared (%)", y_label=label)
            title += ", over PLR as shared: did PLR tell, all would lie on one line"
            return Picture(title, chart, _key(of, curves))
    return None


def _chosen(of: Headline) -> Picture | None:
    """Return what the levels of the first table cost and leave, and the limit of the answer."""
    if of.attacked is None or not of.robots:
        return None
    looks, robot = looks_of(of.known.values()), of.robots[0].measure
    curves = _points(of, robot, of.attacked.measure, looks, levels_of(of)[0])
    if not curves:
        return None
    title, label = _left(of.attacked)
    chart = plane_chart(curves, x_label=_MISSED, y_label=label, limit=LIMIT)
    title = f"{title}, over what {robot_name(robot.consumer)} misses; dashed: {100 * LIMIT:g} %"
    return Picture(title, chart, _key(of, curves))


def _points(
    of: Headline, x: Measure, y: Measure, looks: Mapping[str, Look], among: Iterable[Where] = ()
) -> list[list[Point]]:
    """Return the levels of each mechanism at which both are known, levels rising.

    Of the levels `among` them, by default of all.
    """
    wheres: dict[str, list[Where]] = {}
    for where in among or dict.fromkeys(key.where for key in of.found):
        wheres.setdefault(where[0], []).append(where)
    found = []
    for name, look in looks.items():
        ordered = sorted(wheres.get(name, ()), key=lambda where: where[1] or 0.0)
        pairs = [(at, of.found.get(x.at(*at)), of.found.get(y.at(*at))) for at in ordered]
        points = [
            Point(look, name, of.name(at), one, other)
            for at, one, other in pairs
            if one and other and np.isfinite([one.value, other.value]).all()
        ]
        found += [points] * bool(points)
    return found


def _key(of: Headline, curves: Sequence[Sequence[Point]]) -> dict[str, Look]:
    """Return what the marks are of."""
    return {of.name((one[0].mechanism, None)): one[0].look for one in curves}


def _left(one: Shown) -> tuple[str, str]:
    source, others = one.measure.source, "of other families"
    if source.task:
        who = f"found again by {source.attack.label}; {others} by the strongest"
        return f"{source.task}: {who}", "found again (rank 1, %)"
    return f"PLR after {source.label}; {others} after the strongest", "PLR after attack (%)"
