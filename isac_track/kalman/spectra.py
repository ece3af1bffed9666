"""How well stationary Gaussian noise hides a walk, and what it costs a robot.

The walk has constant velocity but for white acceleration of spectral density q, on
either axis. A release adds Gaussian noise of any spectrum to sensed positions. Both
errors here are of the best estimate, by an adversary or a robot that knows all laws:

- *floor*: of a position, by a smoother of several releases with fresh noise and one
  known position at a random instant (`smoothed_rms_m`);
- *price*: of the position after a horizon, by the robot (`predicted_rms_m`).

Both grow with the noise, and their squares are concave in its covariance. Derivations:
docs/explanation/shaped.md.

References
----------
Wiener smoother and steady state: van Trees, *Detection, Estimation and Modulation
Theory* I, 1968, ch. 6. Matern spectra: Rasmussen, Williams, *Gaussian Processes for
Machine Learning*, 2006, section 4.2.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.linalg import cho_factor, cho_solve, toeplitz
from scipy.optimize import brentq

from isac_track.kalman.steady import INTERVAL_S, Q_M2_PER_S3
from isac_track.types import Floats, positive

# rad/s: fine enough for a lag of a minute, and far beyond any walk.
_FREQUENCY = np.concatenate(
    [
        np.geomspace(1e-5, 1.0, 600)[:-1],
        np.arange(1.0, 10.0, 0.02),
        np.geomspace(10.0, 300.0, 150),
    ]
)
_ANCHOR_M2 = 1e-4  # Error variance per axis of a known position.
_PRIOR_STD = (100.0, 10.0)  # m and m/s: more than in any walk.
_N_LAGS = 61
_LEAST_M, _MOST_M = 1e-4, 1e4  # Noise per axis that is searched.


@dataclass(frozen=True, slots=True)
class World:
    """A walk, how it is sensed, and how it is attacked. ValueError if not positive."""

    q: float = Q_M2_PER_S3  # m^2/s^3
    raw_m: float = 0.5  # Standard deviation of the sensing error per axis, white.
    dt_s: float = INTERVAL_S
    horizon_s: float = 3.0
    seen_s: float = 30.0  # Time in view before the robot predicts.
    releases: int = 4  # Releases of a walk that the adversary has.
    step_s: float = 0.2  # Samples are averaged over this step for the robot.

    def __post_init__(self) -> None:
        for name in ("q", "raw_m", "dt_s", "horizon_s", "seen_s", "step_s"):
            positive(name, getattr(self, name))
        if self.releases < 1:
            raise ValueError(f"releases must be 1 or more, got {self.releases}")


WORLD = World()
SMOOTH_ORDER = 50.0
"""Order of a Matern density that is Gaussian within 1 %."""


def frequencies() -> Floats:
    """Return the angular frequencies at which spectra are given, (F,) rad/s."""
    return _FREQUENCY


def matern_density(*, std_m: float, theta_s: float, order: float) -> Floats:
    """Return a Matern spectral density at `frequencies`, (F,) m^2 s.

    It is proportional to (1 + (w theta)^2 / order)^-order, and its integral over all
    frequencies, divided by 2 pi, is std_m^2. Order 1 is an Ornstein-Uhlenbeck process
    of correlation time theta; in the limit of high orders the density is Gaussian. The
    order is above 1/2.
    """
    power = np.square(_FREQUENCY * theta_s) / order
    shape = np.exp(-order * np.log1p(power))
    ratio = math.exp(math.lgamma(order) - math.lgamma(order - 0.5))
    # The integral of (1 + u^2)^-n is sqrt(pi) Gamma(n - 1/2) / Gamma(n).
    peak = 2.0 * math.sqrt(math.pi / order) * theta_s * ratio
    return np.asarray(std_m**2 * peak * shape)


def smoothed_rms_m(
    density: Floats, *, world: World = WORLD, releases: int | None = None
) -> tuple[float, float]:
    """Return the rms error per axis of a smoothed position: without and with an anchor.

    `density`, (F,) m^2 s, is that of the noise in each release; by default there are
    the releases of the `world`. An anchor is a known position. It lies at a random
    instant of a walk in view for `seen_s`, and the mean is over all positions. The
    smoother knows the endless past and future.
    """
    plain, anchored = _smoothed_m2(density, world, releases)
    return math.sqrt(plain), math.sqrt(_mean_over_lags(anchored, world))


def known_shares(
    density: Floats,
    *,
    epsilon_m: float,
    world: World = WORLD,
    releases: int | None = None,
) -> tuple[float, float]:
    """Return the expected PLR of that smoother, 0..1: without and with an anchor.

    Its errors are Gaussian; a position counts as known within `epsilon_m`. Otherwise as
    `smoothed_rms_m`.
    """
    plain, anchored = _smoothed_m2(density, world, releases)
    shares = -np.expm1(-(epsilon_m**2) / (2.0 * np.append(plain, anchored)))
    return float(shares[0]), _mean_over_lags(shares[1:], world)


def _smoothed_m2(
    density: Floats, world: World, releases: int | None
) -> tuple[float, Floats]:
    """Return a smoothed position's variance per axis, m^2: without an anchor, and (L,).

    The anchor lies at each lag from 0 to the time in view.
    """
    n = world.releases if releases is None else releases
    walk = world.q / _FREQUENCY**4
    noise = (density + world.raw_m**2 * world.dt_s) / n
    covariance = _lag_covariance(walk * noise / (walk + noise), world.seen_s)
    known = np.square(covariance) / (covariance[0] + _ANCHOR_M2)
    return float(covariance[0]), covariance[0] - known


def _mean_over_lags(values: Floats, world: World) -> float:
    """Return the mean of values at lags, (L,), over positions and a random anchor."""
    lag_s = np.linspace(0.0, world.seen_s, _N_LAGS)
    chance = 2.0 * (world.seen_s - lag_s) / world.seen_s**2
    return float(np.trapezoid(chance * values, lag_s))


def floor_m(density: Floats, *, world: World = WORLD) -> float:
    """Return the rms error that the adversary with releases and an anchor keeps, m."""
    return smoothed_rms_m(density, world=world)[1]


def predicted_rms_m(density: Floats, *, world: World = WORLD) -> float:
    """Return the robot's rms error per axis after the horizon, m.

    The robot has a release of the last `seen_s`. Its samples are averaged over
    `step_s`, which leaves the spectral density of the sensing error as it is.
    """
    n_steps = round(world.seen_s / world.step_s) + 1
    lags = _lag_covariance(density, world.seen_s, n_steps)
    white = world.raw_m**2 * world.dt_s / world.step_s
    walk = _walk_covariance(world, n_steps)
    seen = walk.past + toeplitz(lags) + white * np.eye(n_steps)
    solved = cho_solve(cho_factor(seen), walk.with_future)
    return math.sqrt(walk.future - float(walk.with_future @ solved))


def scaled_to(density: Floats, *, floor: float, world: World = WORLD) -> Floats:
    """Return the density times the number with which the adversary keeps a floor, m.

    ValueError if no noise of this shape does.
    """
    unit = density / _lag_covariance(density, 1.0, 1)[0]

    def excess(log_std: float) -> float:
        return floor_m(math.exp(2.0 * log_std) * unit, world=world) - floor

    low, high = math.log(_LEAST_M), math.log(_MOST_M)
    if excess(low) > 0.0 or excess(high) < 0.0:
        raise ValueError(f"no noise of this shape keeps a floor of {floor:g} m")
    log_std = float(brentq(excess, low, high, xtol=1e-10))
    return np.asarray(math.exp(2.0 * log_std) * unit)


def std_of_density(density: Floats) -> float:
    """Return the standard deviation of a process of spectral density `density`."""
    return float(np.sqrt(_lag_covariance(density, 1.0, 1)[0]))


def _lag_covariance(density: Floats, longest_s: float, n: int = _N_LAGS) -> Floats:
    """Return the covariance at `n` lags from 0 to `longest_s`, (n,)."""
    return np.asarray(_cosines(longest_s, n) @ density)


# The integrals of a few grids of lags, for the process.
@cache
def _cosines(longest_s: float, n: int) -> Floats:
    """Return the integration weights of cos(w lag) / pi at `frequencies`, (n, F)."""
    width = np.zeros_like(_FREQUENCY)
    step = np.diff(_FREQUENCY)
    width[:-1] += 0.5 * step
    width[1:] += 0.5 * step
    lag_s = np.linspace(0.0, longest_s, n)
    return np.asarray(np.cos(np.outer(lag_s, _FREQUENCY)) * width / np.pi)


@dataclass(frozen=True, eq=False, slots=True)
class _WalkCovariance:
    """Prior covariance of a walk's positions, m^2 per axis."""

    past: Floats  # (n, n), at n instants
    with_future: Floats  # (n,), between these and the future instant
    future: float  # At the future instant.


# Covariances of a few worlds, for the process.
@cache
def _walk_covariance(world: World, n_steps: int) -> _WalkCovariance:
    """Return the covariance at `n_steps` seen instants and the future instant."""
    t = np.append(
        np.linspace(0.0, world.seen_s, n_steps), world.seen_s + world.horizon_s
    )
    early, late = np.minimum(t[:, None], t), np.maximum(t[:, None], t)
    covariance = _PRIOR_STD[0] ** 2 + _PRIOR_STD[1] ** 2 * np.outer(t, t)
    covariance += world.q * early**2 * (3.0 * late - early) / 6.0
    return _WalkCovariance(
        covariance[:-1, :-1], covariance[:-1, -1], float(covariance[-1, -1])
    )
