"""Build the sessions of a linkage task: windows of true walks, and their mates.

Sensing, sharing and the frames that an adversary sees come later.
"""

from collections.abc import Callable, Mapping
from typing import Final

from attacks.tasks.draft import Draft
from attacks.tasks.handover import handover
from attacks.tasks.paired_windows import PAIRED, joined, samples_at_shares
from attacks.tasks.sessions import N_FOLDS, Sessions
from attacks.tasks.task_list import Task, task_named
from isac_track.config import StageSettings
from isac_track.datasets import load
from isac_track.errors import DataError
from isac_track.place import placed_together
from isac_track.types import Tracks

__all__ = ["joined", "make_sessions", "samples_at_shares"]
_MAKERS: Final[Mapping[str, Callable[[Draft], Sessions]]] = {
    make.__name__: make for make in (*PAIRED, handover)
}
"""The function that makes the sessions of a task, by the task's family."""


def make_sessions(
    task: Task,
    *,
    tracks: Tracks,
    stages: StageSettings,
    seed: int,
    later: Tracks | None = None,
) -> Sessions:
    """Return the sessions of a task: of the recording, or of the two-session crowd.

    `later` is the second session, unless it is that of the bundled crowd. DataError if
    there are too few people for the task, or if a half of them has nobody to link or to
    learn from; SettingsError if there is no task of this name.
    """
    make = _MAKERS[task_named(task.name).family]
    if task.simulated and later is None:
        crowd = _crowd(stages.linkage.trait_strength)
        tracks, later = placed_together(crowd, settings=stages)
    sessions = make(
        Draft(
            task=task, tracks=tracks, later=later or tracks, settings=stages, seed=seed
        )
    )
    if task.links_returning_people:
        return sessions
    mated = sessions.mate >= 0
    fold = sessions.fold[sessions.probe.search[mated]]
    person = sessions.probe.person[mated]
    for half in range(N_FOLDS):
        victims, others = person[fold == half], person[fold != half]
        if victims.size < 2 or not sessions.learns[half][others].any():  # noqa: PLR2004 - linking takes two
            raise DataError(
                f"task {task.name}: half of the people have no mate, or no other people"
                " to train on, since too many share a walking group or are present all"
                " the time; use a recording of more people or leave the task out"
                " (--task)"
            )
    return sessions


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
