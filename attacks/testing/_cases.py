"""Made-up walks as an attack gets them: a release, its truth, and all that may be granted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from attacks.testing._releases import (
    BOX_M,
    RAW_SIGMA_M,
    Motion,
    draws,
    in_order,
    of_each,
    origins,
    shared,
    steps,
)
from isac_track.protocols import TrainingSet
from isac_track.sharing import Fixed
from isac_track.types import Knowledge

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from attacks.testing._releases import Sampling, Walk
    from isac_track.types import ErrorLaw, Floats, Release

ACCELERATION = 0.04
"""m^2/s^3, spectral density of the walks' acceleration (Bar-Shalom et al., 2001, ch. 6.2)."""
SPEED_MPS = (1.0, 0.2)
"""Mean and standard deviation at the start."""
N_TRACKS = 24
N_REPEATS = 2
FRAMES = (
    Motion(angle_rad=2.1, shift_m=(35.0, -80.0), clock_s=500.0),
    Motion(angle_rad=-0.7, shift_m=(-60.0, 15.0), clock_s=-20.0),
    Motion(angle_rad=1.2, shift_m=(5.0, 140.0), clock_s=120.0),
    Motion(angle_rad=-2.8, shift_m=(-90.0, -30.0), clock_s=1000.0),
)
"""Of the release, the training set and the two repeats: without SCENE, no two are the same."""


class Estimate(NamedTuple):
    """What an attack returned, read as arrays."""

    xy: Floats
    """(M, 2) m"""
    std: Floats | None
    """(M,) m"""


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """One release with M samples, and everything that an adversary may know besides."""

    asked: ClassVar[tuple[str, ...]] = ("release",)
    """What the function from `fit` is called with."""
    everything: ClassVar[frozenset[Knowledge]] = frozenset(Knowledge)
    answers: ClassVar[str] = "positions"
    compared: ClassVar[str] = "positions or std"
    unit: ClassVar[str] = " m"
    relative: ClassVar[str] = ""

    about: str
    """For messages."""
    release: Release
    truth: Floats
    """(M, 2) m. No attack is given it."""
    mechanism: Fixed
    train: TrainingSet
    repeats: tuple[Release, ...]

    def read(self, result: Any) -> Estimate:  # noqa: ANN401 - a stranger's
        """Return a result as arrays; positions alone will do, the check of the type is another one.

        Raises
        ------
        ValueError
            If it is not one finite position per sample.
        """
        try:
            xy = np.asarray(getattr(result, "xy", result), dtype=np.float64)
        except (TypeError, ValueError):
            raise ValueError(f"expected a Reconstruction, got {type(result).__name__}") from None
        if xy.shape != self.release.xy.shape:
            raise ValueError(
                f"positions of shape {xy.shape}, expected {self.release.xy.shape}: one for "
                "every sample of the release, in its order"
            )
        lost = int(np.count_nonzero(~np.isfinite(xy).all(axis=1)))
        if lost:
            raise ValueError(f"{lost} of {len(xy)} positions are not finite")
        std = getattr(result, "std", None) if hasattr(result, "xy") else None  # arrays have a std()
        return Estimate(xy=xy, std=None if std is None else np.asarray(std, dtype=np.float64))

    def gaps(self, one: Estimate, other: Estimate) -> list[Floats]:
        """Return how far apart two answers are, m: positions, and std if either has it."""
        found: list[Floats] = [np.hypot(*(one.xy - other.xy).T)]
        if one.std is not None and other.std is not None and one.std.shape == other.std.shape:
            found.append(np.abs(one.std - other.std))
        elif (one.std is None) != (other.std is None):
            found.append(np.array([np.inf]))
        return found

    def spread(self, answer: Estimate) -> float:
        """Return what gaps are measured in, m."""
        del answer
        return 1.0

    def reordered(
        self, order: Sequence[int] = (5, 2, 7, 0, 3, 6, 1, 4)
    ) -> tuple[Case, Callable[[Estimate], Estimate]]:
        """Return the case with its tracks in another order, and how an answer follows."""
        origin = origins(self.release.offsets, order)
        changed = replace(
            self,
            release=in_order(self.release, order),
            truth=self.truth[origin],
            repeats=tuple(in_order(repeat, order) for repeat in self.repeats),
        )
        return changed, lambda answer: Estimate(
            answer.xy[origin], None if answer.std is None else answer.std[origin]
        )

    def in_other_frames(self) -> tuple[Case, Callable[[Estimate], Estimate]]:
        """Return the case with release, training set and each repeat in frames of their own.

        That is how an adversary without SCENE gets them. And how an answer follows.
        """
        mine, others, *_ = frames = list(FRAMES)
        changed = of_each(self, lambda release: frames.pop(0).of_release(release))
        moved = replace(
            changed,
            truth=mine.of_points(self.truth),
            train=TrainingSet(changed.train.release, others.of_points(self.train.truth)),
        )
        return moved, lambda answer: Estimate(mine.of_points(answer.xy), answer.std)


@cache
def ordinary() -> Case:
    """Return a small release as most are: for checks that compare two runs."""
    sizes = tuple(20 + 4 * row for row in range(8))
    return made_up("ordinary", about="8 walks, noise of 0.3 m", sizes=sizes)


@cache
def another() -> Case:
    """Return other walks with the same numbers of samples and pseudonyms as the ordinary case."""
    base = ordinary()
    sizes = np.diff(base.release.offsets).tolist()
    case = made_up("another", about="8 other walks, noise of 0.3 m", sizes=sizes)
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
    return made_up("short", about=f"tracks of {', '.join(map(str, sizes))} samples", sizes=sizes)


@cache
def irregular() -> Case:
    """Return walks whose steps last from a millisecond to half a minute."""
    about = "8 walks with steps from 1 ms to 30 s"
    return made_up("irregular", about=about, sizes=(60,) * 8, sampling="irregular")


@cache
def unrelated() -> Case:
    """Return positions and truths drawn apart from each other, uniformly in one square.

    Every true position is drawn by itself. Whatever is said of it, it lies within epsilon with
    probability pi epsilon^2 / `BOX_M`^2 at most, independently of all others.
    """

    def scattered(release: Release, *name: str | int) -> Release:
        return replace(release, xy=_uniform(release, *name))

    base = noisy(BOX_M, "isotropic")
    others = base.train.release
    return replace(
        base,
        about=f"{N_TRACKS} tracks of positions that have nothing to do with the truth",
        release=scattered(base.release, "released"),
        truth=_uniform(base.release, "truth"),
        train=TrainingSet(scattered(others, "train"), _uniform(others, "train truth")),
        repeats=tuple(scattered(one, "repeat", row) for row, one in enumerate(base.repeats)),
    )


def made_up(
    name: str,
    *,
    about: str,
    sizes: Sequence[int],
    sigma_m: float = 0.3,
    law: ErrorLaw = "radial",
    sampling: Sampling = "steady",
) -> Case:
    """Return smooth walks at about 1 m/s, shared with errors of standard deviation `sigma_m`.

    Walks and unit errors depend on `name` and `sizes` (samples of each track) alone, so that two
    noise levels, of `RAW_SIGMA_M` or more, differ in nothing else. The training set is other
    people, recorded and shared alike.
    """
    mechanism = Fixed(d_sigma=sigma_m - RAW_SIGMA_M, law=law)

    def walks(who: str, sizes: Sequence[int]) -> tuple[list[Walk], Floats]:
        made = [_walk(size, (name, who, row), sampling) for row, size in enumerate(sizes)]
        return made, np.concatenate([xy for _, xy in made])

    mine, truth = walks("walks", sizes)
    others, others_truth = walks("others", [40 + 4 * row for row in range(12)])
    return Case(
        about=about,
        release=shared(mine, (name, "release"), mechanism=mechanism),
        truth=truth,
        mechanism=mechanism,
        train=TrainingSet(shared(others, (name, "train"), mechanism=mechanism), others_truth),
        repeats=tuple(
            shared(mine, (name, "repeat", row), mechanism=mechanism) for row in range(N_REPEATS)
        ),
    )


def _walk(size: int, name: tuple[str | int, ...], sampling: Sampling) -> Walk:
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
