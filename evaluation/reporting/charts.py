"""Charts of the page: marks on two axes in a few SVG elements, texts as text.

A chart is as wide as a phone. Colours are classes of the page, so that they change in the dark, and
a mark's shape and filling say the same in grey. Every mark is named.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from evaluation.analysis.frontier import front

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from isac_track.intervals import Estimate

WIDTH: Final = 360.0
CHARACTER: Final = 5.6
"""How wide a character is at most on average, in units of a chart."""
PERCENT: Final = 100.0
_SHAPES: Final = (
    "a3.4 3.4 0 1 0 6.8 0a3.4 3.4 0 1 0-6.8 0",
    "m.4-3v6h6v-6z",
    "m-.6 3h8l-4-7z",
    "m-.8 0l4.2 4.2 4.2-4.2-4.2-4.2z",
    "m-.6-3h8l-4 7z",
    "m0-1.2h2.2v-2.2h2.4v2.2h2.2v2.4h-2.2v2.2h-2.4v-2.2h-2.2z",
    "m.3-3.1l3.1 2.1 3.1-2.1-2.1 3.1 2.1 3.1-3.1-2.1-3.1 2.1 2.1-3.1z",
)
"""Paths that begin 3.4 left of their middle, each of a colour."""
LOOKS: Final = len(_SHAPES)
_STEPS: Final = (1.0, 2.0, 5.0, 10.0, 20.0)
_MOST_TICKS: Final = 6


class Look(NamedTuple):
    """Colour and shape of a mark, and whether it is hollow."""

    place: int
    hollow: bool = False

    @property
    def css(self) -> str:
        """Classes of its mark."""
        return f"mark k{self.place % LOOKS}{' hollow' * self.hollow}"

    def path(self, x: float, y: float) -> str:
        """Return its mark in the middle of a point."""
        return f"M{x - 3.4:.1f} {y:.1f}{_SHAPES[self.place % LOOKS]}"


class Point(NamedTuple):
    """A level on two axes of shares."""

    look: Look
    mechanism: str
    name: str
    x: Estimate
    y: Estimate


@dataclass(eq=False, slots=True)
class Chart:
    """What is drawn, in units of the picture; the template knows how."""

    x_label: str
    height: float
    left: float
    y_label: str = ""
    x_ticks: list[tuple[float, str]] = field(default_factory=list)
    y_ticks: list[tuple[float, str]] = field(default_factory=list)
    grid: str = ""
    lines: list[tuple[str, str]] = field(default_factory=list)
    """Classes and path."""
    marks: list[tuple[str, str, str]] = field(default_factory=list)
    """Classes, path and name."""

    @property
    def bottom(self) -> float:
        """Where the horizontal axis is."""
        return self.height - 30.0

    def x_axis(self, most: float) -> float:
        """Draw an axis from zero to a value or above in %; return how long one of them is."""
        ticks = _ticks(most)
        unit = (WIDTH - 12.0 - self.left) / ticks[-1]
        self.x_ticks = [(self.left + unit * one, f"{one:g}") for one in ticks]
        self.grid += "".join(f"M{at:.1f} 6V{self.bottom:.1f}" for at, _ in self.x_ticks)
        return unit


def rows_chart(
    rows: Sequence[str],
    series: Mapping[str, tuple[Look, Sequence[Estimate | None]]],
    *,
    x_label: str,
    across: Iterable[tuple[Look, float]] = (),
) -> Chart:
    """Return a row for each name and in it a mark for each series, with intervals.

    `across` are lines from top to bottom, such as chance.
    """
    step = 4.5 * len(series) + 7.0
    longest = max(map(len, rows), default=0)
    chart = Chart(x_label, 12.0 + step * len(rows) + 30.0, min(150.0, 10.0 + CHARACTER * longest))
    known = [one for _, of in series.values() for one in of if one is not None]
    unit = chart.x_axis(PERCENT * max((_high(one) for one in known), default=1.0))
    for place, row in enumerate(rows):
        middle = 8.0 + step * (place + 0.5)
        chart.y_ticks.append((middle, row))
        chart.grid += f"M{chart.left:.1f} {middle:.1f}H{WIDTH - 12:.1f}"
        for turn, (name, (look, of)) in enumerate(series.items()):
            one = of[place]
            if one is None:
                continue
            y = middle + 4.5 * (turn - 0.5 * (len(series) - 1))
            ends = [chart.left + unit * PERCENT * end for end in (one.ci_low, one.ci_high)]
            chart.lines.append((f"bar k{look.place}", _bar(ends, at=y)))
            x = chart.left + unit * PERCENT * one.value
            chart.marks.append((look.css, look.path(x, y), f"{row}: {name} {share(one)}"))
    for look, value in across:
        if np.isfinite(value):
            at = chart.left + unit * PERCENT * value
            chart.lines.append((f"across k{look.place}", f"M{at:.1f} 6V{chart.bottom:.1f}"))
    return chart


def plane_chart(
    curves: Sequence[Sequence[Point]],
    *,
    x_label: str,
    y_label: str,
    has_front: bool = False,
    limit: float | None = None,
) -> Chart:
    """Return marks on two axes, a line through those of each mechanism, and what none beats.

    The front is a staircase: whoever is right of it and above pays more and leaves more. `limit` is
    a share that is marked on the upright axis.
    """
    points = [point for curve in curves for point in curve]
    chart = Chart(x_label, 290.0, 40.0, y_label)
    unit = chart.x_axis(PERCENT * max((_high(one.x) for one in points), default=1.0))
    ticks = _ticks(PERCENT * max((_high(one.y) for one in points), default=1.0))
    y_unit = (chart.bottom - 6.0) / ticks[-1]

    def at(x: float, y: float) -> tuple[float, float]:
        return chart.left + unit * PERCENT * x, chart.bottom - y_unit * PERCENT * y

    chart.y_ticks = [(at(0.0, one / PERCENT)[1], f"{one:g}") for one in ticks]
    chart.grid += "".join(f"M{chart.left:.1f} {y:.1f}H{WIDTH - 12:.1f}" for y, _ in chart.y_ticks)
    if limit is not None:
        y = at(0.0, limit)[1]
        chart.lines.append(("across k6", f"M{chart.left:.1f} {y:.1f}H{WIDTH - 12:.1f}"))
    for curve in curves:
        way = [at(one.x.value, one.y.value) for one in curve]
        chart.lines.append((f"curve k{curve[0].look.place}", _line(way)))
    if has_front and points:
        values = np.array([(one.x.value, one.y.value) for one in points])
        corners = values[front(*values.T)]
        corners = corners[np.argsort(corners[:, 0])]
        way = [at(corners[0, 0], ticks[-1] / PERCENT), at(*corners[0])]
        for (_, y), (x, below) in pairwise(corners.tolist()):
            way += [at(x, y), at(x, below)]
        chart.lines.append(("front", _line([*way, (WIDTH - 12.0, way[-1][1])])))
    for one in points:
        x, y = at(one.x.value, one.y.value)
        path = _bar([at(end, 0.0)[0] for end in (one.x.ci_low, one.x.ci_high)], at=y)
        ends = [at(0.0, end)[1] for end in (one.y.ci_low, one.y.ci_high)]
        path += _bar(ends, at=x, upright=True)
        chart.lines.append((f"bar k{one.look.place}", path))
        name = f"{one.name}: {_axis(x_label)} {share(one.x)}, {_axis(y_label)} {share(one.y)}"
        chart.marks.append((one.look.css, one.look.path(x, y), name))
    return chart


def _bar(ends: Sequence[float], *, at: float, upright: bool = False) -> str:
    """Return the path of an interval; empty without one."""
    if not np.isfinite(ends).all():
        return ""
    low, high = ends
    return f"M{at:.1f} {low:.1f}V{high:.1f}" if upright else f"M{low:.1f} {at:.1f}H{high:.1f}"


def share(one: Estimate) -> str:
    """Return a share in % with its interval."""
    ends = f" [{PERCENT * one.ci_low:.1f}, {PERCENT * one.ci_high:.1f}]"
    return f"{PERCENT * one.value:.1f} %" + ends * bool(np.isfinite(one.ci_low))


def _axis(label: str) -> str:
    return label.removesuffix(" (%)")


def _high(one: Estimate) -> float:
    return float(np.nanmax([one.value, one.ci_high]))


def _line(way: Sequence[tuple[float, float]]) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in way)


def _ticks(most: float) -> list[float]:
    """Return the ticks of an axis from zero that reaches a value, but not beyond 100 %."""
    most = min(PERCENT, most)
    step = next((one for one in _STEPS if most <= one * (_MOST_TICKS - 1)), _STEPS[-1])
    n = max(1, int(np.ceil(most / step - 1e-9)))
    return [step * place for place in range(n + 1)]
