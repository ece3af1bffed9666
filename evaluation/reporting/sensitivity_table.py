"""What became of a verdict's items under other assumptions: a table, and JSON."""

from __future__ import annotations

import math
from functools import partial
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from evaluation.reporting import terminal
from evaluation.reporting.table import built, said
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
    shown = [section for section in SECTIONS if section in set(rows["section"])]
    columns = [said("variant", itemgetter(0))]
    columns += [said(section, partial(_changes, section)) for section in shown]
    title = "Items of the verdict, by section"
    lines = turned(rows)
    terminal.show(
        [
            built("sensitivity", title, counts(rows).items(), columns),
            *("", _ABOUT),
            *(
                f"left out: {name}: {why}; name it with --variant to run it"
                for name, why in left_out.items()
            ),
            *("", ("Changed sign:" if lines else "No item changed sign.", "bold")),
            *(f"- {line}" for line in lines),
        ]
    )


def _changes(section: str, record: tuple[str, Mapping[str, Mapping[str, int]]]) -> str:
    return ", ".join(f"{n} {change}" for change, n in record[1].get(section, {}).items())
