"""Made-up walks as an attack gets them: a release, its truth, and all that may be granted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from attacks.testing._releases import (
    BOX_M,
    RAW_SIGMA_M,
    copied_release,
    draws,
    in_order,
    joined,
    origins,
    renamed_release,
    shared,
    steps,
)
from isac_track.protocols import TrainingSet
from isac_track.sharing import Fixed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from attacks.testing._releases import Motion, Sampling, Walks
    from isac_track.types import ErrorLaw, Floats, Ints, Release

ACCELERATION = 0.04
"""m^2/s^3, spectral density of the walks' acceleration (Bar-Shalom et al., 2001, ch. 6.2)."""
SPEED_MPS = (1.0, 0.2)
"""Mean and standard deviation at the start."""
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


@cache
def ordinary() -> Case:
    """Return a small release as most are: for checks that compare two runs."""
    sizes = tuple(20 + 4 * row for row in range(8))
    return made_up("ordinary", about="8 walks, noise of 0.3 m", sizes=sizes, sigma_m=0.3)


@cache
def another() -> Case:
    """Return other walks with the same numbers of samples and pseudonyms as the ordinary case."""
    base = ordinary()
    sizes = np.diff(base.release.offsets).tolist()
    case = made_up("another", about="8 other walks, noise of 0.3 m", sizes=sizes, sigma_m=0.3)
    return replace(case, release=replace(case.release, pseudonym=base.release.pseudonym))


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
        release=shared(mine, (name, "release"), mechanism=mechanism, law=law),
        truth=mine.xy,
        mechanism=mechanism,
        train=TrainingSet(shared(others, (name, "train"), mechanism=mechanism, law=law), others.xy),
        repeats=tuple(
            shared(mine, (name, "repeat", row), mechanism=mechanism, law=law)
            for row in range(N_REPEATS)
        ),
    )


def _walks(sizes: Sequence[int], name: tuple[str, ...], *, sampling: Sampling) -> Walks:
    return joined([_walk(size, (*name, row), sampling=sampling) for row, size in enumerate(sizes)])


def _walk(size: int, name: tuple[str | int, ...], *, sampling: Sampling) -> tuple[Floats, Floats]:
    rng = draws(*name)
    step_s = steps(rng, size, sampling=sampling)
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


def _uniform(release: Release, *name: str | int) -> Floats:
    xy: Floats = draws("unrelated", *name).uniform(-BOX_M / 2, BOX_M / 2, release.xy.shape)
    return xy


# The same case, seen otherwise


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
    origin = origins(case.release.offsets, order)
    changed = replace(
        case,
        release=in_order(case.release, order),
        truth=case.truth[origin],
        repeats=tuple(in_order(repeat, order) for repeat in case.repeats),
    )
    return changed, origin


def renamed(case: Case) -> Case:
    """Return the case with other pseudonyms, whose alphabetical order is another one, too."""
    return replace(
        case,
        release=renamed_release(case.release),
        train=TrainingSet(renamed_release(case.train.release), case.train.truth),
        repeats=tuple(map(renamed_release, case.repeats)),
    )


def repeat_as_release(case: Case) -> Release:
    """Return another release of the same walks, under the pseudonyms of the first."""
    return replace(case.repeats[0], pseudonym=case.release.pseudonym)


def copied(case: Case) -> Case:
    """Return the case in arrays of its own; nothing done to them reaches another run."""
    return replace(
        case,
        release=copied_release(case.release),
        truth=case.truth.copy(),
        train=TrainingSet(copied_release(case.train.release), case.train.truth.copy()),
        repeats=tuple(map(copied_release, case.repeats)),
    )


def without_sigma(case: Case) -> Case:
    """Return the case as an adversary without SIGMA gets it."""
    return replace(
        case,
        release=case.release.without_sigma(),
        train=TrainingSet(case.train.release.without_sigma(), case.train.truth),
        repeats=tuple(repeat.without_sigma() for repeat in case.repeats),
    )
