"""The two releases of a linkage task, still true: windows of walks, and who is who in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from isac_track.types import read_only

if TYPE_CHECKING:
    from attacks.tasks.task_list import Task
    from isac_track.types import Bools, Floats, Ints

N_FOLDS = 2


@dataclass(frozen=True, eq=False, slots=True)
class Windows:
    """N stretches of true walks, M samples in all, where they are sensed."""

    t: Floats
    """(M,) s"""
    xy: Floats
    """(M, 2) m"""
    offsets: Ints
    """(N + 1,)"""
    person: Ints
    """(N,) row in the people of the `Sessions`."""
    search: Ints
    """(N,) which search it belongs to: candidates are compared within one."""

    def __post_init__(self) -> None:
        for name in ("t", "xy", "offsets", "person", "search"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def __len__(self) -> int:
        return self.offsets.size - 1


@dataclass(frozen=True, eq=False, slots=True)
class Sessions:
    """Both releases of a task, still true, and who may learn from whom."""

    task: Task
    source: tuple[str, ...]
    """(K,) id of each person's recorded track."""
    group: tuple[str, ...]
    """(K,) cluster: people who walk together, in either session."""
    alone: Bools
    """(K,) False for members of a walking group, who move alike."""
    moving: Bools
    """(K,) False for nearly frozen annotations."""
    probe: Windows
    gallery: Windows
    mate: Ints
    """(P,) gallery window of the same person in the same search, or -1."""
    fold: Ints
    """(S,) half of each search; its adversary learns on the other half."""
    searches: tuple[str, ...]
    """(S,) for people: a fold's number, or the instant of a handover."""
    learns: Bools
    """(2, K) people from whom the adversary of either fold learns."""
    calibrates: Bools
    """(2, K) people on whose scores those of either fold are calibrated."""
    too_short: int
    """Recorded tracks that are left out: shorter than the windows, or not there at the time."""
    not_drawn: int
    """Further ones beyond `linkage.most_people`."""

    def __post_init__(self) -> None:
        for name in ("alone", "moving", "mate", "fold", "learns", "calibrates"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        # Nobody is attacked by who learnt from them or from their group.
        cluster = np.unique(self.group, return_inverse=True)[1]
        for fold in range(N_FOLDS):
            teaches = cluster[self.learns[fold] | self.calibrates[fold]]
            for side in (self.probe, self.gallery):
                attacked = side.person[self.fold[side.search] == fold]
                if np.intersect1d(cluster[attacked], teaches).size:
                    raise AssertionError("a victim's group is among the training people")
        learnt, known = (cluster[each.any(axis=0)] for each in (self.learns, self.calibrates))
        if np.intersect1d(learnt, known).size:
            raise AssertionError("scores are calibrated on people who were learnt from")
