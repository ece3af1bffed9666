"""Controls of linkage: baselines of every attack, and an audit of every task.

Two controls must stay at chance whatever the task: random scores, and the scores of a
real attack with the mates shuffled. The others are the *shortcut audit*: each uses a
single property that has nothing to do with how a person walks. If such a control
differs from chance, in either direction, the task has a shortcut. The success of an
attack in this task then measures nothing.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeAlias

import numpy as np
from numpy.random import Generator

from attacks.tasks.task_list import Task
from attacks.tasks.window_circumstances import CIRCUMSTANCE_COLUMNS
from isac_track.sensing import intervals_before
from isac_track.types import Floats, Ints, Release

Score: TypeAlias = Callable[[Release, Release, Generator], Floats]
"""From probe, gallery and a stream to scores (P, G), higher = more similar."""
_NO_SIGMA_M = 1e-9
_NEIGHBOURS = 5
_DECIMALS = 9  # Of a noise level: many are at the cap, equal but for rounding.


@dataclass(frozen=True, slots=True)
class Control:
    """A linker that must not succeed."""

    about: str
    score: Score | None  # None: the scores of an attack, with shuffled mates.
    scene_score: Score | None = None  # Instead of it for tasks in the true frame.
    is_audit: bool = True  # Whether it belongs to the shortcut audit.
    # Whether a task in the true frame shows its property on purpose.
    is_shown_in_scene: bool = False
    is_evidence_in_walk: bool = False
    """Whether its property is evidence where both sides show one time of one walk.

    There the control is no shortcut but an ablation: what a linker achieves by this
    property alone.
    """
    # Whether its scores are the same at all levels that share every sample.
    sees_times_only: bool = False
    # Columns of `Windows.circumstances` that it uses instead of the releases.
    circumstance: tuple[int, ...] = ()

    def applies(self, task: Task) -> bool:
        """Whether a task has this control."""
        if self.circumstance:
            return task.links_returning_people
        return not (self.is_shown_in_scene and task.shows_scene)

    def audits(self, task: Task) -> bool:
        """Whether success in a task reveals a shortcut, which invalidates the task."""
        return self.is_audit and not (self.is_evidence_in_walk and task.is_sensed_once)

    def scorer(self, task: Task) -> Score | None:
        """Return the score function for a task."""
        if task.shows_scene and self.scene_score is not None:
            return self.scene_score
        return self.score


def _closeness_score(features: Callable[[Release], Floats]) -> Score:
    """Return the score function of the closeness of features, (N,) or (N, F)."""

    def score(probe: Release, gallery: Release, _rng: Generator) -> Floats:
        first = features(probe).reshape(len(probe), -1)
        second = features(gallery).reshape(len(gallery), -1)
        return closeness(first, second)

    return score


def closeness(first: Floats, second: Floats) -> Floats:
    """Return minus the distance of features, (P, G).

    Features are (P, F) and (G, F), each scaled by its spread.
    """
    spread = np.concatenate([first, second]).std(axis=0)
    square = np.zeros((len(first), len(second)))
    # Feature by feature: the gaps of thousands of people in all features at once would
    # take a gigabyte.
    for probe_feature, gallery_feature, width in zip(
        first.T, second.T, spread.tolist(), strict=True
    ):
        gap = (probe_feature[:, None] - gallery_feature) / (width if width > 0 else 1.0)
        square += np.square(gap, out=gap)
    return np.negative(np.sqrt(square, out=square), out=square)


def _means(values: Floats, release: Release) -> Floats:
    """Return the mean of each track's values, (N,) or (N, 2)."""
    total = np.add.reduceat(values, release.offsets[:-1])
    return np.asarray((total.T / np.diff(release.offsets)).T)


def _sampling_times(release: Release) -> Floats:
    """Return mean, mean square, least and greatest of each track's steps, (N, 4) s."""
    step_s = intervals_before(t=release.t, offsets=release.offsets)
    starts = release.offsets[:-1]
    return np.column_stack(
        [
            _means(step_s, release),
            _means(step_s**2, release),
            np.minimum.reduceat(step_s, starts),
            np.maximum.reduceat(step_s, starts),
        ]
    )


def _duration(release: Release) -> Floats:
    """Return how long each track lasts, (N,) s."""
    return np.asarray(release.t[release.offsets[1:] - 1] - _start(release))


def _start(release: Release) -> Floats:
    """Return the first instant of each track on the clock of the release, (N,) s."""
    return np.asarray(release.t[release.offsets[:-1]])


def _sample_count(release: Release) -> Floats:
    """Return the number of samples of each track, (N,)."""
    return np.asarray(np.diff(release.offsets))


def _noise_level(release: Release) -> Floats:
    """Return the mean logarithm of each track's declared noise, (N, 1).

    Its range within a track depends on how far the person walked, which is no shortcut.
    """
    assert release.sigma is not None  # controls are granted SIGMA
    level = _means(np.log(np.maximum(release.sigma, _NO_SIGMA_M)), release)
    return np.asarray(np.round(level, _DECIMALS)[:, None])


def _noise_over_neighbours(release: Release) -> Floats:
    """Return each track's noise level less the mean of its nearest tracks, (N, 1).

    In the true frame, noise that grows with the distance from the base station would
    only show the place.
    """
    from scipy.spatial import cKDTree  # noqa: PLC0415 - heavy, and used here alone

    level, n_near = _noise_level(release), min(_NEIGHBOURS, len(release) - 1)
    # If all levels are equal, only rounding would remain, which depends on the place.
    if n_near == 0 or np.ptp(level) < _NO_SIGMA_M:
        return np.zeros_like(level)
    middle_m = _means(release.xy, release)
    nearest: Ints = np.asarray(cKDTree(middle_m).query(middle_m, k=n_near + 1)[1])
    # The first is the track itself, or somebody in the very same place.
    around = level[nearest[:, 1:], 0].mean(axis=1)[:, None]
    return np.asarray(np.round(level - around, _DECIMALS))


def _frame(release: Release) -> Floats:
    """Return the place, m, and the heading, a unit vector, of each track, (N, 4).

    It heads from the middle of its first half to that of its second.
    """
    first, sizes = release.offsets[:-1], np.diff(release.offsets)[:, None]
    total = np.add.reduceat(release.xy, first)
    halves = np.column_stack([first, first + sizes[:, 0] // 2]).ravel()
    late = np.add.reduceat(release.xy, halves)[1::2]
    # A track of one sample has no first half: it stands where it is.
    early = np.where(sizes > 1, total - late, total) / np.maximum(sizes // 2, 1)
    late /= sizes - sizes // 2
    moved = late - early
    length_m = np.hypot(moved[:, 0], moved[:, 1])[:, None]
    heading = np.divide(moved, length_m, out=np.zeros_like(moved), where=length_m > 0)
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
        _closeness_score(_duration),
    ),
    "sample_count": _Times("how many samples it has", _closeness_score(_sample_count)),
    "sampling_times": _Times(
        "how its sampling steps vary", _closeness_score(_sampling_times)
    ),
    "noise_level": Control(
        "the standard deviations declared with it",
        _closeness_score(_noise_level),
        scene_score=_closeness_score(_noise_over_neighbours),
        # How well somebody is sensed does not change at once: physics, not a leak.
        is_evidence_in_walk=True,
    ),
    "frame": Control(
        "where it lies and heads in its frame",
        _closeness_score(_frame),
        is_shown_in_scene=True,
    ),
    "clock": _Times(
        "when it starts on its clock",
        _closeness_score(_start),
        is_shown_in_scene=True,
    ),
    **{
        name: _Times(f"the {name.replace('_', ' ')} alone", None, circumstance=columns)
        for name, columns in CIRCUMSTANCE_COLUMNS.items()
    },
}
