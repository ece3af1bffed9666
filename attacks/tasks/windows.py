"""The windows of a linkage task: both sides, their mates, and the people to train on."""

from dataclasses import dataclass

import numpy as np

from attacks.tasks.task_list import Task
from isac_track.types import Bools, Floats, Ints, read_only


@dataclass(frozen=True, eq=False, slots=True)
class Windows:
    """N windows of one side, M samples in all: true positions, before any sensing."""

    t: Floats  # (M,) s
    xy: Floats  # (M, 2) m
    offsets: Ints  # (N + 1,) first sample of each window, then M.
    person: Ints  # (N,) row among the K people of `TaskWindows`.
    search: Ints  # (N,) number of the search that the window is part of.
    # (N, 6) of `measure_circumstances`, where a task controls for them.
    circumstances: Floats | None = None
    walked_m: Floats | None = None
    """(M,) m, walked since the recorded walk began; None: since its window began."""

    def __post_init__(self) -> None:
        for name in (
            "t",
            "xy",
            "offsets",
            "person",
            "search",
            "circumstances",
            "walked_m",
        ):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, read_only(value))

    def __len__(self) -> int:
        return self.offsets.size - 1


@dataclass(frozen=True, eq=False, slots=True)
class TaskWindows:
    """Both sides of a task for K people, and what each adversary is trained on.

    F is the number of folds: two, or K in a task of returning people, where every
    person is a fold. S is the number of searches, P of windows of the probe side.
    """

    task: Task
    source: tuple[str, ...]  # (K,) id of each person's recorded track.
    group: tuple[str, ...]  # (K,) cluster: people who walk together, in either session.
    alone: Bools  # (K,) False for members of a walking group, whose walks are similar.
    moving: Bools  # (K,) False for nearly frozen annotations.
    probe: Windows
    gallery: Windows
    mate: Ints  # (P,) gallery window of the same person in the same search, or -1.
    # (S,) name of each search: a half of the people, or the instant of a rotation.
    search_names: tuple[str, ...]
    fold: Ints  # (S,) fold of each search; unused in a task of returning people.
    trained_on: Bools  # (F, K) people on whom the adversary of each fold is trained.
    calibrated_on: (
        Bools  # (F, K) people on whom the scores of each fold are calibrated.
    )
    too_short: int
    """Recorded tracks left out: shorter than the windows, or absent at the time."""
    not_drawn: int  # Further tracks left out, beyond `linkage.most_people`.

    def __post_init__(self) -> None:
        for name in ("alone", "moving", "mate", "fold", "trained_on", "calibrated_on"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        self._check_roles()

    def _check_roles(self) -> None:
        """Raise AssertionError if a fold knows its victims, or the roles overlap."""
        cluster = np.unique(self.group, return_inverse=True)[1]
        for fold, known in enumerate(self.trained_on | self.calibrated_on):
            attacked = cluster[self._attacked_people(fold)]
            if np.intersect1d(attacked, cluster[known]).size:
                raise AssertionError("a victim's group is among the training people")
        trained_on = cluster[self.trained_on.any(axis=0)]
        calibrated_on = cluster[self.calibrated_on.any(axis=0)]
        if np.intersect1d(trained_on, calibrated_on).size:
            raise AssertionError("scores are calibrated on people who were learnt from")

    def _attacked_people(self, fold: int) -> Ints:
        """Return the people whom the adversary of a fold links, as rows."""
        if self.task.links_returning_people:
            return np.array([fold])
        return np.concatenate(
            [
                side.person[self.fold[side.search] == fold]
                for side in (self.probe, self.gallery)
            ]
        )
