"""Tables as LaTeX (booktabs) and as Markdown, and the page's template environment."""

from collections.abc import Iterable, Sequence
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from evaluation.reporting.table import Table, printable

_OPTIONS: dict[str, Any] = {
    "loader": FileSystemLoader(Path(__file__).with_name("templates")),
    "undefined": StrictUndefined,
    "trim_blocks": True,
    "lstrip_blocks": True,
}
HTML: Final = Environment(autoescape=True, **_OPTIONS)


def _path(strokes: Iterable[Sequence[Sequence[float]]]) -> str:
    """Return the SVG path of lines through points; a single point is a dot."""
    lines = []
    for stroke in strokes:
        points = "L".join(f"{x:.1f} {y:.1f}" for x, y in stroke)
        dot = "h0" if len(stroke) == 1 else ""
        lines.append(f"M{points}{dot}")
    return "".join(lines)


def _hinted(text: str) -> Markup:
    """Return a text as HTML: known names get hover text; % never starts a line."""
    from evaluation.reporting.glossary import (  # noqa: PLC0415 - words alone need none
        hinted,
    )

    return hinted(text.replace(" %", "\u00a0%"))


def _defined(text: str) -> str:
    """Return the glossary's definition of a name; empty for other texts."""
    from evaluation.reporting.glossary import DEFINITIONS  # noqa: PLC0415 - as said

    return DEFINITIONS.get(text, "")


HTML.filters |= {
    "plain": printable,
    "path": _path,
    "hinted": _hinted,
    "defined": _defined,
}
_LATEX = Environment(  # noqa: S701 - LaTeX needs another escape: `tex`
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
_MOST_COLUMNS = 10  # Columns beside the keys for which a page has room.
_MOST_BESIDE = 6  # With more columns of intervals, these stand below their values.
_COMMANDS = {
    "\\": "textbackslash",
    "~": "textasciitilde",
    "^": "textasciicircum",
    "<": "textless",
    ">": "textgreater",
    "|": "textbar",
}
_SPECIAL = {character: f"\\{character}" for character in "{}$&%#_"}
_SPECIAL |= {character: f"\\{command}{{}}" for character, command in _COMMANDS.items()}


def escape(text: str) -> str:
    """Return text that LaTeX prints as it is."""
    return "".join(_SPECIAL.get(character, character) for character in printable(text))


def latex(tables: Iterable[Table]) -> str:
    """Return a file of tabulars; a table that is too wide for a page is split."""
    _LATEX.filters["tex"] = escape
    template = _LATEX.get_template("table.tex.j2")
    parts = []
    for table in tables:
        shown = [
            place for place, column in enumerate(table.columns) if not column.is_long
        ]
        keys, others = shown[: table.n_keys], shown[table.n_keys :]
        groups = groupby(table.rows, key=itemgetter(slice(table.n_headings)))
        options = {"table": table, "groups": [list(rows) for _, rows in groups]}
        for start in range(0, max(1, len(others)), _MOST_COLUMNS):
            places = [*keys, *others[start : start + _MOST_COLUMNS]]
            n_intervals = sum(
                any(row[place].low for row in table.rows) for place in places
            )
            is_below = n_intervals > _MOST_BESIDE
            parts.append(template.render(places=places, is_below=is_below, **options))
    return PREAMBLE + "\n".join(parts)


def markdown(table: Table) -> str:
    """Return a table in GitHub's Markdown."""
    rules = [":--" if column.align == "left" else "--:" for column in table.columns]
    rows = [[column.head for column in table.columns], rules]
    rows += [[cell.full for cell in row] for row in table.rows]
    text = str.maketrans({"&": "&amp;", "<": "&lt;", "|": r"\|"})
    plain = [[printable(cell).translate(text) for cell in row] for row in rows]
    return "".join(f"| {' | '.join(row)} |\n" for row in plain)
