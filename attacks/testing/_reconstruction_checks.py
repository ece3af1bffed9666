"""Made-up walks as a reconstruction attack gets them, and what holds for such attacks alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from attacks.testing import _checks as common
from attacks.testing._releases import (
    BOX_M,
    EPSILON_M,
    RAW_SIGMA_M,
    Motion,
    copied,
    draws,
    in_order,
    of_each,
    origins,
    shared,
    steps,
)
from isac_track.privacy import exposure, leakage_indicator
from isac_track.protocols import TrainingSet
from isac_track.sharing import Fixed
from isac_track.types import Knowledge, Reconstruction

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from attacks.testing._checks import Row
    from attacks.testing._releases import Sampling, Walk
    from isac_track.types import ErrorLaw, Floats, Release

ACCELERATION = 0.04
"""m^2/s^3, spectral density of the walks' acceleration (Bar-Shalom et al., 2001, ch. 6.2)."""
SPEED_MPS = (1.0, 0.2)
"""Mean and standard deviation at the start."""
N_TRACKS = 24
FRAMES = (
    Motion(angle_rad=2.1, shift_m=(35.0, -80.0), clock_s=500.0),
    Motion(angle_rad=-0.7, shift_m=(-60.0, 15.0), clock_s=-20.0),
    Motion(angle_rad=1.2, shift_m=(5.0, 140.0), clock_s=120.0),
    Motion(angle_rad=-2.8, shift_m=(-90.0, -30.0), clock_s=1000.0),
)
"""Of the release, the training set and the two repeats: without SCENE, no two are the same."""
SAME_FRAME_M = 1e-5
"""Room for rounding after a motion by some hundred metres and seconds."""
EXTENTS, EXTRA_M = 3.0, 10.0
"""How far an answer may lie from the middle of its track: 3 times its extent and 10 m."""
EASY_PLR = 0.5
"""The shared positions themselves come to 1.0 there."""
SIGMAS_M = (0.3, 1.0, 3.0)


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
    gives: ClassVar[str] = "from a release to a reconstruction"
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
        """Return a result as arrays, or raise ValueError if it is not one position per sample.

        Positions alone will do: the check of the type is another one.
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
        if lost := np.count_nonzero(~np.isfinite(xy).all(axis=1)):
            raise ValueError(f"{lost} of {len(xy)} positions are not finite")
        std = getattr(result, "std", None) if hasattr(result, "xy") else None  # arrays have a std()
        return Estimate(xy, None if std is None else np.asarray(std, dtype=np.float64))

    def gaps(self, one: Estimate, other: Estimate) -> list[Floats]:
        """Return how far apart two answers are, m: positions, and std if either has it."""
        found: list[Floats] = [np.hypot(*(one.xy - other.xy).T)]
        if one.std is not None and other.std is not None and one.std.shape == other.std.shape:
            found.append(np.abs(one.std - other.std))
        elif (one.std is None) != (other.std is None):
            found.append(np.array([np.inf]))
        return found

    def spread(self, _answer: Estimate) -> float:
        """Return what gaps are measured in, m."""
        return 1.0

    def reordered(self) -> tuple[Case, Callable[[Estimate], Estimate]]:
        """Return the ordinary case with its tracks in another order, and how an answer follows."""
        order = (5, 2, 7, 0, 3, 6, 1, 4)
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
        """Return the case as without SCENE, every release in its own frame; how answers follow."""
        mine, others, *_ = frames = list(FRAMES)
        changed = of_each(self, lambda release: frames.pop(0).of_release(release))
        moved = replace(
            changed,
            truth=mine.of_points(self.truth),
            train=TrainingSet(changed.train.release, others.of_points(self.train.truth)),
        )
        return moved, lambda answer: Estimate(mine.of_points(answer.xy), answer.std)


def ordinary_and_another(granted: frozenset[Knowledge]) -> tuple[Case, Case]:
    """Return a small case as most are, and one with its samples and pseudonyms of other walks."""
    sizes = tuple(20 + 4 * row for row in range(8))
    case = made_up("ordinary", about="8 walks, noise of 0.3 m", sizes=sizes)
    other = made_up("another", about="", sizes=sizes).release
    if Knowledge.REPEATS in granted:
        # Repeats are of the walks of a case: another release of those is all that may be asked.
        other = case.repeats[0]
    return case, replace(case, release=replace(other, pseudonym=case.release.pseudonym))


def noisy(sigma_m: float, law: ErrorLaw) -> Case:
    """Return the same 24 walks of 60 to 200 samples, with the same errors times `sigma_m`."""
    sizes = tuple(60 + 6 * row for row in range(N_TRACKS))
    about = f"{N_TRACKS} walks, {law} noise of {sigma_m:g} m"
    return made_up("noisy", about=about, sizes=sizes, sigma_m=sigma_m, law=law)


def irregular() -> Case:
    """Return walks whose steps last from a millisecond to half a minute."""
    about = "8 walks with steps from 1 ms to 30 s"
    return made_up("irregular", about=about, sizes=(60,) * 8, sampling="irregular")


@cache
def unrelated() -> Case:
    """Return walks with a truth that is drawn apart from them, uniformly in one square.

    Whatever is said of a true position, it lies within epsilon with a probability of at most
    pi epsilon^2 / `BOX_M`^2, independently of all others.
    """
    case = noisy(BOX_M, "isotropic")
    about = f"{N_TRACKS} tracks of positions that have nothing to do with the truth"
    rng = draws("unrelated", "truth")
    return replace(case, about=about, truth=rng.uniform(-BOX_M / 2, BOX_M / 2, case.truth.shape))


@cache
def made_up(
    name: str,
    *,
    about: str,
    sizes: tuple[int, ...],
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
        made = [_walk(size, draws(name, who, row), sampling) for row, size in enumerate(sizes)]
        return made, np.concatenate([xy for _, xy in made])

    mine, truth = walks("walks", sizes)
    others, others_truth = walks("others", [40 + 4 * row for row in range(12)])
    return Case(
        about=about,
        release=shared(mine, (name, "release"), mechanism=mechanism),
        truth=truth,
        mechanism=mechanism,
        train=TrainingSet(shared(others, (name, "train"), mechanism=mechanism), others_truth),
        repeats=tuple(shared(mine, (name, "repeat", row), mechanism=mechanism) for row in range(2)),
    )


def _walk(size: int, rng: np.random.Generator, sampling: Sampling) -> Walk:
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


# The checks


def result_is_a_reconstruction(row: Row) -> None:
    """A Reconstruction comes back: xy (M, 2) m, and std (M,) m or None, all of it finite."""
    case = row.ordinary
    (result,) = row.raw(copied(case))
    if not isinstance(result, Reconstruction):
        row.fail(
            case,
            f"expected a Reconstruction, got {type(result).__name__}; "
            "wrap the positions: Reconstruction(xy) or Reconstruction(xy, std)",
        )
    row.read(case, result)


def frame_and_clock_do_not_matter(row: Row) -> None:
    """Release, training set and repeats each in another frame: the result moves along.

    Whoever is granted SCENE may well know where the walls are: such a row is exempt.
    """
    common.frames_do_not_matter(
        row,
        tolerance=SAME_FRAME_M,
        what="another frame and clock for the release, the training set and each repeat",
        hint="without SCENE they are random; does anything depend on x and y taken by "
        "themselves, on absolute times, or on two releases sharing a frame?",
    )


def short_tracks_are_handled(row: Row) -> None:
    """Tracks of one, two or three samples, alone or among others, get a sensible answer."""
    hint = "what do a window, a fit or a difference of samples come to with so few?"
    for sizes in ((1,), (1, 2, 30, 1, 2, 3), (2,)):
        about = f"tracks of {', '.join(map(str, sizes))} samples"
        _stay_near(row, made_up("short", about=about, sizes=sizes), hint=hint)


def irregular_sampling_is_handled(row: Row) -> None:
    """With steps from 1 ms to 30 s no answer flies off."""
    _stay_near(row, irregular(), hint="is anything divided by a time step?")


def null_stays_at_chance(row: Row) -> None:
    """Where the release says nothing of the truth, no more samples leak than by chance."""
    case = unrelated()
    truth = case.truth
    chance = np.pi * EPSILON_M**2 / BOX_M**2
    found = row.answer(case).xy
    leaked = int(leakage_indicator(shared_xy=found, true_xy=truth, epsilon_m=EPSILON_M).sum())
    if common.is_surprising(leaked, tries=len(truth), chance=chance):
        row.fail(
            case,
            f"{leaked} of {len(truth)} samples leak, expected about {chance * len(truth):.0f} by "
            "chance; does the truth reach the attack by a way other than its context?",
        )


def easy_case_beats_chance(row: Row) -> None:
    """With errors far below epsilon, at least half of the samples leak."""
    case = noisy(RAW_SIGMA_M, "radial")
    plr = float(_plr(row.answer(case).xy, case).mean())
    if plr < EASY_PLR:
        row.fail(
            case,
            f"PLR {plr:.3f} at epsilon {EPSILON_M:g} m, expected at least {EASY_PLR:g}; the shared "
            f"positions themselves come to {_shared_plr(case)} (does it smooth too much, or lag "
            "behind?)",
        )


def success_falls_with_noise(row: Row) -> None:
    """PLR at 0.3, 1 and 3 m of isotropic noise falls from each to the next.

    The same walks with the same unit errors, so that each track is compared with itself: the
    mean fall must exceed 2.5 of its standard errors over the tracks.
    """
    levels = [noisy(sigma_m, "isotropic") for sigma_m in SIGMAS_M]
    plrs = [_plr(row.answer(case).xy, case) for case in levels]
    for (low, high), (less, more) in zip(pairwise(plrs), pairwise(SIGMAS_M), strict=True):
        needed = common.least_rise(low - high)
        if not (low - high).mean() > needed:
            raise AssertionError(
                f"{row}, {low.size} walks: PLR {low.mean():.3f} at {less:g} m of noise and "
                f"{high.mean():.3f} at {more:g} m, expected a fall of more than {needed:.3f}; the "
                f"shared positions themselves come to {', '.join(map(_shared_plr, levels))} at "
                f"{', '.join(f'{sigma_m:g}' for sigma_m in SIGMAS_M)} m (what does the attack "
                "take the noise for?)"
            )


ALL = (
    result_is_a_reconstruction,
    *common.FIRST,
    frame_and_clock_do_not_matter,
    common.pseudonyms_do_not_matter,
    short_tracks_are_handled,
    irregular_sampling_is_handled,
    common.calls_do_not_remember,
    null_stays_at_chance,
    easy_case_beats_chance,
    success_falls_with_noise,
)
"""In the order in which they run."""


def _stay_near(row: Row, case: Case, *, hint: str) -> None:
    found = row.answer(case)
    for number, (lo, hi) in enumerate(pairwise(case.release.offsets)):
        shared_xy = case.release.xy[lo:hi]
        low, high = shared_xy.min(axis=0), shared_xy.max(axis=0)
        away_m = float(np.hypot(*(found.xy[lo:hi] - (low + high) / 2).T).max())
        limit_m = EXTENTS * float(np.hypot(*(high - low))) + EXTRA_M
        if away_m > limit_m:
            row.fail(
                case,
                f"an answer lies {away_m:.0f} m from the middle of track {number}, expected at "
                f"most {limit_m:.0f} m ({EXTENTS:g} times its extent and {EXTRA_M:g} m); {hint}",
            )


def _plr(xy: Floats, case: Case) -> Floats:
    leaked = leakage_indicator(shared_xy=xy, true_xy=case.truth, epsilon_m=EPSILON_M)
    return exposure(leaked=leaked, t=case.release.t, offsets=case.release.offsets).plr


def _shared_plr(case: Case) -> str:
    return f"{_plr(case.release.xy, case).mean():.3f}"
