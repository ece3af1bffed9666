"""The manifest of a run: its code, settings and data, its cells, and its failures.

Within the program `cells` and `failed` are lists of records (`store.entries`), one for
each consumer at each level. In the file an entry stands for all consumers of a level
that share their files, and sets of consumers that many levels have are written once, in
`consumers`. `sizes`
has the bytes of each file of a finished run: it tells without reading them that a copy
of the folder is whole. A seal over all of it shows damage, and files of other layouts:
readers need not check every value. It does not show a forgery.
"""

from __future__ import annotations

import json
import platform
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, cast

import numpy as np

import isac_track
from attacks.tasks.returns import LEAST_S, LONGEST_S
from attacks.tasks.task_list import RETURNS
from evaluation.compute.return_columns import CLEAN
from evaluation.plan.choices import PLUS
from evaluation.plan.consumer import TRACK_KINDS
from evaluation.plan.fingerprint import digest, list_user_plugins
from evaluation.plan.settings import AXES, patrol_values, tracking_values
from evaluation.store.entries import (
    Entry,
    make_entry,
    other_entries,
    parse_entries,
    parse_failed,
)
from evaluation.store.files import (
    CELLS_FOLDER,
    MANIFEST,
    read_regular_file,
    write_whole,
)
from evaluation.store.new_files import group_units
from evaluation.store.people import (
    id_labels,
    public_path,
    public_words,
    without_folders,
)
from isac_track.errors import DataError

if TYPE_CHECKING:
    from attacks.tasks.returns import Passages
    from attacks.tasks.sessions import Sessions
    from evaluation.plan.plan import Plan, Unit
    from evaluation.plan.settings import Settings
    from evaluation.store.cell_index import FileIndex
    from isac_track.plugins import Kind
    from isac_track.types import Tracks

CELL_NAME: Final = re.compile(r"[A-Za-z0-9.=-]{1,80}_[0-9]{5}_[0-9a-f]{16}\.parquet")
# The number changes whenever a reader of another would miss or mistake a value.
LAYOUT: Final = 5
# Folders that are read as well: in layout 4 each unit of work has a file of its own.
_READABLE_LAYOUTS: Final = (LAYOUT, 4)
_LIBRARIES: Final = ("numpy", "scipy", "pandas", "pyarrow")


def read_manifest(out: Path) -> dict[str, Any]:
    """Return a run's manifest; DataError if it is missing, damaged, or of no run."""
    manifest = checked_manifest(parse_manifest(out), out=out)
    if not manifest.keys() >= {"dataset", "settings"}:
        raise DataError(f"{out} holds a run that never started; run the matrix again")
    return manifest


def write_manifest(out: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest, whole or not at all."""
    consumers: list[list[dict[str, Any]]] = []
    cells = []
    for level, entries in groupby(manifest["cells"], key=Entry.level_fields):
        level_consumers = [entry.consumer_fields() for entry in entries]
        if level_consumers not in consumers:
            consumers.append(level_consumers)
        cells.append(level | {"consumers": consumers.index(level_consumers)})
    folded = {**manifest, "cells": cells, "consumers": consumers}
    if "failed" in manifest:
        folded["failed"] = [entry.fields() for entry in manifest["failed"]]
    folded["sizes"] = _file_sizes(out, manifest)
    sealed = folded | {"seal": digest([LAYOUT, folded])}
    text = json.dumps(sealed, indent=1, ensure_ascii=False) + "\n"
    write_whole(out / MANIFEST, text.encode())


def file_names(manifest: Mapping[str, Any]) -> list[str]:
    """Return the names of the files of a manifest's cells, each once."""
    names = (name for entry in manifest["cells"] for name in entry.files)
    return list(dict.fromkeys(names))


def _file_sizes(out: Path, manifest: Mapping[str, Any]) -> dict[str, int]:
    """Return the bytes of each file of a run that is finished, by name."""
    if manifest.get("state") != "finished":
        return {}
    paths = (out / CELLS_FOLDER / name for name in file_names(manifest))
    return {path.name: path.lstat().st_size for path in paths if path.exists()}


def parse_manifest(out: Path) -> dict[str, Any]:
    """Return the content of the manifest's file; DataError if it is no manifest."""
    path = out / MANIFEST
    try:
        manifest: dict[str, Any] = json.loads(read_regular_file(path))
    except FileNotFoundError:
        raise DataError(
            f"{out} holds no run ({MANIFEST} is missing); make one with "
            "python -m evaluation.matrix --out DIR"
        ) from None
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(
            f"{path} cannot be read: {error}; choose another --out"
        ) from None
    match manifest:
        case {"identity": dict(), "cells": list()}:
            return manifest
    raise DataError(f"{path} is not the manifest of a run; choose another --out")


def checked_manifest(manifest: dict[str, Any], *, out: Path) -> dict[str, Any]:
    """Return the manifest that a file holds; DataError if it has changed."""
    content = {name: value for name, value in manifest.items() if name != "seal"}
    seals = [digest([layout, content]) for layout in _READABLE_LAYOUTS]
    is_sealed = manifest.get("seal") in seals
    # Files are deleted by these names, and a seal may be forged.
    if not is_sealed or not all(
        CELL_NAME.fullmatch(name)
        for level in content["cells"]
        for name in level["files"]
    ):
        raise DataError(
            f"{out} was written by another version, or its {MANIFEST} is damaged; "
            "run the matrix again with --fresh or another --out"
        )
    content["cells"] = parse_entries(content["cells"], content.pop("consumers"))
    if "failed" in content:
        content["failed"] = parse_failed(content["failed"])
    return content


def with_ceiling(entries: list[Entry]) -> list[Entry]:
    """Return the entries without linkage attacks that have no ceiling.

    The ceiling decides what an attack without success means; in other worlds an attack
    is compared with the optimum instead.
    """
    ceilings = {entry.address.source for entry in entries if entry.spec == CLEAN}
    return [
        entry
        for entry in entries
        if entry.kind != "linkage"
        or entry.address.world
        or entry.address.source in ceilings
    ]


def mean_speeds(recorded: Tracks, *, used: Sequence[str]) -> dict[str, float]:
    """Return the mean speed of the `used` tracks, and of all recorded tracks, m/s.

    A track's speed is the length of its recorded path over its duration. Each track
    counts once; a track of a single sample does not count. Empty without used tracks.
    """
    from isac_track.datasets import summarise  # noqa: PLC0415 - a reader needs none

    speeds = summarise(recorded)["speed_mean_mps"].to_numpy()
    is_used = np.isin(np.array(recorded.source), np.array(used))
    known = np.isfinite(speeds)
    if not (is_used & known).any():
        return {}
    return {
        "used": float(speeds[is_used & known].mean()),
        "recorded": float(speeds[known].mean()),
    }


def named_values(settings: Settings, axis: str) -> list[str] | None:
    """Return the values that a user named on an axis, as typed; None without any.

    A plug-in object is given by its SPEC.
    """
    from isac_track.plugins import resolve_plugins  # noqa: PLC0415 - a reader needs none

    if getattr(settings, axis) is None:
        return None
    choice = settings.choice(axis)
    plus = "" if choice.replaces else PLUS
    texts = []
    for value in choice.named:
        text = value
        if not isinstance(value, str):
            text = resolve_plugins(cast("Kind", axis), value)[0].spec
        texts.append(f"{plus}{text}")
    return texts


def describe_data(plan: Plan) -> dict[str, Any]:
    """Return a description of the data: its source, repairs, and tracks left out.

    It has advice if too few people are left.
    """
    from isac_track.scenes import (  # noqa: PLC0415 - as below
        FEW_PEOPLE,
        recording_advice,
    )

    tracks, dataset = plan.scene_tracks, plan.dataset
    own = ("name", "sha256", "format", "simulated")
    notice = dataset.notice and without_folders(dataset.notice, dataset)
    data = {
        "path": public_path(dataset.path),
        **{name: getattr(dataset, name) for name in own},
        "notice": notice,
        "tracks": len(dataset.tracks),
        "tracks_used": len(tracks),
        "person_s": _person_s(dataset.tracks),
        "too_short": tracks.too_short,
        "no_future": tracks.no_future,
        "speed_mps": mean_speeds(dataset.tracks, used=tracks.source),
        "repairs": [
            asdict(repair) | {"detail": without_folders(repair.detail, dataset)}
            for repair in dataset.repairs
        ],
    }
    if tracks.n_replaced:
        most_m = plan.settings.stages.resample.max_overshoot_m
        detail = (
            f"pieces where a spline leaves the chord by over {most_m:g} m or runs;"
            " straighter"
        )
        data["repairs"].append(
            {"kind": "overshoot", "count": tracks.n_replaced, "detail": detail}
        )
    if plan.passages is not None:
        data["returning"] = _describe_returning(plan.passages)
    if dataset.sessions:
        data["sessions"] = [public_path(session) for session in dataset.sessions]
    if len(tracks) < FEW_PEOPLE:
        stages, used = plan.settings.stages, len(tracks)
        data["would_help"] = recording_advice(
            dataset.tracks, settings=stages, used=used
        )
    return data


def _describe_returning(walks: Passages) -> dict[str, Any]:
    """Return the numbers of people who come back, of passages and of sessions."""
    return {
        "people": int(walks.returning.size),
        "passages": len(walks),
        "candidates": int(np.unique(walks.person).size),
        "sessions": len(walks.sessions),
        "least_s": LEAST_S,
        "longest_s": LONGEST_S,
    }


def _person_s(tracks: Tracks) -> float:
    """Return the time that all people are present for, s."""
    first, last = tracks.offsets[:-1], tracks.offsets[1:] - 1
    return float((tracks.t[last] - tracks.t[first]).sum())


def describe(plan: Plan) -> dict[str, Any]:
    """Return a description of a run: environment, code, settings, data, and tasks."""
    from isac_track.geometry import geometry  # noqa: PLC0415 - a reader needs none

    tracks, settings, axes = plan.scene_tracks, plan.settings, plan.axes
    labels = id_labels(plan)
    without_rule = {
        plugin.family
        for plugin in axes.mechanisms
        if not plugin.adding and getattr(plugin.instance, "adds_error", True)
    }
    horizons = {}
    for horizon_s in (
        settings.stages.conflict.horizons_s if axes.utility_predictors else ()
    ):
        n_used = len(tracks.further.get(horizon_s, ()))
        horizons[f"{horizon_s:g}"] = {
            "tracks_used": n_used,
            "no_future": len(tracks) - n_used,
        }
    tasks = {sessions.task.name: _describe_task(sessions) for sessions in plan.sessions}
    return {
        "environment": {
            "isac_track": isac_track.__version__,
            "python": platform.python_version(),
            "machine": f"{platform.system()} {platform.machine()}",
            "libraries": {name: version(name) for name in _LIBRARIES},
            "git_commit": _git_commit(),
            "command": public_words(
                str(word).encode(errors="replace").decode() for word in sys.argv or ()
            ),
        },
        "code": plan.code_hash,
        "settings": _describe_settings(plan),
        "own_plugins": list_user_plugins(axes),
        "granted": {
            plugin.spec: sorted(item.name for item in plugin.instance.requires)
            for plugin in axes.predictors
            if plugin.instance.requires
        },
        "without_rule": sorted(without_rule),
        "dataset": describe_data(plan),
        "geometry": asdict(
            geometry(
                plan.recorded, settings=settings.stages.sensing, seed=settings.seed
            )
        ),
        "history": _describe_history(tracks),
        "groups": [labels[name] for name in sorted(set(tracks.group))],
        "horizons": horizons,
        "linkage": {"skipped": dict(axes.skipped), "tasks": tasks},
        "no_scenes": axes.why_no_scenes,
    }


def _describe_history(tracks: Tracks) -> dict[str, float]:
    """Return the mean number of samples of a history and their mean interval, s.

    Both are 0 without tracks.
    """
    from isac_track.privacy import (  # noqa: PLC0415 - a reader needs none
        mean_interval_s,
    )

    if not len(tracks):
        return {"points": 0.0, "interval_s": 0.0}
    intervals_s = mean_interval_s(t=tracks.t, offsets=tracks.offsets)
    return {
        "points": float(np.diff(tracks.offsets).mean()),
        "interval_s": float(intervals_s.mean()),
    }


def _describe_settings(plan: Plan) -> dict[str, Any]:
    """Return the settings of a run, with the axes that they expand to."""
    settings, axes = plan.settings, plan.axes
    linkers = dict.fromkeys(link.spec for _, link in axes.links)
    named = {axis: named_values(settings, axis) for axis in AXES}
    described: dict[str, Any] = {
        "preset": settings.preset,
        "scenes": settings.n_attacked_scenes,
        "scenes_utility": settings.n_all_scenes,
        "precision": settings.precision,
        "pilot_half_width": settings.pilot_half_width,
        "seed": settings.seed,
        "mechanisms": [plugin.spec for plugin in axes.mechanisms],
        "predictors": [plugin.spec for plugin in axes.predictors],
        "attacks": [*(plugin.spec for plugin in axes.attacks), *linkers],
        "tasks": [task.name for task in axes.tasks],
        "policies": [plugin.spec for plugin in axes.policies],
        "named": {axis: values for axis, values in named.items() if values is not None},
    }
    if axes.links_returns:
        described["tasks"].append(RETURNS.name)
    if settings.confirming is not None:
        described["confirming"] = settings.confirming
    if axes.adversaries:
        described["adversaries"] = list(axes.adversaries)
    return described | {"stages": settings.stages.flat()}


def _describe_task(sessions: Sessions) -> dict[str, Any]:
    """Return the size of a linkage task: its people, probes and candidates."""
    galleries = np.bincount(sessions.gallery.search, minlength=len(sessions.searches))
    return {
        "about": sessions.task.about,
        "people": len(sessions.source),
        "too_short": sessions.too_short,
        "not_drawn": sessions.not_drawn,
        "clusters": len(set(sessions.group)),
        "in_groups": int((~sessions.alone).sum()),
        "frozen": int((~sessions.moving).sum()),
        "probes": len(sessions.probe),
        "mated": int((sessions.mate >= 0).sum()),
        "candidates": dict(zip(sessions.searches, galleries.tolist(), strict=True)),
        "learnt_from": sessions.learns.sum(axis=1).tolist(),
        "calibrated_on": sessions.calibrates.sum(axis=1).tolist(),
    }


class _CellLoss(NamedTuple):
    """The loss of rank 1 in a linkage cell; tuples compare by it first."""

    rank1_loss: float
    n_checked: int
    consumer: str
    spec: str


def candidate_losses(out: Path, entries: Iterable[Entry]) -> dict[str, Any]:
    """Return the loss of rank 1 by `linkage.candidates`, by task, as cells measured it.

    Of each task: the number of `cells` of attacks; the number of `probes` of each (the
    fewest) that were searched in full as well; over the cells the mean `loss` of rank
    1, a fraction; and the largest, `most`, with its `consumer` and its mechanism's
    `spec`. Tasks whose pairs are all scored are left out.
    """
    from evaluation.store.linkage_outcomes import (  # noqa: PLC0415 - slow to import
        read_outcomes,
    )

    losses_by_task: dict[str, list[_CellLoss]] = defaultdict(list)
    linked = [entry for entry in entries if entry.kind == "linkage"]
    outcomes = read_outcomes(out, linked, drawn=())
    for entry, outcome in zip(linked, outcomes, strict=True):
        if n_checked := outcome.numbers.get("n_checked"):
            rank1_loss = outcome.numbers["rank1_loss"]
            losses_by_task[entry.address.task].append(
                _CellLoss(rank1_loss, n_checked, entry.label, entry.spec)
            )
    summary = {}
    for task, losses in losses_by_task.items():
        largest = max(losses)
        summary[task] = {
            "cells": len(losses),
            "probes": min(loss.n_checked for loss in losses),
            "loss": float(np.mean([loss.rank1_loss for loss in losses])),
            "most": largest.rank1_loss,
            "consumer": largest.consumer,
            "spec": largest.spec,
        }
    return summary


def _git_commit() -> str | None:
    root = Path(isac_track.__file__).parent.parent
    git = shutil.which("git")
    if git is None or not (root / ".git").exists():
        return None
    command = [git, "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40"]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 - fixed
    return answer.stdout.strip() or None


def cell_entries(
    plan: Plan, places: Mapping[tuple[str, str], str], missing: Iterable[Unit]
) -> list[Entry]:
    """Return the entries of a run's cells, whose files are in `places` or to come."""
    files_by_cell = {
        (unit.key, key): file.name
        for file in group_units(missing)
        for unit in file.units
        for key in unit.consumers
    } | {**places}
    files: dict[tuple[str, str], list[str]] = defaultdict(list)
    for unit in plan.units:  # block by block
        for key, consumer in unit.consumers.items():
            files[unit.mechanism.spec, consumer.label].append(
                files_by_cell[unit.key, key]
            )
    return [
        make_entry(mechanism, consumer, files=files[mechanism.spec, consumer.label])
        for mechanism, consumer in plan.mechanism_consumers
    ]


def without_other_patrols(manifest: Mapping[str, Any], plan: Plan) -> list[Entry]:
    """Return the entries of a manifest, without patrols of other settings than a plan's.

    So are tracks. Their files stay: with the earlier settings a run finds them again.
    """
    earlier = manifest.get("settings", {}).get("stages", {})
    ours = plan.settings.stages.flat()
    is_same = patrol_values(earlier) == patrol_values(ours)
    same_tracks = is_same and tracking_values(earlier) == tracking_values(ours)
    return [
        entry
        for entry in manifest["cells"]
        if not entry.address.policy
        or (same_tracks if entry.kind in TRACK_KINDS else is_same)
    ]


def merged_plugins(
    earlier: Mapping[str, Sequence[str]], ours: Mapping[str, Sequence[str]]
) -> dict[str, list[str]]:
    """Return a user's own plug-ins by axis: earlier, whose cells stay, and new."""
    return {
        axis: [*dict.fromkeys([*earlier.get(axis, ()), *ours.get(axis, ())])]
        for axis in dict.fromkeys([*earlier, *ours])
    }


def merged_cells(
    earlier: Iterable[Entry], entries: list[Entry], *, held: Mapping[str, FileIndex]
) -> list[Entry]:
    """Return the entries of this run's cells, and of finished cells of earlier axes.

    An earlier level that was never finished (interrupted, or a plug-in that failed) is
    left out. `held` has the index of every file that is there.
    """
    finished = [
        entry
        for entry in earlier
        if all(
            name in held and held[name].holds(entry.spec, entry.label)
            for name in entry.files
        )
    ]
    return with_ceiling(entries + other_entries(finished, than=entries))
