"""Checks of the leakage indicator and PLR (eqs. leakage_indicator and plr_definition)."""

from __future__ import annotations

from itertools import pairwise
from math import sqrt
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from isac_track.rng import stream
from isac_track.testing._cases import (
    BOUNDARY_M,
    EPSILON_M,
    EPSILONS_M,
    ON_THE_BOUNDARY,
    STANDARD_ERRORS,
    backwards,
    moved,
    plain_track,
    plr_by_definition,
    random_tracks,
    random_walks,
)
from isac_track.testing._kit import check, expect, expect_that

if TYPE_CHECKING:
    from isac_track.testing._kit import PointRatio

_LARGE = 20_000


@check
def plr_hand_examples(plr: PointRatio) -> None:
    """PLR is the share of leaked samples."""
    for pattern, share in (("1000", 0.25), ("1101", 0.75), ("01", 0.5), ("00100", 0.2)):
        track = plain_track(pattern)
        expect(plr(*track.points), share, what="PLR", case=track)


@check
def plr_distance_is_euclidean(plr: PointRatio) -> None:
    """A sample leaks by its distance in the plane, not by either coordinate."""
    true_xy = np.array([[2.0, -1.0]])
    for error, share in (([0.25, 0.25], 0.0), ([0.2, 0.2], 1.0), ([-0.25, -0.1], 1.0)):
        shared_xy = true_xy + np.array([error])
        expect(plr(shared_xy, true_xy, 0.3), share, what="PLR", case=f"one error {error} m")


@check
def plr_boundary_is_strict(plr: PointRatio) -> None:
    """A sample at exactly epsilon does not leak."""
    truth = np.zeros_like(ON_THE_BOUNDARY)
    case = f"errors {ON_THE_BOUNDARY.tolist()} m, all of length 1.25 m"
    expect(plr(ON_THE_BOUNDARY, truth, BOUNDARY_M), 0.0, what="PLR at epsilon", case=case)
    above = float(np.nextafter(BOUNDARY_M, 2.0))
    expect(plr(ON_THE_BOUNDARY, truth, above), 1.0, what="PLR just above epsilon", case=case)


@check
def plr_all_and_none_leaked(plr: PointRatio) -> None:
    """PLR is 1 when every sample leaks and 0 when none does."""
    for size in (2, 5, 50):
        expect(plr(*plain_track("1" * size).points), 1.0, what="PLR", case=f"{size} leaked")
        expect(plr(*plain_track("0" * size).points), 0.0, what="PLR", case=f"{size} not leaked")


@check
def plr_single_sample(plr: PointRatio) -> None:
    """PLR of one sample is 1 or 0: no duration is needed."""
    for pattern, share in (("1", 1.0), ("0", 0.0)):
        track = plain_track(pattern)
        expect(plr(*track.points), share, what="PLR", case=track)


@check
def plr_matches_brute_force(plr: PointRatio) -> None:
    """PLR equals the count on random walks with a known pattern."""
    for track in random_tracks("plr_matches_brute_force"):
        expect(plr(*track.points), plr_by_definition(track), what="PLR", case=track)


@check
def plr_rigid_motion(plr: PointRatio) -> None:
    """PLR does not change when both walks are turned, shifted and mirrored together."""
    for track in random_tracks("plr_rigid_motion", count=60):
        other = moved(track)
        expect(plr(*other.points), plr(*track.points), what="PLR after the motion", case=track)


@check
def plr_time_reversal(plr: PointRatio) -> None:
    """PLR does not depend on the order of the samples."""
    for track in random_tracks("plr_time_reversal", count=60):
        turned = backwards(track)
        expect(plr(*turned.points), plr(*track.points), what="PLR backwards", case=track)


@check
def plr_monotone_in_epsilon(plr: PointRatio) -> None:
    """PLR never falls when epsilon grows."""
    for shared_xy, true_xy, _ in random_walks("plr_monotone_in_epsilon"):
        shares = [plr(shared_xy, true_xy, epsilon_m) for epsilon_m in EPSILONS_M]
        expect_that(
            all(low <= high for low, high in pairwise(shares)),
            what=f"PLR falls: {shares}",
            case=f"epsilon {EPSILONS_M.tolist()} m",
        )


@check
def plr_radial_gaussian(plr: PointRatio) -> None:
    """PLR of radial errors |N(0, s)| tends to 2 Phi(epsilon / s) - 1."""
    for sigma_m in (0.1, 0.3, 0.75):
        rng = stream(0, "testing", "plr_radial_gaussian", str(sigma_m))
        angle = rng.uniform(0.0, 2.0 * np.pi, _LARGE)
        norm = rng.normal(0.0, sigma_m, _LARGE)
        error = norm[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        limit = 2.0 * float(stats.norm.cdf(EPSILON_M / sigma_m)) - 1.0
        _near_share(plr(error, np.zeros_like(error), EPSILON_M), limit, f"radial, s = {sigma_m} m")


@check
def plr_isotropic_gaussian(plr: PointRatio) -> None:
    """PLR of errors N(0, s) on each axis tends to 1 - exp(-epsilon^2 / 2 s^2)."""
    for sigma_m in (0.1, 0.3, 0.75):
        rng = stream(0, "testing", "plr_isotropic_gaussian", str(sigma_m))
        error = rng.normal(0.0, sigma_m, (_LARGE, 2))
        limit = float(stats.rayleigh.cdf(EPSILON_M, scale=sigma_m))
        case = f"isotropic, s = {sigma_m} m"
        _near_share(plr(error, np.zeros_like(error), EPSILON_M), limit, case)


def _near_share(share: float, limit: float, case: str) -> None:
    tolerance = STANDARD_ERRORS * sqrt(limit * (1.0 - limit) / _LARGE)
    what = f"PLR is {share!r}, expected {limit:.6f} within {tolerance:.6f}"
    expect_that(abs(share - limit) <= tolerance, what=what, case=f"{case}, {_LARGE} samples")
