"""Checks of PLR (eq. plr_definition), AEL and MEL (the text below it), and batches.

Most use trajectories with a known leakage pattern: a text with one character a sample,
"1" for leaked. The runs of ones are its segments.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby, pairwise, product
from math import expm1, nan, sqrt
from statistics import fmean

import numpy as np
from scipy.special import ndtr

from isac_track.rng import stream
from isac_track.sensing import unit_errors
from isac_track.testing._metrics import Function, check, expect, expect_that
from isac_track.testing.engine import read_statement
from isac_track.types import ErrorLaw, Floats

EPSILON_M = 0.3
EPSILONS_M = np.linspace(0.02, 1.5, 25).tolist()
STANDARD_ERRORS = 5.0  # Width of the Monte Carlo tolerances.
_NAMES = {"plr": "PLR", "ael_s": "AEL", "mel_s": "MEL"}  # Of the functions' results.
_LARGE = 20_000  # Samples of a Monte Carlo check.


@dataclass(frozen=True, eq=False, slots=True)
class Track:
    """One trajectory whose leakage pattern is known by construction."""

    pattern: str
    t: Floats  # (T,) s
    true_xy: Floats  # (T, 2) m
    shared_xy: Floats  # (T, 2) m
    epsilon_m: float = EPSILON_M

    def __str__(self) -> str:
        times = ", ".join(f"{moment:.6g}" for moment in self.t)
        return (
            f"leakage pattern {self.pattern}, t = [{times}] s, epsilon"
            f" {self.epsilon_m:g} m"
        )


def evaluate(function: Function, track: Track) -> float:
    """Return the value of a descriptor for a trajectory."""
    clock = () if function.__name__ == "plr" else (track.t,)
    return float(function(track.shared_xy, track.true_xy, *clock, track.epsilon_m))


def expect_value(function: Function, track: Track, value: float) -> None:
    """Compare a descriptor of a trajectory with a number."""
    expect(
        evaluate(function, track), value, label=_NAMES[function.__name__], case=track
    )


def by_definition(track: Track) -> dict[str, float]:
    """Return PLR, AEL (s) and MEL (s), by the function's name, from the definitions.

    They are the share of leaked samples, and the mean and longest segment. A sample
    lasts half of each interval beside it, the first and the last a whole interval; a
    single sample has none.
    """
    steps = np.diff(track.t)
    lasting_s = (np.append(steps[:1], steps) + np.append(steps, steps[-1:])) / 2
    samples = zip(track.pattern, lasting_s.tolist() or [nan], strict=True)
    runs = groupby(samples, key=lambda sample: sample[0])
    runs_s = [sum(seconds for _, seconds in run) for leaks, run in runs if leaks == "1"]
    return {
        "plr": track.pattern.count("1") / len(track.pattern),
        "ael_s": sum(runs_s) / len(runs_s) if runs_s else 0.0,
        "mel_s": max(runs_s, default=0.0),
    }


def plain_track(pattern: str, *, t: Sequence[float] = ()) -> Track:
    """Return a walk along x with sideways errors of 0.1 m (leaked) or 0.5 m.

    It is sampled at `t`, (T,) s, or every 0.25 s.
    """
    moments: Floats = np.array(t, float) if t else 0.25 * np.arange(float(len(pattern)))
    true_xy = np.column_stack([1.2 * moments, np.zeros_like(moments)])
    error_m = np.array([0.1 if sample == "1" else 0.5 for sample in pattern])
    return Track(
        pattern, moments, true_xy, shared_xy=true_xy + error_m[:, None] * [0.0, 1.0]
    )


def random_tracks(
    name: str, *, count: int = 150, least_size: int = 1, epsilon_m: float = 0.0
) -> Iterator[Track]:
    """Yield irregularly sampled random walks, the shortest first.

    No error lies within 2 % of epsilon, so that rounding cannot flip a sample. Epsilon
    is random unless it is given.
    """
    for index in range(count):
        rng, size = stream(0, "testing", name, index), least_size + index // 6
        runs = rng.geometric(rng.uniform(0.05, 0.9), size)
        leaked = np.repeat(rng.integers(2) + np.arange(size), runs)[:size] % 2 == 1
        drawn_m = float(rng.uniform(0.05, 1.5))
        chosen_m = epsilon_m or drawn_m
        t: Floats = rng.uniform(-50.0, 50.0) + np.cumsum(rng.uniform(0.03, 0.4, size))
        true_xy = np.cumsum(rng.normal(0.0, 0.1, (size, 2)), axis=0) + rng.uniform(
            -30.0, 30.0, 2
        )
        near, far = rng.uniform(0, 0.98, size), rng.uniform(1.02, 4, size)
        error_m: Floats = chosen_m * np.where(leaked, near, far)
        angle_rad = rng.uniform(0.0, 2.0 * np.pi, size)
        shared_xy = true_xy + (error_m * [np.cos(angle_rad), np.sin(angle_rad)]).T
        pattern = "".join("01"[sample] for sample in leaked.astype(int))
        yield Track(pattern, t, true_xy, shared_xy, chosen_m)


def moved(track: Track) -> Track:
    """Return the trajectory turned, mirrored and shifted."""
    turn = np.array([[0.6, 0.8], [0.8, -0.6]])  # a reflection as well
    shift = [120.0, -45.0]
    return replace(
        track,
        true_xy=track.true_xy @ turn + shift,
        shared_xy=track.shared_xy @ turn + shift,
    )


def backwards(track: Track) -> Track:
    """Return the trajectory with the samples in reverse."""
    t, true_xy, shared_xy = track.t[::-1], track.true_xy[::-1], track.shared_xy[::-1]
    return Track(track.pattern[::-1], t[0] - t, true_xy, shared_xy, track.epsilon_m)


def _check_each(*needs: str) -> Callable[[Callable[[Function], None]], None]:
    """Register a check of each descriptor; its docstring may have `{metric}`."""

    def register_all(body: Callable[[Function], None]) -> None:
        for need in needs:
            statement = read_statement(body).format(metric=_NAMES[need])
            name = _NAMES[need].lower() + body.__name__
            check(body, name=name, statement=statement, needs=(need,))

    return register_all


def _expect_by_hand(
    function: Function, examples: dict[str, float], t: Sequence[float] = ()
) -> None:
    for pattern, value in examples.items():
        expect_value(function, plain_track(pattern, t=t), value)


@_check_each("plr", "ael_s", "mel_s")
def _hand_examples(function: Function) -> None:
    """{metric} is 0 when every sample lies at exactly epsilon: that is no leak."""
    examples = {
        "plr": {"1000": 0.25, "1101": 0.75, "01": 0.5, "00100": 0.2},
        "ael_s": {"0110": 0.5, "1011": 0.375, "10101": 0.25, "0001": 0.25},
        "mel_s": {"0110": 0.5, "101110": 0.75, "10101": 0.25, "0001": 0.25},
    }
    _expect_by_hand(function, examples[function.__name__])


@_check_each("plr", "ael_s", "mel_s")
def _boundary_is_strict(function: Function) -> None:
    """{metric} is 0 when every sample lies at exactly epsilon, which is no leak."""
    # The sides 0.75, 1 and 1.25 of a right-angled triangle, and their squares, are
    # exact in binary.
    t = np.array([0.0, 1.0, 2.0])
    errors = np.array([[0.75, 1.0], [1.25, 0.0], [0.0, -1.25]])
    above = 1.0 if function.__name__ == "plr" else 3.0
    for epsilon_m, value in ((1.25, 0.0), (float(np.nextafter(1.25, 2.0)), above)):
        case = f"errors {errors.tolist()} m, all of length 1.25 m, 1 s apart"
        track = Track(case, t, np.zeros_like(errors), errors, epsilon_m)
        expect_value(function, track, value)


@_check_each("plr", "ael_s", "mel_s")
def _all_and_none_leaked(function: Function) -> None:
    """{metric} is 1, or n intervals, when all n samples leak, and 0 when none does."""
    for size in (2, 5, 50):
        when_all_leak = 1.0 if function.__name__ == "plr" else 0.25 * size
        _expect_by_hand(function, {"1" * size: when_all_leak, "0" * size: 0.0})


@_check_each("ael_s", "mel_s")
def _irregular_sampling(function: Function) -> None:
    """{metric} of a single leaked sample: 1 as a share, NaN as a time; else 0."""
    last = {"ael_s": 6.75, "mel_s": 12.5}[function.__name__]
    examples = {"1100": 2.0, "0011": 12.5, "0010": 4.5, "1011": last}
    _expect_by_hand(function, examples, t=[0.0, 1.0, 2.0, 10.0])


@_check_each("ael_s", "mel_s")
def _segment_at_either_end(function: Function) -> None:
    """{metric} counts segments that touch the first or the last sample."""
    patterns = {"ael_s": {"1000111": 0.5}, "mel_s": {"1001100111": 0.75}}[
        function.__name__
    ]
    _expect_by_hand(function, {"00111": 0.75, "11100": 0.75} | patterns)


@_check_each("plr", "ael_s", "mel_s")
def _single_sample(function: Function) -> None:
    """{metric} of a single leaked sample is 1 as a share, NaN as a time; else 0."""
    _expect_by_hand(
        function, {"1": 1.0 if function.__name__ == "plr" else nan, "0": 0.0}
    )


@_check_each("plr", "ael_s", "mel_s")
def _matches_brute_force(function: Function) -> None:
    """{metric} equals its definition on random walks with a known pattern."""
    for track in random_tracks(
        f"{_NAMES[function.__name__].lower()}_matches_brute_force"
    ):
        expect_value(function, track, by_definition(track)[function.__name__])


def _expect_after(
    function: Function, change: Callable[[Track], Track], factor: float = 1.0
) -> None:
    """Compare a descriptor of changed random walks with `factor` times the original."""
    name = _NAMES[function.__name__]
    for track in random_tracks(f"invariances of {name}", count=60):
        changed, value = change(track), factor * evaluate(function, track)
        expect(
            evaluate(function, changed),
            value,
            label=f"{name} after a change",
            case=changed,
        )


@_check_each("ael_s", "mel_s")
def _rigid_motion_and_clock(function: Function) -> None:
    """{metric} ignores rigid motion, time reversal, clock offset; it scales with t."""
    _expect_after(function, moved)
    _expect_after(function, backwards)
    _expect_after(function, lambda track: replace(track, t=track.t + 100.0))
    _expect_after(function, lambda track: replace(track, t=2.0 * track.t), factor=2.0)


check(
    partial(_expect_after, change=moved),
    name="plr_rigid_motion",
    statement="PLR does not change when both walks are turned, shifted and mirrored.",
    needs=("plr",),
)
check(
    partial(_expect_after, change=backwards),
    name="plr_time_reversal",
    statement="PLR does not depend on the order of the samples.",
    needs=("plr",),
)


@_check_each("plr", "mel_s")
def _monotone_in_epsilon(function: Function) -> None:
    """{metric} never falls when epsilon grows."""
    name = _NAMES[function.__name__]
    for track in random_tracks(
        f"{name.lower()}_monotone_in_epsilon", count=48, least_size=2
    ):
        values = [
            evaluate(function, replace(track, epsilon_m=limit_m))
            for limit_m in EPSILONS_M
        ]
        rising = all(low <= high for low, high in pairwise(values))
        expect_that(
            rising, failure=f"{name} falls: {values}", case=f"epsilon {EPSILONS_M} m"
        )


@check
def ael_may_fall_as_epsilon_grows(ael_s: Function) -> None:
    """AEL is not monotone: a wider epsilon may add a short segment and lower it."""
    walk, errors_m = plain_track("00000"), [0.1, 0.1, 0.1, 0.9, 0.5]
    shared_xy = walk.true_xy + np.outer(errors_m, [0.0, 1.0])
    examples = (0.3, "11100", 0.75), (0.6, "11101", 0.5), (1.0, "11111", 1.25)
    for epsilon_m, pattern, value in examples:
        expect_value(
            ael_s, Track(pattern, walk.t, walk.true_xy, shared_xy, epsilon_m), value
        )


@_check_each("ael_s", "mel_s")
def _averages_independent_samples(function: Function) -> None:
    """{metric} of independent samples averages to the exact mean of its runs."""
    name, size = _NAMES[function.__name__], 9
    patterns = ["".join(samples) for samples in product("01", repeat=size)]
    values = np.array([evaluate(function, plain_track(text)) for text in patterns])
    runs = [[len(run) for run in text.split("0") if run] or [0] for text in patterns]
    exact = 0.25 * np.array(
        [fmean(lengths) if name == "AEL" else max(lengths) for lengths in runs]
    )
    leaked = np.array([text.count("1") for text in patterns])
    for p in (0.2, 0.6):
        weight = p**leaked * (1.0 - p) ** (size - leaked)
        case = (
            f"all patterns of {size} samples 0.25 s apart, each sample leaked with p"
            f" = {p}"
        )
        expect(values @ weight, exact @ weight, label=f"mean {name}", case=case)


@check
def mel_is_at_least_ael(ael_s: Function, mel_s: Function) -> None:
    """The longest segment lasts at least as long as the mean segment."""
    for track in random_tracks("mel_is_at_least_ael", least_size=2):
        mean, longest = evaluate(ael_s, track), evaluate(mel_s, track)
        failure = f"MEL {longest!r} s is below AEL {mean!r} s"
        expect_that(longest >= mean - 1e-9 * abs(mean), failure=failure, case=track)


@check
def mel_is_zero_exactly_when_plr_is(plr: Function, mel_s: Function) -> None:
    """MEL is 0 if and only if PLR is 0 (an unknown duration, NaN, is not 0)."""
    for track in random_tracks("mel_is_zero_exactly_when_plr_is"):
        share, longest = evaluate(plr, track), evaluate(mel_s, track)
        failure = f"PLR {share!r} and MEL {longest!r} s disagree on zero"
        expect_that((share == 0.0) == (longest == 0.0), failure=failure, case=track)


@check
def plr_distance_is_euclidean(plr: Function) -> None:
    """A sample leaks by its distance in the plane, not by either coordinate."""
    true_xy = np.array([[2.0, -1.0]])
    for error, share in (([0.25, 0.25], 0.0), ([0.2, 0.2], 1.0), ([-0.25, -0.1], 1.0)):
        shared_xy = true_xy + np.array(error)
        expect(
            plr(shared_xy, true_xy, 0.3),
            share,
            label="PLR",
            case=f"one error {error} m",
        )


@check
def plr_radial_gaussian(plr: Function) -> None:
    """PLR of radial errors |N(0, s)| tends to 2 Phi(epsilon / s) - 1."""
    _tends_to(plr, "radial", lambda ratio: 2.0 * float(ndtr(ratio)) - 1.0)


@check
def plr_isotropic_gaussian(plr: Function) -> None:
    """PLR of errors N(0, s) on each axis tends to 1 - exp(-epsilon^2 / 2 s^2)."""
    _tends_to(plr, "isotropic", lambda ratio: -expm1(-0.5 * ratio**2))


def _tends_to(plr: Function, law: ErrorLaw, limit_at: Callable[[float], float]) -> None:
    for sigma_m in (0.1, 0.3, 0.75):
        rng = stream(0, "testing", f"plr_{law}_gaussian", str(sigma_m))
        error = sigma_m * unit_errors(n_samples=_LARGE, law=law, rng=rng)
        share = plr(error, np.zeros_like(error), EPSILON_M)
        limit = limit_at(EPSILON_M / sigma_m)
        tolerance = STANDARD_ERRORS * sqrt(limit * (1.0 - limit) / _LARGE)
        failure = f"PLR is {share!r}, expected {limit:.6f} within {tolerance:.6f}"
        case = f"{law}, s = {sigma_m} m, {_LARGE} samples"
        expect_that(abs(share - limit) <= tolerance, failure=failure, case=case)


@check
def exposure_stops_at_the_end_of_a_track(exposure: Function) -> None:
    """In a batch, no segment crosses trajectories, and each has its own interval."""
    slow = plain_track("110", t=[0.0, 2.0, 4.0])
    _expect_batch(
        exposure, [plain_track("0011"), slow, plain_track("1"), plain_track("1111")]
    )


@check
def exposure_matches_brute_force(exposure: Function) -> None:
    """In a batch, every trajectory gets what the definitions give it alone."""
    tracks = list(random_tracks("exposure_random", count=40, epsilon_m=EPSILON_M))
    for first in range(0, len(tracks), 8):
        _expect_batch(exposure, tracks[first : first + 8])


@check
def exposure_order_of_tracks(exposure: Function) -> None:
    """In a batch, the values follow the trajectories when these change places."""
    tracks = list(random_tracks("exposure_order", count=40, epsilon_m=EPSILON_M))
    order = stream(0, "testing", "exposure_order").permutation(len(tracks))
    straight = _call_exposure(exposure, tracks)
    mixed = _call_exposure(exposure, [tracks[place] for place in order])
    expect(
        mixed,
        straight[:, order],
        label="PLR, AEL, MEL in the new order",
        case="40 tracks",
    )


def _call_exposure(exposure: Function, tracks: list[Track]) -> Floats:
    """Return PLR, AEL and MEL, (3, N), of the N trajectories in one call."""
    shared_xy = np.concatenate([track.shared_xy for track in tracks])
    true_xy = np.concatenate([track.true_xy for track in tracks])
    t = np.concatenate([track.t for track in tracks])
    offsets = np.cumsum([0, *(len(track.pattern) for track in tracks)])
    values: Floats = exposure(shared_xy, true_xy, t, offsets, tracks[0].epsilon_m)
    failure = (
        f"PLR, AEL and MEL have the shape {values.shape}, expected (3, {len(tracks)})"
    )
    expect_that(
        values.shape == (3, len(tracks)), failure=failure, case=f"{len(tracks)} tracks"
    )
    return values


def _expect_batch(exposure: Function, tracks: list[Track]) -> None:
    actual = _call_exposure(exposure, tracks)
    definitions = [by_definition(track) for track in tracks]
    for name, values in zip(_NAMES, actual, strict=True):
        case = " | ".join(map(str, tracks))
        expect(
            values,
            [expected[name] for expected in definitions],
            label=_NAMES[name],
            case=case,
        )
