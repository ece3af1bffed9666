"""Compute the missing cells of a run, here, in worker processes or on a cluster."""

import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from functools import partial
from typing import NamedTuple

from evaluation.compute.current_cell import Failure
from evaluation.compute.loops import (
    COMPILED,
    COMPILING,
    LOADED,
    list_loops,
    prepare_loop_in_steps,
)
from evaluation.compute.work import FinishedCell, Work
from evaluation.plan.address import parse_label
from evaluation.plan.plan import Plan
from evaluation.plan.units import Unit
from evaluation.plan.user_plugins import has_user_plugins
from evaluation.pool.failures import FailedCell, Failures
from evaluation.pool.packing import (
    FileCollector,
    HeldCell,
    WholeFile,
    WorkResult,
    compute_files,
    expected_files,
)
from evaluation.pool.pieces import (
    CellName,
    cell_name,
    cut_for_cluster,
    cut_work,
    planned_cells,
)
from evaluation.pool.workers import dismiss, spread
from evaluation.store.checksums import write_checked
from isac_track.command_line import check_interrupt


class ComputedCells(NamedTuple):
    """What came of the missing cells, beside their files."""

    failed: list[FailedCell]
    # Time that compiling the loops took, s; None on a cluster, which is not known.
    compiling_s: float | None


def compute_missing(
    units: Sequence[Unit],
    plan: Plan,
    progress: Callable[[int, int, str], None],
    names: Mapping[str, str],
) -> ComputedCells:
    """Compute the cells of missing units, and write their files.

    Each file is written as soon as all of its cells are finished, or have failed.
    """
    works = deque(cut_work(units, plan))
    total = sum(len(unit.consumers) for unit in units)
    compiling_s = None
    if plan.settings.scheduler is None:  # a cluster's workers compile for themselves
        compiling_s = _prepare_loops(works, plan, partial(progress, 0, total))
    failures, finished = Failures(), set[CellName]()
    shown = set[CellName]()  # Those that are held by a worker, too.
    if not works:
        return ComputedCells(failures.cells, compiling_s)
    first_cell = next(planned_cells(works[0]))
    progress(0, total, _describe_cell(cell_name(first_cell)))
    collector = FileCollector(expected_files(units, plan.code_digests), names)
    with closing(_spread_works(works, plan, collector)) as computed:
        for work, result in computed:
            if isinstance(result, Failure):
                n_before = len(failures.cells)
                works.extend(failures.work_after(work, result, finished=finished))
                for failed in failures.cells[n_before:]:
                    shown.add(cell_name(failed.cell))
                    _write_file(plan, collector.add(cell_name(failed.cell), None))
                continue
            if isinstance(result, HeldCell):
                cells: Sequence[CellName] = (result.cell,)
            else:
                cells = _take_cells(result, collector, plan)
                finished.update(cells)
            check_interrupt()
            shown.update(cells)
            progress(len(shown), total, _describe_cell(cells[-1]))
    return ComputedCells(failures.cells, compiling_s)


def _take_cells(
    result: WholeFile | FinishedCell, collector: FileCollector, plan: Plan
) -> Sequence[CellName]:
    """Write the file that a result completes, if any; return the cells of the result."""
    if isinstance(result, WholeFile):
        _write_file(plan, result)
        return result.cells
    name = cell_name(result)
    _write_file(plan, collector.add(name, result))
    return (name,)


def _spread_works(
    works: deque[Work], plan: Plan, collector: FileCollector
) -> Generator[tuple[Work, WorkResult]]:
    """Yield each result with its work, from this machine or from a Dask cluster."""
    compute = partial(
        compute_files,
        files=collector.files,
        names=collector.names,
        tracks=plan.scene_tracks,
        stages=plan.settings.stages,
        seed=plan.settings.seed,
    )
    scheduler = plan.settings.scheduler
    if scheduler is None:
        return spread(
            compute,
            works,
            jobs=plan.jobs,
            limit_s=plan.settings.cell_timeout_s,
            in_workers=has_user_plugins(plan.axes),
        )
    from evaluation.pool.dask import spread_on_cluster  # noqa: PLC0415 - an extra

    cut_for_cluster(works)
    modules = plan.code_digests.keys()
    return spread_on_cluster(compute, works, scheduler=scheduler, modules=modules)


def _prepare_loops(
    works: Iterable[Work], plan: Plan, report: Callable[[str], None]
) -> float:
    """Compile the loops that the cells call, or load them; return the time of it, s.

    The time is 0 if all were loaded. Workers that had to compile end here: each keeps
    half a gigabyte for it.
    """
    cells = (cell for work in works for cell in planned_cells(work))
    loops = list_loops((cell.mechanism, cell.consumer) for cell in cells)
    in_workers = has_user_plugins(plan.axes) or plan.settings.cell_timeout_s is not None
    started, states = time.monotonic(), dict[str, str]()
    prepared = spread(
        prepare_loop_in_steps,
        deque(loops),
        jobs=plan.jobs,
        limit_s=None,
        in_workers=in_workers,
    )
    with closing(prepared):
        for loop, state in prepared:
            states[loop] = LOADED if isinstance(state, Failure) else state
            if {COMPILING, COMPILED} & {*states.values()}:
                n_ready = len(states) - [*states.values()].count(COMPILING)
                report(f"compiling, once: {n_ready} of {len(loops)} loops")
    if COMPILED not in states.values():
        return 0.0
    dismiss()
    return time.monotonic() - started


def _describe_cell(name: CellName) -> str:
    """Return a cell in words: of linkage if its consumer's label begins with a task."""
    address = parse_label(name.label)
    stage = "linkage" if address.task else "patrols" if address.policy else "scenes"
    return f"{stage}: {name.spec} > {name.label}"


def _write_file(plan: Plan, file: WholeFile | None) -> None:
    if file is not None:
        write_checked(plan.out, file.name, file.content)
