"""Sessions of a linkage task: two sets of true windows, and the people to learn from.

Victims, people to learn from and people to calibrate on never share a walking group.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.random import Generator

from attacks.tasks.task_list import Task
from isac_track.types import Bools, Floats, Ints, Tracks, read_only

N_FOLDS = 2
# Share of the people to learn from that is set aside to calibrate scores.
CALIBRATING_SHARE = 1 / 3
COLUMNS: Final[Mapping[str, tuple[int, ...]]] = {
    "queue_place": (0, 1),
    "walking_direction": (2,),
    "run_density": (3,),
    "run_time": (4,),
    "walk_length": (5,),
}
"""By control, columns of `Windows.circumstances`: of the run, not of the person."""


@dataclass(frozen=True, eq=False, slots=True)
class Windows:
    """N stretches of true walks, M samples in all, where they are sensed."""

    t: Floats  # (M,) s
    xy: Floats  # (M, 2) m
    offsets: Ints  # (N + 1,)
    person: Ints  # (N,) row in the people of the `Sessions`.
    search: Ints  # (N,) search of each window; it has the candidates of its probes.
    # (N, 6) as of `measure_circumstances`, where a task controls for them.
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
class Sessions:
    """Both sides of a task, still true, and the people to learn from."""

    task: Task
    source: tuple[str, ...]  # (K,) id of each person's recorded track.
    group: tuple[str, ...]  # (K,) cluster: people who walk together, in either session.
    alone: Bools  # (K,) False for members of a walking group, whose walks are similar.
    moving: Bools  # (K,) False for nearly frozen annotations.
    probe: Windows
    gallery: Windows
    mate: Ints  # (P,) gallery window of the same person in the same search, or -1.
    fold: Ints  # (S,) half of each search; its adversary learns on the other half.
    # (S,) name of each search: a half of the people, or the instant of a handover.
    searches: tuple[str, ...]
    learns: Bools
    """(2, K) people from whom the adversary of either fold learns.

    In a task of few people who come back, (K, K): the adversary of each person.
    """
    # As `learns`: people on whose scores those of a fold are calibrated.
    calibrates: Bools
    too_short: int
    """Recorded tracks left out: shorter than the windows, or absent at the time."""
    not_drawn: int  # Further tracks left out, beyond `linkage.most_people`.

    def __post_init__(self) -> None:
        for name in ("alone", "moving", "mate", "fold", "learns", "calibrates"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        # No adversary learns from a victim or from a victim's group.
        cluster = np.unique(self.group, return_inverse=True)[1]
        for fold, teachers in enumerate(self.learns | self.calibrates):
            sides = (self.probe, self.gallery)
            attacked = np.concatenate(
                [side.person[self.fold[side.search] == fold] for side in sides]
            )
            if self.task.links_returning_people:
                attacked = np.array([fold])
            if np.intersect1d(cluster[attacked], cluster[teachers]).size:
                raise AssertionError("a victim's group is among the training people")
        learnt = cluster[self.learns.any(axis=0)]
        calibrating = cluster[self.calibrates.any(axis=0)]
        if np.intersect1d(learnt, calibrating).size:
            raise AssertionError("scores are calibrated on people who were learnt from")


def halves(group: tuple[str, ...], *, rng: Generator) -> Ints:
    """Return the half of each person, (K,) 0 or 1: whole groups, similar sizes."""
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
    """Split the people of each fold: to learn from, and to calibrate on, (2, K) each.

    `may_teach`, (2, K), tells the people of each fold. Groups stay whole.
    """
    cluster = np.unique(group, return_inverse=True)[1]
    calibrates = np.zeros_like(may_teach)
    for fold, teachers in enumerate(may_teach):
        clusters = rng.permutation(np.unique(cluster[teachers]))
        # At least one group calibrates, if another group remains to learn from.
        few = min(max(round(CALIBRATING_SHARE * clusters.size), 1), clusters.size - 1)
        calibrates[fold] = teachers & np.isin(cluster, clusters[: max(few, 0)])
    return may_teach & ~calibrates, calibrates


def measure_circumstances(tracks: Tracks, rows: Ints, windows: Windows) -> Floats:
    """Return six properties of each window that do not depend on its person, (N, 6).

    `rows`, (N,), are the tracks that the windows are cut from. The columns are:

    - 0, 1: the place in the queue when the session begins, on a circle: cosine and sine
      of the rank by bearing from the session's middle;
    - 2: the direction of walking round that middle, -1 to 1;
    - 3: the number of people present;
    - 4: the time, s from the session's start;
    - 5: how long the whole track lasts, s.
    """
    assert tracks.session is not None
    session = np.array(tracks.session)
    first, last = tracks.offsets[:-1], tracks.offsets[1:] - 1
    values = np.empty((rows.size, 6))
    for n, row in enumerate(rows.tolist()):
        in_run = np.flatnonzero(session == session[row])
        middle_m = tracks.xy[first[in_run[0]] : last[in_run[-1]] + 1].mean(axis=0)
        bearing = np.arctan2(*(tracks.xy[first[in_run]] - middle_m).T)
        turn = 2.0 * np.pi * float((bearing < bearing[in_run == row]).mean())
        t = windows.t[windows.offsets[n] : windows.offsets[n + 1]]
        walk = slice(first[row], last[row] + 1)
        x = np.interp(t, tracks.t[walk], tracks.xy[walk, 0])
        y = np.interp(t, tracks.t[walk], tracks.xy[walk, 1])
        out, step = (x + 1j * y - complex(*middle_m))[:-1], np.diff(x + 1j * y)
        began = tracks.t[first[in_run]] <= t.mean()
        present = began & (tracks.t[last[in_run]] >= t.mean())
        values[n] = (
            np.cos(turn),
            np.sin(turn),
            (out.conj() * step).imag.sum() / max(float(np.abs(out * step).sum()), 1e-9),
            present.sum(),
            t.mean() - tracks.t[first[in_run]].min(),
            tracks.t[last[row]] - tracks.t[first[row]],
        )
    return values
