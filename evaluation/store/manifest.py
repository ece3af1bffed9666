"""The manifest of a run: what it was made from, its cells, and what failed.

Within the program `cells` is a list of flat entries, one for each consumer at each
level. In the file an entry stands for all consumers of a level that share their files,
and sets of consumers that many levels have are written once, in `consumers`. A seal
over all of it tells whether the file is as a run of this layout wrote it: its readers
need not look at every value.
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
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

import isac_track
from evaluation.plan.choices import PLUS
from evaluation.plan.fingerprint import digest, strangers_in
from evaluation.plan.settings import AXES
from evaluation.store.files import MANIFEST, content_of, label_of, write_whole
from evaluation.store.people import (
    labels_of_ids,
    shown_path,
    shown_words,
    without_folders,
)
from isac_track.errors import DataError

if TYPE_CHECKING:
    from evaluation.plan.axes import Consumer
    from evaluation.plan.plan import Plan, Unit
    from evaluation.plan.settings import Settings
    from evaluation.store.cell_files import Index
    from isac_track.plugins import Kind, Plugin
    from isac_track.types import Tracks

CELL_NAME: Final = re.compile(r"[A-Za-z0-9.=-]{1,80}_[0-9]{5}_[0-9a-f]{16}\.parquet")
LAYOUT: Final = 4  # Another one wherever readers would miss or mistake a value.
FAILED_COLUMNS: Final = ("spec", "kind", "consumer", "knowledge", "block", "why")
_OF_LEVEL: Final = (
    "mechanism",
    "level",
    "family",
    "adding",
    "protects",
    "spec",
    "files",
)
_OF_CONSUMER: Final = ("kind", "consumer", "knowledge", "slow", "world")
_LIBRARIES: Final = ("numpy", "scipy", "pandas", "pyarrow")


def read_manifest(out: Path) -> dict[str, Any]:
    """Return a run's manifest; DataError if none is there, it is damaged, or no run started."""
    manifest = undamaged(parsed(out), out=out)
    if not manifest.keys() >= {"dataset", "settings"}:
        raise DataError(f"{out} holds a run that never started; run the matrix again")
    return manifest


def write_manifest(out: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest, whole or not at all."""
    consumers: list[list[dict[str, Any]]] = []
    cells = []
    for level, entries in groupby(
        manifest["cells"], key=lambda entry: {name: entry[name] for name in _OF_LEVEL}
    ):
        alike = [{name: entry.get(name) for name in _OF_CONSUMER} for entry in entries]
        if alike not in consumers:
            consumers.append(alike)
        cells.append(level | {"consumers": consumers.index(alike)})
    folded = {**manifest, "cells": cells, "consumers": consumers}
    sealed = folded | {"seal": digest([LAYOUT, folded])}
    text = json.dumps(sealed, indent=1, ensure_ascii=False) + "\n"
    write_whole(out / MANIFEST, text.encode())


def parsed(out: Path) -> dict[str, Any]:
    """Return what the manifest's file holds, if it is one at all; DataError if not."""
    path = out / MANIFEST
    try:
        manifest: dict[str, Any] = json.loads(content_of(path))
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


def undamaged(found: dict[str, Any], *, out: Path) -> dict[str, Any]:
    """Return the manifest that a file holds; DataError if it is not as it was written."""
    content = {name: value for name, value in found.items() if name != "seal"}
    is_sealed = found.get("seal") == digest([LAYOUT, content])
    # Files are deleted by these names: a seal is no proof of who wrote it.
    if not is_sealed or not all(
        CELL_NAME.fullmatch(name)
        for level in content["cells"]
        for name in level["files"]
    ):
        raise DataError(
            f"{out} was written by another version, or its {MANIFEST} is damaged; "
            "run the matrix again with --fresh or another --out"
        )
    consumers = content.pop("consumers")
    content["cells"] = [
        {name: value for name, value in level.items() if name != "consumers"} | consumer
        for level in content["cells"]
        for consumer in consumers[level["consumers"]]
    ]
    return content


def others(
    entries: Iterable[dict[str, Any]], *, than: Iterable[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Return the entries of other consumers at other levels."""
    known = {(entry["spec"], label_of(entry)) for entry in than}
    return [entry for entry in entries if (entry["spec"], label_of(entry)) not in known]


def with_ceiling(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the index without what is linked without a ceiling.

    What an attack says when it finds nothing depends on it; in other worlds it is held
    against the optimum instead.
    """
    whose = itemgetter("consumer", "knowledge")
    ceilings = {whose(entry) for entry in entries if entry["spec"] == "clean"}
    return [
        entry
        for entry in entries
        if entry["kind"] != "linkage" or entry.get("world") or whose(entry) in ceilings
    ]


def mean_speeds(recorded: Tracks, *, used: Sequence[str]) -> dict[str, float]:
    """Return the mean speed of the tracks that are `used` and of all recorded ones, m/s.

    A track's speed is the length of its recorded path over its duration; each counts
    once, one of a single sample not at all.
    """
    from isac_track.datasets import summarise  # noqa: PLC0415 - a reader needs none

    speeds = summarise(recorded)["speed_mean_mps"].to_numpy()
    is_used = np.isin(np.array(recorded.source), np.array(used))
    known = np.isfinite(speeds)
    return {
        "used": float(speeds[is_used & known].mean()),
        "recorded": float(speeds[known].mean()),
    }


def given_on(settings: Settings, axis: str) -> list[str] | None:
    """Return the values that a user named on an axis, as they are typed; None without any.

    An object of a plug-in is typed as its SPEC.
    """
    from isac_track.plugins import plugins_of  # noqa: PLC0415 - a reader needs none

    if getattr(settings, axis) is None:
        return None
    choice = settings.choice(axis)
    plus = "" if choice.replaces else PLUS
    texts = [
        (
            value
            if isinstance(value, str)
            else plugins_of(cast("Kind", axis), value)[0].spec
        )
        for value in choice.named
    ]
    return [f"{plus}{text}" for text in texts]


def about_data(ready: Plan) -> dict[str, Any]:
    """Return what was read, mended and left out, and what would help if too little is left."""
    from isac_track.scenes import (  # noqa: PLC0415 - as below
        FEW_PEOPLE,
        what_would_help,
    )

    tracks, dataset = ready.tracks, ready.dataset
    own = ("name", "sha256", "format", "simulated")
    notice = dataset.notice and without_folders(dataset.notice, dataset)
    about = {
        "path": shown_path(dataset.path),
        **{name: getattr(dataset, name) for name in own},
        "notice": notice,
        "tracks": len(dataset.tracks),
        "tracks_used": len(tracks),
        "too_short": tracks.too_short,
        "no_future": tracks.no_future,
        "speed_mps": mean_speeds(dataset.tracks, used=tracks.source),
        "repairs": [
            asdict(repair) | {"detail": without_folders(repair.detail, dataset)}
            for repair in dataset.repairs
        ],
    }
    if tracks.n_replaced:
        most_m = ready.settings.stages.resample.max_overshoot_m
        detail = (
            f"pieces where a spline leaves the chord by over {most_m:g} m or runs;"
            " straighter"
        )
        about["repairs"].append(
            {"kind": "overshoot", "count": tracks.n_replaced, "detail": detail}
        )
    if dataset.sessions:
        about["sessions"] = [shown_path(one) for one in dataset.sessions]
    if len(tracks) < FEW_PEOPLE:
        stages, used = ready.settings.stages, len(tracks)
        about["would_help"] = what_would_help(
            dataset.tracks, settings=stages, used=used
        )
    return about


def describe(ready: Plan) -> dict[str, Any]:
    """Return what a run is made from: code, settings, data set, what is linked."""
    from isac_track.geometry import geometry  # noqa: PLC0415 - a reader needs none
    from isac_track.privacy import (  # noqa: PLC0415 - a reader needs none
        mean_interval_s,
    )

    tracks, settings, axes = ready.tracks, ready.settings, ready.axes
    labels = labels_of_ids(ready)
    linkers = dict.fromkeys(link.spec for _, link in axes.links)
    requires = {plugin.spec: plugin.instance.requires for plugin in axes.predictors}
    undeclared = (plugin for plugin in axes.mechanisms if not plugin.adding)
    without_rule = {
        one.family for one in undeclared if getattr(one.instance, "adds_error", True)
    }
    tasks = {}
    for sessions in ready.sessions:
        galleries = np.bincount(
            sessions.gallery.search, minlength=len(sessions.searches)
        )
        tasks[sessions.task.name] = {
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
    return {
        "environment": {
            "isac_track": isac_track.__version__,
            "python": platform.python_version(),
            "machine": f"{platform.system()} {platform.machine()}",
            "libraries": {name: version(name) for name in _LIBRARIES},
            "git_commit": _git_commit(),
            "command": shown_words(
                str(word).encode(errors="replace").decode() for word in sys.argv or ()
            ),
        },
        "code": ready.code,
        "settings": {
            "preset": settings.preset,
            "scenes": settings.n_scenes,
            "scenes_utility": settings.n_utility_scenes,
            "precision": settings.precision,
            "pilot_half_width": settings.pilot_half_width,
            "seed": settings.seed,
            "mechanisms": [plugin.spec for plugin in axes.mechanisms],
            "predictors": [plugin.spec for plugin in axes.predictors],
            "attacks": [*(plugin.spec for plugin in axes.attacks), *linkers],
            "tasks": [task.name for task in axes.tasks],
            "named": {
                axis: given
                for axis in AXES
                if (given := given_on(settings, axis)) is not None
            },
            **({"adversaries": list(axes.adversaries)} if axes.adversaries else {}),
            "stages": settings.stages.flat(),
        },
        "own_plugins": strangers_in(axes),
        "granted": {
            name: sorted(one.name for one in of) for name, of in requires.items() if of
        },
        "without_rule": sorted(without_rule),
        "dataset": about_data(ready),
        "geometry": asdict(
            geometry(
                ready.recorded, settings=settings.stages.sensing, seed=settings.seed
            )
        ),
        "history": {
            "points": float(np.diff(tracks.offsets).mean()),
            "interval_s": float(
                mean_interval_s(t=tracks.t, offsets=tracks.offsets).mean()
            ),
        },
        "groups": [labels[name] for name in sorted(set(tracks.group))],
        "horizons": {
            f"{horizon_s:g}": {
                "tracks_used": len(tracks.further.get(horizon_s, ())),
                "no_future": len(tracks) - len(tracks.further.get(horizon_s, ())),
            }
            for horizon_s in (
                settings.stages.conflict.horizons_s if axes.utility else ()
            )
        },
        "linkage": {"skipped": dict(axes.skipped), "tasks": tasks},
    }


def losses_of(out: Path, entries: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """Return what rank 1 loses by `linkage.candidates`, by task, as the cells measured it.

    Of each task the `cells` of attacks; how many `probes` of each (the fewest) were
    searched in full as well; over the cells the mean `loss` of rank 1, a fraction, and
    the `most`, of which `consumer` at which mechanism, `spec`, it was. A task whose
    pairs are all scored is not there.
    """
    from evaluation.store.cell_files import (  # noqa: PLC0415 - slow to import
        read_outcomes,
    )

    found: dict[str, list[tuple[float, int, str, str]]] = defaultdict(list)
    linked = [entry for entry in entries if entry["kind"] == "linkage"]
    for entry, outcome in zip(
        linked, read_outcomes(out, linked, drawn=()), strict=True
    ):
        if n_checked := outcome.numbers.get("n_checked"):
            cell = (
                outcome.numbers["rank1_loss"],
                n_checked,
                label_of(entry),
                entry["spec"],
            )
            found[entry["consumer"].partition("/")[0]].append(cell)
    losses = {}
    for task, cells in found.items():
        most, _, consumer, spec = max(cells)
        losses[task] = {
            "cells": len(cells),
            "probes": min(one[1] for one in cells),
            "loss": float(np.mean([one[0] for one in cells])),
            "most": most,
            "consumer": consumer,
            "spec": spec,
        }
    return losses


def _git_commit() -> str | None:
    root = Path(isac_track.__file__).parent.parent
    git = shutil.which("git")
    if git is None or not (root / ".git").exists():
        return None
    command = [git, "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40"]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 - fixed
    return answer.stdout.strip() or None


def named(mechanism: Plugin, consumer: Consumer) -> dict[str, str]:
    """Return what an entry, or one of what failed, calls a mechanism and a consumer."""
    about = {name: getattr(consumer, name) for name in ("kind", "knowledge", "world")}
    return {"spec": mechanism.spec, "consumer": consumer.spec, **about}


def entries_of(
    ready: Plan, places: Mapping[tuple[str, str], str], missing: Iterable[Unit]
) -> list[dict[str, Any]]:
    """Return the entries of a run's cells, whose files are in `places` or to come."""
    of_cell = {(one.key, key): one.file for one in missing for key in one.consumers} | {
        **places
    }
    files: dict[tuple[str, str], list[str]] = defaultdict(list)
    for unit in ready.units:  # block by block
        for key, consumer in unit.consumers.items():
            files[unit.mechanism.spec, consumer.label].append(of_cell[unit.key, key])
    return [
        {
            "mechanism": mechanism.name,
            **{
                name: getattr(mechanism, name)
                for name in ("level", "family", "adding", "protects")
            },
            **named(mechanism, consumer),
            "slow": consumer.is_slow,
            "files": files[mechanism.spec, consumer.label],
        }
        for mechanism, consumer in ready.pairs
    ]


def merged_plugins(
    earlier: Mapping[str, Sequence[str]], ours: Mapping[str, Sequence[str]]
) -> dict[str, list[str]]:
    """Return a user's own plug-ins by axis: those of earlier axes, whose cells stay, and of now."""
    return {
        axis: [*dict.fromkeys([*earlier.get(axis, ()), *ours.get(axis, ())])]
        for axis in dict.fromkeys([*earlier, *ours])
    }


def merged_cells(
    earlier: Iterable[dict[str, Any]],
    ours: list[dict[str, Any]],
    *,
    held: Mapping[str, Index],
) -> list[dict[str, Any]]:
    """Return the index of cells: those of this run, and finished ones of earlier axes.

    An earlier level that was never finished (interrupted, or a plug-in that failed) is
    left out: `held` has what the files hold that are there.
    """
    finished = [
        entry
        for entry in earlier
        if all(
            name in held and label_of(entry) in held[name].consumers
            for name in entry["files"]
        )
    ]
    return with_ceiling(ours + others(finished, than=ours))
