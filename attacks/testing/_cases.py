"""Made-up walks as an attack gets them: a release, its truth, and all that may be granted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from math import log
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from isac_track.protocols import TrainingSet
from isac_track.rng import stream
from isac_track.sensing import fisher_information_density, unit_errors
from isac_track.sharing import Fixed
from isac_track.types import Release, Sensed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isac_track.types import ErrorLaw, Floats, Ints

Sampling: TypeAlias = Literal["steady", "irregular"]

SEED = 0
EPSILON_M = 0.3
RAW_SIGMA_M = 0.05
"""Of the sensing; all else is added by the mechanism."""
ACCELERATION = 0.04
"""m^2/s^3, spectral density of the walks' acceleration (Bar-Shalom et al., 2001, ch. 6.2)."""
SPEED_MPS = (1.0, 0.2)
"""Mean and standard deviation at the start."""
BOX_M = 20.0
"""Side of the square in which walks start."""
STEADY_STEP_S = (1 / 16, 1 / 8)
IRREGULAR_STEP_S = (1e-3, 30.0)
N_TRACKS = 24
N_REPEATS = 2


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """One release with M samples, and everything that an adversary may know besides."""

    about: str
    """For messages."""
    release: Release
    truth: Floats
    """(M, 2) m"""
    mechanism: Fixed
    train: TrainingSet
    repeats: tuple[Release, ...]


@dataclass(frozen=True, eq=False, slots=True)
class _Walks:
    t: Floats
    xy: Floats
    offsets: Ints


@cache
def ordinary() -> Case:
    """Return a small release as most are: for checks that compare two runs."""
    sizes = tuple(20 + 4 * row for row in range(8))
    return made_up("ordinary", about="8 walks, noise of 0.3 m", sizes=sizes, sigma_m=0.3)


@cache
def noisy(sigma_m: float, law: ErrorLaw) -> Case:
    """Return the same 24 walks of 60 to 200 samples, with the same errors times `sigma_m`."""
    sizes = tuple(60 + 6 * row for row in range(N_TRACKS))
    about = f"{N_TRACKS} walks, {law} noise of {sigma_m:g} m"
    return made_up("noisy", about=about, sizes=sizes, sigma_m=sigma_m, law=law)


@cache
def short(sizes: tuple[int, ...]) -> Case:
    """Return a release with tracks of so many samples."""
    about = f"tracks of {', '.join(map(str, sizes))} samples"
    return made_up("short", about=about, sizes=sizes, sigma_m=0.3)


@cache
def irregular() -> Case:
    """Return walks whose steps last from a millisecond to half a minute."""
    return made_up(
        "irregular",
        about="8 walks with steps from 1 ms to 30 s",
        sizes=(60,) * 8,
        sigma_m=0.3,
        sampling="irregular",
    )


@cache
def unrelated() -> Case:
    """Return positions and truths drawn apart from each other, uniformly in one square.

    Every true position is drawn by itself. Whatever is said of it, it lies within epsilon with
    probability pi epsilon^2 / `BOX_M`^2 at most, independently of all others.
    """
    base = noisy(BOX_M, "isotropic")
    xy = _uniform(base.release, "released")
    return replace(
        base,
        about=f"{N_TRACKS} tracks of positions that have nothing to do with the truth",
        release=replace(base.release, xy=xy),
        truth=_uniform(base.release, "truth"),
        train=TrainingSet(
            replace(base.train.release, xy=_uniform(base.train.release, "train")),
            _uniform(base.train.release, "train truth"),
        ),
        repeats=tuple(
            replace(repeat, xy=_uniform(repeat, "repeat", row))
            for row, repeat in enumerate(base.repeats)
        ),
    )


def made_up(
    name: str,
    *,
    about: str,
    sizes: Sequence[int],
    sigma_m: float,
    law: ErrorLaw = "radial",
    sampling: Sampling = "steady",
) -> Case:
    """Return smooth walks at about 1 m/s, shared with errors of standard deviation `sigma_m`.

    Walks and unit errors depend on `name` and sizes alone, so that two noise levels differ in
    nothing else. The training set is other people, recorded and shared alike.

    Parameters
    ----------
    name : str
        Of the random streams.
    about : str
    sizes : sequence of int
        Samples of each track.
    sigma_m : float
        `RAW_SIGMA_M` or more.
    law : {"radial", "isotropic"}
    sampling : {"steady", "irregular"}
        Steps at 8 to 16 Hz, or from a millisecond to half a minute.
    """
    mechanism = Fixed(d_sigma=sigma_m - RAW_SIGMA_M, law=law)
    mine = _walks(sizes, (name, "walks"), sampling=sampling)
    others = _walks([40 + 4 * row for row in range(12)], (name, "others"), sampling=sampling)
    return Case(
        about=about,
        release=_shared(mine, (name, "release"), mechanism=mechanism, law=law),
        truth=mine.xy,
        mechanism=mechanism,
        train=TrainingSet(
            _shared(others, (name, "train"), mechanism=mechanism, law=law), others.xy
        ),
        repeats=tuple(
            _shared(mine, (name, "repeat", row), mechanism=mechanism, law=law)
            for row in range(N_REPEATS)
        ),
    )


def _walks(sizes: Sequence[int], name: tuple[str, ...], *, sampling: Sampling) -> _Walks:
    tracks = [_walk(size, (*name, row), sampling=sampling) for row, size in enumerate(sizes)]
    return _Walks(
        t=np.concatenate([t for t, _ in tracks]),
        xy=np.concatenate([xy for _, xy in tracks]),
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
    )


def _walk(size: int, name: tuple[str | int, ...], *, sampling: Sampling) -> tuple[Floats, Floats]:
    rng = _stream(*name)
    if sampling == "steady":
        step_s: Floats = rng.uniform(*STEADY_STEP_S, size)
    else:
        low, high = map(log, IRREGULAR_STEP_S)
        step_s = np.exp(rng.uniform(low, high, size))
    t: Floats = rng.uniform(0.0, 60.0) + np.cumsum(step_s)
    direction = rng.uniform(0.0, 2.0 * np.pi)
    velocity = rng.normal(*SPEED_MPS) * np.array([np.cos(direction), np.sin(direction)])
    # What white acceleration does in one step to velocity and, jointly, to position.
    kick = np.sqrt(ACCELERATION * step_s[1:, None]) * rng.standard_normal((size - 1, 2))
    apart = np.sqrt(ACCELERATION * step_s[1:, None] ** 3 / 12.0)
    shift = step_s[1:, None] * kick / 2.0 + apart * rng.standard_normal((size - 1, 2))
    before = velocity + np.cumsum(kick, axis=0) - kick
    start = rng.uniform(-BOX_M / 2, BOX_M / 2, (1, 2))
    xy = np.concatenate([start, start + np.cumsum(step_s[1:, None] * before + shift, axis=0)])
    return t, xy


def _shared(
    walks: _Walks, name: tuple[str | int, ...], *, mechanism: Fixed, law: ErrorLaw
) -> Release:
    unit = unit_errors(n_samples=walks.t.size, law=law, rng=_stream("errors", *name))
    information = np.full(walks.t.size, RAW_SIGMA_M**-2)
    sensed = Sensed(
        t=walks.t,
        xy=walks.xy + RAW_SIGMA_M * unit,
        unit_error=unit,
        sigma_raw=np.full(walks.t.size, RAW_SIGMA_M),
        information=information,
        fid=fisher_information_density(information=information, t=walks.t, offsets=walks.offsets),
        offsets=walks.offsets,
        law=law,
    )
    return mechanism.share(sensed, _stream("share", *name))


def _uniform(release: Release, *name: str | int) -> Floats:
    xy: Floats = _stream("unrelated", *name).uniform(-BOX_M / 2, BOX_M / 2, release.xy.shape)
    return xy


def _stream(*name: str | int) -> np.random.Generator:
    return stream(SEED, "attacks", "testing", *name)


# The same case, seen otherwise


@dataclass(frozen=True, slots=True)
class Motion:
    """A frame and a clock: turned, then shifted."""

    angle_rad: float
    shift_m: tuple[float, float]
    clock_s: float

    def of_points(self, xy: Floats) -> Floats:
        """Return points, (M, 2) m, in this frame."""
        cos, sin = np.cos(self.angle_rad), np.sin(self.angle_rad)
        moved: Floats = xy @ np.array([[cos, sin], [-sin, cos]]) + self.shift_m
        return moved

    def of_release(self, release: Release) -> Release:
        """Return a release in this frame and on this clock."""
        return replace(release, t=release.t + self.clock_s, xy=self.of_points(release.xy))


def moved(case: Case, motions: Sequence[Motion]) -> Case:
    """Return the case with the release, the training set and each repeat in frames of their own.

    That is how an adversary without SCENE gets them.
    """
    mine, others, *further = motions
    return replace(
        case,
        release=mine.of_release(case.release),
        truth=mine.of_points(case.truth),
        train=TrainingSet(
            others.of_release(case.train.release), others.of_points(case.train.truth)
        ),
        repeats=tuple(
            motion.of_release(repeat) for motion, repeat in zip(further, case.repeats, strict=True)
        ),
    )


def reordered(case: Case, order: Sequence[int]) -> tuple[Case, Ints]:
    """Return the case with its tracks in another order, and where each sample came from, (M,)."""
    offsets = case.release.offsets
    origin = np.concatenate([np.arange(offsets[row], offsets[row + 1]) for row in order])
    changed = replace(
        case,
        release=_in_order(case.release, order, origin),
        truth=case.truth[origin],
        repeats=tuple(_in_order(repeat, order, origin) for repeat in case.repeats),
    )
    return changed, origin


def renamed(case: Case) -> Case:
    """Return the case with other pseudonyms, whose alphabetical order is another one, too."""
    return replace(
        case,
        release=_renamed(case.release),
        train=TrainingSet(_renamed(case.train.release), case.train.truth),
        repeats=tuple(map(_renamed, case.repeats)),
    )


def copied(case: Case) -> Case:
    """Return the case in arrays of its own; nothing done to them reaches another run."""
    return replace(
        case,
        release=_copied(case.release),
        truth=case.truth.copy(),
        train=TrainingSet(_copied(case.train.release), case.train.truth.copy()),
        repeats=tuple(map(_copied, case.repeats)),
    )


def without_sigma(case: Case) -> Case:
    """Return the case as an adversary without SIGMA gets it."""
    return replace(
        case,
        release=case.release.without_sigma(),
        train=TrainingSet(case.train.release.without_sigma(), case.train.truth),
        repeats=tuple(repeat.without_sigma() for repeat in case.repeats),
    )


def _in_order(release: Release, order: Sequence[int], origin: Ints) -> Release:
    sizes = np.diff(release.offsets)[list(order)]
    return Release(
        t=release.t[origin],
        xy=release.xy[origin],
        sigma=None if release.sigma is None else release.sigma[origin],
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        pseudonym=tuple(release.pseudonym[row] for row in order),
    )


def _renamed(release: Release) -> Release:
    ranks = {name: rank for rank, name in enumerate(sorted(release.pseudonym, reverse=True))}
    return replace(release, pseudonym=tuple(f"p{ranks[name]:04}" for name in release.pseudonym))


def _copied(release: Release) -> Release:
    return Release(
        t=release.t.copy(),
        xy=release.xy.copy(),
        sigma=None if release.sigma is None else release.sigma.copy(),
        offsets=release.offsets.copy(),
        pseudonym=release.pseudonym,
    )
