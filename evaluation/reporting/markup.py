"""A table as LaTeX (a booktabs tabular) and Markdown; `templates` has it for the page."""

from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from evaluation.reporting.table import Cell, Column, Table, printable

TEMPLATES: Final = Path(__file__).with_name("templates")
_OPTIONS: dict[str, Any] = {
    "loader": FileSystemLoader(TEMPLATES),
    "undefined": StrictUndefined,
    "trim_blocks": True,
    "lstrip_blocks": True,
}
HTML: Final = Environment(autoescape=True, **_OPTIONS)
HTML.filters["plain"] = printable
# The path of lines through places; one alone is a dot.
HTML.filters["path"] = lambda strokes: "".join(
    "M" + ("L".join(f"{x:.1f} {y:.1f}" for x, y in line) + "h0" * (len(line) == 1))
    for line in strokes
)
_LATEX = Environment(  # noqa: S701 - what is not HTML needs another escape: `tex`
    **_OPTIONS,
    block_start_string="<%",
    block_end_string="%>",
    variable_start_string="<<",
    variable_end_string=">>",
    comment_start_string="<#",
    comment_end_string="#>",
    keep_trailing_newline=True,
)
PREAMBLE: Final = "% Needs \\usepackage{booktabs}. Values with 95 % intervals.\n"
_MOST_COLUMNS = 10  # Beside the keys: what a page has room for.
_MOST_BESIDE = 6  # With more columns of intervals, these stand below their values.
_WORDS = {"\\": "textbackslash", "~": "textasciitilde", "^": "textasciicircum"}
_WORDS |= {"<": "textless", ">": "textgreater", "|": "textbar"}
_SPECIAL = {one: f"\\{one}" for one in "{}$&%#_"}
_SPECIAL |= {one: f"\\{word}{{}}" for one, word in _WORDS.items()}


def escape(text: str) -> str:
    """Return text that LaTeX prints as it is."""
    return "".join(_SPECIAL.get(character, character) for character in printable(text))


def latex(tables: Iterable[Table]) -> str:
    """Return a file of tabulars, several of a table that is too wide for a page."""
    template = _LATEX.get_template("table.tex.j2")
    return PREAMBLE + "\n".join(
        template.render(
            table=table,
            columns=[table.columns[place] for place in places],
            groups=_groups(table, places),
            escape=escape,
        )
        for table in tables
        for places in _pages(table)
    )


def _pages(table: Table) -> list[list[int]]:
    """Return which columns go into each tabular."""
    places = [place for place, column in enumerate(table.columns) if not column.is_long]
    keys, others = places[: table.n_keys], places[table.n_keys :]
    starts = range(0, max(1, len(others)), _MOST_COLUMNS)
    return [[*keys, *others[start : start + _MOST_COLUMNS]] for start in starts]


def _groups(table: Table, places: Sequence[int]) -> list[list[list[str]]]:
    """Return the lines of a tabular's body, those of a heading together."""
    below = sum(any(row[place].low for row in table.rows) for place in places) > _MOST_BESIDE
    groups = []
    for _, rows in groupby(table.rows, key=lambda row: row[: table.n_headings]):
        lines = []
        for row in rows:
            lines.append([_tex(row[n], of=table.columns[n], beside=not below) for n in places])
            if below and any(row[place].low for place in places):
                lines.append([_small(row[place]) for place in places])
        groups.append(lines)
    return groups


def _tex(cell: Cell, *, of: Column, beside: bool) -> str:
    if not cell.text:
        return "--" if of.align == "right" and of.name != "level" else ""
    is_signed = cell.value is not None and cell.text[0] in "+-"
    text = f"${cell.text}$" if is_signed else escape(cell.text)
    text += rf"\textsuperscript{{{escape(cell.mark)}}}" if cell.mark else ""
    return " ".join(filter(None, [text, _small(cell) if beside else "", escape(cell.unit)]))


def _small(cell: Cell) -> str:
    return rf"{{\scriptsize {cell.interval}}}" if cell.low else ""


def markdown(table: Table) -> str:
    """Return a table in GitHub's Markdown."""
    rules = [":--" if column.align == "left" else "--:" for column in table.columns]
    rows = [[column.head for column in table.columns], rules]
    rows += [[cell.full for cell in row] for row in table.rows]
    text = str.maketrans({"&": "&amp;", "<": "&lt;", "|": r"\|"})
    plain = [[printable(cell).translate(text) for cell in row] for row in rows]
    return "".join(f"| {' | '.join(row)} |\n" for row in plain)
