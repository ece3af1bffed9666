"""A table of results: built once from the frames of a run, rendered in four ways.

`terminal.show_table` prints it, `markup` makes HTML, LaTeX, Markdown and CSV of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

from evaluation.analysis.keys import level_text
from evaluation.analysis.metrics import METRICS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from isac_track.intervals import Estimate

SYMBOLS: Final = {
    "tracks": ("✓", "good"),
    "tracks weakly": ("~", "middle"),
    "does not track": ("✗", "bad"),
    "holds": ("✓", "good"),
    "yes": ("✓", "good"),
    "reversed": ("⇄", "bad"),
    "does not hold": ("✗", "bad"),
    "no": ("✗", "bad"),
    "inflated": ("▲", "bad"),
    "not inflated": ("✓", "good"),
    "deflated": ("▼", "good"),
    "undecided": ("?", "open"),
    "differs": ("✗", "bad"),
    "equal": ("✓", "good"),
    "unclear": ("?", "open"),
}
"""Of a decision: the sign that says the same without colour, and its tone."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column: what its numbers are, in which unit."""

    name: str
    unit: str = ""
    align: Literal["left", "right"] = "right"
    above: str = ""
    """What stands above the name, such as an adding rule."""
    weight: float = 0.0
    """Where there is no room, intervals of little weight go first."""
    is_long: bool = False
    """Sentences: left out of terminals and of LaTeX."""

    @property
    def head(self) -> str:
        """In one line."""
        unit = f" ({self.unit})" if self.unit else ""
        return f"{self.above} {self.name}{unit}".strip()


@dataclass(frozen=True, slots=True)
class Cell:
    """A value with its interval as text, and the number that it is sorted by if it is one."""

    text: str = ""
    low: str = ""
    high: str = ""
    unit: str = ""
    """Only where the cells of a column differ in it."""
    mark: str = ""
    """Stands behind the value; `Table.marks` says what it means."""
    value: float | None = None
    tone: str = ""
    """Name of a colour."""

    @property
    def interval(self) -> str:
        """Both ends in brackets; empty without an interval."""
        return f"[{self.low}, {self.high}]" if self.low else ""

    @property
    def full(self) -> str:
        """In one line, as ``18.7 [18.4, 19.1]``."""
        return " ".join(filter(None, [self.text + self.mark, self.interval, self.unit]))

    @property
    def signed(self) -> str:
        """A decision with its sign before it; other cells in one line."""
        sign = SYMBOLS[self.text][0] if self.tone and self.text in SYMBOLS else ""
        return f"{sign} {self.full}".strip()


@dataclass(frozen=True, eq=False, slots=True)
class Table:
    """Rows of cells below named columns."""

    name: str
    """Unique in a report."""
    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()
    marks: Mapping[str, str] | None = None
    """Of every mark that may be used: what it means."""
    n_headings: int = 0
    """Leading columns that a terminal shows above the rows which agree in them."""
    n_keys: int = 1
    """Leading columns that say what a row is of: repeated where a table is split."""

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Which columns hold numbers."""
        columns = zip(*self.rows, strict=True) if self.rows else ([] for _ in self.columns)
        return tuple(any(cell.value is not None for cell in column) for column in columns)

    @property
    def legend(self) -> str:
        """What the marks mean that are used; empty without any."""
        used = {mark for row in self.rows for cell in row for mark in cell.mark}
        return "; ".join(
            f"{mark} {text}" for mark, text in (self.marks or {}).items() if mark in used
        )


Made: TypeAlias = "tuple[Column, Callable[[Any], Cell]]"
"""A column, and what makes the cell of a record."""


def table(
    name: str,
    title: str,
    columns: Sequence[Column],
    rows: Sequence[Sequence[Cell]],
    *,
    notes: Sequence[str] = (),
    marks: Mapping[str, str] | None = None,
    n_headings: int = 0,
    n_keys: int = 1,
) -> Table:
    """Return a table of any sequences.

    Raises
    ------
    ValueError
        If a row has not a cell for each column.
    """
    if any(len(row) != len(columns) for row in rows):
        raise ValueError(f"table {name}: rows need {len(columns)} cells each")
    return Table(
        name,
        title,
        tuple(columns),
        tuple(map(tuple, rows)),
        tuple(notes),
        marks,
        n_headings,
        n_keys,
    )


def built(
    name: str,
    title: str,
    records: Iterable[Any],
    columns: Iterable[Made],
    *,
    notes: Sequence[str] = (),
    n_headings: int = 0,
    n_keys: int = 1,
) -> Table:
    """Return a table with a row for each record, its columns given with what makes their cells."""
    pairs = list(columns)
    return table(
        name,
        title,
        [column for column, _ in pairs],
        [[cell(record) for _, cell in pairs] for record in records],
        notes=notes,
        n_headings=n_headings,
        n_keys=n_keys,
    )


def said(name: str, of: str | Callable[[Any], object] = "") -> Made:
    """Return a column of words: what a record has under its name, under a key, or by a function."""
    take = of if callable(of) else itemgetter(of or name)
    return Column(name, align="left"), lambda record: word(take(record))


def decided(name: str, of: str = "") -> Made:
    """Return a column of decisions."""
    return Column(name, align="left"), lambda record: decision(record[of or name])


def counted(
    name: str,
    unit: str,
    *keys: str,
    scale: float = 1.0,
    digits: int = 1,
    sign: str = "-",
) -> Made:
    """Return a column of numbers: keys of value and, if there is one, both ends of the interval."""
    return Column(name, unit), lambda record: number(
        *(record[key] for key in keys), scale=scale, digits=digits, sign=sign
    )


def measured(name: str, *keys: str, metric: str = "", sign: str = "-") -> Made:
    """Return a column of a metric, or of the one that each record names, as it is shown."""
    unit = METRICS[metric].unit if metric else ""
    return Column(name, unit), lambda record: amount(
        metric or record["metric"], *(record[key] for key in keys), sign=sign
    )


def words(*names: str) -> list[Column]:
    """Return columns of words."""
    return [Column(name, align="left") for name in names]


def word(text: object) -> Cell:
    """Return a cell of text; empty where it is missing."""
    return Cell("" if text is None or (isinstance(text, float) and math.isnan(text)) else str(text))


def decision(text: object) -> Cell:
    """Return a cell with a decision."""
    return Cell(str(text), tone=SYMBOLS.get(str(text), ("", ""))[1])


def number(
    value: float | None,
    low: float | None = None,
    high: float | None = None,
    *,
    scale: float = 1.0,
    digits: int = 1,
    sign: str = "-",
    unit: str = "",
    mark: str = "",
) -> Cell:
    """Return a cell with a number and its interval, `scale` times as large; empty where unknown.

    `sign` is "+" for a difference.
    """
    if value is None or not math.isfinite(value):
        return Cell("")
    ends = ("", "")
    if low is not None and high is not None and math.isfinite(low) and math.isfinite(high):
        ends = (f"{scale * low:{sign}.{digits}f}", f"{scale * high:{sign}.{digits}f}")
    text = f"{scale * value:{sign}.{digits}f}"
    return Cell(text, *ends, unit=unit, mark=mark, value=scale * float(value))


def amount(
    metric: str,
    value: float | None,
    low: float | None = None,
    high: float | None = None,
    *,
    sign: str = "-",
    mark: str = "",
) -> Cell:
    """Return a cell with a metric and its interval, in the unit and digits in which it is shown."""
    shown = METRICS[metric]
    return number(value, low, high, scale=shown.scale, digits=shown.digits, sign=sign, mark=mark)


def estimated(metric: str, one: Estimate, *, mark: str = "") -> Cell:
    """Return the cell of an estimate of a metric."""
    return amount(metric, one.value, one.ci_low, one.ci_high, mark=mark)


def metric_of(row: Mapping[str, Any], *, mark: str = "") -> Cell:
    """Return the cell of a row of `summary.csv`."""
    return amount(row["metric"], row["value"], row["ci_low"], row["ci_high"], mark=mark)


def metric_column(metric: str, name: str = "", *, weight: float = 0.0) -> Column:
    """Return the column of a metric, under its own name or another."""
    shown = METRICS[metric]
    return Column(name or shown.head, shown.unit, weight=weight)


def level(value: float | None) -> Cell:
    """Return a level; empty for a mechanism without one."""
    known = value is not None and math.isfinite(value)
    return Cell(level_text(value), value=value if known else None)
