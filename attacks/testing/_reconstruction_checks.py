"""Made-up walks as a reconstruction attack gets them, and what holds for such attacks alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from attacks.testing import _checks as common
from attacks.testing import _releases as made
from attacks.testing._releases import BOX_M, EPSILON_M, RAW_SIGMA_M, draws
from isac_track.privacy import exposure, leakage_indicator
from isac_track.protocols import TrainingSet
from isac_track.sharing import Fixed
from isac_track.types import ErrorLaw, Floats, Knowledge, Reconstruction, Release, stretches

N_TRACKS = 24
FRAMES: tuple[made.Frame, ...] = (
    (2.1, (35.0, -80.0), 500.0),
    (-0.7, (-60.0, 15.0), -20.0),
    (1.2, (5.0, 140.0), 120.0),
    (-2.8, (-90.0, -30.0), 1000.0),
)
"""Angle (rad), shift (m) and clock (s) of the release, the training set and the two repeats."""
SAME_FRAME_M = 1e-5  # Room for rounding after a motion by some hundred metres and seconds.
EXTENTS, EXTRA_M = 3.0, 10.0
"""How far an answer may lie from the middle of its track: 3 times its extent and 10 m."""
EASY_PLR = 0.5  # The shared positions themselves come to 1.0 there.
SIGMAS_M = (0.3, 1.0, 3.0)


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """One release with M samples, and everything that an adversary may know besides."""

    asked: ClassVar[tuple[str, ...]] = ("release",)  # What the function from `fit` is called with.
    gives: ClassVar[str] = "from a release to a reconstruction"
    everything: ClassVar[frozenset[Knowledge]] = frozenset(Knowledge)  # All that there is to grant.
    compared: ClassVar[str] = "positions or std"
    unit: ClassVar[str] = " m"

    about: str  # For messages.
    release: Release
    truth: Floats  # (M, 2) m. No attack is given it.
    mechanism: Fixed
    train: TrainingSet
    repeats: tuple[Release, ...]
    anchor: Release
    companions: tuple[Release, ...]

    def read(self, result: Any) -> Floats:  # noqa: ANN401 - a stranger's
        """Return positions and std, if claimed, (M, 2 or 3) m; ValueError if it is neither.

        Positions alone will do: the check of the type is another one.
        """
        std = getattr(result, "std", None) if hasattr(result, "xy") else None  # arrays have a std()
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
        return xy if std is None else np.column_stack([xy, np.asarray(std, dtype=np.float64)])

    def gaps(self, one: Floats, other: Floats, _plain: Floats) -> Floats:
        """Return how far apart two answers are, (1 or 2, M) m: positions, and std if claimed."""
        if one.shape != other.shape:  # a std that comes and goes
            return np.array([[np.inf]])
        return np.stack([np.hypot(*(one - other)[:, :2].T), *np.abs(one - other)[:, 2:].T])

    def reordered(self) -> tuple[Case, Callable[[Floats], Floats]]:
        """Return the ordinary case with its tracks in another order, and how an answer follows."""
        rows, offsets = np.array([5, 2, 7, 0, 3, 6, 1, 4]), self.release.offsets
        samples, _ = stretches(offsets[rows], np.diff(offsets)[rows])
        changed = replace(
            self,
            release=self.release.tracks(rows),
            truth=self.truth[samples],
            repeats=tuple(repeat.tracks(rows) for repeat in self.repeats),
            anchor=self.anchor.tracks(rows),
            companions=tuple(one.tracks(rows) for one in self.companions),
        )
        return changed, lambda answer: answer[samples]

    def in_other_frames(self) -> tuple[Case, Callable[[Floats], Floats]]:
        """Return the case as without SCENE, every release in its own frame; how answers follow."""
        mine, others, *_ = FRAMES
        frames = [*FRAMES, mine, mine]  # the anchor and who walks along are seen as the release is
        changed = made.of_each(self, lambda release: made.moved(release, frames.pop(0)))
        train = TrainingSet(changed.train.release, made.turned(self.train.truth, others))
        changed = replace(changed, truth=made.turned(self.truth, mine), train=train)
        return changed, lambda answer: np.hstack([made.turned(answer[:, :2], mine), answer[:, 2:]])


def ordinary_and_another(_granted: frozenset[Knowledge]) -> tuple[Case, Case]:
    """Return a small case as most are, and one with another release of the same walks."""
    sizes = tuple(20 + 4 * row for row in range(8))
    case = made_up("ordinary", about="8 walks, noise of 0.3 m", sizes=sizes)
    other = replace(case.repeats[0], pseudonym=case.release.pseudonym)
    return case, replace(case, release=other)


def noisy(sigma_m: float, law: ErrorLaw) -> Case:
    """Return the same 24 walks of 60 to 200 samples, with the same errors times `sigma_m`."""
    sizes = tuple(60 + 6 * row for row in range(N_TRACKS))
    about = f"{N_TRACKS} walks, {law} noise of {sigma_m:g} m"
    return made_up("noisy", about=about, sizes=sizes, sigma_m=sigma_m, law=law)


@cache
def made_up(
    name: str,
    *,
    about: str,
    sizes: tuple[int, ...],
    sigma_m: float = 0.3,
    law: ErrorLaw = "radial",
    steps_s: tuple[float, float] = made.STEADY_S,
) -> Case:
    """Return walks of people, shared with errors of standard deviation `sigma_m`.

    Walks and unit errors depend on `name` and `sizes` (samples of each track) alone, so that two
    noise levels, of `RAW_SIGMA_M` or more, differ in nothing else.
    """
    mechanism = Fixed(d_sigma=sigma_m - RAW_SIGMA_M, law=law)

    mine, others = (
        made.walks(name, who, sizes=some, steps_s=steps_s)
        for who, some in (("walks", sizes), ("others", range(40, 88, 4)))
    )
    truth, others_truth = (np.concatenate([xy for _, xy in some]) for some in (mine, others))

    def share(walked: list[made.Walk], *words: str | int) -> Release:
        return made.shared(walked, (name, *words), mechanism=mechanism)

    release, beside = share(mine, "release"), share(mine, "beside")
    return Case(
        about=about,
        release=release,
        truth=truth,
        mechanism=mechanism,
        train=TrainingSet(share(others, "train"), others_truth),
        repeats=tuple(share(mine, "repeat", row) for row in range(2)),
        anchor=replace(
            release,
            t=release.t[release.offsets[:-1]],
            xy=truth[release.offsets[:-1]],
            sigma=None,
            offsets=np.arange(len(release) + 1),
        ),
        companions=(replace(beside, xy=beside.xy + 1.0),),
    )


# The checks


def result_is_a_reconstruction(row: common.Row) -> None:
    """A Reconstruction comes back: xy (M, 2) m, and std (M,) m or None, all of it finite."""
    case = row.ordinary
    (result,) = row.raw(made.copied(case))
    if not isinstance(result, Reconstruction):
        row.fail(
            case.about,
            f"expected a Reconstruction, got {type(result).__name__}; "
            "wrap the positions: Reconstruction(xy) or Reconstruction(xy, std)",
        )
    row.read(case, result)


def frame_and_clock_do_not_matter(row: common.Row) -> None:
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


def odd_tracks_are_handled(row: common.Row) -> None:
    """With tracks of one to three samples and steps from 1 ms to 30 s no answer flies off."""
    hint = "what do a window, a fit or a difference of samples come to with so few?"
    for sizes in ((1,), (1, 2, 30, 1, 2, 3), (2,)):
        about = f"tracks of {', '.join(map(str, sizes))} samples"
        _stay_near(row, made_up("short", about=about, sizes=sizes), hint=hint)
    about = "8 walks with steps from 1 ms to 30 s"
    case = made_up("irregular", about=about, sizes=(60,) * 8, steps_s=made.IRREGULAR_S)
    _stay_near(row, case, hint="is anything divided by a time step?")


def null_stays_at_chance(row: common.Row) -> None:
    """Where the release says nothing of the truth, no more samples leak than by chance.

    The truth is drawn apart from the walks, uniformly in one square. Whatever is said of a true
    position, it lies within epsilon with a probability of at most pi epsilon^2 / `BOX_M`^2,
    independently of all others.
    """
    case = noisy(BOX_M, "isotropic")
    about = f"{N_TRACKS} tracks of positions that have nothing to do with the truth"
    truth = draws("unrelated", "truth").uniform(-BOX_M / 2, BOX_M / 2, case.truth.shape)
    answer = row.answer(replace(case, about=about, truth=truth))
    leaked = leakage_indicator(shared_xy=answer[:, :2], true_xy=truth, epsilon_m=EPSILON_M)
    chance = np.pi * EPSILON_M**2 / BOX_M**2
    hint = "does the truth reach the attack by a way other than its context?"
    common.expect_chance(row, about, leaked, chance=chance, what="samples leak", hint=hint)


def easy_case_beats_chance(row: common.Row) -> None:
    """With errors far below epsilon, at least half of the samples leak."""
    case = noisy(RAW_SIGMA_M, "radial")
    plr = float(_plr(row.answer(case), case).mean())
    if plr < EASY_PLR:
        row.fail(
            case.about,
            f"PLR {plr:.3f} at epsilon {EPSILON_M:g} m, expected at least {EASY_PLR:g}; the shared "
            f"positions themselves come to {_shared_plr(case)} (does it smooth too much, or lag "
            "behind?)",
        )


def success_falls_with_noise(row: common.Row) -> None:
    """PLR at 0.3, 1 and 3 m of isotropic noise falls from each to the next.

    The same walks with the same unit errors, so that each track is compared with itself: the
    mean fall must exceed 2.5 of its standard errors over the tracks.
    """
    levels = [noisy(sigma_m, "isotropic") for sigma_m in SIGMAS_M]
    plrs = [_plr(row.answer(case), case) for case in levels]
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
    odd_tracks_are_handled,
    common.calls_do_not_remember,
    null_stays_at_chance,
    easy_case_beats_chance,
    success_falls_with_noise,
)
"""In the order in which they run."""


def _stay_near(row: common.Row, case: Case, *, hint: str) -> None:
    found = row.answer(case)
    for number, (lo, hi) in enumerate(pairwise(case.release.offsets)):
        shared_xy = case.release.xy[lo:hi]
        low, high = shared_xy.min(axis=0), shared_xy.max(axis=0)
        away_m = float(np.hypot(*(found[lo:hi, :2] - (low + high) / 2).T).max())
        limit_m = EXTENTS * float(np.hypot(*(high - low))) + EXTRA_M
        if away_m > limit_m:
            row.fail(
                case.about,
                f"an answer lies {away_m:.0f} m from the middle of track {number}, expected at "
                f"most {limit_m:.0f} m ({EXTENTS:g} times its extent and {EXTRA_M:g} m); {hint}",
            )


def _plr(answer: Floats, case: Case) -> Floats:
    leaked = leakage_indicator(shared_xy=answer[:, :2], true_xy=case.truth, epsilon_m=EPSILON_M)
    return exposure(leaked=leaked, t=case.release.t, offsets=case.release.offsets).plr


def _shared_plr(case: Case) -> str:
    return f"{_plr(case.release.xy, case).mean():.3f}"
