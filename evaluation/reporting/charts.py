"""Charts: marks and lines on two axes, in picture units; templates turn them into SVG.

A chart is as wide as a phone. Colours are CSS classes, so that they change in the dark
mode. The shape and the filling of a mark say the same in grey. Every mark has a name.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from evaluation.estimates.families import FID, FIXED, RAW, Family
from evaluation.estimates.keys import level_text
from evaluation.estimates.pareto import front
from evaluation.reporting.amounts import PERCENT, precise_percent
from isac_track.intervals import Estimate
from isac_track.types import Floats

WIDTH: Final = 360.0
# How wide a character is at most on average, in units of a chart.
CHARACTER: Final = 5.6
# Colours of `colours.css`.
INKS: Final = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    "#1b1d20",
)
# Shapes of `chart.html.j2`, as matplotlib names them.
MARKERS: Final = "os^DvP*"
LOOKS: Final = len(INKS)
GUIDE_COLOUR: Final = 6  # Of lines at a limit, at chance or at zero.
Stroke: TypeAlias = "Sequence[Any]"  # Points (x, y) that a line goes through.
_STEPS: Final = (1.0, 2.0, 5.0, 10.0)
_MOST_STEPS: Final = 5
_TOP: Final = 6.0
_RIGHT: Final = WIDTH - 12.0
_FEW_DECADES: Final = 2.0
_CURVES_HEIGHT: Final = 190.0
_PLANE_HEIGHT: Final = 250.0
_LABEL_MARK: Final = 16.0  # Width of the mark before a label.
_LABEL_STEP: Final = 11.0  # Distance between two labels.
_LABEL_ROOM: Final = 150.0
_MOST_LABELS: Final = 7
_WIDEST_ROW: Final = 172.0  # Width of the names of rows, at most.


class Look(NamedTuple):
    """Colour and shape of a mark, and whether it is hollow."""

    colour: int
    hollow: bool = False
    # A colour that is used again has the shape of the colour `turn` places later.
    turn: int = 0

    @property
    def css(self) -> str:
        """CSS classes of the mark."""
        hollow = " hollow" if self.hollow else ""
        return f"mark k{self.colour % LOOKS}{hollow}"

    @property
    def shape(self) -> int:
        """Number of the shape."""
        if self.turn:
            return (self.colour + self.turn) % (LOOKS - 1)
        return self.colour % LOOKS


def mechanism_looks(known: Iterable[Family]) -> dict[str, Look]:
    """Return the look of each mechanism: independent noise is hollow, raw is a star."""
    noisy = [family for family in known if family.is_added]
    names = dict.fromkeys([FID, FIXED, *(family.name for family in noisy)])
    family_looks = {
        name: Look(n % (LOOKS - 1), turn=n // (LOOKS - 1))
        for n, name in enumerate(names)
    }
    looks = {RAW: Look(LOOKS - 1)}
    for family in noisy:
        is_hollow = family.adding == "independent"
        looks[family.mechanism] = family_looks[family.name]._replace(hollow=is_hollow)
    return looks


class Point(NamedTuple):
    """A level on two axes of shares."""

    look: Look
    name: str
    x: Estimate
    y: Estimate


class Curve(NamedTuple):
    """A line over an axis, with marks and intervals."""

    look: Look
    name: str
    x: Floats  # (P,) in the unit of the axis
    y: Floats  # (3, P) values and both ends of their intervals, NaN where unknown
    label: str = ""  # Text at the right end of the line, if there is room.


class LonePoint(NamedTuple):
    """A point of its own, on no curve."""

    look: Look
    x: float  # In the unit of the axis; infinite: at the right edge.
    y: float
    name: str


class Label(NamedTuple):
    """A name beside the right end of a curve, behind a small mark of its look."""

    x: float
    y: float
    look: Look
    text: str


class Text(NamedTuple):
    """Words at a place of a chart."""

    x: float
    y: float
    css: str  # Class: `x` or `y`, the axis that it belongs to.
    words: str


class ChartMark(NamedTuple):
    """Marks of the same look that a keyboard reaches together."""

    look: Look
    centres: Stroke
    name: str


class Tick(NamedTuple):
    """A text beside an axis."""

    at: float  # Position along the axis.
    text: str


class Guide(NamedTuple):
    """A value that a line across the chart marks, such as chance or a limit."""

    colour: int
    value: float  # In the unit of the axis.


class Line(NamedTuple):
    """Strokes of one kind and colour."""

    kind: str  # CSS class: `across` (a guide), `bar`, `curve` or `front`.
    strokes: Sequence[Stroke]
    colour: int | None = None  # None: the kind has its own.

    @property
    def css(self) -> str:
        """CSS classes of the strokes."""
        return self.kind if self.colour is None else f"{self.kind} k{self.colour}"


class Axis(NamedTuple):
    """An axis: its label, and whether it is logarithmic."""

    label: str
    log: bool = False


@dataclass(eq=False, slots=True)
class Chart:
    """Marks, lines and texts in picture units; the templates draw them."""

    x_label: str
    height: float
    left: float
    y_label: str = ""
    x_ticks: list[Tick] = field(default_factory=list)
    y_ticks: list[Tick] = field(default_factory=list)
    grid: list[Stroke] = field(default_factory=list)
    lines: list[Line] = field(default_factory=list)
    marks: list[ChartMark] = field(default_factory=list)
    labels: list[Label] = field(default_factory=list)  # Beside the ends of curves.
    # Hover text of a text that the chart shows.
    hints: dict[str, str] = field(default_factory=dict)
    right: float = _RIGHT  # The right end of the horizontal axis.

    @property
    def bottom(self) -> float:
        """Height of the horizontal axis."""
        return self.height - 30.0

    @property
    def texts(self) -> list[Text]:
        """All texts but the vertical label."""
        middle = 0.5 * (self.left + self.right)
        texts = [
            Text(tick.at, self.bottom + 12.0, "x", tick.text) for tick in self.x_ticks
        ]
        texts.append(Text(middle, self.bottom + 26.0, "x", self.x_label))
        texts += [
            Text(self.left - 5.0, tick.at + 3.4, "y", tick.text)
            for tick in self.y_ticks
        ]
        return texts

    def x_axis(self, values: Floats, *, log: bool = False) -> Callable[[Any], Any]:
        """Draw the horizontal axis; return the map from a value to its position."""
        position, self.x_ticks = _axis(values, (self.left, self.right), log=log)
        self.grid += [self.down(tick.at) for tick in self.x_ticks]
        return position

    def y_axis(self, values: Floats, *, log: bool = False) -> Callable[[Any], Any]:
        """Draw the vertical axis; return the map from a value to its position."""
        position, self.y_ticks = _axis(values, (self.bottom, _TOP), log=log)
        self.grid += [self.across(tick.at) for tick in self.y_ticks]
        return position

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
    guides: Iterable[tuple[Look, float]] = (),
) -> Chart:
    """Return a chart with a row for each name and a mark for each series.

    `guides` are vertical lines, such as chance: a look and a fraction each.
    """
    step = 4.5 * len(series) + 7.0
    longest = max(map(len, rows), default=0)
    left = min(_WIDEST_ROW, 10.0 + CHARACTER * longest)
    chart = Chart(x_label, 12.0 + step * len(rows) + 30.0, left)
    columns = [estimates for _, estimates in series.values()]
    known = [estimate for column in columns for estimate in column if estimate]
    to_x = chart.x_axis(_percents(known))
    for n_row, row in enumerate(rows):
        middle = 8.0 + step * (n_row + 0.5)
        chart.y_ticks.append(Tick(middle, row))
        chart.grid.append(chart.across(middle))
        for n_series, (name, (look, estimates)) in enumerate(series.items()):
            if estimate := estimates[n_row]:
                y = middle + 4.5 * (n_series - 0.5 * (len(series) - 1))
                x, *ends = to_x(_percents([estimate]))
                text = f"{row}: {name} {precise_percent(estimate)}"
                chart.lines.append(Line("bar", bar(ends, at=y), look.colour))
                chart.marks.append(ChartMark(look, [(x, y)], text))
    for look, value in guides:
        if np.isfinite(value):
            line = chart.down(to_x(PERCENT * value))
            chart.lines.append(Line("across", [line], look.colour))
    return chart


def plane_chart(
    curves: Sequence[Sequence[Point]],
    *,
    x_label: str,
    y_label: str,
    has_front: bool = False,
    limit: float | None = None,
) -> Chart:
    """Return a chart of points, joined by a line for each mechanism.

    `has_front` draws the front: the levels that no other level beats. `limit` is a
    fraction; it is drawn as a horizontal line.
    """
    points = [point for curve in curves for point in curve]
    x_name, y_name = x_label.removesuffix(" (%)"), y_label.removesuffix(" (%)")
    chart = Chart(x_label, _PLANE_HEIGHT, 40.0, y_label)
    to_x = chart.x_axis(_percents([point.x for point in points]))
    to_y = chart.y_axis(_percents([point.y for point in points]))
    if limit is not None:
        strokes = [chart.across(to_y(PERCENT * limit))]
        chart.lines.append(Line("across", strokes, GUIDE_COLOUR))
    for curve in curves:
        line = [
            (to_x(PERCENT * point.x.value), to_y(PERCENT * point.y.value))
            for point in curve
        ]
        chart.lines.append(Line("curve", [line], curve[0].look.colour))
    if has_front and points:
        chart.lines.append(Line("front", [_front_line(points, to_x, to_y)]))
    for point in points:
        x, *x_ends = to_x(_percents([point.x]))
        y, *y_ends = to_y(_percents([point.y]))
        bars = bar(x_ends, at=y) + bar(y_ends, at=x, upright=True)
        chart.lines.append(Line("bar", bars, point.look.colour))
        name = (
            f"{point.name}: {x_name} {precise_percent(point.x)},"
            f" {y_name} {precise_percent(point.y)}"
        )
        chart.marks.append(ChartMark(point.look, [(x, y)], name))
    return chart


def _front_line(
    points: Sequence[Point], to_x: Callable[[Any], Any], to_y: Callable[[Any], Any]
) -> Stroke:
    """Return the front as a staircase: every point above and right of it is beaten."""
    values = np.array([(point.x.value, point.y.value) for point in points])
    corners = values[front(values)]
    x_percent, y_percent = corners[np.argsort(corners[:, 0])].T * PERCENT
    x, y = np.repeat(to_x(x_percent), 2), np.repeat(to_y(y_percent), 2)
    return list(zip([*x, _RIGHT], [_TOP, *y], strict=True))


def curves_chart(
    curves: Sequence[Curve],
    *,
    x: Axis,
    y: Axis,
    guides: Sequence[Guide] = (),
    marked: Sequence[LonePoint] = (),
) -> Chart:
    """Return a chart of curves on two axes.

    `guides` are horizontal lines. `marked` are further marks, of no curve.
    """
    chart = Chart(
        x.label, _CURVES_HEIGHT, 40.0, y.label, right=_RIGHT - label_room(curves)
    )
    to_x = chart.x_axis(np.concatenate([curve.x for curve in curves]), log=x.log)
    others = [guide.value for guide in guides] + [mark.y for mark in marked]
    curve_values = [curve.y.ravel() for curve in curves]
    to_y = chart.y_axis(np.concatenate([*curve_values, np.array(others)]), log=y.log)
    for guide in guides:
        strokes = [chart.across(to_y(guide.value))]
        chart.lines.append(Line("across", strokes, guide.colour))
    for curve in curves:
        known = np.isfinite(curve.y[0])
        xs = to_x(curve.x[known])
        middles, lows, highs = to_y(curve.y[:, known])
        line = list(zip(xs, middles, strict=True))
        bars: list[Stroke] = []
        for at, low, high in zip(xs, lows, highs, strict=True):
            bars += bar([low, high], at=at, upright=True)
        chart.lines.append(Line("curve", [line], curve.look.colour))
        chart.lines.append(Line("bar", bars, curve.look.colour))
        chart.marks.append(ChartMark(curve.look, line, curve.name))
    for mark in marked:
        mark_x = to_x(mark.x) if np.isfinite(mark.x) else chart.right
        chart.marks.append(ChartMark(mark.look, [(mark_x, to_y(mark.y))], mark.name))
    if chart.right < _RIGHT:
        chart.labels = _labels(curves, to_y, x=chart.right, bottom=chart.bottom)
    return chart


def label_room(curves: Sequence[Curve]) -> float:
    """Return the width of the labels right of the curves; 0 if they do not fit.

    They fit if every curve has a different label, there are at most seven, and none is
    too long.
    """
    labels = [curve.label for curve in curves]
    widest = CHARACTER * max(map(len, labels), default=0) + _LABEL_MARK
    is_clear = all(labels) and len(set(labels)) == len(labels) <= _MOST_LABELS
    return widest if is_clear and widest <= _LABEL_ROOM else 0.0


def _labels(
    curves: Sequence[Curve], to_y: Callable[[Any], Any], *, x: float, bottom: float
) -> list[Label]:
    """Return labels at the heights of the last values, moved apart if they overlap."""
    # A curve without a known value has no end to stand beside.
    curves = [curve for curve in curves if np.isfinite(curve.y[0]).any()]
    ends = [float(to_y(curve.y[0][np.isfinite(curve.y[0])][-1])) for curve in curves]
    order = sorted(range(len(curves)), key=ends.__getitem__)
    # Heights are counted from the top of the picture, so that the first is the highest.
    heights = list[float]()
    for place in order:
        least = heights[-1] + _LABEL_STEP if heights else _TOP + 2.0
        heights.append(max(ends[place], least))
    # Labels that have moved below the axis push the others up again.
    limit = bottom
    for n in reversed(range(len(heights))):
        heights[n] = min(heights[n], limit)
        limit = heights[n] - _LABEL_STEP
    return [
        Label(x + 0.75 * _LABEL_MARK, height, curves[place].look, curves[place].label)
        for place, height in zip(order, heights, strict=True)
    ]


def bar(ends: Sequence[float], *, at: float, upright: bool = False) -> list[Stroke]:
    """Return the line of an interval; an empty list without an interval."""
    line = [(at, end) if upright else (end, at) for end in ends]
    return [line] if np.isfinite(ends).all() else []


def _percents(estimates: Sequence[Estimate]) -> Floats:
    """Return value and both interval ends of each estimate in %, flat: (3 E,)."""
    rows = [
        (estimate.value, estimate.ci_low, estimate.ci_high) for estimate in estimates
    ]
    return PERCENT * np.array(rows, dtype=np.float64).reshape(-1)


def _axis(
    values: Floats, ends: tuple[float, float], *, log: bool
) -> tuple[Callable[[Any], Any], list[Tick]]:
    """Return the map from values to positions between two ends, and the ticks.

    A linear axis always shows 0. A logarithmic axis shows the values alone; without a
    positive value it is linear.
    """
    known, length = values[np.isfinite(values)], ends[1] - ends[0]
    if log and (known > 0).any():
        return _log_axis(known[known > 0], ends)
    ticks = _ticks(float(known.min(initial=0.0)), float(known.max(initial=0.0)))
    unit = length / (ticks[-1] - ticks[0])

    def position(values: Any) -> Any:  # noqa: ANN401 - a number or an array, as given
        return ends[0] + unit * (values - ticks[0])

    return position, [Tick(position(tick), level_text(tick)) for tick in ticks]


def _log_axis(
    known: Floats, ends: tuple[float, float]
) -> tuple[Callable[[Any], Any], list[Tick]]:
    """Return the same for a logarithmic axis of positive values."""
    length = ends[1] - ends[0]
    low, high = np.log10([known.min() / 1.1, 1.1 * known.max()]).tolist()
    ticks = _log_ticks(low, high)

    def position(values: Any) -> Any:  # noqa: ANN401 - a number or an array, as given
        exponents = np.log10(np.maximum(values, 10.0**low))
        return ends[0] + length * (exponents - low) / (high - low)

    return position, [Tick(float(position(tick)), _short(tick)) for tick in ticks]


def _log_ticks(low: float, high: float) -> list[float]:
    """Return the ticks of a logarithmic axis between two exponents, at least one.

    They are powers of ten; over few decades also their double and fivefold. Over less
    than such a step they are all whole multiples, or else the middle to two digits.
    """
    steps = (1.0, 2.0, 5.0) if high - low < _FEW_DECADES else (1.0,)
    decades = 10.0 ** np.arange(np.floor(low), np.ceil(high))
    for factors in (steps, range(1, 10)):
        candidates = np.outer(decades, factors).ravel()
        ticks = [tick for tick in candidates if low <= np.log10(tick) <= high]
        if ticks:
            return ticks
    return [float(f"{10.0 ** (0.5 * (low + high)):.2g}")]


def _short(value: float) -> str:
    """Return the text of a tick; large powers of ten as `10⁵`."""
    exponent = round(np.log10(value))
    if exponent >= 4 and np.isclose(value, 10.0**exponent):  # noqa: PLR2004 - 1000 is short
        return "10" + str(exponent).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return level_text(value)


def _ticks(low: float, high: float) -> list[float]:
    """Return the ticks of a linear axis from `low` to `high`: multiples of one step."""
    least = max(high - low, 1e-9) / _MOST_STEPS
    unit = 10.0 ** np.floor(np.log10(least))
    step = next(
        factor * unit for factor in _STEPS if least <= factor * unit * (1.0 + 1e-9)
    )
    first, last = int(np.floor(low / step + 1e-9)), int(np.ceil(high / step - 1e-9))
    return [step * n for n in range(first, max(first + 1, last) + 1)]
