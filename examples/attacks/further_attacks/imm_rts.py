"""Smooth walks under two motions that take turns: walking on, and turning."""

from dataclasses import dataclass
from importlib import import_module
from typing import ClassVar

import numpy as np

from attacks.building_blocks import COMMON_KNOWLEDGE, make_smoother
from further_attacks.parameters import PRIOR_STD, require_positive
from isac_track.kalman import Batch, Moods, imm_states
from isac_track.protocols import AttackContext, Reconstructor
from isac_track.types import Floats, Knowledge, Reconstruction, Release

_FACTORS = (1 / 4, 1.0, 4.0)  # Of the default densities: the candidates to learn from.


@dataclass(frozen=True, slots=True)
class ImmRTS:
    """Two constant-velocity models with a Markov chain: walking on, or turning.

    The filter is that of `isac_track.kalman`, and the smoother `smooth_moods`.
    """

    # m^2/s^3 while walking on; None, with `q_turn`: learnt or `DEFAULT_Q`.
    q: float | None = None
    q_turn: float | None = None  # m^2/s^3 while stopping or turning.
    walk_s: float = 4.0  # Mean time of walking on.
    turn_s: float = 1.5  # Mean time of stopping or turning.

    slow: ClassVar[bool] = True
    seconds_per_sample: ClassVar[float] = 2e-6
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = COMMON_KNOWLEDGE
    DEFAULT_Q: ClassVar[tuple[float, float]] = (0.03, 0.12)

    def __post_init__(self) -> None:
        if (self.q is None) != (self.q_turn is None):
            raise ValueError("give both q and q_turn, or neither to have them learnt")
        require_positive(
            q=self.q, q_turn=self.q_turn, walk_s=self.walk_s, turn_s=self.turn_s
        )

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the smoother of releases like those in the training set."""
        q, q_turn = self.DEFAULT_Q
        candidates = [(q * factor, q_turn * factor) for factor in _FACTORS]
        if self.q is not None and self.q_turn is not None:
            candidates = [(self.q, self.q_turn)]
        return make_smoother(context, self._smooth, candidates=candidates)

    def _smooth(
        self, release: Release, variance: Floats, density: tuple[float, float]
    ) -> Reconstruction:
        batch = Batch(release.t, release.xy, variance, release.offsets, PRIOR_STD)
        moods = Moods(density, (self.walk_s, self.turn_s))
        position, spread = smooth_moods(batch, moods)
        # The spread between the modes couples the axes; the claimed std comes from
        # their mean variance.
        return Reconstruction(position, np.sqrt(spread))


def smooth_moods(batch: Batch, moods: Moods) -> tuple[Floats, Floats]:
    """Return smoothed positions, (M, 2) m, and their mean variance per axis, (M,) m^2.

    Expectation correction (Barber 2006) with one Gaussian per mode. Backwards in time,
    every mode now is smoothed from every mode next by Rauch-Tung-Striebel. The weight
    of a pair is that of the filter times the density of the next smoothed mean under
    the pair's prediction. The pairs of each mode are then collapsed into one Gaussian.
    Like the filter it is an approximation: exact with modes of equal q. ValueError for
    a prior of another number of states than two.

    References
    ----------
    Barber, "Expectation correction for smoothed inference in switching linear dynamical
    systems", J. Machine Learning Research 7, 2006, 2515-2540.
    """
    states = imm_states(batch, moods)
    mean = states.mean.reshape(-1, 2, 4)
    position, spread = np.empty((batch.t.size, 2)), np.empty(batch.t.size)
    # Imported late: a list of attacks need not wait for numba.
    import_module("further_attacks._imm_loop").smooth_back(
        batch.t,
        batch.offsets,
        np.array(moods.q, dtype=np.float64),
        moods.transitions(batch.t),
        mean,
        states.cov,
        states.probability,
        position,
        spread,
    )
    return position, spread
