"""Settings of two runs: those that differ, and how numbers of both are paired."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from evaluation.plan.address import Address, parse_consumer

Manifest = Mapping[str, Any]
Apart = dict[str, tuple[Any, Any]]
"""Values in run A and in run B, by name."""
DRAWS, PEOPLE, NONE = "people and draws", "people", "none"  # Pairing of a row.
_ABOUT_DATA = frozenset(
    {"dataset", "sha256", "format", "fps", "unit", "tracks", "tracks_used"}
)
_ABOUT_CODE = ("code version", "isac_track", "git_commit", "python", "machine")
_DECIDED = ("conflict.decision", "conflict.probability_threshold")
# A setting of `_KEEP_DRAWS` changes no random number, but for `_CHANGE_DRAWS`.
_KEEP_DRAWS = ("dataset", "privacy.", "sensing.", *_DECIDED)
_CHANGE_DRAWS = ("sensing.n_paths", "sensing.law")
# Settings that only linkage has, and that only scenes have.
_LINKAGE_ALONE, _SCENES_ALONE = ("linkage.", "crowd"), ("scenes", "conflict.")
# Settings of patrols and tracks, which a run may change without a new folder.
_WALK_SETTINGS = ("patrol.", "tracking.")
# What people and blocks of patrols and tracks depend on.
_CHANGE_WALKS = ("sha256", "resample.", *_WALK_SETTINGS)


def pairing(
    first: Manifest, second: Manifest, *, consumer: str, policy: str = ""
) -> str:
    """Return how a consumer's numbers in two runs are paired.

    Replicates of linkage were drawn with the cell: the same people cannot be drawn
    again later. Those of patrols and tracks draw people or blocks of a recording by
    their number, which settings of either may change.
    """
    moved = _unequal(*(_all_settings(run) for run in (first, second)))
    task = parse_consumer(consumer).task
    is_apart = "sha256" in moved
    without_effect = _LINKAGE_ALONE
    if policy:
        is_apart = any(name.startswith(_CHANGE_WALKS) for name in moved)
    else:
        moved = {
            name: ends
            for name, ends in moved.items()
            if not name.startswith(_WALK_SETTINGS)
        }
    if task:
        people_a, people_b = (
            run["linkage"]["tasks"].get(task) for run in (first, second)
        )
        same_people = people_a is not None and people_a == people_b
        redraws = ("sha256", "seed", *_LINKAGE_ALONE)
        has_others = any(name.startswith(redraws) for name in moved)
        is_apart = has_others or not same_people or first["groups"] != second["groups"]
        without_effect = _SCENES_ALONE
    if is_apart:
        return NONE
    # Whether the same people's random numbers are the same, too.
    keep = (*_KEEP_DRAWS, *without_effect)
    other = any(
        name.startswith(_CHANGE_DRAWS) or not name.startswith(keep) for name in moved
    )
    return PEOPLE if other else DRAWS


def _all_settings(manifest: Manifest) -> dict[str, Any]:
    """Return the identity of a run, and the settings of its patrols and tracks."""
    if not any(entry.address.policy for entry in manifest["cells"]):
        return dict(manifest["identity"])
    walks = {
        name: value
        for name, value in manifest["settings"].get("stages", {}).items()
        if name.startswith(_WALK_SETTINGS)
    }
    return {**manifest["identity"], **walks}


def _unequal(a: Manifest, b: Manifest) -> Apart:
    values = {name: (a.get(name), b.get(name)) for name in (*a, *b)}
    return {name: pair for name, pair in values.items() if pair[0] != pair[1]}


def about(out: Path, manifest: Manifest) -> dict[str, Any]:
    """Return the folder, data set, size, seed and preset of a run."""
    wanted = ("scenes", "scenes_utility", "seed")
    identity = manifest["identity"]
    return {
        "out": str(out),
        "dataset": manifest["dataset"]["name"],
        "people": len(manifest["groups"]),
        **{name: value for name, value in identity.items() if name in wanted},
        "preset": manifest["settings"]["preset"],
    }


def changed(first: Manifest, second: Manifest) -> dict[str, Apart]:
    """Return the values that differ under data, settings and code."""
    described, code = [], []
    for run in (first, second):
        tracks = {name: run["dataset"][name] for name in ("tracks", "tracks_used")}
        preset = {"preset": run["settings"]["preset"]}
        described.append(_all_settings(run) | tracks | preset)
        environment = {"code version": run["code"], **run["environment"]}
        versions = {name: environment[name] for name in _ABOUT_CODE}
        code.append(versions | environment["libraries"])
    settings = _unequal(*described)
    data = {name: settings.pop(name) for name in [*settings] if name in _ABOUT_DATA}
    return {"data": data, "settings": settings, "code": _unequal(*code)}


def only_in(first: Manifest, second: Manifest) -> Apart:
    """Return by axis the names that only the first run has, and only the second."""
    a, b = _axes(first), _axes(second)
    apart = {
        axis: (names_beside(a[axis], b[axis]), names_beside(b[axis], a[axis]))
        for axis in a
    }
    return {axis: names for axis, names in apart.items() if any(names)}


def names_beside(names: Iterable[str], others: Iterable[str]) -> list[str]:
    """Return the names that others lack, each once."""
    return [name for name in dict.fromkeys(names) if name not in others]


def _axes(manifest: Manifest) -> dict[str, list[str]]:
    """Return the names on each axis of a run, in the order of its cells."""
    cells = manifest["cells"]

    def consumers(*kinds: str) -> list[Address]:
        return [cell.address for kind in kinds for cell in cells if cell.kind == kind]

    return {
        "mechanisms": [cell.spec for cell in cells],
        "predictors": [robot.consumer for robot in consumers("predictor")],
        "attacks": [attack.attack_spec for attack in consumers("attack", "linkage")],
        "tasks": [reader.task for reader in consumers("linkage", "control")],
    }
