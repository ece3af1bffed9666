"""Lines on a terminal: literal text, columns that line up, and headings between them."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from evaluation.analysis.levels import printable

if TYPE_CHECKING:
    from collections.abc import Sequence
    from collections.abc import Set as AbstractSet

PIPE_WIDTH = 116
"""Columns where there is no terminal: room for every interval of a sweep."""


def standard_output() -> Console:
    """Return standard output, as wide as the terminal or `PIPE_WIDTH` where there is none."""
    piped = not sys.stdout.isatty() and "COLUMNS" not in os.environ
    return Console(width=PIPE_WIDTH if piped else None, highlight=False)


def say(console: Console, text: str, style: str = "", *, wrap: bool = False) -> None:
    """Print text as it is, without markup and in characters that the terminal has."""
    console.print(
        Text(literal(console, text), style=style),
        no_wrap=not wrap,
        overflow="fold" if wrap else "crop",
    )


def literal(console: Console, text: str) -> str:
    """Return text without what could move a cursor, in characters that the terminal has."""
    return printable(text).encode(console.encoding, "replace").decode(console.encoding)


def aligned(
    rows: Sequence[Sequence[str]],
    *,
    left: AbstractSet[int] = frozenset(),
    close: AbstractSet[int] = frozenset(),
) -> list[str]:
    """Return the rows as lines whose columns line up.

    Cells go to the right of their column except in `left`; the columns of `close` stand near
    the one before.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        line = ""
        for column, (cell, width) in enumerate(zip(row, widths, strict=True)):
            gap = "" if column == 0 else " " if column in close else "  "
            line += gap + (cell.ljust(width) if column in left else cell.rjust(width))
        lines.append(line.rstrip())
    return lines


def show_grouped(
    rows: Sequence[tuple[str | None, list[str]]], lines: Sequence[str], *, console: Console
) -> None:
    """Print the lines under each new heading, unless their first cell says the same.

    Rows without a heading are the table's head.
    """
    shown: str | None = None
    for (heading, cells), line in zip(rows, lines, strict=True):
        if heading is not None and heading not in (shown, cells[0]):
            say(console, heading, "bold cyan")
        shown = heading
        say(console, line, "bold" if heading is None else "")
