"""Made-up people as a linkage attack gets them: two releases, and all that may be granted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from attacks.testing._releases import (
    BOX_M,
    RAW_SIGMA_M,
    Motion,
    draws,
    in_order,
    of_each,
    shared,
    steps,
)
from isac_track.protocols import LinkageTrainingSet
from isac_track.sharing import Fixed
from isac_track.types import Knowledge

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
_ROUND = (0.0, 2.0 * np.pi)
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

    asked: ClassVar[tuple[str, ...]] = ("probe", "gallery")
    """What the function from `fit` is called with."""
    repeats: ClassVar[None] = None
    """Nobody who links is granted any: the repeats of a walk would be linked already."""
    answers: ClassVar[str] = "scores"
    compared: ClassVar[str] = "scores"
    unit: ClassVar[str] = ""
    relative: ClassVar[str] = " of their spread"

    about: str
    """For messages."""
    probe: Release
    gallery: Release
    mate: Ints
    """(P,) gallery track of the same person, or -1. No attack is given it."""
    mechanism: Fixed
    train: LinkageTrainingSet
    scene: bool
    """Whether the true frame and clock are shown."""

    @property
    def everything(self) -> frozenset[Knowledge]:
        """All that there is to grant."""
        hidden = {Knowledge.REPEATS} if self.scene else {Knowledge.REPEATS, Knowledge.SCENE}
        return frozenset(Knowledge) - hidden

    def read(self, result: Any) -> Floats:  # noqa: ANN401 - a stranger's
        """Return a result as an array; the check of its type is another one.

        Raises
        ------
        ValueError
            If it is not one finite real number for each probe and gallery track.
        """
        expected = (len(self.probe), len(self.gallery))
        try:
            scores = np.asarray(result)
        except ValueError:  # rows of different lengths
            scores = np.asarray(None)
        if scores.dtype.kind not in "fiub":
            shown = type(result).__name__ if scores.ndim == 0 else f"an array of {scores.dtype}"
            raise ValueError(f"expected real numbers of shape (P, G) = {expected}, got {shown}")
        if scores.shape != expected:
            turned = " (turned round?)" if scores.shape == expected[::-1] else ""
            raise ValueError(
                f"scores of shape {scores.shape}, expected (P, G) = {expected}: "
                f"a row for every probe, a column for every gallery track{turned}"
            )
        read_as = scores.astype(np.float64)
        lost = np.count_nonzero(~np.isfinite(read_as))
        if lost:
            raise ValueError(
                f"{lost} of {read_as.size} scores are not finite; who cannot tell gives all "
                "candidates the same score"
            )
        return read_as

    def gaps(self, one: Floats, other: Floats) -> list[Floats]:
        """Return how far apart scores are."""
        return [np.abs(one - other)]

    def spread(self, scores: Floats) -> float:
        """Return what gaps are measured in: scores have no unit, but a lowest and a highest."""
        # Where all scores are alike there is no spread; their size will do.
        return float(np.ptp(scores)) or float(np.abs(scores).max()) or 1.0

    def reordered(
        self,
        rows: Sequence[int] = (5, 2, 0, 3, 6, 1, 4),
        columns: Sequence[int] = (4, 8, 0, 6, 2, 7, 1, 5, 3),
    ) -> tuple[LinkageCase, Callable[[Floats], Floats]]:
        """Return the case with probes and gallery in another order, and how scores follow."""
        changed = replace(
            self,
            probe=in_order(self.probe, rows),
            gallery=in_order(self.gallery, columns),
            mate=np.argsort(columns)[self.mate[list(rows)]],
        )
        return changed, lambda scores: scores[np.ix_(rows, columns)]

    def in_other_frames(self) -> tuple[LinkageCase, Callable[[Floats], Floats]]:
        """Return the case with every walk of all four releases in yet another frame and clock."""
        rng = draws("linkage", "other frames")
        changed = of_each(self, lambda release: _moved(release, rng, together=False))
        return changed, lambda scores: scores


@cache
def ordinary(*, scene: bool) -> LinkageCase:
    """Return a small case as most are, with P < G: for checks that compare two runs."""
    return sized(7, 9, scene=scene)


@cache
def sized(n_probes: int, n_gallery: int, *, scene: bool, name: str = "ordinary") -> LinkageCase:
    """Return so many probes against so many gallery tracks."""
    about = f"P = {n_probes}, G = {n_gallery}, noise of 0.3 m"
    probe, gallery = (N_SAMPLES,) * n_probes, (N_SAMPLES,) * n_gallery
    return made_up(name, about=about, probe=probe, gallery=gallery, scene=scene)


@cache
def another(*, scene: bool) -> LinkageCase:
    """Return other people with the pseudonyms and numbers of samples of the ordinary case."""
    base = ordinary(scene=scene)
    case = sized(7, 9, scene=scene, name="another")
    return replace(
        case,
        about=f"{base.about}, of other people",
        probe=replace(case.probe, pseudonym=base.probe.pseudonym),
        gallery=replace(case.gallery, pseudonym=base.gallery.pseudonym),
    )


@cache
def noisy(sigma_m: float, law: ErrorLaw, *, scene: bool) -> LinkageCase:
    """Return the same 24 people against each other, with the same errors times `sigma_m`."""
    about = f"{N_PEOPLE} people, {law} noise of {sigma_m:g} m"
    return made_up("noisy", about=about, sigma_m=sigma_m, law=law, scene=scene)


@cache
def short(
    probe: tuple[int, ...], gallery: tuple[int, ...], others: tuple[int, ...], *, scene: bool
) -> LinkageCase:
    """Return tracks of so many samples, in both releases and in both of the training set."""
    probes, candidates = (", ".join(map(str, sizes)) for sizes in (probe, gallery))
    about = f"probes of {probes} samples against {candidates}"
    return made_up("short", about=about, probe=probe, gallery=gallery, others=others, scene=scene)


@cache
def irregular(*, scene: bool) -> LinkageCase:
    """Return walks whose steps last from a millisecond to half a minute."""
    return made_up(
        "irregular",
        about="steps from 1 ms to 30 s",
        probe=(60,) * 6,
        gallery=(60,) * 8,
        others=(60,) * 12,
        scene=scene,
        sampling="irregular",
    )


@cache
def unrelated(*, scene: bool) -> LinkageCase:
    """Return people who are not in the gallery, each with a mate drawn from it all the same.

    Mates are drawn one by one, apart from both releases. Whatever the scores, each probe's mate
    comes first with probability 1 / G, independently of all others.
    """
    strangers = made_up("strangers", about="", sigma_m=RAW_SIGMA_M, scene=scene)
    return replace(
        noisy(RAW_SIGMA_M, "radial", scene=scene),
        about=f"{N_PEOPLE} probes of people who are not among the {N_PEOPLE} of the gallery",
        gallery=strangers.gallery,
        mate=draws("linkage", "strangers", "mate").integers(0, N_PEOPLE, N_PEOPLE),
    )


def made_up(
    name: str,
    *,
    about: str,
    probe: Sequence[int] = (N_SAMPLES,) * N_PEOPLE,
    gallery: Sequence[int] = (N_SAMPLES,) * N_PEOPLE,
    sigma_m: float = 0.3,
    scene: bool,
    others: Sequence[int] = (N_SAMPLES,) * N_OTHERS,
    law: ErrorLaw = "radial",
    sampling: Sampling = "steady",
) -> LinkageCase:
    """Return people who differ in speed, in how evenly they walk and in how they turn.

    People, sampling instants, frames and unit errors depend on `name` and sizes alone, so that
    two noise levels differ in nothing else; a noise of `sigma_m`, `RAW_SIGMA_M` or more, is in all
    four releases. `probe` and `gallery` are the samples of each track of the same people (the
    gallery comes in an order of its own), `others` those of either release of the training set,
    which is other people, made alike.
    """
    mechanism = Fixed(d_sigma=sigma_m - RAW_SIGMA_M, law=law)

    def pair(who: str, *sizes: Sequence[int]) -> LinkageTrainingSet:
        streams = "linkage", name, who
        return _pair(streams, sizes, mechanism=mechanism, scene=scene, sampling=sampling)

    victims = pair("victims", probe, gallery)
    return LinkageCase(
        about=about + (", in one frame" if scene else ""),
        probe=victims.probe,
        gallery=victims.gallery,
        mate=victims.mate,
        mechanism=mechanism,
        train=pair("others", others, others),
        scene=scene,
    )


def _pair(
    name: tuple[str, ...],
    sizes: tuple[Sequence[int], ...],
    *,
    mechanism: Fixed,
    scene: bool,
    sampling: Sampling,
) -> LinkageTrainingSet:
    """Return two releases of the same people, and who is who in them."""
    rng = draws(*name, "people")
    speeds = rng.permutation(np.linspace(*SPEEDS_MPS, max(map(len, sizes))))
    people = [_person(float(speed_mps), rng) for speed_mps in speeds]
    releases = []
    for side, of_side in zip(("probe", "gallery"), sizes, strict=True):
        walks = []
        for row, size in enumerate(of_side):
            elapsed = np.cumsum(steps(draws(*name, side, row), size, sampling=sampling))
            t = GAP_S + elapsed if scene and side == "gallery" else elapsed - elapsed[-1]
            walks.append((t, people[row](t)))
        release = shared(walks, (*name, side), mechanism=mechanism)
        # One motion for all that is in one frame, or one for every walk.
        frames = draws(*name, *(() if scene else (side,)), "frames")
        releases.append(_moved(release, frames, together=scene))
    # In an order of its own, lest a place in the list tell who is who.
    order = draws(*name, "order").permutation(len(sizes[1]))
    place = np.argsort(order)
    rows = np.arange(len(sizes[0]))
    return LinkageTrainingSet(
        probe=releases[0],
        gallery=in_order(releases[1], order.tolist()),
        mate=np.where(rows < place.size, place[np.minimum(rows, place.size - 1)], -1),
    )


def _person(speed_mps: float, rng: np.random.Generator) -> Callable[[Floats], Floats]:
    """Return where somebody is at times before and after 0, (M,) s -> (M, 2) m.

    Speed and turning rate each sway about a mean of their own.
    """
    sway, sway_s, sway_phase = rng.uniform(*SWAY), rng.uniform(*SWAY_S), rng.uniform(*_ROUND)
    turn_radps = rng.uniform(*TURN_RADPS)
    wind_radps, wind_s = rng.uniform(*WIND_RADPS), rng.uniform(*WIND_S)
    wind_phase, heading_rad = rng.uniform(*_ROUND), rng.uniform(*_ROUND)
    start_m = rng.uniform(-BOX_M / 2, BOX_M / 2, 2)

    def positions(t: Floats) -> Floats:
        first, last = min(float(t[0]), 0.0) - _GRID_S, max(float(t[-1]), 0.0) + _GRID_S
        grid = np.linspace(first, last, 2 + int((last - first) / _GRID_S))
        cycle = 2.0 * np.pi / np.array([sway_s, wind_s])
        speed = speed_mps * (1.0 + sway * np.sin(cycle[0] * grid + sway_phase))
        wind = wind_radps / cycle[1] * -np.cos(cycle[1] * grid + wind_phase)
        heading = heading_rad + turn_radps * grid + wind
        velocity = speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        step = np.diff(grid)[:, None] * (velocity[1:] + velocity[:-1]) / 2.0
        way = np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])
        xy = np.column_stack([np.interp(t, grid, axis) for axis in way.T])
        here = [float(np.interp(0.0, grid, axis)) for axis in way.T]
        placed: Floats = xy - here + start_m
        return placed

    return positions


def _moved(release: Release, rng: np.random.Generator, *, together: bool) -> Release:
    """Return a release with one motion for all its walks, or with one for each."""
    motions = [
        Motion(
            angle_rad=rng.uniform(*_ROUND),
            shift_m=tuple(rng.uniform(-_FARTHEST_M, _FARTHEST_M, 2)),
            clock_s=rng.uniform(0.0, _LATEST_S),
        )
        for _ in range(1 if together else len(release))
    ]
    if together:
        return motions[0].of_release(release)
    walks = [motion.of_release(walk) for motion, walk in zip(motions, release, strict=True)]
    return replace(
        release,
        t=np.concatenate([walk.t for walk in walks]),
        xy=np.concatenate([walk.xy for walk in walks]),
    )


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
            train.probe,
            in_order(train.gallery, stays.tolist()),
            np.where(mate >= 0, place[mate], -1),
        ),
    )


def with_others_reordered(case: LinkageCase) -> LinkageCase:
    """Return the case with the gallery of the training set from last to first."""
    train = case.train
    last = len(train.gallery) - 1
    gallery = in_order(train.gallery, range(last, -1, -1))
    mate = np.where(train.mate >= 0, last - train.mate, -1)
    return replace(case, train=LinkageTrainingSet(train.probe, gallery, mate))
