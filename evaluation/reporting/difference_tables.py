"""Two runs side by side: on the terminal, and as JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from evaluation.analysis.differences import (
    DIFFERS,
    IDENTICAL,
    SIGNIFICANCE,
    UNDECIDED,
    UNTESTED,
    counts,
)
from evaluation.analysis.families import with_unit
from evaluation.analysis.keys import Source, level_text
from evaluation.analysis.metrics import METRICS
from evaluation.analysis.run_changes import DRAWS, NONE, PEOPLE, short_list
from evaluation.reporting.table import Cell, Column, amount, level, table, word, words
from evaluation.reporting.terminal import aligned, say, show_table, standard_output
from evaluation.reporting.texts import shortened

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd
    from rich.console import Console

    from evaluation.analysis.differences import Comparison
    from evaluation.reporting.table import Table

_MOST_SHOWN = 20
_ROOM = 24
_SURE = 0.001
"""Smaller p-values are not written out."""
_PAIRED = {
    DRAWS: "paired over people and draws",
    PEOPLE: "paired over people, not over draws (scenes and errors are others)",
    NONE: "not paired: intervals as of independent estimates",
}
_MARKS = {PEOPLE: "~", NONE: "*"}
"""Of a difference that is not paired in full."""


def to_json(comparison: Comparison, *, every: bool = False) -> dict[str, Any]:
    """Return a comparison as one object of plain values; what is unknown is None.

    `every` adds the numbers that are not in the headline.
    """
    rows = comparison.rows if every else comparison.headline
    known = rows.replace([math.inf, -math.inf], math.nan).astype(object)
    return {
        "a": comparison.a,
        "b": comparison.b,
        "changed": {
            kind: {name: {"a": a, "b": b} for name, (a, b) in values.items()}
            for kind, values in comparison.changed.items()
        },
        "only": {axis: {"a": a, "b": b} for axis, (a, b) in comparison.only.items()},
        "numbers": {
            "in_both": len(comparison.rows),
            "only_a": comparison.only_numbers[0],
            "only_b": comparison.only_numbers[1],
            "headline": counts(comparison.headline),
            "other": counts(comparison.rows[~comparison.rows["headline"]]),
            "pairing": comparison.rows["pairing"].value_counts().to_dict(),
        },
        "verdicts": comparison.verdicts,
        "differences": known.where(known.notna(), None).to_dict("records"),
    }


def show(comparison: Comparison, *, every: bool = False, console: Console | None = None) -> None:
    """Print what changed, how much of it counts, and the surest differences.

    `every` shows all numbers that are not identical instead of the surest of the headline.
    """
    console = standard_output() if console is None else console
    _show_header(comparison, console=console)
    _show_counts(comparison, console=console)
    rows = comparison.rows if every else comparison.headline
    other = rows[rows["finding"] != IDENTICAL]
    shown = other if every else other.head(_MOST_SHOWN)
    show_table(differences(shown, of=len(other), room=console.width), console=console)
    if len(shown) < len(other):
        say(console, "(all of them: --all, or --csv FILE)", wrap=True)
    if comparison.verdicts is not None:
        _show_verdicts(comparison.verdicts, console=console)


def _show_header(comparison: Comparison, *, console: Console) -> None:
    for name, about in (("A", comparison.a), ("B", comparison.b)):
        mechanism = f", mechanism {about['mechanism']}" if "mechanism" in about else ""
        text = (
            f"{name}: {about['out']} ({about['dataset']}, {about['people']} clusters of people, "
            f"{about['scenes']} scenes, seed {about['seed']}{mechanism})"
        )
        say(console, text, "bold", wrap=True)
    console.print()
    rows = [
        [f"{kind}:", name, f"{_value(a)} -> {_value(b)}"]
        for kind, values in comparison.changed.items()
        for name, (a, b) in values.items()
    ]
    if rows:
        say(console, "What changed, A -> B", "bold")
        for line in aligned(rows, left={0, 1, 2}):
            say(console, line, wrap=True)
    else:
        say(console, "Nothing changed in data, settings, code and libraries.", "bold", wrap=True)
    for axis, sides in comparison.only.items():
        for side, names in zip("AB", sides, strict=True):
            if names:
                say(console, f"{axis} only in {side}: {short_list(names)}", wrap=True)


def _show_counts(comparison: Comparison, *, console: Console) -> None:
    rows, only = comparison.rows, comparison.only_numbers
    console.print()
    text = (
        f"{counts(rows)[IDENTICAL]} of {len(rows)} numbers are identical "
        f"({only[0]} more are only in A, {only[1]} only in B)"
    )
    say(console, text, "bold", wrap=True)
    others = rows[~rows["headline"]]
    for name, of in (("headline", comparison.headline), ("others", others)):
        found = counts(of)
        if len(of):
            untested = f", {found[UNTESTED]} without an interval" * bool(found[UNTESTED])
            text = (
                f"{name}: {found[DIFFERS]} of {len(of)} differ (p <= {SIGNIFICANCE:g} after "
                f"Holm), {found[UNDECIDED]} undecided, {found[IDENTICAL]} identical{untested}"
            )
            say(console, text, wrap=True)
    kinds = rows["pairing"].value_counts()
    text = "; ".join(f"{kinds[kind]} {note}" for kind, note in _PAIRED.items() if kind in kinds)
    say(console, f"({text})", wrap=True)


def differences(shown: pd.DataFrame, *, of: int, room: int) -> Table:
    """Return the table of some differences out of many, for so many characters."""
    which = "All" if len(shown) == of else f"The {len(shown)} surest of {of}"
    is_mixed = len(set(shown["pairing"])) > 1
    return table(
        "differences",
        f"{which} differences, B - A with 95 % intervals, p after Holm",
        [
            *words(""),
            Column("level"),
            *words("metric"),
            *(Column(name) for name in ("A", "B", "B - A", "p")),
        ],
        [_cells(row, room=room, is_mixed=is_mixed) for row in shown.to_dict("records")],
        marks={mark: _PAIRED[kind] for kind, mark in _MARKS.items()},
        n_headings=1,
        n_keys=3,
    )


def _cells(row: Mapping[Any, Any], *, room: int, is_mixed: bool) -> list[Cell]:
    metric, p = METRICS[row["metric"]], row["p_holm"]
    mark = _MARKS.get(row["pairing"], "") if is_mixed else ""
    return [
        word(_heading(row, room=room)),
        word("") if _apart(row) else level(row["level_a"]),
        word(f"{metric.head} {metric.unit}".rstrip()),
        *(amount(metric.name, row[side]) for side in "ab"),
        amount(
            *(metric.name, row["difference"], row["ci_low"], row["ci_high"]), sign="+", mark=mark
        ),
        Cell("" if math.isnan(p) else "<0.001" if p < _SURE else f"{p:.3f}", value=p),
    ]


def _heading(row: Mapping[Any, Any], *, room: int) -> str:
    source = Source(row["consumer"], row["knowledge"]).label
    a, b = (
        f"{row[f'mechanism_{side}']} {level_text(row[f'level_{side}'])}".rstrip()
        if _apart(row)
        else str(row[f"mechanism_{side}"])
        for side in "ab"
    )
    full = f"{source}: {with_unit(a) if a == b else f'{a} -> {b}'}"
    bare = f"{source}: {a if a == b else f'{a} -> {b}'}"
    return full if len(full) <= room else shortened(bare, room=room)


def _apart(row: Mapping[Any, Any]) -> bool:
    """Return whether the two levels are not the same."""
    return level_text(row["level_a"]) != level_text(row["level_b"])


def _show_verdicts(verdicts: Mapping[str, Any], *, console: Console) -> None:
    changed = verdicts["changed"]
    if not any(verdicts.values()):
        return
    console.print()
    text = f"Verdict: {len(changed)} of {verdicts['in_both']} decisions changed"
    only = [f"{len(verdicts[f'only_{side}'])} only in {side.upper()}" for side in "ab"]
    say(console, f"{text} ({', '.join(only)})", "bold", wrap=True)
    for item in changed:
        say(console, f"{item['id']}: {item['a']} -> {item['b']}", wrap=True)


def _value(value: object) -> str:
    return "-" if value is None else shortened(str(value), room=_ROOM)
