"""Kalman filters and smoothers of many tracks at once: fronts of compiled loops.

Two models, each per axis: constant velocity, with state (position, velocity), and
constant acceleration, with state (position, velocity, acceleration). Continuous white
noise of spectral density q drives the constant quantity, so that predictions over
irregular steps compose. Both axes have the same measurement variance and no
correlation; they share one covariance. Errors with a shape couple the axes: see
`Batch.ellipse` and `planar_last`.

Interacting multiple models (IMM) are two models of constant velocity, each with its own
spectral density; the current model follows a Markov chain in continuous time. A cycle
is Blom and Bar-Shalom's: mix, predict, update, weigh; `docs/reference/kernels.md` lists
where filterpy's differs.

Nothing here imports numba before the first call (see `prepare`).

References
----------
Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*,
2001: sections 5.2 (filter), 6.2 (models), 8.6 (smoother), 11.6.6 (IMM). Rauch, Tung,
Striebel, AIAA J. 3(8), 1965. Blom, Bar-Shalom, "The interacting multiple model
algorithm for systems with Markovian switching coefficients", IEEE Trans. Automatic
Control 33(8), 1988, 780-783.
"""

from dataclasses import dataclass
from importlib import import_module

import numpy as np

from isac_track.measurement import mean_variance, principal_axes
from isac_track.types import Floats, Ints, check_offsets, positive, within

__all__ = ["MAX_REJECTIONS", "Batch", "ImmStates", "LastState", "Moods"]
__all__ += ["PlanarState", "imm_last", "imm_states", "kalman_last", "planar_last"]
__all__ += ["prepare", "smooth_ellipses", "smooth_positions"]

MAX_REJECTIONS = 3
"""After this many rejected samples in a row the next is accepted.

A gate may drop outliers; it may not lose a track.
"""


@dataclass(frozen=True, eq=False, slots=True)
class Batch:
    """N tracks of M noisy positions in all, and the prior of each track's first state.

    The release checks that times increase and positions are finite. ValueError if
    shapes disagree, a track is empty, or a variance or standard deviation is not
    positive.
    """

    t: Floats  # (M,) s, strictly increasing within a track.
    xy: Floats  # (M, 2) m
    variance: Floats  # (M,) m^2, of the measurement, per axis.
    # (N + 1,) track i owns the samples ``offsets[i]:offsets[i + 1]``; none is empty.
    offsets: Ints
    prior_std: tuple[float, ...]
    """Standard deviations of the prior, per axis and independent.

    m around the first sample; m/s and, for constant acceleration, m/s^2 around rest.
    The prior holds at the time of the first sample, which is then measured like any
    other.
    """
    ellipse: Floats | None = None
    """(M, 2, 2), covariance of the measurement in units of `variance`, of trace 2.

    None: the same variance on both axes. `kalman_last` and `slow_errors.smooth_each`
    refuse an ellipse by a ValueError.
    """

    def __post_init__(self) -> None:
        offsets = np.ascontiguousarray(self.offsets, dtype=np.int64)
        object.__setattr__(self, "offsets", offsets)
        check_offsets(offsets, len(self.t))
        for name, shape in (("t", ()), ("xy", (2,)), ("variance", ())):
            array = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if array.shape != (len(self.t), *shape):
                raise ValueError(f"{name} must have shape {(len(self.t), *shape)}")
            object.__setattr__(self, name, array)
        if not within(self.variance, np.nextafter(0.0, 1.0), np.finfo(np.float64).max):
            raise ValueError("variance must be positive and finite")
        for std in self.prior_std:
            positive("prior_std", std)
        if self.ellipse is not None and np.shape(self.ellipse) != (len(self.t), 2, 2):
            raise ValueError(f"ellipse must have shape {(len(self.t), 2, 2)}")

    def __len__(self) -> int:
        """Return the number of tracks."""
        return self.offsets.size - 1

    def arrays(self, *n_states: int) -> tuple[Floats, Floats, Floats, Ints, Floats]:
        """Return the batch as a compiled loop takes it: a plain tuple, in fixed order.

        Times, positions, variances, offsets, and the variances of the prior. ValueError
        for another number of states, or an ellipse.
        """
        if self.ellipse is not None:
            raise ValueError("this filter needs the same variance on both axes")
        return self._arrays(*n_states)

    def planar_arrays(self, *n_states: int) -> tuple[Floats | Ints, ...]:
        """Return the batch as a loop for errors with a shape takes it.

        Behind what `arrays` returns stand the principal axes of each sample's error,
        and their variances as shares of the mean. ValueError for another number of
        states, or an ellipse that is flat.
        """
        ellipse = np.eye(2) if self.ellipse is None else self.ellipse
        axes, shares = principal_axes(np.broadcast_to(ellipse, (len(self.t), 2, 2)))
        if not within(shares, np.nextafter(0.0, 1.0), np.finfo(np.float64).max):
            raise ValueError("an ellipse needs two axes of positive, finite variance")
        return *self._arrays(*n_states), axes, shares

    def shaped_arrays(self, *n_states: int) -> tuple[Floats | Ints, ...]:
        """Return `planar_arrays`; of round errors without axes and shares."""
        if self.ellipse is not None:
            return self.planar_arrays(*n_states)
        return *self._arrays(*n_states), np.empty((0, 2, 2)), np.empty((0, 2))

    def _arrays(self, *n_states: int) -> tuple[Floats, Floats, Floats, Ints, Floats]:
        if len(self.prior_std) not in n_states:
            numbers = " or ".join("two" if n == 2 else "three" for n in n_states)  # noqa: PLR2004 - the sizes that there are
            raise ValueError(
                f"prior_std must have {numbers} numbers, got {len(self.prior_std)}"
            )
        prior_m2 = np.square(self.prior_std, dtype=float)  # They may be whole numbers.
        return self.t, self.xy, self.variance, self.offsets, prior_m2


@dataclass(frozen=True, eq=False, slots=True)
class LastState:
    """States of N tracks after their last sample; d states per axis."""

    # (N, 2, d) m, m/s, m/s^2: per axis position, velocity, then acceleration.
    mean: Floats
    cov: Floats  # (N, d, d) covariance of either axis; the axes are independent.
    # (N,) log density of a track's accepted samples, 1/m^2 each.
    log_likelihood: Floats


def kalman_last(batch: Batch, *, q: float, gate: float = np.inf) -> LastState:
    """Return the state of every track after its last sample.

    With a prior of two states the model is constant velocity, of three constant
    acceleration. `q` is the spectral density of the driving white noise, positive: of
    the acceleration (m^2/s^3) or, for constant acceleration, of the jerk (m^2/s^5). A
    sample whose normalised innovation squared exceeds the `gate` is not used, unless
    `MAX_REJECTIONS` samples before it were not. Chi-square with 2 degrees of freedom:
    13.8 keeps all but one sample in a thousand.

    ValueError if q or the gate is not positive, or for a prior of another number of
    states.
    """
    arrays, d = batch.arrays(2, 3), len(batch.prior_std)
    n = len(batch)
    out = LastState(np.empty((n, 2, d)), np.empty((n, d, d)), np.empty(n))
    loops = import_module("isac_track.kalman._linear_loops")
    filter_tracks = loops.cv_last if d == 2 else loops.ca_last  # noqa: PLR2004 - p and v
    filter_tracks(
        arrays,
        positive("q", q),
        positive("gate", gate, finite=False),
        MAX_REJECTIONS,
        (out.mean, out.cov, out.log_likelihood),
    )
    return out


@dataclass(frozen=True, eq=False, slots=True)
class PlanarState:
    """States of N tracks after their last sample, whose axes are coupled."""

    mean: Floats  # (N, 2, d) m, m/s, m/s^2: per axis, as in `LastState`.
    cov: Floats  # (N, 2, d, 2, d)
    log_likelihood: Floats  # (N,) as in `LastState`.


def planar_last(batch: Batch, *, q: float, gate: float = np.inf) -> PlanarState:
    """Return the state of every track after its last sample, for errors with a shape.

    Parameters and errors are those of `kalman_last`.
    """
    arrays, n, d = batch.planar_arrays(2, 3), len(batch), len(batch.prior_std)
    mean, cov = np.empty((n, 2 * d)), np.empty((n, 2 * d, 2 * d))
    out = mean, cov, np.empty(n)
    import_module("isac_track.kalman._planar_loops").last_states(
        arrays,
        positive("q", q),
        positive("gate", gate, finite=False),
        MAX_REJECTIONS,
        out,
    )
    return PlanarState(mean.reshape(n, 2, d), cov.reshape(n, 2, d, 2, d), out[2])


def smooth_planar(
    batch: Batch,
    *,
    motions: Floats,
    weight: Floats,
    passes: int,
    anneal: float,
) -> tuple[Floats, Floats]:
    """Return mean, (M, 2) m, and covariance, (M, 2, 2) m^2, of smoothed positions.

    `motions`, (K, 3), are the variance of the first velocity, the time over which the
    velocity's correlation falls to 1/e, and q; `weight`, (N, K), is that of each for
    each track. Nothing else is checked here.
    """
    loops = import_module("isac_track.kalman._planar_loops")
    fill_steps = import_module("isac_track.kalman._error_loops").fill_steps
    arrays, steps = batch.planar_arrays(2), np.empty((batch.t.size, 5))
    out = np.zeros_like(batch.xy), np.zeros((batch.t.size, 2, 2)), np.zeros(len(batch))
    for motion, own in zip(np.ascontiguousarray(motions), weight.T, strict=True):
        track = np.flatnonzero(own)
        if track.size:
            fill_steps(batch.t, batch.offsets, motion, steps)
            loops.smooth_tracks(
                arrays, motion, steps, track, own[track], passes, float(anneal), out
            )
    return out[:2]


def smooth_ellipses(
    batch: Batch, *, q: float, passes: int = 1, anneal: float = 0.0
) -> tuple[Floats, Floats]:
    """Return smoothed positions, (M, 2) m, and their covariances, (M, 2, 2) m^2.

    Parameters are those of `smooth_positions`.
    """
    motions = np.array([[batch.prior_std[1] ** 2, np.inf, positive("q", q)]])
    weight = np.ones((len(batch), 1))
    return smooth_planar(
        batch, motions=motions, weight=weight, passes=passes, anneal=anneal
    )


def smooth_positions(
    batch: Batch, *, q: float, passes: int = 1, anneal: float = 0.0
) -> tuple[Floats, Floats]:
    """Return smoothed positions, (M, 2) m, and their variance per axis, (M,) m^2.

    One pass is a Rauch-Tung-Striebel smoother of constant velocity; it returns no
    velocities. Further passes are for errors of the radial law, whose length is that of
    a normal error N(0, sigma) in any direction. Its density in the plane, exp(-r^2 / 2
    sigma^2) / r up to a constant, is infinite at zero: a sample that lies close to the
    walk is very likely almost exact. The posterior mode solves a smoother with the
    weights 1 / r^2 + 1 / sigma^2 per axis, r the sample's distance from the smoothed
    position. They are iterated as 1 / (r^2 + delta^2) + 1 / sigma^2, with delta^2 = 2 P
    + anneal^(m - 1) sigma^2 after the m-th pass. So a residual counts as no smaller
    than the uncertainty of the position (P is its variance per axis). The first passes
    are nearly those of Gaussian errors, lest the walk be drawn to samples that happen
    to lie near its start.

    The `batch` has a prior of two states, and sigma^2 is twice its variance per axis;
    `q` is the spectral density of the acceleration, m^2/s^3, positive. There are
    `passes` passes, at least 1; the first is that of Gaussian errors. `anneal` is in
    [0, 1). ValueError otherwise. Behind an ellipse the distance r is in its units, and
    the variance is the mean of both axes.

    References
    ----------
    Iterative re-weighting: Huber and Ronchetti, *Robust Statistics*, 2009, ch. 7.8; the
    mode of a scale mixture: Dempster, Laird, Rubin, *Multivariate Analysis V*, 1980.
    """
    if passes < 1 or not 0 <= anneal < 1:
        raise ValueError(
            f"need passes >= 1 and 0 <= anneal < 1, got {passes} and {anneal}"
        )
    if batch.ellipse is not None:
        xy, cov = smooth_ellipses(batch, q=q, passes=passes, anneal=anneal)
        return xy, mean_variance(cov)
    out = np.empty((batch.t.size, 2)), np.empty(batch.t.size)
    order = np.argsort(np.diff(batch.offsets), kind="stable")
    loops = import_module("isac_track.kalman._linear_loops")
    loops.smooth_positions(
        batch.arrays(2), order, positive("q", q), passes, float(anneal), out
    )
    return out


@dataclass(frozen=True, slots=True)
class Moods:
    """Two modes of a walk that take turns: walking on, and stopping or turning.

    ValueError if a number is not positive and finite.
    """

    # m^2/s^3, spectral density of the acceleration in each mode.
    q: tuple[float, float]
    stay_s: tuple[float, float]  # s, mean time until a mode gives way to the other.

    def __post_init__(self) -> None:
        for name, values in (("q", self.q), ("mean times", self.stay_s)):
            for value in values:
                positive(name, value)

    @property
    def probability(self) -> Floats:
        """Probabilities of the modes in the long run and at first, (2,)."""
        return np.array(self.stay_s) / sum(self.stay_s)

    def transitions(self, t: Floats) -> Floats:
        """Return the transition probabilities to each sample, (M, 2, 2).

        They are exp(rates * step), indexed by the mode before, then the mode now; there
        is no step to a track's first sample.
        """
        rates = 1.0 / np.array(self.stay_s)
        step_s = np.abs(np.diff(t, prepend=t[:1]))
        mixed = -np.expm1(-rates.sum() * step_s) / rates.sum()
        chances = np.empty((step_s.size, 2, 2))
        for mode, rate in enumerate(rates):
            np.multiply(mixed, rate, out=chances[:, mode, 1 - mode])
            np.subtract(1.0, chances[:, mode, 1 - mode], out=chances[:, mode, mode])
        return chances


@dataclass(frozen=True, eq=False, slots=True)
class ImmStates:
    """States under each of two modes: K of N tracks.

    They are those after the last sample of each track, or after every sample. To
    forecast, predict each mode with its own q and mix by `probability`.
    """

    mean: Floats  # (K, 2, 2, 2) m, m/s: per mode and axis position and velocity.
    cov: Floats  # (K, 2, 4, 4) of (x, vx, y, vy) under each mode.
    probability: Floats  # (K, 2) of the modes.
    # (N,) log density of a track's accepted samples, 1/m^2 each.
    log_likelihood: Floats


def imm_last(batch: Batch, moods: Moods, *, gate: float = np.inf) -> ImmStates:
    """Return the states of N tracks after their last sample.

    The `batch` has a prior of two states, which holds under either mode. A sample is
    not used if its normalised innovation squared exceeds the `gate` under every mode,
    unless `MAX_REJECTIONS` samples before it were not. ValueError if the gate is not
    positive, or for a prior of another number of states.
    """
    return _imm_states("imm_last", batch, moods, gate=gate, n_rows=len(batch))


def imm_states(batch: Batch, moods: Moods, *, gate: float = np.inf) -> ImmStates:
    """Return the states after each of M samples, as a smoother needs them.

    A state rests on the samples of its track up to its own. Parameters and errors are
    those of `imm_last`.
    """
    return _imm_states("imm_states", batch, moods, gate=gate, n_rows=batch.t.size)


def _imm_states(
    loop: str, batch: Batch, moods: Moods, *, gate: float, n_rows: int
) -> ImmStates:
    """Return the states that a loop of the filter writes, a row each."""
    mean, cov = np.empty((n_rows, 2, 2, 2)), np.empty((n_rows, 2, 4, 4))
    out = ImmStates(mean, cov, np.empty((n_rows, 2)), np.empty(len(batch)))
    getattr(import_module("isac_track.kalman._imm_loops"), loop)(
        batch.shaped_arrays(2),
        (
            np.array(moods.q, dtype=np.float64),
            moods.probability,
            moods.transitions(batch.t),
        ),
        positive("gate", gate, finite=False),
        MAX_REJECTIONS,
        (mean.reshape(n_rows, 2, 4), cov, out.probability, out.log_likelihood),
    )
    return out


def prepare() -> None:
    """Compile every loop of this package, or load it from the cache.

    Otherwise a loop is compiled when it is first called. The machine code is cached
    beside the package, or in the user's cache if that is read-only; where neither can
    be written it is compiled in every process. Worth a call before a timing or before
    workers start.
    """
    from isac_track.compiling import loops_in  # noqa: PLC0415 - imports numba

    for name in ("linear", "imm", "error", "planar", "planar_error"):
        for loop in loops_in(import_module(f"isac_track.kalman._{name}_loops")):
            loop.prepare()
