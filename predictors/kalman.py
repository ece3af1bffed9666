"""Trackers for the robot: constant velocity, constant acceleration, and both moods of a walk.

`kalman_cv`, `kalman_ca` and `kalman_imm` filter the most recent shared samples with irregular
steps and predict the whole horizon with a covariance. The measurement noise is estimated from the
innovations, since a robot is not told how accurate a sample is, or taken as declared.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from isac_track.kalman import imm_last, kalman_last
from isac_track.noise import innovation_variance_m2
from isac_track.types import ErrorLaw, Knowledge, Prediction
from predictors.recent import Recent, recent

if TYPE_CHECKING:
    from isac_track.types import Floats, Release

GATE = 18.4
"""Chi-square quantile of 0.9999 with two degrees of freedom."""
WINDOW = 160
"""Samples; what came before no longer moves the prediction (tested)."""
_PRIOR_STD = (100.0, 10.0, 10.0)
"""m around the first sample, m/s, m/s^2: far more than any walk, so that nothing is tuned."""

Noise = Literal["estimated", "declared"]
Engine = Literal["kernels", "filterpy"]


@dataclass(frozen=True, slots=True)
class KalmanCV:
    """Constant velocity, white-noise acceleration."""

    q: float = 0.04
    """m^2/s^3, from ``python -m benchmarks.tune``"""
    gate: float = GATE
    window: int = WINDOW
    noise: Noise = "estimated"
    law: ErrorLaw = "radial"
    """With declared noise: a radial error of std sigma has the variance sigma^2 / 2 per axis."""
    engine: Engine = "kernels"

    model: ClassVar[Literal["cv", "ca"]] = "cv"
    states: ClassVar[int] = 2

    def __post_init__(self) -> None:
        _check(q=self.q, gate=self.gate, window=self.window)

    @property
    def requires(self) -> frozenset[Knowledge]:
        """SIGMA if the noise is taken as declared."""
        return _requires(self.noise)

    def predict(self, release: Release, t_future: Floats) -> Prediction:
        """Return mean and covariance at `t_future`, (N, H) s."""
        arguments = filter_arguments(recent(release, window=self.window), self)
        if self.engine == "filterpy":
            from predictors import filterpy_engine  # noqa: PLC0415 - only where it runs

            mean, cov = filterpy_engine.last_states(**arguments)
        else:
            last = kalman_last(model=self.model, **arguments)
            mean, cov = last.mean, last.cov
        return _ahead(mean, cov, q=self.q, elapsed_s=_elapsed(release, t_future))

    def log_likelihood(self, release: Release) -> Floats:
        """Return the log density of what was shared, (N,), over the window."""
        arguments = filter_arguments(recent(release, window=self.window), self)
        return kalman_last(model=self.model, **arguments).log_likelihood


@dataclass(frozen=True, slots=True)
class KalmanCA(KalmanCV):
    """Constant acceleration, white-noise jerk: `KalmanCV` with one more state per axis."""

    q: float = 0.026
    """m^2/s^5, from ``python -m benchmarks.tune``"""

    model: ClassVar[Literal["cv", "ca"]] = "ca"
    states: ClassVar[int] = 3


@dataclass(frozen=True, slots=True)
class KalmanIMM:
    """Two interacting models: walking on, and stopping or turning."""

    q: float = 0.001
    """m^2/s^3 while walking on, from ``python -m benchmarks.tune``"""
    q_turn: float = 0.12
    """m^2/s^3 while stopping or turning, likewise"""
    walk_s: float = 4.0
    """Mean time of walking on; set, not tuned: the likelihood would make modes of whole tracks"""
    turn_s: float = 1.5
    """Mean time of stopping or turning; set, not tuned"""
    gate: float = GATE
    window: int = WINDOW
    noise: Noise = "estimated"
    law: ErrorLaw = "radial"
    engine: Engine = "kernels"

    def __post_init__(self) -> None:
        _check(q=self.q, gate=self.gate, window=self.window)
        if not (self.q_turn > 0 and self.walk_s > 0 and self.turn_s > 0):
            raise ValueError("q_turn, walk_s and turn_s must be positive")

    @property
    def requires(self) -> frozenset[Knowledge]:
        """SIGMA if the noise is taken as declared."""
        return _requires(self.noise)

    def predict(self, release: Release, t_future: Floats) -> Prediction:
        """Return mean and covariance at `t_future`, (N, H) s.

        Every mode is carried on by itself and the forecasts are mixed: within the horizon of
        a second the walk keeps its mood.
        """
        seen = recent(release, window=self.window)
        mean, cov, probability = self._modes(seen)
        elapsed_s = _elapsed(release, t_future)
        ahead = [
            _ahead_planar(mean[:, mode], cov[:, mode], q=q, elapsed_s=elapsed_s)
            for mode, q in enumerate((self.q, self.q_turn))
        ]
        weights = probability.T[:, :, None, None]
        mixed: Floats = sum(w * m for w, (m, _) in zip(weights, ahead, strict=True))
        spread = np.zeros((*mixed.shape, 2))
        for w, (m, c) in zip(weights[..., None], ahead, strict=True):
            gap = m - mixed
            spread += w * (c + gap[..., :, None] * gap[..., None, :])
        return Prediction(mixed, spread)

    def log_likelihood(self, release: Release) -> Floats:
        """Return the log density of what was shared, (N,), over the window."""
        return imm_last(**self._arguments(recent(release, window=self.window))).log_likelihood

    def _modes(self, seen: Recent) -> tuple[Floats, Floats, Floats]:
        arguments = self._arguments(seen)
        if self.engine == "filterpy":
            from predictors import filterpy_engine  # noqa: PLC0415 - only where it runs

            return filterpy_engine.last_modes(**arguments)
        last = imm_last(**arguments)
        return last.mean, last.cov, last.probability

    def _arguments(self, seen: Recent) -> dict[str, Any]:
        initial_mean, initial_cov = _prior(seen, d=2)
        leave, come = 1.0 / self.walk_s, 1.0 / self.turn_s
        share = np.array([self.walk_s, self.turn_s]) / (self.walk_s + self.turn_s)
        return {
            "t": seen.t,
            "xy": seen.xy,
            "variance": _variance(seen, self),
            "offsets": seen.offsets,
            "q": np.array([self.q, self.q_turn]),
            "rates": np.array([[-leave, leave], [come, -come]]),
            "initial_mean": initial_mean,
            "initial_cov": initial_cov,
            "initial_probability": share,
            "gate": self.gate,
        }


def filter_arguments(seen: Recent, settings: KalmanCV) -> dict[str, Any]:
    """Return what the filter of a tracker is called with."""
    initial_mean, initial_cov = _prior(seen, d=settings.states)
    return {
        "t": seen.t,
        "xy": seen.xy,
        "variance": _variance(seen, settings),
        "offsets": seen.offsets,
        "q": settings.q,
        "initial_mean": initial_mean,
        "initial_cov": initial_cov,
        "gate": settings.gate,
    }


def _variance(seen: Recent, settings: KalmanCV | KalmanIMM) -> Floats:
    """Return the error variance per axis of every sample, (K,) m^2."""
    if settings.noise == "declared":
        assert seen.sigma is not None  # the release was granted with it
        return np.maximum(seen.sigma**2 * (0.5 if settings.law == "radial" else 1.0), 1e-12)
    sizes = np.diff(seen.offsets)
    level = innovation_variance_m2(t=seen.t, xy=seen.xy, offsets=seen.offsets)
    return np.repeat(level, sizes)


def _prior(seen: Recent, *, d: int) -> tuple[Floats, Floats]:
    """Return (N, 2, d) and (N, d, d): at rest at the first sample, and hardly sure of it."""
    n_tracks = seen.offsets.size - 1
    mean = np.zeros((n_tracks, 2, d))
    mean[:, :, 0] = seen.xy[seen.offsets[:-1]]
    cov = np.diag(_PRIOR_STD[:d]) ** 2
    return mean, np.broadcast_to(cov, (n_tracks, d, d))


def _elapsed(release: Release, t_future: Floats) -> Floats:
    elapsed: Floats = t_future - release.t[release.offsets[1:] - 1][:, None]
    return elapsed


def _ahead(mean: Floats, cov: Floats, *, q: float, elapsed_s: Floats) -> Prediction:
    """Return the forecast of a model with one covariance for both axes.

    Parameters
    ----------
    mean : (N, 2, d)
    cov : (N, d, d)
    q : float
    elapsed_s : (N, H) s
    """
    d = mean.shape[2]
    # Taylor terms of the motion: position after tau is sum_k tau^k / k! times derivative k.
    factorial = np.array([1.0, 1.0, 2.0])[:d]
    h = elapsed_s[..., None] ** np.arange(d) / factorial  # (N, H, d)
    position = np.einsum("nhd,nad->nha", h, mean)
    # White noise on derivative d: its (d - 1)-fold integral has the variance below.
    grown = q * elapsed_s ** (2 * d - 1) / (3.0 if d == 2 else 20.0)  # noqa: PLR2004
    variance = np.einsum("nhd,nde,nhe->nh", h, cov, h) + grown
    return Prediction(position, variance[..., None, None] * np.eye(2))


def _ahead_planar(
    mean: Floats, cov: Floats, *, q: float, elapsed_s: Floats
) -> tuple[Floats, Floats]:
    """Return (N, H, 2) and (N, H, 2, 2) of a constant-velocity model with coupled axes.

    Parameters
    ----------
    mean : (N, 2, 2)
        (position, velocity) per axis
    cov : (N, 4, 4)
        Of (x, vx, y, vy).
    q : float
    elapsed_s : (N, H) s
    """
    tau = elapsed_s[..., None]
    position = mean[:, None, :, 0] + tau * mean[:, None, :, 1]
    tau = tau[..., None]
    place = cov[:, None, 0::2, 0::2]
    speed = cov[:, None, 1::2, 1::2]
    cross = cov[:, None, 0::2, 1::2]
    spread = (
        place
        + tau * (cross + np.swapaxes(cross, -2, -1))
        + tau**2 * speed
        + q * tau**3 / 3.0 * np.eye(2)
    )
    return position, spread


def _requires(noise: Noise) -> frozenset[Knowledge]:
    return frozenset({Knowledge.SIGMA}) if noise == "declared" else frozenset()


def _check(*, q: float, gate: float, window: int) -> None:
    if not (np.isfinite(q) and q > 0):
        raise ValueError(f"q must be positive, got {q}")
    if not gate > 0:
        raise ValueError(f"gate must be positive, got {gate}")
    if window < 2:  # noqa: PLR2004 - a velocity needs two samples
        raise ValueError(f"window must be at least 2 samples, got {window}")
