"""What holds for reconstruction attacks alone, and the list of their checks."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from attacks.testing import _cases as cases
from attacks.testing import _checks as common
from attacks.testing._releases import BOX_M, EPSILON_M, RAW_SIGMA_M, copied
from isac_track.privacy import exposure, leakage_indicator
from isac_track.types import Reconstruction

if TYPE_CHECKING:
    from attacks.testing._cases import Case
    from attacks.testing._rows import Row
    from isac_track.types import Bools, Floats

SAME_FRAME_M = 1e-5
"""Room for rounding after a motion by some hundred metres and seconds."""
SHORT = ((1,), (1, 2, 30, 1, 2, 3), (2,))
EXTENTS = 3.0
EXTRA_M = 10.0
"""How far an answer may lie from the middle of its track: 3 times its extent and 10 m."""
EASY_SIGMA_M = RAW_SIGMA_M
EASY_PLR = 0.5
"""The shared positions themselves come to 1.0 there."""
SIGMAS_M = (0.3, 1.0, 3.0)


def result_is_a_reconstruction(row: Row) -> None:
    """A Reconstruction comes back: xy (M, 2) m, and std (M,) m or None, all of it finite."""
    case = row.ordinary
    (result,) = row.raw([copied(case)])
    if not isinstance(result, Reconstruction):
        row.fail(
            case,
            f"expected a Reconstruction, got {type(result).__name__}; "
            "wrap the positions: Reconstruction(xy) or Reconstruction(xy, std)",
        )
    row.read(case, result)


def frame_and_clock_do_not_matter(row: Row) -> None:
    """Release, training set and repeats each in another frame: the result moves along.

    Without SCENE that is how an adversary gets them. Whoever is granted SCENE may well know
    where the walls are: such a row is exempt.
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
    for sizes in SHORT:
        hint = "what do a window, a fit or a difference of samples come to with so few?"
        _stay_near(row, cases.short(sizes), hint=hint)


def irregular_sampling_is_handled(row: Row) -> None:
    """With steps from 1 ms to 30 s no answer flies off."""
    _stay_near(row, cases.irregular(), hint="is anything divided by a time step?")


def null_stays_at_chance(row: Row) -> None:
    """Where the release says nothing of the truth, no more samples leak than by chance.

    Every true position is drawn by itself, uniformly and apart from the release. Whatever an
    attack answers, the number that leak is at most binomial with p = pi epsilon^2 / area.
    """
    case = cases.unrelated()
    truth = case.truth
    chance = np.pi * EPSILON_M**2 / BOX_M**2
    leaked = int(_leaked(row.answer(case).xy, truth).sum())
    if common.is_surprising(leaked, tries=len(truth), chance=chance):
        row.fail(
            case,
            f"{leaked} of {len(truth)} samples leak, expected about {chance * len(truth):.0f} by "
            "chance; does the truth reach the attack by a way other than its context?",
        )


def easy_case_beats_chance(row: Row) -> None:
    """With errors far below epsilon, at least half of the samples leak."""
    case = cases.noisy(EASY_SIGMA_M, "radial")
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
    levels = [cases.noisy(sigma_m, "isotropic") for sigma_m in SIGMAS_M]
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
    common.same_seed_same_result,
    common.inputs_are_not_mutated,
    common.only_granted_knowledge_is_touched,
    common.order_of_tracks_does_not_matter,
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
        shared = case.release.xy[lo:hi]
        low, high = shared.min(axis=0), shared.max(axis=0)
        away_m = float(np.hypot(*(found.xy[lo:hi] - (low + high) / 2).T).max())
        limit_m = EXTENTS * float(np.hypot(*(high - low))) + EXTRA_M
        if away_m > limit_m:
            row.fail(
                case,
                f"an answer lies {away_m:.0f} m from the middle of track {number}, expected at "
                f"most {limit_m:.0f} m ({EXTENTS:g} times its extent and {EXTRA_M:g} m); {hint}",
            )


def _leaked(xy: Floats, truth: Floats) -> Bools:
    return leakage_indicator(shared_xy=xy, true_xy=truth, epsilon_m=EPSILON_M)


def _plr(xy: Floats, case: Case) -> Floats:
    leaked = _leaked(xy, case.truth)
    return exposure(leaked=leaked, t=case.release.t, offsets=case.release.offsets).plr


def _shared_plr(case: Case) -> str:
    return f"{_plr(case.release.xy, case).mean():.3f}"
