"""What became of a verdict's items under other assumptions: a table, and JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from evaluation.reporting.table import table, word, words
from evaluation.reporting.terminal import say, show_table, standard_output
from evaluation.verdict.rules import SECTIONS
from evaluation.verdict.sensitivity import TURNED, counts

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pandas as pd

_ABOUT = (
    "(Signs of decisions: base against the run's own verdict, all others against base. lost: "
    "decided before, undecided now; gained: the reverse; missing: not tested there.)"
)


def turned(rows: pd.DataFrame) -> list[str]:
    """Return every item whose decision changed sign, in words."""
    return [
        f"{one['variant']}: {one['id']}: {one['decision_base']} "
        f"({_number(one['effect_base'], one['unit'])}) -> {one['decision']} "
        f"({_number(one['effect'], one['unit'])} "
        f"[{_number(one['ci_low'], '')}, {_number(one['ci_high'], '')}])"
        for one in rows[rows["changed"] == TURNED].to_dict("records")
    ]


def _number(value: float, unit: str) -> str:
    if not math.isfinite(value):
        return "?"
    return f"{value:.3g}" + (" s" if unit == "s" else "")


def to_json(rows: pd.DataFrame, variants: list[dict[str, Any]], *, out: Path) -> dict[str, Any]:
    """Return the table as one object of plain values; what is unknown is None.

    `variants` is what became of those that were asked for.
    """
    known = rows.astype(object)
    return {
        "out": str(out),
        "variants": variants,
        "counts": counts(rows),
        "changed_sign": turned(rows),
        "items": known.where(known.notna(), None).to_dict("records"),
    }


def show(rows: pd.DataFrame, *, left_out: Mapping[str, str]) -> None:
    """Print the table, and what changed sign, in words."""
    console = standard_output()
    shown = [section for section in SECTIONS if section in set(rows["section"])]
    cells = [
        [
            word(variant),
            *(
                word(", ".join(f"{n} {change}" for change, n in found.get(section, {}).items()))
                for section in shown
            ),
        ]
        for variant, found in counts(rows).items()
    ]
    title = "Items of the verdict, by section"
    show_table(table("sensitivity", title, words("variant", *shown), cells), console=console)
    console.print()
    say(console, _ABOUT, wrap=True)
    for name, why in left_out.items():
        say(console, f"left out: {name}: {why}; name it with --variant to run it", wrap=True)
    lines = turned(rows)
    console.print()
    say(console, "Changed sign:" if lines else "No item changed sign.", "bold")
    for line in lines:
        say(console, f"- {line}", wrap=True)
