"""The work of a run: what is missing is computed, and what could not be is named."""

import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from evaluation.compute.loops import (
    COMPILED,
    COMPILING,
    GAIN,
    LOADED,
    loops_of,
    prepare_loop,
)
from evaluation.compute.sample_tracks import chosen, gallery_rows
from evaluation.compute.where import Failed, here, note
from evaluation.plan.constants import horizon_world
from evaluation.plan.fingerprint import has_strangers
from evaluation.plan.plan import Plan, Unit
from evaluation.pool import pieces
from evaluation.pool.trials import try_plugins
from evaluation.pool.workers import dismiss, spread
from evaluation.store.cell_files import (
    places_of,
    read_rows,
    renamed,
    sound_files,
    write_gallery,
)
from evaluation.store.files import FOLDER, label_of, locked, write_checked
from evaluation.store.folder import check_folder, check_preset, open_run
from evaluation.store.manifest import (
    describe,
    entries_of,
    losses_of,
    merged_cells,
    merged_plugins,
    named,
    others,
    with_ceiling,
    write_manifest,
)
from evaluation.store.people import names_to_write, share_key
from isac_track.command_line import check_interrupt
from isac_track.errors import PluginError, told
from isac_track.plugins import Plugin

NOT_PASSED_ON: Final = "never to be passed on"  # What such a recording's licence says.


class FailedCellsWarning(UserWarning):
    """Some cells of a run could not be computed; `Results.failed` names them."""


def execute(
    ready: Plan, tell: Callable[[int, int, str], None], *, keeps_walks: bool = True
) -> None:
    """Compute what a run's folder misses; the folder is locked by who calls.

    The walks of a few people are kept to be drawn, unless `keeps_walks` is false or the
    recording's licence forbids that they are passed on.

    `tell` is called with cells finished, cells to do, and what is under way. Raises
    IsacTrackError for anything that a user can mend; finished cells are kept.
    """
    started, out = time.monotonic(), ready.out
    given_up = try_plugins(ready)
    if not ready.settings.fresh:
        check_preset(out, preset=ready.settings.preset)
    manifest, held, damaged = open_run(
        out, identity=ready.identity, fresh=ready.settings.fresh
    )
    deque(prepare_loop(GAIN), maxlen=0)
    names = names_to_write(ready, is_continued=bool(held))
    earlier_s = float(manifest.get("wall_time_s", 0.0))
    places = places_of(held)
    missing = pieces.missing_of(ready, places)
    earlier_plugins = manifest.get("own_plugins", {})
    manifest |= describe(ready) | {
        "damaged_cells": damaged,
        "untried_plugins": given_up,
    }
    manifest["own_plugins"] = merged_plugins(earlier_plugins, manifest["own_plugins"])
    # What failed when other axes were run, whose finished levels stay in the tables.
    failures = manifest.get("failed", []) if manifest["cells"] else []
    ours = entries_of(ready, places, missing)
    manifest["failed"] = others(failures, than=ours)
    manifest["cells"] = merged_cells(manifest["cells"], ours, held=held)
    write_manifest(out, manifest | {"state": "running"})
    failed = _computed(missing, ready, manifest, tell, names)
    tell(ready.n_cells, ready.n_cells, "report: intervals, verdict, figures")
    without = {str(one[name]) for one in failed for name in ("spec", "consumer")}
    keeps_walks = keeps_walks and NOT_PASSED_ON not in ready.dataset.licence
    manifest["gallery_without"] = (
        _write_gallery(ready, without, names) if keeps_walks else []
    )
    if not keeps_walks:
        write_gallery([], out=out)
    manifest["exhausted_redraws"] = _exhausted(out, manifest["cells"], "")
    for horizon_s, about in manifest["horizons"].items():
        world = horizon_world(float(horizon_s))
        about["exhausted_redraws"] = _exhausted(out, manifest["cells"], world)
    is_approximate = ready.settings.stages.linkage.candidates > 0
    if is_approximate and (losses := losses_of(out, manifest["cells"])):
        manifest["linkage"]["candidates"] = losses
    manifest["wall_time_s"] = round(earlier_s + time.monotonic() - started, 3)
    write_manifest(out, manifest | {"state": "finished"})


def execute_trial(ready: Plan, tell: Callable[[int, int, str], None]) -> None:
    """Compute further cells of a run that is finished; what is said of the run stays.

    `ready` is of `evaluation.plan.plan.trial`; otherwise as `execute`.
    """
    if not ready.units:
        return
    started, out = time.monotonic(), ready.out
    manifest, held, _ = open_run(out, identity=ready.identity, fresh=False)
    names = names_to_write(ready, is_continued=True)
    places = places_of(held)
    missing = pieces.missing_of(ready, places)
    ours = entries_of(ready, places, missing)
    manifest["failed"] = others(manifest.get("failed", []), than=ours)
    # In the order of before: results do not depend on who asked first.
    by_label = {(entry["spec"], label_of(entry)): entry for entry in ours}
    cells = [
        by_label.pop((one["spec"], label_of(one)), one) for one in manifest["cells"]
    ]
    manifest["cells"] = cells + list(by_label.values())
    write_manifest(out, manifest | {"state": "running"})
    _computed(missing, ready, manifest, tell, names)
    spent_s = float(manifest.get("wall_time_s", 0.0)) + time.monotonic() - started
    write_manifest(
        out, manifest | {"state": "finished", "wall_time_s": round(spent_s, 3)}
    )


def _computed(
    missing: Sequence[Unit],
    ready: Plan,
    manifest: dict[str, Any],
    tell: Callable[[int, int, str], None],
    names: Mapping[str, str],
) -> list[dict[str, Any]]:
    """Compute what is missing; return what failed, which the manifest then names."""
    works = deque(pieces.pieces_of(missing, ready))
    if ready.settings.scheduler is None:  # a cluster's workers compile for themselves
        total = sum(len(unit.consumers) for unit in missing)
        compiling_s = _prepare_loops(works, ready, partial(tell, 0, total))
        manifest["compiling_s"] = round(
            manifest.get("compiling_s", 0.0) + compiling_s, 3
        )
    failed = [
        {**named(mechanism, consumer), "block": block, "why": why}
        for (block, mechanism, consumer), why in _compute(
            missing, works, ready, tell, names
        )
    ]
    if failed:
        manifest["failed"] += failed
        # No entry that misses a cell: nothing is averaged over less.
        manifest["cells"] = with_ceiling(others(manifest["cells"], than=failed))
        if not manifest["cells"]:
            write_manifest(ready.out, manifest | {"state": "failed"})
            raise PluginError(failed[0]["why"])
        reasons = list(dict.fromkeys(one["why"] for one in failed))
        more = f" (and {len(reasons) - 1} other reasons)" if len(reasons) > 1 else ""
        text = f"{len(failed)} cells failed and are left out: {reasons[0]}{more}"
        warnings.warn(text, FailedCellsWarning, stacklevel=5)
    return failed


def _exhausted(out: Path, cells: Iterable[dict[str, Any]], world: str) -> int | None:
    """Return how many agents of a world kept a place without clearance; None if no cell tells."""
    forecasts = (entry for entry in cells if entry["kind"] == "predictor")
    of_world = (entry for entry in forecasts if (entry.get("world") or "") == world)
    entry = next(of_world, None)
    if entry is None:
        return None
    return int(
        read_rows(out, entry, columns=["exhausted"])["exhausted"].to_numpy().sum()
    )


def borrow(ready: Plan, *, sources: Sequence[Path], fresh: bool = False) -> None:
    """Open the folder of a run and copy the cells into it that other runs have.

    Each is taken from the first of the source folders that has it: what is keyed alike
    is the same. Raises DataError if the folder cannot be written or another process
    runs in it, and SettingsError if it holds another run, which `fresh` replaces.
    """
    check_folder(ready.out)
    with locked(ready.out):
        manifest, files, _ = open_run(ready.out, identity=ready.identity, fresh=fresh)
        share_key(ready.out, sources)
        write_manifest(ready.out, manifest | {"code": ready.code, "state": "running"})
        missing = pieces.missing_of(ready, places_of(files))
        wanted = {(one.key, key) for one in missing for key in one.consumers}
        for source in sources:
            for name, index in sound_files(source)[0].items():
                held = {(index.unit, one.key) for one in index.consumers.values()}
                if wanted & held:
                    write_checked(
                        ready.out, name, (source / FOLDER / name).read_bytes()
                    )
                    wanted -= held


def _write_gallery(
    ready: Plan, without: set[str], names: Mapping[str, str]
) -> list[str]:
    """Keep some tracks to look at, `without` some plug-ins; return what fails here."""
    compute = partial(
        _gallery_part,
        tracks=ready.tracks,
        attacks=[one for one in ready.axes.attacks if one.spec not in without],
        stages=ready.settings.stages,
        seed=ready.settings.seed,
    )
    mechanisms = chosen(
        [one for one in ready.axes.mechanisms if one.spec not in without]
    )
    parts: list[pa.Table] = []
    failed = []
    # Where workers are they have loaded all that this takes.
    apart = ready.jobs > 1 or has_strangers(ready.axes)
    limit_s = ready.settings.cell_timeout_s
    for plugin, found in spread(
        compute, deque(mechanisms), jobs=1, limit_s=limit_s, apart=apart
    ):
        for part in found:
            if isinstance(part, Failed):
                failed.append(f"{plugin.spec}: {part.why}")
            else:
                parts.append(renamed(part, names))
    write_gallery(parts, out=ready.out)
    return failed


def _gallery_part(mechanism: Plugin, **options: Any) -> Iterator[pa.Table | Failed]:  # noqa: ANN401 - handed on
    note(mechanism.spec, "gallery")
    try:
        yield gallery_rows(mechanism, **options)
    except Exception as error:  # noqa: BLE001 - the cells are finished: no picture may cost them
        yield Failed(
            here.at, str(error) if isinstance(error, PluginError) else told(error)
        )


def _compute(
    missing: Sequence[Unit],
    works: deque[pieces.Work],
    ready: Plan,
    tell: Callable[[int, int, str], None],
    names: Mapping[str, str],
) -> list[tuple[pieces.Cell, str]]:
    """Compute what is missing, here or by workers, and return what could not be, and why."""
    settings = ready.settings
    if not works:
        return []
    total = sum(len(one.consumers) for one in missing)
    tell(0, total, _stage(pieces.place_of(next(pieces.cells_of(works[0])))))
    files = pieces.files_to_come(missing, ready.code_of)
    own: dict[str, Any] = {
        "tracks": ready.tracks,
        "stages": settings.stages,
        "seed": settings.seed,
    }
    compute = partial(pieces.in_files, files=files, names=names, **own)
    computed: Generator[tuple[pieces.Work, Iterable[pieces.Found]]]
    if settings.scheduler is None:
        computed = spread(
            compute,
            works,
            jobs=ready.jobs,
            limit_s=settings.cell_timeout_s,
            apart=has_strangers(ready.axes),
        )
    else:
        from evaluation.pool.dask import spread_on_cluster  # noqa: PLC0415 - an extra

        pieces.cut_for_cluster(works)
        modules = ready.code_of.keys()
        computed = spread_on_cluster(
            compute, works, scheduler=settings.scheduler, modules=modules
        )
    finished: set[pieces.Place] = set()
    failures, gathered, n_failed = pieces.Failures(), pieces.Gathered(files, names), 0
    with closing(computed):
        for work, found in computed:
            for one in found:
                if isinstance(one, pieces.WholeFile):
                    _write(ready.out, one)
                    finished.update(one.places)
                    place = one.places[-1]
                elif isinstance(one, Failed):
                    works.extend(failures.rest(work, one, finished=finished))
                    for cell, _ in failures.cells[n_failed:]:
                        _write(ready.out, gathered.add(pieces.place_of(cell), None))
                    n_failed = len(failures.cells)
                    continue
                else:
                    place = pieces.place_of(one[:3])
                    _write(ready.out, gathered.add(place, one))
                    finished.add(place)
                check_interrupt()
                tell(len(finished) + n_failed, total, _stage(place))
    return failures.cells


def _stage(place: pieces.Place) -> str:
    """Return what is under way: of scenes or of linkage, whose consumers are called by a task."""
    _, spec, label = place
    return (
        f"{'linkage' if '/' in label.partition(':')[0] else 'scenes'}: {spec} > {label}"
    )


def _prepare_loops(
    works: Iterable[pieces.Work], ready: Plan, tell: Callable[[str], None]
) -> float:
    """Compile the loops that the cells call, or load them; return the seconds that compiling took.

    Workers that had to compile end here: each keeps half a gigabyte for it.
    """
    loops = loops_of(cell[1:] for work in works for cell in pieces.cells_of(work))
    apart = has_strangers(ready.axes) or ready.settings.cell_timeout_s is not None
    started, states = time.monotonic(), dict[str, str]()
    prepared = spread(
        prepare_loop, deque(loops), jobs=ready.jobs, limit_s=None, apart=apart
    )
    with closing(prepared):
        for loop, some in prepared:
            for state in some:
                states[loop] = LOADED if isinstance(state, Failed) else state
                if {COMPILING, COMPILED} & {*states.values()}:
                    n_ready = sum(one != COMPILING for one in states.values())
                    tell(f"compiling, once: {n_ready} of {len(loops)} loops")
    if COMPILED not in states.values():
        return 0.0
    dismiss()
    return time.monotonic() - started


def _write(out: Path, file: pieces.WholeFile | None) -> None:
    if file is not None:
        write_checked(out, file.name, file.content)
