"""What changed between two runs, and what they have in common: by their manifests."""

from __future__ import annotations

import json
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    Manifest = Mapping[str, Any]
    Apart = dict[str, tuple[Any, Any]]

DRAWS, PEOPLE, NONE = "people and draws", "people", "none"
"""Pairing of a row."""
_VERDICT = "verdict.json"
_MOST_NAMED = 4
_ABOUT_DATA = frozenset({"dataset", "sha256", "format", "fps", "tracks", "tracks_used"})
_ABOUT_CODE = ("code version", "isac_track", "git_commit", "python", "machine")
_KEEP_DRAWS = (
    *("dataset", "privacy.", "sensing."),
    *("conflict.decision", "conflict.probability_threshold"),
)
_CHANGE_DRAWS = ("sensing.n_paths", "sensing.law")


def short_list(names: Sequence[str]) -> str:
    """Return the first few names, and how many more there are."""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return ", ".join(names[:_MOST_NAMED]) + more


def pairing(first: Manifest, second: Manifest, *, consumer: str) -> str:
    """Return how a consumer's numbers in two runs are paired.

    Replicates of a linkage task (`TASK/ATTACK`) were drawn with the cell: nobody can draw the same
    people later.
    """
    moved = _unequal(first["identity"], second["identity"])
    task, is_linked, _ = consumer.partition("/")
    aside: tuple[str, ...] = ("linkage.", "crowd")
    is_apart = "sha256" in moved
    if is_linked:
        known = [one["linkage"]["tasks"].get(task) for one in (first, second)]
        same_people = known[0] is not None and known[0] == known[1]
        of_others = [name for name in moved if name.startswith(("sha256", "seed", *aside))]
        is_apart = bool(of_others) or not same_people or first["groups"] != second["groups"]
        aside = ("scenes", "conflict.")
    if is_apart:
        return NONE
    # Whether the same people's random numbers are the same, too.
    keep = (*_KEEP_DRAWS, *aside)
    other = any(name.startswith(_CHANGE_DRAWS) or not name.startswith(keep) for name in moved)
    return PEOPLE if other else DRAWS


def _unequal(a: Manifest, b: Manifest) -> Apart:
    return {
        name: (a.get(name), b.get(name))
        for name in dict.fromkeys((*a, *b))
        if a.get(name) != b.get(name)
    }


def about(out: Path, manifest: Manifest, *, mechanism: str | None) -> dict[str, Any]:
    """Return what a run is, with the mechanism if one was named."""
    return {
        "out": str(out),
        "dataset": manifest["dataset"]["name"],
        "people": len(manifest["groups"]),
        **{name: manifest["identity"][name] for name in ("scenes", "seed")},
        "preset": manifest["settings"]["preset"],
        **({} if mechanism is None else {"mechanism": mechanism}),
    }


def changed(first: Manifest, second: Manifest) -> dict[str, Apart]:
    """Return what differs under data, settings and code."""
    described, code = [], []
    for one in (first, second):
        tracks = {name: one["dataset"][name] for name in ("tracks", "tracks_used")}
        described.append(one["identity"] | tracks | {"preset": one["settings"]["preset"]})
        by = {"code version": one["code"], **one["environment"]}
        code.append({name: by[name] for name in _ABOUT_CODE} | by["libraries"])
    moved = _unequal(*described)
    return {
        "data": {name: both for name, both in moved.items() if name in _ABOUT_DATA},
        "settings": {name: both for name, both in moved.items() if name not in _ABOUT_DATA},
        "code": _unequal(*code),
    }


def only_in(first: Manifest, second: Manifest) -> Apart:
    """Return by axis what only the first of the runs has, and what only the second."""
    a, b = _axes(first), _axes(second)
    apart = {axis: (_beside(a[axis], b[axis]), _beside(b[axis], a[axis])) for axis in a}
    return {axis: both for axis, both in apart.items() if any(both)}


def _beside(names: Iterable[str], others: Iterable[str]) -> list[str]:
    """Return the names that the others lack, each once."""
    return [name for name in dict.fromkeys(names) if name not in others]


def _axes(manifest: Manifest) -> dict[str, list[str]]:
    """Return what a run has cells of, in its order."""
    of: dict[str, list[str]] = {"predictor": [], "attack": [], "linkage": [], "control": []}
    for cell in manifest["cells"]:
        of.setdefault(cell["kind"], []).append(cell["consumer"])
    return {
        "mechanisms": [cell["spec"] for cell in manifest["cells"]],
        "predictors": of["predictor"],
        "attacks": of["attack"] + [name.partition("/")[2] for name in of["linkage"]],
        "tasks": [name.partition("/")[0] for name in of["linkage"] + of["control"]],
    }


def verdicts(out_a: Path, out_b: Path) -> dict[str, Any] | None:
    """Return the decisions that changed; None unless both runs have a verdict."""
    if not all((out / _VERDICT).is_file() for out in (out_a, out_b)):
        return None
    a, b = (
        {item["id"]: item["decision"] for item in verdict_of(out)["items"]}
        for out in (out_a, out_b)
    )
    both = [name for name in a if name in b]
    return {
        "in_both": len(both),
        "only_a": _beside(a, b),
        "only_b": _beside(b, a),
        "changed": [{"id": one, "a": a[one], "b": b[one]} for one in both if a[one] != b[one]],
    }


def verdict_of(out: Path) -> dict[str, Any]:
    """Return the verdict of a run folder; each of its items has an id and a decision.

    Raises DataError if there is none or it cannot be read.
    """
    path, again = out / _VERDICT, f"run python -m evaluation.report {out}"
    try:
        said: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        list(map(itemgetter("id", "decision"), said["items"]))  # or it is no verdict
    except FileNotFoundError:
        raise DataError(f"{out} has no {_VERDICT}; {again} first") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path} cannot be read: {error!r}; {again} again") from None
    return said
