"""A run from its manifest to its manifest: compute what its folder lacks."""

import inspect
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from evaluation.compute.loops import GAIN, prepare_loop_in_steps
from evaluation.plan.plan import Plan
from evaluation.plan.units import Unit
from evaluation.plan.world import OWN_WORLD, World
from evaluation.pool import pieces
from evaluation.pool.missing_cells import ComputedCells, compute_missing
from evaluation.pool.plugin_calls import try_plugins
from evaluation.pool.sample_tracks import compute_sample_tracks
from evaluation.store.cell_files import read_rows
from evaluation.store.cell_index import CellKey, file_by_cell, sound_files
from evaluation.store.checksums import write_checked
from evaluation.store.describe import describe_run
from evaluation.store.entries import (
    Entry,
    FailedEntry,
    entries_in,
    entries_without,
)
from evaluation.store.files import CELLS_FOLDER, read_regular_file
from evaluation.store.folder import check_folder, check_preset, open_run
from evaluation.store.lock import locked
from evaluation.store.manifest import write_manifest
from evaluation.store.merge_cells import (
    cell_entries,
    merged_cells,
    merged_plugins,
    with_ceiling,
    without_other_settings,
)
from evaluation.store.people import prepare_names, share_key
from evaluation.store.sample_tracks import save_sample_tracks
from isac_track.errors import PluginError

# Words in the licence of a recording whose walks must not be passed on.
NOT_PASSED_ON: Final = "never to be passed on"
_PACKAGE: Final = __name__.partition(".")[0]


class FailedCellsWarning(UserWarning):
    """Some cells of a run could not be computed; `Results.failed` names them."""


def execute(
    plan: Plan, progress: Callable[[int, int, str], None], *, keeps_walks: bool = True
) -> None:
    """Compute the cells that a run's folder lacks; the caller holds the folder's lock.

    The walks of a few people stay to be drawn, unless `keeps_walks` is false or the
    recording's licence forbids to pass them on.

    `progress` is called with cells finished, cells to do, and the cell under way.
    Raises IsacTrackError for anything that a user can mend; finished cells stay.
    """
    started_s, out = time.monotonic(), plan.out
    started = _start_run(plan)
    manifest = started.manifest
    earlier_s = float(manifest.get("wall_time_s", 0.0))
    write_manifest(out, manifest | {"state": "running"})
    computed = compute_missing(started.missing, plan, progress, started.names)
    failed = _note_computed(computed, plan, manifest)
    progress(plan.n_cells, plan.n_cells, "report: intervals, verdict, figures")
    may_be_shown = keeps_walks and NOT_PASSED_ON not in plan.dataset.licence
    if may_be_shown and not plan.axes.scenes.why_left_out:
        # The consumer of a reconstruction is the SPEC of the attack.
        failed_specs = {entry.spec for entry in failed}
        failed_specs |= {entry.address.consumer for entry in failed}
        manifest["gallery_without"] = compute_sample_tracks(
            plan, failed_specs, started.names
        )
    else:
        manifest["gallery_without"] = []
        save_sample_tracks([], out=out)
    _note_scene_faults(out, manifest)
    if plan.settings.stages.linkage.candidates > 0:
        _note_candidate_losses(out, manifest)
    manifest["wall_time_s"] = round(earlier_s + time.monotonic() - started_s, 3)
    write_manifest(out, manifest | {"state": "finished"})


@dataclass(frozen=True, eq=False, slots=True)
class _StartedRun:
    """A run whose folder is open, and whose plug-ins were tried."""

    manifest: dict[str, Any]  # With an entry for each cell, finished or missing.
    missing: list[Unit]
    names: Mapping[str, str]  # Of every id, as cells hold it.


def _start_run(plan: Plan) -> _StartedRun:
    """Try the plug-ins, open the folder of a run, and find the cells that it lacks."""
    untried = try_plugins(plan)
    if not plan.settings.fresh:
        check_preset(plan.out, preset=plan.settings.preset)
    opened = open_run(plan.out, identity=plan.identity, fresh=plan.settings.fresh)
    manifest, index_by_file = opened.manifest, opened.index_by_file
    # A generator: its steps compile or load the loop.
    for _ in prepare_loop_in_steps(GAIN):
        pass
    names = prepare_names(plan, is_continued=bool(index_by_file))
    finished = file_by_cell(index_by_file)
    missing = pieces.missing_units(plan, finished)
    earlier_plugins = manifest.get("own_plugins", {})
    manifest["cells"] = without_other_settings(manifest, plan)
    manifest |= describe_run(plan) | {
        "damaged_cells": opened.damaged,
        "untried_plugins": untried,
        "edited_modules": [],
    }
    manifest["own_plugins"] = merged_plugins(earlier_plugins, manifest["own_plugins"])
    # Failures of earlier axes stay, and so do their finished levels.
    failures = manifest.get("failed", []) if manifest["cells"] else []
    entries = cell_entries(plan, finished, missing)
    manifest["failed"] = entries_without(failures, entries)
    manifest["cells"] = merged_cells(
        manifest["cells"], entries, index_by_file=index_by_file
    )
    return _StartedRun(manifest, missing, names)


def _note_scene_faults(out: Path, manifest: dict[str, Any]) -> None:
    """Note in the manifest how many agents stand without clearance, by horizon."""
    cells = manifest["cells"]
    manifest["exhausted_redraws"] = _agents_without_clearance(out, cells, OWN_WORLD)
    for horizon_s, horizon_entry in manifest["horizons"].items():
        world = World(horizon_s=float(horizon_s))
        horizon_entry["exhausted_redraws"] = _agents_without_clearance(
            out, cells, world
        )


def _note_candidate_losses(out: Path, manifest: dict[str, Any]) -> None:
    """Note in the manifest what linkers lose as they score only some candidates."""
    from evaluation.store.candidate_losses import (  # noqa: PLC0415 - slow to import
        candidate_losses,
    )

    if losses := candidate_losses(out, manifest["cells"]):
        manifest["linkage"]["candidates"] = losses


def execute_stronger(plan: Plan, progress: Callable[[int, int, str], None]) -> None:
    """Compute the cells of stronger adversaries for a finished run.

    `plan` is a plan of `evaluation.plan.plan.plan_stronger`. The description of the
    run in its manifest stays. Otherwise as `execute`.
    """
    if not plan.units:
        return
    started_s, out = time.monotonic(), plan.out
    opened = open_run(out, identity=plan.identity, fresh=False)
    manifest = opened.manifest
    names = prepare_names(plan, is_continued=True)
    finished = file_by_cell(opened.index_by_file)
    missing = pieces.missing_units(plan, finished)
    entries = cell_entries(plan, finished, missing)
    manifest["failed"] = entries_without(manifest.get("failed", []), entries)
    # Earlier cells keep their order: results do not depend on the order of requests.
    by_cell = {entry.cell: entry for entry in entries}
    cells = [by_cell.pop(earlier.cell, earlier) for earlier in manifest["cells"]]
    manifest["cells"] = cells + list(by_cell.values())
    write_manifest(out, manifest | {"state": "running"})
    computed = compute_missing(missing, plan, progress, names)
    _note_computed(computed, plan, manifest)
    spent_s = float(manifest.get("wall_time_s", 0.0)) + time.monotonic() - started_s
    write_manifest(
        out, manifest | {"state": "finished", "wall_time_s": round(spent_s, 3)}
    )


def _note_computed(
    computed: ComputedCells, plan: Plan, manifest: dict[str, Any]
) -> list[FailedEntry]:
    """Note failed cells and the time of compiling in the manifest; return the failed.

    Raises PluginError if no cell is finished.
    """
    if computed.compiling_s is not None:
        earlier_s = manifest.get("compiling_s", 0.0)
        manifest["compiling_s"] = round(earlier_s + computed.compiling_s, 3)
    failed = [
        FailedEntry(
            address=cell.consumer.address,
            kind=cell.consumer.kind_in_files,
            spec=cell.mechanism.spec,
            block=cell.block,
            why=message,
        )
        for cell, message in computed.failed
    ]
    if failed:
        manifest["failed"] += failed
        # No entry that lacks a cell: every mean is over all blocks.
        manifest["cells"] = with_ceiling(entries_without(manifest["cells"], failed))
        if not manifest["cells"]:
            write_manifest(plan.out, manifest | {"state": "failed"})
            raise PluginError(failed[0].why)
        reasons = list(dict.fromkeys(entry.why for entry in failed))
        more = f" (and {len(reasons) - 1} other reasons)" if len(reasons) > 1 else ""
        text = f"{len(failed)} cells failed and are left out: {reasons[0]}{more}"
        warnings.warn(text, FailedCellsWarning, stacklevel=_user_stacklevel())
    return failed


def _user_stacklevel() -> int:
    """Return the `stacklevel` with which the caller's warning names the user's line.

    It is the first line outside of this package: a run warns at several depths.
    """
    callers = inspect.stack(context=0)[1:]
    modules = [str(caller.frame.f_globals.get("__name__")) for caller in callers]
    is_users = [name.partition(".")[0] != _PACKAGE for name in modules]
    return 1 + is_users.index(True) if any(is_users) else 1


def _agents_without_clearance(
    out: Path, cells: Iterable[Entry], world: World
) -> int | None:
    """Return the number of a world's agents whose place has no clearance.

    None if no cell of a predictor tells.
    """
    forecasts = entries_in(cells, world, kinds=("predictor",))
    if not forecasts:
        return None
    rows = read_rows(out, forecasts[0], columns=["exhausted"])
    return int(rows["exhausted"].to_numpy().sum())


def borrow(plan: Plan, *, sources: Sequence[Path], fresh: bool = False) -> None:
    """Open the folder of a run and copy cells of other runs into it.

    Each cell comes from the first of the source folders that has it: equal keys mean
    equal cells. Raises DataError if the folder cannot be written or another process
    runs in it, and SettingsError if it holds another run, which `fresh` replaces.
    """
    check_folder(plan.out)
    with locked(plan.out):
        opened = open_run(plan.out, identity=plan.identity, fresh=fresh)
        share_key(plan.out, sources)
        begun = opened.manifest | {"code": plan.code_hash, "state": "running"}
        write_manifest(plan.out, begun)
        units = pieces.missing_units(plan, file_by_cell(opened.index_by_file))
        wanted = {
            CellKey(unit.key, consumer_key)
            for unit in units
            for consumer_key in unit.consumers
        }
        for source in sources:
            for name, index in sound_files(source).index_by_file.items():
                present = file_by_cell({name: index}).keys()
                if wanted & present:
                    content = read_regular_file(source / CELLS_FOLDER / name)
                    write_checked(plan.out, name, content)
                    wanted -= present
