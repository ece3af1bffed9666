"""Checks of PLR (eq. plr_definition), of AEL and MEL (the text below it), and of batches."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from math import expm1, nan, sqrt
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr

from isac_track.rng import stream
from isac_track.testing._cases import (
    BOUNDARY_M,
    EPSILON_M,
    ON_THE_BOUNDARY,
    STANDARD_ERRORS,
    Track,
    ael_by_definition,
    backwards,
    expect_rising,
    longest_run_expected,
    mean_run_expected,
    mel_by_definition,
    moved,
    plain_track,
    plr_by_definition,
    random_tracks,
)
from isac_track.testing._metrics import check, expect, expect_that, register
from isac_track.testing.engine import statement_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.random import Generator

    from isac_track.testing._metrics import Batch, Duration, PointRatio
    from isac_track.types import Floats

_LARGE = 20_000
_MEANING = {
    "AEL": "mean duration of the leaked segments",
    "MEL": "duration of the longest leaked segment",
}


def _check_both(body: Callable[[str, Duration], None]) -> None:
    """Register a check of AEL and one of MEL; it receives the name, and the function."""
    for of, meaning in _MEANING.items():
        prefix = of.lower()
        register(
            partial(body, of),
            name=prefix + body.__name__,
            statement=statement_of(body).format(of=of, meaning=meaning),
            needs=(f"{prefix}_s",),
        )


@_check_both
def _hand_examples(of: str, duration: Duration) -> None:
    """{of} is the {meaning}; n samples last n intervals of 0.25 s."""
    long = {"AEL": ("1011", 0.375), "MEL": ("101110", 0.75)}
    _by_hand(of, duration, ("0110", 0.5), long[of], ("10101", 0.25), ("0001", 0.25))


@_check_both
def _boundary_is_strict(of: str, duration: Duration) -> None:
    """{of} is 0 when every sample lies at exactly epsilon."""
    truth = np.zeros_like(ON_THE_BOUNDARY)
    t = np.array([0.0, 1.0, 2.0])
    case = f"errors {ON_THE_BOUNDARY.tolist()} m, all of length 1.25 m, 1 s apart"
    for epsilon_m, duration_s in ((BOUNDARY_M, 0.0), (float(np.nextafter(BOUNDARY_M, 2.0)), 3.0)):
        value = duration(ON_THE_BOUNDARY, truth, t, epsilon_m)
        expect(value, duration_s, what=f"{of} at epsilon {epsilon_m!r} m", case=case)


@_check_both
def _all_and_none_leaked(of: str, duration: Duration) -> None:
    """{of} is n intervals when all n samples leak and 0 when none does."""
    for size in (2, 5, 50):
        _by_hand(of, duration, ("1" * size, 0.25 * size), ("0" * size, 0.0))


@_check_both
def _irregular_sampling(of: str, duration: Duration) -> None:
    """{of} counts samples in mean intervals of the whole trajectory, not elapsed time."""
    last = {"AEL": 5.0, "MEL": 20 / 3}
    examples = ("1100", 20 / 3), ("0011", 20 / 3), ("1011", last[of])
    _by_hand(of, duration, *examples, t=[0.0, 1.0, 2.0, 10.0])


@_check_both
def _segment_at_either_end(of: str, duration: Duration) -> None:
    """{of} counts segments that touch the first or the last sample."""
    both = {"AEL": ("1000111", 0.5), "MEL": ("1001100111", 0.75)}
    _by_hand(of, duration, ("00111", 0.75), ("11100", 0.75), both[of])


@_check_both
def _single_sample(of: str, duration: Duration) -> None:
    """{of} of one leaked sample is NaN: there is no interval; of one that does not leak, 0."""
    _by_hand(of, duration, ("1", nan), ("0", 0.0))


@_check_both
def _matches_brute_force(of: str, duration: Duration) -> None:
    """{of} equals the definition on random walks with a known pattern."""
    by_definition = {"AEL": ael_by_definition, "MEL": mel_by_definition}[of]
    for track in random_tracks(f"{of.lower()}_matches_brute_force"):
        expect(duration(*track.timed), by_definition(track), what=of, case=track)


@_check_both
def _rigid_motion_and_clock(of: str, duration: Duration) -> None:
    """{of} ignores rigid motion, time reversal and a clock's offset; it scales with the clock."""
    for track in random_tracks(f"invariances of {of}", count=60):
        value = duration(*track.timed)
        for change, other, factor in (
            ("turned, shifted and mirrored", moved(track), 1.0),
            ("backwards", backwards(track), 1.0),
            ("100 s later", replace(track, t=track.t + 100.0), 1.0),
            ("at half the speed", replace(track, t=2.0 * track.t), 2.0),
        ):
            what = f"{of} {change}"
            expect(duration(*other.timed), factor * value, what=what, case=track)


@check
def ael_may_fall_as_epsilon_grows(ael_s: Duration) -> None:
    """AEL is not monotone: a wider epsilon may add a short segment and lower the mean."""
    track = plain_track("11101")
    error_m = np.array([0.1, 0.1, 0.1, 0.9, 0.5])
    shared_xy = track.true_xy + np.column_stack([np.zeros(5), error_m])
    for epsilon_m, duration_s in ((0.3, 0.75), (0.6, 0.5), (1.0, 1.25)):
        value = ael_s(shared_xy, track.true_xy, track.t, epsilon_m)
        case = f"errors {error_m.tolist()} m every 0.25 s, epsilon {epsilon_m} m"
        expect(value, duration_s, what="AEL", case=case)


@check
def mel_monotone_in_epsilon(mel_s: Duration) -> None:
    """MEL never falls when epsilon grows."""
    for track in random_tracks("mel_monotone_in_epsilon", count=48, least=2):
        expect_rising(partial(mel_s, *track.timed[:-1]), what="MEL")


@check
def ael_of_independent_samples(ael_s: Duration) -> None:
    """AEL of independent samples averages to the exact mean run length (run counts)."""
    _independent(ael_s, "AEL", exact=mean_run_expected)


@check
def mel_of_independent_samples(mel_s: Duration) -> None:
    """MEL of independent samples averages to the exact mean longest run (recursion)."""
    _independent(mel_s, "MEL", exact=longest_run_expected)


@check
def mel_is_at_least_ael(ael_s: Duration, mel_s: Duration) -> None:
    """The longest segment lasts at least as long as the mean one."""
    for track in random_tracks("mel_is_at_least_ael", least=2):
        mean, longest = ael_s(*track.timed), mel_s(*track.timed)
        holds = longest >= mean - 1e-9 * abs(mean)
        expect_that(holds, what=f"MEL {longest!r} s is below AEL {mean!r} s", case=track)


@check
def mel_is_zero_exactly_when_plr_is(plr: PointRatio, mel_s: Duration) -> None:
    """MEL is 0 if and only if PLR is 0 (an unknown duration, NaN, is not 0)."""
    for track in random_tracks("mel_is_zero_exactly_when_plr_is"):
        share, longest = plr(*track.points), mel_s(*track.timed)
        what = f"PLR {share!r} and MEL {longest!r} s disagree on zero"
        expect_that((share == 0.0) == (longest == 0.0), what=what, case=track)


@check
def exposure_stops_at_the_end_of_a_track(exposure: Batch) -> None:
    """In a batch, no segment runs on into the next trajectory, and each has its own interval."""
    slow = plain_track("110", t=[0.0, 2.0, 4.0])
    tracks = [plain_track("0011"), slow, plain_track("1"), plain_track("1111")]
    _batch(exposure, tracks)


@check
def exposure_matches_brute_force(exposure: Batch) -> None:
    """In a batch, every trajectory gets what the definitions give it alone."""
    tracks = _one_epsilon("exposure_random")
    for first in range(0, len(tracks), 8):
        _batch(exposure, tracks[first : first + 8])


@check
def exposure_order_of_tracks(exposure: Batch) -> None:
    """In a batch, the values follow the trajectories when these change places."""
    tracks = _one_epsilon("exposure_order")
    order = stream(0, "testing", "exposure_order").permutation(len(tracks))
    straight = _run_batch(exposure, tracks)
    mixed = _run_batch(exposure, [tracks[place] for place in order])
    expect(mixed, straight[:, order], what="PLR, AEL, MEL in the new order", case="40 tracks")


@check
def plr_hand_examples(plr: PointRatio) -> None:
    """PLR is the share of leaked samples."""
    _by_hand("PLR", plr, ("1000", 0.25), ("1101", 0.75), ("01", 0.5), ("00100", 0.2))


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
        _by_hand("PLR", plr, ("1" * size, 1.0), ("0" * size, 0.0))


@check
def plr_single_sample(plr: PointRatio) -> None:
    """PLR of one sample is 1 or 0: no duration is needed."""
    _by_hand("PLR", plr, ("1", 1.0), ("0", 0.0))


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
    for track in random_tracks("plr_monotone_in_epsilon", count=48, least=2):
        expect_rising(partial(plr, *track.points[:-1]), what="PLR")


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


def _by_hand(
    of: str,
    function: Duration | PointRatio,
    *examples: tuple[str, float],
    t: Sequence[float] | None = None,
) -> None:
    for pattern, value in examples:
        track = plain_track(pattern, t=t)
        found = function(*(track.points if of == "PLR" else track.timed))
        expect(found, value, what=of, case=track)


def _independent(duration: Duration, what: str, *, exact: Callable[[int, float], float]) -> None:
    size, repeats, step_s = 30, 500, 0.5
    for p in (0.2, 0.6):
        leaked = stream(0, "testing", "independent", what, str(p)).random((repeats, size)) < p
        patterns = ["".join("1" if sample else "0" for sample in row) for row in leaked]
        t = (step_s * np.arange(size)).tolist()
        values = [duration(*plain_track(pattern, t=t).timed) for pattern in patterns]
        mean, error = float(np.mean(values)), float(np.std(values)) / sqrt(repeats)
        limit = exact(size, p) * step_s
        expect_that(
            abs(mean - limit) <= STANDARD_ERRORS * error,
            what=f"mean {what} is {mean:.4f} s, expected {limit:.4f} s within 5 x {error:.4f}",
            case=f"{repeats} trajectories of {size} samples 0.5 s apart, each leaked with p = {p}",
        )


def _one_epsilon(name: str) -> list[Track]:
    """Return random tracks whose errors are rescaled to one common epsilon."""
    tracks = []
    for track in random_tracks(name, count=40):
        error = (track.shared_xy - track.true_xy) * (EPSILON_M / track.epsilon_m)
        shared_xy = track.true_xy + error
        tracks.append(replace(track, shared_xy=shared_xy, epsilon_m=EPSILON_M))
    return tracks


def _run_batch(exposure: Batch, tracks: list[Track]) -> Floats:
    sizes = [len(track.pattern) for track in tracks]
    found = exposure(
        np.concatenate([track.shared_xy for track in tracks]),
        np.concatenate([track.true_xy for track in tracks]),
        np.concatenate([track.t for track in tracks]),
        np.concatenate([[0], np.cumsum(sizes)]),
        tracks[0].epsilon_m,
    )
    shapes = [values.shape for values in found]
    what = f"PLR, AEL and MEL have the shapes {shapes}, expected ({len(tracks)},) each"
    expect_that(shapes == 3 * [(len(tracks),)], what=what, case=f"{len(tracks)} tracks")
    return np.stack(found)


def _batch(exposure: Batch, tracks: list[Track]) -> None:
    shares, means, longest = _run_batch(exposure, tracks)
    case = " | ".join(str(track) for track in tracks)
    expect(shares, [plr_by_definition(track) for track in tracks], what="PLR", case=case)
    expect(means, [ael_by_definition(track) for track in tracks], what="AEL", case=case)
    expect(longest, [mel_by_definition(track) for track in tracks], what="MEL", case=case)


def _sizes(name: str) -> list[tuple[float, Generator]]:
    return [(size_m, stream(0, "testing", name, str(size_m))) for size_m in (0.1, 0.3, 0.75)]


def _near_share(plr: PointRatio, error: Floats, limit: float, case: str) -> None:
    share = plr(error, np.zeros_like(error), EPSILON_M)
    tolerance = STANDARD_ERRORS * sqrt(limit * (1.0 - limit) / _LARGE)
    what = f"PLR is {share!r}, expected {limit:.6f} within {tolerance:.6f}"
    expect_that(abs(share - limit) <= tolerance, what=what, case=f"{case}, {_LARGE} samples")
