"""One run from settings to data frames: what `evaluation.run` does and the command shows."""

from __future__ import annotations

import hashlib
import time
import warnings
from collections import deque
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation import store
from evaluation.cell import Block, LinkWork, attempt
from evaluation.cell_files import read_cells, sound_cells, write_cell
from evaluation.failures import FailedCell, Failures
from evaluation.grid import BLOCK_SCENES, Axes, Settings, axes, n_blocks
from evaluation.linkage_ground import sessions_of
from evaluation.memory import given_back
from evaluation.page_gallery import chosen, gallery_rows, write_gallery
from evaluation.report import Results, build
from evaluation.run_lock import locked
from evaluation.workers import Failed, default_jobs, note, noted, spread
from isac_track import datasets, kernels
from isac_track.command_line import check_interrupt
from isac_track.datasets import crowd
from isac_track.errors import DataError, PluginError, told
from isac_track.privacy import mean_interval_s
from isac_track.scenes import cut, track_order

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator
    from collections.abc import Set as AbstractSet

    import pandas as pd

    from attacks.linkage.sessions import Sessions
    from evaluation.cell import Item
    from evaluation.failures import Work
    from evaluation.grid import Consumer
    from isac_track.datasets import Dataset
    from isac_track.registry import Plugin
    from isac_track.scenes import Cut
    from isac_track.types import Tracks


WORTH_WORKERS = 5000
"""Scenes times levels: below, workers take longer to start than they save."""
WORTH_WORKERS_LINKED = 400
"""Linkage cells: the same."""
_TASKS_PER_WORKER = 2
_LEVELS_PER_TASK = 12
"""Of what is linked."""
_CLUSTER_TASKS = 64
"""At least so many, where there are as many levels and blocks."""


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """A run that is ready to start: everything is checked, nothing is written."""

    settings: Settings
    dataset: Dataset
    tracks: Cut
    axes: Axes
    identity: dict[str, Any]
    code: str
    """Version of the code that computes the cells."""
    jobs: int
    """Worker processes."""
    out: Path
    cells: tuple[tuple[Plugin, Consumer, tuple[str, ...]], ...]
    """Mechanism, consumer and its files: one a block of scenes, or one for all that is linked."""
    sessions: tuple[Sessions, ...]
    """What is linked, by task."""

    @property
    def n_cells(self) -> int:
        """Cells of the run, finished or not."""
        return sum(len(files) for _, _, files in self.cells)


def plan(settings: Settings) -> Plan:
    """Check the settings, find the data set and lay out the cells.

    Raises
    ------
    IsacTrackError
        For anything that a user can mend.
    """
    crossed = axes(settings)
    source: str | Path | None = settings.dataset
    dataset = datasets.load(source, format=settings.format, fps=settings.fps)
    tracks = cut(dataset.tracks, settings=settings.stages, seed=settings.seed)
    identity = {
        "dataset": dataset.name,
        "sha256": dataset.sha256,
        "format": dataset.format,
        "fps": settings.fps,
        "seed": settings.seed,
        "scenes": settings.n_scenes,
        "crowd": _crowd_hash(),
        **settings.stages.flat(),
    }
    code = store.code_hash()
    crossed, sessions = _sessions(crossed, settings, tracks=dataset.tracks)

    def files(mechanism: Plugin, consumer: Consumer, count: int) -> tuple[str, ...]:
        return tuple(
            store.cell_name(
                identity=identity, code=code, block=block, mechanism=mechanism, consumer=consumer
            )
            for block in range(count)
        )

    cells = tuple(
        (mechanism, consumer, files(mechanism, consumer, count))
        for mechanisms, consumers, count in (
            (crossed.mechanisms, crossed.consumers, n_blocks(settings.n_scenes)),
            *((crossed.linked_mechanisms, crossed.readers(task), 1) for task in crossed.tasks),
        )
        for mechanism in mechanisms
        for consumer in consumers
    )
    name = f"{dataset.name}-{settings.preset}-{settings.seed}"
    jobs = _jobs(
        settings,
        n_levels=len(crossed.mechanisms),
        n_links=sum(len(crossed.linkers(task)) for task in crossed.tasks),
    )
    if jobs > 1 or settings.cell_timeout_s is not None or settings.scheduler is not None:
        _check_sendable(crossed)
    return Plan(
        settings=settings,
        dataset=dataset,
        tracks=tracks,
        axes=crossed,
        identity=identity,
        code=code,
        jobs=jobs,
        out=Path("runs") / name if settings.out is None else Path(settings.out),
        cells=cells,
        sessions=sessions,
    )


def _crowd_hash() -> str:
    """Return a digest of the bundled crowd, which one task always uses."""
    digest = hashlib.sha256()
    for session in crowd.SESSIONS:
        digest.update(crowd.bundled_path(session).read_bytes())
    return digest.hexdigest()[:16]


def _sessions(
    crossed: Axes, settings: Settings, *, tracks: Tracks
) -> tuple[Axes, tuple[Sessions, ...]]:
    """Return the sessions of every task, and the axes without tasks that cannot be.

    A task that was named must be; one of a preset is left out, with the reason.
    """
    sessions = []
    for task in crossed.tasks:
        try:
            sessions.append(
                sessions_of(task, tracks=tracks, stages=settings.stages, seed=settings.seed)
            )
        except DataError as error:
            if settings.tasks is not None:
                raise
            crossed = crossed.without(task, str(error))
    return crossed, tuple(sessions)


def _check_sendable(crossed: Axes) -> None:
    """Raise PluginError for a plug-in that no other process can be given."""
    from joblib.externals.loky.backend.reduction import dumps  # noqa: PLC0415 - only with workers

    consumers = [*crossed.consumers]
    for task in crossed.tasks:
        consumers += crossed.readers(task)
    plugins = [*crossed.mechanisms, *crossed.linked_mechanisms]
    plugins += [part for one in consumers for part in (one.plugin, one.behind) if part is not None]
    for plugin in {one.spec: one for one in plugins}.values():
        try:
            dumps(plugin)
        except Exception as error:  # noqa: BLE001 - a stranger's __reduce__ may do anything
            raise PluginError(
                f"{plugin.spec} cannot be sent to a worker ({told(error)}); "
                "leave out what cannot be pickled, or run with --jobs 1 and no --cell-timeout"
            ) from None


def _jobs(settings: Settings, *, n_levels: int, n_links: int) -> int:
    """Return how many workers to use: as asked, or what the work is worth."""
    if settings.jobs is not None:
        return settings.jobs
    if settings.n_scenes * n_levels < WORTH_WORKERS and n_levels * n_links < WORTH_WORKERS_LINKED:
        return 1
    return default_jobs()


def run(
    settings: Settings | None = None,
    *,
    progress: Callable[[int, int, str], None] | None = None,
    ready: Plan | None = None,
    pictures: bool = True,
) -> Results:
    """Run the matrix and return its results as data frames.

    Parameters
    ----------
    settings : Settings, optional
        By default preset `paper`.
    progress : callable, optional
        Called with cells finished, cells to do, and what is under way.
    ready : Plan, optional
        A plan of `plan`, instead of settings.
    pictures : bool
        Without them there are neither figures nor `report.html`; `evaluation.report` draws them.

    Raises
    ------
    IsacTrackError
        For anything that a user can mend; finished cells are kept.
    """
    if ready is None:
        ready = plan(settings or Settings())
    tell = progress or (lambda _done, _total, _what: None)
    store.check_folder(ready.out)
    with given_back(), locked(ready.out):
        return _run_locked(ready, tell, pictures=pictures)


def _run_locked(ready: Plan, tell: Callable[[int, int, str], None], *, pictures: bool) -> Results:
    started = time.monotonic()
    manifest = store.open_run(
        ready.out, identity=ready.identity, code=ready.code, fresh=ready.settings.fresh
    )
    earlier_s = float(manifest.get("wall_time_s", 0.0))
    earlier = [name for entry in manifest["cells"] for name in entry["files"]]
    ours = [name for _, _, names in ready.cells for name in names]
    sound, damaged = sound_cells(ready.out, (*earlier, *ours))
    manifest |= _describe(ready)
    manifest["damaged_cells"] = damaged
    manifest["failed"] = _failed_earlier(manifest, ready)
    manifest["cells"] = _merged(manifest["cells"], ready, sound=sound)
    store.write_manifest(ready.out, manifest | {"state": "running"})
    failed = _compute_missing(ready, tell, sound=sound)
    if failed:
        manifest["failed"] += [_described_failure(one) for one in failed]
        manifest["cells"] = _whole(manifest["cells"], failed, ready)
        if not manifest["cells"]:
            store.write_manifest(ready.out, manifest | {"state": "failed"})
            raise PluginError(failed[0].why)
        warnings.warn(_summed_up(failed), FailedCellsWarning, stacklevel=3)
    tell(ready.n_cells, ready.n_cells, "intervals, verdict, figures and report")
    manifest["gallery_without"] = _write_gallery(ready, failed)
    manifest["exhausted_redraws"] = _exhausted_redraws(ready.out, manifest["cells"])
    manifest["wall_time_s"] = round(earlier_s + time.monotonic() - started, 3)
    store.write_manifest(ready.out, manifest | {"state": "finished"})
    return build(ready.out, pictures=pictures, jobs=ready.jobs)


def _failed_earlier(manifest: dict[str, Any], ready: Plan) -> list[dict[str, Any]]:
    """Return what failed when other axes were run, whose finished levels stay in the tables."""
    if not manifest["cells"]:
        return []
    ours = {(mech.spec, consumer.spec, consumer.knowledge) for mech, consumer, _ in ready.cells}
    return [entry for entry in manifest.get("failed", []) if _cell_key(entry) not in ours]


def _write_gallery(ready: Plan, failed: list[FailedCell]) -> list[str]:
    """Keep some tracks to look at, from plug-ins that have not failed; return what fails here."""
    named = {one.mechanism.spec for one in failed} | {one.consumer.spec for one in failed}
    compute = partial(
        _gallery_part,
        tracks=ready.tracks,
        attacks=[one for one in ready.axes.attacks if one.spec not in named],
        stages=ready.settings.stages,
        seed=ready.settings.seed,
    )
    mechanisms = chosen([one for one in ready.axes.mechanisms if one.spec not in named])
    parts: list[pd.DataFrame] = []
    without = []
    limit_s = ready.settings.cell_timeout_s
    for mechanism, found in spread(compute, deque(mechanisms), jobs=1, limit_s=limit_s):
        for part in found:
            if isinstance(part, Failed):
                without.append(f"{mechanism.spec}: {part.why}")
            else:
                parts.append(part)
    write_gallery(parts, out=ready.out)
    return without


def _gallery_part(mechanism: Plugin, **options: Any) -> Iterator[pd.DataFrame | Failed]:  # noqa: ANN401 - handed on
    note(mechanism.spec, "gallery")
    try:
        yield gallery_rows(mechanisms=[mechanism], **options)
    except PluginError as error:
        yield Failed(noted(), str(error))
    except Exception as error:  # noqa: BLE001 - the cells are finished: no picture may cost them
        yield Failed(noted(), told(error))


def _compute_missing(
    ready: Plan, tell: Callable[[int, int, str], None], *, sound: AbstractSet[str]
) -> list[FailedCell]:
    """Compute what is missing, and return what could not be."""
    blocks = tuple(_missing_blocks(ready, sound))
    # The longest first: at the end no worker waits for long.
    links = sorted(_missing_links(ready, sound), key=_pairs, reverse=True)
    works: deque[Work] = deque((*blocks, *links))
    total = sum(len(consumers) for work in works for _, consumers in work.levels)
    files = {(mechanism.spec, consumer.label): names for mechanism, consumer, names in ready.cells}
    done = 0
    failures = Failures()
    if not works:
        return failures.cells
    tell(done, total, "starting")
    if any(_uses_kernels(consumer) for _, consumer, _ in ready.cells):
        kernels.prepare()  # before workers start: each would compile for itself
        import_module("attacks.reconstruction._parabola_loop")
    if links:
        for loops in ("isac_track._linkability_loops", "attacks.linkage._lag_loop"):
            import_module(loops)
    with closing(_computed(works, ready)) as computed:
        for work, items in computed:
            finished: set[tuple[str, str]] = set()
            for item in items:
                if isinstance(item, Failed):
                    before = len(failures.cells)
                    works.extend(failures.rest(work, item, finished=finished))
                    done += len(failures.cells) - before
                    continue
                block, mechanism, consumer, rows = item
                write_cell(
                    ready.out,
                    files[mechanism.spec, consumer.label][block],
                    rows,
                    tracks=ready.tracks,
                )
                finished.add((mechanism.spec, consumer.label))
                done += 1
                check_interrupt()
                tell(done, total, f"{mechanism.spec} > {consumer.label}")
    return failures.cells


def _uses_kernels(consumer: Consumer) -> bool:
    origin = "" if consumer.plugin is None else consumer.plugin.origin
    links = consumer.kind in {"linkage", "control"}
    return links or origin.startswith(("predictors.kalman", "attacks."))


def _exhausted_redraws(out: Path, entries: list[dict[str, Any]]) -> int | None:
    """Return how many agents kept a place without clearance; None if no cell tells."""
    for entry in entries:
        if entry["kind"] == "predictor":
            paths = [out / "cells" / name for name in entry["files"]]
            table = read_cells(paths, columns=["exhausted"])
            return int(table["exhausted"].to_numpy().sum())
    return None


def _missing_blocks(ready: Plan, present: AbstractSet[str]) -> Iterator[Block]:
    settings = ready.settings
    order = track_order(
        n_tracks=len(ready.tracks),
        n_scenes=settings.n_scenes,
        agents=settings.stages.scenes.agents,
        seed=settings.seed,
    )
    for number in range(n_blocks(settings.n_scenes)):
        missing: dict[str, tuple[Plugin, list[Consumer]]] = {}
        for mechanism, consumer, names in ready.cells:
            if not consumer.task and names[number] not in present:
                missing.setdefault(mechanism.spec, (mechanism, []))[1].append(consumer)
        levels = tuple((mechanism, tuple(consumers)) for mechanism, consumers in missing.values())
        first = number * BLOCK_SCENES
        for part in _parts(levels, ready=ready):
            yield Block(
                number=number,
                first_scene=first,
                order=order[first : first + BLOCK_SCENES],
                levels=part,
            )


def _missing_links(ready: Plan, present: AbstractSet[str]) -> Iterator[LinkWork]:
    for sessions in ready.sessions:
        missing: dict[str, tuple[Plugin, list[Consumer]]] = {}
        for mechanism, consumer, names in ready.cells:
            if consumer.task == sessions.task.name and names[0] not in present:
                missing.setdefault(mechanism.spec, (mechanism, []))[1].append(consumer)
        levels = [(mechanism, tuple(consumers)) for mechanism, consumers in missing.values()]
        # Each part senses the sessions again, which takes less than one level.
        for first in range(0, len(levels), _LEVELS_PER_TASK):
            yield LinkWork(
                sessions=sessions,
                groups=tuple(sorted(set(ready.tracks.group))),
                levels=tuple(levels[first : first + _LEVELS_PER_TASK]),
            )


def _pairs(work: LinkWork) -> int:
    """Return how many pairs are compared: what a linker takes goes by it."""
    sides = (work.sessions.probe.search, work.sessions.gallery.search)
    probes, gallery = (np.bincount(side, minlength=len(work.sessions.searches)) for side in sides)
    return len(work.levels) * int((probes * gallery).sum())


def _parts(
    levels: tuple[tuple[Plugin, tuple[Consumer, ...]], ...], *, ready: Plan
) -> list[tuple[tuple[Plugin, tuple[Consumer, ...]], ...]]:
    """Split the levels of a block where there are few blocks for the workers.

    Each part senses the block again, so that there are no more parts than an even load takes.
    """
    if not levels:
        return []
    if ready.jobs == 1:
        return [levels]
    n_tasks = _TASKS_PER_WORKER * ready.jobs
    n_parts = min(len(levels), -(-n_tasks // n_blocks(ready.settings.n_scenes)))
    # Every n-th level: neighbours take alike long, and so do the parts.
    return [levels[part::n_parts] for part in range(n_parts)]


def _computed(works: deque[Work], ready: Plan) -> Generator[tuple[Work, Iterable[Item | Failed]]]:
    """Yield every work with its cells, from this process or from workers; works may be added."""
    compute = partial(
        attempt, tracks=ready.tracks, stages=ready.settings.stages, seed=ready.settings.seed
    )
    settings = ready.settings
    if settings.scheduler is None:
        return spread(compute, works, jobs=ready.jobs, limit_s=settings.cell_timeout_s)
    from evaluation.cluster import own_modules, spread_on_cluster  # noqa: PLC0415 - only there

    # Workers come and go: there are parts for some dozen threads in any case.
    n_parts = -(-_CLUSTER_TASKS // len(works))
    for _ in range(len(works)):
        work = works.popleft()
        works.extend(
            replace(work, levels=work.levels[part::n_parts])
            for part in range(min(n_parts, len(work.levels)))
        )
    return spread_on_cluster(
        compute,
        works,
        scheduler=settings.scheduler,
        modules=own_modules((one, consumer) for one, consumer, _ in ready.cells),
    )


def _describe(ready: Plan) -> dict[str, Any]:
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


def _merged(
    earlier: list[dict[str, Any]], ready: Plan, *, sound: AbstractSet[str]
) -> list[dict[str, Any]]:
    """Return the index of cells: those of this run, and finished ones of earlier axes.

    An earlier level that was never finished (interrupted, or a plug-in that failed) is left out.
    """
    ours = [
        {
            "mechanism": mechanism.name,
            "level": mechanism.level,
            "spec": mechanism.spec,
            "kind": consumer.kind,
            "consumer": consumer.spec,
            "knowledge": consumer.knowledge,
            "slow": consumer.is_slow,
            "files": list(names),
        }
        for mechanism, consumer, names in ready.cells
    ]
    known = {_cell_key(entry) for entry in ours}
    merged = ours + [
        entry for entry in earlier if _cell_key(entry) not in known and sound >= set(entry["files"])
    ]
    return _with_ceiling(merged)


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


def _whole(
    entries: list[dict[str, Any]], failed: list[FailedCell], ready: Plan
) -> list[dict[str, Any]]:
    """Return the index without entries that miss a cell: nothing is averaged over less."""
    files = {(mechanism.spec, consumer.label): names for mechanism, consumer, names in ready.cells}
    missing = {files[one.mechanism.spec, one.consumer.label][one.block] for one in failed}
    return _with_ceiling([entry for entry in entries if missing.isdisjoint(entry["files"])])


class FailedCellsWarning(UserWarning):
    """Some cells of a run could not be computed; `Results.failed` names them."""


def _summed_up(failed: list[FailedCell]) -> str:
    reasons = list(dict.fromkeys(one.why for one in failed))
    more = f" (and {len(reasons) - 1} other reasons)" if len(reasons) > 1 else ""
    return f"{len(failed)} cells failed and are left out: {reasons[0]}{more}"


def _described_failure(one: FailedCell) -> dict[str, Any]:
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
