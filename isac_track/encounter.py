"""Probability of a conflict from a predicted distribution."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr

if TYPE_CHECKING:
    from isac_track.types import Floats

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_SMALLEST_STD_M = 1e-3
_REACH_STD = 6.0


def disc_probability(*, mean: Floats, cov: Floats, radius_m: float) -> Floats:
    """Return the probability that a planar Gaussian lies within a disc around the origin.

    Integrated along one axis with the other in closed form (Gauss-Legendre in the angle, 16
    nodes). Standard deviations below 1 mm count as 1 mm.

    Parameters
    ----------
    mean : (..., 2) m
    cov : (..., 2, 2) m^2
    radius_m : float

    Returns
    -------
    (...,) in 0..1
    """
    # Integrate along the axis of the smaller spread, where the closed form does the sharp part.
    half_trace = 0.5 * (cov[..., 0, 0] + cov[..., 1, 1])
    half_gap = 0.5 * (cov[..., 0, 0] - cov[..., 1, 1])
    reach = np.hypot(half_gap, cov[..., 0, 1])
    angle = 0.5 * np.arctan2(cov[..., 0, 1], half_gap)
    cos, sin = np.cos(angle), np.sin(angle)
    wide_m = np.sqrt(np.maximum(half_trace + reach, _SMALLEST_STD_M**2))
    narrow_m = np.sqrt(np.maximum(half_trace - reach, _SMALLEST_STD_M**2))
    along = cos * mean[..., 0] + sin * mean[..., 1]
    across = cos * mean[..., 1] - sin * mean[..., 0]
    # Only where the wide axis has mass: a narrow Gaussian would fall between fixed nodes.
    low = np.clip((along - 5.0 * wide_m) / radius_m, -1.0, 1.0)
    high = np.clip((along + 5.0 * wide_m) / radius_m, -1.0, 1.0)
    first, last = np.arcsin(low), np.arcsin(high)
    total = np.zeros_like(along)
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        theta = first + 0.5 * (node + 1.0) * (last - first)
        x = radius_m * np.sin(theta)
        half_chord = radius_m * np.cos(theta)
        density = np.exp(-0.5 * ((x - along) / wide_m) ** 2) / (np.sqrt(2.0 * np.pi) * wide_m)
        inside = ndtr((half_chord - across) / narrow_m) - ndtr((-half_chord - across) / narrow_m)
        total += weight * density * inside * half_chord
    probability: Floats = np.clip(0.5 * (last - first) * total, 0.0, 1.0)
    return probability


def conflict_probability(*, robot: Floats, mean: Floats, cov: Floats, radius_m: float) -> Floats:
    """Return the probability of a conflict in each scene, (S,).

    Of one agent: the probability to lie within the safety radius at the step where that is
    likeliest. The steps share one velocity error and are nearly one event, so that this lower
    bound on the whole horizon is close; a product over the steps would count one encounter
    twelve times. Agents are independent. Further than 6 std from the disc counts as 0.

    Parameters
    ----------
    robot, mean : (S, A, H, 2) m
    cov : (S, A, H, 2, 2) m^2
    radius_m : float
    """
    gap = mean - robot
    distance_m = np.hypot(gap[..., 0], gap[..., 1])
    widest_m = np.sqrt(np.maximum(np.trace(cov, axis1=-2, axis2=-1), _SMALLEST_STD_M**2))
    near = distance_m < radius_m + _REACH_STD * widest_m
    step = np.zeros(near.shape)
    step[near] = disc_probability(mean=gap[near], cov=cov[near], radius_m=radius_m)
    none: Floats = np.prod(1.0 - step.max(axis=2), axis=1)
    return 1.0 - none
