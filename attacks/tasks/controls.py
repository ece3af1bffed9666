"""Controls of linkage: what every attack is held against, and what no task may reveal.

Two controls must stay at chance whatever the task: random scores, and the scores of a
real attack with the mates shuffled. The others are the *shortcut audit*: each sees one
thing that has nothing to do with how a person walks. If it differs from chance, in
either direction, the task gives people away by a side door, and what an attack achieves
there is no measure of anything.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeAlias

import numpy as np
from numpy.random import Generator

from attacks.tasks.sessions import COLUMNS
from attacks.tasks.task_list import Task
from isac_track.sensing import intervals_before
from isac_track.types import Floats, Ints, Release

Score: TypeAlias = Callable[[Release, Release, Generator], Floats]
_NO_SIGMA_M = 1e-9
_NEIGHBOURS = 5
_DECIMALS = 9  # Of a noise level: many are at the cap, equal but for rounding.


@dataclass(frozen=True, slots=True)
class Control:
    """A linker that must not succeed."""

    about: str
    score: Score | None
    """From probe, gallery and a stream to scores (P, G), higher = more alike; None: the scores
    of an attack, with shuffled mates."""
    # The same in the true frame, if it must look another way there.
    in_scene: Score | None = None
    is_audit: bool = True
    # Whether it sees what a task in the true frame shows on purpose.
    hides_in_scene: bool = False
    is_evidence_live: bool = False
    """Whether what it sees is evidence where both sides show one time of one walk: there it is an
    ablation, of what a linker could do by this alone, and no shortcut."""
    # Whether all levels that share every sample are alike to it.
    sees_times_only: bool = False
    circumstance: tuple[
        int, ...
    ] = ()  # Columns of `circumstances`, which it sees instead.

    def applies(self, task: Task) -> bool:
        """Whether a task has this control."""
        if self.circumstance:
            return task.comes_back
        return not (self.hides_in_scene and task.shows_scene)

    def audits(self, task: Task) -> bool:
        """Whether what it links in a task is a shortcut, which makes the task say nothing."""
        return self.is_audit and not (self.is_evidence_live and task.is_one_time)

    def scorer(self, task: Task) -> Score | None:
        """Return what scores in a task."""
        return (
            self.in_scene
            if task.shows_scene and self.in_scene is not None
            else self.score
        )


def _alike(features: Callable[[Release], Floats]) -> Score:
    """Return what scores the closeness of what features of tracks, (N,) or (N, F), tell."""

    def score(probe: Release, gallery: Release, _rng: Generator) -> Floats:
        return closeness(
            *(features(one).reshape(len(one), -1) for one in (probe, gallery))
        )

    return score


def closeness(first: Floats, second: Floats) -> Floats:
    """Return minus the distance of features, (P, F) and (G, F), each scaled by its spread."""
    spread = np.concatenate([first, second]).std(axis=0)
    square = np.zeros((len(first), len(second)))
    # One by one: the gaps of thousands of people in all features at once are a
    # gigabyte.
    for one, other, width in zip(first.T, second.T, spread.tolist(), strict=True):
        gap = (one[:, None] - other) / (width if width > 0 else 1.0)
        square += np.square(gap, out=gap)
    return np.negative(np.sqrt(square, out=square), out=square)


def _means(values: Floats, release: Release) -> Floats:
    """Return the mean of each track's values, (N,) or (N, 2)."""
    total = np.add.reduceat(values, release.offsets[:-1])
    return np.asarray((total.T / np.diff(release.offsets)).T)


def _sampling_times(release: Release) -> Floats:
    step_s, starts = (
        intervals_before(t=release.t, offsets=release.offsets),
        release.offsets[:-1],
    )
    extremes = (each.reduceat(step_s, starts) for each in (np.minimum, np.maximum))
    return np.column_stack(
        [_means(step_s, release), _means(step_s**2, release), *extremes]
    )


def _noise(release: Release) -> Floats:
    """Return the mean logarithm of each track's declared noise, (N, 1).

    How far it ranges within a track tells how far the person walked, which is no
    shortcut.
    """
    assert release.sigma is not None  # a control sees all that is declared
    level = _means(np.log(np.maximum(release.sigma, _NO_SIGMA_M)), release)
    return np.asarray(np.round(level, _DECIMALS)[:, None])


def _over_neighbours(release: Release) -> Floats:
    """Return each track's noise level less the mean of its nearest few, (N, 1), of one release.

    In the true frame noise that grows with the distance from the base station is but
    the place.
    """
    from scipy.spatial import cKDTree  # noqa: PLC0415 - heavy, and used here alone

    level, few = _noise(release), min(_NEIGHBOURS, len(release) - 1)
    # Of levels that are all alike only rounding would be left, which goes by the place.
    if few == 0 or np.ptp(level) < _NO_SIGMA_M:
        return np.zeros_like(level)
    middle_m = _means(release.xy, release)
    nearest: Ints = np.asarray(cKDTree(middle_m).query(middle_m, k=few + 1)[1])
    # The first is the track itself, or somebody in the very same place.
    around = level[nearest[:, 1:], 0].mean(axis=1)[:, None]
    return np.asarray(np.round(level - around, _DECIMALS))


def _frame(release: Release) -> Floats:
    """Return where each track lies and where it heads: from its first half to its second."""
    first, sizes = release.offsets[:-1], np.diff(release.offsets)[:, None]
    total = np.add.reduceat(release.xy, first)
    halves = np.column_stack([first, first + sizes[:, 0] // 2]).ravel()
    late = np.add.reduceat(release.xy, halves)[1::2]
    # A track of one sample has no first half: it stands where it is.
    early = np.where(sizes > 1, total - late, total) / np.maximum(sizes // 2, 1)
    late /= sizes - sizes // 2
    way = late - early
    length_m = np.hypot(way[:, 0], way[:, 1])[:, None]
    heading = np.divide(way, length_m, out=np.zeros_like(way), where=length_m > 0)
    return np.column_stack([(early + late) / 2.0, heading])


_Times = partial(Control, sees_times_only=True)
CONTROLS: Final[Mapping[str, Control]] = {
    "random": Control(
        "random scores",
        lambda probe, gallery, rng: rng.standard_normal((len(probe), len(gallery))),
        is_audit=False,
    ),
    "shuffled": Control("an attack's scores with shuffled mates", None, is_audit=False),
    "duration": _Times(
        "how long a release lasts",
        _alike(lambda one: one.t[one.offsets[1:] - 1] - one.t[one.offsets[:-1]]),
    ),
    "sample_count": _Times(
        "how many samples it has", _alike(lambda one: np.diff(one.offsets))
    ),
    "sampling_times": _Times("how its sampling steps vary", _alike(_sampling_times)),
    "noise_level": Control(
        "the standard deviations declared with it",
        _alike(_noise),
        _alike(_over_neighbours),
        # How well somebody is sensed does not change at once: physics, not a leak.
        is_evidence_live=True,
    ),
    "frame": Control(
        "where it lies and heads in its frame", _alike(_frame), hides_in_scene=True
    ),
    "clock": _Times(
        "when it starts on its clock",
        _alike(lambda one: one.t[one.offsets[:-1]]),
        hides_in_scene=True,
    ),
    **{
        name: _Times(f"the {name.replace('_', ' ')} alone", None, circumstance=columns)
        for name, columns in COLUMNS.items()
    },
}
