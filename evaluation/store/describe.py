"""The description of a run in its manifest: environment, settings, data, and tasks."""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

import isac_track
from attacks.tasks.passages import LEAST_S, LONGEST_S
from attacks.tasks.task_list import RETURNS
from evaluation.plan.choices import PLUS
from evaluation.plan.fingerprint import list_user_plugins
from evaluation.plan.settings import AXES
from evaluation.store.people import id_labels
from evaluation.store.public_text import public_path, public_words, without_folders

if TYPE_CHECKING:
    from attacks.tasks.passages import Passages
    from attacks.tasks.windows import TaskWindows
    from evaluation.plan.plan import Plan
    from evaluation.plan.settings import Settings
    from isac_track.plugins import Kind
    from isac_track.types import Tracks

_LIBRARIES: Final = ("numpy", "scipy", "pandas", "pyarrow")


def describe_run(plan: Plan) -> dict[str, Any]:
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
    tasks = {
        windows.task.name: _describe_task(windows) for windows in plan.task_windows
    }
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


def _git_commit() -> str | None:
    root = Path(isac_track.__file__).parent.parent
    git = shutil.which("git")
    if git is None or not (root / ".git").exists():
        return None
    command = [git, "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40"]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 - fixed
    return answer.stdout.strip() or None


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


def _describe_returning(passages: Passages) -> dict[str, Any]:
    """Return the numbers of people who come back, of passages and of sessions."""
    return {
        "people": int(passages.returning.size),
        "passages": len(passages),
        "candidates": int(np.unique(passages.person).size),
        "sessions": len(passages.sessions),
        "least_s": LEAST_S,
        "longest_s": LONGEST_S,
    }


def _person_s(tracks: Tracks) -> float:
    """Return the time that all people are present for, s."""
    first, last = tracks.offsets[:-1], tracks.offsets[1:] - 1
    return float((tracks.t[last] - tracks.t[first]).sum())


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


def _describe_task(windows: TaskWindows) -> dict[str, Any]:
    """Return the size of a linkage task: its people, probes and candidates."""
    galleries = np.bincount(windows.gallery.search, minlength=len(windows.search_names))
    return {
        "about": windows.task.about,
        "people": len(windows.source),
        "too_short": windows.too_short,
        "not_drawn": windows.not_drawn,
        "clusters": len(set(windows.group)),
        "in_groups": int((~windows.alone).sum()),
        "frozen": int((~windows.moving).sum()),
        "probes": len(windows.probe),
        "mated": int((windows.mate >= 0).sum()),
        "candidates": dict(zip(windows.search_names, galleries.tolist(), strict=True)),
        "learnt_from": windows.trained_on.sum(axis=1).tolist(),
        "calibrated_on": windows.calibrated_on.sum(axis=1).tolist(),
    }
