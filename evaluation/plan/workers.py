"""The number of workers of a run: as many as it has work for, or a core each."""

import os
from typing import Final

from evaluation.plan.axes import Axes
from evaluation.plan.constants import BLOCK_SCENES
from evaluation.plan.settings import Settings

MOST_DEFAULT_JOBS: Final = 8  # Unless more are asked for: each takes a few hundred MB.
WORTH_WORKERS: Final = 5000
"""Scenes times levels: fewer take less time than workers to start."""
WORTH_WORKERS_LINKED: Final = 400
"""Linkers of all tasks times levels: the same."""


def most_workers(run_axes: Axes, settings: Settings) -> int:
    """Return the number of workers that a run has work for, finished or not."""
    scenes, linkage = run_axes.scenes, run_axes.linkage
    n_scenes = 0 if scenes.why_left_out else settings.n_all_scenes
    n_blocks = -(-n_scenes // BLOCK_SCENES)
    worlds = [run_axes.mechanisms, *scenes.mechanisms_by_world.values()]
    n_levels = sum(len(levels) for levels in worlds)
    linked_worlds = [linkage.mechanisms, *linkage.mechanisms_by_world.values()]
    n_linked = sum(len(levels) for levels in linked_worlds)
    n_tasks = len(linkage.tasks) + len(linkage.return_consumers)
    n_patrols = len(run_axes.patrols.mechanisms) + len(run_axes.tracks.mechanisms)
    return max(n_blocks * n_levels + n_tasks * n_linked + n_patrols, 1)


def choose_jobs(run_axes: Axes, settings: Settings) -> int:
    """Return the number of workers: as asked, or a core each if it is worth it."""
    if settings.jobs is not None:
        return min(settings.jobs, max(most_workers(run_axes, settings), 2))
    n_levels = len(run_axes.mechanisms)
    linkage = run_axes.linkage
    # Without the descriptors of windows, which every task has.
    n_linkers = len(linkage.all_consumers) - len(linkage.tasks)
    if (
        settings.n_all_scenes * n_levels < WORTH_WORKERS
        and n_levels * n_linkers < WORTH_WORKERS_LINKED
    ):
        return 1
    return usual_jobs()


def usual_jobs() -> int:
    """Return the workers of a run with enough work: a core each, up to a limit."""
    cores = os.cpu_count()
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    return min(cores or 1, MOST_DEFAULT_JOBS)
