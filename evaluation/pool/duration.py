"""Estimate the duration of a plan from measured rates of its parts, for `--dry-run`."""

import json
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from statistics import median
from types import MappingProxyType
from typing import Final, TypeAlias

import numpy as np

from evaluation.compute.plugin_call import PluginTime
from evaluation.compute.work import (
    PatrolWork,
    ReturnWork,
    SceneWork,
    TrackingWork,
    Work,
)
from evaluation.plan.consumer import Consumer
from evaluation.plan.plan import Plan
from evaluation.pool.pieces import cut_work, missing_in_folder, n_pairs, planned_cells
from isac_track.types import Tracks

RATES: Final = "rates.json"
"""Name of the file of rates: see `measured_rates`."""
PluginTimes: TypeAlias = Mapping[tuple[str, str], PluginTime]
"""Times of a user's plug-ins by kind and SPEC; a linker's kind is `linkage`."""
NO_TIMES: Final[PluginTimes] = MappingProxyType({})
_START_S: Final = 3.0  # Imports, and the first worker.
_REPORT_SHARE: Final = 0.12  # Of the time of the cells, as the progress bar has it.
_MINUTES_FROM_S: Final = 120.0  # Shorter durations are given in seconds.
_HOURS_FROM_S: Final = 7200.0
_REPORT_S: Final = 3.0  # Of the smallest run: tables, figures and page.


def expected_s(plan: Plan, own: PluginTimes = NO_TIMES) -> float:
    """Return the expected duration of a plan, s, on as many idle cores as workers.

    Finished cells take no time. A plug-in of a user's own counts as the median of the
    built-in of its kind; its measured time, if `own` has it, comes on top. Loops
    that are still to be compiled are not counted.
    """
    return wall_s(cells_cpu_s(plan, own), jobs=plan.jobs)


def wall_s(cpu_s: float, *, jobs: int) -> float:
    """Return the duration of a run, s, from the CPU time of its cells."""
    return _START_S + (1.0 + _REPORT_SHARE) * cpu_s / max(jobs, 1) + _REPORT_S


def cells_cpu_s(plan: Plan, own: PluginTimes = NO_TIMES) -> float:
    """Return the CPU time of the missing cells of a plan, s."""
    missing = plan.units if plan.settings.fresh else missing_in_folder(plan)
    rates, cpu_s = measured_rates(), 0.0
    for work in cut_work(missing, plan):
        rate = rates[setup_name(work)]
        rate += sum(_rate(cell.consumer, rates) for cell in planned_cells(work))
        cpu_s += rate * work_size(work, plan)
        cpu_s += _own_s(work, plan, own) if own else 0.0
    return cpu_s


def _own_s(work: Work, plan: Plan, own: PluginTimes) -> float:
    """Return the CPU time of a user's plug-ins in a piece of work, s."""
    n_samples = _millions_of_samples(work, plan)
    sizes = {"linkage": work_size(work, plan)}  # all others read samples, not pairs
    calls = [("mechanism", mechanism) for mechanism, _ in work.levels]
    consumers = [cell.consumer for cell in planned_cells(work)]
    calls += [
        ("attack" if plugin is consumer.reconstruction else consumer.kind, plugin)
        for consumer in consumers
        for plugin in consumer.plugins
    ]
    return sum(
        own[kind, plugin.spec].cell_s(sizes.get(kind, n_samples))
        for kind, plugin in calls
        if (kind, plugin.spec) in own
    )


def _millions_of_samples(work: Work, plan: Plan) -> float:
    """Return the millions of samples that are shared at a level of a work.

    For linkage these are samples of both sides, where `work_size` counts pairs.
    """
    if isinstance(work, SceneWork | PatrolWork | TrackingWork):
        return work_size(work, plan)
    if isinstance(work, ReturnWork):
        return float(work.passages.offsets[-1]) / 1e6
    sides = work.task_windows.probe, work.task_windows.gallery
    return sum(float(side.offsets[-1]) for side in sides) / 1e6


def in_words(seconds: float, *, jobs: int) -> str:
    """Return a duration in words: `about 25 s on 2 cores`."""
    cores = "1 core" if jobs == 1 else f"{jobs} cores"
    if seconds < _MINUTES_FROM_S:
        return f"about {_rounded(seconds):.0f} s on {cores}"
    if seconds < _HOURS_FROM_S:
        return f"about {seconds / 60:.0f} min on {cores}"
    return f"about {seconds / 3600:.1f} h on {cores}"


def _rounded(seconds: float) -> float:
    """Return seconds to the nearest five: more digits are not known."""
    return 5.0 * max(round(seconds / 5.0), 1)


def work_size(work: Work, plan: Plan) -> float:
    """Return the millions of samples, or of pairs, that a consumer reads of a work.

    On a patrol each robot reads the last samples of people at each query: the
    person-seconds of the recording, once for each robot. Passages of people who come
    back are compared once for each of these people, who is left out. Tracks have the
    samples of people at all scans, once for each seed.
    """
    if isinstance(work, ReturnWork):
        n_passages, n_people = len(work.passages), work.passages.returning.size
        return (n_people + 1) * n_passages**2 / 1e6
    if isinstance(work, TrackingWork):
        stages = plan.settings.stages
        tracks, segment_s = work.recorded, stages.patrol.segment_s
        share = min(1.0, segment_s / float(tracks.t.max() - tracks.t.min()))
        n_samples = share * _present_s(tracks) / stages.patrol.scan_s
        return n_samples * stages.tracking.seeds / 1e6
    if isinstance(work, PatrolWork):
        rules = plan.settings.stages.patrol
        n_queries = _present_s(work.recorded) / rules.query_s
        return n_queries * rules.robots * rules.fleets / 1e6
    if isinstance(work, SceneWork):
        return work.order.size * float(np.diff(plan.scene_tracks.offsets).mean()) / 1e6
    return n_pairs(work) / 1e6


def _present_s(tracks: Tracks) -> float:
    """Return the person-seconds of a recording."""
    present_s = tracks.t[tracks.offsets[1:] - 1] - tracks.t[tracks.offsets[:-1]]
    return float(present_s.sum())


def setup_name(work: Work) -> str:
    """Return the name of the rate of all that the levels of a work share."""
    if isinstance(work, ReturnWork):
        return "setup/returns"
    if isinstance(work, PatrolWork):
        return "setup/patrol"
    if isinstance(work, TrackingWork):
        return "setup/tracking"
    return "setup/scenes" if isinstance(work, SceneWork) else "setup/linkage"


def rate_name(consumer: Consumer) -> str:
    """Return the name of a consumer's rate: its kind and its plug-ins' families."""
    families = "@".join(plugin.family for plugin in consumer.plugins)
    return f"{consumer.kind_in_files}/{families or consumer.control}".rstrip("/")


def measured_rates() -> Mapping[str, float]:
    """Return the CPU time of each part on an idle machine, by its name.

    In s per million samples, or per million pairs of a linkage task: per unit of
    `work_size`. A name is that of `setup_name` or `rate_name`. A consumer without a
    rate counts as the median of its kind, so that each kind has one.
    `python -m benchmarks.rates` measures them.
    """
    path = files("evaluation.pool") / RATES
    rates: dict[str, float] = json.loads(path.read_text(encoding="utf-8"))
    return rates


def _rate(consumer: Consumer, rates: Mapping[str, float]) -> float:
    """Return a consumer's rate, or the median of its kind if it was not measured."""
    name = rate_name(consumer)
    if name in rates:
        return rates[name]
    kind = f"{consumer.kind_in_files}/"
    same_kind = [rate for known, rate in rates.items() if known.startswith(kind)]
    return median(same_kind or [0.0])


def rates_path(root: Path) -> Path:
    """Return where a checkout keeps the measured rates."""
    return root / "evaluation" / "pool" / RATES
