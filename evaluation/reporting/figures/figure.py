"""The figures of a run, panels of charts: a file of this folder with `figures` makes some."""

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

from evaluation.reporting.charts import CHARACTER, INKS, MARKERS, WIDTH, Chart, Look
from evaluation.reporting.markup import HTML
from evaluation.reporting.rows import Results
from evaluation.reporting.table import printable, shortened
from evaluation.store.files import write_whole

_TOP, _LEFT, _HEADING, _GAP = 26.0, 10.0, 16.0, 14.0
_LINE: Final = 14.0  # Of the caption and the note.
_TEXT_CHARACTER: Final = 5.3  # How wide a character of these is, on average.
_PRINTED: Final[dict[str, dict[str, Any]]] = {  # What `chart.css` says of each class.
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
    key: Mapping[
        str, Look
    ]  # What each mark is of, where no label beside a curve says so.
    caption: str = ""  # What its numbers say: a sentence.
    note: str = ""  # How to read it.


class Layout(NamedTuple):
    """Where everything of a figure stands."""

    width: float
    height: float
    lines: list[tuple[float, str]]  # Height and words of the caption and the note.
    panels: list[tuple[float, float, str, Chart]]  # Left, top, heading and chart.
    key: list[tuple[float, float, str, Look]]  # Middle of each mark, and what it is of.


def figures_of(run: Results) -> list[Figure]:
    """Return the figures of a run that have a panel, of every file of this folder."""
    folder = __name__.rpartition(".")[0]
    names = [one.name for one in iter_modules(import_module(folder).__path__)]
    modules = [import_module(f"{folder}.{name}") for name in names]
    every = (one for of in modules if hasattr(of, "figures") for one in of.figures(run))
    return [one for one in every if one.panels]


def write(figures: Iterable[Figure], *, folder: Path, dataset: str, pdf: bool) -> None:
    """Write every figure of a data set as SVG, with `pdf` as PDF, too. DataError if that fails."""
    with contextlib.suppress(OSError):  # write_whole says what is wrong
        folder.mkdir(parents=True, exist_ok=True)
    template = HTML.get_template("figure.svg.j2")
    for of in figures:
        one = replace(
            of, title=printable(f"{shortened(dataset, room=_ROOM)}: {of.title}")
        )
        text = template.render(of=one, at=_layout(one))
        write_whole(folder / f"{one.name}.svg", text.encode())
        if pdf:
            write_whole(folder / f"{one.name}.pdf", _printed(one))


def _layout(of: Figure) -> Layout:
    columns = min(of.columns, len(of.panels))
    width, top, panels = columns * (WIDTH + _GAP), _TOP, []
    lines = list[tuple[float, str]]()
    for text in _wrapped(of.caption, width):
        lines.append((top + 4.0, text))
        top += _LINE
    for start in range(0, len(of.panels), of.columns):
        row = of.panels[start : start + of.columns]
        for place, (heading, chart) in enumerate(row):
            panels.append((place * (WIDTH + _GAP), top + _HEADING, heading, chart))
        top += _HEADING + max(chart.height for _, chart in row) + _GAP
    key, x = [], _LEFT
    for name, look in of.key.items():
        needed = CHARACTER * len(name) + 26.0
        if x > _LEFT and x + needed > width:
            x, top = _LEFT, top + 15.0
        key.append((x, top, name, look))
        x += needed
    top += _LINE if key else 0.0
    for text in _wrapped(of.note, width):
        lines.append((top, text))
        top += _LINE
    return Layout(width, top + 4.0, lines, panels, key)


def _wrapped(text: str, width: float) -> list[str]:
    """Return a text in lines that fit into a width."""
    return textwrap.wrap(text, int((width - 2 * _LEFT) / _TEXT_CHARACTER))


def _printed(of: Figure) -> bytes:
    """Return a figure as PDF, the same bytes each time, whatever the user's own settings are."""
    import matplotlib as mpl  # noqa: PLC0415 - slow to import, and seldom needed
    from matplotlib.figure import Figure as Page  # noqa: PLC0415 - as said

    at = _layout(of)
    usual = mpl.rcParamsDefault | {"text.parse_math": False}
    with mpl.rc_context(usual), warnings.catch_warnings():
        # A data set may be named in a script that the bundled font lacks.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        page = Page(figsize=(at.width / 72.0, at.height / 72.0))
        ax = page.add_axes(
            (0.0, 0.0, 1.0, 1.0), xlim=(0.0, at.width), ylim=(at.height, 0.0)
        )
        ax.set_axis_off()
        ax.text(8.0, 16.0, of.title, fontsize=11.0, weight="bold")
        for left, top, heading, chart in at.panels:
            ax.text(left + 8.0, top - 4.0, heading, fontsize=9.5, weight="bold")
            for x, y, kind, text in chart.texts:
                ax.text(left + x, top + y, text, fontsize=8.5, ha=_ALIGNED[kind])
            middle = top + 0.5 * chart.bottom
            ax.text(
                left + 10.0,
                middle,
                chart.y_label,
                fontsize=8.5,
                rotation=90,
                va="center",
            )
            for css, strokes in [("grid", chart.grid), *chart.lines]:
                kind, _, colour = css.partition(" k")
                ink = {"color": INKS[int(colour or 0)], **_PRINTED[kind]}
                for line in strokes:
                    ax.plot(*(np.array(line) + np.array([left, top])).T, **ink)
            for look, places, _ in chart.marks:
                for x, y in places:
                    _mark(ax, left + x, top + y, look)
            for label in chart.labels:
                _mark(ax, left + label.x, top + label.y, label.look)
                ax.text(
                    left + label.x + 6.0, top + label.y + 3.0, label.text, fontsize=8.5
                )
        for y, text in at.lines:
            ax.text(8.0, y, text, fontsize=8.5)
        for x, y, name, look in at.key:
            _mark(ax, x, y, look)
            ax.text(x + 8.0, y + 3.0, name, fontsize=8.5)
        sink, dated = (
            io.BytesIO(),
            dict.fromkeys(("CreationDate", "Creator", "Producer")),
        )
        page.savefig(sink, format="pdf", metadata=dated)
    return sink.getvalue()


def _mark(ax: Any, x: float, y: float, of: Look) -> None:  # noqa: ANN401 - matplotlib's axes
    ink = INKS[of.place]
    look = {
        "color": ink,
        "markerfacecolor": "white" if of.hollow else ink,
        "markersize": 5.0,
    }
    ax.plot([x], [y], MARKERS[of.shape], **look)
