"""What is left after an attack, in the terminal: every level in short, the headline in full."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from evaluation.analysis.keys import AS_SHARED, ORACLE, Source
from evaluation.analysis.levels import (
    HEADLINE,
    SHOWN,
    after_attack,
    heading,
    level_text,
    most_knowing,
    sources,
)
from evaluation.analysis.matching import ADDING_SUFFIX
from evaluation.analysis.metrics import RECONSTRUCTION
from evaluation.experiment.presets import IDENTITY
from evaluation.reporting.terminal import aligned, say, show_grouped

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from collections.abc import Set as AbstractSet

    import pandas as pd
    from rich.console import Console

    from evaluation.analysis.levels import After, Number

_METRIC = "plr"
_LONGEST_ALONE = 8
_HEAD_WIDTH = 9
_LABEL_WIDTH = 34
# What the headline block shows and which of it with intervals, from wide terminals to narrow.
_DETAILS = (
    (RECONSTRUCTION, frozenset(RECONSTRUCTION)),
    (RECONSTRUCTION, frozenset({"plr", "ael", "mel", "rmse"})),
    (RECONSTRUCTION, frozenset({"plr", "rmse"})),
    (RECONSTRUCTION, frozenset({"plr"})),
    (RECONSTRUCTION, frozenset[str]()),
    (RECONSTRUCTION[:4], frozenset[str]()),
    (RECONSTRUCTION[:1], frozenset[str]()),
)

_Rows = list[tuple[str | None, list[str]]]


def show_attacks(
    summary: pd.DataFrame, *, slow: AbstractSet[str] = frozenset(), console: Console
) -> None:
    """Print PLR as shared and after each attack at all levels, then the headline levels in full.

    Nothing is printed without attacks.

    Parameters
    ----------
    summary : DataFrame
        As in `summary.csv`.
    slow : set of str
        Attacks that saw one release of each source track only; a line says so.
    console : Console
    """
    after = after_attack(summary)
    if not after:
        return
    columns = most_knowing(sources(after.values()))
    _show_levels(after, columns, console=console)
    notes = []
    if any(source.knowledge == ORACLE for source in columns):
        notes.append("The oracle is a reference: it stands where nobody less can run the attack.")
    notes += [
        f"{source.consumer} saw only the first release of each source track."
        for source in columns
        if source.consumer in slow
    ]
    for note in notes:
        say(console, note, wrap=True)
    _show_headline(after, console=console)


def _show_levels(after: After, columns: Sequence[Source], *, console: Console) -> None:
    """Print a table over all levels; several, each with some attacks, where one is too wide."""
    for part in _parts(after, columns, width=console.width):
        # The strongest attacks keep their intervals longest.
        order = [AS_SHARED, *sorted(part[1:], key=lambda source: -_mean(after, source))]
        for n in range(len(order), -1, -1):
            rows = _level_rows(after, part, intervals=order[:n])
            lines = aligned([cells for _, cells in rows], close=_close(part, order[:n]))
            if max(map(len, lines)) <= console.width:
                break
        left_out = "" if n == len(order) else " where there is room"
        console.print()
        say(console, f"After attack: PLR in % with 95 % intervals{left_out}", "bold", wrap=True)
        show_grouped(rows, lines, console=console)


def _parts(after: After, columns: Sequence[Source], *, width: int) -> list[list[Source]]:
    """Return the columns in parts that fit without intervals, each beside what was shared."""
    parts = [[AS_SHARED]]
    for source in columns[1:]:
        wider = [*parts[-1], source]
        rows = _level_rows(after, wider, intervals=[])
        if len(wider) > 2 and len(aligned([cells for _, cells in rows])[-1]) > width:  # noqa: PLR2004
            wider = [AS_SHARED, source]
            parts.append(wider)
        parts[-1] = wider
    return parts


def _level_rows(after: After, columns: Sequence[Source], *, intervals: Collection[Source]) -> _Rows:
    """Return the rows of a table over all levels, each under its heading; the head has none."""
    names = [[*_broken(source.consumer), *filter(None, [source.knowledge])] for source in columns]
    depth = max(map(len, names))
    heads = [[""] * (depth - len(name)) + name for name in names]
    rows: _Rows = []
    for line in range(depth):
        cells = ["level" if line == depth - 1 else ""]
        for source, head in zip(columns, heads, strict=True):
            cells += [head[line], *[""] * (source in intervals)]
        rows.append((None, cells))
    for (mechanism, level), block in after.items():
        alone = level is None and len(mechanism) <= _LONGEST_ALONE
        cells = [mechanism if alone else level_text(level)]
        for source in columns:
            cells += _cells(block.get(source, {}).get(_METRIC), interval=source in intervals)
        rows.append((heading(mechanism), cells))
    return rows


def _close(columns: Sequence[Source], intervals: Collection[Source]) -> set[int]:
    """Return which columns of the grid hold intervals."""
    kinds = ["level"]
    for source in columns:
        kinds += ["value", *["interval"] * (source in intervals)]
    return {place for place, kind in enumerate(kinds) if kind == "interval"}


def _show_headline(after: After, *, console: Console) -> None:
    blocks = {
        (name, level): after[name, level]
        for suffix in ADDING_SUFFIX.values()
        for mechanism, level, _ in HEADLINE
        if (name := mechanism if level is None else mechanism + suffix, level) in after
    }
    if not blocks:
        return
    for metrics, intervals in _DETAILS:
        rows = _headline_rows(blocks, metrics=metrics, intervals=intervals)
        kinds = ["label"]
        for metric in metrics:
            kinds += ["value", *["interval"] * (metric in intervals)]
        close = {place for place, kind in enumerate(kinds) if kind == "interval"}
        lines = aligned([cells for _, cells in rows], left={0}, close=close)
        if max(map(len, lines)) <= console.width:
            break
    left_out = "" if intervals >= set(metrics) else " where there is room"
    console.print()
    say(console, f"After attack, every adversary: 95 % intervals{left_out}", "bold", wrap=True)
    show_grouped(rows, lines, console=console)


def _headline_rows(
    blocks: Mapping[tuple[str, float | None], Mapping[Source, Mapping[str, Number]]],
    *,
    metrics: Sequence[str],
    intervals: AbstractSet[str],
) -> _Rows:
    heads: list[list[str]] = [[""], ["positions"]]
    for metric in metrics:
        first, _, rest = SHOWN[metric].head.partition(" ")
        pad = [""] * (metric in intervals)
        heads[0] += [first, *pad]
        heads[1] += [rest or SHOWN[metric].unit, *pad]
    rows: _Rows = [(None, cells) for cells in heads]
    for (mechanism, level), block in blocks.items():
        for label, numbers in _merged(block).items():
            cells = [label]
            for metric in metrics:
                cells += _cells(numbers.get(metric), interval=metric in intervals)
            rows.append((f"{mechanism} {level_text(level)}".rstrip(), cells))
    return rows


def _merged(block: Mapping[Source, Mapping[str, Number]]) -> dict[str, Mapping[str, Number]]:
    """Return the numbers by label: adversaries whose numbers are the same share a line.

    The control is left out where it says what `shared` says.
    """
    groups: list[tuple[str, list[str], Mapping[str, Number]]] = []
    adversaries: dict[str, int] = {}
    for source, numbers in block.items():
        adversaries[source.consumer] = adversaries.get(source.consumer, 0) + 1
        if source.consumer == IDENTITY and _same(numbers, block.get(AS_SHARED, {})):
            continue
        for consumer, knows, others in groups:
            if consumer == source.consumer and numbers == others:
                knows.append(source.knowledge)
                break
        else:
            groups.append((source.consumer, [source.knowledge], numbers))
    return {
        _label(consumer, knows, is_all=len(knows) == adversaries[consumer]): numbers
        for consumer, knows, numbers in groups
    }


def _same(numbers: Mapping[str, Number], others: Mapping[str, Number]) -> bool:
    """Whether the descriptors agree; only an attack has a ratio to the benchmark."""
    return all(numbers.get(metric) == one for metric, one in others.items())


def _label(consumer: str, knows: Sequence[str], *, is_all: bool) -> str:
    who = "any adversary" if is_all and len(knows) > 1 else ", ".join(knows)
    room = _LABEL_WIDTH - len(who) - 3
    name = consumer if len(consumer) <= room else f"{consumer[: room - 3]}..."
    return f"{name} ({who})" if who else name


def _cells(value: Number | None, *, interval: bool) -> list[str]:
    shown = "-" if value is None or not value.value else value.value
    return [shown, "" if value is None else value.interval] if interval else [shown]


def _mean(after: After, source: Source) -> float:
    values = [
        float(number.value)
        for block in after.values()
        if (number := block.get(source, {}).get(_METRIC)) is not None and number.value
    ]
    return sum(values) / len(values) if values else 0.0


def _broken(name: str) -> list[str]:
    """Return a name in lines of few characters, broken after punctuation where that is enough."""
    lines = [""]
    for piece in re.findall(r"[^_:.,=-]*[_:.,=-]|[^_:.,=-]+", name):
        if lines[-1] and len(lines[-1]) + len(piece) > _HEAD_WIDTH:
            lines.append("")
        lines[-1] += piece
    return [
        line[start : start + _HEAD_WIDTH]
        for line in lines
        for start in range(0, max(len(line), 1), _HEAD_WIDTH)
    ]
