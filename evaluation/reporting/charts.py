"""Charts: marks and lines on two axes, as places; the page's templates make SVG of them.

A chart is as wide as a phone. Colours are classes, so that they change in the dark, and
a mark's shape and filling say the same in grey. Every mark is named.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from evaluation.estimates.families import FID, FIXED, RAW, Family
from evaluation.estimates.frontier import front
from evaluation.estimates.keys import level_text
from isac_track.intervals import Estimate
from isac_track.types import Floats

WIDTH: Final = 360.0
# How wide a character is at most on average, in units of a chart.
CHARACTER: Final = 5.6
PERCENT: Final = 100.0
INKS: Final = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    "#1b1d20",
)
MARKERS: Final = "os^DvP*"
"""Colours as in `colours.css`, and shapes as in `chart.html.j2`, as matplotlib has them."""
LOOKS: Final = len(INKS)
Stroke: TypeAlias = "Sequence[Any]"  # Places (x, y) that a line goes through.
_STEPS: Final = (1.0, 2.0, 5.0, 10.0)
_MOST_STEPS: Final = 5
_TOP: Final = 6.0
_RIGHT: Final = WIDTH - 12.0
_FEW_DECADES: Final = 2.0
_CURVES_HEIGHT: Final = 190.0
_PLANE_HEIGHT: Final = 250.0
_LABEL_MARK: Final = 16.0  # Room of the mark before a label.
_LABEL_STEP: Final = 11.0  # Between two labels.
_LABEL_ROOM: Final = 150.0
_MOST_LABELS: Final = 7
_WIDEST_ROW: Final = 172.0  # Of the names of rows.


class Look(NamedTuple):
    """Colour and shape of a mark, and whether it is hollow."""

    place: int
    hollow: bool = False
    turn: int = 0  # A colour that is used again has the shape of so many colours on.

    @property
    def css(self) -> str:
        """Classes of its mark."""
        return f"mark k{self.place % LOOKS}{' hollow' * self.hollow}"

    @property
    def shape(self) -> int:
        """Number of its shape."""
        return (
            (self.place + self.turn) % (LOOKS - 1) if self.turn else self.place % LOOKS
        )


def looks_of(known: Iterable[Family]) -> dict[str, Look]:
    """Return the look of every mechanism: its rule is hollow or not, raw is a star."""
    added = [one for one in known if one.is_added]
    names = dict.fromkeys([FID, FIXED, *(one.name for one in added)])
    looks = {
        name: Look(n % (LOOKS - 1), turn=n // (LOOKS - 1))
        for n, name in enumerate(names)
    }
    return {RAW: Look(LOOKS - 1)} | {
        one.mechanism: looks[one.name]._replace(hollow=one.adding == "independent")
        for one in added
    }


class Point(NamedTuple):
    """A level on two axes of shares."""

    look: Look
    name: str
    x: Estimate
    y: Estimate


class Curve(NamedTuple):
    """A line over something, with marks and intervals."""

    look: Look
    name: str
    x: Floats  # (P,) in the unit of the axis
    y: Floats  # (3, P) values and both ends of their intervals, NaN where unknown
    label: str = ""  # Stands at the right end of the line, where there is room.


Mark: TypeAlias = tuple[
    Look, float, float, str
]  # x (infinite: the right edge), y, and name.


class Label(NamedTuple):
    """A name beside the right end of a curve, behind a small mark of its look."""

    x: float
    y: float
    look: Look
    text: str


class Axis(NamedTuple):
    """An axis: its label, and whether it is logarithmic."""

    label: str
    log: bool = False


@dataclass(eq=False, slots=True)
class Chart:
    """What is drawn, in units of the picture; the templates know how."""

    x_label: str
    height: float
    left: float
    y_label: str = ""
    x_ticks: list[tuple[float, str]] = field(default_factory=list)
    y_ticks: list[tuple[float, str]] = field(default_factory=list)
    grid: list[Stroke] = field(default_factory=list)
    lines: list[tuple[str, Sequence[Stroke]]] = field(
        default_factory=list
    )  # Classes before.
    marks: list[tuple[Look, Stroke, str]] = field(
        default_factory=list
    )  # Middles and name.
    labels: list[Label] = field(default_factory=list)  # Beside the ends of curves.
    hints: dict[str, str] = field(
        default_factory=dict
    )  # Hover text by the words of a text.
    right: float = _RIGHT  # Where the horizontal axis ends.

    @property
    def bottom(self) -> float:
        """Where the horizontal axis is."""
        return self.height - 30.0

    @property
    def texts(self) -> list[tuple[float, float, str, str]]:
        """Place, class and words of all texts but that of the upright axis."""
        found = [(at, self.bottom + 12.0, "x", text) for at, text in self.x_ticks]
        found += [
            (0.5 * (self.left + self.right), self.bottom + 26.0, "x", self.x_label)
        ]
        return found + [
            (self.left - 5.0, at + 3.4, "y", text) for at, text in self.y_ticks
        ]

    def x_axis(self, values: Floats, *, log: bool = False) -> Callable[[Any], Any]:
        """Draw the axis of values; return where one of them is."""
        place, self.x_ticks = _axis(values, (self.left, self.right), log=log)
        self.grid += [self.down(at) for at, _ in self.x_ticks]
        return place

    def y_axis(self, values: Floats, *, log: bool = False) -> Callable[[Any], Any]:
        """Draw the upright axis of values; return where one of them is."""
        place, self.y_ticks = _axis(values, (self.bottom, _TOP), log=log)
        self.grid += [self.across(at) for at, _ in self.y_ticks]
        return place

    def across(self, y: float) -> Stroke:
        """Return a line from side to side."""
        return (self.left, y), (self.right, y)

    def down(self, x: float) -> Stroke:
        """Return a line from top to bottom."""
        return (x, _TOP), (x, self.bottom)


def rows_chart(
    rows: Sequence[str],
    series: Mapping[str, tuple[Look, Sequence[Estimate | None]]],
    *,
    x_label: str,
    across: Iterable[tuple[Look, float]] = (),
) -> Chart:
    """Return a row for each name, a mark for each series, and lines `across`, such as chance."""
    step = 4.5 * len(series) + 7.0
    longest = max(map(len, rows), default=0)
    left = min(_WIDEST_ROW, 10.0 + CHARACTER * longest)
    chart = Chart(x_label, 12.0 + step * len(rows) + 30.0, left)
    at = chart.x_axis(_shares([one for _, of in series.values() for one in of if one]))
    for place, row in enumerate(rows):
        middle = 8.0 + step * (place + 0.5)
        chart.y_ticks.append((middle, row))
        chart.grid.append(chart.across(middle))
        for turn, (name, (look, of)) in enumerate(series.items()):
            if one := of[place]:
                y = middle + 4.5 * (turn - 0.5 * (len(series) - 1))
                x, *ends = at(_shares([one]))
                chart.lines.append((f"bar k{look.place}", bar(ends, at=y)))
                chart.marks.append((look, [(x, y)], f"{row}: {name} {share(one)}"))
    for look, value in across:
        if np.isfinite(value):
            chart.lines.append(
                (f"across k{look.place}", [chart.down(at(PERCENT * value))])
            )
    return chart


def plane_chart(
    curves: Sequence[Sequence[Point]],
    *,
    x_label: str,
    y_label: str,
    has_front: bool = False,
    limit: float | None = None,
) -> Chart:
    """Return marks on two axes, a line for each mechanism, what none beats, and a limit of y."""
    points = [point for curve in curves for point in curve]
    words = [label.removesuffix(" (%)") for label in (x_label, y_label)]
    chart = Chart(x_label, _PLANE_HEIGHT, 40.0, y_label)
    at_x = chart.x_axis(_shares([one.x for one in points]))
    at_y = chart.y_axis(_shares([one.y for one in points]))
    if limit is not None:
        chart.lines.append(("across k6", [chart.across(at_y(PERCENT * limit))]))
    for curve in curves:
        way = [
            (at_x(PERCENT * one.x.value), at_y(PERCENT * one.y.value)) for one in curve
        ]
        chart.lines.append((f"curve k{curve[0].look.place}", [way]))
    if has_front and points:
        values = np.array([(one.x.value, one.y.value) for one in points])
        corners = values[front(*values.T)]
        # A staircase: whoever is right of it and above pays more and leaves more.
        across, up = corners[np.argsort(corners[:, 0])].T * PERCENT
        x, y = np.repeat(at_x(across), 2), np.repeat(at_y(up), 2)
        chart.lines.append(("front", [[*zip([*x, _RIGHT], [_TOP, *y], strict=True)]]))
    for one in points:
        (x, *x_ends), (y, *y_ends) = at_x(_shares([one.x])), at_y(_shares([one.y]))
        both = bar(x_ends, at=y) + bar(y_ends, at=x, upright=True)
        chart.lines.append((f"bar k{one.look.place}", both))
        name = f"{one.name}: {words[0]} {share(one.x)}, {words[1]} {share(one.y)}"
        chart.marks.append((one.look, [(x, y)], name))
    return chart


def curves_chart(
    curves: Sequence[Curve],
    *,
    x: Axis,
    y: Axis,
    across: Sequence[tuple[str, float]] = (),
    marked: Sequence[Mark] = (),
) -> Chart:
    """Return curves on two axes; `across` are lines from side to side, a class and value each."""
    chart = Chart(
        x.label, _CURVES_HEIGHT, 40.0, y.label, right=_RIGHT - label_room(curves)
    )
    at_x = chart.x_axis(np.concatenate([one.x for one in curves]), log=x.log)
    others = [value for _, value in across] + [value for _, _, value, _ in marked]
    shown = np.concatenate([*(one.y.ravel() for one in curves), np.array(others)])
    at_y = chart.y_axis(shown, log=y.log)
    for css, value in across:
        chart.lines.append((f"across {css}", [chart.across(at_y(value))]))
    for one in curves:
        known = np.isfinite(one.y[0])
        places, (middle, *ends) = at_x(one.x[known]), at_y(one.y[:, known])
        way = [*zip(places, middle, strict=True)]
        each = zip(places, *ends, strict=True)
        bars = [line for at, *pair in each for line in bar(pair, at=at, upright=True)]
        chart.lines.append((f"curve k{one.look.place}", [way]))
        chart.lines.append((f"bar k{one.look.place}", bars))
        chart.marks.append((one.look, way, one.name))
    for look, at, value, name in marked:
        place = at_x(at) if np.isfinite(at) else chart.right
        chart.marks.append((look, [(place, at_y(value))], name))
    if chart.right < _RIGHT:
        chart.labels = _labels(curves, at_y, x=chart.right, bottom=chart.bottom)
    return chart


def label_room(curves: Sequence[Curve]) -> float:
    """Return how much room the labels of curves take at the right; 0 if they do not fit.

    They fit if every curve has a different one, there are at most seven, and none is
    too long.
    """
    labels = [curve.label for curve in curves]
    widest = CHARACTER * max(map(len, labels), default=0) + _LABEL_MARK
    is_clear = all(labels) and len(set(labels)) == len(labels) <= _MOST_LABELS
    return widest if is_clear and widest <= _LABEL_ROOM else 0.0


def _labels(
    curves: Sequence[Curve], at_y: Callable[[Any], Any], *, x: float, bottom: float
) -> list[Label]:
    """Return the labels at the height of the last values, moved apart so that none overlap."""
    ends = [float(at_y(curve.y[0][np.isfinite(curve.y[0])][-1])) for curve in curves]
    order = sorted(range(len(curves)), key=ends.__getitem__)
    heights = list[float]()
    for place in order:
        heights.append(
            max(ends[place], heights[-1] + _LABEL_STEP if heights else _TOP + 2.0)
        )
    # What has moved below the axis pushes the others up again.
    limit = bottom
    for turn in reversed(range(len(heights))):
        heights[turn] = min(heights[turn], limit)
        limit = heights[turn] - _LABEL_STEP
    return [
        Label(x + 0.75 * _LABEL_MARK, height, curves[place].look, curves[place].label)
        for place, height in zip(order, heights, strict=True)
    ]


def bar(ends: Sequence[float], *, at: float, upright: bool = False) -> list[Stroke]:
    """Return the line of an interval; none without one."""
    line = [(at, end) if upright else (end, at) for end in ends]
    return [line] if np.isfinite(ends).all() else []


def share(one: Estimate) -> str:
    """Return a share in % with its interval."""
    ends = f" [{PERCENT * one.ci_low:.1f}, {PERCENT * one.ci_high:.1f}]"
    return f"{PERCENT * one.value:.1f} %" + ends * bool(np.isfinite(one.ci_low))


def _shares(of: Sequence[Estimate]) -> Floats:
    """Return values in % with both ends of their intervals, one after the other."""
    found = np.array(
        [(one.value, one.ci_low, one.ci_high) for one in of], dtype=np.float64
    )
    return PERCENT * found.reshape(-1)


def _axis(
    values: Floats, ends: tuple[float, float], *, log: bool
) -> tuple[Callable[[Any], Any], list[tuple[float, str]]]:
    """Return where a value is on an axis between two places, and its ticks."""
    known, length = values[np.isfinite(values)], ends[1] - ends[0]
    if log and (known > 0).any():
        known = known[known > 0]
        low, high = np.log10([known.min() / 1.1, 1.1 * known.max()]).tolist()
        steps = (1.0, 2.0, 5.0) if high - low < _FEW_DECADES else (1.0,)
        decades = 10.0 ** np.arange(np.floor(low), np.ceil(high))
        ticks = [
            one
            for one in np.outer(decades, steps).ravel()
            if low <= np.log10(one) <= high
        ]

        def place(values: Any) -> Any:  # noqa: ANN401 - a number or an array, as given
            return ends[0] + length * (
                np.log10(np.maximum(values, 10.0**low)) - low
            ) / (high - low)

        return place, [(float(place(one)), _short(one)) for one in ticks]
    ticks = _ticks(float(known.min(initial=0.0)), float(known.max(initial=0.0)))
    unit = length / (ticks[-1] - ticks[0])
    of_tick = [(ends[0] + unit * (one - ticks[0]), level_text(one)) for one in ticks]
    return lambda of: ends[0] + unit * (of - ticks[0]), of_tick


def _short(value: float) -> str:
    """Return a tick, large powers of ten as such."""
    exponent = round(np.log10(value))
    if exponent >= 4 and np.isclose(value, 10.0**exponent):  # noqa: PLR2004 - 1000 is short
        return "10" + str(exponent).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return level_text(value)


def _ticks(low: float, high: float) -> list[float]:
    """Return the ticks of an axis with zero on it that reaches from a value to another."""
    least = max(high - low, 1e-9) / _MOST_STEPS
    unit = 10.0 ** np.floor(np.log10(least))
    step = next(one * unit for one in _STEPS if least <= one * unit * (1.0 + 1e-9))
    first, last = int(np.floor(low / step + 1e-9)), int(np.ceil(high / step - 1e-9))
    return [step * place for place in range(first, max(first + 1, last) + 1)]
