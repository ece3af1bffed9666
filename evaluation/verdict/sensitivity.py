"""What becomes of a verdict's items under other assumptions: the rows of `sensitivity.csv`."""

from __future__ import annotations

import json
from collections import Counter
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote_plus, unquote_plus

import pandas as pd

from evaluation.experiment.variants import BASE, variants
from evaluation.runs.files import write_whole
from evaluation.runs.manifest import read_manifest
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

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


def attacks_of(items: Iterable[Mapping[str, Any]]) -> dict[str, frozenset[str]]:
    """Return the SPECs of the attacks that a verdict is about, each with its tasks.

    Those are the subjects of its items, and of the contrasts in which a mechanism differs from
    fixed noise. A reconstruction has the task "".

    Parameters
    ----------
    items : iterable of mapping
        As in `verdict.json`.
    """
    found: dict[str, set[str]] = {}
    for one in items:
        contrasts = [pair for pair in one.get("contrasts", ()) if pair["reading"] == "differs"]
        for subject in (one["subject"], *(pair.get("subject", "") for pair in contrasts)):
            if subject:
                found.setdefault(subject.rpartition(" (")[0], set()).add(one["task"])
    return {spec: frozenset(tasks) for spec, tasks in found.items()}


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
            manifest, said = {}, {}
        why = _why_left_out(manifest, reference)
        if why:
            left_out[name] = why
        else:
            rows += changes(name, base=base, said=said)
    return pd.DataFrame(rows, columns=list(COLUMNS)), left_out


def _why_left_out(manifest: Mapping[str, Any], reference: Mapping[str, Any]) -> str:
    """Return why a variant's run cannot be held against the base; empty if it can."""
    if manifest.get("state") != "finished":
        return "it is not finished"
    if any(manifest["identity"][key] != reference["identity"][key] for key in ("seed", "scenes")):
        return "it has another seed or number of scenes"
    if manifest["code"] != reference["code"]:
        return "it is of another version of the code"
    return ""


def counts(rows: pd.DataFrame) -> dict[str, dict[str, dict[str, int]]]:
    """Return how many items of a section changed in which way: variant, section, change."""
    found: dict[str, dict[str, dict[str, int]]] = {}
    for (variant, section), part in rows.groupby(["variant", "section"], sort=False):
        number = Counter(part["changed"])
        found.setdefault(str(variant), {})[str(section)] = {
            change: number[change] for change in CHANGES if number[change]
        }
    return found


def write(out: Path) -> tuple[pd.DataFrame, dict[str, str]]:
    """Write `sensitivity.csv`; return what `collect` does."""
    rows, left_out = collect(out)
    write_whole(out / TABLE, rows.to_csv(index=False).encode())
    return rows, left_out
