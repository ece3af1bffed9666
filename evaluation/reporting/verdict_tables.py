"""The verdict in the terminal and as LaTeX: three sentences, then a table for each section."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from evaluation.analysis.matching import AT_EQUAL_ALARMS, MISSED
from evaluation.reporting.latex import escape
from evaluation.reporting.terminal import aligned, say
from evaluation.verdict.items import NAME
from evaluation.verdict.rules import (
    DEFLATED,
    DOES_NOT,
    HOLDS,
    INFLATED,
    REVERSED,
    TRACKS,
    UNDECIDED,
    WEAKLY,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rich.console import Console

TITLES: Final = {
    "validity": "At equal descriptor value, does every mechanism let as many people be linked?",
    "within": "Does a track's own descriptor tell that it is linked, beyond length, speed, noise?",
    "claim": "At equal missed rate (and equal false alarms), is FID lower than fixed noise?",
    "inflation": "How many times higher is a descriptor after the strongest reconstruction?",
}
SHORT: Final = {
    TRACKS: "tracks",
    WEAKLY: "weakly",
    DOES_NOT: "does not",
    HOLDS: "lower",
    REVERSED: "higher",
    INFLATED: "",
    DEFLATED: "",
    UNDECIDED: "?",
}
_CRITERIA: Final = {MISSED: "", AT_EQUAL_ALARMS: " and alarms"}
_OF: Final = {"as-shared": "as shared", "after-attack": "after attack", "linkage": "linked"}


@dataclass(frozen=True, slots=True)
class Grid:
    """A section as a table: items that differ in the adding rule are rows of one table."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def grids(said: Mapping[str, Any]) -> list[Grid]:
    """Return a table for each section that has items."""
    found = []
    for section, title in TITLES.items():
        items = [one for one in said["items"] if one["section"] == section]
        if not items:
            continue
        cells: dict[tuple[str, str], dict[str, str]] = {}
        columns: dict[str, None] = {}
        for one in items:
            row, column = _place(one)
            columns[column] = None
            cells.setdefault(row, {})[column] = _cell(one)
        found.append(
            Grid(
                title,
                ("" if section == "claim" else "adding", "", *columns),
                tuple(
                    (*row, *(known.get(column, "") for column in columns))
                    for row, known in cells.items()
                ),
            )
        )
    return found


def show_verdict(said: Mapping[str, Any], *, console: Console) -> None:
    """Print the verdict; `said` is as in `verdict.json`."""
    if not said["items"]:
        return
    console.print()
    say(console, "Verdict", "bold", wrap=True)
    for sentence in said["answer"]:
        say(console, f"- {sentence}", wrap=True)
    for grid in grids(said):
        console.print()
        say(console, grid.title, "bold", wrap=True)
        lines = aligned([grid.head, *_unrepeated(grid.rows)], left={0, 1})
        for place, line in enumerate(lines):
            say(console, line, "bold" if place == 0 else "")
    say(
        console,
        "(?: undecided, no statement either way. Items, intervals and reasons: verdict.json.)",
        wrap=True,
    )


def verdict_tex(said: Mapping[str, Any]) -> str:
    """Return the verdict as tabulars, a section each."""
    parts = ["% Needs \\usepackage{booktabs}. ?: undecided.\n"]
    for grid in grids(said):
        body = [
            " & ".join(map(escape, row)) + r" \\" for row in (grid.head, *_unrepeated(grid.rows))
        ]
        parts.append(
            "\n".join(
                [
                    f"% {grid.title}",
                    rf"\begin{{tabular}}{{ll{'r' * (len(grid.head) - 2)}}}",
                    r"\toprule",
                    body[0],
                    r"\midrule",
                    *body[1:],
                    r"\bottomrule",
                    r"\end{tabular}",
                    "",
                ]
            )
        )
    return "\n".join(parts)


def _place(one: Mapping[str, Any]) -> tuple[tuple[str, str], str]:
    """Return row and column of an item."""
    name = NAME.get(one["descriptor"], "")
    if one["section"] == "claim":
        return (_OF[one["of"]], name or one["task"]), one["adding"] + _CRITERIA[one["criterion"]]
    if one["section"] == "inflation":
        return (one["adding"], one["of"]), name
    return (one["adding"], name), one["task"]


def _cell(one: Mapping[str, Any]) -> str:
    if one["section"] == "inflation" and one["decision"] != UNDECIDED:
        return f"{one['effect']:.1f}"
    return SHORT[one["decision"]]


def _unrepeated(rows: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return the rows, the first cell only where it changes."""
    shown = ""
    found = []
    for row in rows:
        found.append(("" if row[0] == shown else row[0], *row[1:]))
        shown = row[0]
    return found
