"""Made-up people as a linkage attack gets them: two releases, and all that may be granted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from attacks.testing._releases import (
    BOX_M,
    RAW_SIGMA_M,
    Motion,
    copied_release,
    draws,
    in_order,
    joined,
    renamed_release,
    shared,
    steps,
)
from isac_track.protocols import LinkageTrainingSet
from isac_track.sharing import Fixed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from attacks.testing._releases import Sampling
    from isac_track.types import ErrorLaw, Floats, Ints, Release

SPEEDS_MPS = (0.6, 2.0)
"""Slowest and fastest of the people in a release; the others lie between, evenly spaced."""
SWAY = (0.05, 0.3)
"""By what share of itself a person's speed rises and falls."""
SWAY_S = (2.0, 6.0)
TURN_RADPS = (-0.25, 0.25)
"""How fast a person turns on the whole."""
WIND_RADPS = (0.1, 0.8)
"""By how much more or less on the way, to either side."""
WIND_S = (3.0, 8.0)
GAP_S = 1.0
"""Silence before the gallery goes on, where the scene is shown."""
N_PEOPLE = 24
N_OTHERS = 20
N_SAMPLES = 128
"""12 s at 8 to 16 Hz."""
_GRID_S = 0.02
_FARTHEST_M = 100.0
_LATEST_S = 1000.0


@dataclass(frozen=True, eq=False, slots=True)
class LinkageCase:
    """P probes, G gallery tracks, and everything that an adversary may know besides.

    Where the scene is hidden, every walk of all four releases comes in a frame and on a clock of
    its own. Probe and gallery are then two recordings of one walk. Where the scene is shown, all
    is in one frame and on one clock, and the gallery goes on after `GAP_S` of silence.
    """

    about: str
    """For messages."""
    probe: Release
    gallery: Release
    mate: Ints
    """(P,) gallery track of the same person, or -1. No attack is given it."""
    mechanism: Fixed
    train: LinkageTrainingSet


@dataclass(frozen=True, slots=True)
class _Person:
    """How somebody walks: speed and turning rate, each swaying about a mean of their own."""

    speed_mps: float
    sway: float
    sway_s: float
    sway_phase: float
    turn_radps: float
    wind_radps: float
    wind_s: float
    wind_phase: float
    heading_rad: float
    start_m: tuple[float, float]
    """Where they are at time 0."""

    def positions(self, t: Floats) -> Floats:
        """Return where they are at times before and after 0, (M, 2) m."""
        first, last = min(float(t[0]), 0.0) - _GRID_S, max(float(t[-1]), 0.0) + _GRID_S
        grid = np.linspace(first, last, 2 + int((last - first) / _GRID_S))
        cycle = 2.0 * np.pi / np.array([self.sway_s, self.wind_s])
        speed = self.speed_mps * (1.0 + self.sway * np.sin(cycle[0] * grid + self.sway_phase))
        wind = self.wind_radps / cycle[1] * -np.cos(cycle[1] * grid + self.wind_phase)
        heading = self.heading_rad + self.turn_radps * grid + wind
        velocity = speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        step = np.diff(grid)[:, None] * (velocity[1:] + velocity[:-1]) / 2.0
        way = np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])
        xy = np.column_stack([np.interp(t, grid, axis) for axis in way.T])
        here = [float(np.interp(0.0, grid, axis)) for axis in way.T]
        placed: Floats = xy - here + self.start_m
        return placed


@cache
def ordinary(*, scene: bool) -> LinkageCase:
    """Return a small case as most are, with P < G: for checks that compare two runs."""
    return sized(7, 9, scene=scene)


@cache
def sized(n_probes: int, n_gallery: int, *, scene: bool) -> LinkageCase:
    """Return so many probes against so many gallery tracks."""
    return made_up(
        "ordinary",
        about=f"P = {n_probes}, G = {n_gallery}, noise of 0.3 m",
        probe=(N_SAMPLES,) * n_probes,
        gallery=(N_SAMPLES,) * n_gallery,
        sigma_m=0.3,
        scene=scene,
    )


@cache
def another(*, scene: bool) -> LinkageCase:
    """Return other people with the pseudonyms and numbers of samples of the ordinary case."""
    base = ordinary(scene=scene)
    case = made_up(
        "another",
        about=f"{base.about}, of other people",
        probe=(N_SAMPLES,) * len(base.probe),
        gallery=(N_SAMPLES,) * len(base.gallery),
        sigma_m=0.3,
        scene=scene,
    )
    return replace(
        case,
        probe=replace(case.probe, pseudonym=base.probe.pseudonym),
        gallery=replace(case.gallery, pseudonym=base.gallery.pseudonym),
    )


@cache
def noisy(sigma_m: float, law: ErrorLaw, *, scene: bool) -> LinkageCase:
    """Return the same 24 people against each other, with the same errors times `sigma_m`."""
    return made_up(
        "noisy",
        about=f"{N_PEOPLE} people, {law} noise of {sigma_m:g} m",
        probe=(N_SAMPLES,) * N_PEOPLE,
        gallery=(N_SAMPLES,) * N_PEOPLE,
        sigma_m=sigma_m,
        law=law,
        scene=scene,
    )


@cache
def short(
    probe: tuple[int, ...], gallery: tuple[int, ...], others: tuple[int, ...], *, scene: bool
) -> LinkageCase:
    """Return tracks of so many samples, in both releases and in both of the training set."""

    def shown(sizes: tuple[int, ...]) -> str:
        return ", ".join(map(str, sizes))

    return made_up(
        "short",
        about=f"probes of {shown(probe)} samples against {shown(gallery)}",
        probe=probe,
        gallery=gallery,
        others=others,
        sigma_m=0.3,
        scene=scene,
    )


@cache
def irregular(*, scene: bool) -> LinkageCase:
    """Return walks whose steps last from a millisecond to half a minute."""
    return made_up(
        "irregular",
        about="steps from 1 ms to 30 s",
        probe=(60,) * 6,
        gallery=(60,) * 8,
        others=(60,) * 12,
        sigma_m=0.3,
        scene=scene,
        sampling="irregular",
    )


@cache
def unrelated(*, scene: bool) -> LinkageCase:
    """Return people who are not in the gallery, each with a mate drawn from it all the same.

    Mates are drawn one by one, apart from both releases. Whatever the scores, each probe's mate
    comes first with probability 1 / G, independently of all others.
    """
    base = noisy(RAW_SIGMA_M, "radial", scene=scene)
    strangers = made_up(
        "strangers",
        about="",
        probe=(N_SAMPLES,) * N_PEOPLE,
        gallery=(N_SAMPLES,) * N_PEOPLE,
        sigma_m=RAW_SIGMA_M,
        scene=scene,
    )
    return replace(
        base,
        about=f"{N_PEOPLE} probes of people who are not among the {N_PEOPLE} of the gallery",
        gallery=strangers.gallery,
        mate=draws("linkage", "strangers", "mate").integers(0, N_PEOPLE, N_PEOPLE),
    )


def made_up(
    name: str,
    *,
    about: str,
    probe: Sequence[int],
    gallery: Sequence[int],
    sigma_m: float,
    scene: bool,
    others: Sequence[int] = (N_SAMPLES,) * N_OTHERS,
    law: ErrorLaw = "radial",
    sampling: Sampling = "steady",
) -> LinkageCase:
    """Return people who differ in speed, in how evenly they walk and in how they turn.

    People, sampling instants, frames and unit errors depend on `name` and sizes alone, so that
    two noise levels differ in nothing else. The training set is other people, made alike.

    Parameters
    ----------
    name : str
        Of the random streams.
    about : str
    probe, gallery : sequence of int
        Samples of each probe, and of the gallery track of the same person; the gallery comes in
        an order of its own.
    sigma_m : float
        `RAW_SIGMA_M` or more, in all four releases.
    scene : bool
        Whether the true frame and clock are shown.
    others : sequence of int
        Samples of the tracks of the training set, in either of its releases.
    law : {"radial", "isotropic"}
    sampling : {"steady", "irregular"}
        Steps at 8 to 16 Hz, or from a millisecond to half a minute.
    """
    mechanism = Fixed(d_sigma=sigma_m - RAW_SIGMA_M, law=law)
    pairs = [
        _pair(
            (name, what),
            sizes,
            mechanism=mechanism,
            law=law,
            scene=scene,
            sampling=sampling,
        )
        for what, sizes in (("victims", (probe, gallery)), ("others", (others, others)))
    ]
    return LinkageCase(
        about=about + (", in one frame" if scene else ""),
        probe=pairs[0].probe,
        gallery=pairs[0].gallery,
        mate=pairs[0].mate,
        mechanism=mechanism,
        train=pairs[1],
    )


def _pair(
    name: tuple[str, ...],
    sizes: tuple[Sequence[int], Sequence[int]],
    *,
    mechanism: Fixed,
    law: ErrorLaw,
    scene: bool,
    sampling: Sampling,
) -> LinkageTrainingSet:
    """Return two releases of the same people, and who is who in them."""
    name = ("linkage", *name)
    people = _people(name, max(map(len, sizes)))
    releases = []
    for side, of_side in zip(("probe", "gallery"), sizes, strict=True):
        walks = []
        for row, size in enumerate(of_side):
            elapsed = np.cumsum(steps(draws(*name, side, row), size, sampling=sampling))
            t = GAP_S + elapsed if scene and side == "gallery" else elapsed - elapsed[-1]
            walks.append((t, people[row].positions(t)))
        release = shared(joined(walks), (*name, side), mechanism=mechanism, law=law)
        # One motion for all that is in one frame, or one for every walk.
        frames = draws(*name, *(() if scene else (side,)), "frames")
        count = 1 if scene else len(of_side)
        releases.append(moved(release, [_motion(frames) for _ in range(count)]))
    # In an order of its own, lest a place in the list tell who is who.
    order = draws(*name, "order").permutation(len(sizes[1]))
    place = np.argsort(order)
    rows = np.arange(len(sizes[0]))
    return LinkageTrainingSet(
        probe=releases[0],
        gallery=in_order(releases[1], order.tolist()),
        mate=np.where(rows < place.size, place[np.minimum(rows, place.size - 1)], -1),
    )


def _people(name: tuple[str, ...], count: int) -> list[_Person]:
    rng = draws(*name, "people")
    speeds = rng.permutation(np.linspace(*SPEEDS_MPS, count))
    return [
        _Person(
            speed_mps=float(speed),
            sway=rng.uniform(*SWAY),
            sway_s=rng.uniform(*SWAY_S),
            sway_phase=rng.uniform(0.0, 2.0 * np.pi),
            turn_radps=rng.uniform(*TURN_RADPS),
            wind_radps=rng.uniform(*WIND_RADPS),
            wind_s=rng.uniform(*WIND_S),
            wind_phase=rng.uniform(0.0, 2.0 * np.pi),
            heading_rad=rng.uniform(0.0, 2.0 * np.pi),
            start_m=tuple(rng.uniform(-BOX_M / 2, BOX_M / 2, 2)),
        )
        for speed in speeds
    ]


def _motion(rng: np.random.Generator) -> Motion:
    return Motion(
        angle_rad=rng.uniform(0.0, 2.0 * np.pi),
        shift_m=tuple(rng.uniform(-_FARTHEST_M, _FARTHEST_M, 2)),
        clock_s=rng.uniform(0.0, _LATEST_S),
    )


# The same case, seen otherwise


def moved(release: Release, motions: Sequence[Motion]) -> Release:
    """Return a release with one motion for all its walks, or with one for each."""
    if len(motions) == 1:
        return motions[0].of_release(release)
    walks = [motion.of_release(walk) for motion, walk in zip(motions, release, strict=True)]
    return replace(
        release,
        t=np.concatenate([walk.t for walk in walks]),
        xy=np.concatenate([walk.xy for walk in walks]),
    )


def in_other_frames(case: LinkageCase) -> LinkageCase:
    """Return the case with every walk of all four releases in yet another frame and clock."""
    rng = draws("linkage", "other frames")

    def elsewhere(release: Release) -> Release:
        return moved(release, [_motion(rng) for _ in range(len(release))])

    return _of_each(case, elsewhere)


def reordered(case: LinkageCase, rows: Sequence[int], columns: Sequence[int]) -> LinkageCase:
    """Return the case with its probes and its gallery tracks in another order."""
    return replace(
        case,
        probe=in_order(case.probe, rows),
        gallery=in_order(case.gallery, columns),
        mate=np.argsort(columns)[case.mate[list(rows)]],
    )


def renamed(case: LinkageCase) -> LinkageCase:
    """Return the case with other pseudonyms, whose alphabetical order is another one, too.

    Probes and gallery share their pseudonyms then, but not with whom they belong together.
    """
    return _of_each(case, renamed_release)


def copied(case: LinkageCase) -> LinkageCase:
    """Return the case in arrays of its own; nothing done to them reaches another run."""
    own = _of_each(case, copied_release)
    mate = case.train.mate.copy()
    return replace(own, mate=own.mate.copy(), train=replace(own.train, mate=mate))


def without_sigma(case: LinkageCase) -> LinkageCase:
    """Return the case as an adversary without SIGMA gets it."""
    return _of_each(case, type(case.probe).without_sigma)


def without_mates(case: LinkageCase) -> LinkageCase:
    """Return the case with a training set in which every third probe has no mate.

    Of every other such probe the gallery track is gone, of the rest it stays as a stranger's.
    """
    train = case.train
    mate = train.mate.copy()
    mate[::3] = -1
    gone = train.mate[::6]
    stays = np.setdiff1d(np.arange(len(train.gallery)), gone)
    place = np.full(len(train.gallery), -1)
    place[stays] = np.arange(stays.size)
    return replace(
        case,
        about=f"{case.about}, {np.count_nonzero(mate < 0)} of {mate.size} others without a mate",
        train=LinkageTrainingSet(
            probe=train.probe,
            gallery=in_order(train.gallery, stays.tolist()),
            mate=np.where(mate >= 0, place[mate], -1),
        ),
    )


def with_others_reordered(case: LinkageCase) -> LinkageCase:
    """Return the case with the gallery of the training set from last to first."""
    train = case.train
    last = len(train.gallery) - 1
    return replace(
        case,
        train=LinkageTrainingSet(
            probe=train.probe,
            gallery=in_order(train.gallery, range(last, -1, -1)),
            mate=np.where(train.mate >= 0, last - train.mate, -1),
        ),
    )


def _of_each(case: LinkageCase, change: Callable[[Release], Release]) -> LinkageCase:
    return replace(
        case,
        probe=change(case.probe),
        gallery=change(case.gallery),
        train=LinkageTrainingSet(
            probe=change(case.train.probe),
            gallery=change(case.train.gallery),
            mate=case.train.mate,
        ),
    )
