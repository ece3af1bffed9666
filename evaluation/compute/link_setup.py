"""Prepare a linkage task for all mechanism levels: sense both sides, split people.

Both sides are sensed as scenes are. Unless the task shows the scene, every walk is
turned and shifted by itself and put on a clock of its own.
"""

import hashlib
import pickle
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import numpy as np

from attacks.tasks.windows import TaskWindows
from evaluation.compute.frames import FAR_M, LONG_S, Frame
from isac_track.config import PrivacySettings, StageSettings
from isac_track.intervals import cluster_weights
from isac_track.model_world import Motion, simulate_walks
from isac_track.rng import stream
from isac_track.sensing import (
    draw_walk_channel,
    recorded_walk,
    sense,
    walk_numbers,
    walked_within,
)
from isac_track.types import Bools, Floats, Ints, Sensed, derived, read_only

N_REPLICATES = 1000
SIDES = ("probe", "gallery")


@dataclass(frozen=True, eq=False, slots=True)
class Pairing:
    """Windows of both sides, and their mates: a search, or a training set."""

    probe: Ints  # (p,) rows of the probe side.
    gallery: Ints  # (g,) rows of the gallery side.
    mate: Ints  # (p,) number in `gallery` of the window of the same person, or -1.

    @property
    def has_mates(self) -> bool:
        """Whether any probe has a mate: without, nothing can be learnt from it."""
        return bool((self.mate >= 0).any())


@dataclass(frozen=True, eq=False, slots=True)
class FoldPairings:
    """The windows of a fold: those that its adversary attacks, and the training set.

    A fold is half of the people or of the rotations, or a single returning person.
    """

    searches: Mapping[int, Pairing]  # By number; only with probes of this fold.
    training: Pairing
    # Searches of other people, whose scores calibrate those of this fold.
    calibrating: tuple[Pairing, ...]
    # Share of the calibrating probes that have a mate; never 0 or 1.
    mate_rate: float


@dataclass(frozen=True, eq=False, slots=True)
class SensedTask:
    """Both sides of a task as sensed, and all else that its levels share."""

    task_windows: TaskWindows
    sensed: tuple[Sensed, ...]  # Probe and gallery.
    # Frames of the walks of either side; none where the task shows the scene.
    frames: tuple[Frame, ...]
    folds: tuple[FoldPairings, ...]
    searches: Mapping[int, Pairing]  # Every search, by number, with all of its probes.
    # The C clusters of the task are walking groups. Some are also among the `n_groups`
    # walking groups of the run's scenes.
    drawn_as: Ints  # (C,) row of each cluster among these, or -1.
    n_groups: int
    weights: Floats  # (B, C) bootstrap weights of the clusters.
    cluster: Ints  # (K,) cluster of each person: a column of the weights.
    privacy: PrivacySettings
    seed: int
    n_candidates: int  # How many of a gallery are scored for each probe; 0: all.


_newest: dict[bytes, SensedTask] = {}
"""A memo of the newest setup alone, by a digest of its inputs.

A worker gets the pieces of a task one after another, each in arrays of its own. The
next task replaces it."""


def sense_task(
    task_windows: TaskWindows,
    *,
    groups: Sequence[str],
    motion: Motion | None = None,
    stages: StageSettings,
    seed: int,
) -> SensedTask:
    """Sense both sides of a task and prepare its folds.

    `groups` are the walking groups of the run's scenes. The bootstrap draws a group of
    task and scenes equally often in both. With a `motion` people walk by that model;
    all else is as recorded.
    """
    key = hashlib.sha256(
        pickle.dumps((task_windows, groups, motion, stages, seed))
    ).digest()
    if key not in _newest:
        setup = _sense_recorded(task_windows, groups, stages, seed)
        _newest.clear()
        _newest[key] = setup if motion is None else _walk_by_model(setup, motion)
    return _newest[key]


def _sense_recorded(
    task_windows: TaskWindows,
    groups: Sequence[str],
    stages: StageSettings,
    seed: int,
) -> SensedTask:
    """Sense the recorded walks of a task and prepare its folds."""
    task = task_windows.task
    clusters, cluster = np.unique(task_windows.group, return_inverse=True)
    group_place = {name: place for place, name in enumerate(groups)}
    drawn_as = np.array([group_place.get(name, -1) for name in clusters.tolist()])
    frames: tuple[Frame, ...] = ()
    if not task.shows_scene:
        frames = tuple(_draw_frames(task_windows, side, seed=seed) for side in SIDES)
    folds = tuple(
        prepare_fold(task_windows, fold) for fold in _list_folds(task_windows)
    )
    return SensedTask(
        task_windows=task_windows,
        sensed=tuple(
            _sense_side(task_windows, side, stages=stages, seed=seed) for side in SIDES
        ),
        frames=frames,
        folds=folds,
        searches=whole_searches(fold.searches for fold in folds),
        drawn_as=drawn_as,
        n_groups=len(groups),
        weights=linkage_weights(
            drawn_as, n_groups=len(groups), task=task.name, seed=seed
        ),
        cluster=cluster.astype(np.int64),
        privacy=stages.privacy,
        seed=seed,
        n_candidates=_count_candidates(task_windows, stages.linkage.candidates),
    )


def _list_folds(task_windows: TaskWindows) -> list[int]:
    """Return the numbers of the folds: every person, where few come back."""
    if task_windows.task.links_returning_people:
        return list(range(len(task_windows.trained_on)))
    folds: list[int] = np.unique(task_windows.fold).tolist()
    return folds


def _count_candidates(task_windows: TaskWindows, candidates: int) -> int:
    """Return how many candidates of a probe are scored, or 0 for the whole gallery.

    That is `candidates`, unless no gallery has more.
    """
    if task_windows.task.links_returning_people:
        return 0
    largest = int(np.bincount(task_windows.gallery.search).max())
    return candidates if candidates < largest else 0


def _walk_by_model(setup: SensedTask, motion: Motion) -> SensedTask:
    """Return a task whose people walk by a model: a single walk each on both sides."""
    sides = (setup.task_windows.probe, setup.task_windows.gallery)
    owner = np.concatenate(
        [np.repeat(windows.person, np.diff(windows.offsets)) for windows in sides]
    )
    t = np.concatenate([windows.t for windows in sides])
    walks = np.empty((t.size, 2))
    for person, source in enumerate(setup.task_windows.source):
        rng = stream(setup.seed, "model walks", "linkage", source)
        instants, row = np.unique(t[owner == person], return_inverse=True)
        offsets, start = np.array([0, instants.size]), np.zeros((1, 2))
        walk = simulate_walks(
            t=instants, offsets=offsets, start=start, motion=motion, rng=rng
        )
        walks[owner == person] = walk[row]
    walks_by_side = np.split(walks, [sides[0].t.size])
    probe, gallery = (
        replace(windows, xy=xy)
        for windows, xy in zip(sides, walks_by_side, strict=True)
    )
    sensed = tuple(
        derived(side, xy=xy + side.sigma_raw[:, None] * side.unit_error)
        for side, xy in zip(setup.sensed, walks_by_side, strict=True)
    )
    task_windows = replace(setup.task_windows, probe=probe, gallery=gallery)
    return replace(setup, task_windows=task_windows, sensed=sensed)


def whole_searches(parts: Iterable[Mapping[int, Pairing]]) -> dict[int, Pairing]:
    """Return every search with all of its probes, which the folds may have split."""
    searches: dict[int, Pairing] = {}
    for number, piece in chain.from_iterable(part.items() for part in parts):
        whole = searches.setdefault(number, piece)
        if whole is not piece:
            probe = np.concatenate([whole.probe, piece.probe])
            searches[number] = Pairing(
                probe, piece.gallery, np.concatenate([whole.mate, piece.mate])
            )
    return searches


def prepare_fold(task_windows: TaskWindows, fold: int) -> FoldPairings:
    """Return the pairings of a fold: its searches, and people of other folds."""
    own = np.flatnonzero(task_windows.fold == fold)
    others = np.flatnonzero(task_windows.fold != fold)
    attacked = everybody = np.ones(len(task_windows.source), dtype=bool)
    # There a fold is a person, who is linked among all people in a single search.
    if task_windows.task.links_returning_people:
        own = others = np.arange(task_windows.fold.size)
        attacked = np.arange(everybody.size) == fold
    trained_on = task_windows.trained_on[fold]
    calibrated_on = task_windows.calibrated_on[fold]
    pair = partial(_pair_windows, task_windows)
    calibrating = [
        pair([number], probed=calibrated_on, searched=calibrated_on)
        for number in others.tolist()
    ]
    has_mate = [pairing.mate >= 0 for pairing in calibrating]
    mated = np.concatenate([np.zeros(0, dtype=bool), *has_mate])
    return FoldPairings(
        searches={
            number: pair([number], probed=attacked, searched=everybody)
            for number in own.tolist()
        },
        training=pair(others, probed=trained_on, searched=trained_on),
        calibrating=tuple(
            pairing
            for pairing, is_mated in zip(calibrating, has_mate, strict=True)
            if is_mated.any()
        ),
        mate_rate=(int(mated.sum()) + 0.5) / (mated.size + 1.0),
    )


def _pair_windows(
    task_windows: TaskWindows,
    searches: Ints | Sequence[int],
    *,
    probed: Bools,
    searched: Bools,
) -> Pairing:
    """Return the windows of some searches, by number, and of some of their people.

    `probed` and `searched`, (K,), are masks of the people on either side.
    """
    probes, gallery = task_windows.probe, task_windows.gallery
    in_probe = np.isin(probes.search, searches) & probed[probes.person]
    in_gallery = np.isin(gallery.search, searches) & searched[gallery.person]
    row_in_pairing = np.where(in_gallery, np.cumsum(in_gallery) - 1, -1)
    mate = task_windows.mate[in_probe]
    return Pairing(
        probe=np.flatnonzero(in_probe),
        gallery=np.flatnonzero(in_gallery),
        mate=np.where(mate >= 0, row_in_pairing[mate], -1),
    )


def linkage_weights(drawn_as: Ints, *, n_groups: int, task: str, seed: int) -> Floats:
    """Return bootstrap weights of the clusters of a linkage task, (B, C).

    Clusters that the run's scenes have as well are drawn as they are there; the others
    are drawn among themselves. `drawn_as` and `n_groups` as of `SensedTask`.
    """
    # In the memory order of clusters: products with sums by cluster need no copy.
    weights = np.empty((N_REPLICATES, drawn_as.size), order="F")
    shared, new = np.flatnonzero(drawn_as >= 0), np.flatnonzero(drawn_as < 0)
    if shared.size:
        drawn = cluster_weights(
            n_clusters=n_groups, n_replicates=N_REPLICATES, seed=seed
        )
        weights[:, shared] = drawn[:, drawn_as[shared]]
    if new.size:
        rng = stream(seed, "bootstrap", "linkage", task)
        share = np.full(new.size, 1.0 / new.size)
        weights[:, new] = rng.multinomial(new.size, share, N_REPLICATES)
    return read_only(weights)


def _sense_side(
    task_windows: TaskWindows, side: str, *, stages: StageSettings, seed: int
) -> Sensed:
    """Return what the network senses of one side; every window has streams of its own.

    The slow part of the channel belongs to the walk and its time: the same before and
    after a gap, another draw when the steps are logged again or people come back.
    """
    windows, task = getattr(task_windows, side), task_windows.task
    # Names of the streams of each window, and of the lasting parts of its walk.
    window_keys = list[tuple[str | int, ...]]()
    walk_keys = list[tuple[str | int, ...]]()
    for person, search in zip(windows.person, windows.search, strict=True):
        source = task_windows.source[person]
        own = ("linkage", task.family, side, source)
        # The number of a closed search is a fold, which depends on the other people.
        window_keys.append(
            (*own, task_windows.search_names[search]) if task.is_open else own
        )
        walk_keys.append(recorded_walk(source) if task.is_sensed_once else own)
    walked_m = windows.walked_m
    if walked_m is None:
        walked_m = walked_within(windows.xy, windows.offsets)
    # A slow error goes on along a walk: sides that are two walks have two numbers.
    ending = () if task.is_single_walk else (side,)
    names = [("person", source, *ending) for source in task_windows.source]
    walk_of_person = np.concatenate(
        [walk_numbers(*name, n_walks=1, seed=seed) for name in names]
    )
    return sense(
        t=windows.t,
        xy=windows.xy,
        offsets=windows.offsets,
        channel=draw_walk_channel(
            walked_m=walked_m,
            offsets=windows.offsets,
            walks=walk_keys,
            keys=window_keys,
            settings=stages.sensing,
            seed=seed,
        ),
        settings=stages.sensing,
        walk=walk_of_person[windows.person],
    )


def _draw_frames(task_windows: TaskWindows, side: str, *, seed: int) -> Frame:
    """Return the frames of one side; a walk's frame does not depend on other people."""
    windows = getattr(task_windows, side)
    names = ("frames", "linkage", task_windows.task.family, side)
    draws = [
        stream(seed, *names, task_windows.source[person]).random(4)
        for person in windows.person
    ]
    drawn = np.reshape(draws, (-1, 4))
    angle = 2.0 * np.pi * drawn[:, 0]
    return Frame(
        turn=np.cos(angle) + 1j * np.sin(angle),
        shift_m=FAR_M * (2.0 * drawn[:, 1:3] - 1.0).view(np.complex128)[:, 0],
        # From the start of each window: a recording may last longer than `LONG_S`.
        clock_s=LONG_S * drawn[:, 3] - windows.t[windows.offsets[:-1]],
    )
