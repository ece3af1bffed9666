"""Mechanisms that are meant to survive a filter, and the white noise that they are held against.

White noise falls to whoever smooths; `ou` adds an error that stays for seconds, which
neither a smoother nor the robot's filter averages away, `ou_fid` the same where the
Fisher information density is high. Derivations: docs/mechanisms.md.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final, Literal, TypeAlias

import numpy as np
from numpy.random import Generator

from isac_track.kalman import Batch, kalman_last
from isac_track.mechanisms.controls import correlated_errors
from isac_track.mechanisms.paper import Fid, fid_d_sigma
from isac_track.mechanisms.perturb import check_at_least, perturb
from isac_track.rng import stream
from isac_track.types import (
    Adding,
    ErrorLaw,
    Floats,
    Ints,
    Release,
    Sensed,
    positive,
    stretches,
)

Reuse: TypeAlias = Literal["release", "session"]
"""Whether errors are drawn anew for every release, or once for a walk and session."""
# Correlation times after which what was is forgotten: 1e-10 of it is left.
_REMEMBERED = 24
# Of the path of a session within one correlation time; between them it is a line.
_POINTS = 512
_PRIOR_STD = (
    100.0,
    10.0,
)  # m around the first sample, m/s: far more than any walk; not tuned.
_MEMORY_S = 6.0  # What a filter of a walk has long forgotten.


def session_errors(*, t: Floats, offsets: Ints, walk: Ints, tau_s: float) -> Floats:
    """Return standardised Ornstein-Uhlenbeck errors that belong to walks, (M, 2), per axis.

    An instant of a walk has the same error in whichever release: the path follows from
    the number of the walk alone. Its values at multiples of `tau_s` are those of a
    stationary process; between them lies a bridge, exact at 512 points and a line in
    between, of unit variance everywhere. `t` are (M,) s, `offsets` (N + 1,), `walk`
    (N,) the numbers.
    """
    errors = np.empty((t.size, 2))
    for number, first, end in zip(
        walk.tolist(), offsets[:-1], offsets[1:], strict=True
    ):
        place = t[first:end] / tau_s
        block = np.floor(place).astype(np.int64)
        known: dict[int, Floats] = {}
        for one in np.unique(block).tolist():
            path = _bridge(number, one, known)
            inside = np.flatnonzero(block == one)
            at = (place[inside] - one) * _POINTS
            left = np.minimum(at.astype(np.int64), _POINTS - 1)
            weight = (at - left)[:, None]
            mixed = (1.0 - weight) * path[left] + weight * path[left + 1]
            # Of two points that correlate by f the line has variance 1 - 2 w (1 - w) (1
            # - f).
            lost = -2.0 * np.expm1(-1.0 / _POINTS) * weight * (1.0 - weight)
            errors[first + inside] = mixed / np.sqrt(1.0 - lost)
    return errors


def _bridge(walk: int, block: int, known: dict[int, Floats]) -> Floats:
    """Return the path of a walk over one correlation time, (512 + 1, 2); `known` are its draws."""
    for one in range(block - _REMEMBERED, block + 2):
        if one not in known:
            known[one] = stream(0, "session errors", walk, one).standard_normal(2)
    ages = np.exp(-np.arange(_REMEMBERED, dtype=float))
    kept = np.sqrt(-np.expm1(-2.0))
    start, end = (
        kept * (ages @ np.stack([known[last - age] for age in range(_REMEMBERED)]))
        for last in (block, block + 1)
    )
    # A free path from the start, then moved by what it misses the end by (Matheron's
    # rule).
    f = np.exp(-1.0 / _POINTS)
    grid = np.arange(_POINTS + 1) / _POINTS
    growth = np.exp(grid)[:, None]
    steps = stream(0, "session bridge", walk, block).standard_normal((_POINTS, 2))
    steps *= np.sqrt(-np.expm1(-2.0 / _POINTS))
    free = start / growth
    free[1:] += (
        np.cumsum(steps * f ** -np.arange(1.0, _POINTS + 1)[:, None], axis=0)
        / growth[1:]
    )
    pull = np.exp(-(1.0 - grid)) * np.expm1(-2.0 * grid) / np.expm1(-2.0)
    return np.asarray(free + pull[:, None] * (end - free[-1]))


def _with_slow_error(
    sensed: Sensed, std_m: Floats | float, mechanism: "Ou | OuFid", rng: Generator
) -> Release:
    """Return the raw estimates with a slow error; either kind of reuse draws alike from `rng`."""
    t, offsets, tau_s = sensed.t, sensed.offsets, mechanism.tau_s
    unit = correlated_errors(
        t=t, offsets=offsets, law="isotropic", tau_s=tau_s, rng=rng
    )
    if mechanism.reuse == "session":
        unit = session_errors(t=t, offsets=offsets, walk=sensed.walk, tau_s=tau_s)
    return perturb(sensed, std_m, rng, adding="independent", unit_error=unit)


def _check_slow(tau_s: float, reuse: str) -> None:
    positive("tau_s", tau_s)
    if reuse not in ("release", "session"):
        raise ValueError(f"reuse must be release or session, got {reuse!r}")


@dataclass(frozen=True, slots=True)
class Ou:
    """Add a Gaussian error that changes slowly: an Ornstein-Uhlenbeck process per axis."""

    std_m: float  # Of the added error, per axis and stationary, m.
    tau_s: float = 5.0  # Time over which its correlation falls to 1/e, s.
    reuse: Reuse = "release"
    """`session`: every release of a walk in one session bears the same error at the same instant;
    averaging gains nothing, but two releases are as alike as their errors."""

    adding: ClassVar[Adding] = "independent"
    law: ClassVar[ErrorLaw] = "isotropic"
    protects: ClassVar[bool] = True
    errors_are_independent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_at_least("std_m", self.std_m, 0, " m")
        _check_slow(self.tau_s, self.reuse)

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the raw estimates with the slow error on top."""
        return _with_slow_error(sensed, self.std_m, self, rng)


@dataclass(frozen=True, slots=True)
class OuFid:
    """Add the slow error of `ou` where the FID rule asks for one, as much as it asks for."""

    eta: float  # 1/(m^2 s)
    alpha: float = 0.5  # m
    beta: float = 1.5
    tau_s: float = 5.0  # s
    reuse: Reuse = "release"

    sweep: ClassVar[str] = "log"
    adding: ClassVar[Adding] = "independent"
    law: ClassVar[ErrorLaw] = "isotropic"
    protects: ClassVar[bool] = True
    errors_are_independent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        Fid(self.eta, self.alpha, self.beta)  # which checks them
        _check_slow(self.tau_s, self.reuse)

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the raw estimates with the slow error that the rule scales."""
        extra = fid_d_sigma(
            fid=sensed.fid, eta=self.eta, alpha_m=self.alpha, beta=self.beta
        )
        return _with_slow_error(sensed, extra, self, rng)


@dataclass(frozen=True, slots=True)
class Laplace:
    """Add planar Laplace noise to every sample (Andres et al., CCS 2013).

    Its density falls as exp(-epsilon r); the distance r has the law Gamma(2, 1 /
    epsilon), so that either axis has the standard deviation sqrt(3) / epsilon.
    """

    std_m: float  # Of the added error, per axis, m.

    adding: ClassVar[Adding] = "independent"
    law: ClassVar[ErrorLaw] = "isotropic"
    protects: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_at_least("std_m", self.std_m, 0, " m")

    @property
    def epsilon_per_m(self) -> float:
        """Of geo-indistinguishability, 1/m, for one report; infinite without noise."""
        return float(np.sqrt(3.0) / self.std_m) if self.std_m > 0 else float("inf")

    def epsilon_over(self, n_reports: int) -> float:
        """Of a whole track, 1/m: those of its reports add up."""
        return n_reports * self.epsilon_per_m

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the raw estimates with planar Laplace noise on top."""
        turn = 2.0 * np.pi * rng.random(sensed.t.size)
        distance = rng.standard_gamma(2.0, sensed.t.size) / np.sqrt(3.0)
        unit = distance[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        return perturb(sensed, self.std_m, rng, adding="independent", unit_error=unit)


@dataclass(frozen=True, slots=True)
class Forecast:
    """Share the network's own filtered position, seldom, with white Gaussian noise on top.

    A constant-velocity filter has seen all samples up to each one that is shared; of
    these there is one every `every_s`, counted back from the last.
    """

    std_m: float  # Of the added error, per axis, m.
    every_s: float = 1.0  # s
    q: float = 0.057  # m^2/s^3, spectral density of the acceleration in the filter.

    adding: ClassVar[Adding] = "independent"
    law: ClassVar[ErrorLaw] = "isotropic"
    protects: ClassVar[bool] = True
    errors_are_independent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_at_least("std_m", self.std_m, 0, " m")
        positive("every_s", self.every_s)
        positive("q", self.q)

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the filtered positions of the samples that are shared."""
        white = rng.standard_normal((sensed.t.size, 2))
        # Radially |N(0, sigma)| is half of sigma^2 per axis.
        share = 1.0 if sensed.law == "isotropic" else 0.5
        owner = np.repeat(np.arange(len(sensed)), np.diff(sensed.offsets))
        turn = np.floor(
            (sensed.t[sensed.offsets[1:] - 1][owner] - sensed.t) / self.every_s
        )
        rows = np.flatnonzero(
            (np.diff(turn, append=-1.0) != 0) | (np.diff(owner, append=-1) != 0)
        )
        # What each filter has seen: its own stretch of the walk, back to its start or
        # far enough.
        known = owner + 1j * sensed.t
        first = np.searchsorted(known, owner[rows] + 1j * (sensed.t[rows] - _MEMORY_S))
        first = np.maximum(first, sensed.offsets[owner[rows]])
        taken, offsets = stretches(first, rows + 1 - first)
        variance = np.maximum(
            share * sensed.sigma_raw[taken] ** 2, np.finfo(float).tiny
        )
        seen = Batch(sensed.t[taken], sensed.xy[taken], variance, offsets, _PRIOR_STD)
        state = kalman_last(seen, q=self.q)
        return Release(
            t=sensed.t[rows],
            xy=state.mean[:, :, 0] + self.std_m * white[rows],
            sigma=np.hypot(np.sqrt(state.cov[:, 0, 0]), self.std_m),
            offsets=np.append(
                0, np.cumsum(np.bincount(owner[rows], minlength=len(sensed)))
            ),
            pseudonym=perturb(sensed, 0.0, rng).pseudonym,
        )


MECHANISMS: Final[Mapping[str, type]] = {
    "ou": Ou,
    "ou_fid": OuFid,
    "laplace": Laplace,
    "forecast": Forecast,
}  # By the name in a SPEC.
