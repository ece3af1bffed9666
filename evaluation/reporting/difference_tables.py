"""Differences on the terminal and as JSON: of two runs, or under other settings."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console

from evaluation.estimates import differences as comparing
from evaluation.estimates import run_settings
from evaluation.estimates.families import with_unit
from evaluation.estimates.keys import where_text
from evaluation.estimates.metrics import METRICS
from evaluation.plan.address import parse_consumer
from evaluation.plan.variants import BASE
from evaluation.plan.world import OWN_WORLD, parse_world
from evaluation.reporting import table as make
from evaluation.reporting import terminal
from evaluation.reporting.announcements import scenes_text
from evaluation.reporting.table import Cell, Column, Table
from evaluation.reporting.terminal import Part
from evaluation.verdict import sensitivity
from evaluation.verdict.rules import SECTIONS

_MOST_SHOWN = 20
_ROOM = 24
_SURE = 0.001  # Smaller p-values are not written out.
_WITHOUT_UNIT = {"", "fraction", "share", "ratio", "correlation"}
_PAIRED = {
    run_settings.DRAWS: "paired over people and draws",
    run_settings.PEOPLE: "paired over people, not over draws (other scenes and errors)",
    run_settings.NONE: "not paired: intervals of independent estimates",
}
# Mark of a difference that is not paired in full.
_MARKS = {
    run_settings.PEOPLE: "~",
    run_settings.NONE: "*",
}


def to_json(comparison: comparing.Comparison, *, every: bool = False) -> dict[str, Any]:
    """Return a comparison as plain values, its headline or `every` number.

    What is unknown is None.
    """
    rows = comparison.rows if every else comparison.headline
    return {
        "a": comparison.a,
        "b": comparison.b,
        "changed": {
            kind: {
                name: {"a": _json_value(a), "b": _json_value(b)}
                for name, (a, b) in values.items()
            }
            for kind, values in comparison.changed.items()
        },
        "only": {axis: {"a": a, "b": b} for axis, (a, b) in comparison.only.items()},
        "numbers": {
            "in_both": len(comparison.rows),
            "only_a": comparison.only_numbers[0],
            "only_b": comparison.only_numbers[1],
            "headline": comparing.counts(comparison.headline),
            "other": comparing.counts(comparison.rows[~comparison.rows["headline"]]),
            "pairing": comparison.rows["pairing"].value_counts().to_dict(),
        },
        "verdicts": comparison.verdicts,
        "lead": _plain(comparison.lead),
        "differences": _plain(rows),
    }


def _json_value(value: object) -> object:
    """Return a setting as JSON has it: infinity is a text."""
    is_infinite = isinstance(value, float) and not math.isfinite(value)
    return str(value) if is_infinite else value


def _plain(rows: pd.DataFrame) -> list[dict[Any, Any]]:
    """Return rows as plain values; NaN and infinity become None."""
    known = rows.replace([math.inf, -math.inf], math.nan).astype(object)
    return known.where(known.notna(), None).to_dict("records")


def show(
    comparison: comparing.Comparison,
    *,
    every: bool = False,
    console: Console | None = None,
) -> None:
    """Print the changes and the surest differences, or `every` difference."""
    console = console or terminal.standard_output()
    rows = comparison.rows if every else comparison.headline
    other = rows[rows["finding"] != comparing.IDENTICAL]
    shown = other if every else other.head(_MOST_SHOWN)
    parts: list[Part] = [*map(_bold, _run_lines(comparison))]
    parts += [_lead_table(comparison.lead), ""]
    parts += _change_parts(comparison)
    parts += ["", *_count_parts(comparison)]
    parts.append(difference_table(shown, n_total=len(other), room=console.width))
    if len(shown) < len(other):
        parts.append("(all of them: --all, or --csv FILE)")
    parts += _verdict_parts(comparison.verdicts or {})
    terminal.show(parts, console=console)


def _bold(text: str) -> Part:
    return text, "bold"


def _run_lines(comparison: comparing.Comparison) -> list[str]:
    """Return a line on each of the two runs."""
    return [
        f"{name}: {about['out']} ({about['dataset']}, {about['people']} clusters of"
        f" people, {scenes_text(about)}, seed {about['seed']})"
        for name, about in (("A", comparison.a), ("B", comparison.b))
    ]


def _lead_table(lead: pd.DataFrame) -> Table:
    """Return the table of the main numbers."""
    title = "The main numbers, B - A with 95 % intervals, p after Holm"
    keys = [
        make.text_column(
            "",
            lambda row: f"{METRICS[row['metric']].title}, {_source(row)}{_ahead(row)}",
        ),
        make.text_column("", lambda row: where_text(row["mechanism"], row["level"])),
    ]
    return _table("lead", title, lead, keys)


def _change_parts(comparison: comparing.Comparison) -> list[Part]:
    """Return which settings, data and code differ, and which names one run lacks."""
    rows = [
        [f"{kind}:", name, " -> ".join(_shown_value(value) for value in pair)]
        for kind, values in comparison.changed.items()
        for name, pair in values.items()
    ]
    head = "Nothing changed in data, settings, code and libraries."
    if rows:
        head = "What changed, A -> B"
    only = [
        f"{axis} only in {side}: {comparing.short_list(names)}"
        for axis, sides in comparison.only.items()
        for side, names in zip("AB", sides, strict=True)
        if names
    ]
    return [_bold(head), *terminal.aligned(rows, left={0, 1, 2}), *only]


def _shown_value(value: object) -> str:
    return make.shorten_name("-" if value is None else str(value), room=_ROOM)


def _count_parts(comparison: comparing.Comparison) -> list[Part]:
    """Return how many numbers are identical, and how many of each family differ."""
    rows, (only_a, only_b) = comparison.rows, comparison.only_numbers
    n_identical = comparing.counts(rows)[comparing.IDENTICAL]
    head = (
        f"{n_identical} of {len(rows)} numbers are identical ({only_a} more are only in"
        f" A, {only_b} only in B)"
    )
    families = {"headline": comparison.headline, "others": rows[~rows["headline"]]}
    texts = [
        _family_text(name, numbers)
        for name, numbers in families.items()
        if len(numbers)
    ]
    kinds = rows["pairing"].value_counts()
    paired = [
        f"{kinds[kind]} {note}" for kind, note in _PAIRED.items() if kind in kinds
    ]
    return [_bold(head), *texts, f"({'; '.join(paired)})"]


def _family_text(name: str, rows: pd.DataFrame) -> str:
    """Return how many numbers of a family differ."""
    counts = comparing.counts(rows)
    untested = counts[comparing.UNTESTED]
    without = f", {untested} without an interval" if untested else ""
    return (
        f"{name}: {counts[comparing.DIFFERS]} of {len(rows)} differ (p <="
        f" {comparing.SIGNIFICANCE:g} after Holm), {counts[comparing.BETWEEN]}"
        f" undecided, {counts[comparing.IDENTICAL]} identical{without}"
    )


def _verdict_parts(verdicts: Mapping[str, Any]) -> list[Part]:
    """Return which decisions changed; an empty list if none can be compared."""
    if not any(verdicts.values()):
        return []
    changed = verdicts["changed"]
    head = (
        f"Verdict: {len(changed)} of {verdicts['in_both']} decisions changed "
        f"({len(verdicts['only_a'])} only in A, {len(verdicts['only_b'])} only in B)"
    )
    return [
        "",
        _bold(head),
        *(f"{item['id']}: {item['a']} -> {item['b']}" for item in changed),
    ]


def difference_table(shown: pd.DataFrame, *, n_total: int, room: int) -> Table:
    """Return the table of the `shown` differences out of `n_total`.

    `room` is the width of the terminal in characters.
    """
    selection = "All"
    if len(shown) < n_total:
        selection = f"The {len(shown)} surest of {n_total}"
    metrics = {
        name: f"{metric.head} {metric.unit}".rstrip()
        for name, metric in METRICS.items()
    }
    keys = [
        make.text_column("", lambda row: _heading(row, room=room)),
        Column("level", lambda row: make.level_cell(row["level"])),
        make.text_column("metric", lambda row: metrics[row["metric"]]),
    ]
    title = f"{selection} differences, B - A with 95 % intervals, p after Holm"
    return _table("differences", title, shown, keys)


def _table(name: str, title: str, shown: pd.DataFrame, keys: Sequence[Column]) -> Table:
    """Return a table of differences: the key columns, A, B, B - A, and p."""
    marks = _MARKS if len(set(shown["pairing"])) > 1 else {}

    def change(row: Mapping[Any, Any]) -> Cell:
        ends = (row[name] for name in ("difference", "ci_low", "ci_high"))
        return make.metric_cell(
            row["metric"], *ends, sign="+", mark=marks.get(row["pairing"], "")
        )

    def p_value(row: Mapping[Any, Any]) -> Cell:
        p = row["p_holm"]
        text = "<0.001" if p < _SURE else f"{p:.3f}"
        return Cell("" if math.isnan(p) else text, value=p)

    columns = [*keys, make.metric_column("A", "a"), make.metric_column("B", "b")]
    columns += [Column("B - A", change), Column("p", p_value)]
    meaning = {mark: _PAIRED[kind] for kind, mark in _MARKS.items()}
    return make.build_table(
        name,
        title,
        shown.to_dict("records"),
        columns,
        marks=meaning,
        n_headings=1,
        n_keys=len(keys),
    )


def _heading(row: Mapping[Any, Any], *, room: int) -> str:
    """Return attack or robot and mechanism; the mechanism with its unit, if it fits."""
    source = f"{_source(row)}{_ahead(row)}"
    if len(full := f"{source}: {with_unit(row['mechanism'])}") <= room:
        return full
    return make.shorten_name(f"{source}: {row['mechanism']}", room=room)


def _ahead(row: Mapping[Any, Any]) -> str:
    """Return the further horizon of a robot's number; empty at the run's own."""
    world = parse_world(row["world"]) or OWN_WORLD
    horizon_s = world.horizon_s
    return "" if horizon_s is None else f", {horizon_s:g} s ahead"


def _source(row: Mapping[Any, Any]) -> str:
    label = parse_consumer(row["consumer"], row["knowledge"]).label
    return f"{label} under {row['policy']}" if row["policy"] else label


def sign_changes(rows: pd.DataFrame) -> list[str]:
    """Return a line on every item whose decision changed sign."""
    items = rows[rows["changed"] == sensitivity.TURNED].to_dict("records")
    return [
        f"{item['variant']}: {item['id']}: {item['decision_base']} "
        f"({_short(item['effect_base'], item['unit'])}) -> {item['decision']} "
        f"({_short(item['effect'], item['unit'])} "
        f"[{_short(item['ci_low'], '')}, {_short(item['ci_high'], '')}])"
        for item in items
    ]


def _short(value: float, unit: str) -> str:
    """Return an effect with three digits, and its unit if it has a dimension."""
    if not math.isfinite(value):
        return "unknown"
    word = "" if unit in _WITHOUT_UNIT else f" {unit}"
    return f"{value:.3g}{word}"


def variants_json(
    rows: pd.DataFrame, others: list[dict[str, Any]], *, out: Path
) -> dict[str, Any]:
    """Return the table and the outcomes of the variants, `others`, as plain values."""
    return {
        "out": str(out),
        "variants": others,
        "counts": sensitivity.counts(rows),
        "changed_sign": sign_changes(rows),
        "items": _plain(rows),
    }


def show_variants(rows: pd.DataFrame, *, left_out: Mapping[str, str]) -> None:
    """Print how many items changed by variant, and the items that changed sign."""
    shown = [section for section in SECTIONS if section in set(rows["section"])]
    records = []
    for variant, sections in sensitivity.counts(rows).items():
        record = {"variant": variant}
        for section in shown:
            changes = sections.get(section, {})
            record[section] = ", ".join(f"{n} {name}" for name, n in changes.items())
        records.append(record)
    columns = [make.text_column(name) for name in ("variant", *shown)]
    items = make.build_table(
        "sensitivity", "Items of the verdict, by section", records, columns
    )
    terminal.show([items, "", *_variant_parts(rows, left_out)])


def _variant_parts(rows: pd.DataFrame, left_out: Mapping[str, str]) -> list[Part]:
    """Return which variants were left out, and how many decisions changed."""
    changes = rows.loc[rows["variant"] != BASE, "changed"].value_counts()
    others = [name for name in sensitivity.CHANGES if name in changes.index]
    counts = [
        f", {changes[name]} {name}"
        for name in others
        if name not in (sensitivity.SAME, sensitivity.TURNED)
    ]
    lines = sign_changes(rows)
    end = ":" if lines else "."
    head = (
        f"{changes.get(sensitivity.SAME, 0)} items have the same"
        f" decision{''.join(counts)}, {len(lines)} {sensitivity.TURNED}{end}"
    )
    meaning = (
        "(Signs of decisions: base against the run's own verdict, all others against"
        " base. lost: decided before, not now; gained: the reverse; missing: not tested"
        " there.)"
    )
    return [
        meaning,
        *(
            f"left out: {name}: {why}; --variant {name} runs it"
            for name, why in left_out.items()
        ),
        "",
        _bold(head),
        *(f"- {line}" for line in lines),
    ]
