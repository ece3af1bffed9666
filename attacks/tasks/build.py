"""Build the windows of a linkage task from recorded tracks.

Sensing, sharing and the frames that an adversary sees come later.
"""

from collections.abc import Callable, Mapping
from typing import Final

from attacks.tasks.cross_session import cross_session
from attacks.tasks.folds import N_FOLDS
from attacks.tasks.handover import handover
from attacks.tasks.paired_windows import PAIRED
from attacks.tasks.task_input import TaskInput
from attacks.tasks.task_list import Task, task_named
from attacks.tasks.windows import TaskWindows
from isac_track.config import StageSettings
from isac_track.datasets import load
from isac_track.errors import DataError
from isac_track.place import placed_together
from isac_track.types import Tracks

_MAKERS: Final[Mapping[str, Callable[[TaskInput], TaskWindows]]] = {
    **PAIRED,
    "cross_session": cross_session,
    "handover": handover,
}
"""The function that makes the windows of a task, by the task's family."""


def make_task_windows(
    task: Task,
    *,
    tracks: Tracks,
    stages: StageSettings,
    seed: int,
    second_tracks: Tracks | None = None,
) -> TaskWindows:
    """Return the windows of a task: of the recording, or of the two-session crowd.

    `second_tracks` is the second session, unless it is that of the bundled crowd.
    DataError if there are too few people for the task, or if a fold of them has nobody
    to link or to train on; SettingsError if there is no task of this name.
    """
    make = _MAKERS[task_named(task.name).family]
    if task.simulated and second_tracks is None:
        crowd = _crowd(stages.linkage.trait_strength)
        tracks, second_tracks = placed_together(crowd, settings=stages)
    task_windows = make(
        TaskInput(
            task=task,
            tracks=tracks,
            second_tracks=second_tracks or tracks,
            settings=stages,
            seed=seed,
        )
    )
    if not task.links_returning_people:
        _check_folds(task_windows)
    return task_windows


def _check_folds(task_windows: TaskWindows) -> None:
    """Raise DataError if a fold has nobody to link, or nobody to train on."""
    mated = task_windows.mate >= 0
    fold = task_windows.fold[task_windows.probe.search[mated]]
    person = task_windows.probe.person[mated]
    for number in range(N_FOLDS):
        victims, others = person[fold == number], person[fold != number]
        can_train = task_windows.trained_on[number][others].any()
        if victims.size < 2 or not can_train:  # noqa: PLR2004 - linking takes two
            raise DataError(
                f"task {task_windows.task.name}: half of the people have no mate, or no"
                " other people to train on, since too many share a walking group or are"
                " present all the time; use a recording of more people or leave the"
                " task out (--task)"
            )


def _crowd(trait_strength: float) -> tuple[Tracks, Tracks]:
    """Return the two sessions of the crowd: the bundled files, or simulated anew."""
    if trait_strength == 1.0:
        return load("plaza").tracks, load("plaza-session2").tracks
    from isac_track.datasets.crowd import (  # noqa: PLC0415 - seldom needed
        BUNDLED_SEED,
        CrowdSettings,
        generate,
    )

    crowd = CrowdSettings(trait_strength=trait_strength)
    first, second = (
        generate(crowd, seed=BUNDLED_SEED, session=number) for number in (1, 2)
    )
    return first, second
