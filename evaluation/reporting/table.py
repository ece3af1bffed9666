"""A table of results: built once, rendered by `terminal`, `markup`, and the templates of a page."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Final, Literal

from evaluation.estimates.keys import level_text
from evaluation.estimates.metrics import METRICS

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
"""Of a decision: the sign that says the same without colour, and its tone."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A value with its interval as text, and the number that it is sorted by if it is one."""

    text: str = ""
    low: str = ""
    high: str = ""
    unit: str = ""  # Only where the cells of a column differ in it.
    mark: str = ""  # Stands behind the value; `Table.marks` says what it means.
    value: float | None = None
    tone: str = ""  # Name of a colour.

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
    """A column: what its numbers are, in which unit, and what makes the cell of a record."""

    name: str
    of: Callable[[Any], Cell] = lambda _: Cell()
    unit: str = ""
    align: Literal["left", "right"] = "right"
    above: str = ""  # What stands above the name, such as an adding rule.
    is_long: bool = False  # Sentences: left out of terminals and of LaTeX.

    @property
    def head(self) -> str:
        """In one line."""
        unit = f" ({self.unit})" if self.unit else ""
        return f"{self.above} {self.name}{unit}".strip()


@dataclass(frozen=True, eq=False, slots=True)
class Table:
    """Rows of cells below named columns; ValueError where a row has not a cell for each column."""

    name: str  # Unique in a report.
    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]]
    notes: Sequence[str] = ()
    # Of every mark that may be used: what it means.
    marks: Mapping[str, str] | None = None
    n_headings: int = 0  # Leading columns: LaTeX has a rule where they change.
    # Leading columns that say what a row is of: repeated where a table is split.
    n_keys: int = 1

    @property
    def numeric(self) -> list[bool]:
        """Which columns hold numbers."""
        of = zip(*self.rows, strict=True)
        return [any(cell.value is not None for cell in cells) for cells in of]

    @property
    def legend(self) -> str:
        """What the marks mean that are used; empty without any."""
        used = {mark for row in self.rows for cell in row for mark in cell.mark}
        known = (self.marks or {}).items()
        return "; ".join(f"{mark} {text}" for mark, text in known if mark in used)


def built(
    name: str,
    title: str,
    records: Iterable[Any],
    columns: Sequence[Column],
    **options: Any,  # noqa: ANN401 - the other fields of `Table`
) -> Table:
    """Return a table with a row for each record; `options` are the other fields of a table."""
    rows = [[one.of(record) for one in columns] for record in records]
    return Table(name, title, columns, rows, **options)


def said(name: str, of: str | Callable[[Any], object] = "") -> Column:
    """Return a column of words: what a record has under its name, under a key, or by a function."""
    take = of if callable(of) else itemgetter(of or name)
    return Column(name, lambda record: word(take(record)), align="left")


def held(name: str, key: str = "", **more: Any) -> Column:  # noqa: ANN401 - see `Column`
    """Return a column of cells that records have ready; empty where one has none."""
    return Column(name, lambda record: record.get(key or name, Cell()), **more)


def decided(name: str) -> Column:
    """Return a column of decisions."""
    return Column(name, lambda record: decision(record[name]), align="left")


def counted(name: str, unit: str, *keys: str, **shown: Any) -> Column:  # noqa: ANN401 - see `number`
    """Return a column of numbers: keys of value and, if there is one, both ends of the interval."""
    return Column(
        name, lambda record: number(*(record[key] for key in keys), **shown), unit
    )


def measured(name: str, *keys: str, sign: str = "-") -> Column:
    """Return a column of the metric that each record names, as it is shown."""
    return Column(
        name, lambda one: amount(one["metric"], *(one[key] for key in keys), sign=sign)
    )


def word(text: object) -> Cell:
    """Return a cell of text; empty where it is missing."""
    return Cell(
        ""
        if text is None or (isinstance(text, float) and math.isnan(text))
        else str(text)
    )


def decision(text: object) -> Cell:
    """Return a cell with a decision."""
    return Cell(str(text), tone=SYMBOLS.get(str(text), ("", ""))[1])


def number(
    value: float | None,
    *interval: float | None,
    scale: float = 1.0,
    digits: int = 1,
    sign: str = "-",
    unit: str = "",
    mark: str = "",
) -> Cell:
    """Return a cell with a number and its interval times `scale`; `sign` is "+" of a difference."""
    if value is None or not math.isfinite(value):
        return Cell()
    known = [
        scale * one
        for one in (value, *interval)
        if one is not None and math.isfinite(one)
    ]
    text, *ends = (f"{one:{sign}.{digits}f}" for one in known)
    low, high = ends if len(ends) > 1 else ("", "")
    return Cell(text, low, high, unit, mark, value=known[0])


def amount(metric: str, *values: float | None, sign: str = "-", mark: str = "") -> Cell:
    """Return a cell with a metric and its interval, in the unit and digits in which it is shown."""
    shown = METRICS[metric]
    return number(*values, scale=shown.scale, digits=shown.digits, sign=sign, mark=mark)


def estimated(metric: str, one: Estimate | None, *, mark: str = "") -> Cell:
    """Return the cell of an estimate of a metric; empty without one."""
    return (
        amount(metric, one.value, one.ci_low, one.ci_high, mark=mark) if one else Cell()
    )


def level(value: float | None) -> Cell:
    """Return a level; empty for a mechanism without one."""
    return replace(word(level_text(value)), value=number(value).value)


def shortened(name: str, *, room: int) -> str:
    """Return a name without its middle if it is too long: its settings are at the end."""
    if len(name) <= room:
        return name
    end = (room - 3) // 2
    return f"{name[: room - 3 - end]}...{name[-end:]}"


def spoken(name: str) -> str:
    """Return the name of a plug-in, a class in a module by the class alone."""
    return re.sub(r"^[\w.]*\.\w+:(?=[A-Za-z])", "", name)


def printable(text: str) -> str:
    """Return a name without what could move a cursor or break a line."""
    return "".join(character if character.isprintable() else "?" for character in text)
