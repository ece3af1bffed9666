"""Trackers for the robot: constant velocity, constant acceleration, and both moods of a walk.

`kalman_cv`, `kalman_ca` and `kalman_imm` filter the most recent shared samples with irregular
steps and predict the whole horizon with a covariance. The measurement noise is estimated from the
innovations, since a robot is not told how accurate a sample is, or taken as declared.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from isac_track.kalman import Batch, Moods, imm_last, kalman_last
from isac_track.noise import innovation_variance_m2
from isac_track.types import ErrorLaw, Floats, Knowledge, Prediction, Release, end_to_end

GATE = 18.4  # Chi-square quantile of 0.9999 with two degrees of freedom.
WINDOW = 160  # Samples; what came before no longer moves the prediction (tested).
_PRIOR_STD = (100.0, 10.0, 10.0)
"""m around the first sample, m/s, m/s^2: far more than any walk, so that nothing is tuned."""


@dataclass(frozen=True, slots=True)
class KalmanCV:
    """Constant velocity, white-noise acceleration."""

    q: float = 0.04  # m^2/s^3, from ``python -m benchmarks.tune``
    gate: float = GATE
    window: int = WINDOW
    noise: Literal["estimated", "declared"] = "estimated"
    law: ErrorLaw = "radial"
    """With declared noise: a radial error of std sigma has the variance sigma^2 / 2 per axis."""
    engine: Literal["kernels", "filterpy"] = "kernels"

    states: ClassVar[int] = 2

    def __post_init__(self) -> None:
        if not (np.isfinite(self.q) and self.q > 0):
            raise ValueError(f"q must be positive, got {self.q}")
        if not self.gate > 0:
            raise ValueError(f"gate must be positive, got {self.gate}")
        if self.window < 2:  # noqa: PLR2004 - a velocity needs two samples
            raise ValueError(f"window must be at least 2 samples, got {self.window}")

    @property
    def requires(self) -> frozenset[Knowledge]:
        """SIGMA if the noise is taken as declared."""
        return frozenset({Knowledge.SIGMA}) if self.noise == "declared" else frozenset()

    def predict(self, release: Release, t_future: Floats) -> Prediction:
        """Return mean and covariance at `t_future`, (N, H) s."""
        batch = self.batch(release)
        if self.engine == "filterpy":
            from predictors import filterpy_engine  # noqa: PLC0415 - only where it runs

            mean, cov = filterpy_engine.last_states(batch, q=self.q, gate=self.gate)
        else:
            last = kalman_last(batch, q=self.q, gate=self.gate)
            mean, cov = last.mean, last.cov
        planar = np.einsum("ab,nde->nadbe", np.eye(2), cov)
        elapsed_s = t_future - release.t[release.offsets[1:] - 1, None]
        return Prediction(*_ahead(mean, planar, q=np.array(self.q), elapsed_s=elapsed_s))

    def log_likelihood(self, release: Release) -> Floats:
        """Return the log density of what was shared, (N,), over the window."""
        return kalman_last(self.batch(release), q=self.q, gate=self.gate).log_likelihood

    def batch(self, release: Release) -> Batch:
        """Return the last `window` samples of every track, or all that it has, for the filters.

        The clock of each track is 0 at its last sample, so that late clocks lose no precision.
        """
        last = release.offsets[1:]
        sizes = np.minimum(np.diff(release.offsets), self.window)
        runs = list(zip((last - sizes).tolist(), last.tolist(), strict=True))
        offsets = np.concatenate([[0], np.cumsum(sizes)])
        t = end_to_end(release.t, runs) - np.repeat(release.t[last - 1], sizes)
        xy = end_to_end(release.xy, runs)
        if self.noise == "declared":
            assert release.sigma is not None  # the release was granted with it
            share = 0.5 if self.law == "radial" else 1.0
            variance = np.maximum(end_to_end(release.sigma, runs) ** 2 * share, 1e-12)
        else:
            variance = np.repeat(innovation_variance_m2(t=t, xy=xy, offsets=offsets), sizes)
        return Batch(t, xy, variance, offsets, _PRIOR_STD[: self.states])


@dataclass(frozen=True, slots=True)
class KalmanCA(KalmanCV):
    """Constant acceleration, white-noise jerk: `KalmanCV` with one more state per axis."""

    q: float = 0.026  # m^2/s^5, from ``python -m benchmarks.tune``

    states: ClassVar[int] = 3


@dataclass(frozen=True, slots=True)
class KalmanIMM(KalmanCV):
    """Two interacting models: walking on, and stopping or turning."""

    q: float = 0.001  # m^2/s^3 while walking on, from ``python -m benchmarks.tune``
    q_turn: float = 0.12  # m^2/s^3 while stopping or turning, likewise
    walk_s: float = 4.0
    """Mean time of walking on; set, not tuned: the likelihood would make modes of whole tracks"""
    turn_s: float = 1.5  # Mean time of stopping or turning; set, not tuned

    def __post_init__(self) -> None:
        KalmanCV.__post_init__(self)
        if not (self.q_turn > 0 and self.walk_s > 0 and self.turn_s > 0):
            raise ValueError("q_turn, walk_s and turn_s must be positive")

    @property
    def moods(self) -> Moods:
        """The two models."""
        return Moods((self.q, self.q_turn), (self.walk_s, self.turn_s))

    def predict(self, release: Release, t_future: Floats) -> Prediction:
        """Return mean and covariance at `t_future`, (N, H) s.

        Every mode is carried on by itself and the forecasts are mixed: within the horizon of
        a second the walk keeps its mood.
        """
        batch = self.batch(release)
        if self.engine == "filterpy":
            from predictors import filterpy_engine  # noqa: PLC0415 - only where it runs

            mean, cov, probability = filterpy_engine.last_modes(batch, self.moods, gate=self.gate)
        else:
            last = imm_last(batch, self.moods, gate=self.gate)
            mean, cov, probability = last.mean, last.cov, last.probability
        mean, cov = _ahead(
            mean,
            cov.reshape(*cov.shape[:2], 2, 2, 2, 2),
            q=np.array(self.moods.q)[:, None],
            elapsed_s=(t_future - release.t[release.offsets[1:] - 1, None])[:, None],
        )
        mixed = np.einsum("nj,njha->nha", probability, mean)
        gap = mean - mixed[:, None]
        spread = cov + gap[..., :, None] * gap[..., None, :]
        return Prediction(mixed, np.einsum("nj,njhab->nhab", probability, spread))

    def log_likelihood(self, release: Release) -> Floats:
        """Return the log density of what was shared, (N,), over the window."""
        return imm_last(self.batch(release), self.moods, gate=self.gate).log_likelihood


def _ahead(mean: Floats, cov: Floats, *, q: Floats, elapsed_s: Floats) -> tuple[Floats, Floats]:
    """Return the forecasts, (..., H), of states (..., 2, d) with covariance (..., 2, d, 2, d)."""
    d = mean.shape[-1]
    # Taylor terms of the motion: position after tau is sum_k tau^k / k! times derivative k.
    factorial, tau = np.array([1.0, 1.0, 2.0])[:d], elapsed_s[..., None]
    terms = mean / factorial
    position = terms[..., None, :, d - 1]
    for k in reversed(range(d - 1)):
        position = terms[..., None, :, k] + tau * position
    both, tau = cov / (factorial[:, None, None] * factorial), tau[..., None]
    spread = np.zeros(())
    for power in reversed(range(2 * d - 1)):
        pairs = range(max(power - d + 1, 0), min(power, d - 1) + 1)
        spread = tau * spread + sum(both[..., None, :, k, :, power - k] for k in pairs)
    # White noise on derivative d: its (d - 1)-fold integral has the variance below.
    grown = q * elapsed_s ** (2 * d - 1) / (3.0 if d == 2 else 20.0)  # noqa: PLR2004 - states an axis
    return position, spread + grown[..., None, None] * np.eye(2)
