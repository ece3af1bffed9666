"""Interacting multiple models (IMM) over many tracks at once: the front of the compiled loops.

Two constant-velocity models, each with a spectral density of its own; which one holds is a Markov
chain in continuous time. One cycle is Blom and Bar-Shalom's: mix, predict, update, weigh.
It equals filterpy's `IMMEstimator` except where that departs from the textbook: `docs/kernels.md`
lists where, and why.

References
----------
Blom, Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
coefficients", IEEE Trans. Automatic Control 33(8), 1988, 780-783. Bar-Shalom, Li, Kirubarajan,
*Estimation with Applications to Tracking and Navigation*, 2001, section 11.6.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np

from isac_track.kalman.linear import MAX_REJECTIONS, Batch, positive

if TYPE_CHECKING:
    from isac_track.types import Floats


@dataclass(frozen=True, slots=True)
class Moods:
    """Two modes of a walk that take turns: walking on, and stopping or turning.

    Raises
    ------
    ValueError
        If a number is not positive and finite.
    """

    q: tuple[float, float]
    """m^2/s^3, spectral density of the acceleration in either."""
    stay_s: tuple[float, float]
    """s, mean time until it gives way to the other."""

    def __post_init__(self) -> None:
        for name, values in (("q", self.q), ("mean times", self.stay_s)):
            for value in values:
                positive(name, value)

    @property
    def probability(self) -> Floats:
        """(2,) of the modes in the long run, and before a track's first sample."""
        return np.array(self.stay_s) / sum(self.stay_s)

    def arrays(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Return what the compiled loops take: q, `probability`, and exp(rates * step) of steps.

        The last, (M, 2, 2), row by row of the mode before; no step counts to a track's first
        sample.
        """
        rates = 1.0 / np.array(self.stay_s)
        step_s = np.abs(np.diff(t, prepend=t[:1]))
        left = (-np.expm1(-rates.sum() * step_s) / rates.sum())[:, None] * rates
        chances = np.empty((step_s.size, 2, 2))
        chances[:, [0, 1], [0, 1]] = 1.0 - left
        chances[:, [0, 1], [1, 0]] = left
        return np.array(self.q, dtype=np.float64), self.probability, chances


@dataclass(frozen=True, eq=False, slots=True)
class ImmStates:
    """States of N tracks after their last sample under each of two modes.

    To forecast, predict each mode with its own q and mix by `probability`.
    """

    mean: Floats
    """(N, 2, 2, 2) m, m/s: per mode and axis position and velocity."""
    cov: Floats
    """(N, 2, 4, 4) of (x, vx, y, vy) under each mode."""
    probability: Floats
    """(N, 2) of the modes."""
    log_likelihood: Floats
    """(N,) log density of a track's accepted samples, 1/m^2 each."""


def imm_last(batch: Batch, moods: Moods, *, gate: float = np.inf) -> ImmStates:
    """Return the states of every track after its last sample.

    Parameters
    ----------
    batch : Batch
        With a prior of two states, which holds under either mode.
    moods : Moods
    gate : float, optional
        A sample is not used if its normalised innovation squared exceeds this under every mode,
        unless `MAX_REJECTIONS` samples before it were not. Default: all are used.

    Raises
    ------
    ValueError
        If the gate is not positive, or for a prior of another number of states.
    """
    n = len(batch)
    out = ImmStates(np.empty((n, 2, 2, 2)), np.empty((n, 2, 4, 4)), np.empty((n, 2)), np.empty(n))
    import_module("isac_track.kalman._imm_loops").imm_last(
        *(batch.arrays(2), moods.arrays(batch.t)),
        *(positive("gate", gate, finite=False), MAX_REJECTIONS),
        (out.mean.reshape(n, 2, 4), out.cov, out.probability, out.log_likelihood),
    )
    return out


def imm_smoother(batch: Batch, moods: Moods) -> tuple[Floats, Floats]:
    """Return smoothed positions, (M, 2) m, and their mean variance over both axes, (M,) m^2.

    Expectation correction (Barber 2006) with one Gaussian per mode: backwards in time, every
    mode now is smoothed from every mode next by Rauch-Tung-Striebel; the pair's weight is that of
    the filter times the density of the next smoothed mean under the pair's prediction; the
    pairs of each mode are then collapsed into one Gaussian. Like the filter it is an
    approximation: exact with modes of equal q. Parameters and errors are those of `imm_last`.

    References
    ----------
    Barber, "Expectation correction for smoothed inference in switching linear dynamical
    systems", J. Machine Learning Research 7, 2006, 2515-2540.
    """
    position, variance = np.empty((batch.t.size, 2)), np.empty(batch.t.size)
    import_module("isac_track.kalman._imm_loops").imm_smoother(
        batch.arrays(2), moods.arrays(batch.t), position, variance
    )
    return position, variance
