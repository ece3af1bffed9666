"""The work of a run: compute the missing cells, and record the failed ones by name."""

import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from evaluation.compute.current_cell import Failure, current_cell, note_cell
from evaluation.compute.loops import (
    COMPILED,
    COMPILING,
    GAIN,
    LOADED,
    list_loops,
    prepare_loop,
)
from evaluation.compute.sample_tracks import gallery_mechanisms, gallery_rows
from evaluation.plan.constants import horizon_world
from evaluation.plan.fingerprint import has_user_plugins
from evaluation.plan.plan import Plan, Unit
from evaluation.pool import pieces
from evaluation.pool.plugin_calls import try_plugins
from evaluation.pool.workers import dismiss, spread
from evaluation.store.cell_files import (
    cell_places,
    read_rows,
    rename_people,
    sound_files,
    write_gallery,
)
from evaluation.store.files import (
    FOLDER,
    entry_label,
    locked,
    read_regular_file,
    write_checked,
)
from evaluation.store.folder import check_folder, check_preset, open_run
from evaluation.store.manifest import (
    candidate_losses,
    cell_entries,
    consumer_fields,
    describe,
    merged_cells,
    merged_plugins,
    other_entries,
    with_ceiling,
    write_manifest,
)
from evaluation.store.people import prepare_names, share_key
from isac_track.command_line import check_interrupt
from isac_track.errors import PluginError, error_text
from isac_track.plugins import Plugin

# Words in the licence of a recording whose walks must not be passed on.
NOT_PASSED_ON: Final = "never to be passed on"


class FailedCellsWarning(UserWarning):
    """Some cells of a run could not be computed; `Results.failed` names them."""


def execute(
    ready: Plan, progress: Callable[[int, int, str], None], *, keeps_walks: bool = True
) -> None:
    """Compute the cells that a run's folder lacks; the caller holds the folder's lock.

    The walks of a few people are kept to be drawn, unless `keeps_walks` is false or the
    recording's licence forbids to pass them on.

    `progress` is called with cells finished, cells to do, and the cell under way.
    Raises IsacTrackError for anything that a user can mend; finished cells are kept.
    """
    started, out = time.monotonic(), ready.out
    untried = try_plugins(ready)
    if not ready.settings.fresh:
        check_preset(out, preset=ready.settings.preset)
    manifest, index_by_file, damaged = open_run(
        out, identity=ready.identity, fresh=ready.settings.fresh
    )
    deque(prepare_loop(GAIN), maxlen=0)  # runs the steps of the generator
    names = prepare_names(ready, is_continued=bool(index_by_file))
    earlier_s = float(manifest.get("wall_time_s", 0.0))
    places = cell_places(index_by_file)
    units = pieces.missing_units(ready, places)
    earlier_plugins = manifest.get("own_plugins", {})
    manifest |= describe(ready) | {
        "damaged_cells": damaged,
        "untried_plugins": untried,
    }
    manifest["own_plugins"] = merged_plugins(earlier_plugins, manifest["own_plugins"])
    # Failures of earlier axes stay, and so do their finished levels.
    failures = manifest.get("failed", []) if manifest["cells"] else []
    entries = cell_entries(ready, places, units)
    manifest["failed"] = other_entries(failures, than=entries)
    manifest["cells"] = merged_cells(manifest["cells"], entries, held=index_by_file)
    write_manifest(out, manifest | {"state": "running"})
    failed = _compute_missing(units, ready, manifest, progress, names)
    progress(ready.n_cells, ready.n_cells, "report: intervals, verdict, figures")
    if keeps_walks and NOT_PASSED_ON not in ready.dataset.licence:
        failed_plugins = {
            str(entry[name]) for entry in failed for name in ("spec", "consumer")
        }
        manifest["gallery_without"] = _write_gallery(ready, failed_plugins, names)
    else:
        manifest["gallery_without"] = []
        write_gallery([], out=out)
    manifest["exhausted_redraws"] = _exhausted_redraws(out, manifest["cells"], "")
    for horizon_s, horizon_entry in manifest["horizons"].items():
        world = horizon_world(float(horizon_s))
        horizon_entry["exhausted_redraws"] = _exhausted_redraws(
            out, manifest["cells"], world
        )
    is_approximate = ready.settings.stages.linkage.candidates > 0
    if is_approximate and (losses := candidate_losses(out, manifest["cells"])):
        manifest["linkage"]["candidates"] = losses
    manifest["wall_time_s"] = round(earlier_s + time.monotonic() - started, 3)
    write_manifest(out, manifest | {"state": "finished"})


def execute_stronger(ready: Plan, progress: Callable[[int, int, str], None]) -> None:
    """Compute the cells of stronger adversaries for a finished run.

    `ready` is a plan of `evaluation.plan.plan.plan_stronger`. The description of the
    run in its manifest stays. Otherwise as `execute`.
    """
    if not ready.units:
        return
    started, out = time.monotonic(), ready.out
    manifest, index_by_file, _ = open_run(out, identity=ready.identity, fresh=False)
    names = prepare_names(ready, is_continued=True)
    places = cell_places(index_by_file)
    missing = pieces.missing_units(ready, places)
    entries = cell_entries(ready, places, missing)
    manifest["failed"] = other_entries(manifest.get("failed", []), than=entries)
    # Earlier cells keep their order: results do not depend on the order of requests.
    by_label = {(entry["spec"], entry_label(entry)): entry for entry in entries}
    cells = []
    for earlier in manifest["cells"]:
        key = earlier["spec"], entry_label(earlier)
        cells.append(by_label.pop(key, earlier))
    manifest["cells"] = cells + list(by_label.values())
    write_manifest(out, manifest | {"state": "running"})
    _compute_missing(missing, ready, manifest, progress, names)
    spent_s = float(manifest.get("wall_time_s", 0.0)) + time.monotonic() - started
    write_manifest(
        out, manifest | {"state": "finished", "wall_time_s": round(spent_s, 3)}
    )


def _compute_missing(
    units: Sequence[Unit],
    ready: Plan,
    manifest: dict[str, Any],
    progress: Callable[[int, int, str], None],
    names: Mapping[str, str],
) -> list[dict[str, Any]]:
    """Compute missing cells; return the failed ones, which the manifest then names."""
    works = deque(pieces.cut_work(units, ready))
    if ready.settings.scheduler is None:  # a cluster's workers compile for themselves
        total = sum(len(unit.consumers) for unit in units)
        compiling_s = _prepare_loops(works, ready, partial(progress, 0, total))
        manifest["compiling_s"] = round(
            manifest.get("compiling_s", 0.0) + compiling_s, 3
        )
    failures = _compute_cells(units, works, ready, progress, names)
    failed = [
        {
            **consumer_fields(cell.mechanism, cell.consumer),
            "block": cell.block,
            "why": why,
        }
        for cell, why in failures
    ]
    if failed:
        manifest["failed"] += failed
        # No entry that lacks a cell: every mean is over all blocks.
        manifest["cells"] = with_ceiling(other_entries(manifest["cells"], than=failed))
        if not manifest["cells"]:
            write_manifest(ready.out, manifest | {"state": "failed"})
            raise PluginError(failed[0]["why"])
        reasons = list(dict.fromkeys(entry["why"] for entry in failed))
        more = f" (and {len(reasons) - 1} other reasons)" if len(reasons) > 1 else ""
        text = f"{len(failed)} cells failed and are left out: {reasons[0]}{more}"
        warnings.warn(text, FailedCellsWarning, stacklevel=5)
    return failed


def _exhausted_redraws(
    out: Path, cells: Iterable[dict[str, Any]], world: str
) -> int | None:
    """Return the number of a world's agents whose place has no clearance.

    None if no cell of a predictor tells.
    """
    forecasts = (entry for entry in cells if entry["kind"] == "predictor")
    in_world = (entry for entry in forecasts if (entry.get("world") or "") == world)
    entry = next(in_world, None)
    if entry is None:
        return None
    return int(
        read_rows(out, entry, columns=["exhausted"])["exhausted"].to_numpy().sum()
    )


def borrow(ready: Plan, *, sources: Sequence[Path], fresh: bool = False) -> None:
    """Open the folder of a run and copy cells of other runs into it.

    Each cell comes from the first of the source folders that has it: equal keys mean
    equal cells. Raises DataError if the folder cannot be written or another process
    runs in it, and SettingsError if it holds another run, which `fresh` replaces.
    """
    check_folder(ready.out)
    with locked(ready.out):
        manifest, files, _ = open_run(ready.out, identity=ready.identity, fresh=fresh)
        share_key(ready.out, sources)
        write_manifest(ready.out, manifest | {"code": ready.code, "state": "running"})
        units = pieces.missing_units(ready, cell_places(files))
        wanted = {
            (unit.key, consumer_key)
            for unit in units
            for consumer_key in unit.consumers
        }
        for source in sources:
            for name, index in sound_files(source)[0].items():
                present = {
                    (index.unit, consumer.key) for consumer in index.consumers.values()
                }
                if wanted & present:
                    content = read_regular_file(source / FOLDER / name)
                    write_checked(ready.out, name, content)
                    wanted -= present


def _write_gallery(
    ready: Plan, failed_plugins: set[str], names: Mapping[str, str]
) -> list[str]:
    """Write sample tracks without the failed plug-ins; return the failures here."""
    axes = ready.axes
    mechanisms = [
        plugin for plugin in axes.mechanisms if plugin.spec not in failed_plugins
    ]
    compute = partial(
        _gallery_part,
        tracks=ready.tracks,
        attacks=[
            plugin for plugin in axes.attacks if plugin.spec not in failed_plugins
        ],
        stages=ready.settings.stages,
        seed=ready.settings.seed,
    )
    parts: list[pa.Table] = []
    failed = []
    # Workers have loaded all modules that this takes.
    in_workers = ready.jobs > 1 or has_user_plugins(axes)
    limit_s = ready.settings.cell_timeout_s
    works = deque(gallery_mechanisms(mechanisms))
    for mechanism, results in spread(
        compute, works, jobs=1, limit_s=limit_s, in_workers=in_workers
    ):
        for result in results:
            if isinstance(result, Failure):
                failed.append(f"{mechanism.spec}: {result.message}")
            else:
                parts.append(rename_people(result, names))
    write_gallery(parts, out=ready.out)
    return failed


def _gallery_part(mechanism: Plugin, **options: Any) -> Iterator[pa.Table | Failure]:  # noqa: ANN401 - handed on
    note_cell(mechanism.spec, "gallery")
    try:
        yield gallery_rows(mechanism, **options)
    except PluginError as error:
        yield Failure(current_cell.names, str(error))
    except Exception as error:  # noqa: BLE001 - no picture may cost finished cells
        yield Failure(current_cell.names, error_text(error))


def _compute_cells(
    units: Sequence[Unit],
    works: deque[pieces.Work],
    ready: Plan,
    progress: Callable[[int, int, str], None],
    names: Mapping[str, str],
) -> list[tuple[pieces.PlannedCell, str]]:
    """Compute missing cells, here or by workers; return failed ones with reasons."""
    if not works:
        return []
    total = sum(len(unit.consumers) for unit in units)
    first_cell = next(pieces.planned_cells(works[0]))
    progress(0, total, _describe_cell(pieces.cell_name(first_cell)))
    files = pieces.expected_files(units, ready.code_digests)
    compute = partial(
        pieces.compute_files,
        files=files,
        names=names,
        tracks=ready.tracks,
        stages=ready.settings.stages,
        seed=ready.settings.seed,
    )
    computed = _spread_works(compute, works, ready)
    finished: set[pieces.CellName] = set()
    failures, collector = pieces.Failures(), pieces.FileCollector(files, names)
    n_failed = 0
    with closing(computed):
        for work, results in computed:
            for result in results:
                if isinstance(result, pieces.WholeFile):
                    _write_file(ready.out, result)
                    finished.update(result.cells)
                    name = result.cells[-1]
                elif isinstance(result, Failure):
                    works.extend(failures.rest(work, result, finished=finished))
                    for cell, _ in failures.cells[n_failed:]:
                        _write_file(
                            ready.out, collector.add(pieces.cell_name(cell), None)
                        )
                    n_failed = len(failures.cells)
                    continue
                else:
                    name = pieces.cell_name(result)
                    _write_file(ready.out, collector.add(name, result))
                    finished.add(name)
                check_interrupt()
                progress(len(finished) + n_failed, total, _describe_cell(name))
    return failures.cells


def _spread_works(
    compute: Callable[[pieces.Work], Iterable[pieces.WorkResult]],
    works: deque[pieces.Work],
    ready: Plan,
) -> Generator[tuple[pieces.Work, Iterable[pieces.WorkResult]]]:
    """Yield each work with its results, from this machine or from a Dask cluster."""
    scheduler = ready.settings.scheduler
    if scheduler is None:
        return spread(
            compute,
            works,
            jobs=ready.jobs,
            limit_s=ready.settings.cell_timeout_s,
            in_workers=has_user_plugins(ready.axes),
        )
    from evaluation.pool.dask import spread_on_cluster  # noqa: PLC0415 - an extra

    pieces.cut_for_cluster(works)
    modules = ready.code_digests.keys()
    return spread_on_cluster(compute, works, scheduler=scheduler, modules=modules)


def _describe_cell(name: pieces.CellName) -> str:
    """Return a cell in words: of linkage if its consumer's label begins with a task."""
    _, spec, label = name
    stage = "linkage" if "/" in label.partition(":")[0] else "scenes"
    return f"{stage}: {spec} > {label}"


def _prepare_loops(
    works: Iterable[pieces.Work], ready: Plan, report: Callable[[str], None]
) -> float:
    """Compile the loops that the cells call, or load them; return the time of it, s.

    The time is 0 if all were loaded. Workers that had to compile end here: each keeps
    half a gigabyte for it.
    """
    cells = (cell for work in works for cell in pieces.planned_cells(work))
    loops = list_loops((cell.mechanism, cell.consumer) for cell in cells)
    in_workers = (
        has_user_plugins(ready.axes) or ready.settings.cell_timeout_s is not None
    )
    started, states = time.monotonic(), dict[str, str]()
    prepared = spread(
        prepare_loop, deque(loops), jobs=ready.jobs, limit_s=None, in_workers=in_workers
    )
    with closing(prepared):
        for loop, loop_states in prepared:
            for state in loop_states:
                states[loop] = LOADED if isinstance(state, Failure) else state
                if {COMPILING, COMPILED} & {*states.values()}:
                    n_ready = len(states) - [*states.values()].count(COMPILING)
                    report(f"compiling, once: {n_ready} of {len(loops)} loops")
    if COMPILED not in states.values():
        return 0.0
    dismiss()
    return time.monotonic() - started


def _write_file(out: Path, file: pieces.WholeFile | None) -> None:
    if file is not None:
        write_checked(out, file.name, file.content)
