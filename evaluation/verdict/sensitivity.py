"""What becomes of a verdict's items under other assumptions: the rows of `sensitivity.csv`."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote_plus, unquote_plus

import pandas as pd

from evaluation.estimates.differences import verdict_of
from evaluation.plan.variants import BASE, variants
from evaluation.store.manifest import read_manifest
from isac_track.errors import DataError

FOLDER: Final = "sensitivity"
TABLE: Final = "sensitivity.csv"
SAME, NEITHER, TURNED = "same", "not decided before and after", "changed sign"
LOST, GAINED, MISSING = "lost", "gained", "missing"
CHANGES: Final = (SAME, NEITHER, TURNED, LOST, GAINED, MISSING)
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
_SAME: Final = (
    "seed",
    "scenes",
    "scenes_utility",
)  # Of identity; what is not there is the same.
_THEIRS: Final = ("decision", "effect", "ci_low", "ci_high", "n", "sign")
"""Columns of the variant's own item; unknown without one."""


def attacks_of(items: Iterable[Mapping[str, Any]]) -> dict[str, frozenset[str]]:
    """Return the SPECs of the attacks that a verdict is about, each with its tasks.

    Those are the subjects of its items, and of the contrasts in which a mechanism
    differs from fixed noise. A reconstruction has the task "". `items` are as in
    `verdict.json`.
    """
    found: defaultdict[str, set[str]] = defaultdict(set)
    for one in items:
        apart = [
            pair for pair in one.get("contrasts", ()) if pair["reading"] == "differs"
        ]
        others = (*one.get("scored", ()), *(pair.get("subject") for pair in apart))
        for subject in filter(None, (one["subject"], *others)):
            found[subject.rpartition(" (")[0]].add(one["task"])
    return {spec: frozenset(tasks) for spec, tasks in found.items()}


def changes(
    variant: str, *, base: Mapping[str, Any], said: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Return a row of `sensitivity.csv` for every item of the base; both are verdicts."""
    found = {one["id"]: one for one in said["items"]}
    rows = []
    for one in base["items"]:
        other = found.get(one["id"])
        before, after = one["sign"], other["sign"] if other else None
        if before == 0:
            changed = {0: NEITHER, None: MISSING}.get(after, GAINED)
        else:
            changed = {0: LOST, before: SAME, None: MISSING}.get(after, TURNED)
        theirs = other or dict.fromkeys(_THEIRS)
        rows.append(
            {
                **{name: one[name] for name in COLUMNS if name in one},
                **{name: theirs[name] for name in _THEIRS},
                **{
                    f"{name}_base": one[name] for name in ("decision", "effect", "sign")
                },
                "subject": (other or one)["subject"],
                "variant": variant,
                "changed": changed,
            }
        )
    return rows


def folder_of(out: Path, name: str) -> Path:
    """Return the folder of a variant's run."""
    return out / FOLDER / quote_plus(name, safe="=")


def read_verdict(out: Path) -> dict[str, Any]:
    """Return the verdict of a run folder; DataError if there is none, or it has no items."""
    said = verdict_of(out)
    if not said["items"]:
        why = "nothing was compared, nothing can change"
        raise DataError(f"the verdict of {out} has no items: {why}")
    return said


def collect(out: Path) -> tuple[pd.DataFrame, dict[str, str]]:
    """Return all finished variants of a run as one table, and which ones are left out, and why.

    The base is held against the verdict of OUT, every other variant against the base.
    DataError if the run or the base has no verdict.
    """
    base = read_verdict(folder_of(out, BASE))
    reference = read_manifest(folder_of(out, BASE))
    order = {one.name: place for place, one in enumerate(variants())}
    names = {
        unquote_plus(one.name) for one in (out / FOLDER).iterdir() if one.is_dir()
    } - {BASE}
    rows, left_out = changes(BASE, base=read_verdict(out), said=base), {}
    for name in sorted(names, key=lambda one: (order.get(one, len(order)), one)):
        folder = folder_of(out, name)
        try:
            manifest, said = read_manifest(folder), read_verdict(folder)
        except DataError:
            manifest, said = {}, {}
        theirs = [manifest.get("identity", {}).get(one) for one in _SAME]
        if manifest.get("state") != "finished":
            left_out[name] = "it is not finished"
        elif theirs != [reference["identity"].get(one) for one in _SAME]:
            left_out[name] = "it has another seed or number of scenes"
        elif manifest["code"] != reference["code"]:
            left_out[name] = "it is of another version of the code"
        else:
            rows += changes(name, base=base, said=said)
    return pd.DataFrame(rows, columns=list(COLUMNS)), left_out


def counts(rows: pd.DataFrame) -> dict[str, dict[str, dict[str, int]]]:
    """Return how many items of a section changed in which way: variant, section, change."""
    found: dict[str, dict[str, dict[str, int]]] = {}
    for (variant, section), changed in rows.groupby(["variant", "section"], sort=False)[
        "changed"
    ]:
        number = changed.value_counts()
        found.setdefault(str(variant), {})[str(section)] = {
            change: int(number[change]) for change in CHANGES if change in number
        }
    return found
