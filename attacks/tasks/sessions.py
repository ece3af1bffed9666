"""The two releases of a linkage task, still true, and who may learn from whom.

Walking groups stay whole, whoever is attacked, teaches the adversary or calibrates it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.random import Generator

from attacks.tasks.task_list import Task
from isac_track.types import Bools, Floats, Ints, Tracks, read_only

N_FOLDS = 2
CALIBRATING_SHARE = (
    1 / 3
)  # Of the people to learn from, kept apart to calibrate scores on.
COLUMNS: Final[Mapping[str, tuple[int, ...]]] = {
    "queue_place": (0, 1),
    "walking_direction": (2,),
    "run_density": (3,),
    "run_time": (4,),
    "walk_length": (5,),
}
"""What is not the person, but the run: columns of `circumstances`, by control."""


@dataclass(frozen=True, eq=False, slots=True)
class Windows:
    """N stretches of true walks, M samples in all, where they are sensed."""

    t: Floats  # (M,) s
    xy: Floats  # (M, 2) m
    offsets: Ints  # (N + 1,)
    person: Ints  # (N,) row in the people of the `Sessions`.
    search: Ints  # (N,) which search it belongs to: candidates are compared within one.
    # (N, 6) `circumstances`, where a task controls for them.
    about: Floats | None = None
    walked_m: Floats | None = None
    """(M,) m, walked since the recorded walk began; None: as if each began with its window."""

    def __post_init__(self) -> None:
        for name in ("t", "xy", "offsets", "person", "search", "about", "walked_m"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, read_only(value))

    def __len__(self) -> int:
        return self.offsets.size - 1


@dataclass(frozen=True, eq=False, slots=True)
class Sessions:
    """Both releases of a task, still true, and who may learn from whom."""

    task: Task
    source: tuple[str, ...]  # (K,) id of each person's recorded track.
    group: tuple[str, ...]  # (K,) cluster: people who walk together, in either session.
    alone: Bools  # (K,) False for members of a walking group, who move alike.
    moving: Bools  # (K,) False for nearly frozen annotations.
    probe: Windows
    gallery: Windows
    mate: Ints  # (P,) gallery window of the same person in the same search, or -1.
    fold: Ints  # (S,) half of each search; its adversary learns on the other half.
    searches: tuple[
        str, ...
    ]  # (S,) for people: a fold's number, or the instant of a handover.
    learns: Bools
    """(2, K) people from whom the adversary of either fold learns; where the task is of few who
    come back, (K, K) from whom that of each person does."""
    # as `learns`: people on whose scores those of a fold are calibrated.
    calibrates: Bools
    too_short: int
    """Recorded tracks that are left out: shorter than the windows, or not there at the time."""
    not_drawn: int  # Further ones beyond `linkage.most_people`.

    def __post_init__(self) -> None:
        for name in ("alone", "moving", "mate", "fold", "learns", "calibrates"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        # Nobody is attacked by who learnt from them or from their group.
        cluster = np.unique(self.group, return_inverse=True)[1]
        for fold, teachers in enumerate(self.learns | self.calibrates):
            sides = (self.probe, self.gallery)
            attacked = np.concatenate(
                [one.person[self.fold[one.search] == fold] for one in sides]
            )
            if self.task.comes_back:
                attacked = np.array([fold])
            if np.intersect1d(cluster[attacked], cluster[teachers]).size:
                raise AssertionError("a victim's group is among the training people")
        learnt, known = (
            cluster[each.any(axis=0)] for each in (self.learns, self.calibrates)
        )
        if np.intersect1d(learnt, known).size:
            raise AssertionError("scores are calibrated on people who were learnt from")


def halves(group: tuple[str, ...], *, rng: Generator) -> Ints:
    """Return the half of each person, (K,) 0 or 1: groups stay whole, halves are of like size."""
    names, cluster, sizes = np.unique(group, return_inverse=True, return_counts=True)
    half = np.empty(names.size, dtype=np.int64)
    count = [0, 0]
    # Large groups first, each to the smaller half.
    drawn = rng.permutation(names.size)
    for name in drawn[np.argsort(-sizes[drawn], kind="stable")]:
        half[name] = int(count[1] < count[0])
        count[half[name]] += sizes[name]
    return half[cluster]


def roles(
    group: tuple[str, ...], *, may_teach: Bools, rng: Generator
) -> tuple[Bools, Bools]:
    """Return who is learnt from and who calibrates, (2, K) each: groups stay whole."""
    cluster = np.unique(group, return_inverse=True)[1]
    calibrates = np.zeros_like(may_teach)
    for fold, teachers in enumerate(may_teach):
        clusters = rng.permutation(np.unique(cluster[teachers]))
        # One at least, where there is another one to learn from.
        few = min(max(round(CALIBRATING_SHARE * clusters.size), 1), clusters.size - 1)
        calibrates[fold] = teachers & np.isin(cluster, clusters[: max(few, 0)])
    return may_teach & ~calibrates, calibrates


def circumstances(tracks: Tracks, rows: Ints, windows: Windows) -> Floats:
    """Return what goes with each window beside its person, (N, 6).

    Of the tracks that they are cut from, `rows`, (N,): the place in the queue when the
    session begins, on a circle (cosine and sine of the rank by bearing from its
    middle); which way round that middle one walks, -1 to 1; how many people are there;
    when it is, s from the session's start; and how long the whole track lasts, s.
    """
    assert tracks.session is not None
    session = np.array(tracks.session)
    first, last = tracks.offsets[:-1], tracks.offsets[1:] - 1
    found = np.empty((rows.size, 6))
    for n, row in enumerate(rows.tolist()):
        of_run = np.flatnonzero(session == session[row])
        middle_m = tracks.xy[first[of_run[0]] : last[of_run[-1]] + 1].mean(axis=0)
        bearing = np.arctan2(*(tracks.xy[first[of_run]] - middle_m).T)
        turn = 2.0 * np.pi * float((bearing < bearing[of_run == row]).mean())
        t, walk = (
            windows.t[slice(*windows.offsets[n : n + 2])],
            slice(first[row], last[row] + 1),
        )
        x, y = (np.interp(t, tracks.t[walk], tracks.xy[walk, axis]) for axis in (0, 1))
        out, step = (x + 1j * y - complex(*middle_m))[:-1], np.diff(x + 1j * y)
        there = (tracks.t[first[of_run]] <= t.mean()) & (
            tracks.t[last[of_run]] >= t.mean()
        )
        found[n] = (
            np.cos(turn),
            np.sin(turn),
            (out.conj() * step).imag.sum() / max(float(np.abs(out * step).sum()), 1e-9),
            there.sum(),
            t.mean() - tracks.t[first[of_run]].min(),
            tracks.t[last[row]] - tracks.t[first[row]],
        )
    return found
