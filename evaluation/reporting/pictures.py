"""The pictures of the page: one for each question, the plane of privacy and utility, and tracks."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from evaluation.analysis.keys import Measure, Where
from evaluation.analysis.metrics import MISSED_RATE
from evaluation.reporting.charts import LOOKS, Chart, Look, Point, looks_of, plane_chart, rows_chart
from evaluation.reporting.headline import Headline, Shown, levels_of
from evaluation.reporting.names import robot_name
from evaluation.verdict.what_to_share import MOST_PLR
from isac_track.types import Bools, Floats

_MISSED: Final = "missed conflicts (%)"
_SERIES: Final = tuple(Look(place) for place in range(LOOKS))
SIZE: Final = (180.0, 135.0)  # Of a panel of the gallery, in its own units.
_BAR_M: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


class Picture(NamedTuple):
    """A chart, and what stands around it."""

    title: str
    chart: Chart
    key: Mapping[str, Look]  # What each mark is of.


def pictures(of: Headline) -> list[Picture | None]:
    """Return the picture of each of the five answers; None where a run has nothing to draw."""
    missed = {robot_name(one.measure.consumer): one for one in of.robots}
    known = {"as shared": of.shared}
    if of.attacked:
        known[f"after {of.attacked.measure.source.label}"] = of.attacked
    found = {one.measure.source.task: one for one in of.linked}
    telling = chosen = None
    if of.linked:
        about = ", over PLR as shared: did PLR tell, all would lie on one line"
        x_label = "PLR as shared (%)"
        telling = _plane(of, of.shared, of.linked[-1], about, x_label=x_label, has_hollow=False)
    if of.attacked and of.robots:
        who = robot_name(of.robots[0].measure.consumer)
        about = f", over what {who} misses; dashed: {100 * MOST_PLR:g} %"
        among = levels_of(of)[0]
        chosen = _plane(of, of.robots[0], of.attacked, about, among=among, limit=MOST_PLR)
    return [
        _levels(of, "Conflicts that a robot misses", missed, _MISSED),
        _levels(
            of, f"Positions known to {of.epsilon_m:g} m", known, "positions known (%)", of.attacked
        ),
        _levels(of, "People found again by the strongest attack", found, "found again (rank 1, %)"),
        telling,
        chosen,
    ]


def planes(of: Headline) -> dict[str, list[Picture]]:
    """Return missed conflicts against what is left, for each robot: all mechanisms of the run."""
    found: dict[str, list[Picture]] = {}
    for robot in dict.fromkeys(key.consumer for key in of.numbers if key.metric == MISSED_RATE):
        missed = Shown("", "", Measure(robot, MISSED_RATE))
        for one in filter(None, [of.attacked, *of.linked[-1:]]):
            if picture := _plane(of, missed, one, has_front=True):
                found.setdefault(robot_name(robot), []).append(picture)
    return found


def _levels(
    of: Headline, title: str, shown: Mapping[str, Shown], x_label: str, law: Shown | None = None
) -> Picture | None:
    """Return the levels of the first table as rows, a mark for each number."""
    every, _ = levels_of(of)
    levels = [where for where in every if any(of.at(where, one) for one in shown.values())]
    if not levels:
        return None
    found = {name: [of.at(where, one) for where in levels] for name, one in shown.items()}
    if law and of.other_law:
        isotropic = [of.at(where, law, other_law=True) for where in levels]
        found["the same, isotropic error"] = isotropic
    looks = dict(zip(found, _SERIES, strict=False))
    chart = rows_chart(
        [of.name(where) for where in levels],
        {name: (look, found[name]) for name, look in looks.items()},
        x_label=x_label,
        across=[(look, shown[name].chance) for name, look in looks.items() if name in shown],
    )
    return Picture(title, chart, looks)


def _plane(
    of: Headline,
    x: Shown,
    y: Shown,
    about: str = "",
    *,
    x_label: str = _MISSED,
    among: Collection[Where] = (),
    has_hollow: bool = True,
    **drawn: Any,  # noqa: ANN401 - see `plane_chart`
) -> Picture | None:
    """Return the levels, all or those `among` them, at which both are known; None without any."""
    ordered = sorted(among or of.wheres, key=lambda where: where[1] or 0.0)
    curves, key = list[list[Point]](), dict[str, Look]()
    for name, look in looks_of(of.known.values()).items():
        pairs = [(at, of.at(at, x), of.at(at, y)) for at in ordered if at[0] == name]
        points = [Point(look, of.name(at), one, other) for at, one, other in pairs if one and other]
        if points and (has_hollow or not look.hollow):
            curves.append(points)
            key[of.name((name, None))] = look
    if not curves:
        return None
    source, others = y.measure.source, "of other families"
    title, label = f"PLR after {source.label}; {others} after the strongest", "PLR after attack (%)"
    if source.task:
        who = f"found again by {source.attack.label}; {others} by the strongest"
        title, label = f"{source.task}: {who}", "found again (rank 1, %)"
    chart = plane_chart(curves, x_label=x_label, y_label=label, **drawn)
    return Picture(title + about, chart, key)


class Panel(NamedTuple):
    """One person under one mechanism, in the gallery of tracks."""

    person: int
    mechanism: str
    shared: float
    rebuilt: float  # Shares of samples that leak.
    paths: Sequence[tuple[str, Sequence[Floats]]]  # Class and lines, (L, 2) each, of each layer.
    bar: tuple[float, str]  # How long a metre or a few are.


def panels(rows: pd.DataFrame) -> list[Panel]:
    """Return a panel for each person and mechanism of `gallery.parquet`, person by person."""
    found = []
    for person, of in rows.groupby("track", sort=False):
        low, unit = _window(of)
        length = max((one for one in _BAR_M if one * unit < 0.3 * SIZE[0]), default=_BAR_M[0])
        bar = length * unit, f"{length:g} m"
        for mechanism, part in of.groupby("mechanism", sort=False):
            places = {
                what: (part[[f"x_{what}", f"y_{what}"]].to_numpy() - low) * unit * [1.0, -1.0]
                + [0.0, SIZE[1]]
                for what in ("true", "shared", "rec")
            }
            leaked, kept = (part[f"leaked_{what}"].to_numpy() for what in ("shared", "rec"))
            paths = [
                ("shared", [*places["shared"][~leaked, None]]),
                ("rebuilt leak", _runs(places["rec"], kept)),
                ("rebuilt", [places["rec"]]),
                ("shared leak", [*places["shared"][leaked, None]]),
                ("true", [places["true"]]),
            ]
            about = int(str(person)) + 1, str(mechanism), float(leaked.mean()), float(kept.mean())
            found.append(Panel(*about, paths, bar))
    return found


def _window(of: pd.DataFrame) -> tuple[Floats, float]:
    """Return the lower left corner in m, and units of a panel in a metre."""
    # Not all that was shared: a few far samples would make the walk tiny.
    ends = [np.percentile(of[["x_shared", "y_shared"]].to_numpy(), [5.0, 95.0], axis=0)]
    for what in ("true", "rec"):
        walk = of[[f"x_{what}", f"y_{what}"]].to_numpy()
        ends.append(np.stack([walk.min(axis=0), walk.max(axis=0)]))
    low, high = np.min(ends, axis=0)[0] - 0.2, np.max(ends, axis=0)[1] + 0.2
    unit = float(np.min(np.array(SIZE) / np.maximum(high - low, 1.0)))
    corner: Floats = 0.5 * (low + high) - 0.5 * np.array(SIZE) / unit
    return corner, unit


def _runs(places: Floats, drawn: Bools) -> list[Floats]:
    """Return the lines through some of the points, with gaps where others are."""
    edges = np.flatnonzero(np.diff(drawn)) + 1
    runs = zip(np.split(places, edges), np.split(drawn, edges), strict=True)
    return [run for run, on in runs if on[0]]
