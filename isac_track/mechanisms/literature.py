"""Mechanisms of the literature, for comparison: each with the promise of its paper.

Derivations, and what each promise says about a walk:
docs/explanation/mechanisms-of-the-literature.md.

References
----------
Correlated Laplace noise: Wang, Xu, "CTS-DP: publishing correlated time-series data via
differential privacy", Knowledge-Based Systems 122, 2017, and its QCLM: Entropy 26(2),
2024, 138. Gaussian-process prior: Meehan, Chaudhuri, "Location trace privacy under
conditional priors", AISTATS 2021 (arXiv 2102.11955). Fourier coefficients: Ou, Qin,
Liao, Yin, Jia, "An optimal Pufferfish privacy mechanism for temporally correlated
trajectories", IEEE Access 6, 2018, 37150-37165; Rastogi, Nath, SIGMOD 2010. Remapping:
Chatzikokolakis, ElSalamouny, Palamidessi, PoPETs 2017(4), 308-328. Least information:
Cover, Thomas, *Elements of Information Theory*, 2006, sections 9.4 and 10.3.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Final

import numpy as np
from numpy.random import Generator

from isac_track.kalman import Batch
from isac_track.kalman.slow_errors import SlowError, filter_tracks
from isac_track.kalman.steady import INTERVAL_S, Q_M2_PER_S3
from isac_track.measurement import axis_variance
from isac_track.mechanisms.error_paths import Reuse, check_slow
from isac_track.mechanisms.perturb import add_isotropic
from isac_track.mechanisms.protections import Laplace
from isac_track.mechanisms.stationary import (
    Filter,
    add_stationary,
    error_numbers,
    smooth_filter,
    stationary_errors,
)
from isac_track.rng import stream
from isac_track.types import (
    Adding,
    ErrorLaw,
    Floats,
    Release,
    Sensed,
    check_at_least,
    derived,
    positive,
)

WALK_TAU_S: Final = 7.0
"""Time over which the correlation of a walk's positions falls to 1/e, s.

Positions with the correlation exp(-(dt / tau)^2) and standard deviation p have
velocities of standard deviation sqrt(2) p / tau. On Students03 the crowd's positions
and velocities give 9.8 s, and those within each walk 5.2 s.
"""
_PRIOR_STD = (100.0, 10.0)  # m around the first sample, and m/s: more than in any walk.
_MOST_COEFFICIENTS = 10_000  # Far more than any walk shows.
_LEAST_STD_M = 1e-3  # Below it, the shape of an error no longer matters.


@dataclass(frozen=True, slots=True)
class Qclm:
    """Add Laplace noise whose correlation is that of a walk (CTS-DP, QCLM).

    On either axis the noise is G1^2 + G2^2 - G3^2 - G4^2 of four Gaussian processes.
    The difference of two exponential variables has a Laplace law, and its correlation
    is the square of theirs.
    """

    std_m: float  # m, standard deviation of the added error, per axis.
    tau_s: float = WALK_TAU_S  # Its correlation is exp(-(dt / tau)^2).
    reuse: Reuse = "release"

    plain_name: ClassVar[str] = "correlated Laplace, {level} m"
    about: ClassVar[str] = "Laplace noise that changes as slowly as a walk, level in m."
    adding: ClassVar[Adding] = "independent"
    law: ClassVar[ErrorLaw] = "isotropic"
    protects: ClassVar[bool] = True
    errors_are_independent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_at_least("std_m", self.std_m, 0, " m")
        check_slow(self.tau_s, self.reuse)

    @property
    def epsilon_per_m(self) -> float:
        """Epsilon of a report on each axis, 1/m; inf without noise."""
        return math.sqrt(2.0) / self.std_m if self.std_m > 0 else math.inf

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the raw estimates with correlated Laplace noise on top."""
        paths = stationary_errors(
            t=sensed.t,
            offsets=sensed.offsets,
            walk=error_numbers(sensed, self.reuse, rng),
            shape=smooth_filter(math.sqrt(2.0) * self.tau_s),
            n_paths=8,
        )
        squares = np.square(paths).reshape(-1, 2, 4)
        # Four squares with signs have the variance 4 times 2.
        unit = squares @ np.array([1.0, 1.0, -1.0, -1.0]) / math.sqrt(8.0)
        return add_isotropic(sensed, self.std_m, rng, unit_error=unit)


@dataclass(frozen=True, slots=True)
class GpPrior:
    """Add Gaussian noise with the covariance of a Gaussian-process prior of walks.

    Of all Gaussian noise with this loss at every moment it has the least variance.
    """

    std_m: float  # m, standard deviation of the added error, per axis.
    tau_s: float = WALK_TAU_S  # Prior and noise have the correlation exp(-(dt/tau)^2).
    reuse: Reuse = "release"

    plain_name: ClassVar[str] = "noise like a walk, {level} m"
    about: ClassVar[str] = "Gaussian noise with the correlation of a walk, level in m."
    adding: ClassVar[Adding] = "independent"
    law: ClassVar[ErrorLaw] = "isotropic"
    protects: ClassVar[bool] = True
    errors_are_independent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_at_least("std_m", self.std_m, 0, " m")
        check_slow(self.tau_s, self.reuse)

    def loss(self, *, apart_m: float, order: float = 2.0) -> float:
        """Return the Renyi loss about two places of a person at any moment.

        They lie `apart_m` apart. It is order apart^2 / (2 std^2) of the whole release:
        as much as of a single report, since its neighbours add nothing. inf without
        noise.
        """
        return order * apart_m**2 / (2.0 * self.std_m**2) if self.std_m > 0 else np.inf

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the raw estimates with the prior's noise on top."""
        return add_stationary(
            sensed,
            self.std_m,
            rng,
            shape=smooth_filter(self.tau_s),
            reuse=self.reuse,
        )


@dataclass(frozen=True, slots=True)
class Fourier:
    """Add Laplace noise to the first Fourier coefficients of a walk (Pufferfish).

    A secret is the place at a moment. Its neighbours shift along with it by the
    correlation of walks, exp(-(dt / walk_tau)^2). The scales of the noise are those
    with the least variance for a promise (Lagrange).
    """

    std_m: float  # m, standard deviation of the added error, per axis.
    coefficients: int = 8  # Frequencies with noise besides 0.
    period_s: float = 60.0  # Period of the Fourier series, s: the error repeats.
    walk_tau_s: float = WALK_TAU_S
    reuse: Reuse = "release"

    plain_name: ClassVar[str] = "Fourier noise, {level} m"
    about: ClassVar[str] = (
        "Laplace noise in a walk's first Fourier coefficients, level in m."
    )
    adding: ClassVar[Adding] = "independent"
    law: ClassVar[ErrorLaw] = "isotropic"
    protects: ClassVar[bool] = True
    errors_are_independent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_at_least("std_m", self.std_m, 0, " m")
        check_at_least("coefficients", self.coefficients, 1)
        if self.coefficients > _MOST_COEFFICIENTS:
            raise ValueError(f"coefficients must be {_MOST_COEFFICIENTS} or fewer")
        positive("period_s", self.period_s)
        check_slow(self.walk_tau_s, self.reuse)

    @property
    def shift(self) -> Floats:
        """Coefficients of a secret's shift, relative to the first, (K + 1,)."""
        k = np.arange(self.coefficients + 1)
        fade = np.square(np.pi * k * self.walk_tau_s / self.period_s)
        return np.asarray(np.exp(-fade))

    @property
    def scale_m(self) -> Floats:
        """Laplace scale of each frequency's terms on one axis, (K + 1,) m.

        They are scale_k proportional to shift_k^(1/3). The variance of their sum, 2
        scale_0^2 + 4 sum_k scale_k^2, is std_m^2 at every instant (see `share`).
        """
        relative = np.cbrt(self.shift)
        variance = 2.0 * relative[0] ** 2 + 4.0 * np.sum(relative[1:] ** 2)
        return np.asarray(self.std_m * relative / np.sqrt(variance))

    @property
    def epsilon_per_m(self) -> float:
        """Epsilon of a whole walk for a shift along one axis, 1/m; inf without noise.

        Only the coefficients with noise count.
        """
        if self.std_m == 0.0:
            return math.inf
        weight = np.full(self.coefficients + 1, 2.0)
        weight[0] = 1.0
        mean = math.sqrt(math.pi) * self.walk_tau_s / self.period_s
        return float(mean * np.sum(weight * self.shift / self.scale_m))

    @property
    def tau_s(self) -> float:
        """Time over which the correlation of the error falls to 1/e, s."""
        lag_s = np.linspace(0.0, 0.5 * self.period_s, 2001)
        share = np.cbrt(self.shift) ** 2
        share[1:] *= 2.0
        turn = 2.0 * np.pi * np.outer(lag_s / self.period_s, np.arange(share.size))
        correlation = np.cos(turn) @ share / share.sum()
        below = correlation < math.exp(-1.0)
        return float(lag_s[np.argmax(below)] if below.any() else lag_s[-1])

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the raw estimates with noise in their first Fourier coefficients.

        An axis gets z_0 + sum_k sqrt(2) (z_k cos + z'_k sin), z Laplace variables of
        `scale_m`.
        """
        unit = np.empty_like(sensed.xy)
        k = np.arange(1, self.coefficients + 1)
        scale = np.concatenate([self.scale_m, self.scale_m[1:]])
        scale = scale / self.std_m if self.std_m else np.zeros_like(scale)
        amplitude = np.append(1.0, np.full(2 * k.size, math.sqrt(2.0)))
        numbers = error_numbers(sensed, self.reuse, rng)
        for track, number in enumerate(numbers.tolist()):
            own = slice(sensed.offsets[track], sensed.offsets[track + 1])
            turn = 2.0 * np.pi * np.outer(sensed.t[own] / self.period_s, k)
            basis = np.hstack([np.ones((len(turn), 1)), np.cos(turn), np.sin(turn)])
            draws = stream(0, "fourier errors", number).laplace(size=(scale.size, 2))
            unit[own] = basis @ ((amplitude * scale)[:, None] * draws)
        return add_isotropic(sensed, self.std_m, rng, unit_error=unit)


INFORMATION_AREA: Final = 1.748038369528081
"""Integral of 2 / (1 + sqrt(1 + 4 x^4)) over x > 0: 2/3 of the lemniscate constant."""
_INFORMATION_LAG: Final = 1.027456906784
"""Lag, in corner times, at which the correlation of that spectrum is 1/e."""
_CORNERS_OF_FILTER = 30.0  # Corner times on either side: exp(-15) of the peak is left.
_LONGEST_STEP_S = 0.04  # Half the usual interval of sensing.


@dataclass(frozen=True, slots=True)
class LeastInformation:
    """Add the stationary Gaussian noise with the least information about a walk.

    The walk has white acceleration of spectral density q. Of all noise of this
    variance it has the least mutual information per second between walk and release.
    """

    std_m: float  # m, standard deviation of the added error, per axis.
    q: float = Q_M2_PER_S3  # m^2/s^3
    reuse: Reuse = "release"

    plain_name: ClassVar[str] = "least informative, {level} m"
    about: ClassVar[str] = (
        "Noise that tells least about a walk for its size (mutual information), in m."
    )
    adding: ClassVar[Adding] = "independent"
    law: ClassVar[ErrorLaw] = "isotropic"
    protects: ClassVar[bool] = True
    errors_are_independent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_at_least("std_m", self.std_m, 0, " m")
        positive("q", self.q)
        check_slow(self.tau_s, self.reuse)

    @property
    def corner_per_s(self) -> float:
        """Angular frequency above which the noise falls, (q / level)^(1/4) in rad/s."""
        std_m = max(self.std_m, _LEAST_STD_M)
        return float(np.cbrt(self.q * INFORMATION_AREA / (math.pi * std_m**2)))

    @property
    def tau_s(self) -> float:
        """Time over which the correlation of the error falls to 1/e, s."""
        return _INFORMATION_LAG / self.corner_per_s

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the raw estimates with the least informative noise on top."""
        return add_stationary(
            sensed,
            self.std_m,
            rng,
            shape=_information_filter(self.corner_per_s),
            reuse=self.reuse,
        )


# The filters of the last few levels, for the process: a level is shared block by block.
@lru_cache(maxsize=8)
def _information_filter(corner_per_s: float) -> Filter:
    """Return the filter of the spectrum 2 / (1 + sqrt(1 + 4 (w / corner)^4))."""
    step_s = min(0.02 / corner_per_s, _LONGEST_STEP_S)
    half = int(_CORNERS_OF_FILTER / (corner_per_s * step_s))
    frequency = 2.0 * np.pi * np.fft.rfftfreq(4 * half, step_s)
    density = 2.0 / (1.0 + np.sqrt(1.0 + 4.0 * (frequency / corner_per_s) ** 4))
    # The square root of a spectrum is that of its symmetric filter.
    response = np.fft.irfft(np.sqrt(density))
    weight = np.concatenate([response[-half:], response[: half + 1]])
    return Filter(step_s, weight / np.sqrt(np.sum(weight**2)))


@dataclass(frozen=True, slots=True)
class Remap:
    """Move planar Laplace reports to where a person most likely is (remapping).

    The prior of a report is what a constant-velocity filter predicts from the reports
    before it; its q is that of other people. The position that is shared has the least
    expected squared error of all linear remaps of round errors. It follows from the
    reports alone, and so keeps their promise. It declares the error of the reports.
    """

    std_m: float  # m, standard deviation of a report's Laplace noise, per axis.
    q: float = Q_M2_PER_S3  # m^2/s^3, spectral density of the acceleration.

    plain_name: ClassVar[str] = "remapped Laplace, {level} m"
    about: ClassVar[str] = (
        "Planar Laplace noise, then the likeliest position given the reports before."
    )
    adding: ClassVar[Adding] = "independent"
    law: ClassVar[ErrorLaw] = "isotropic"
    protects: ClassVar[bool] = True
    errors_are_independent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_at_least("std_m", self.std_m, 0, " m")
        positive("q", self.q)

    @property
    def epsilon_per_m(self) -> float:
        """Epsilon of geo-indistinguishability per report, 1/m, as of `laplace`."""
        return Laplace(self.std_m).epsilon_per_m

    @property
    def tau_s(self) -> float:
        """Memory of the filter in steady state, (std^2 dt / q)^(1/4) in s."""
        std_m = max(self.std_m, _LEAST_STD_M)
        return float((std_m**2 * INTERVAL_S / self.q) ** 0.25)

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the reports, each moved by the prior of those before it."""
        reports = Laplace(self.std_m).share(sensed, rng)
        raw_m2 = axis_variance(sigma_m=sensed.sigma_raw, law=sensed.law)
        variance = self.std_m**2 + raw_m2
        batch = Batch(
            reports.t,
            reports.xy,
            np.maximum(variance, np.finfo(float).tiny),
            reports.offsets,
            _PRIOR_STD,
        )
        remapped = filter_tracks(batch, SlowError(0.0, 0.0), q=self.q).causal_xy
        return derived(reports, xy=remapped)


MECHANISMS: Final[Mapping[str, type]] = {
    "qclm": Qclm,
    "gp_prior": GpPrior,
    "fourier": Fourier,
    "least_information": LeastInformation,
    "remap": Remap,
}
"""By the name in a SPEC."""
