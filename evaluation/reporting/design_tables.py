"""The answer of `evaluation.design` on the terminal."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from rich.text import Text

from evaluation.analysis.families import LEVEL_UNITS
from evaluation.analysis.keys import Source, level_text
from evaluation.analysis.linkability import REMARKS, remarks
from evaluation.analysis.metrics import DESCRIPTORS, METRICS, SUCCESS
from evaluation.reporting import table as tables
from evaluation.reporting.design_words import closer, notes, reasons, sentence
from evaluation.reporting.linkage_tables import MARKS
from evaluation.reporting.terminal import literal, say, show_table, standard_output
from evaluation.verdict.choose_level import METRIC_OF, UNKNOWN

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from rich.console import Console

    from evaluation.reporting.table import Cell, Column, Table
    from evaluation.verdict.choose_level import Attacked, Choice, Level, Linked


def show(choice: Choice, *, console: Console | None = None) -> None:
    """Print the answer in one sentence, the levels behind it, and why."""
    console = standard_output() if console is None else console
    _say(sentence(choice), "bold green" if choice.met else "bold red", console=console)
    console.print()
    identity = choice.manifest["identity"]
    about = (
        f"{choice.manifest['dataset']['name']}: {identity['scenes']} scenes, seed "
        f"{identity['seed']}; predictor {choice.predictor}; 95 % intervals, whose upper ends must "
        "meet the limits"
    )
    _say(about, console=console)
    units = ", ".join(f"{family} {unit}" for family, unit in LEVEL_UNITS.items())
    _say(f"(level: {units})", console=console)
    for one in answer_tables(choice):
        show_table(one, console=console, whole=True)
    for scheme in choice.schemes:
        console.print()
        _say(f"{scheme.name}, {scheme.adding} adding", "bold cyan", console=console)
        for reason in [*reasons(scheme), *["meets everything that was asked"] * scheme.met]:
            _say(f"- {reason}", console=console)
    said = notes(choice)
    if said:
        console.print()
    for note in said:
        _say(f"NOTICE: {note}", "yellow", console=console)
    command = closer(choice)
    if command:
        console.print()
        _say("To look closer where the answer turns:", "bold", console=console)
        # As one line, whatever the width: it is there to be copied.
        console.print(Text(literal(console, command)), soft_wrap=True)


def _say(text: str, style: str = "", *, console: Console) -> None:
    """Print a paragraph; the further lines of an item stand below its first word."""
    indent = "  " * text.startswith("- ")
    for line in textwrap.wrap(
        text, console.width, subsequent_indent=indent, break_on_hyphens=False
    ):
        say(console, line, style)


def answer_tables(choice: Choice) -> list[Table]:
    """Return the chosen levels beside raw: as shared, after a reconstruction, and linked."""
    rows = [*([choice.raw] if choice.raw else []), *(scheme.chosen for scheme in choice.schemes)]
    limits = choice.limits.of(*METRIC_OF)
    after = choice.limits.of(*DESCRIPTORS) if choice.limits.after_attack else {}
    shared = {name: limit for name, limit in limits.items() if name not in after}
    title = "Utility, and privacy as shared"
    found = [_table(choice, "shared", title, *_numbers(rows, METRIC_OF, limits=shared))]
    attacked = [None if row is None else row.after_attack for row in rows]
    if any(attacked):
        title = f"After the best reconstruction: {_attacks(attacked)}"
        columns = _numbers(attacked, DESCRIPTORS, limits=after)
        found.append(_table(choice, "attacked", title, *columns))
    if choice.tasks:
        found.append(_linked(choice, rows))
    return found


def _numbers(
    found: Sequence[Level | Attacked | None], names: Iterable[str], *, limits: Mapping[str, float]
) -> tuple[list[Column], list[list[Cell]]]:
    """Return a column for each name, and its cells."""
    columns, cells = [], []
    for name in names:
        metric = METRIC_OF[name]
        columns.append(_column(metric, limit=limits.get(name)))
        values = [UNKNOWN if one is None else one.numbers[name] for one in found]
        cells.append([tables.estimated(metric, value) for value in values])
    return columns, cells


def _column(metric: str, name: str = "", *, limit: float | None) -> Column:
    above = "" if limit is None else f"<= {limit * METRICS[metric].scale:.4g}"
    unit = METRICS[metric].unit
    return tables.Column(name or METRICS[metric].head, unit, above=above)


def _linked(choice: Choice, rows: Sequence[Level | None]) -> Table:
    """Return rank 1 by task, what its marks mean, and what guessing achieves."""
    columns, cells, about = [], [], []
    for place, task in enumerate(choice.tasks):
        found = [None if row is None else row.tasks[place] for row in rows]
        limit = choice.limits.given.get(SUCCESS) if task.limited else None
        columns.append(_column(SUCCESS, task.task, limit=limit))
        cells.append([_rank1(one) for one in found])
        known = [one for one in found if one and one.attack]
        chances = dict.fromkeys(tables.amount(SUCCESS, one.chance).text for one in known)
        where = "" if task.limited else f", {task.dataset}"
        if chances:
            about.append(f"{task.task}{where}: {_attacks(known)}; chance {', '.join(chances)} %")
    title = "Rank 1 of the strongest attack"
    return _table(choice, "linked", title, columns, cells, notes=about)


def _rank1(one: Linked | None) -> Cell:
    if one is None:
        return tables.word("")
    mark = "".join(
        MARKS[name] for name in remarks({"outcome": one.outcome, "invalid": one.invalid})
    )
    return tables.estimated(SUCCESS, one.rank1, mark=mark)


def _attacks(found: Iterable[Attacked | Linked | None]) -> str:
    """Return the attacks of some levels, each once."""
    labels = [Source(one.attack, one.knowledge).label for one in found if one and one.attack]
    return ", ".join(dict.fromkeys(labels))


def _table(
    choice: Choice,
    name: str,
    title: str,
    columns: Sequence[Column],
    cells: Sequence[Sequence[Cell]],
    *,
    notes: Sequence[str] = (),
) -> Table:
    """Return columns beside the levels that they are of."""
    levels = [["", "raw", ""]] if choice.raw else []
    levels += [
        [
            f"{scheme.adding} adding",
            scheme.name,
            "none" if scheme.chosen is None else level_text(scheme.chosen.level),
        ]
        for scheme in choice.schemes
    ]
    return tables.table(
        name,
        title,
        [*tables.words("adding", ""), tables.Column("level"), *columns],
        [
            [*map(tables.word, level), *row]
            for level, row in zip(levels, zip(*cells, strict=True), strict=True)
        ],
        notes=notes,
        marks={MARKS[remark]: text for remark, text in REMARKS.items()},
        n_headings=1,
        n_keys=3,
    )
