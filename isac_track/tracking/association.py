"""Association of the detections of a scan with tracks: global, or by probabilities.

Both start from the likelihood ratio of each pair: that a detection comes from a track,
against clutter and a track that is missed.

References
----------
Blackman, Popoli, *Design and Analysis of Modern Tracking Systems*, 1999, ch. 6 (global
nearest neighbour). Williams, Lau, "Approximate evaluation of marginal association
probabilities with belief propagation", IEEE Trans. Aerospace and Electronic Systems
50(4), 2014, 2942-2959.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from isac_track.errors import SettingsError
from isac_track.tracking.filters import States
from isac_track.types import Bools, Floats, Ints

UNASSIGNED: Final = -1
_CLOSE: Final = 1e-6  # Change of the messages below which they have converged.
_MOST_STEPS: Final = 200


@dataclass(frozen=True, slots=True)
class Likelihood:
    """What a tracker assumes about detections. SettingsError for a bad value."""

    detection_probability: float = 0.9
    # Clutter and people not tracked yet, per scan.
    density_per_m2: float = 0.02
    # Chi-square quantile of 0.999 with two degrees of freedom.
    gate: float = 13.8

    def __post_init__(self) -> None:
        p = self.detection_probability
        if not 0.0 < p < 1.0:
            raise SettingsError(
                f"a tracker must assume a detection probability between 0 and 1, got {p}"
            )
        for name in ("density_per_m2", "gate"):
            value = getattr(self, name)
            if not (value > 0.0 and np.isfinite(value)):
                raise SettingsError(f"{name} must be positive, got {value}")


def likelihood_ratios(
    states: States, *, xy: Floats, cov: Floats, likelihood: Likelihood
) -> Floats:
    """Return the ratio of each pair of track and detection, (T, D); 0 beyond the gate.

    It is ``p N(innovation; 0, S) / (density (1 - p))``. `xy` is (D, 2) m, `cov` (D, 2,
    2) m^2.
    """
    dx = xy[:, 0] - states.position[:, 0, None]
    dy = xy[:, 1] - states.position[:, 1, None]
    a = states.pp[:, 0, 0, None] + cov[:, 0, 0]
    b = states.pp[:, 0, 1, None] + cov[:, 0, 1]
    d = states.pp[:, 1, 1, None] + cov[:, 1, 1]
    determinant = a * d - b * b
    square = (d * dx * dx - 2.0 * b * dx * dy + a * dy * dy) / determinant
    p = likelihood.detection_probability
    scale = p / ((1.0 - p) * likelihood.density_per_m2 * 2.0 * np.pi)
    ratio = scale * np.exp(-0.5 * square) / np.sqrt(determinant)
    return np.where(square < likelihood.gate, ratio, 0.0)


def nearest_assignment(ratios: Floats) -> Ints:
    """Return the detection of each track in the most probable assignment, (T,).

    It maximises the product of the ratios, (T, D), of assigned pairs; a track or a
    detection may stay alone, which counts 1. `UNASSIGNED` is a track without a
    detection.
    """
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415 - heavy to import

    assigned = np.full(len(ratios), UNASSIGNED)
    if not ratios.size:
        return assigned
    gain = np.log(np.maximum(ratios, 1.0))
    track, detection = linear_sum_assignment(gain, maximize=True)
    is_gain = gain[track, detection] > 0.0
    assigned[track[is_gain]] = detection[is_gain]
    return assigned


def marginal_probabilities(ratios: Floats) -> Floats:
    """Return the probability of each association, (T, 1 + D); first: a missed track.

    Loopy belief propagation (Williams and Lau, fig. 3 and eq. 12): exact if the gated
    pairs have no loop, an approximation otherwise. `ratios` are those of
    `likelihood_ratios`, (T, D).
    """
    n_tracks, n_detections = ratios.shape
    if not ratios.size:
        return np.concatenate(
            [np.ones((n_tracks, 1)), np.zeros((n_tracks, n_detections))], axis=1
        )
    to_track = np.ones_like(ratios)
    for _ in range(_MOST_STEPS):
        weighted = ratios * to_track
        to_detection = ratios / (1.0 + weighted.sum(axis=1, keepdims=True) - weighted)
        after = 1.0 / (1.0 + to_detection.sum(axis=0, keepdims=True) - to_detection)
        change = np.abs(after - to_track).max()
        to_track = after
        if change < _CLOSE:
            break
    weighted = ratios * to_track
    missed = 1.0 / (1.0 + weighted.sum(axis=1, keepdims=True))
    return np.concatenate([missed, weighted * missed], axis=1)


def unused_detections(n_detections: int, used: Ints) -> Bools:
    """Return which of the detections no track uses, (D,)."""
    is_free = np.ones(n_detections, dtype=bool)
    is_free[used[used >= 0]] = False
    return is_free
