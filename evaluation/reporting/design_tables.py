"""The answer of `evaluation.design` on the terminal, and as JSON."""

from __future__ import annotations

import json
import math
import textwrap
from dataclasses import asdict, astuple
from typing import TYPE_CHECKING, Any, TypeAlias

from rich.text import Text

from evaluation.analysis.keys import Source
from evaluation.analysis.levels import (
    LEVEL_UNITS,
    REMARKS,
    SHOWN,
    Number,
    amount,
    level_text,
    number,
    remarks,
)
from evaluation.analysis.metrics import DESCRIPTORS
from evaluation.reporting.linkage_tables import MARKS
from evaluation.reporting.terminal import aligned, literal, say, show_grouped, standard_output
from evaluation.verdict.design_levels import METRIC_OF

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from rich.console import Console

    from evaluation.design import Answer
    from evaluation.verdict.design_levels import Attacked, Level, Linked, Measured

_Column: TypeAlias = "tuple[list[str], list[str]]"
"""Values and their intervals, both below two lines of heads and one of limits."""


def to_json(answer: Answer) -> str:
    """Return the answer as a JSON object; what is unknown is null."""
    return json.dumps(asdict(answer, dict_factory=_known), indent=1, allow_nan=False)


def _known(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in pairs
    }


def show(answer: Answer, *, console: Console | None = None) -> None:
    """Print the answer in one sentence, the levels behind it, and why."""
    console = standard_output() if console is None else console
    _say(answer.answer, "bold green" if answer.met else "bold red", console=console)
    console.print()
    about = (
        f"{answer.dataset}: {answer.scenes} scenes, seed {answer.seed}; predictor "
        f"{answer.predictor}; 95 % intervals, whose upper ends must meet the limits"
    )
    _say(about, console=console)
    units = ", ".join(f"{family} {unit}" for family, unit in LEVEL_UNITS.items())
    _say(f"(level: {units})", console=console)
    rows = [*([answer.raw] if answer.raw else []), *(scheme.chosen for scheme in answer.schemes)]
    limits = answer.limits.given(*METRIC_OF)
    after = answer.limits.given(*DESCRIPTORS) if answer.limits.after_attack else {}
    held = {name: limit for name, limit in limits.items() if name not in after}
    columns = _columns(rows, METRIC_OF, limits=held)
    _show_columns("Utility, and privacy as shared", columns, answer, console=console)
    attacked = [None if row is None else row.after_attack for row in rows]
    if any(attacked):
        title = f"After the best reconstruction: {_attacks(attacked)}"
        columns = _columns(attacked, DESCRIPTORS, limits=after)
        _show_columns(title, columns, answer, console=console)
    _show_linked(answer, rows, console=console)
    for scheme in answer.schemes:
        console.print()
        _say(f"{scheme.family}, {scheme.adding} adding", "bold cyan", console=console)
        for reason in [*scheme.reasons, *["meets everything that was asked"] * scheme.met]:
            _say(f"- {reason}", console=console)
    if answer.notes:
        console.print()
    for note in answer.notes:
        _say(f"NOTICE: {note}", "yellow", console=console)
    if answer.refine:
        console.print()
        _say("To look closer where the answer turns:", "bold", console=console)
        # As one line, whatever the width: it is there to be copied.
        console.print(Text(literal(console, answer.refine)), soft_wrap=True)


def _say(text: str, style: str = "", *, console: Console) -> None:
    """Print a paragraph; the further lines of an item stand below its first word."""
    indent = "  " * text.startswith("- ")
    for line in textwrap.wrap(
        text, console.width, subsequent_indent=indent, break_on_hyphens=False
    ):
        say(console, line, style)


def _columns(
    found: Sequence[Level | Attacked | None], names: Iterable[str], *, limits: Mapping[str, float]
) -> list[_Column]:
    return [
        _column(
            METRIC_OF[name],
            [None if one is None else getattr(one, name) for one in found],
            limit=limits.get(name),
        )
        for name in names
    ]


def _show_linked(answer: Answer, rows: Sequence[Level | None], *, console: Console) -> None:
    """Print the linkage tasks, what their marks mean, and what guessing achieves."""
    tasks: dict[str, list[Linked | None]] = {}
    for place, row in enumerate(rows):
        for one in () if row is None else row.tasks:
            tasks.setdefault(one.task, [None] * len(rows))[place] = one
    if not tasks:
        return
    columns, notes = [], []
    used: set[str] = set()
    for task, found in tasks.items():
        known = [one for one in found if one]
        marked = [remarks(asdict(one)) if one else [] for one in found]
        used.update(*marked)
        first, dash, rest = task.partition("-")
        columns.append(
            _column(
                "rank1",
                [None if one is None else one.rank1 for one in found],
                limit=answer.limits.rank1 if known[0].limited else None,
                heads=(first + dash, rest) if dash else ("", task),
                marks=["".join(map(MARKS.__getitem__, names)) for names in marked],
            )
        )
        chances = dict.fromkeys(amount("rank1", one.chance) for one in known if one.attack)
        where = "" if known[0].limited else f", {known[0].dataset}"
        if chances:
            notes.append(f"{task}{where}: {_attacks(known)}; chance {', '.join(chances)} %")
    _show_columns("Rank 1 of the strongest attack, %", columns, answer, console=console)
    legend = [f"{MARKS[name]} {text}" for name, text in REMARKS.items() if name in used]
    for note in [*([f"({'; '.join(legend)})"] if legend else []), *notes]:
        _say(note, console=console)


def _attacks(found: Iterable[Attacked | Linked | None]) -> str:
    """Return the attacks of some levels, each once."""
    labels = [Source(one.attack, one.knowledge).label for one in found if one and one.attack]
    return ", ".join(dict.fromkeys(labels))


def _column(
    metric: str,
    found: Sequence[Measured | None],
    *,
    limit: float | None,
    heads: tuple[str, str] | None = None,
    marks: Sequence[str] = (),
) -> _Column:
    shown = SHOWN[metric]
    texts = [Number("") if one is None else number(metric, *astuple(one)) for one in found]
    held = "" if limit is None else f"<= {limit * shown.scale:.4g}"
    values = [*(heads or (shown.head, shown.unit)), held, *(text.value or "-" for text in texts)]
    # A mark stands behind its number, so that the numbers line up.
    room = max(map(len, marks), default=0)
    behind = ["", "", "", *(marks or [""] * len(texts))]
    return (
        [value + mark.ljust(room) for value, mark in zip(values, behind, strict=True)],
        ["", "", "", *(text.interval for text in texts)],
    )


def _show_columns(
    title: str, columns: Sequence[_Column], answer: Answer, *, console: Console
) -> None:
    """Print the columns beside the levels that they are of, in as many tables as need be."""
    console.print()
    _say(title, "bold", console=console)
    left = list(columns)
    while left:
        count = len(left)
        rows, lines = _table(answer, left)
        while count > 1 and max(map(len, lines)) > console.width:
            count -= 1
            rows, lines = _table(answer, left[:count])
        show_grouped(rows, lines, console=console)
        left = left[count:]
        if left:
            console.print()


def _table(
    answer: Answer, columns: Sequence[_Column]
) -> tuple[list[tuple[str | None, list[str]]], list[str]]:
    """Return the rows under their headings and the lines that they make."""
    rows: list[tuple[str | None, list[str]]] = [(None, ["", ""]), (None, ["", "level"])]
    rows.append((None, ["limit", ""]))
    if answer.raw is not None:
        rows.append(("raw", ["raw", ""]))
    for scheme in answer.schemes:
        level = "none" if scheme.chosen is None else level_text(scheme.chosen.level)
        rows.append((f"{scheme.adding} adding", [scheme.family, level]))
    for (_, cells), *pairs in zip(
        rows, *(zip(*column, strict=True) for column in columns), strict=True
    ):
        cells += [text for pair in pairs for text in pair]
    # Heads and limits only where there are any.
    rows = [row for row in rows if row[0] or any(map(str.strip, row[1][2:]))]
    intervals = set(range(3, 3 + 2 * len(columns), 2))
    return rows, aligned([cells for _, cells in rows], left={0}, close=intervals)
