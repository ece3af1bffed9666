"""Lines on a terminal: literal text, columns that line up, and headings between them."""

from __future__ import annotations

import os
import re
import sys
import textwrap
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from evaluation.reporting.texts import printable

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from collections.abc import Set as AbstractSet

    from evaluation.reporting.table import Cell, Table

PIPE_WIDTH = 116
"""Columns where there is no terminal: room for every interval of a sweep."""
_HEAD_WIDTH = 10
_SHORT = 8
_LEAST_WORDS = 16
"""Below this words are not wrapped to."""


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


def show_table(table: Table, *, console: Console, whole: bool = False) -> None:
    """Print a table: title, lines that fit, what its marks mean, and its notes.

    Where there is no room, intervals go first, those of light columns before all others; then the
    table is split, and nothing else if it is to stay `whole`. Nothing is printed of a table
    without rows.
    """
    if not table.rows:
        return
    columns = [
        place
        for place, column in enumerate(table.columns)
        if place >= table.n_headings and not column.is_long
    ]
    keys = [place for place in columns if place < table.n_keys]
    others = [place for place in columns if place not in keys]
    parts = _parts(table, keys, others, width=console.width, whole=whole)
    for part in parts:
        intervals, lines = _fitting(table, part, console.width)
        left_out = intervals < _intervals(table, part)
        console.print()
        told = " where there is room"
        if not table.title.endswith("intervals"):
            told = f" (intervals{told})"
        title = table.title + told * left_out
        say(console, title, "bold", wrap=True)
        for line, style in lines:
            say(console, line, style)
    for note in [*([f"({table.legend})"] if table.legend else []), *table.notes]:
        say(console, note, wrap=True)


def _intervals(table: Table, columns: Iterable[int]) -> set[int]:
    """Return which of the columns have intervals."""
    return {place for place in columns if any(row[place].low for row in table.rows)}


def _parts(
    table: Table, keys: list[int], others: list[int], *, width: int, whole: bool
) -> list[list[int]]:
    """Return the columns in parts that fit, with intervals if `whole`, each beside the keys."""
    parts = [keys]
    for place in others:
        wider = [*parts[-1], place]
        intervals = _intervals(table, wider) if whole else set()
        lines = _lines(table, wider, intervals=intervals, width=width)
        if len(parts[-1]) > len(keys) and max(len(line) for line, _ in lines) > width:
            parts.append([*keys, place])
        else:
            parts[-1] = wider
    return parts


def _fitting(
    table: Table, columns: list[int], width: int
) -> tuple[set[int], list[tuple[str, str]]]:
    """Return which columns keep their intervals, and the lines."""
    # The last of the light ones go first.
    order = sorted(
        _intervals(table, columns), key=lambda place: (-table.columns[place].weight, place)
    )
    for n in range(len(order), -1, -1):
        lines = _lines(table, columns, intervals=set(order[:n]), width=width)
        if max(len(line) for line, _ in lines) <= width:
            break
    return set(order[:n]), lines


def _lines(
    table: Table, columns: list[int], *, intervals: set[int], width: int
) -> list[tuple[str, str]]:
    """Return the lines with their styles: heads, headings, and rows whose columns line up."""
    shown = [_column(table, place, has_interval=place in intervals) for place in columns]
    depth = max(len(head) for head, _ in shown)
    heads = [[""] * (depth - len(head)) + head for head, _ in shown]
    grid = [[head[line] for head in heads] for line in range(depth)]
    grid += [list(cells) for cells in zip(*(cells for _, cells in shown), strict=True)]
    headings = [_heading(table, row) for row in table.rows]
    for place, (heading, cells) in enumerate(zip(headings, grid[depth:], strict=True)):
        # Short, alone and without a level: it stands where the level would.
        if heading and headings.count(heading) == 1 and not cells[0] and len(heading) <= _SHORT:
            headings[place], cells[0] = "", heading
    left = {n for n, place in enumerate(columns) if table.columns[place].align == "left"}
    wrapped, owner = _wrapped(grid, left=left, width=width)
    lines: list[tuple[str, str]] = []
    above = ""
    for line, row in zip(aligned(wrapped, left=left), owner, strict=True):
        if row < depth:
            lines.append((line, "bold"))
            continue
        heading = headings[row - depth]
        if heading and heading != above:
            lines.append((heading, "bold cyan"))
        above = heading
        lines.append((line, ""))
    return lines


def _column(table: Table, place: int, *, has_interval: bool) -> tuple[list[str], list[str]]:
    """Return the head of a column in lines, and its cells; intervals stand close to their value."""
    column, cells = table.columns[place], [row[place] for row in table.rows]
    is_number = column.align == "right"
    room = max(len(cell.mark) for cell in cells)
    values = [
        (cell.text or ("-" if is_number and place >= table.n_keys else "")) + cell.mark.ljust(room)
        for cell in cells
    ]
    values = [
        " ".join(filter(None, [text, cell.unit])) for text, cell in zip(values, cells, strict=True)
    ]
    head = [*([column.above] if column.above else []), *_broken(column.name)]
    if column.unit and len(head[-1]) + len(column.unit) < _HEAD_WIDTH:
        head[-1] = f"{head[-1]} {column.unit}".strip()
    elif column.unit:
        head.append(column.unit)
    if not has_interval:
        return head, values
    width = max(map(len, values))
    ends = [_ends(cell) for cell in cells]
    room = max(map(len, [*ends, *(line[width + 1 :] for line in head)]))
    return (
        [line.rjust(width).ljust(width + 1 + room) for line in head],
        [
            f"{value.rjust(width)} {end.ljust(room)}"
            for value, end in zip(values, ends, strict=True)
        ],
    )


def _ends(cell: Cell) -> str:
    """Return both ends of an interval, with a hyphen where none of them has a sign."""
    is_signed = cell.low.startswith(("+", "-")) or cell.high.startswith(("+", "-"))
    return cell.interval if is_signed or not cell.low else f"{cell.low}-{cell.high}"


def _heading(table: Table, row: Sequence[Cell]) -> str:
    """Return what stands above a row: its leading cells, each with its column's name but one."""
    parts: list[str] = []
    for column, cell in zip(table.columns[: table.n_headings], row, strict=False):
        if cell.text and column.name == "adding":
            parts.append(f"{cell.text} adding")
        elif cell.text:
            parts.append(f"{column.name} {cell.text}" if parts else cell.text)
    return ", ".join(parts)


def _wrapped(
    grid: Sequence[Sequence[str]], *, left: AbstractSet[int], width: int
) -> tuple[list[list[str]], list[int]]:
    """Return the rows with the widest words wrapped to fit, and which row each line is of."""
    widths = [max(map(len, column)) for column in zip(*grid, strict=True)]
    total = sum(widths) + 2 * (len(widths) - 1)
    widest = max(left, key=lambda place: widths[place], default=None)
    if total <= width or widest is None or widths[widest] - (total - width) < _LEAST_WORDS:
        return [list(cells) for cells in grid], list(range(len(grid)))
    room = widths[widest] - (total - width)
    wrapped, owner = [], []
    for place, cells in enumerate(grid):
        pieces = textwrap.wrap(cells[widest], room) or [""]
        for n, piece in enumerate(pieces):
            rest = cells if n == 0 else [""] * len(cells)
            wrapped.append([*rest[:widest], piece, *rest[widest + 1 :]])
            owner.append(place)
    return wrapped, owner


def _broken(name: str) -> list[str]:
    """Return a name in lines of few characters, broken after punctuation where that is enough."""
    lines = [""]
    for piece in re.findall(r"[^_:.,=\s-]*[_:.,=\s-]|[^_:.,=\s-]+", name):
        if lines[-1] and len(lines[-1] + piece.rstrip()) > _HEAD_WIDTH:
            lines.append("")
        lines[-1] += piece
    return [
        line[start : start + _HEAD_WIDTH].rstrip()
        for line in lines
        for start in range(0, max(len(line.rstrip()), 1), _HEAD_WIDTH)
    ]
