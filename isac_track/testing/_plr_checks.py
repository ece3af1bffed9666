"""Checks of the leakage indicator and PLR (eqs. leakage_indicator and plr_definition)."""

from __future__ import annotations

from functools import partial
from math import expm1, sqrt
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr

from isac_track.rng import stream
from isac_track.testing._cases import (
    BOUNDARY_M,
    EPSILON_M,
    ON_THE_BOUNDARY,
    STANDARD_ERRORS,
    backwards,
    expect_rising,
    moved,
    plain_track,
    plr_by_definition,
    random_tracks,
    random_walks,
)
from isac_track.testing._metrics import check, expect, expect_that

if TYPE_CHECKING:
    from numpy.random import Generator

    from isac_track.testing._metrics import PointRatio
    from isac_track.types import Floats

_LARGE = 20_000


@check
def plr_hand_examples(plr: PointRatio) -> None:
    """PLR is the share of leaked samples."""
    _by_hand(plr, ("1000", 0.25), ("1101", 0.75), ("01", 0.5), ("00100", 0.2))


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
        _by_hand(plr, ("1" * size, 1.0), ("0" * size, 0.0))


@check
def plr_single_sample(plr: PointRatio) -> None:
    """PLR of one sample is 1 or 0: no duration is needed."""
    _by_hand(plr, ("1", 1.0), ("0", 0.0))


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
        expect_rising(partial(plr, shared_xy, true_xy), what="PLR")


@check
def plr_radial_gaussian(plr: PointRatio) -> None:
    """PLR of radial errors |N(0, s)| tends to 2 Phi(epsilon / s) - 1."""
    for sigma_m, rng in _sizes("plr_radial_gaussian"):
        angle = rng.uniform(0.0, 2.0 * np.pi, _LARGE)
        norm = rng.normal(0.0, sigma_m, _LARGE)
        error = norm[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        limit = 2.0 * float(ndtr(EPSILON_M / sigma_m)) - 1.0
        _near_share(plr, error, limit, f"radial, s = {sigma_m} m")


@check
def plr_isotropic_gaussian(plr: PointRatio) -> None:
    """PLR of errors N(0, s) on each axis tends to 1 - exp(-epsilon^2 / 2 s^2)."""
    for sigma_m, rng in _sizes("plr_isotropic_gaussian"):
        error = rng.normal(0.0, sigma_m, (_LARGE, 2))
        limit = -expm1(-0.5 * (EPSILON_M / sigma_m) ** 2)
        _near_share(plr, error, limit, f"isotropic, s = {sigma_m} m")


def _sizes(name: str) -> list[tuple[float, Generator]]:
    return [(size_m, stream(0, "testing", name, str(size_m))) for size_m in (0.1, 0.3, 0.75)]


def _by_hand(plr: PointRatio, *examples: tuple[str, float]) -> None:
    for pattern, share in examples:
        track = plain_track(pattern)
        expect(plr(*track.points), share, what="PLR", case=track)


def _near_share(plr: PointRatio, error: Floats, limit: float, case: str) -> None:
    share = plr(error, np.zeros_like(error), EPSILON_M)
    tolerance = STANDARD_ERRORS * sqrt(limit * (1.0 - limit) / _LARGE)
    what = f"PLR is {share!r}, expected {limit:.6f} within {tolerance:.6f}"
    expect_that(abs(share - limit) <= tolerance, what=what, case=f"{case}, {_LARGE} samples")
