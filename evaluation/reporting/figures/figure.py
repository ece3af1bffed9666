"""Figures of a run: panels of charts.

Each file of this folder with a function `figures` makes some.
"""

import contextlib
import io
import textwrap
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, Final, NamedTuple

import numpy as np

from evaluation.reporting.charts import (
    CHARACTER,
    INKS,
    MARKERS,
    WIDTH,
    Chart,
    Line,
    Look,
)
from evaluation.reporting.markup import HTML
from evaluation.reporting.rows import Results
from evaluation.reporting.table import printable, shorten_name
from evaluation.store.files import write_whole

_TOP, _LEFT, _HEADING, _GAP = 26.0, 10.0, 16.0, 14.0
_LINE: Final = 14.0  # Height of a line of the caption and the note.
_TEXT_CHARACTER: Final = 5.3  # Mean width of a character of these lines.
# The style of each class in `chart.css`, for PDF.
_PRINTED: Final[dict[str, dict[str, Any]]] = {
    "grid": {"color": "#d9dce0", "linewidth": 0.6},
    "bar": {"linewidth": 1.1, "alpha": 0.55},
    "curve": {"linewidth": 0.8, "alpha": 0.5},
    "across": {"linewidth": 1.0, "linestyle": (0, (2, 2))},
    "front": {"color": "#555b63", "linewidth": 2.2, "alpha": 0.6},
}
_ROOM: Final = 40  # Characters of a data set's name.
_ALIGNED: Final = {"x": "center", "y": "right"}


@dataclass(frozen=True, eq=False, slots=True)
class Figure:
    """Panels that belong together."""

    name: str  # Of its files.
    section: str  # Of the page.
    title: str
    panels: Sequence[tuple[str, Chart]]  # Heading and chart, row by row.
    columns: int
    # Text and look of each mark that has no label beside a curve.
    key: Mapping[str, Look]
    caption: str = ""  # The finding, in a sentence.
    note: str = ""  # How to read it.


class _PlacedChart(NamedTuple):
    """A chart and its heading in a figure."""

    left: float
    top: float
    heading: str
    chart: Chart


class _PlacedKey(NamedTuple):
    """An entry of a figure's key: a look and its name."""

    x: float  # Of the mark's middle.
    y: float
    name: str
    look: Look


class Layout(NamedTuple):
    """Positions of all parts of a figure, px."""

    width: float
    height: float
    lines: list[tuple[float, str]]  # Height and words of the caption and the note.
    panels: list[_PlacedChart]
    key: list[_PlacedKey]


def make_figures(run: Results) -> list[Figure]:
    """Make the figures of a run with all files of this folder, unless empty."""
    folder = __name__.rpartition(".")[0]
    names = [module.name for module in iter_modules(import_module(folder).__path__)]
    modules = [import_module(f"{folder}.{name}") for name in names]
    return [
        figure
        for module in modules
        if hasattr(module, "figures")
        for figure in module.figures(run)
        if figure.panels
    ]


def write(figures: Iterable[Figure], *, folder: Path, dataset: str, pdf: bool) -> None:
    """Write figures of a data set as SVG, and as PDF if wanted.

    Raises DataError if a file cannot be written.
    """
    with contextlib.suppress(OSError):  # write_whole says what is wrong
        folder.mkdir(parents=True, exist_ok=True)
    template = HTML.get_template("figure.svg.j2")
    heading = shorten_name(dataset, room=_ROOM)
    for figure in figures:
        titled = replace(figure, title=printable(f"{heading}: {figure.title}"))
        text = template.render(figure=titled, layout=_layout(titled))
        write_whole(folder / f"{titled.name}.svg", text.encode())
        if pdf:
            write_whole(folder / f"{titled.name}.pdf", _printed(titled))


def _layout(figure: Figure) -> Layout:
    columns = min(figure.columns, len(figure.panels))
    width, top, panels = columns * (WIDTH + _GAP), _TOP, []
    lines = list[tuple[float, str]]()
    for text in _wrapped(figure.caption, width):
        lines.append((top + 4.0, text))
        top += _LINE
    for start in range(0, len(figure.panels), figure.columns):
        row = figure.panels[start : start + figure.columns]
        for place, (heading, chart) in enumerate(row):
            left = place * (WIDTH + _GAP)
            panels.append(_PlacedChart(left, top + _HEADING, heading, chart))
        top += _HEADING + max(chart.height for _, chart in row) + _GAP
    key, x = [], _LEFT
    for name, look in figure.key.items():
        needed = CHARACTER * len(name) + 26.0
        if x > _LEFT and x + needed > width:
            x, top = _LEFT, top + 15.0
        key.append(_PlacedKey(x, top, name, look))
        x += needed
    top += 1.5 * _LINE if key else 0.0
    for text in _wrapped(figure.note, width):
        lines.append((top, text))
        top += _LINE
    return Layout(width, top + 4.0, lines, panels, key)


def _wrapped(text: str, width: float) -> list[str]:
    """Return a text in lines that fit into a width."""
    return textwrap.wrap(text, int((width - 2 * _LEFT) / _TEXT_CHARACTER))


def _printed(figure: Figure) -> bytes:
    """Return a figure as PDF, the same bytes whatever the user's settings."""
    import matplotlib as mpl  # noqa: PLC0415 - slow to import, and seldom needed
    from matplotlib.figure import Figure as Page  # noqa: PLC0415 - as said

    layout = _layout(figure)
    usual = mpl.rcParamsDefault | {"text.parse_math": False}
    with mpl.rc_context(usual), warnings.catch_warnings():
        # A data set may be named in a script that the bundled font lacks.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        page = Page(figsize=(layout.width / 72.0, layout.height / 72.0))
        ax = page.add_axes(
            (0.0, 0.0, 1.0, 1.0), xlim=(0.0, layout.width), ylim=(layout.height, 0.0)
        )
        ax.set_axis_off()
        ax.text(8.0, 16.0, figure.title, fontsize=11.0, weight="bold")
        for panel in layout.panels:
            x, y = panel.left + 8.0, panel.top - 4.0
            ax.text(x, y, panel.heading, fontsize=9.5, weight="bold")
            _print_chart(ax, panel.chart, panel.left, panel.top)
        for y, text in layout.lines:
            ax.text(8.0, y, text, fontsize=8.5)
        for entry in layout.key:
            _mark(ax, entry.x, entry.y, entry.look)
            ax.text(entry.x + 8.0, entry.y + 3.0, entry.name, fontsize=8.5)
        sink = io.BytesIO()
        undated = dict.fromkeys(("CreationDate", "Creator", "Producer"))
        page.savefig(sink, format="pdf", metadata=undated)
    return sink.getvalue()


def _print_chart(ax: Any, chart: Chart, left: float, top: float) -> None:  # noqa: ANN401 - matplotlib's axes
    """Draw a chart with its upper left corner at a place, as the page does in SVG."""
    for text in chart.texts:
        x, y = left + text.x, top + text.y
        ax.text(x, y, text.words, fontsize=8.5, ha=_ALIGNED[text.css])
    middle = top + 0.5 * chart.bottom
    ax.text(left + 10.0, middle, chart.y_label, fontsize=8.5, rotation=90, va="center")
    for line in [Line("grid", chart.grid), *chart.lines]:
        ink = {"color": INKS[line.colour or 0], **_PRINTED[line.kind]}
        for stroke in line.strokes:
            ax.plot(*(np.array(stroke) + np.array([left, top])).T, **ink)
    for mark in chart.marks:
        for x, y in mark.centres:
            _mark(ax, left + x, top + y, mark.look)
    for label in chart.labels:
        _mark(ax, left + label.x, top + label.y, label.look)
        ax.text(left + label.x + 6.0, top + label.y + 3.0, label.text, fontsize=8.5)


def _mark(ax: Any, x: float, y: float, look: Look) -> None:  # noqa: ANN401 - matplotlib's axes
    ink = INKS[look.colour]
    style = {
        "color": ink,
        "markerfacecolor": "white" if look.hollow else ink,
        "markersize": 5.0,
    }
    ax.plot([x], [y], MARKERS[look.shape], **style)
