"""What is to be linked: windows of true walks, and who is who in them.

All start from the recorded tracks; sensing, sharing and the frames that an adversary sees come
later. Where a task hides the frame, each window is first put in another place of the recording:
sensed twice in one place, a walk would be known by its distance from the base station, on which
the noise depends. `attacks.tasks.task_list` says which tasks there are.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from attacks.tasks.draft import Draft
from attacks.tasks.sessions import N_FOLDS
from attacks.tasks.task_list import task_named
from isac_track.datasets import load
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable

    from attacks.tasks.sessions import Sessions
    from attacks.tasks.task_list import Task
    from isac_track.config import StageSettings
    from isac_track.types import Tracks


def sessions_of(task: Task, *, tracks: Tracks, stages: StageSettings, seed: int) -> Sessions:
    """Return the sessions of a task: of the recording, or of the two-session crowd.

    Raises
    ------
    DataError
        If there are too few people for the task.
    """
    later = None
    if task.simulated:
        tracks, later = _crowd(stages.linkage.trait_strength)
    return build(task, tracks=tracks, later=later, settings=stages, seed=seed)


def _crowd(trait_strength: float) -> tuple[Tracks, Tracks]:
    """Return the two sessions of the crowd: the bundled ones, or simulated anew."""
    if trait_strength == 1.0:
        return load("plaza").tracks, load("plaza-session2").tracks
    from isac_track.datasets.crowd import BUNDLED_SEED, generate  # noqa: PLC0415 - seldom needed
    from isac_track.datasets.crowd.plan import CrowdSettings  # noqa: PLC0415

    crowd = CrowdSettings(trait_strength=trait_strength)
    first, second = (generate(crowd, seed=BUNDLED_SEED, session=number) for number in (1, 2))
    return first, second


def build(
    task: Task, *, tracks: Tracks, later: Tracks | None, settings: StageSettings, seed: int
) -> Sessions:
    """Return the two sessions of a task.

    Parameters
    ----------
    task : Task
    tracks : Tracks
        The recording; for ``new_traversal`` the crowd's first session.
    later : Tracks or None
        The crowd's second session.
    settings : StageSettings
    seed : int

    Raises
    ------
    DataError
        If the recording has too few people for the task, or a half of them has nobody to link, or
        nobody to learn from.
    SettingsError
        If there is no task of this name.
    """
    module, _, function = task_named(task.name).maker.partition(":")
    make: Callable[[Draft], Sessions] = getattr(import_module(module), function)
    found = make(Draft(task=task, tracks=tracks, later=later, settings=settings, seed=seed))
    mated = found.mate >= 0
    fold, person = found.fold[found.probe.search[mated]], found.probe.person[mated]
    for half in range(N_FOLDS):
        mine, others = person[fold == half], person[fold != half]
        if mine.size < 2 or not found.learns[half][others].any():  # noqa: PLR2004 - one alone has no other
            raise DataError(
                f"task {task.name}: half of the people has nobody to link, or nobody "
                "else to learn from: too many belong to one walking group, or are there all the "
                "time; use a recording of more people or leave the task out (--task)"
            )
    return found
