"""Checks of PLR (eq. plr_definition), of AEL and MEL (the text below it), and of batches.

Most are held against trajectories whose leakage pattern is known. A pattern is text, one character
a sample, "1" for leaked: its segments are what remains between the zeros. This is the brute-force
oracle of the suite; it is meant to be read.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from math import comb, expm1, nan, sqrt
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr

from isac_track.rng import stream
from isac_track.testing._metrics import Function, check, expect, expect_that, register
from isac_track.testing.engine import statement_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.random import Generator

    from isac_track.types import Floats

EPSILON_M = 0.3
EPSILONS_M = np.linspace(0.02, 1.5, 25)
STANDARD_ERRORS = 5.0
"""Width of the Monte Carlo tolerances; the draws are seeded, so that they never flicker."""
# Exact in binary, as are their squares: 0.75, 1 and 1.25 are a right-angled triangle.
ON_THE_BOUNDARY = np.array([[0.75, 1.0], [1.25, 0.0], [0.0, -1.25]])
BOUNDARY_M = 1.25
_NEEDS = {"PLR": "plr", "AEL": "ael_s", "MEL": "mel_s"}
_LARGE = 20_000


@dataclass(frozen=True, eq=False, slots=True)
class Track:
    """One trajectory whose leakage pattern is known by construction."""

    pattern: str
    t: Floats
    """(T,) s"""
    true_xy: Floats
    """(T, 2) m"""
    shared_xy: Floats
    """(T, 2) m"""
    epsilon_m: float = EPSILON_M

    def __str__(self) -> str:
        times = ", ".join(f"{moment:.6g}" for moment in self.t)
        return f"leakage pattern {self.pattern}, t = [{times}] s, epsilon {self.epsilon_m:g} m"

    def given(self, of: str) -> tuple[Floats | float, ...]:
        """Return the arguments of the function of a descriptor; epsilon is the last."""
        clock = () if of == "PLR" else (self.t,)
        return self.shared_xy, self.true_xy, *clock, self.epsilon_m


def segments(pattern: str) -> list[int]:
    """Return the number of samples of every leaked segment."""
    return [len(run) for run in pattern.split("0") if run]


def by_definition(track: Track) -> dict[str, float]:
    """Return PLR, AEL (s) and MEL (s); a single sample has no interval."""
    runs, size = segments(track.pattern), len(track.pattern)
    interval_s = float(track.t[-1] - track.t[0]) / (size - 1) if size > 1 else nan
    return {
        "PLR": sum(runs) / size,
        "AEL": sum(runs) / len(runs) * interval_s if runs else 0.0,
        "MEL": max(runs) * interval_s if runs else 0.0,
    }


def plain_track(pattern: str, *, t: Sequence[float] | None = None) -> Track:
    """Return a walk along x, sampled every 0.25 s, with errors of 0.1 m or 0.5 m to the side."""
    moments: Floats = 0.25 * np.arange(float(len(pattern))) if t is None else np.array(t, float)
    true_xy = np.column_stack([1.2 * moments, np.zeros_like(moments)])
    error_m = np.array([0.1 if sample == "1" else 0.5 for sample in pattern])
    shared_xy = true_xy + np.column_stack([np.zeros_like(error_m), error_m])
    return Track(pattern=pattern, t=moments, true_xy=true_xy, shared_xy=shared_xy)


def random_track(rng: Generator, *, size: int) -> Track:
    """Return an irregularly sampled random walk with errors in all directions.

    Its segments are neither all short nor all long. No error lies within 2 % of epsilon, so that
    rounding cannot flip a sample.
    """
    stay, sample = rng.uniform(0.1, 0.95), bool(rng.integers(2))
    pattern = ""
    for _ in range(size):
        pattern += "1" if sample else "0"
        sample = sample if rng.random() < stay else not sample
    leaked = np.array([sample == "1" for sample in pattern])
    epsilon_m = float(rng.uniform(0.05, 1.5))
    t: Floats = rng.uniform(-50.0, 50.0) + np.cumsum(rng.uniform(0.03, 0.4, size))
    true_xy = np.cumsum(rng.normal(0.0, 0.1, (size, 2)), axis=0) + rng.uniform(-30.0, 30.0, 2)
    near, far = rng.uniform(0, 0.98, size), rng.uniform(1.02, 4, size)
    error = _turned(epsilon_m * np.where(leaked, near, far), rng.uniform(0.0, 2.0 * np.pi, size))
    return Track(pattern, t=t, true_xy=true_xy, shared_xy=true_xy + error, epsilon_m=epsilon_m)


def random_tracks(name: str, *, count: int = 150, least: int = 1) -> Iterator[Track]:
    """Yield seeded tracks, those of few samples first: the first counterexample is a small one."""
    for index in range(count):
        yield random_track(stream(0, "testing", name, index), size=least + index // 6)


def _turned(norm: Floats, angle_rad: Floats) -> Floats:
    return np.column_stack([norm * np.cos(angle_rad), norm * np.sin(angle_rad)])


def moved(track: Track) -> Track:
    """Return the trajectory turned, mirrored and shifted."""
    turn = np.array([[0.6, 0.8], [0.8, -0.6]])  # a reflection as well
    true_xy, shared_xy = (xy @ turn + [120.0, -45.0] for xy in (track.true_xy, track.shared_xy))
    return replace(track, true_xy=true_xy, shared_xy=shared_xy)


def backwards(track: Track) -> Track:
    """Return the trajectory with the samples in reverse."""
    return replace(
        track,
        pattern=track.pattern[::-1],
        t=track.t[-1] - track.t[::-1],
        true_xy=track.true_xy[::-1],
        shared_xy=track.shared_xy[::-1],
    )


def longest_run_expected(n: int, p: float) -> float:
    """Return the mean length of the longest run of ones among n independent samples.

    ``P(longest <= k)`` by the place of the first zero (Schilling, The longest run of heads,
    1990): ``F(m) = sum over j = 0..k of p^j q F(m - 1 - j)`` for m > k, and 1 for m <= k.
    """
    expected = 0.0
    for k in range(n):
        at_most_k = [1.0] * (k + 1)
        for m in range(k + 1, n + 1):
            at_most_k.append(sum(p**j * (1 - p) * at_most_k[m - 1 - j] for j in range(k + 1)))
        expected += 1.0 - at_most_k[n]
    return expected


def mean_run_expected(n: int, p: float) -> float:
    """Return the mean over patterns of their mean run length (0 without a one).

    Of the patterns with m ones, C(m - 1, r - 1) C(n - m + 1, r) have them in r runs.
    """
    return sum(
        comb(m - 1, r - 1) * comb(n - m + 1, r) * p**m * (1 - p) ** (n - m) * m / r
        for m in range(1, n + 1)
        for r in range(1, m + 1)
    )


def _check_each(**words: str) -> Callable[[Callable[[str, Function], None]], None]:
    """Register a check of each descriptor; it receives the name, and the function.

    Its docstring says what it shows, with `of` for the descriptor and `word` for what is given.
    """

    def register_all(body: Callable[[str, Function], None]) -> None:
        for of, word in words.items():
            register(
                partial(body, of),
                name=of.lower() + body.__name__,
                statement=statement_of(body).format(of=of, word=word),
                needs=(_NEEDS[of],),
            )

    return register_all


def _by_hand(
    of: str, function: Function, examples: dict[str, float], *, t: Sequence[float] | None = None
) -> None:
    for pattern, value in examples.items():
        track = plain_track(pattern, t=t)
        expect(function(*track.given(of)), value, what=of, case=track)


@_check_each(
    PLR="share of leaked samples",
    AEL="mean duration of the leaked segments; n samples last n intervals of 0.25 s",
    MEL="duration of the longest leaked segment; n samples last n intervals of 0.25 s",
)
def _hand_examples(of: str, function: Function) -> None:
    """{of} is the {word}."""
    examples = {
        "PLR": {"1000": 0.25, "1101": 0.75, "01": 0.5, "00100": 0.2},
        "AEL": {"0110": 0.5, "1011": 0.375, "10101": 0.25, "0001": 0.25},
        "MEL": {"0110": 0.5, "101110": 0.75, "10101": 0.25, "0001": 0.25},
    }
    _by_hand(of, function, examples[of])


@_check_each(
    PLR="A sample at exactly epsilon does not leak",
    AEL="AEL is 0 when every sample lies at exactly epsilon",
    MEL="MEL is 0 when every sample lies at exactly epsilon",
)
def _boundary_is_strict(of: str, function: Function) -> None:
    """{word}."""
    truth, t = np.zeros_like(ON_THE_BOUNDARY), np.array([0.0, 1.0, 2.0])
    case = f"errors {ON_THE_BOUNDARY.tolist()} m, all of length 1.25 m, 1 s apart"
    above = 1.0 if of == "PLR" else 3.0
    for epsilon_m, value in ((BOUNDARY_M, 0.0), (float(np.nextafter(BOUNDARY_M, 2.0)), above)):
        track = Track("", t=t, true_xy=truth, shared_xy=ON_THE_BOUNDARY, epsilon_m=epsilon_m)
        what = f"{of} at epsilon {epsilon_m!r} m"
        expect(function(*track.given(of)), value, what=what, case=case)


@_check_each(
    PLR="1 when every sample leaks",
    AEL="n intervals when all n samples leak",
    MEL="n intervals when all n samples leak",
)
def _all_and_none_leaked(of: str, function: Function) -> None:
    """{of} is {word} and 0 when none does."""
    for size in (2, 5, 50):
        whole = 1.0 if of == "PLR" else 0.25 * size
        _by_hand(of, function, {"1" * size: whole, "0" * size: 0.0})


@_check_each(AEL="", MEL="")
def _irregular_sampling(of: str, function: Function) -> None:
    """{of} counts samples in mean intervals of the whole trajectory, not elapsed time."""
    last = {"AEL": 5.0, "MEL": 20 / 3}[of]
    examples = {"1100": 20 / 3, "0011": 20 / 3, "1011": last}
    _by_hand(of, function, examples, t=[0.0, 1.0, 2.0, 10.0])


@_check_each(AEL="", MEL="")
def _segment_at_either_end(of: str, function: Function) -> None:
    """{of} counts segments that touch the first or the last sample."""
    both = {"AEL": {"1000111": 0.5}, "MEL": {"1001100111": 0.75}}[of]
    _by_hand(of, function, {"00111": 0.75, "11100": 0.75} | both)


@_check_each(
    PLR="one sample is 1 or 0: no duration is needed",
    AEL="one leaked sample is NaN: there is no interval; of one that does not leak, 0",
    MEL="one leaked sample is NaN: there is no interval; of one that does not leak, 0",
)
def _single_sample(of: str, function: Function) -> None:
    """{of} of {word}."""
    _by_hand(of, function, {"1": 1.0 if of == "PLR" else nan, "0": 0.0})


@_check_each(PLR="count", AEL="definition", MEL="definition")
def _matches_brute_force(of: str, function: Function) -> None:
    """{of} equals the {word} on random walks with a known pattern."""
    for track in random_tracks(f"{of.lower()}_matches_brute_force"):
        expect(function(*track.given(of)), by_definition(track)[of], what=of, case=track)


@_check_each(AEL="", MEL="")
def _rigid_motion_and_clock(of: str, function: Function) -> None:
    """{of} ignores rigid motion, time reversal and a clock's offset; it scales with the clock."""
    for track in random_tracks(f"invariances of {of}", count=60):
        value = function(*track.given(of))
        for change, other, factor in (
            ("turned, shifted and mirrored", moved(track), 1.0),
            ("backwards", backwards(track), 1.0),
            ("100 s later", replace(track, t=track.t + 100.0), 1.0),
            ("at half the speed", replace(track, t=2.0 * track.t), 2.0),
        ):
            what = f"{of} {change}"
            expect(function(*other.given(of)), factor * value, what=what, case=track)


@check
def plr_rigid_motion(plr: Function) -> None:
    """PLR does not change when both walks are turned, shifted and mirrored together."""
    for track in random_tracks("plr_rigid_motion", count=60):
        value = plr(*moved(track).given("PLR"))
        expect(value, plr(*track.given("PLR")), what="PLR after the motion", case=track)


@check
def plr_time_reversal(plr: Function) -> None:
    """PLR does not depend on the order of the samples."""
    for track in random_tracks("plr_time_reversal", count=60):
        value = plr(*backwards(track).given("PLR"))
        expect(value, plr(*track.given("PLR")), what="PLR backwards", case=track)


@_check_each(PLR="", MEL="")
def _monotone_in_epsilon(of: str, function: Function) -> None:
    """{of} never falls when epsilon grows."""
    for track in random_tracks(f"{of.lower()}_monotone_in_epsilon", count=48, least=2):
        values = [function(*track.given(of)[:-1], epsilon_m) for epsilon_m in EPSILONS_M]
        rising = all(low <= high for low, high in pairwise(values))
        case = f"epsilon {EPSILONS_M.tolist()} m"
        expect_that(rising, what=f"{of} falls: {values}", case=case)


@check
def ael_may_fall_as_epsilon_grows(ael_s: Function) -> None:
    """AEL is not monotone: a wider epsilon may add a short segment and lower the mean."""
    track = plain_track("11101")
    error_m = np.array([0.1, 0.1, 0.1, 0.9, 0.5])
    shared_xy = track.true_xy + np.column_stack([np.zeros(5), error_m])
    for epsilon_m, duration_s in ((0.3, 0.75), (0.6, 0.5), (1.0, 1.25)):
        value = ael_s(shared_xy, track.true_xy, track.t, epsilon_m)
        case = f"errors {error_m.tolist()} m every 0.25 s, epsilon {epsilon_m} m"
        expect(value, duration_s, what="AEL", case=case)


@_check_each(AEL="run length (run counts)", MEL="longest run (recursion)")
def _of_independent_samples(of: str, function: Function) -> None:
    """{of} of independent samples averages to the exact mean {word}."""
    exact = {"AEL": mean_run_expected, "MEL": longest_run_expected}[of]
    size, repeats, step_s = 30, 500, 0.5
    for p in (0.2, 0.6):
        leaked = stream(0, "testing", "independent", of, str(p)).random((repeats, size)) < p
        patterns = ["".join("01"[sample] for sample in row) for row in leaked.astype(int)]
        t = (step_s * np.arange(size)).tolist()
        values = [function(*plain_track(pattern, t=t).given(of)) for pattern in patterns]
        mean, error = float(np.mean(values)), float(np.std(values)) / sqrt(repeats)
        limit = exact(size, p) * step_s
        expect_that(
            abs(mean - limit) <= STANDARD_ERRORS * error,
            what=f"mean {of} is {mean:.4f} s, expected {limit:.4f} s within 5 x {error:.4f}",
            case=f"{repeats} trajectories of {size} samples 0.5 s apart, each leaked with p = {p}",
        )


@check
def mel_is_at_least_ael(ael_s: Function, mel_s: Function) -> None:
    """The longest segment lasts at least as long as the mean one."""
    for track in random_tracks("mel_is_at_least_ael", least=2):
        mean, longest = ael_s(*track.given("AEL")), mel_s(*track.given("MEL"))
        holds = longest >= mean - 1e-9 * abs(mean)
        expect_that(holds, what=f"MEL {longest!r} s is below AEL {mean!r} s", case=track)


@check
def mel_is_zero_exactly_when_plr_is(plr: Function, mel_s: Function) -> None:
    """MEL is 0 if and only if PLR is 0 (an unknown duration, NaN, is not 0)."""
    for track in random_tracks("mel_is_zero_exactly_when_plr_is"):
        share, longest = plr(*track.given("PLR")), mel_s(*track.given("MEL"))
        what = f"PLR {share!r} and MEL {longest!r} s disagree on zero"
        expect_that((share == 0.0) == (longest == 0.0), what=what, case=track)


@check
def plr_distance_is_euclidean(plr: Function) -> None:
    """A sample leaks by its distance in the plane, not by either coordinate."""
    true_xy = np.array([[2.0, -1.0]])
    for error, share in (([0.25, 0.25], 0.0), ([0.2, 0.2], 1.0), ([-0.25, -0.1], 1.0)):
        shared_xy = true_xy + np.array([error])
        expect(plr(shared_xy, true_xy, 0.3), share, what="PLR", case=f"one error {error} m")


@check
def plr_radial_gaussian(plr: Function) -> None:
    """PLR of radial errors |N(0, s)| tends to 2 Phi(epsilon / s) - 1."""
    for sigma_m, rng in _sizes("plr_radial_gaussian"):
        angle_rad = rng.uniform(0.0, 2.0 * np.pi, _LARGE)
        error = _turned(rng.normal(0.0, sigma_m, _LARGE), angle_rad)
        limit = 2.0 * float(ndtr(EPSILON_M / sigma_m)) - 1.0
        _near_share(plr, error, limit, f"radial, s = {sigma_m} m")


@check
def plr_isotropic_gaussian(plr: Function) -> None:
    """PLR of errors N(0, s) on each axis tends to 1 - exp(-epsilon^2 / 2 s^2)."""
    for sigma_m, rng in _sizes("plr_isotropic_gaussian"):
        error = rng.normal(0.0, sigma_m, (_LARGE, 2))
        limit = -expm1(-0.5 * (EPSILON_M / sigma_m) ** 2)
        _near_share(plr, error, limit, f"isotropic, s = {sigma_m} m")


def _sizes(name: str) -> list[tuple[float, Generator]]:
    return [(size_m, stream(0, "testing", name, str(size_m))) for size_m in (0.1, 0.3, 0.75)]


def _near_share(plr: Function, error: Floats, limit: float, case: str) -> None:
    share = plr(error, np.zeros_like(error), EPSILON_M)
    tolerance = STANDARD_ERRORS * sqrt(limit * (1.0 - limit) / _LARGE)
    what = f"PLR is {share!r}, expected {limit:.6f} within {tolerance:.6f}"
    expect_that(abs(share - limit) <= tolerance, what=what, case=f"{case}, {_LARGE} samples")


@check
def exposure_stops_at_the_end_of_a_track(exposure: Function) -> None:
    """In a batch, no segment runs on into the next trajectory, and each has its own interval."""
    slow = plain_track("110", t=[0.0, 2.0, 4.0])
    _batch(exposure, [plain_track("0011"), slow, plain_track("1"), plain_track("1111")])


@check
def exposure_matches_brute_force(exposure: Function) -> None:
    """In a batch, every trajectory gets what the definitions give it alone."""
    tracks = _one_epsilon("exposure_random")
    for first in range(0, len(tracks), 8):
        _batch(exposure, tracks[first : first + 8])


@check
def exposure_order_of_tracks(exposure: Function) -> None:
    """In a batch, the values follow the trajectories when these change places."""
    tracks = _one_epsilon("exposure_order")
    order = stream(0, "testing", "exposure_order").permutation(len(tracks))
    straight = _run_batch(exposure, tracks)
    mixed = _run_batch(exposure, [tracks[place] for place in order])
    expect(mixed, straight[:, order], what="PLR, AEL, MEL in the new order", case="40 tracks")


def _one_epsilon(name: str) -> list[Track]:
    """Return random tracks whose errors are rescaled to one common epsilon."""
    tracks = []
    for track in random_tracks(name, count=40):
        error = (track.shared_xy - track.true_xy) * (EPSILON_M / track.epsilon_m)
        tracks.append(replace(track, shared_xy=track.true_xy + error, epsilon_m=EPSILON_M))
    return tracks


def _run_batch(exposure: Function, tracks: list[Track]) -> Floats:
    found = exposure(
        np.concatenate([track.shared_xy for track in tracks]),
        np.concatenate([track.true_xy for track in tracks]),
        np.concatenate([track.t for track in tracks]),
        np.cumsum([0, *(len(track.pattern) for track in tracks)]),
        tracks[0].epsilon_m,
    )
    shapes = [values.shape for values in found]
    what = f"PLR, AEL and MEL have the shapes {shapes}, expected ({len(tracks)},) each"
    expect_that(shapes == 3 * [(len(tracks),)], what=what, case=f"{len(tracks)} tracks")
    return np.stack(found)


def _batch(exposure: Function, tracks: list[Track]) -> None:
    found = _run_batch(exposure, tracks)
    wanted = [by_definition(track) for track in tracks]
    for of, values in zip(_NEEDS, found, strict=True):
        case = " | ".join(map(str, tracks))
        expect(values, [one[of] for one in wanted], what=of, case=case)
