"""Put the two sides of a task together, and say on whom each adversary is trained."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from attacks.tasks.folds import set_calibrators_aside
from attacks.tasks.task_input import TaskInput, track_rows
from attacks.tasks.windows import TaskWindows, Windows
from isac_track.datasets import summarise
from isac_track.types import Bools, Ints, Tracks


@dataclass(frozen=True, eq=False, slots=True)
class Searches:
    """The S searches of a task of K people, and their F folds."""

    names: tuple[str, ...]  # (S,)
    fold: Ints  # (S,)
    may_train_on: Bools  # (F, K) people whom the adversary of each fold may know.


def assemble(
    task_input: TaskInput,
    rows: Ints,
    *,
    group: tuple[str, ...],
    searches: Searches,
    probe: Windows,
    gallery: Windows,
    mate: Ints,
    too_short: int,
    not_drawn: int,
) -> TaskWindows:
    """Return the windows of a task whose K people have the tracks in `rows`, (K,).

    All arguments but `rows` and `searches` are fields of `TaskWindows`.
    """
    may_train_on = searches.may_train_on
    trained_on, calibrated_on = may_train_on, np.zeros_like(may_train_on)
    if not task_input.task.links_returning_people:
        trained_on, calibrated_on = set_calibrators_aside(
            may_train_on, group, rng=task_input.rng("roles")
        )
    source = tuple(task_input.tracks.source[row] for row in rows)
    alone, moving = np.ones((2, rows.size), dtype=bool)
    for tracks in (task_input.tracks, task_input.second_tracks):
        session_rows = track_rows(tracks, source)
        alone &= _are_alone(tracks)[session_rows]
        moving &= _are_moving(tracks)[session_rows]
    return TaskWindows(
        task=task_input.task,
        source=source,
        group=group,
        alone=alone,
        moving=moving,
        probe=probe,
        gallery=gallery,
        mate=mate,
        search_names=searches.names,
        fold=searches.fold,
        trained_on=trained_on,
        calibrated_on=calibrated_on,
        too_short=too_short,
        not_drawn=not_drawn,
    )


def _are_alone(tracks: Tracks) -> Bools:
    """Return whether each person walks in no group, (N,)."""
    _, cluster, sizes = np.unique(tracks.group, return_inverse=True, return_counts=True)
    return np.asarray(sizes[cluster] == 1)


# For the recording, and both sessions of the crowd; the oldest of four goes.
@lru_cache(maxsize=4)
def _are_moving(tracks: Tracks) -> Bools:
    """Return whether each track is more than a nearly frozen annotation, (N,)."""
    return np.asarray(~summarise(tracks)["frozen"].to_numpy())
