"""What other assumptions give: a verdict's items in variants of a run, other sensing constants."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from evaluation.analysis.calibration import FITTED, Calibration
from evaluation.analysis.metrics import METRICS
from evaluation.analysis.paper import PUBLISHED
from evaluation.reporting import terminal
from evaluation.reporting.table import built, held, number, word
from evaluation.verdict.rules import SECTIONS
from evaluation.verdict.sensitivity import TURNED, counts

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pandas as pd

_ABOUT_ITEMS = (
    "(Signs of decisions: base against the run's own verdict, all others against base. lost: "
    "decided before, undecided now; gained: the reverse; missing: not tested there.)"
)
_ABOUT_CONSTANTS = (
    "rates and PLR in %, lengths in s; fitted: raw PLR, raw MEL and the PLR of fid:1000; all "
    "others (linear adding) are predictions"
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
    return f"{value:.3g}{' s' * (unit == 's')}" if math.isfinite(value) else "?"


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


def show_variants(rows: pd.DataFrame, *, left_out: Mapping[str, str]) -> None:
    """Print the table, and what changed sign, in words."""
    records = [
        {"variant": word(variant)}
        | {
            section: word(", ".join(f"{n} {change}" for change, n in found.items()))
            for section, found in of.items()
        }
        for variant, of in counts(rows).items()
    ]
    shown = [section for section in SECTIONS if section in set(rows["section"])]
    columns = [held(name, align="left") for name in ("variant", *shown)]
    lines = turned(rows)
    terminal.show(
        [
            built("sensitivity", "Items of the verdict, by section", records, columns),
            *("", _ABOUT_ITEMS),
            *(
                f"left out: {name}: {why}; name it with --variant to run it"
                for name, why in left_out.items()
            ),
            *("", ("Changed sign:" if lines else "No item changed sign.", "bold")),
            *(f"- {line}" for line in lines),
        ]
    )


def show_constants(found: Mapping[str, Calibration]) -> None:
    """Print constants and what they predict beside the paper's numbers, case by case."""
    records = [
        {"constant or number": word(name)}
        | {case: number(getattr(fit, name), digits=2) for case, (fit, _) in found.items()}
        for name in FITTED
    ]
    for mechanism, level, metric, published in PUBLISHED:
        spec = mechanism if level is None else f"{mechanism}:{level:g}"
        numbers = {"paper": published} | {
            case: ours[spec, metric] for case, (_, ours) in found.items()
        }
        shown = METRICS[metric]
        digits = 1 if shown.is_share else 2
        cells = {
            case: number(one, scale=shown.scale, digits=digits) for case, one in numbers.items()
        }
        records.append({"constant or number": word(f"{spec} {metric}")} | cells)
    columns = [held("constant or number", align="left"), *map(held, ("paper", *found))]
    title = "paper, and what each set of constants gives"
    terminal.show([built("calibration", title, records, columns, notes=[_ABOUT_CONSTANTS])])
