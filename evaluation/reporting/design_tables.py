"""The answer of `evaluation.design` on the terminal."""

from __future__ import annotations

import textwrap
from dataclasses import replace
from functools import partial
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, TypeAlias

from rich.text import Text

from evaluation.analysis.families import LEVEL_UNITS
from evaluation.analysis.keys import Source, level_text
from evaluation.analysis.linkability import remarks
from evaluation.analysis.metrics import DESCRIPTORS, METRICS, SUCCESS
from evaluation.reporting.design_words import closer, notes, reasons, sentence
from evaluation.reporting.linkage_tables import MARKS, MEANING
from evaluation.reporting.table import (
    Cell,
    Column,
    amount,
    built,
    estimated,
    metric_column,
    said,
    word,
)
from evaluation.reporting.terminal import literal, say, show_table, standard_output
from evaluation.verdict.choose_level import METRIC_OF, UNKNOWN

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from rich.console import Console

    from evaluation.reporting.table import Made, Table
    from evaluation.verdict.choose_level import Attacked, Choice, Level, Linked


_Row: TypeAlias = "tuple[str, str, str, Level | None]"
"""Adding rule, mechanism, level, and what it comes to."""


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
    for place, note in enumerate(notes(choice)):
        if place == 0:
            console.print()
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
    rows: list[_Row] = [("", "raw", "", choice.raw)] if choice.raw else []
    for scheme in choice.schemes:
        at = "none" if scheme.chosen is None else level_text(scheme.chosen.level)
        rows.append((scheme.adding, scheme.name, at, scheme.chosen))
    keys = [*(said(name, itemgetter(place)) for place, name in enumerate(("adding", "")))]
    keys.append((Column("level"), lambda row: word(row[2])))

    def shown(name: str, title: str, columns: list[Made], notes: Sequence[str] = ()) -> Table:
        options = {"notes": notes, "marks": MEANING, "n_headings": 1, "n_keys": 3}
        return built(name, title, rows, [*keys, *columns], **options)

    limits = choice.limits.of(*METRIC_OF)
    after = choice.limits.of(*DESCRIPTORS) if choice.limits.after_attack else {}
    shared = {name: limit for name, limit in limits.items() if name not in after}
    columns = [_number(name, lambda level: level, shared) for name in METRIC_OF]
    found = [shown("shared", "Utility, and privacy as shared", columns)]
    attacked = [None if level is None else level.after_attack for *_, level in rows]
    if any(attacked):
        columns = [_number(name, attrgetter("after_attack"), after) for name in DESCRIPTORS]
        title = f"After the best reconstruction: {_attacks(attacked)}"
        found.append(shown("attacked", title, columns))
    if choice.tasks:
        columns, about = [], []
        for place, task in enumerate(choice.tasks):
            limit = choice.limits.given.get(SUCCESS) if task.limited else None
            columns.append((_headed(SUCCESS, task.task, limit=limit), partial(_rank1, place)))
            ran = [one for *_, row in rows if row and (one := row.tasks[place]).attack]
            chances = dict.fromkeys(amount(SUCCESS, one.chance).text for one in ran)
            where = "" if task.limited else f", {task.dataset}"
            if chances:
                about.append(f"{task.task}{where}: {_attacks(ran)}; chance {', '.join(chances)} %")
        found.append(shown("linked", "Rank 1 of the strongest attack", columns, about))
    return found


def _number(
    name: str, take: Callable[[Level], Level | Attacked | None], limits: Mapping[str, float]
) -> Made:
    """Return the column of a number of what is taken from a level."""
    metric = METRIC_OF[name]

    def cell(row: _Row) -> Cell:
        one = take(row[3]) if row[3] else None
        return estimated(metric, one.numbers[name] if one else UNKNOWN)

    return _headed(metric, limit=limits.get(name)), cell


def _headed(metric: str, name: str = "", *, limit: float | None) -> Column:
    above = "" if limit is None else f"<= {limit * METRICS[metric].scale:.4g}"
    return replace(metric_column(metric, name), above=above)


def _rank1(place: int, row: _Row) -> Cell:
    if row[3] is None:
        return Cell()
    one = row[3].tasks[place]
    marks = (MARKS[name] for name in remarks({"outcome": one.outcome, "invalid": one.invalid}))
    return estimated(SUCCESS, one.rank1, mark="".join(marks))


def _attacks(found: Iterable[Attacked | Linked | None]) -> str:
    """Return the attacks of some levels, each once."""
    labels = [Source(one.attack, one.knowledge).label for one in found if one]
    return ", ".join(dict.fromkeys(labels))
