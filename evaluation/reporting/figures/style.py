"""How figures look, and how they become files: style, axes, legend and title.

The same figure gives the same bytes: no dates, no random ids, and nothing from the user's own
matplotlib settings. Colours are those of Okabe and Ito; marker and line style tell the same in
grey.
"""

from __future__ import annotations

import contextlib
import io
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib import style as styles
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullLocator

from evaluation.analysis.metrics import DESCRIPTORS, METRICS, MISSED_RATE

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from numpy.typing import NDArray

    from evaluation.reporting.schemes import Scheme
    from isac_track.types import Floats

Dashes = Literal["", "-", "--", "-.", ":"] | tuple[float, tuple[float, ...]]

SINGLE_COLUMN_IN, DOUBLE_COLUMN_IN = 3.5, 7.16
"""Widths of a figure in an IEEE journal."""
CHARACTERS_PER_IN = 17.5
"""At 7 to 8 points."""
LOG_RATIO = 5.0
"""A logarithmic axis has too few ticks where the data span less."""
NAME_LENGTH = 40

_BAND_ALPHA = 0.18
_IMAGE_DPI = 200
_HANDLE_CHARACTERS = 10
_RC = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.labelsize": 7.5,
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 7.5,
    "figure.titlesize": 8,
    "font.size": 7,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.4,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "lines.linewidth": 1.1,
    "lines.markersize": 3.2,
    "pdf.fonttype": 42,
    # Outlines look the same where the font is missing; the PDF holds the words.
    "svg.fonttype": "path",
    "svg.hashsalt": "isac-track",
    # Names are shown as they are, whatever `$` or `_` they hold.
    "text.parse_math": False,
    "xtick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.labelsize": 7,
    "ytick.major.width": 0.6,
}


@dataclass(frozen=True, slots=True)
class Look:
    """Colour, marker and line style of a line."""

    colour: str
    marker: str
    dashes: Dashes


# Dotted is kept for the raw baseline.
LOOKS = (
    Look("#0072B2", "o", "-"),
    Look("#D55E00", "s", "--"),
    Look("#009E73", "^", "-."),
    Look("#CC79A7", "X", (0, (5, 1, 1, 1, 1, 1))),
    Look("#E69F00", "P", (0, (8, 2))),
)


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Set matplotlib's defaults and ours, whatever the user's own settings are."""
    with styles.context(["default", _RC]), warnings.catch_warnings():
        # A data set may be named in a script that the bundled font lacks.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield


def empty_figure(*, width_in: float, height_in: float) -> Figure:
    """Return a figure that makes room for its labels, legend and title."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def placed_figure(*, width_in: float, height_in: float) -> Figure:
    """Return a figure whose panels are placed by hand."""
    return Figure(figsize=(width_in, height_in), dpi=_IMAGE_DPI)


def placed(
    figure: Figure,
    *,
    rows: int,
    columns: int,
    left_in: float,
    right_in: float,
    top_in: float,
    bottom_in: float,
    gap_in: float,
    between_in: float = 0.0,
    sharex: bool | Literal["col"] = False,
    sharey: bool = False,
) -> NDArray[Any]:
    """Return a grid of panels, (rows, columns), within margins and with gaps in inches."""
    width_in, height_in = figure.get_size_inches()
    panel_width_in = (width_in - left_in - right_in - gap_in * (columns - 1)) / columns
    panel_height_in = (height_in - top_in - bottom_in - between_in * (rows - 1)) / rows
    panels: NDArray[Any] = figure.subplots(
        rows,
        columns,
        squeeze=False,
        sharex=sharex,
        sharey=sharey,
        gridspec_kw={
            "left": left_in / width_in,
            "right": 1.0 - right_in / width_in,
            "top": 1.0 - top_in / height_in,
            "bottom": bottom_in / height_in,
            "wspace": gap_in / panel_width_in,
            "hspace": between_in / panel_height_in,
        },
    )
    return panels


def rendered(figure: Figure) -> dict[str, bytes]:
    """Return the figure as `svg` and `pdf`.

    It is laid out once for both, and printed by the canvases themselves: `savefig` would find
    the layout anew and draw everything twice each time.
    """
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")
    svg, pdf = io.BytesIO(), io.BytesIO()
    FigureCanvasSVG(figure).print_svg(  # type: ignore[no-untyped-call]
        svg, metadata={"Date": None, "Creator": None}
    )
    FigureCanvasPdf(figure).print_pdf(  # type: ignore[no-untyped-call]
        pdf, metadata={"CreationDate": None, "Creator": None, "Producer": None}
    )
    return {"svg": svg.getvalue(), "pdf": pdf.getvalue()}


def band(ax: Axes, *, x: Floats, low: Floats, high: Floats, look: Look) -> None:
    """Fill the interval around a line; it has gaps where the interval is unknown."""
    ax.fill_between(x, low, high, color=look.colour, alpha=_BAND_ALPHA, linewidth=0)


def level_axis(ax: Axes, *, log: bool) -> None:
    """Set the axis of a mechanism's level."""
    if log:
        ax.set_xscale("log")
        _plain_ticks(ax.xaxis, LogLocator())
    else:
        ax.set_xlim(left=0)


def value_axis(ax: Axes, values: Sequence[Floats], *, log: bool) -> None:
    """Start at zero, or take a logarithmic axis where it is wanted and the data span it."""
    known = np.concatenate(values)
    if log and known.min() > 0 and known.max() > LOG_RATIO * known.min():
        ax.set_yscale("log")
        _plain_ticks(ax.yaxis, LogLocator(subs=(1.0, 2.0, 5.0)))
    else:
        # A little below zero, so that a marker at zero is whole.
        ax.set_ylim(bottom=-0.03 * ax.get_ylim()[1])


def look_of(scheme: Scheme) -> Look:
    """Return the look of what is swept, the same in every figure."""
    return LOOKS[scheme.place % len(LOOKS)]


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


def line_handle(text: str, look: Look) -> Line2D:
    """Return the legend's entry of a line."""
    return Line2D([], [], color=look.colour, marker=look.marker, linestyle=look.dashes, label=text)


def black_handle(
    text: str, *, marker: str = "", dashes: Dashes = "", hollow: bool = False
) -> Line2D:
    """Return the legend's entry of something that has no colour of its own."""
    return Line2D(
        [],
        [],
        color="black",
        marker=marker,
        markersize=5,
        markerfacecolor="white" if hollow else "black",
        linestyle=dashes,
        label=text,
    )


def band_handle(text: str) -> Patch:
    """Return the legend's entry of a band."""
    return Patch(color="black", alpha=_BAND_ALPHA, linewidth=0, label=text)


def legend(figure: Figure, handles: Sequence[Artist]) -> None:
    """Put a legend below the panels, in as few rows as its words allow."""
    room = CHARACTERS_PER_IN * figure.get_figwidth()
    widths = [len(str(handle.get_label())) + _HANDLE_CHARACTERS for handle in handles]
    columns = next(
        n
        for n in range(len(handles), 0, -1)
        if n == 1 or sum(max(column) for column in np.array_split(widths, n)) <= room
    )
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)


def legend_in_rows(figure: Figure, handles: Sequence[Artist], *, columns: int) -> None:
    """Put a legend along the lower edge of a figure that is placed by hand."""
    figure.legend(
        handles=handles,
        loc="lower center",
        bbox_to_anchor=(0.5, 0.0),
        ncols=columns,
        borderaxespad=0.2,
        columnspacing=1.4,
    )


def title(figure: Figure, *, dataset: str, what: str, one_line: bool = False) -> None:
    """Write the data set's name and what is shown above the panels."""
    name = "".join(character if character.isprintable() else " " for character in dataset)
    if len(name) > NAME_LENGTH:
        name = name[: NAME_LENGTH - 1] + "…"
    separator = ": " if one_line or figure.get_figwidth() > SINGLE_COLUMN_IN else "\n"
    top = 1.0 - 0.05 / figure.get_figheight() if figure.get_layout_engine() is None else None
    figure.suptitle(
        f"{name}{separator}{what}",
        x=0.01,
        horizontalalignment="left",
        **({} if top is None else {"y": top, "verticalalignment": "top"}),
    )


def _plain_ticks(axis: Axis, locator: LogLocator) -> None:
    axis.set_major_locator(locator)
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(lambda value, _: number(value))
