"""Two runs side by side, in the terminal."""

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
from evaluation.analysis.keys import Source
from evaluation.analysis.levels import heading, level_text, shortened
from evaluation.analysis.metrics import METRICS
from evaluation.analysis.run_changes import DRAWS, NONE, PEOPLE, short_list
from evaluation.reporting.terminal import aligned, say, show_grouped, standard_output

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd
    from rich.console import Console

    from evaluation.analysis.differences import Comparison

_MOST_SHOWN = 20
_ROOM = 24


def show(comparison: Comparison, *, every: bool = False, console: Console | None = None) -> None:
    """Print what changed, how much of it counts, and the surest differences.

    `every` shows all numbers that are not identical instead of the surest of the headline.
    """
    console = standard_output() if console is None else console
    _show_header(comparison, console=console)
    _show_counts(comparison.rows, only=comparison.only_numbers, console=console)
    rows = comparison.rows if every else comparison.rows[comparison.rows["headline"]]
    _show_rows(rows, most=None if every else _MOST_SHOWN, console=console)
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
    changed = [
        (kind, name, both)
        for kind, all_ in comparison.changed.items()
        for name, both in all_.items()
    ]
    if changed:
        say(console, "What changed, A -> B", "bold")
        rows = [[f"{kind}:", name, f"{_value(a)} -> {_value(b)}"] for kind, name, (a, b) in changed]
        for line in aligned(rows, left={0, 1, 2}):
            say(console, line, wrap=True)
    else:
        say(console, "Nothing changed in data, settings, code and libraries.", "bold", wrap=True)
    for axis, sides in comparison.only.items():
        for side, names in zip("AB", sides, strict=True):
            if names:
                say(console, f"{axis} only in {side}: {short_list(names)}", wrap=True)


def _show_counts(rows: pd.DataFrame, *, only: tuple[int, int], console: Console) -> None:
    identical = int((rows["finding"] == IDENTICAL).sum())
    console.print()
    text = (
        f"{identical} of {len(rows)} numbers are identical "
        f"({only[0]} more are only in A, {only[1]} only in B)"
    )
    say(console, text, "bold", wrap=True)
    for name, of in (("headline", rows["headline"]), ("others", ~rows["headline"])):
        found = counts(rows[of])
        total = sum(found.values())
        if total:
            text = (
                f"{name}: {found[DIFFERS]} of {total} differ "
                f"(p <= {SIGNIFICANCE:g} after Holm), {found[UNDECIDED]} undecided, "
                f"{found[IDENTICAL]} identical"
                + f", {found[UNTESTED]} without an interval"
                * bool(found[UNTESTED])
            )
            say(console, text, wrap=True)
    kinds = rows["pairing"].value_counts()
    notes = {
        DRAWS: "paired over people and draws",
        PEOPLE: "paired over people, not over draws (scenes and errors are others)",
        NONE: "not paired: intervals as of independent estimates",
    }
    text = "; ".join(f"{kinds[kind]} {note}" for kind, note in notes.items() if kind in kinds)
    say(console, f"({text})", wrap=True)


def _show_rows(rows: pd.DataFrame, *, most: int | None, console: Console) -> None:
    other = rows[rows["finding"] != IDENTICAL]
    shown = other.head(len(other) if most is None else most)
    if shown.empty:
        return
    console.print()
    which = "All" if len(shown) == len(other) else f"The {len(shown)} surest of {len(other)}"
    text = f"{which} differences, B - A with 95 % intervals, p after Holm"
    say(console, text, "bold", wrap=True)
    mixed = len(set(shown["pairing"])) > 1
    heads = ["level", "metric", "A", "B", "B - A", "95 % interval", "p", *["paired"] * mixed]
    by_heading: dict[str, list[list[str]]] = {}
    for row in shown.to_dict("records"):
        cells = [*_cells(row), *[row["pairing"]] * mixed]
        by_heading.setdefault(_heading(row, room=console.width), []).append(cells)
    grid: list[tuple[str | None, list[str]]] = [(None, heads)]
    grid += [(name, cells) for name, block in by_heading.items() for cells in block]
    lines = aligned([cells for _, cells in grid], left={1, 7})
    if max(map(len, lines)) > console.width and mixed:
        grid = [(name, cells[:-1]) for name, cells in grid]
        lines = aligned([cells for _, cells in grid], left={1})
    show_grouped(grid, lines, console=console)
    if len(shown) < len(other):
        say(console, "(all of them: --all, or --csv FILE)", wrap=True)


def _heading(row: Mapping[Any, Any], *, room: int) -> str:
    source = Source(row["consumer"], row["knowledge"]).label
    a, b = (
        f"{row[f'mechanism_{side}']} {level_text(row[f'level_{side}'])}".rstrip()
        if _apart(row)
        else str(row[f"mechanism_{side}"])
        for side in "ab"
    )
    full = f"{source}: {heading(a) if a == b else f'{a} -> {b}'}"
    bare = f"{source}: {a if a == b else f'{a} -> {b}'}"
    return full if len(full) <= room else shortened(bare, room=room)


def _apart(row: Mapping[Any, Any]) -> bool:
    """Return whether the two levels are not the same."""
    return level_text(row["level_a"]) != level_text(row["level_b"])


def _cells(row: Mapping[Any, Any]) -> list[str]:
    shown = METRICS[row["metric"]]

    def text(name: str, sign: str = "-") -> str:
        value = row[name] * shown.scale
        return f"{value:{sign}.{shown.digits}f}" if math.isfinite(value) else "-"

    interval = f"[{text('ci_low', '+')}, {text('ci_high', '+')}]"
    p = row["p_holm"]
    return [
        "" if _apart(row) else level_text(row["level_a"]),
        f"{shown.head} {shown.unit}".rstrip(),
        text("a"),
        text("b"),
        text("difference", "+"),
        interval if math.isfinite(row["ci_low"]) else "",
        "" if math.isnan(p) else "<0.001" if p < 0.001 else f"{p:.3f}",  # noqa: PLR2004
    ]


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
