"""Mechanisms that should withstand smoothing, and white noise for comparison.

Smoothing removes most white noise. `ou` adds an error that lasts for seconds, which
neither a smoother nor the robot's filter averages away; `ou_fid` adds it where the
Fisher information density is high. Derivations: docs/explanation/mechanisms.md.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final, NamedTuple

import numpy as np
from numpy.random import Generator

from isac_track.kalman import Batch, kalman_last, planar_last
from isac_track.measurement import (
    axis_share,
    axis_variance,
    error_ellipses,
    mean_variance,
    scalar_covariance,
)
from isac_track.mechanisms.error_paths import (
    Reuse,
    check_slow,
    correlated_errors,
    session_errors,
)
from isac_track.mechanisms.paper import Fid, fid_d_sigma
from isac_track.mechanisms.perturb import add_isotropic, draw_pseudonyms
from isac_track.types import (
    Adding,
    ErrorLaw,
    Floats,
    Ints,
    Release,
    Sensed,
    check_at_least,
    positive,
    stretches,
)

# m around the first sample, and m/s: far more than any walk; not tuned.
_PRIOR_STD = (100.0, 10.0)
_MEMORY_S = 6.0  # Samples older than this no longer change a filter's estimate.


def _with_slow_error(
    sensed: Sensed, std_m: Floats | float, mechanism: "Ou | OuFid", rng: Generator
) -> Release:
    """Return the raw estimates with a slow error.

    Both kinds of reuse make the same draws from `rng`, so that what follows in its
    stream does not depend on the kind.
    """
    t, offsets, tau_s = sensed.t, sensed.offsets, mechanism.tau_s
    unit = correlated_errors(
        t=t, offsets=offsets, law="isotropic", tau_s=tau_s, rng=rng
    )
    if mechanism.reuse == "session":
        unit = session_errors(t=t, offsets=offsets, walk=sensed.walk, tau_s=tau_s)
    return add_isotropic(sensed, std_m, rng, unit_error=unit)


@dataclass(frozen=True, slots=True)
class Ou:
    """Add an error that changes slowly: an Ornstein-Uhlenbeck process per axis."""

    std_m: float  # m, stationary standard deviation of the added error, per axis.
    tau_s: float = 5.0  # Time over which its correlation falls to 1/e, s.
    reuse: Reuse = "release"
    """`session`: all releases of a walk in a session have the same error at an instant.

    Averaging releases then gains nothing, but their shared error makes them similar.
    """

    plain_name: ClassVar[str] = "slow noise, {level} m"
    about: ClassVar[str] = (
        "Noise that changes slowly, over some seconds (tau_s), level in m."
    )
    adding: ClassVar[Adding] = "independent"
    law: ClassVar[ErrorLaw] = "isotropic"
    protects: ClassVar[bool] = True
    errors_are_independent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_at_least("std_m", self.std_m, 0, " m")
        check_slow(self.tau_s, self.reuse)

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the raw estimates with the slow error on top."""
        return _with_slow_error(sensed, self.std_m, self, rng)


@dataclass(frozen=True, slots=True)
class OuFid:
    """Add the slow error of `ou`, scaled by the FID rule."""

    eta: float  # 1/(m^2 s)
    alpha: float = 0.5  # m
    beta: float = 1.5
    tau_s: float = 5.0  # s
    reuse: Reuse = "release"

    plain_name: ClassVar[str] = "slow FID noise, eta {level}"
    about: ClassVar[str] = "Slow noise where the FID exceeds eta."
    sweep: ClassVar[str] = "log"
    adding: ClassVar[Adding] = "independent"
    law: ClassVar[ErrorLaw] = "isotropic"
    protects: ClassVar[bool] = True
    errors_are_independent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        Fid(self.eta, self.alpha, self.beta)  # Checks the values.
        check_slow(self.tau_s, self.reuse)

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

    std_m: float  # m, standard deviation of the added error, per axis.

    plain_name: ClassVar[str] = "Laplace noise, {level} m"
    about: ClassVar[str] = "Planar Laplace noise on every position, level in m."
    adding: ClassVar[Adding] = "independent"
    law: ClassVar[ErrorLaw] = "isotropic"
    protects: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_at_least("std_m", self.std_m, 0, " m")

    @property
    def epsilon_per_m(self) -> float:
        """Epsilon of geo-indistinguishability per report, 1/m; inf without noise."""
        return float(np.sqrt(3.0) / self.std_m) if self.std_m > 0 else float("inf")

    def epsilon_over(self, n_reports: int) -> float:
        """Return epsilon of a whole track, 1/m: the sum over its reports."""
        return n_reports * self.epsilon_per_m

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the raw estimates with planar Laplace noise on top."""
        turn = 2.0 * np.pi * rng.random(sensed.t.size)
        distance = rng.standard_gamma(2.0, sensed.t.size) / np.sqrt(3.0)
        unit = distance[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        return add_isotropic(sensed, self.std_m, rng, unit_error=unit)


class _Filtered(NamedTuple):
    """Filtered positions at the ends of N stretches of samples."""

    xy: Floats  # (N, 2) m
    cov: Floats  # (N, 2, 2) m^2


def _filter_positions(
    sensed: Sensed, sample: Ints, variance: Floats, offsets: Ints, *, q: float
) -> _Filtered:
    """Filter stretches of samples to their ends, with the shape of the raw error."""
    t, xy = sensed.t[sample], sensed.xy[sample]
    if sensed.cov is None:
        state = kalman_last(Batch(t, xy, variance, offsets, _PRIOR_STD), q=q)
        return _Filtered(state.mean[:, :, 0], scalar_covariance(state.cov[:, 0, 0]))
    ellipse = error_ellipses(sensed.cov[sample])
    planar = planar_last(Batch(t, xy, variance, offsets, _PRIOR_STD, ellipse), q=q)
    return _Filtered(planar.mean[:, :, 0], planar.cov[:, :, 0, :, 0])


@dataclass(frozen=True, slots=True)
class Forecast:
    """Share the network's filtered position at intervals, with white Gaussian noise.

    A sample is shared every `every_s`, counted back from the last. Its position is
    that of a constant-velocity filter of all samples up to it.
    """

    std_m: float  # m, standard deviation of the added error, per axis.
    every_s: float = 1.0  # s
    q: float = 0.057  # m^2/s^3, spectral density of the acceleration in the filter.

    plain_name: ClassVar[str] = "forecast noise, {level} m"
    about: ClassVar[str] = (
        "The network's own filtered position, once a second, with noise, level in m."
    )
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
        owner = np.repeat(np.arange(len(sensed)), np.diff(sensed.offsets))
        end_s = sensed.t[sensed.offsets[1:] - 1][owner]
        interval = np.floor((end_s - sensed.t) / self.every_s)
        is_last_of_interval = np.diff(interval, append=-1.0) != 0
        is_last_of_track = np.diff(owner, append=-1) != 0
        rows = np.flatnonzero(is_last_of_interval | is_last_of_track)
        # A filter for each shared sample: it reads the walk from its start, or from as
        # far back as matters. Complex numbers sort by track, then by time.
        order = owner + 1j * sensed.t
        first = np.searchsorted(order, owner[rows] + 1j * (sensed.t[rows] - _MEMORY_S))
        first = np.maximum(first, sensed.offsets[owner[rows]])
        sample, offsets = stretches(first, rows + 1 - first)
        raw_m2 = axis_variance(sigma_m=sensed.sigma_raw[sample], law=sensed.law)
        variance = np.maximum(raw_m2, np.finfo(float).tiny)
        filtered = _filter_positions(sensed, sample, variance, offsets, q=self.q)
        # As the raw error is declared: its standard deviation under the sensor's law.
        filtered_m2 = mean_variance(filtered.cov) / axis_share(sensed.law)
        cov = None
        if sensed.cov is not None:
            cov = filtered.cov + self.std_m**2 * np.eye(2)
        return Release(
            t=sensed.t[rows],
            xy=filtered.xy + self.std_m * white[rows],
            sigma=np.sqrt(filtered_m2 + self.std_m**2),
            cov=cov,
            offsets=np.append(
                0, np.cumsum(np.bincount(owner[rows], minlength=len(sensed)))
            ),
            pseudonym=draw_pseudonyms(len(sensed), rng),
        )


MECHANISMS: Final[Mapping[str, type]] = {
    "ou": Ou,
    "ou_fid": OuFid,
    "laplace": Laplace,
    "forecast": Forecast,
}
"""By the name in a SPEC."""
