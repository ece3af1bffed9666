"""What changed between two runs, and what they have in common: by their manifests."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from evaluation.runs.manifest import read_manifest
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

DRAWS, PEOPLE, NONE = "people and draws", "people", "none"
"""Pairing of a row."""
_NEEDED = {"groups": list, "dataset": dict, "settings": dict, "environment": dict}
_MOST_NAMED = 4
_ABOUT_DATA = frozenset({"dataset", "sha256", "format", "fps", "tracks", "tracks_used"})
_KEEP_DRAWS = (
    "dataset",
    "privacy.",
    "sensing.",
    "conflict.decision",
    "conflict.probability_threshold",
)
_CHANGE_DRAWS = ("sensing.n_paths", "sensing.law")


def manifest_of(out: Path) -> dict[str, Any]:
    """Return the manifest of a run.

    Raises
    ------
    DataError
        If the folder holds no run, or one of another version.
    """
    manifest = read_manifest(out)
    whole = all(isinstance(manifest.get(name), kind) for name, kind in _NEEDED.items())
    if not whole or not {"sha256", "seed", "scenes"} <= manifest["identity"].keys():
        raise DataError(f"{out} was written by another version; run the matrix again with --fresh")
    return manifest


def short_list(names: Sequence[str]) -> str:
    """Return the first few names, and how many more there are."""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return ", ".join(names[:_MOST_NAMED]) + more


def pairing(first: Mapping[str, Any], second: Mapping[str, Any], *, consumer: str) -> str:
    """Return how a consumer's numbers in two runs are paired.

    Replicates of a linkage task (`TASK/ATTACK`) were drawn with the cell: nobody can draw the same
    people later.
    """
    moved = _moved(first, second)
    task, is_linked, _ = consumer.partition("/")
    if not is_linked:
        return NONE if "sha256" in moved else _draws(moved, aside=("linkage.", "crowd"))
    known = [one.get("linkage", {}).get("tasks", {}).get(task) for one in (first, second)]
    drawn_apart = {"sha256", "seed", "crowd"} & moved.keys() or any(
        name.startswith("linkage.") for name in moved
    )
    same_people = known[0] is not None and known[0] == known[1]
    if drawn_apart or not same_people or first["groups"] != second["groups"]:
        return NONE
    return _draws(moved, aside=("scenes", "conflict."))


def _draws(moved: Iterable[str], *, aside: tuple[str, ...]) -> str:
    """Return whether the same people's random numbers are the same, too."""
    keep = (*_KEEP_DRAWS, *aside)
    other = any(name.startswith(_CHANGE_DRAWS) or not name.startswith(keep) for name in moved)
    return PEOPLE if other else DRAWS


def _moved(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    return _unequal(first["identity"], second["identity"])


def _unequal(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    return {
        name: (a.get(name), b.get(name))
        for name in dict.fromkeys((*a, *b))
        if a.get(name) != b.get(name)
    }


def about(out: Path, manifest: Mapping[str, Any], *, mechanism: str | None) -> dict[str, Any]:
    """Return what a run is, with the mechanism if one was named."""
    found = {
        "out": str(out),
        "dataset": manifest["dataset"].get("name"),
        "people": len(manifest["groups"]),
        "scenes": manifest["identity"]["scenes"],
        "seed": manifest["identity"]["seed"],
        "preset": manifest["settings"].get("preset"),
    }
    return found if mechanism is None else found | {"mechanism": mechanism}


def changed(
    first: Mapping[str, Any], second: Mapping[str, Any]
) -> dict[str, dict[str, tuple[Any, Any]]]:
    """Return what differs under data, settings and code."""
    moved = _unequal(*map(_described, (first, second)))
    return {
        "data": {name: both for name, both in moved.items() if name in _ABOUT_DATA},
        "settings": {name: both for name, both in moved.items() if name not in _ABOUT_DATA},
        "code": _unequal(*map(_code, (first, second))),
    }


def _described(manifest: Mapping[str, Any]) -> dict[str, Any]:
    dataset = manifest["dataset"]
    tracks = {name: dataset.get(name) for name in ("tracks", "tracks_used")}
    return {**manifest["identity"], **tracks, "preset": manifest["settings"].get("preset")}


def _code(manifest: Mapping[str, Any]) -> dict[str, Any]:
    environment = manifest["environment"]
    names = ("isac_track", "git_commit", "python", "machine")
    return {
        "code version": manifest.get("code"),
        **{name: environment.get(name) for name in names},
        **environment.get("libraries", {}),
    }


def only_in(
    first: Mapping[str, Any], second: Mapping[str, Any]
) -> dict[str, tuple[list[str], list[str]]]:
    """Return by axis what only one of the runs has."""
    a, b = _axes(first), _axes(second)
    apart = {
        axis: (
            [name for name in a[axis] if name not in b[axis]],
            [name for name in b[axis] if name not in a[axis]],
        )
        for axis in a
    }
    return {axis: both for axis, both in apart.items() if any(both)}


def _axes(manifest: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return what a run has cells of, each once, in its order."""
    consumers: dict[str, list[str]] = {}
    for entry in manifest["cells"]:
        consumers.setdefault(entry["kind"], []).append(entry["consumer"])
    linked = consumers.get("linkage", [])
    axes = {
        "mechanisms": [entry["spec"] for entry in manifest["cells"]],
        "predictors": consumers.get("predictor", []),
        "attacks": [
            *consumers.get("attack", []),
            *(consumer.partition("/")[2] for consumer in linked),
        ],
        "tasks": [
            consumer.partition("/")[0] for consumer in [*linked, *consumers.get("control", [])]
        ],
    }
    return {axis: list(dict.fromkeys(names)) for axis, names in axes.items()}


def mechanisms(manifest: Mapping[str, Any]) -> list[str]:
    """Return the names of a run's mechanisms, in its order."""
    return list(dict.fromkeys(entry["mechanism"] for entry in manifest["cells"]))


def verdicts(out_a: Path, out_b: Path) -> dict[str, Any] | None:
    """Return the decisions that changed; None unless both runs have a verdict."""
    paths = [out / "verdict.json" for out in (out_a, out_b)]
    if not all(path.is_file() for path in paths):
        return None
    a, b = (_decisions(path) for path in paths)
    both = [name for name in a if name in b]
    return {
        "in_both": len(both),
        "only_a": [name for name in a if name not in b],
        "only_b": [name for name in b if name not in a],
        "changed": [
            {"id": name, "a": a[name], "b": b[name]} for name in both if a[name] != b[name]
        ],
    }


def _decisions(path: Path) -> dict[str, str]:
    try:
        items = json.loads(path.read_text(encoding="utf-8"))["items"]
        return {item["id"]: item["decision"] for item in items}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(
            f"{path} cannot be read ({type(error).__name__}: {error}); "
            "write it again with python -m evaluation.report"
        ) from None
