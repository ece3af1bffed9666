"""A table of results, rendered by `terminal`, `markup` and the page's templates."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Final, Literal

from evaluation.estimates.keys import level_text
from evaluation.estimates.metrics import METRICS
from evaluation.reporting.amounts import PERCENT

if TYPE_CHECKING:
    from isac_track.intervals import Estimate

_SIGNS = (
    ("✓", "good", ("tracks", "holds", "yes", "not inflated", "equal")),
    ("▼", "good", ("deflated",)),
    ("✗", "bad", ("does not track", "does not hold", "no", "differs")),
    ("⇄", "bad", ("reversed",)),
    ("▲", "bad", ("inflated",)),
    ("·", "open", ("between", "not testable")),
)
SYMBOLS: Final = {text: (sign, tone) for sign, tone, texts in _SIGNS for text in texts}
"""By decision: the sign that says the same without colour, and its tone."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A value with its interval as text, and the number that it is sorted by."""

    text: str = ""
    low: str = ""
    high: str = ""
    unit: str = ""  # Only where the cells of a column differ in it.
    mark: str = ""  # Stands behind the value; `Table.marks` says what it means.
    value: float | None = None  # None for text.
    tone: str = ""  # Name of a colour.
    link: str = ""  # Where the text leads to, on a page.

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


@dataclass(frozen=True, slots=True)
class Column:
    """A column: its name and unit, and the function from a record to its cell."""

    name: str
    make_cell: Callable[[Any], Cell] = lambda _: Cell()
    unit: str = ""
    align: Literal["left", "right"] = "right"
    above: str = ""  # What stands above the name, such as an adding rule.
    is_long: bool = False  # Sentences: left out of terminals and of LaTeX.

    @property
    def head(self) -> str:
        """The heading in one line."""
        unit = f" ({self.unit})" if self.unit else ""
        return f"{self.above} {self.name}{unit}".strip()


@dataclass(frozen=True, eq=False, slots=True)
class Table:
    """Rows of cells below named columns.

    `numeric` raises ValueError if rows differ in their number of cells.
    """

    name: str  # Unique in a report.
    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]]
    notes: Sequence[str] = ()
    # The meaning of every mark that a cell may carry.
    marks: Mapping[str, str] | None = None
    n_headings: int = 0  # Leading columns: LaTeX has a rule where they change.
    # Leading columns that say what a row is of: repeated where a table is split.
    n_keys: int = 1

    @property
    def numeric(self) -> list[bool]:
        """Which columns hold numbers."""
        columns = zip(*self.rows, strict=True)
        return [any(cell.value is not None for cell in cells) for cells in columns]

    @property
    def legend(self) -> str:
        """The meaning of the marks in use; empty without any."""
        used = {mark for row in self.rows for cell in row for mark in cell.mark}
        known = (self.marks or {}).items()
        return "; ".join(f"{mark} {text}" for mark, text in known if mark in used)


def build_table(
    name: str,
    title: str,
    records: Iterable[Any],
    columns: Sequence[Column],
    **options: Any,  # noqa: ANN401 - the other fields of `Table`
) -> Table:
    """Build a table with a row for each record; `options` are the other fields."""
    rows = [[column.make_cell(record) for column in columns] for record in records]
    return Table(name, title, columns, rows, **options)


def text_column(name: str, source: str | Callable[[Any], object] = "") -> Column:
    """Return a column of text, aligned left.

    `source` is the key of a record's text, by default `name`, or a function of the
    record.
    """
    take = source if callable(source) else itemgetter(source or name)
    return Column(name, lambda record: text_cell(take(record)), align="left")


def cell_column(name: str, key: str = "", **options: Any) -> Column:  # noqa: ANN401 - see `Column`
    """Return a column of the cells that records hold; empty where a record has none."""
    return Column(name, lambda record: record.get(key or name, Cell()), **options)


def decision_column(name: str) -> Column:
    """Return a column of decisions."""
    return Column(name, lambda record: decision_cell(record[name]), align="left")


def number_column(name: str, unit: str, *keys: str, **style: Any) -> Column:  # noqa: ANN401 - see `number_cell`
    """Return a column of numbers.

    `keys` name the value and, if there is an interval, both of its ends.
    """

    def make_cell(record: Mapping[str, Any]) -> Cell:
        return number_cell(*(record[key] for key in keys), **style)

    return Column(name, make_cell, unit)


def share_column(name: str, *keys: str, unit: str = "%", **style: Any) -> Column:  # noqa: ANN401 - see `number_cell`
    """Return a column of fractions in percent, or of their differences in points."""
    return number_column(name, unit, *keys, scale=PERCENT, **style)


def metric_column(name: str, *keys: str, sign: str = "-") -> Column:
    """Return a column of the metric that each record names, as it is shown."""

    def make_cell(record: Mapping[str, Any]) -> Cell:
        values = (record[key] for key in keys)
        return metric_cell(record["metric"], *values, sign=sign)

    return Column(name, make_cell)


def text_cell(text: object) -> Cell:
    """Return a cell of text; empty where it is missing."""
    is_missing = text is None or (isinstance(text, float) and math.isnan(text))
    return Cell("" if is_missing else str(text))


def decision_cell(text: object) -> Cell:
    """Return a cell with a decision."""
    return Cell(str(text), tone=SYMBOLS.get(str(text), ("", ""))[1])


def number_cell(
    value: float | None,
    *interval: float | None,
    scale: float = 1.0,
    digits: int = 1,
    sign: str = "-",
    unit: str = "",
    mark: str = "",
) -> Cell:
    """Return a cell with a number and its interval times `scale`.

    `sign` is "+" for a difference.
    """
    if value is None or not math.isfinite(value):
        return Cell()
    known = [
        scale * bound
        for bound in (value, *interval)
        if bound is not None and math.isfinite(bound)
    ]
    text, *ends = (f"{bound:{sign}.{digits}f}" for bound in known)
    low, high = ends if len(ends) > 1 else ("", "")
    return Cell(text, low, high, unit, mark, value=known[0])


def metric_cell(
    metric: str, *values: float | None, sign: str = "-", mark: str = ""
) -> Cell:
    """Return a cell with a metric and its interval, in the metric's unit and digits."""
    style = METRICS[metric]
    return number_cell(
        *values, scale=style.scale, digits=style.digits, sign=sign, mark=mark
    )


def estimate_cell(metric: str, estimate: Estimate | None, *, mark: str = "") -> Cell:
    """Return the cell of an estimate of a metric; empty without an estimate."""
    if not estimate:
        return Cell()
    return metric_cell(
        metric, estimate.value, estimate.ci_low, estimate.ci_high, mark=mark
    )


def level_cell(value: float | None) -> Cell:
    """Return a cell with a level; empty for a mechanism without levels."""
    return replace(text_cell(level_text(value)), value=number_cell(value).value)


def shorten_name(name: str, *, room: int) -> str:
    """Cut the middle out of a name that is too long: its settings are at the end."""
    if len(name) <= room:
        return name
    end = (room - 3) // 2
    return f"{name[: room - 3 - end]}...{name[-end:]}"


def plugin_label(name: str) -> str:
    """Return the name of a plug-in; a class in a module goes by the class alone."""
    return re.sub(r"^[\w.]*\.\w+:(?=[A-Za-z])", "", name)


def printable(text: str) -> str:
    """Replace characters that could move a cursor or break a line."""
    return "".join(character if character.isprintable() else "?" for character in text)
