"""Prepare a linkage task for all mechanism levels: sense the sessions, split people.

Both sessions are sensed as scenes are. Unless the task shows the scene, every walk is
turned and shifted by itself and put on a clock of its own.
"""

import hashlib
import pickle
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from attacks.tasks.sessions import Sessions
from evaluation.compute.sharing import FAR_M, LONG_S, Frame
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
    mate: Ints  # (p,) place in `gallery`, or -1.


@dataclass(frozen=True, eq=False, slots=True)
class Half:
    """One fold: the people that its adversary attacks, and those it learns from."""

    searches: tuple[tuple[int, Pairing], ...]  # Number of the search, and its windows.
    learns: Pairing
    # Searches of other people, whose scores calibrate those of this fold.
    calibrates: tuple[Pairing, ...]
    # Share of the calibrating probes that have a mate; never 0 or 1.
    mate_rate: float


@dataclass(frozen=True, eq=False, slots=True)
class SensedSessions:
    """Both sessions of a task as sensed, and all else that its levels share."""

    sessions: Sessions
    sensed: tuple[Sensed, ...]  # Probe and gallery.
    # Frames of the walks of either side; none where the task shows the scene.
    frames: tuple[Frame, ...]
    halves: tuple[Half, ...]
    searches: Mapping[int, Pairing]  # Every search, by number, with all of its probes.
    drawn_as: Ints  # (C,) which cluster of the run's scenes each cluster is, or -1.
    n_groups: int  # Clusters of the run's scenes.
    weights: Floats  # (B, C) bootstrap weights of the clusters.
    cluster: Ints  # (K,) cluster of each person: a column of the weights.
    privacy: PrivacySettings
    seed: int
    candidates: int  # How many of a gallery are scored for each probe; 0: all.


_newest: dict[bytes, SensedSessions] = {}
"""A memo of the newest setup alone, by a digest of its inputs.

A worker gets the pieces of a task one after another, each in arrays of its own. The
next task replaces it."""


def sensed_sessions(
    sessions: Sessions,
    *,
    groups: Sequence[str],
    motion: Motion | None = None,
    stages: StageSettings,
    seed: int,
) -> SensedSessions:
    """Sense both sessions of a task and prepare its folds.

    `groups` are the clusters of the run's scenes: the bootstrap draws a cluster of both
    alike in both. With a `motion` people walk by that model; all else is as recorded.
    """
    key = hashlib.sha256(
        pickle.dumps((sessions, groups, motion, stages, seed))
    ).digest()
    if key in _newest:
        return _newest[key]
    clusters, cluster = np.unique(sessions.group, return_inverse=True)
    group_place = {name: place for place, name in enumerate(groups)}
    drawn_as = np.array([group_place.get(name, -1) for name in clusters.tolist()])
    task = sessions.task
    largest = int(np.bincount(sessions.gallery.search).max())
    candidates = 0 if task.comes_back else stages.linkage.candidates
    folds = np.unique(sessions.fold).tolist()
    if task.comes_back:
        folds = list(range(len(sessions.learns)))
    halves = tuple(_prepare_half(sessions, fold) for fold in folds)
    frames: tuple[Frame, ...] = ()
    if not task.shows_scene:
        frames = tuple(_draw_frames(sessions, side, seed=seed) for side in SIDES)
    setup = SensedSessions(
        sessions=sessions,
        sensed=tuple(
            _sense_side(sessions, side, stages=stages, seed=seed) for side in SIDES
        ),
        frames=frames,
        halves=halves,
        searches=_whole_searches(search for half in halves for search in half.searches),
        drawn_as=drawn_as,
        n_groups=len(groups),
        weights=linkage_weights(
            drawn_as, n_groups=len(groups), task=task.name, seed=seed
        ),
        cluster=cluster.astype(np.int64),
        privacy=stages.privacy,
        seed=seed,
        candidates=candidates if candidates < largest else 0,
    )
    _newest.clear()
    _newest[key] = setup if motion is None else _walk_by_model(setup, motion)
    return _newest[key]


def _walk_by_model(setup: SensedSessions, motion: Motion) -> SensedSessions:
    """Return sessions whose people walk by a model: one walk a person on both sides."""
    sides = (setup.sessions.probe, setup.sessions.gallery)
    owner = np.concatenate(
        [np.repeat(windows.person, np.diff(windows.offsets)) for windows in sides]
    )
    t = np.concatenate([windows.t for windows in sides])
    walks = np.empty((t.size, 2))
    for person, source in enumerate(setup.sessions.source):
        rng = stream(setup.seed, "model walks", "linkage", source)
        instants, place = np.unique(t[owner == person], return_inverse=True)
        offsets, start = np.array([0, instants.size]), np.zeros((1, 2))
        walk = simulate_walks(
            t=instants, offsets=offsets, start=start, motion=motion, rng=rng
        )
        walks[owner == person] = walk[place]
    walks_by_side = np.split(walks, [sides[0].t.size])
    probe, gallery = (
        replace(windows, xy=xy)
        for windows, xy in zip(sides, walks_by_side, strict=True)
    )
    sensed = tuple(
        derived(side, xy=xy + side.sigma_raw[:, None] * side.unit_error)
        for side, xy in zip(setup.sensed, walks_by_side, strict=True)
    )
    sessions = replace(setup.sessions, probe=probe, gallery=gallery)
    return replace(setup, sessions=sessions, sensed=sensed)


def _whole_searches(parts: Iterable[tuple[int, Pairing]]) -> dict[int, Pairing]:
    """Return every search with all of its probes, which the folds may have split."""
    searches: dict[int, Pairing] = {}
    for number, piece in parts:
        whole = searches.setdefault(number, piece)
        if whole is not piece:
            probe = np.concatenate([whole.probe, piece.probe])
            searches[number] = Pairing(
                probe, piece.gallery, np.concatenate([whole.mate, piece.mate])
            )
    return searches


def _prepare_half(sessions: Sessions, fold: int) -> Half:
    own = np.flatnonzero(sessions.fold == fold)
    others = np.flatnonzero(sessions.fold != fold)
    attacked = everybody = np.ones(len(sessions.source), dtype=bool)
    if sessions.task.comes_back:  # a fold is a person, searched for among all people
        own = others = np.arange(sessions.fold.size)
        attacked = np.arange(everybody.size) == fold
    learns, calibrates = sessions.learns[fold], sessions.calibrates[fold]

    def part(searches: Ints, probes: Bools, candidates: Bools) -> Pairing:
        probe = np.isin(sessions.probe.search, searches) & probes[sessions.probe.person]
        gallery = (
            np.isin(sessions.gallery.search, searches)
            & candidates[sessions.gallery.person]
        )
        place = np.where(gallery, np.cumsum(gallery) - 1, -1)
        mate = sessions.mate[probe]
        return Pairing(
            probe=np.flatnonzero(probe),
            gallery=np.flatnonzero(gallery),
            mate=np.where(mate >= 0, place[mate], -1),
        )

    calibrating = [part(number, calibrates, calibrates) for number in others[:, None]]
    has_mate = [pairing.mate >= 0 for pairing in calibrating]
    mated = np.concatenate([np.zeros(0, dtype=bool), *has_mate])
    return Half(
        searches=tuple(
            (int(number[0]), part(number, attacked, everybody))
            for number in own[:, None]
        ),
        learns=part(others, learns, learns),
        calibrates=tuple(
            pairing
            for pairing, is_mated in zip(calibrating, has_mate, strict=True)
            if is_mated.any()
        ),
        mate_rate=(int(mated.sum()) + 0.5) / (mated.size + 1.0),
    )


def linkage_weights(drawn_as: Ints, *, n_groups: int, task: str, seed: int) -> Floats:
    """Return bootstrap weights of the clusters of a linkage task, (B, C).

    Clusters that the run's scenes have as well are drawn as they are there; the others
    are drawn among themselves. `drawn_as`, (C,), is the place of each among the
    `n_groups` clusters of the run's scenes, or -1.
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
    sessions: Sessions, side: str, *, stages: StageSettings, seed: int
) -> Sensed:
    """Return what the network senses of one side; every window has streams of its own.

    The slow part of the channel belongs to the walk and its time: the same before and
    after a gap, another one when the steps are logged again or people come back.
    """
    windows, task = getattr(sessions, side), sessions.task
    keys, sensed_walks = list[tuple[str | int, ...]](), list[tuple[str | int, ...]]()
    for person, search in zip(windows.person, windows.search, strict=True):
        source = sessions.source[person]
        own = ("linkage", task.family, side, source)
        # The number of a closed search is a half, which depends on the other people.
        keys.append((*own, sessions.searches[search]) if task.is_open else own)
        sensed_walks.append(recorded_walk(source) if task.is_one_time else own)
    walked_m = windows.walked_m
    if walked_m is None:
        walked_m = walked_within(windows.xy, windows.offsets)
    ending = () if task.is_one_walk else (side,)
    names = [("person", source, *ending) for source in sessions.source]
    walks = np.concatenate(
        [walk_numbers(*name, n_walks=1, seed=seed) for name in names]
    )
    return sense(
        t=windows.t,
        xy=windows.xy,
        offsets=windows.offsets,
        channel=draw_walk_channel(
            walked_m=walked_m,
            offsets=windows.offsets,
            walks=sensed_walks,
            keys=keys,
            settings=stages.sensing,
            seed=seed,
        ),
        settings=stages.sensing,
        walk=walks[windows.person],
    )


def _draw_frames(sessions: Sessions, side: str, *, seed: int) -> Frame:
    """Return the frames of one side; a walk's frame does not depend on other people."""
    windows = getattr(sessions, side)
    names = ("frames", "linkage", sessions.task.family, side)
    draws = [
        stream(seed, *names, sessions.source[person]).random(4)
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
