"""What the manifest says of a run: what it was made from, its cells, and what failed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.runs import folder as store
from evaluation.runs.cell_files import label_of
from isac_track.privacy import mean_interval_s

if TYPE_CHECKING:
    from collections.abc import Mapping

    from attacks.tasks.sessions import Sessions
    from evaluation.experiment.plan import Plan
    from evaluation.runs.cell_files import Index
    from evaluation.runs.failures import FailedCell


def failed_earlier(manifest: dict[str, Any], ready: Plan) -> list[dict[str, Any]]:
    """Return what failed when other axes were run, whose finished levels stay in the tables."""
    if not manifest["cells"]:
        return []
    ours = {(mech.spec, consumer.spec, consumer.knowledge) for mech, consumer in ready.pairs}
    return [entry for entry in manifest.get("failed", []) if _cell_key(entry) not in ours]


def describe(ready: Plan) -> dict[str, Any]:
    """Return what a run is made from: code, settings, data set, what is linked."""
    tracks, dataset, settings = ready.tracks, ready.dataset, ready.settings
    return {
        "environment": store.environment(),
        "code": ready.code,
        "settings": {
            "preset": settings.preset,
            "scenes": settings.n_scenes,
            "seed": settings.seed,
            "mechanisms": [plugin.spec for plugin in ready.axes.mechanisms],
            "predictors": [plugin.spec for plugin in ready.axes.predictors],
            "attacks": [
                *(plugin.spec for plugin in ready.axes.attacks),
                *dict.fromkeys(link.spec for _, link in ready.axes.links),
            ],
            "tasks": [task.name for task in ready.axes.tasks],
            "stages": settings.stages.flat(),
        },
        "granted": {
            plugin.spec: sorted(one.name for one in plugin.instance.requires)
            for plugin in ready.axes.predictors
            if plugin.instance.requires
        },
        "without_rule": sorted(
            {
                plugin.family
                for plugin in ready.axes.mechanisms
                if not plugin.adding and getattr(plugin.instance, "adds_error", True)
            }
        ),
        "dataset": {
            "name": dataset.name,
            "path": str(dataset.path),
            "sha256": dataset.sha256,
            "format": dataset.format,
            "simulated": dataset.simulated,
            "notice": dataset.notice,
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
        "linkage": {
            "skipped": dict(ready.axes.skipped),
            "tasks": {sessions.task.name: _described(sessions) for sessions in ready.sessions},
        },
    }


def _described(sessions: Sessions) -> dict[str, Any]:
    """Return what is linked in a task: who, among how many, and who learns from whom."""
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


def merged_cells(
    earlier: list[dict[str, Any]],
    ready: Plan,
    *,
    files: Mapping[tuple[str, str], list[str]],
    held: Mapping[str, Index],
) -> list[dict[str, Any]]:
    """Return the index of cells: those of this run, and finished ones of earlier axes.

    An earlier level that was never finished (interrupted, or a plug-in that failed) is left out.

    Parameters
    ----------
    earlier : list of dict
    ready : Plan
    files : mapping
        By mechanism and consumer, of this run.
    held : mapping
        What the files hold that are there.
    """
    ours = [
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
    known = {_cell_key(entry) for entry in ours}
    finished = [
        entry
        for entry in earlier
        if all(name in held and label_of(entry) in held[name].consumers for name in entry["files"])
    ]
    return _with_ceiling(ours + [one for one in finished if _cell_key(one) not in known])


def _with_ceiling(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the index without what is linked without a ceiling.

    What an attack says when it finds nothing depends on it.
    """
    ceilings = {
        (entry["consumer"], entry["knowledge"]) for entry in entries if entry["spec"] == "clean"
    }
    return [
        entry
        for entry in entries
        if entry["kind"] != "linkage" or (entry["consumer"], entry["knowledge"]) in ceilings
    ]


def whole_cells(entries: list[dict[str, Any]], failed: list[FailedCell]) -> list[dict[str, Any]]:
    """Return the index without entries that miss a cell: nothing is averaged over less."""
    missing = {_cell_key(described_failure(one)) for one in failed}
    return _with_ceiling([entry for entry in entries if _cell_key(entry) not in missing])


def described_failure(one: FailedCell) -> dict[str, Any]:
    """Return the entry of a cell that could not be computed."""
    return {
        "spec": one.mechanism.spec,
        "kind": one.consumer.kind,
        "consumer": one.consumer.spec,
        "knowledge": one.consumer.knowledge,
        "block": one.block,
        "why": one.why,
    }


def _cell_key(entry: dict[str, Any]) -> tuple[str, str, str]:
    return entry["spec"], entry["consumer"], entry["knowledge"]
