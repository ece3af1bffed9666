"""What all mechanism levels of a linkage task have in common, before anything is shared.

Both sessions are sensed like everything else. Unless the task shows the scene, every
walk is turned and shifted by itself and put on a clock of its own.
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
from isac_track.model_world import Motion, simulated
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
    """Some windows of both sides, and who is who in them: a search, or a training set."""

    probe: Ints  # (p,) rows of the probe side.
    gallery: Ints  # (g,) rows of the gallery side.
    mate: Ints  # (p,) place in `gallery`, or -1.


@dataclass(frozen=True, eq=False, slots=True)
class Half:
    """What belongs to one fold: whom its adversary attacks, and from whom it learns."""

    searches: tuple[tuple[int, Pairing], ...]  # Number of the search, and its windows.
    learns: Pairing
    calibrates: tuple[
        Pairing, ...
    ]  # Searches on whose scores those of this fold are calibrated.
    mate_rate: float  # Share of the probes of those that have a mate, kept off 0 and 1.


@dataclass(frozen=True, eq=False, slots=True)
class SensedSessions:
    """Both sessions of a task as they are sensed, and what else all of its levels share."""

    sessions: Sessions
    sensed: tuple[Sensed, ...]  # Probe and gallery.
    frames: tuple[
        Frame, ...
    ]  # Of the walks of either; none where the task shows the scene.
    halves: tuple[Half, ...]
    searches: Mapping[int, Pairing]  # Every search, by number, whole.
    drawn_as: Ints  # (C,) which cluster of the run's scenes each cluster is, or -1.
    n_groups: int  # Clusters of the run's scenes.
    weights: Floats  # (B, C) bootstrap weights of the clusters.
    cluster: Ints  # (K,) cluster of each person: a column of the weights.
    privacy: PrivacySettings
    seed: int
    candidates: int  # How many of a gallery are scored for each probe; 0: all.


_last: dict[bytes, SensedSessions] = {}
"""What was sensed last, by a digest of what it was made of: a worker gets one piece of a task after
another, and each in arrays of its own."""


def sensed_sessions(
    sessions: Sessions,
    *,
    groups: Sequence[str],
    motion: Motion | None = None,
    stages: StageSettings,
    seed: int,
) -> SensedSessions:
    """Sense both sessions of a task and prepare its folds.

    `groups` are the clusters of the run's scenes: who is in both is drawn alike in
    both. With a `motion` people walk as that says, and all else is as it was recorded.
    """
    key = hashlib.sha256(
        pickle.dumps((sessions, groups, motion, stages, seed))
    ).digest()
    if key in _last:
        return _last[key]
    names, cluster = np.unique(sessions.group, return_inverse=True)
    known = {name: place for place, name in enumerate(groups)}
    drawn_as = np.array([known.get(name, -1) for name in names.tolist()])
    task = sessions.task
    largest = int(np.bincount(sessions.gallery.search).max())
    candidates = 0 if task.comes_back else stages.linkage.candidates
    folds = (
        range(len(sessions.learns))
        if task.comes_back
        else np.unique(sessions.fold).tolist()
    )
    halves = tuple(_half(sessions, fold) for fold in folds)
    frames = (
        ()
        if task.shows_scene
        else tuple(_frames(sessions, one, seed=seed) for one in SIDES)
    )
    found = SensedSessions(
        sessions=sessions,
        sensed=tuple(_sensed(sessions, one, stages=stages, seed=seed) for one in SIDES),
        frames=frames,
        halves=halves,
        searches=_whole(one for half in halves for one in half.searches),
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
    _last.clear()
    _last[key] = found if motion is None else _modelled(found, motion)
    return _last[key]


def _modelled(found: SensedSessions, motion: Motion) -> SensedSessions:
    """Return sessions whose people walk as a motion says, one walk a person on both sides."""
    sides = (found.sessions.probe, found.sessions.gallery)
    owner = np.concatenate(
        [np.repeat(one.person, np.diff(one.offsets)) for one in sides]
    )
    t = np.concatenate([one.t for one in sides])
    walks = np.empty((t.size, 2))
    for person, source in enumerate(found.sessions.source):
        rng = stream(found.seed, "model walks", "linkage", source)
        instants, which = np.unique(t[owner == person], return_inverse=True)
        offsets, start = np.array([0, instants.size]), np.zeros((1, 2))
        walk = simulated(
            t=instants, offsets=offsets, start=start, motion=motion, rng=rng
        )
        walks[owner == person] = walk[which]
    places = np.split(walks, [sides[0].t.size])
    probe, gallery = (
        replace(one, xy=xy) for one, xy in zip(sides, places, strict=True)
    )
    sensed = tuple(
        derived(one, xy=xy + one.sigma_raw[:, None] * one.unit_error)
        for one, xy in zip(found.sensed, places, strict=True)
    )
    sessions = replace(found.sessions, probe=probe, gallery=gallery)
    return replace(found, sessions=sessions, sensed=sensed)


def _whole(parts: Iterable[tuple[int, Pairing]]) -> dict[int, Pairing]:
    """Return every search whole, of which each fold may have some of the probes."""
    found: dict[int, Pairing] = {}
    for number, part in parts:
        one = found.setdefault(number, part)
        if one is not part:
            probe = np.concatenate([one.probe, part.probe])
            found[number] = Pairing(
                probe, part.gallery, np.concatenate([one.mate, part.mate])
            )
    return found


def _half(sessions: Sessions, fold: int) -> Half:
    mine = np.flatnonzero(sessions.fold == fold)
    others = np.flatnonzero(sessions.fold != fold)
    attacked = everybody = np.ones(len(sessions.source), dtype=bool)
    if sessions.task.comes_back:  # a fold is a person, who is searched for among all
        mine = others = np.arange(sessions.fold.size)
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

    known = [part(one, calibrates, calibrates) for one in others[:, None]]
    mated = np.concatenate([np.zeros(0, dtype=bool), *(one.mate >= 0 for one in known)])
    return Half(
        searches=tuple(
            (int(one[0]), part(one, attacked, everybody)) for one in mine[:, None]
        ),
        learns=part(others, learns, learns),
        calibrates=tuple(one for one in known if (one.mate >= 0).any()),
        mate_rate=(int(mated.sum()) + 0.5) / (mated.size + 1.0),
    )


def linkage_weights(drawn_as: Ints, *, n_groups: int, task: str, seed: int) -> Floats:
    """Return bootstrap weights of the clusters of a linkage task, (B, C).

    Clusters that the run's scenes have as well are drawn as they are there; the others
    are drawn among themselves. `drawn_as`, (C,), is the place of each among the
    `n_groups` clusters of the run's scenes, or -1.
    """
    # Cluster by cluster: so a product with sums in each cluster need not be laid out
    # anew.
    weights = np.empty((N_REPLICATES, drawn_as.size), order="F")
    again, further = np.flatnonzero(drawn_as >= 0), np.flatnonzero(drawn_as < 0)
    if again.size:
        drawn = cluster_weights(
            n_clusters=n_groups, n_replicates=N_REPLICATES, seed=seed
        )
        weights[:, again] = drawn[:, drawn_as[again]]
    if further.size:
        rng = stream(seed, "bootstrap", "linkage", task)
        share = np.full(further.size, 1.0 / further.size)
        weights[:, further] = rng.multinomial(further.size, share, N_REPLICATES)
    return read_only(weights)


def _sensed(
    sessions: Sessions, side: str, *, stages: StageSettings, seed: int
) -> Sensed:
    """Return what the network senses of one side; every window draws from its own streams.

    What lasts of the channel is of the walk and its time: one before and after a gap,
    another one when the steps are logged again or people are back.
    """
    windows, task = getattr(sessions, side), sessions.task
    keys, sensed_walks = list[tuple[str | int, ...]](), list[tuple[str | int, ...]]()
    for person, search in zip(windows.person, windows.search, strict=True):
        source = sessions.source[person]
        own = ("linkage", task.family, side, source)
        # The number of a closed search is a half, which may change with who else is
        # there.
        keys.append((*own, sessions.searches[search]) if task.is_open else own)
        sensed_walks.append(recorded_walk(source) if task.is_one_time else own)
    walked_m = windows.walked_m
    if walked_m is None:
        walked_m = walked_within(windows.xy, windows.offsets)
    names = [
        ("person", one, *(() if task.is_one_walk else (side,)))
        for one in sessions.source
    ]
    walks = np.concatenate([walk_numbers(*one, n_walks=1, seed=seed) for one in names])
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


def _frames(sessions: Sessions, side: str, *, seed: int) -> Frame:
    """Return the frames of one side: those of a walk are its own, whoever else is there."""
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
        # From the start of each window: a recording may last longer than the draw
        # reaches.
        clock_s=LONG_S * drawn[:, 3] - windows.t[windows.offsets[:-1]],
    )
