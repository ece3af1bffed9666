"""Changes of a verdict's items under other assumptions: `sensitivity.csv`."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote_plus, unquote_plus

import pandas as pd

from evaluation.plan.address import parse_label
from evaluation.plan.variants import BASE, usual_variants
from evaluation.store.manifest import read_manifest
from evaluation.store.verdict_file import load_verdict
from isac_track.errors import DataError

VARIANTS_FOLDER: Final = "sensitivity"
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
# Entries of the identity that must be equal; an entry may be missing in both.
_SAME: Final = ("seed", "scenes", "scenes_utility")
_OWN_COLUMNS: Final = ("decision", "effect", "ci_low", "ci_high", "n", "sign")
"""Columns of the variant's own item; unknown without an item."""


def attack_tasks(items: Iterable[Mapping[str, Any]]) -> dict[str, frozenset[str]]:
    """Return the attacks that a verdict is about, by SPEC, each with its tasks.

    Those are the subjects of its items, and of the contrasts in which a mechanism
    differs from fixed noise. A reconstruction has the task "". `items` are as in
    `verdict.json`.
    """
    tasks: defaultdict[str, set[str]] = defaultdict(set)
    for item in items:
        subjects = [
            item["subject"],
            *item.get("scored", ()),
            *(
                contrast.get("subject")
                for contrast in item.get("contrasts", ())
                if contrast["reading"] == "differs"
            ),
        ]
        for subject in filter(None, subjects):
            tasks[parse_label(subject).consumer].add(item["task"])
    return {spec: frozenset(names) for spec, names in tasks.items()}


def changes(
    variant: str, *, base: Mapping[str, Any], varied: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Return a row of `sensitivity.csv` for every item of the base.

    `base` and `varied` are verdicts: of the base, and of the variant.
    """
    varied_items = {item["id"]: item for item in varied["items"]}
    rows = []
    for item in base["items"]:
        other = varied_items.get(item["id"])
        before, after = item["sign"], other["sign"] if other else None
        if before == 0:
            changed = {0: NEITHER, None: MISSING}.get(after, GAINED)
        else:
            changed = {0: LOST, before: SAME, None: MISSING}.get(after, TURNED)
        own = other or dict.fromkeys(_OWN_COLUMNS)
        rows.append(
            {
                **{name: item[name] for name in COLUMNS if name in item},
                **{name: own[name] for name in _OWN_COLUMNS},
                "decision_base": item["decision"],
                "effect_base": item["effect"],
                "sign_base": item["sign"],
                "subject": (other or item)["subject"],
                "variant": variant,
                "changed": changed,
            }
        )
    return rows


def variant_folder(out: Path, name: str) -> Path:
    """Return the folder of a variant's run."""
    return out / VARIANTS_FOLDER / quote_plus(name, safe="=")


def read_verdict(out: Path) -> dict[str, Any]:
    """Return the verdict of a run folder; DataError if missing or without items."""
    verdict = load_verdict(out)
    if not verdict["items"]:
        raise DataError(
            f"the verdict of {out} has no items: nothing was compared, nothing can"
            " change"
        )
    return verdict


def collect(out: Path) -> tuple[pd.DataFrame, dict[str, str]]:
    """Return all finished variants of a run as a table, and the others with the reason.

    The base is compared with the verdict of OUT, every other variant with the base.
    DataError if the run or the base has no verdict.
    """
    base = read_verdict(variant_folder(out, BASE))
    reference = read_manifest(variant_folder(out, BASE))
    order = {variant.name: place for place, variant in enumerate(usual_variants())}
    names = {
        unquote_plus(folder.name)
        for folder in (out / VARIANTS_FOLDER).iterdir()
        if folder.is_dir()
    } - {BASE}
    rows = changes(BASE, base=read_verdict(out), varied=base)
    left_out = {}
    for name in sorted(names, key=lambda name: (order.get(name, len(order)), name)):
        folder = variant_folder(out, name)
        try:
            manifest, verdict = read_manifest(folder), read_verdict(folder)
        except DataError:
            manifest, verdict = {}, {}
        identity = manifest.get("identity", {})
        is_same = all(
            identity.get(entry) == reference["identity"].get(entry) for entry in _SAME
        )
        if manifest.get("state") != "finished":
            left_out[name] = "it is not finished"
        elif not is_same:
            left_out[name] = "it has another seed or number of scenes"
        elif manifest["code"] != reference["code"]:
            left_out[name] = "it is of another version of the code"
        else:
            rows += changes(name, base=base, varied=verdict)
    return pd.DataFrame(rows, columns=list(COLUMNS)), left_out


def counts(rows: pd.DataFrame) -> dict[str, dict[str, dict[str, int]]]:
    """Return the number of items with each change, by variant and section."""
    by_variant: dict[str, dict[str, dict[str, int]]] = {}
    sections = rows.groupby(["variant", "section"], sort=False)["changed"]
    for (variant, section), changed in sections:
        n_items = changed.value_counts()
        by_variant.setdefault(str(variant), {})[str(section)] = {
            change: int(n_items[change]) for change in CHANGES if change in n_items
        }
    return by_variant
