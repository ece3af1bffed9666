"""Trackers for the robot: constant velocity, constant acceleration, and two modes.

They filter the most recent shared samples and predict the whole horizon with a
covariance. The noise is as declared, or estimated from the innovations, since a robot
usually does not know it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

import numpy as np

from isac_track.kalman import (
    Batch,
    LastState,
    Moods,
    PlanarState,
    imm_last,
    kalman_last,
    planar_last,
)
from isac_track.kalman.slow_errors import (
    LEAST_REST,
    SlowError,
    added_error,
    filter_tracks,
)
from isac_track.measurement import (
    axis_share,
    covariance_without,
    error_ellipses,
    mean_variance,
)
from isac_track.noise import MIN_VARIANCE_M2, innovation_variance_m2
from isac_track.types import (
    ErrorLaw,
    Floats,
    Ints,
    Knowledge,
    Prediction,
    Release,
    end_to_end,
    positive,
)

GATE = 18.4  # Chi-square quantile of 0.9999 with two degrees of freedom.
WINDOW = 160  # Samples; earlier samples no longer change the prediction (tested).
_LEAST_DECLARED_M2 = 1e-12
# m around the first sample, m/s, m/s^2: more than in any walk.
_PRIOR_STD = (100.0, 10.0, 10.0)


@dataclass(frozen=True, slots=True)
class KalmanCV:
    """Constant velocity, white-noise acceleration."""

    q: float = 0.04  # m^2/s^3, from ``python -m benchmarks.tune``
    gate: float = GATE
    window: int = WINDOW
    noise: Literal["estimated", "declared"] = "estimated"
    # Law of declared noise without a covariance: a radial error has the variance
    # sigma^2 / 2 per axis.
    law: ErrorLaw = "radial"
    engine: Literal["kernels", "filterpy"] = "kernels"
    aware: bool = False  # Whether `knowing` adapts it to the mechanism before a run.
    # Standard deviation per axis of the added error that the robot knows of, m.
    added_std_m: float = 0.0
    # Correlation time of that error, s; 0: white. With a slow error all history counts.
    tau_s: float = 0.0

    states: ClassVar[int] = 2

    def __post_init__(self) -> None:
        if type(self) is not KalmanCV and (
            self.aware or self.added_std_m or self.tau_s
        ):
            raise ValueError("only kalman_cv can be aware of a mechanism")
        SlowError(self.added_std_m, self.tau_s)
        positive("q", self.q)
        positive("gate", self.gate, finite=False)
        if self.window < 2:  # noqa: PLR2004 - a velocity needs two samples
            raise ValueError(f"window must be at least 2 samples, got {self.window}")

    @property
    def requires(self) -> frozenset[Knowledge]:
        """SIGMA if the noise is taken as declared."""
        return frozenset({Knowledge.SIGMA}) if self.noise == "declared" else frozenset()

    def predict(self, release: Release, t_future: Floats) -> Prediction:
        """Return mean and covariance at `t_future`, (N, H) s."""
        batch = self.batch(release)
        state = self._planar_state(batch)
        # Leave out the last state, the error: predict the true position.
        d = self.states
        mean, planar = state.mean[..., :d], state.cov[..., :d, :, :d]
        elapsed_s = t_future - release.t[release.offsets[1:] - 1, None]
        return Prediction(
            *_extrapolate(mean, planar, q=np.array(self.q), elapsed_s=elapsed_s)
        )

    def _planar_state(self, batch: Batch) -> PlanarState:
        """Return the last states with the covariances of both axes."""
        if self.engine == "filterpy":
            from predictors import filterpy_engine  # noqa: PLC0415 - only where it runs

            return filterpy_engine.planar_states(
                batch, q=self.q, gate=self.gate, error=self._slow_error
            )
        last = self._last(batch)
        if isinstance(last, PlanarState):
            return last
        # The axes are independent with the same covariance: (N, 2, d, 2, d).
        planar = np.einsum("ab,nde->nadbe", np.eye(2), last.cov)
        return PlanarState(last.mean, planar, last.log_likelihood)

    def knowing(self, mechanism: object) -> Self:
        """Return the predictor, adapted to a mechanism's error if it is `aware`."""
        if not self.aware:
            return self
        std_m, tau_s = added_error(mechanism)
        return replace(self, added_std_m=std_m, tau_s=tau_s)

    @property
    def _slow_error(self) -> SlowError | None:
        slow = self.added_std_m > 0.0 and self.tau_s > 0.0
        return SlowError(self.added_std_m, self.tau_s) if slow else None

    def log_likelihood(self, release: Release) -> Floats:
        """Return the log density of the shared positions in the window, (N,)."""
        return self._last(self.batch(release)).log_likelihood

    def _last(self, batch: Batch) -> LastState | PlanarState:
        error = self._slow_error
        if error is None and batch.ellipse is not None:
            return planar_last(batch, q=self.q, gate=self.gate)
        if error is None:
            return kalman_last(batch, q=self.q, gate=self.gate)
        return filter_tracks(batch, error, q=self.q, gate=self.gate).last

    @property
    def track(self) -> Callable[[Release], Floats] | None:
        """Function that returns the causal estimate of each sample, (M, 2) m.

        It uses the noise estimated by then, and the whole history. None for other
        models.
        """
        return self._track_samples if type(self) is KalmanCV else None

    def _track_samples(self, release: Release) -> Floats:
        error = self._slow_error or SlowError(0.0, 0.0)
        batch = self.batch(release, is_causal=True)
        return filter_tracks(batch, error, q=self.q, gate=self.gate).causal_xy

    def batch(self, release: Release, *, is_causal: bool = False) -> Batch:
        """Return the samples of every track that the filters read, with their noise.

        These are the last `window` samples of a track, or all of them behind a slow
        error or if the batch `is_causal`. In a causal batch the variance of a sample is
        estimated from the samples up to it, else from the whole track. The clock of
        each track is 0 at its last sample, so that late clocks lose no precision.
        """
        last, sizes = release.offsets[1:], np.diff(release.offsets)
        error = self._slow_error
        if error is None and not is_causal:
            sizes = np.minimum(sizes, self.window)
        runs = list(zip((last - sizes).tolist(), last.tolist(), strict=True))
        offsets = np.concatenate([[0], np.cumsum(sizes)])
        t = end_to_end(release.t, runs) - np.repeat(release.t[last - 1], sizes)
        xy = end_to_end(release.xy, runs)
        ellipse = None
        if self.noise == "declared":
            assert release.sigma is not None  # granted because it is required
            variance = self._declared_variance(end_to_end(release.sigma, runs))
            if release.cov is not None:
                cov = end_to_end(release.cov, runs)
                if error is not None:
                    cov = covariance_without(
                        cov, std_m=self.added_std_m, least_m2=MIN_VARIANCE_M2
                    )
                variance = np.maximum(mean_variance(cov), _LEAST_DECLARED_M2)
                ellipse = error_ellipses(cov)
        else:
            level = self._estimated_level(t, xy, offsets, is_causal=is_causal)
            variance = level if is_causal else np.repeat(level, sizes)
        return Batch(t, xy, variance, offsets, _PRIOR_STD[: self.states], ellipse)

    def _declared_variance(self, sigma: Floats) -> Floats:
        """Return the white variance per axis of samples with declared std, (M,) m^2."""
        error = self._slow_error
        slow_m2 = 0.0 if error is None else self.added_std_m**2
        least_m2 = _LEAST_DECLARED_M2 if error is None else MIN_VARIANCE_M2
        # With an isotropic added error of std s per axis, releases declare sqrt(raw^2 +
        # s^2): the law is that of the raw error alone.
        raw_m2 = sigma**2 - slow_m2
        return np.asarray(np.maximum(raw_m2 * axis_share(self.law), least_m2))

    def _estimated_level(
        self, t: Floats, xy: Floats, offsets: Ints, *, is_causal: bool
    ) -> Floats:
        """Estimate the white variance per axis by innovations, (N,) or (M,) m^2."""
        error = self._slow_error
        level = innovation_variance_m2(t=t, xy=xy, offsets=offsets, running=is_causal)
        if error is None:  # at least the variance of the added error
            return np.asarray(np.maximum(level, self.added_std_m**2))
        # A small part of a slow error looks like white noise.
        share = error.innovation_share(t=t, offsets=offsets, running=is_causal)
        white = level - self.added_std_m**2 * share
        return np.asarray(np.maximum(white, LEAST_REST * level))


@dataclass(frozen=True, slots=True)
class KalmanCA(KalmanCV):
    """Constant acceleration, white-noise jerk: `KalmanCV` with 3 states per axis."""

    q: float = 0.026  # m^2/s^5, from ``python -m benchmarks.tune``
    states: ClassVar[int] = 3


@dataclass(frozen=True, slots=True)
class KalmanIMM(KalmanCV):
    """Two interacting models: walking on, and stopping or turning."""

    q: float = 0.001  # m^2/s^3 while walking on, from ``python -m benchmarks.tune``
    q_turn: float = 0.12  # m^2/s^3 while stopping or turning, likewise
    # Mean durations of the modes. They are set by hand: the most likely durations are
    # as long as tracks.
    walk_s: float = 4.0
    turn_s: float = 1.5

    def __post_init__(self) -> None:
        KalmanCV.__post_init__(self)
        if not (self.q_turn > 0 and self.walk_s > 0 and self.turn_s > 0):
            raise ValueError("q_turn, walk_s and turn_s must be positive")

    @property
    def moods(self) -> Moods:
        """The two models."""
        return Moods((self.q, self.q_turn), (self.walk_s, self.turn_s))

    def predict(self, release: Release, t_future: Floats) -> Prediction:
        """Return mean and covariance at `t_future`, (N, H) s, mixed over the modes.

        Within the horizon of a second a walk is assumed to stay in its mode.
        """
        batch = self.batch(release)
        if self.engine == "filterpy":
            from predictors import filterpy_engine  # noqa: PLC0415 - only where it runs

            last = filterpy_engine.last_modes(batch, self.moods, gate=self.gate)
        else:
            last = imm_last(batch, self.moods, gate=self.gate)
        mean, cov = _extrapolate(
            last.mean,
            last.cov.reshape(len(batch), 2, 2, 2, 2, 2),
            q=np.array(self.moods.q)[:, None],
            elapsed_s=(t_future - release.t[release.offsets[1:] - 1, None])[:, None],
        )
        probability = last.probability
        mixed = np.einsum("nj,njha->nha", probability, mean)
        gap = mean - mixed[:, None]
        spread = cov + gap[..., :, None] * gap[..., None, :]
        return Prediction(mixed, np.einsum("nj,njhab->nhab", probability, spread))

    def log_likelihood(self, release: Release) -> Floats:
        """Return the log density of the shared positions in the window, (N,)."""
        return imm_last(self.batch(release), self.moods, gate=self.gate).log_likelihood


def _extrapolate(
    mean: Floats, cov: Floats, *, q: Floats, elapsed_s: Floats
) -> tuple[Floats, Floats]:
    """Extrapolate states (..., 2, d) with covariance (..., 2, d, 2, d).

    Returns mean and covariance of the positions at `elapsed_s`, (..., H) s.
    """
    d = mean.shape[-1]
    # Taylor terms of the motion: position after tau is sum_k tau^k / k! times
    # derivative k.
    # `tau` gets further axes of length 1, those of a position, then of a covariance.
    factorial, tau = np.array([1.0, 1.0, 2.0])[:d], elapsed_s[..., None]
    terms = mean / factorial
    position = terms[..., None, :, d - 1]
    for k in reversed(range(d - 1)):
        position = terms[..., None, :, k] + tau * position
    cov_terms, tau = cov / (factorial[:, None, None] * factorial), tau[..., None]
    spread = np.zeros(())
    for power in reversed(range(2 * d - 1)):
        pairs = range(max(power - d + 1, 0), min(power, d - 1) + 1)
        coefficient = sum(cov_terms[..., None, :, k, :, power - k] for k in pairs)
        spread = tau * spread + coefficient
    # White noise on derivative d adds the variance of its d-fold integral.
    added = q * elapsed_s ** (2 * d - 1) / (3.0 if d == 2 else 20.0)  # noqa: PLR2004 - states an axis
    return position, spread + added[..., None, None] * np.eye(2)
