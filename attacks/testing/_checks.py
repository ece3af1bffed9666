"""The checks themselves. Each is a statement about one attack, held against every row it makes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeAlias
from unittest import SkipTest

import numpy as np
from scipy.special import bdtrc

from attacks.testing import _cases as cases
from attacks.testing._kit import Estimate, expect_same, read, rows, run, strict_rows
from attacks.testing._releases import BOX_M, EPSILON_M, RAW_SIGMA_M, Motion
from isac_track.privacy import exposure, leakage_indicator
from isac_track.types import Knowledge, Reconstruction

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from attacks.testing._cases import Case
    from isac_track.protocols import ReconstructionAttack
    from isac_track.types import Bools, Floats

Check: TypeAlias = "Callable[[ReconstructionAttack], None]"

SAME_M = 1e-6
"""Room for rounding."""
SAME_FRAME_M = 1e-5
"""Room for rounding after a motion by some hundred metres and seconds."""
FRAMES = (
    Motion(angle_rad=2.1, shift_m=(35.0, -80.0), clock_s=500.0),
    Motion(angle_rad=-0.7, shift_m=(-60.0, 15.0), clock_s=-20.0),
    Motion(angle_rad=1.2, shift_m=(5.0, 140.0), clock_s=120.0),
    Motion(angle_rad=-2.8, shift_m=(-90.0, -30.0), clock_s=1000.0),
)
"""Of the release, the training set and the two repeats: without SCENE, no two are the same."""
SHORT = ((1,), (1, 2, 30, 1, 2, 3), (2,))
EXTENTS = 3.0
EXTRA_M = 10.0
"""How far an answer may lie from the middle of its track: 3 times its extent and 10 m."""
SURPRISE = 1e-6
"""Probability with which chance alone would fail an attack."""
EASY_SIGMA_M = RAW_SIGMA_M
EASY_PLR = 0.5
"""The shared positions themselves come to 1.0 there."""
SIGMAS_M = (0.3, 1.0, 3.0)
STANDARD_ERRORS = 2.5
"""One-sided 99 % for the 24 tracks (Student's t)."""


def result_is_a_reconstruction(attack: ReconstructionAttack) -> None:
    """A Reconstruction comes back: xy (M, 2) m, and std (M,) m or None, all of it finite."""
    case = cases.ordinary()
    for row in rows(attack):
        result = row.raw(case)
        if not isinstance(result, Reconstruction):
            raise AssertionError(  # noqa: TRY004 - a failed check
                f"{row}, {case.about}: expected a Reconstruction, got {type(result).__name__}; "
                "wrap the positions: Reconstruction(xy) or Reconstruction(xy, std)"
            )
        read(result, case, who=str(row))


def same_seed_same_result(attack: ReconstructionAttack) -> None:
    """Two runs with the same context.rng agree to the last bit."""
    case = cases.ordinary()
    for row in rows(attack):
        first, second = row.estimate(case), row.estimate(case)
        if not (_same_bits(first.xy, second.xy) and _same_bits(first.std, second.std)):
            differ = np.count_nonzero((first.xy != second.xy).any(axis=1))
            raise AssertionError(
                f"{row}, {case.about}: two runs with one seed differ in {differ} of "
                f"{len(first.xy)} positions; draw from context.rng alone, and keep nothing "
                "between two calls of fit"
            )


def inputs_are_not_mutated(attack: ReconstructionAttack) -> None:
    """Release, training set and repeats are left as they came."""
    case = cases.ordinary()
    for row in rows(attack):
        given = cases.copied(case)
        run(attack, given, granted=row.given, who=str(row))
        changed = [
            name
            for (name, before), (_, after) in zip(_arrays(case), _arrays(given), strict=True)
            if not _same_bits(before, after)
        ]
        if changed:
            raise AssertionError(
                f"{row}, {case.about}: changed {', '.join(changed)}; others read the same arrays: "
                "work on a copy, as in xy = release.xy.copy()"
            )


def order_of_tracks_does_not_matter(attack: ReconstructionAttack) -> None:
    """Tracks in another order come back in that order, and are otherwise the same."""
    case = cases.ordinary()
    changed, origin = cases.reordered(case, [5, 2, 7, 0, 3, 6, 1, 4])
    for row in rows(attack):
        plain = row.estimate(case)
        expect_same(
            row,
            case,
            got=row.estimate(changed),
            expected=Estimate(plain.xy[origin], None if plain.std is None else plain.std[origin]),
            tolerance_m=SAME_M,
            what="tracks in another order",
            hint="does anything run from one track into the next, or depend on a track's number?",
        )


def frame_and_clock_do_not_matter(attack: ReconstructionAttack) -> None:
    """Release, training set and repeats each in another frame: the result moves along.

    Without SCENE that is how an adversary gets them. Whoever is granted SCENE may well know
    where the walls are: such a row is exempt.
    """
    case = cases.ordinary()
    mine = FRAMES[0]
    tested = [row for row in rows(attack) if Knowledge.SCENE not in row.granted]
    if not tested:
        raise SkipTest("granted SCENE in every row: it may depend on the true frame and clock")
    for row in tested:
        plain = row.estimate(case)
        expect_same(
            row,
            case,
            got=row.estimate(cases.moved(case, FRAMES)),
            expected=Estimate(mine.of_points(plain.xy), plain.std),
            tolerance_m=SAME_FRAME_M,
            what="another frame and clock for the release, the training set and each repeat",
            hint="without SCENE they are random; does anything depend on x and y taken by "
            "themselves, on absolute times, or on two releases sharing a frame?",
        )


def pseudonyms_do_not_matter(attack: ReconstructionAttack) -> None:
    """Other pseudonyms, same result."""
    case = cases.ordinary()
    for row in rows(attack):
        expect_same(
            row,
            case,
            got=row.estimate(cases.renamed(case)),
            expected=row.estimate(case),
            tolerance_m=SAME_M,
            what="other pseudonyms",
            hint="they are drawn afresh for every release",
        )


def short_tracks_are_handled(attack: ReconstructionAttack) -> None:
    """Tracks of one, two or three samples, alone or among others, get a sensible answer."""
    hint = "what do a window, a fit or a difference of samples come to with so few?"
    _stay_near(attack, [cases.short(sizes) for sizes in SHORT], hint=hint)


def irregular_sampling_is_handled(attack: ReconstructionAttack) -> None:
    """With steps from 1 ms to 30 s no answer flies off."""
    _stay_near(attack, [cases.irregular()], hint="is anything divided by a time step?")


def calls_do_not_remember(attack: ReconstructionAttack) -> None:
    """What the function from fit answers does not depend on what it was asked before.

    Asked A, B and A again it answers A alike to the last bit, and B as if it had not seen A. B has
    A's pseudonyms and as many samples, lest a cache go by those.
    """
    case = cases.ordinary()
    for row in rows(attack):
        # Repeats are of the walks of A: another release of those is all that may be asked.
        if Knowledge.REPEATS in row.granted:
            other = cases.repeat_as_release(case)
        else:
            other = cases.another().release
        first, after, again = row.estimates(case, [case.release, other, case.release])
        (alone,) = row.estimates(case, [other])
        for got, expected, what in (
            (again, first, "asked once more, after another release"),
            (after, alone, "another release, asked after the first"),
        ):
            if _same_bits(got.xy, expected.xy) and _same_bits(got.std, expected.std):
                continue
            expect_same(
                row,
                case,
                got=got,
                expected=expected,
                tolerance_m=0.0,
                what=what,
                hint="one function serves many releases: keep nothing from one to the next",
            )


def only_granted_knowledge_is_touched(attack: ReconstructionAttack) -> None:
    """Given what its adversary knows and it declares, and no more, the attack runs."""
    case = cases.ordinary()
    for row in strict_rows(attack):
        try:
            row.raw(case)
        except AssertionError as error:
            # Whether more knowledge would help tells a denial from any other fault.
            replace(row, given=frozenset(Knowledge)).raw(case)
            raise AssertionError(
                f"{error}; given all knowledge it runs: declare what you touch in `requires` or "
                "`uses`, and look into context.granted before you touch what is only in `uses` "
                "(without SIGMA, release.sigma is None)"
            ) from error


def null_stays_at_chance(attack: ReconstructionAttack) -> None:
    """Where the release says nothing of the truth, no more samples leak than by chance.

    Every true position is drawn by itself, uniformly and apart from the release. Whatever an
    attack answers, the number that leak is at most binomial with p = pi epsilon^2 / area.
    """
    case = cases.unrelated()
    truth = case.truth
    chance = np.pi * EPSILON_M**2 / BOX_M**2
    for row in rows(attack):
        found = row.estimate(case)
        leaked = int(_leaked(found, truth).sum())
        # P(as many or more): the survival function counts what exceeds its argument.
        if leaked and bdtrc(leaked - 1, len(truth), chance) < SURPRISE:
            raise AssertionError(
                f"{row}, {case.about}: {leaked} of {len(truth)} samples leak, expected about "
                f"{chance * len(truth):.0f} by chance; does the truth reach the attack by a way "
                "other than its context?"
            )


def easy_case_beats_chance(attack: ReconstructionAttack) -> None:
    """With errors far below epsilon, at least half of the samples leak."""
    case = cases.noisy(EASY_SIGMA_M, "radial")
    for row in rows(attack):
        plr = float(_plr(row.estimate(case), case).mean())
        if plr < EASY_PLR:
            raise AssertionError(
                f"{row}, {case.about}: PLR {plr:.3f} at epsilon {EPSILON_M:g} m, expected "
                f"at least {EASY_PLR:g}; the shared positions themselves come to "
                f"{_shared_plr(case):.3f} (does it smooth too much, or lag behind?)"
            )


def success_falls_with_noise(attack: ReconstructionAttack) -> None:
    """PLR at 0.3, 1 and 3 m of isotropic noise falls from each to the next.

    The same walks with the same unit errors, so that each track is compared with itself: the
    mean fall must exceed 2.5 of its standard errors over the tracks.
    """
    levels = [cases.noisy(sigma_m, "isotropic") for sigma_m in SIGMAS_M]
    for row in rows(attack):
        plrs = [_plr(row.estimate(case), case) for case in levels]
        for (low, high), (less_noise, more_noise) in zip(
            pairwise(plrs), pairwise(SIGMAS_M), strict=True
        ):
            fall = low - high
            needed = STANDARD_ERRORS * float(fall.std(ddof=1)) / np.sqrt(fall.size)
            if not fall.mean() > needed:
                raise AssertionError(
                    f"{row}, {levels[0].release.offsets.size - 1} walks: PLR {low.mean():.3f} at "
                    f"{less_noise:g} m of noise and {high.mean():.3f} at {more_noise:g} m, "
                    f"expected a fall of more than {needed:.3f}; the shared positions themselves "
                    f"come to {', '.join(f'{_shared_plr(case):.3f}' for case in levels)} at "
                    f"{', '.join(f'{sigma_m:g}' for sigma_m in SIGMAS_M)} m (what does the attack "
                    "take the noise for?)"
                )


CHECKS: dict[str, Check] = {
    check.__name__: check
    for check in (
        result_is_a_reconstruction,
        same_seed_same_result,
        inputs_are_not_mutated,
        only_granted_knowledge_is_touched,
        order_of_tracks_does_not_matter,
        frame_and_clock_do_not_matter,
        pseudonyms_do_not_matter,
        short_tracks_are_handled,
        irregular_sampling_is_handled,
        calls_do_not_remember,
        null_stays_at_chance,
        easy_case_beats_chance,
        success_falls_with_noise,
    )
}
"""All checks by name, in the order in which they run."""


def _stay_near(attack: ReconstructionAttack, releases: list[Case], *, hint: str) -> None:
    for row in rows(attack):
        for case in releases:
            found = row.estimate(case)
            for number, (lo, hi) in enumerate(pairwise(case.release.offsets)):
                shared = case.release.xy[lo:hi]
                low, high = shared.min(axis=0), shared.max(axis=0)
                away_m = float(np.hypot(*(found.xy[lo:hi] - (low + high) / 2).T).max())
                limit_m = EXTENTS * float(np.hypot(*(high - low))) + EXTRA_M
                if away_m > limit_m:
                    raise AssertionError(
                        f"{row}, {case.about}: an answer lies {away_m:.0f} m from the middle of "
                        f"track {number}, expected at most {limit_m:.0f} m ({EXTENTS:g} times its "
                        f"extent and {EXTRA_M:g} m); {hint}"
                    )


def _leaked(found: Estimate, truth: Floats) -> Bools:
    return leakage_indicator(shared_xy=found.xy, true_xy=truth, epsilon_m=EPSILON_M)


def _plr(found: Estimate, case: Case) -> Floats:
    leaked = _leaked(found, case.truth)
    return exposure(leaked=leaked, t=case.release.t, offsets=case.release.offsets).plr


def _shared_plr(case: Case) -> float:
    return float(_plr(Estimate(case.release.xy, None), case).mean())


def _arrays(case: Case) -> list[tuple[str, NDArray[Any] | None]]:
    named: list[tuple[str, NDArray[Any] | None]] = [("context.train.truth", case.train.truth)]
    for name, release in (
        ("release", case.release),
        ("context.train.release", case.train.release),
        *((f"context.repeats[{row}]", repeat) for row, repeat in enumerate(case.repeats)),
    ):
        fields = ("t", "xy", "sigma", "offsets")
        named += [(f"{name}.{field}", getattr(release, field)) for field in fields]
    return named


def _same_bits(first: NDArray[Any] | None, second: NDArray[Any] | None) -> bool:
    if first is None or second is None:
        return first is second
    return first.shape == second.shape and first.tobytes() == second.tobytes()
