"""Cells and tables of the page: what is shown, and what it is sorted by."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

SYMBOLS = {
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
"""Of a decision: the sign that stands before it, and its colour."""


@dataclass(frozen=True, slots=True)
class Cell:
    """What is shown, and the number that it is sorted by if it is one."""

    text: str
    value: float | None = None
    tone: str = ""
    """Name of a colour for a decision."""


@dataclass(frozen=True, slots=True)
class Table:
    """A table of the page."""

    name: str
    """Unique on the page."""
    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Which columns hold numbers."""
        columns = zip(*self.rows, strict=True) if self.rows else ([] for _ in self.heads)
        return tuple(any(cell.value is not None for cell in column) for column in columns)


def table(name: str, caption: str, heads: Sequence[str], rows: Sequence[Sequence[Cell]]) -> Table:
    """Return a table."""
    return Table(name, caption, tuple(heads), tuple(tuple(row) for row in rows))


def word(text: object) -> Cell:
    """Return a cell of text; empty where it is missing."""
    return Cell("" if text is None or (isinstance(text, float) and math.isnan(text)) else str(text))


def decision(text: object) -> Cell:
    """Return a decision with the sign that says the same without colour."""
    sign, tone = SYMBOLS.get(str(text), ("", ""))
    return Cell(f"{sign} {text}".strip(), tone=tone)


def number(
    value: float | None,
    low: float | None = None,
    high: float | None = None,
    *,
    scale: float = 1.0,
    digits: int = 1,
    sign: str = "-",
    unit: str = "",
) -> Cell:
    """Return a number with its interval, as ``18.7 [18.4, 19.1]``; empty where it is unknown."""
    if value is None or not math.isfinite(value):
        return Cell("")
    shown = f"{scale * value:{sign}.{digits}f}"
    if low is not None and high is not None and math.isfinite(low) and math.isfinite(high):
        shown += f" [{scale * low:{sign}.{digits}f}, {scale * high:{sign}.{digits}f}]"
    return Cell(f"{shown} {unit}".strip(), scale * float(value))
