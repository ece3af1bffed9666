"""What became of a verdict's items under other assumptions: `sensitivity.csv` and its table."""

from __future__ import annotations

import json
import math
from collections import Counter
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote_plus, unquote_plus

from evaluation.experiment.variants import BASE, variants
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pandas as pd

FOLDER: Final = "sensitivity"
TABLE: Final = "sensitivity.csv"
SECTIONS: Final = ("validity", "within", "claim", "inflation")
SAME, TURNED, LOST, GAINED, MISSING = "same", "changed sign", "lost", "gained", "missing"
CHANGES: Final = (SAME, TURNED, LOST, GAINED, MISSING)
COLUMNS: Final = (
    "variant",
    "id",
    "section",
    "adding",
    "descriptor",
    "task",
    "subject",
    "decision_base",
    "decision",
    "effect_base",
    "effect",
    "ci_low",
    "ci_high",
    "unit",
    "n",
    "sign_base",
    "sign",
    "changed",
)


def change_of(sign_base: int, sign: int | None) -> str:
    """Return what became of an item, from the signs of its decision; None: it is not there."""
    if sign is None:
        return MISSING
    if sign == sign_base:
        return SAME
    if sign_base == 0:
        return GAINED
    return LOST if sign == 0 else TURNED


def changes(
    variant: str, *, base: Mapping[str, Any], said: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Return a row of `sensitivity.csv` for every item of the base.

    Parameters
    ----------
    variant : str
    base, said : mapping
        Verdicts as in `verdict.json`.
    """
    found = {one["id"]: one for one in said["items"]}
    rows = []
    for one in base["items"]:
        other = found.get(one["id"])
        shared = {name: one[name] for name in ("id", "section", "adding", "descriptor", "task")}
        theirs = ("decision", "effect", "ci_low", "ci_high", "n", "sign")
        rows.append(
            {
                "variant": variant,
                **shared,
                "subject": (other or one)["subject"],
                "unit": one["unit"],
                **{f"{name}_base": one[name] for name in ("decision", "effect", "sign")},
                **{name: other[name] if other else None for name in theirs},
                "changed": change_of(one["sign"], other["sign"] if other else None),
            }
        )
    return rows


def folder_of(out: Path, name: str) -> Path:
    """Return the folder of a variant's run."""
    return out / FOLDER / quote_plus(name, safe="=")


def read_verdict(out: Path) -> dict[str, Any]:
    """Return the verdict of a run folder.

    Raises
    ------
    DataError
        If there is none or it cannot be read.
    """
    path = out / "verdict.json"
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
        known = [one["id"] for one in said["items"]]
    except FileNotFoundError:
        raise DataError(
            f"{out} has no verdict.json; run python -m evaluation.report {out} first"
        ) from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path} cannot be read: {error!r}; run evaluation.report again") from None
    if not known:
        raise DataError(
            f"the verdict of {out} has no items: nothing was compared, nothing can change"
        )
    assert isinstance(said, dict)
    return said


def collect(out: Path) -> tuple[pd.DataFrame, dict[str, str]]:
    """Return all finished variants as one table, and which ones are left out, each with why.

    The base is held against the verdict of OUT, every other variant against the base.

    Parameters
    ----------
    out : Path
        Folder of the run.

    Raises
    ------
    DataError
        If the run or the base has no verdict.
    """
    import pandas as pd  # noqa: PLC0415 - as above

    from evaluation.runs.folder import read_manifest  # noqa: PLC0415

    base = read_verdict(folder_of(out, BASE))
    reference = read_manifest(folder_of(out, BASE))
    order = {one.name: place for place, one in enumerate(variants())}
    names = [unquote_plus(one.name) for one in (out / FOLDER).iterdir() if one.is_dir()]
    rows, left_out = changes(BASE, base=read_verdict(out), said=base), {}
    for name in sorted(names, key=lambda one: (order.get(one, len(order)), one)):
        folder = folder_of(out, name)
        if name == BASE:
            continue
        try:
            manifest, said = read_manifest(folder), read_verdict(folder)
        except DataError:
            left_out[name] = "it is not finished"
            continue
        alike = ("seed", "scenes")
        if manifest.get("state") != "finished":
            left_out[name] = "it is not finished"
        elif any(manifest["identity"][key] != reference["identity"][key] for key in alike):
            left_out[name] = "it has another seed or number of scenes"
        elif manifest["code"] != reference["code"]:
            left_out[name] = "it is of another version of the code"
        else:
            rows += changes(name, base=base, said=said)
    return pd.DataFrame(rows, columns=list(COLUMNS)), left_out


def counts(rows: pd.DataFrame) -> dict[str, dict[str, dict[str, int]]]:
    """Return how many items of a section changed in which way: variant, section, change."""
    found: dict[str, dict[str, dict[str, int]]] = {}
    for (variant, section), part in rows.groupby(["variant", "section"], sort=False):
        number = Counter(part["changed"])
        found.setdefault(str(variant), {})[str(section)] = {
            change: number[change] for change in CHANGES if number[change]
        }
    return found


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


def show(rows: pd.DataFrame, *, left_out: Mapping[str, str]) -> None:
    """Print the table, and what changed sign, in words."""
    from rich.table import Table  # noqa: PLC0415 - as above

    from evaluation.reporting.terminal import literal, say, standard_output  # noqa: PLC0415

    console = standard_output()
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    table.add_column("variant", no_wrap=True)
    shown = [section for section in SECTIONS if section in set(rows["section"])]
    for section in shown:
        table.add_column(section)
    for variant, sections in counts(rows).items():
        cells = [
            ", ".join(f"{number} {change}" for change, number in sections.get(section, {}).items())
            for section in shown
        ]
        table.add_row(literal(console, variant), *cells)
    console.print(table, markup=False)
    console.print()
    say(
        console,
        "(Signs of decisions: base against the run's own verdict, all others against base. lost: "
        "decided before, undecided now; gained: the reverse; missing: not tested there.)",
        wrap=True,
    )
    for name, why in left_out.items():
        say(console, f"left out: {name}: {why}; name it with --variant to run it", wrap=True)
    lines = turned(rows)
    console.print()
    say(console, "Changed sign:" if lines else "No item changed sign.", "bold")
    for line in lines:
        say(console, f"- {line}", wrap=True)
