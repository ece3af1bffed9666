"""What the manifest says of a run: what it was made from, and which cells it has."""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import isac_track
from evaluation.runs.cell_files import label_of
from evaluation.runs.manifest import others, with_ceiling
from isac_track.privacy import mean_interval_s

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from evaluation.experiment.plan import Plan
    from evaluation.runs.cell_files import Index
    from evaluation.runs.pieces import Missing

_LIBRARIES = ("numpy", "scipy", "pandas", "pyarrow")


def describe(ready: Plan) -> dict[str, Any]:
    """Return what a run is made from: code, settings, data set, what is linked."""
    tracks, dataset, settings, axes = ready.tracks, ready.dataset, ready.settings, ready.axes
    tasks = {}
    for sessions in ready.sessions:
        galleries = np.bincount(sessions.gallery.search, minlength=len(sessions.searches))
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
            "command": [word.encode(errors="replace").decode() for word in sys.argv],
        },
        "code": ready.code,
        "settings": {
            "preset": settings.preset,
            "scenes": settings.n_scenes,
            "seed": settings.seed,
            "mechanisms": [plugin.spec for plugin in axes.mechanisms],
            "predictors": [plugin.spec for plugin in axes.predictors],
            "attacks": [
                *(plugin.spec for plugin in axes.attacks),
                *dict.fromkeys(link.spec for _, link in axes.links),
            ],
            "tasks": [task.name for task in axes.tasks],
            "stages": settings.stages.flat(),
        },
        "granted": {
            plugin.spec: sorted(one.name for one in plugin.instance.requires)
            for plugin in axes.predictors
            if plugin.instance.requires
        },
        "without_rule": sorted(
            {
                plugin.family
                for plugin in axes.mechanisms
                if not plugin.adding and getattr(plugin.instance, "adds_error", True)
            }
        ),
        "dataset": {
            "path": str(dataset.path),
            **{
                name: getattr(dataset, name)
                for name in ("name", "sha256", "format", "simulated", "notice")
            },
            "tracks": len(dataset.tracks),
            "tracks_used": len(tracks),
            "too_short": tracks.too_short,
            "no_future": tracks.no_future,
            "repairs": [
                {"kind": repair.kind, "count": repair.count, "detail": repair.detail}
                for repair in dataset.repairs
            ],
        },
        "history": {
            "points": float(np.diff(tracks.offsets).mean()),
            "interval_s": float(mean_interval_s(t=tracks.t, offsets=tracks.offsets).mean()),
        },
        "groups": sorted(set(tracks.group)),
        "linkage": {"skipped": dict(axes.skipped), "tasks": tasks},
    }


def _git_commit() -> str | None:
    root = Path(isac_track.__file__).parent.parent
    git = shutil.which("git")
    if git is None or not (root / ".git").exists():
        return None
    answer = subprocess.run(  # noqa: S603 - a fixed command
        [git, "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40"],
        capture_output=True,
        text=True,
        check=False,
    )
    return answer.stdout.strip() or None


def entries_of(
    ready: Plan, places: dict[tuple[str, str], str], missing: Iterable[Missing]
) -> list[dict[str, Any]]:
    """Return the entries of a run's cells, whose files are in `places` or to come."""
    of_cell = {(one.unit.key, key): one.file for one in missing for key in one.consumers} | places
    files: dict[tuple[str, str], list[str]] = {}
    for unit in ready.units:  # block by block
        for key, consumer in unit.consumers.items():
            files.setdefault((unit.mechanism.spec, consumer.label), []).append(
                of_cell[unit.key, key]
            )
    return [
        {
            "mechanism": mechanism.name,
            "level": mechanism.level,
            "family": mechanism.family,
            "adding": mechanism.adding,
            "spec": mechanism.spec,
            "kind": consumer.kind,
            "consumer": consumer.spec,
            "knowledge": consumer.knowledge,
            "slow": consumer.is_slow,
            "files": files[mechanism.spec, consumer.label],
        }
        for mechanism, consumer in ready.pairs
    ]


def merged_cells(
    earlier: Iterable[dict[str, Any]], ours: list[dict[str, Any]], *, held: Mapping[str, Index]
) -> list[dict[str, Any]]:
    """Return the index of cells: those of this run, and finished ones of earlier axes.

    An earlier level that was never finished (interrupted, or a plug-in that failed) is left out:
    `held` has what the files hold that are there.
    """
    finished = [
        entry
        for entry in earlier
        if all(name in held and label_of(entry) in held[name].consumers for name in entry["files"])
    ]
    return with_ceiling(ours + others(finished, than=ours))
