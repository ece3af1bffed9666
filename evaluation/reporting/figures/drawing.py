"""The figures of a run: how they look, and how they become files.

A file in this folder with a function `drawings` makes some.

The same figure gives the same bytes: no dates, no random ids, and nothing from the user's own
matplotlib settings. Colours are those of Okabe and Ito; marker and line style tell the same in
grey.
"""

from __future__ import annotations

import contextlib
import io
import warnings
from collections import deque
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib import style as styles
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import Locator, LogLocator, NullLocator

from evaluation.analysis.families import RAW
from evaluation.analysis.metrics import DESCRIPTORS, EXPOSURE, METRICS, MISSED_RATE, Metric
from evaluation.cells.where import Failed
from evaluation.reporting.rows import ENDS, Results, Scheme, by_title
from evaluation.reporting.table import shortened
from evaluation.runs.files import write_whole
from evaluation.runs.workers import spread
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from numpy.typing import NDArray

    from evaluation.analysis.keys import Source
    from isac_track.types import Floats

Dashes = Literal["", "-", "--", "-.", ":"] | tuple[float, tuple[float, ...]]

SINGLE_COLUMN_IN, DOUBLE_COLUMN_IN = 3.5, 7.16
"""Widths of a figure in an IEEE journal."""
IMAGE_DPI = 200
CHARACTERS_PER_IN = 17.5
"""At 7 to 8 points."""
LOG_RATIO = 5.0
"""A logarithmic axis has too few ticks where the data span less."""
NAME_LENGTH = 40
PERCENT = 100.0

_BAND_ALPHA = 0.18
_HANDLE_CHARACTERS = 10
_CANVASES: dict[str, tuple[str, ...]] = {
    "svg": ("FigureCanvasSVG", "Date", "Creator"),
    "pdf": ("FigureCanvasPdf", "CreationDate", "Creator", "Producer"),
}
"""Of a kind of file, with what would make it another each time."""
_STYLE = Path(__file__).parents[1] / "templates" / "figures.mplstyle"


@dataclass(frozen=True, slots=True)
class Look:
    """Colour, marker and line style of a line."""

    colour: str
    marker: str
    dashes: Dashes

    @property
    def line(self) -> dict[str, Any]:
        """As matplotlib's lines take it."""
        return {"color": self.colour, "marker": self.marker, "linestyle": self.dashes}


# Dotted is kept for the raw baseline.
LOOKS = (
    Look("#0072B2", "o", "-"),
    Look("#D55E00", "s", "--"),
    Look("#009E73", "^", "-."),
    Look("#CC79A7", "X", (0, (5, 1, 1, 1, 1, 1))),
    Look("#E69F00", "P", (0, (8, 2))),
)


@dataclass(frozen=True, eq=False, slots=True)
class Drawing:
    """A figure of a run: how it is called, where it stands, and how it is drawn and told."""

    name: str
    """Of its files."""
    section: str
    """Of the page."""
    title: str
    draw: Callable[[Results], Figure | None]
    """None where the run has nothing to draw."""
    words: Callable[[Results], str]
    """What it shows, in numbers, for whoever does not see it."""
    caption: str = ""
    task: str = ""
    """The only linkage task that it is of."""


def figures_of(run: Results) -> list[Drawing]:
    """Return the figures of a run, of every file of this folder that has any."""
    folder = __name__.rpartition(".")[0]
    names = [one.name for one in iter_modules(import_module(folder).__path__)]
    modules = [import_module(f"{folder}.{name}") for name in names]
    return [
        one for module in modules if hasattr(module, "drawings") for one in module.drawings(run)
    ]


def draw_all(run: Results, *, folder: Path, jobs: int = 1, pdf: bool = False) -> list[Path]:
    """Draw every figure that the results allow, as SVG, and return the files written.

    `jobs` workers draw, whose number changes nothing; with `pdf` each is written as PDF, too.
    Raises DataError if the folder cannot be written.
    """
    with contextlib.suppress(OSError):  # write_whole says what is wrong
        folder.mkdir(parents=True, exist_ok=True)
    files: dict[str, bytes] = {}
    draw = partial(_drawn, run=run, step=jobs, pdf=pdf)
    for _, found in spread(draw, deque(range(jobs)), jobs=jobs, limit_s=None):
        for one in found:
            if isinstance(one, Failed):
                raise DataError(f"cannot draw the figures: {one.why}; run evaluation.report again")
            files |= one
    for name in sorted(files):
        write_whole(folder / name, files[name])
    return [folder / name for name in sorted(files)]


def _drawn(first: int, *, run: Results, step: int, pdf: bool) -> Iterator[dict[str, bytes]]:
    """Yield the files of every so many-th figure by name; one that is empty has none."""
    with style():
        for one in figures_of(run)[first::step]:  # one at a time is in memory
            figure = one.draw(run)
            if figure is not None:
                files = rendered(figure, pdf=pdf)
                yield {f"{one.name}.{kind}": of for kind, of in files.items()}


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Set matplotlib's defaults and ours, whatever the user's own settings are."""
    with styles.context(["default", _STYLE]), warnings.catch_warnings():
        # A data set may be named in a script that the bundled font lacks.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield


def panels(
    rows: int,
    columns: int,
    *,
    height_in: float,
    margins_in: tuple[float, float, float, float, float, float] | None = None,
    **sharing: Any,  # noqa: ANN401 - as matplotlib's subplots take it
) -> tuple[Figure, NDArray[Any]]:
    """Return a figure and its panels, (rows, columns).

    Without margins it makes room for its labels, legend and title; a single column of panels then
    fits into one column of a journal. Margins are left, right, top and bottom, and the gaps
    between columns and between rows. `sharing`: sharex, sharey; and width_in.
    """
    if margins_in is None:
        width_in = SINGLE_COLUMN_IN if columns == 1 else DOUBLE_COLUMN_IN
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        return figure, figure.subplots(rows, columns, squeeze=False, **sharing)
    width_in = sharing.pop("width_in", DOUBLE_COLUMN_IN)
    figure = Figure(figsize=(width_in, height_in), dpi=IMAGE_DPI)
    size_in, gaps = figure.get_size_inches(), np.array(margins_in[4:])
    left, right, top, bottom = np.array(margins_in[:4]) / size_in[[0, 0, 1, 1]]
    n, share = np.array([columns, rows]), np.array([1.0 - left - right, 1.0 - top - bottom])
    wspace, hspace = gaps / ((share * size_in - gaps * (n - 1)) / n)
    figure.subplots_adjust(left, bottom, 1.0 - right, 1.0 - top, wspace, hspace)
    return figure, figure.subplots(rows, columns, squeeze=False, **sharing)


def rendered(figure: Figure, *, pdf: bool) -> dict[str, bytes]:
    """Return the figure as `svg`, and as `pdf` if asked for: fonts make that the slower one.

    It is laid out once for both, and printed by the canvases themselves: `savefig` would find
    the layout anew and draw everything twice each time.
    """
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")
    files = {"svg": io.BytesIO()} | ({"pdf": io.BytesIO()} if pdf else {})
    for kind, file in files.items():
        name, *dated = _CANVASES[kind]
        # Only what is asked for: that of PDF takes half a second to import.
        canvas = getattr(import_module(f"matplotlib.backends.backend_{kind}"), name)(figure)
        getattr(canvas, f"print_{kind}")(file, metadata=dict.fromkeys(dated))
    return {kind: file.getvalue() for kind, file in files.items()}


@dataclass(frozen=True, eq=False, slots=True)
class Line:
    """A line over the level, and what stands beside it in a legend."""

    label: str
    look: Look
    rows: pd.DataFrame
    """Columns mechanism, level, value, ci_low and ci_high, as in a summary."""
    shown: Metric = METRICS[EXPOSURE]
    """In whose unit the axis is: by default a share, in %."""
    has_band: bool = True
    is_raw_across: bool = False
    """Whether raw is drawn from side to side, not only at the edge where levels end in it."""
    apart: Mapping[str, Any] = field(default_factory=dict)
    """What sets it apart from the others, as matplotlib's lines take it."""

    def alone(self, mechanism: str) -> list[float]:
        """Return where it is at a mechanism without levels, if anywhere, in the axis's unit."""
        found = self.rows["value"][self.rows["mechanism"] == mechanism]
        return [self.shown.scale * one for one in found]

    @property
    def handle(self) -> Line2D:
        """The legend's entry of it."""
        return handle(self.label, self.look, **self.apart)

    def draw(self, ax: Axes, scheme: Scheme) -> None:
        """Draw it over the levels of a scheme, and raw dotted.

        Its band has gaps where the interval is unknown.
        """
        rows = scheme.of(self.rows)
        if len(rows):
            x = rows["level"].to_numpy()
            y, *ends = (self.shown.scale * rows[key].to_numpy() for key in ENDS)
            ax.plot(x, y, **self.look.line, **self.apart)
            if self.has_band:
                band(ax, x, *ends, look=self.look)
        for raw in self.alone(RAW)[:1]:
            at = (0.0, 1.0) if self.is_raw_across else (0.95, 1.0) if scheme.log else (0.0, 0.06)
            # Above the axis itself, where the value is zero.
            look: dict[str, Any] = {"color": self.look.colour, "linestyle": ":", "zorder": 2.6}
            ax.plot(at, [raw, raw], transform=ax.get_yaxis_transform(), **look)


def band(ax: Axes, x: Floats, low: Floats, high: Floats, *, look: Look) -> None:
    """Fill the interval around a line."""
    ax.fill_between(x, low, high, color=look.colour, alpha=_BAND_ALPHA, linewidth=0)


def level_axis(ax: Axes, *, log: bool) -> None:
    """Set the axis of a mechanism's level."""
    if log:
        ax.set_xscale("log")
        plain_ticks(ax.xaxis, LogLocator())
    else:
        ax.set_xlim(left=0)


def value_axis(ax: Axes, values: Sequence[Sequence[float] | pd.Series], *, log: bool) -> None:
    """Start at zero, or take a logarithmic axis where it is wanted and the data span it."""
    known = np.concatenate(values)
    if log and known.min() > 0 and known.max() > LOG_RATIO * known.min():
        ax.set_yscale("log")
        plain_ticks(ax.yaxis, LogLocator(subs=(1.0, 2.0, 5.0)))
    else:
        # A little below zero, so that a marker at zero is whole.
        ax.set_ylim(bottom=-0.03 * ax.get_ylim()[1])


def look_of(scheme: Scheme) -> Look:
    """Return the look of what is swept, the same in every figure."""
    return LOOKS[scheme.place % len(LOOKS)]


def handles_of(known: Sequence[Scheme]) -> list[Line2D]:
    """Return the legend's entries of what is swept."""
    return [handle(name, look_of(one)) for name, one in by_title(known).items()]


def label(metric: str) -> str:
    """Return the label of a metric's axis; of a descriptor with whose positions it is of."""
    if metric == MISSED_RATE:
        return "Missed conflicts (%)"
    shown = METRICS[metric]
    return f"{shown.head}{', shared' * (metric in DESCRIPTORS)} ({shown.unit})"


def number(value: float) -> str:
    """Return a level or tick as a short number, large powers of ten as such."""
    exponent = round(np.log10(value)) if value > 0 else 0
    if exponent >= 4 and np.isclose(value, 10.0**exponent):  # noqa: PLR2004 - 1000 is short
        return "10" + str(exponent).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{value:.4g}"


def handle(text: str, look: Look, **more: Any) -> Line2D:  # noqa: ANN401 - matplotlib's
    """Return the legend's entry of a line."""
    return Line2D([], [], label=text, **look.line, **more)


def black_handle(
    text: str, *, marker: str = "", dashes: Dashes = "", hollow: bool = False
) -> Line2D:
    """Return the legend's entry of something that has no colour of its own."""
    face = "white" if hollow else "black"
    return handle(text, Look("black", marker, dashes), markersize=5, markerfacecolor=face)


def band_handle(text: str) -> Patch:
    """Return the legend's entry of a band."""
    return Patch(color="black", alpha=_BAND_ALPHA, linewidth=0, label=text)


def finish(
    figure: Figure, handles: Sequence[Artist | bool], *, dataset: str, what: str, columns: int = 0
) -> Figure:
    """Put a legend below the panels, the data set's name and what is shown above them.

    The legend has some columns, or as few rows as its words allow; of the handles a False is none.
    """
    entries = [one for one in handles if isinstance(one, Artist)]
    is_placed = figure.get_layout_engine() is None
    place: dict[str, Any] = {"loc": "outside lower center"}
    if columns:
        place = {"loc": "lower center", "bbox_to_anchor": (0.5, 0.0)}
        place |= {"borderaxespad": 0.2, "columnspacing": 1.4}
    room = CHARACTERS_PER_IN * figure.get_figwidth()
    widths = [len(str(one.get_label())) + _HANDLE_CHARACTERS for one in entries]
    n = columns or len(entries)
    while not columns and n > 1 and sum(map(max, np.array_split(widths, n))) > room:
        n -= 1
    figure.legend(handles=entries, ncols=n, **place)
    name = "".join(character if character.isprintable() else " " for character in dataset)
    if len(name) > NAME_LENGTH:
        name = name[: NAME_LENGTH - 1] + "…"
    separator = ": " if is_placed or figure.get_figwidth() > SINGLE_COLUMN_IN else "\n"
    place = {"x": 0.01, "horizontalalignment": "left"}
    if is_placed:
        place |= {"y": 1.0 - 0.05 / figure.get_figheight(), "verticalalignment": "top"}
    figure.suptitle(f"{name}{separator}{what}", **place)
    return figure


def short(source: Source) -> str:
    """Return whose a line is, so short that it fits."""
    return shortened(source.label, room=NAME_LENGTH)


def plain_ticks(axis: Axis, locator: Locator) -> None:
    """Set ticks with short numbers, and none between them."""
    axis.set_major_locator(locator)
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(lambda value, _: number(value))
