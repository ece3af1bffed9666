"""Trajectories with a known leakage pattern, and what the descriptors are by definition.

A pattern is text, one character a sample, "1" for leaked: its segments are what remains
between the zeros. This is the brute-force oracle of the suite; it is meant to be read.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import comb, nan
from typing import TYPE_CHECKING

import numpy as np

from isac_track.rng import stream
from isac_track.testing._metrics import expect_that

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.random import Generator

    from isac_track.types import Floats

EPSILON_M = 0.3
STANDARD_ERRORS = 5.0
"""Width of the Monte Carlo tolerances; the draws are seeded, so that they never flicker."""

EPSILONS_M = np.linspace(0.02, 1.5, 25)

# Exact in binary, as are their squares: 0.75, 1 and 1.25 are a right-angled triangle.
ON_THE_BOUNDARY = np.array([[0.75, 1.0], [1.25, 0.0], [0.0, -1.25]])
BOUNDARY_M = 1.25


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

    @property
    def points(self) -> tuple[Floats, Floats, float]:
        """The arguments of `plr`."""
        return self.shared_xy, self.true_xy, self.epsilon_m

    @property
    def timed(self) -> tuple[Floats, Floats, Floats, float]:
        """The arguments of `ael_s` and `mel_s`."""
        return self.shared_xy, self.true_xy, self.t, self.epsilon_m


def plr_by_definition(track: Track) -> float:
    """Return the share of ones."""
    return track.pattern.count("1") / len(track.pattern)


def segments(pattern: str) -> list[int]:
    """Return the number of samples of every leaked segment."""
    return [len(run) for run in pattern.split("0") if run]


def interval_by_definition(t: Floats) -> float:
    """Return the mean sampling interval, s; a single sample has none."""
    return float(t[-1] - t[0]) / (len(t) - 1) if len(t) > 1 else nan


def ael_by_definition(track: Track) -> float:
    """Return the mean duration of the leaked segments, s; 0 without one."""
    runs = segments(track.pattern)
    return sum(runs) / len(runs) * interval_by_definition(track.t) if runs else 0.0


def mel_by_definition(track: Track) -> float:
    """Return the duration of the longest leaked segment, s; 0 without one."""
    runs = segments(track.pattern)
    return max(runs) * interval_by_definition(track.t) if runs else 0.0


def plain_track(pattern: str, *, t: Sequence[float] | None = None) -> Track:
    """Return a walk along x, sampled every 0.25 s, with errors of 0.1 m or 0.5 m to the side."""
    moments: Floats = (
        0.25 * np.arange(float(len(pattern))) if t is None else np.array(t, dtype=float)
    )
    true_xy = np.column_stack([1.2 * moments, np.zeros_like(moments)])
    error_m = np.array([0.1 if sample == "1" else 0.5 for sample in pattern])
    shared_xy = true_xy + np.column_stack([np.zeros_like(error_m), error_m])
    return Track(pattern=pattern, t=moments, true_xy=true_xy, shared_xy=shared_xy)


def random_track(rng: Generator, *, pattern: str) -> Track:
    """Return an irregularly sampled random walk with errors in all directions.

    No error lies within 2 % of epsilon, so that rounding cannot flip a sample.
    """
    size = len(pattern)
    epsilon_m = float(rng.uniform(0.05, 1.5))
    t: Floats = rng.uniform(-50.0, 50.0) + np.cumsum(rng.uniform(0.03, 0.4, size))
    true_xy = np.cumsum(rng.normal(0.0, 0.1, (size, 2)), axis=0) + rng.uniform(-30.0, 30.0, 2)
    leaked = np.array([sample == "1" for sample in pattern])
    norm: Floats = epsilon_m * np.where(
        leaked, rng.uniform(0, 0.98, size), rng.uniform(1.02, 4, size)
    )
    angle = rng.uniform(0.0, 2.0 * np.pi, size)
    error = norm[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return Track(
        pattern=pattern, t=t, true_xy=true_xy, shared_xy=true_xy + error, epsilon_m=epsilon_m
    )


def random_pattern(rng: Generator, *, size: int) -> str:
    """Return a pattern whose segments are neither all short nor all long."""
    stay = rng.uniform(0.1, 0.95)
    sample = bool(rng.integers(2))
    pattern = ""
    for _ in range(size):
        pattern += "1" if sample else "0"
        sample = sample if rng.random() < stay else not sample
    return pattern


def random_tracks(name: str, *, count: int = 150, least: int = 1) -> Iterator[Track]:
    """Yield seeded tracks of `least` samples or more, short ones first.

    So the first counterexample is a small one.
    """
    for index in range(count):
        rng = stream(0, "testing", name, index)
        yield random_track(rng, pattern=random_pattern(rng, size=least + index // 6))


def expect_rising(value: Callable[[float], float], *, what: str) -> None:
    """Fail if a value falls anywhere when epsilon grows."""
    values = [value(epsilon_m) for epsilon_m in EPSILONS_M]
    rising = all(low <= high for low, high in pairwise(values))
    expect_that(rising, what=f"{what} falls: {values}", case=f"epsilon {EPSILONS_M.tolist()} m")


def moved(track: Track) -> Track:
    """Return the trajectory turned, mirrored and shifted."""
    turn = np.array([[0.6, 0.8], [0.8, -0.6]])  # a reflection as well
    shift_m = np.array([120.0, -45.0])
    return replace(
        track, true_xy=track.true_xy @ turn + shift_m, shared_xy=track.shared_xy @ turn + shift_m
    )


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
