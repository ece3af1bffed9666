"""Which releases are linked, in the terminal: a block for each task, at the headline levels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from attacks.tasks.controls import CONTROLS
from evaluation.analysis.levels import (
    INVALID,
    REMARKS,
    adding_of,
    amount,
    level_text,
    linked_levels,
    linked_tasks,
    linker,
    number,
    remarks,
    shortened,
)
from evaluation.analysis.linkability import CLEAN
from evaluation.cells.link_scores import WITHOUT_FROZEN, WITHOUT_GROUPS
from evaluation.reporting.terminal import aligned, say
from isac_track.linkability import LEVEL

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    import pandas as pd
    from rich.console import Console

    from evaluation.analysis.keys import Source, Where
    from evaluation.analysis.levels import LinkedTask

MARKS = dict(zip(REMARKS, "~?!", strict=True))
_USUAL = "informed"
_COHORTS = {WITHOUT_GROUPS: "walking groups", WITHOUT_FROZEN: "frozen annotations"}
_HEAD_WIDTH = 9
_LABEL_WIDTH = 30
_MOST_NAMED = 4


def show_linkage(
    linkability: pd.DataFrame, *, manifest: Mapping[str, Any], console: Console
) -> None:
    """Print how often each attack links at the headline levels, task by task.

    Nothing is printed without linkage.

    Parameters
    ----------
    linkability : DataFrame
        As in `linkability.csv`.
    manifest : mapping
        As in `manifest.json`; it knows how many people a task has.
    console : Console
    """
    tasks = linked_tasks(linkability)
    if not tasks:
        return
    known = manifest.get("linkage", {})
    _show_legend(tasks, console=console)
    for task in tasks:
        people = known.get("tasks", {}).get(task.name, {}).get("people")
        _show_task(task, people=people, console=console)
    for name, why in known.get("skipped", {}).items():
        console.print()
        say(console, f"{name} is left out: {why}", "yellow", wrap=True)


def _show_legend(tasks: Sequence[LinkedTask], *, console: Console) -> None:
    console.print()
    text = "Linkage: rank 1 in % with 95 % intervals where there is room"
    say(console, text, "bold", wrap=True)
    shown = [
        (where, task.cells[where][source])
        for task in tasks
        for where in linked_levels(task)
        for source in task.attacks
        if source in task.cells[where]
    ]
    used = {remark for _, row in shown for remark in remarks(row)}
    notes = [f"{mark} {REMARKS[remark]}" for remark, mark in MARKS.items() if remark in used]
    if len(used - {INVALID}):
        notes.append(f"unmarked: it links, by the ranks of all mates (p <= {LEVEL:g})")
    if any(where == (CLEAN, None) for where, _ in shown):
        notes.append("clean: no error at all, the ceiling")
    if any(adding_of(mechanism)[1] for (mechanism, _), _ in shown):
        notes.append("lin., ind.: linear and independent adding")
    notes.append(f"the adversary is {_USUAL} where none is named")
    say(console, f"({'; '.join(notes)})", wrap=True)


def _show_task(task: LinkedTask, *, people: int | None, console: Console) -> None:
    columns = linked_levels(task)
    console.print()
    say(console, f"{task.name}: {task.about}" if task.about else task.name, "bold cyan", wrap=True)
    some = next(iter(task.cells[columns[0]].values()))
    say(console, _size(some, people=people), wrap=True)
    lines, left_out = _fitting(task, columns, width=console.width)
    for place, line in enumerate(lines):
        say(console, line, "bold" if place < len(lines) - len(task.attacks) else "")
    notes = [_confounders(task, columns), _controls(task)]
    if left_out:
        names = (
            ", ".join(map(_name, left_out))
            if len(left_out) <= _MOST_NAMED
            else f"{len(left_out)} more levels"
        )
        notes.insert(0, f"No room for {names}: linkability.csv")
    for note in filter(None, notes):
        say(console, note, wrap=True)


def _size(row: Mapping[str, Any], *, people: int | None) -> str:
    """Return how many people and candidates there are, and what guessing achieves."""
    low, high = int(row["gallery_min"]), int(row["gallery_max"])
    candidates = str(low) if low == high else f"{low} to {high} (mean {row['gallery_mean']:.1f})"
    who = "" if people is None else f"{people} people; "
    probes, mated = int(row["n_probes"]), int(row["n_mated"])
    among = f"all {probes}" if probes == mated else f"{mated} of {probes}"
    return (
        f"{who}{among} releases have a mate among {candidates} candidates; "
        f"chance {amount('rank1', row['chance'])} %"
    )


def _fitting(
    task: LinkedTask, columns: Sequence[Where], *, width: int
) -> tuple[list[str], list[Where]]:
    """Return the table in lines that fit, and the columns that find no room."""
    # What is shared as it is by default keeps its intervals longest.
    order = sorted(columns, key=lambda where: (bool(adding_of(where[0])[1]), where[1] is None))
    kept = list(columns)
    while len(kept) > 1 and max(map(len, _lines(task, kept, intervals=[]))) > width:
        kept.pop()
    for n in range(len(order), -1, -1):
        lines = _lines(task, kept, intervals=order[:n])
        if max(map(len, lines)) <= width:
            break
    return lines, list(columns[len(kept) :])


def _lines(
    task: LinkedTask, columns: Sequence[Where], *, intervals: Collection[Where]
) -> list[str]:
    heads_of = _heads(columns)
    depth = max(map(len, heads_of))
    rows = [[label] for label in [*[""] * (depth - 1), "attack", *_labels(task.attacks)]]
    kinds = ["label"]
    for where, parts in zip(columns, heads_of, strict=True):
        heads = [""] * (depth - len(parts)) + parts
        found = [task.cells[where].get(source) for source in task.attacks]
        marks = [
            "" if row is None else "".join(MARKS[one] for one in remarks(row)) for row in found
        ]
        room = max(map(len, marks))
        kinds += ["value", *["interval"] * (where in intervals)]
        for cells, head in zip(rows[:depth], heads, strict=True):
            cells += [head + " " * room, *[""] * (where in intervals)]
        for cells, row, mark in zip(rows[depth:], found, marks, strict=True):
            shown = None if row is None else number("rank1", *_estimate(row))
            cells.append((shown.value if shown and shown.value else "-") + mark.ljust(room))
            if where in intervals:
                cells.append(shown.interval if shown else "")
    close = {place for place, kind in enumerate(kinds) if kind == "interval"}
    return aligned(rows, left={0}, close=close)


def _heads(columns: Sequence[Where]) -> list[list[str]]:
    """Return the head of each column, in lines from top to bottom."""
    has_rules = any(adding_of(mechanism)[1] for mechanism, _ in columns)
    heads = []
    for mechanism, level in columns:
        name, adding = adding_of(mechanism)
        parts = [name[start : start + _HEAD_WIDTH] for start in range(0, len(name), _HEAD_WIDTH)]
        if level is not None:
            rule = ["ind." if adding else "lin."] if has_rules else []
            parts = [*rule, *parts, level_text(level)]
        heads.append(parts)
    return heads


def _labels(attacks: Iterable[Source]) -> list[str]:
    """Return the names of the rows; a linker's reconstructions stand below its own name."""
    labels: list[str] = []
    above = ""
    for source in attacks:
        name = source.consumer
        if linker(source) == above and "@" in name:
            name = f"  {name.removeprefix(above)}"
        above = linker(source)
        who = "" if source.knowledge == _USUAL else f" ({source.knowledge})"
        labels.append(shortened(name, room=_LABEL_WIDTH - len(who)) + who)
    return labels


def _estimate(row: Mapping[str, Any]) -> tuple[float, float, float]:
    return row["rank1"], row["ci_low"], row["ci_high"]


def _confounders(task: LinkedTask, columns: Sequence[Where]) -> str:
    """Return what the best attack of one level links without each confounder."""
    # A level of the mechanisms under test before raw and the ceiling.
    for where in sorted(columns, key=lambda where: where[1] is None):
        rows = {
            source: row
            for source in task.attacks
            if (row := task.cells[where].get(source)) is not None and row["rank1"] >= 0
        }
        if not rows:
            continue
        best = max(rows, key=lambda source: rows[source]["rank1"])
        parts = [
            f"without {what} {_against_chance(cohort)}"
            for name, what in _COHORTS.items()
            if (cohort := task.cohorts.get(name, {}).get(where, {}).get(best)) is not None
        ]
        if parts:
            value = _against_chance(rows[best], word="chance ")
            return f"{_name(where)}, {best.consumer}: {value}; {', '.join(parts)}"
    return ""


def _against_chance(row: Mapping[str, Any], *, word: str = "") -> str:
    value, chance = (number("rank1", row[key]).value or "-" for key in ("rank1", "chance"))
    return f"{value} ({word}{chance})"


def _controls(task: LinkedTask) -> str:
    """Return how many controls beat chance, and which audits leak at how many levels."""
    tests: dict[str, list[float]] = {}
    for row in task.controls:
        name = row["consumer"].partition("/control-")[2]
        p_values = tests.setdefault(name, [])
        # One that only sees times says the same at every level.
        if not (p_values and name in CONTROLS and CONTROLS[name].sees_times_only):
            p_values.append(row["p_value"])
    beaten = {name: sum(p <= LEVEL for p in p_values) for name, p_values in tests.items()}
    often = [
        f"{name} {count} of {len(tests[name])}"
        for name, count in beaten.items()
        if count > len(tests[name]) / 2
    ]
    parts = []
    if tests:
        n_tests = sum(map(len, tests.values()))
        told = "; ".join([f"{LEVEL * n_tests:.1f} expected", *often])
        count = f"{sum(beaten.values())} of {n_tests}"
        parts.append(f"controls: {count} beat chance at {100 * LEVEL:g} % ({told})")
    leaks: dict[str, int] = {}
    for block in task.cells.values():
        names = {row["invalid"] for row in block.values() if row["invalid"]}
        for name in sorted({part for one in names for part in one.split(", ")}):
            leaks[name] = leaks.get(name, 0) + 1
    leaky = [f"{name} at {count} of {len(task.cells)} levels" for name, count in leaks.items()]
    if leaky or tests:
        parts.append(f"audits that leak: {', '.join(leaky) or 'none'}")
    return "; ".join(parts)


def _name(where: Where) -> str:
    mechanism, adding = adding_of(where[0])
    return f"{mechanism} {level_text(where[1])}".rstrip() + (f" ({adding})" if adding else "")
