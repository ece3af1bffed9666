"""What all mechanism levels of a linkage task have in common, before anything is shared.

Both sessions are sensed like everything else. Unless the task shows the scene, every walk is turned
and shifted by itself and put on a clock of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from evaluation.cells.adversary import FAR_M, LONG_S
from evaluation.cells.samples import restricted, samples_shared
from isac_track.intervals import cluster_weights
from isac_track.rng import stream
from isac_track.sensing import draw_channel, sense

if TYPE_CHECKING:
    from collections.abc import Sequence

    from attacks.tasks.sessions import Sessions, Windows
    from isac_track.config import StageSettings
    from isac_track.types import Bools, Floats, Ints, Release, Sensed

N_REPLICATES = 1000
SIDES = ("probe", "gallery")


@dataclass(frozen=True, eq=False, slots=True)
class Frames:
    """A frame and a clock for each of N walks: turned by the angle, then shifted."""

    cos: Floats
    """(M,)"""
    sin: Floats
    """(M,)"""
    shift_m: Floats
    """(M, 2)"""
    clock_s: Floats
    """(M,)"""

    def points(self, xy: Floats) -> Floats:
        """Return positions, (M, 2) m, each in the frame of its walk."""
        turned = np.empty_like(xy)
        turned[:, 0] = self.cos * xy[:, 0] - self.sin * xy[:, 1]
        turned[:, 1] = self.sin * xy[:, 0] + self.cos * xy[:, 1]
        return turned + self.shift_m

    def release(self, release: Release) -> Release:
        """Return a release, every walk in its frame and on its clock."""
        return replace(release, xy=self.points(release.xy), t=release.t + self.clock_s)

    def of(self, samples: Ints) -> Frames:
        """Return the frames of some of the samples."""
        return Frames(*(getattr(self, item.name)[samples] for item in fields(self)))


@dataclass(frozen=True, eq=False, slots=True)
class Pairing:
    """Some windows of both sides, and who is who in them: a search, or a training set."""

    probe: Ints
    """(p,) rows of the probe side."""
    gallery: Ints
    """(g,) rows of the gallery side."""
    mate: Ints
    """(p,) place in `gallery`, or -1."""


@dataclass(frozen=True, eq=False, slots=True)
class Half:
    """What belongs to one fold: whom its adversary attacks, and from whom it learns."""

    searches: tuple[tuple[int, Pairing], ...]
    """Number of the search, and its windows."""
    learns: Pairing
    calibrates: tuple[Pairing, ...]
    """Searches of the people on whose scores those of this fold are calibrated."""
    mate_rate: float
    """Share of those people's probes that have a mate, kept off 0 and 1."""


@dataclass(frozen=True, eq=False, slots=True)
class SensedSessions:
    """Both sessions of a task as they are sensed, and what else all of its levels share."""

    sessions: Sessions
    sensed: tuple[Sensed, Sensed]
    """Probe and gallery."""
    frames: tuple[Frames, Frames] | None
    """None where the task shows the scene."""
    halves: tuple[Half, ...]
    drawn_as: Ints
    """(C,) which cluster of the run's scenes each cluster is, or -1."""
    n_groups: int
    """Clusters of the run's scenes."""
    weights: Floats
    """(B, C) bootstrap weights of the clusters."""
    cluster: Ints
    """(K,) cluster of each person: a column of the weights."""


def sensed_sessions(
    sessions: Sessions, *, groups: Sequence[str], stages: StageSettings, seed: int
) -> SensedSessions:
    """Sense both sessions of a task and prepare its folds.

    Parameters
    ----------
    sessions : Sessions
    groups : sequence of str
        Clusters of the run's scenes: who is in both is drawn alike in both.
    stages : StageSettings
    seed : int
    """
    names = sorted(set(sessions.group))
    column = {name: place for place, name in enumerate(names)}
    known = {name: place for place, name in enumerate(groups)}
    drawn_as = np.array([known.get(name, -1) for name in names])
    frames = None
    if not sessions.task.shows_scene:
        frames = (_frames(sessions, "probe", seed=seed), _frames(sessions, "gallery", seed=seed))
    return SensedSessions(
        sessions=sessions,
        sensed=(
            _sensed(sessions, "probe", stages=stages, seed=seed),
            _sensed(sessions, "gallery", stages=stages, seed=seed),
        ),
        frames=frames,
        halves=tuple(_half(sessions, fold) for fold in np.unique(sessions.fold).tolist()),
        drawn_as=drawn_as,
        n_groups=len(groups),
        weights=linkage_weights(drawn_as, n_groups=len(groups), task=sessions.task.name, seed=seed),
        cluster=np.array([column[name] for name in sessions.group], dtype=np.int64),
    )


def without(known: SensedSessions, released: Sequence[Release]) -> SensedSessions:
    """Return sessions as they are for these releases: without the samples that they left out.

    Parameters
    ----------
    known : SensedSessions
    released : sequence of Release
        Of the probe and of the gallery side, at the instants of the windows.
    """
    sessions, sensed, frames = known.sessions, list(known.sensed), known.frames
    windows, turned = [sessions.probe, sessions.gallery], [] if frames is None else list(frames)
    lefts = [samples_shared(one, whole) for one, whole in zip(released, sensed, strict=True)]
    for side, left in enumerate(lefts):
        if left is None:
            continue
        sensed[side] = restricted(sensed[side], left)
        windows[side] = restricted(windows[side], left)
        if turned:
            turned[side] = turned[side].of(left.rows)
    if all(left is None for left in lefts):
        return known
    return replace(
        known,
        sessions=replace(sessions, probe=windows[0], gallery=windows[1]),
        sensed=(sensed[0], sensed[1]),
        frames=(turned[0], turned[1]) if turned else None,
    )


def _half(sessions: Sessions, fold: int) -> Half:
    mine = np.flatnonzero(sessions.fold == fold)
    others = np.flatnonzero(sessions.fold != fold)

    def part(searches: Ints, people: Bools | None) -> Pairing:
        probe = np.isin(sessions.probe.search, searches)
        gallery = np.isin(sessions.gallery.search, searches)
        if people is not None:
            probe &= people[sessions.probe.person]
            gallery &= people[sessions.gallery.person]
        place = np.where(gallery, np.cumsum(gallery) - 1, -1)
        mate = sessions.mate[probe]
        return Pairing(
            probe=np.flatnonzero(probe),
            gallery=np.flatnonzero(gallery),
            mate=np.where(mate >= 0, place[mate], -1),
        )

    calibrates = [part(np.array([number]), sessions.calibrates[fold]) for number in others]
    n_probes = sum(one.mate.size for one in calibrates)
    n_mated = sum(int((one.mate >= 0).sum()) for one in calibrates)
    return Half(
        searches=tuple((int(number), part(np.array([number]), None)) for number in mine),
        learns=part(others, sessions.learns[fold]),
        calibrates=tuple(one for one in calibrates if (one.mate >= 0).any()),
        mate_rate=(n_mated + 0.5) / (n_probes + 1.0),
    )


def linkage_weights(drawn_as: Ints, *, n_groups: int, task: str, seed: int) -> Floats:
    """Return bootstrap weights of the clusters of a linkage task, (B, C).

    Clusters that the run's scenes have as well are drawn as they are there; the others are drawn
    among themselves.

    Parameters
    ----------
    drawn_as : (C,) int
        Place of each among the clusters of the run's scenes, or -1.
    n_groups : int
        Clusters of the run's scenes.
    task : str
    seed : int
    """
    weights = np.empty((N_REPLICATES, drawn_as.size))
    again, further = np.flatnonzero(drawn_as >= 0), np.flatnonzero(drawn_as < 0)
    if again.size:
        drawn = cluster_weights(n_clusters=n_groups, n_replicates=N_REPLICATES, seed=seed)
        weights[:, again] = drawn[:, drawn_as[again]]
    if further.size:
        rng = stream(seed, "bootstrap", "linkage", task)
        share = np.full(further.size, 1.0 / further.size)
        weights[:, further] = rng.multinomial(further.size, share, N_REPLICATES)
    return weights


def _side(sessions: Sessions, side: str) -> Windows:
    return sessions.probe if side == "probe" else sessions.gallery


def _sensed(sessions: Sessions, side: str, *, stages: StageSettings, seed: int) -> Sensed:
    """Return what the network senses of one side; every window draws from its own streams."""
    windows, task = _side(sessions, side), sessions.task
    drawn = []
    for size, person, search in zip(
        np.diff(windows.offsets), windows.person, windows.search, strict=True
    ):
        # The number of a closed search is a half, which may change with who else is there.
        key = ("linkage", task.family, side, sessions.source[person])
        drawn.append(
            draw_channel(
                n_samples=np.array([[size]]),
                keys=[(*key, sessions.searches[search]) if task.shows_scene else key],
                settings=stages.sensing,
                seed=seed,
            )
        )
    channel = type(drawn[0])(
        *(np.concatenate([getattr(one, item.name) for one in drawn]) for item in fields(drawn[0]))
    )
    return sense(
        t=windows.t,
        xy=windows.xy,
        offsets=windows.offsets,
        channel=channel,
        settings=stages.sensing,
    )


def _frames(sessions: Sessions, side: str, *, seed: int) -> Frames:
    """Return the frames of one side: those of a walk are its own, whoever else is there."""
    windows = _side(sessions, side)
    drawn = np.empty((len(windows), 4))
    for row, person in enumerate(windows.person):
        rng = stream(seed, "frames", "linkage", sessions.task.family, side, sessions.source[person])
        drawn[row] = rng.random(4)
    sizes = np.diff(windows.offsets)
    angle, *shift, clock = np.repeat(drawn, sizes, axis=0).T
    return Frames(
        cos=np.cos(2.0 * np.pi * angle),
        sin=np.sin(2.0 * np.pi * angle),
        shift_m=FAR_M * (2.0 * np.column_stack(shift) - 1.0),
        # From the start of each window: a recording may last longer than the draw reaches.
        clock_s=LONG_S * clock - np.repeat(windows.t[windows.offsets[:-1]], sizes),
    )
