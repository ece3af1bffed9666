"""Lines on a terminal: literal text, columns that line up, and headings between them."""

import os
import re
import sys
import textwrap
from collections.abc import Collection, Iterable, Sequence
from typing import TypeAlias

from rich.console import Console
from rich.text import Text

from evaluation.reporting.table import Table, printable

PIPE_WIDTH = 116  # Columns where there is no terminal: room for every interval of a sweep.
Part: TypeAlias = "Table | str | tuple[str, str]"
"""Of what is printed: a table, or a text, which may have a style."""
_HEAD_WIDTH = 10
_SHORT = 8
_LEAST_WORDS = 16  # Below this words are not wrapped to.
Lines: TypeAlias = "list[tuple[str, str]]"  # Each with its style.


def standard_output() -> Console:
    """Return standard output, as wide as the terminal or `PIPE_WIDTH` where there is none."""
    piped = not sys.stdout.isatty() and "COLUMNS" not in os.environ
    return Console(width=PIPE_WIDTH if piped else None, highlight=False)


def show(parts: Iterable[Part], *, console: Console | None = None) -> None:
    """Print tables, paragraphs with or without a style, and empty lines for empty texts."""
    console = standard_output() if console is None else console
    for part in parts:
        text, style = part if isinstance(part, tuple) else (part, "")
        if isinstance(text, Table):
            show_table(text, console=console)
        elif text:
            say(console, text, style, wrap=True)
        else:
            console.print()


def say(console: Console, text: str, style: str = "", *, wrap: bool = False) -> None:
    """Print text as it is, without markup and in characters that the terminal has."""
    shown = Text(literal(console, text), style=style)
    console.print(shown, no_wrap=not wrap, overflow="fold" if wrap else "crop")


def literal(console: Console, text: str) -> str:
    """Return text without what could move a cursor, in characters that the terminal has."""
    return printable(text).encode(console.encoding, "replace").decode(console.encoding)


def aligned(rows: Sequence[Sequence[str]], *, left: Collection[int] = frozenset()) -> list[str]:
    """Return the rows as lines whose columns line up, to the right of them except in `left`."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    places = list(enumerate(widths))
    return [
        "  ".join(row[n].ljust(w) if n in left else row[n].rjust(w) for n, w in places).rstrip()
        for row in rows
    ]


def show_table(table: Table, *, console: Console) -> None:
    """Print a table: title, lines that fit, what its marks mean, and its notes.

    Where there is no room it is split. Nothing is printed of a table without rows.
    """
    if not table.rows:
        return
    for part in _parts(table, width=console.width):
        console.print()
        say(console, table.title, "bold", wrap=True)
        for line, style in _lines(table, part, width=console.width):
            say(console, line, style)
    for note in [*([f"({table.legend})"] if table.legend else []), *table.notes]:
        say(console, note, wrap=True)


def _parts(table: Table, *, width: int) -> list[list[int]]:
    """Return the columns in parts that fit, each beside the keys."""
    shown = [place for place, column in enumerate(table.columns) if not column.is_long]
    keys = [place for place in shown if table.n_headings <= place < table.n_keys]
    parts = [keys]
    for place in shown[max(table.n_headings, table.n_keys) :]:
        wider = [*parts[-1], place]
        lines = _lines(table, wider, width=width)
        if len(parts[-1]) > len(keys) and max(len(line) for line, _ in lines) > width:
            parts.append([*keys, place])
        else:
            parts[-1] = wider
    return parts


def _lines(table: Table, columns: list[int], *, width: int) -> Lines:
    """Return the lines with their styles: heads, headings, and rows whose columns line up."""
    shown = [_column(table, place) for place in columns]
    depth = max(len(head) for head, _ in shown)
    filled = [[*[""] * (depth - len(head)), *head, *cells] for head, cells in shown]
    grid = [list(cells) for cells in zip(*filled, strict=True)]
    headings = []
    for row in table.rows:
        # Leading cells, each with its column's name but the first.
        parts: list[str] = []
        for column, cell in zip(table.columns[: table.n_headings], row, strict=False):
            before = f"{column.name} " * bool(parts)
            told = f"{cell.text} adding" if column.name == "adding" else f"{before}{cell.text}"
            parts += [told] * bool(cell.text)
        headings.append(", ".join(parts))
    for place, (heading, cells) in enumerate(zip(headings, grid[depth:], strict=True)):
        # Short, alone and without a level: it stands where the level would.
        if heading and headings.count(heading) == 1 and not cells[0] and len(heading) <= _SHORT:
            headings[place], cells[0] = "", heading
    left = {n for n, place in enumerate(columns) if table.columns[place].align == "left"}
    lines: Lines = []
    above = ""
    wrapped = _wrapped(grid, left=left, width=width)
    lined_up = aligned([cells for _, cells in wrapped], left=left)
    for (at, _), line in zip(wrapped, lined_up, strict=True):
        heading = headings[at - depth] if at >= depth else ""
        if heading and heading != above:
            lines.append((heading, "bold cyan"))
        above = heading
        lines.append((line, "bold" if at < depth else ""))
    return lines


def _column(table: Table, place: int) -> tuple[list[str], list[str]]:
    """Return the head of a column in lines, and its cells; intervals stand close to their value."""
    column, cells = table.columns[place], [row[place] for row in table.rows]
    missing = "-" if column.align == "right" and place >= table.n_keys else ""
    room = max(len(cell.mark) for cell in cells)
    values = [
        f"{cell.text or missing}{cell.mark.ljust(room)}" + f" {cell.unit}" * bool(cell.unit)
        for cell in cells
    ]
    head = [column.above] * bool(column.above) + _broken(column.name)
    if column.unit and len(head[-1]) + len(column.unit) < _HEAD_WIDTH:
        head[-1] = f"{head[-1]} {column.unit}".strip()
    elif column.unit:
        head.append(column.unit)
    if not any(cell.low for cell in cells):
        return head, values
    width = max(map(len, values))
    # A hyphen where neither end has a sign.
    ends = [
        cell.interval
        if "+" in cell.interval or "-" in cell.interval or not cell.low
        else f"{cell.low}-{cell.high}"
        for cell in cells
    ]
    room = max(map(len, [*ends, *(line[width + 1 :] for line in head)]))
    rows = [f"{value:>{width}} {end:<{room}}" for value, end in zip(values, ends, strict=True)]
    return [line.rjust(width).ljust(width + 1 + room) for line in head], rows


def _wrapped(
    grid: Sequence[Sequence[str]], *, left: Collection[int], width: int
) -> list[tuple[int, list[str]]]:
    """Return the lines of rows whose widest words are wrapped to fit, each with its row."""
    widths = [max(map(len, column)) for column in zip(*grid, strict=True)]
    excess = sum(widths) + 2 * (len(widths) - 1) - width
    widest = max(left, key=lambda place: widths[place], default=None)
    if excess <= 0 or widest is None or widths[widest] - excess < _LEAST_WORDS:
        return [(place, list(cells)) for place, cells in enumerate(grid)]
    wrapped = []
    for place, cells in enumerate(grid):
        rest = cells
        for piece in textwrap.wrap(cells[widest], widths[widest] - excess) or [""]:
            wrapped.append((place, [*rest[:widest], piece, *rest[widest + 1 :]]))
            rest = [""] * len(cells)
    return wrapped


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
