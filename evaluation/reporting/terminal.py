"""Output on a terminal: literal text, aligned columns, and headings between them."""

import os
import shutil
import sys
import textwrap
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TypeAlias

from rich.console import Console
from rich.text import Text

from evaluation.reporting.table import Table, printable

# Columns without a terminal: room for every interval of a sweep.
PIPE_WIDTH = 116
# A table, or a text, which may have a style.
Part: TypeAlias = "Table | str | tuple[str, str]"
_HEAD_WIDTH = 10


class _Console(Console):
    def on_broken_pipe(self) -> None:
        raise  # noqa: PLE0704 - rich is at it, and would end with 1


def standard_output() -> Console:
    """Return standard output, as wide as the terminal, or `PIPE_WIDTH` into a pipe."""
    piped = not (sys.stdout.isatty() or os.environ.get("COLUMNS", "").strip("0"))
    width = PIPE_WIDTH if piped else shutil.get_terminal_size().columns
    return _Console(width=width, highlight=False, force_jupyter=False)


def show(parts: Iterable[Part], *, console: Console | None = None) -> None:
    """Print tables, paragraphs, styled or not, and empty lines for empty texts."""
    console = console or standard_output()
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
    """Return text without control characters, in characters that the terminal has."""
    return printable(text).encode(console.encoding, "replace").decode(console.encoding)


def aligned(
    rows: Sequence[Sequence[str]], *, left: Collection[int] = frozenset()
) -> list[str]:
    """Return rows as lines of aligned columns: flush left in `left`, else right."""
    columns = []
    for n, column in enumerate(zip(*rows, strict=True)):
        width = max(map(len, column))
        if n in left:
            columns.append([text.ljust(width) for text in column])
        else:
            columns.append([text.rjust(width) for text in column])
    return ["  ".join(row).rstrip() for row in zip(*columns, strict=True)]


def show_table(table: Table, *, console: Console) -> None:
    """Print a table with marks and notes, split if too wide; nothing without rows."""
    if not table.rows:
        return
    shown = [place for place, column in enumerate(table.columns) if not column.is_long]
    columns = {place: _column(table, place) for place in shown}
    height = max(map(len, columns.values()))
    columns = {
        place: [""] * (height - len(lines)) + lines for place, lines in columns.items()
    }
    for part in _parts(
        shown[: table.n_keys], shown[table.n_keys :], columns, width=console.width
    ):
        console.print()
        say(console, table.title, "bold", wrap=True)
        rows = list(zip(*(columns[place] for place in part), strict=True))
        left = {
            n for n, place in enumerate(part) if table.columns[place].align == "left"
        }
        for n, line in enumerate(aligned(rows, left=left)):
            style = "bold" if n < height - len(table.rows) else ""
            say(console, line, style, wrap=len(line) > console.width)
    if table.legend:
        say(console, f"({table.legend})", wrap=True)
    for note in table.notes:
        say(console, note, wrap=True)


def _parts(
    keys: list[int],
    others: list[int],
    columns: Mapping[int, Sequence[str]],
    *,
    width: int,
) -> list[list[int]]:
    """Return the columns in parts that fit, each beside the keys."""
    parts = [keys]
    for place in others:
        wider = [*parts[-1], place]
        room = sum(2 + max(map(len, columns[column])) for column in wider) - 2
        if len(parts[-1]) > len(keys) and room > width:
            parts.append([*keys, place])
        else:
            parts[-1] = wider
    return parts


def _column(table: Table, place: int) -> list[str]:
    """Return the head of a column in lines, and its cells."""
    column = table.columns[place]
    missing = "-" if column.align == "right" and place >= table.n_keys else ""
    cells = [row[place].full or missing for row in table.rows]
    room = max(_HEAD_WIDTH, *map(len, cells))
    above = [column.above] if column.above else []
    return [*above, *textwrap.wrap(f"{column.name} {column.unit}", room), *cells]
