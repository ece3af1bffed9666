"""Stationary Gaussian errors of any smooth spectrum, drawn once for each walk.

White noise on a grid of instants passes a symmetric filter. The draws depend on the
number of a walk alone, so that all releases of a walk share its path of errors.
"""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from isac_track.mechanisms.error_paths import Reuse
from isac_track.mechanisms.perturb import add_isotropic
from isac_track.rng import stream
from isac_track.types import Floats, Ints, Release, Sensed

# Grid points of a block, which is computed as a whole: an instant has one error.
_BLOCK = 1024
_STEPS_PER_TAU = 64  # Grid points in the correlation time of a Gaussian filter.
_TAUS_OF_FILTER = 3.0  # Correlation times on either side: exp(-18) of the peak is left.


@dataclass(frozen=True, eq=False, slots=True)
class Filter:
    """Filter that turns white noise on a grid into an error of unit variance."""

    step_s: float  # s between two points of the grid.
    weight: Floats  # (2 L + 1,), symmetric; the squares sum to 1.


def smooth_filter(tau_s: float) -> Filter:
    """Return the filter of an error with the correlation exp(-(dt / tau)^2).

    Its own shape is exp(-2 (dt / tau)^2): convolved with itself it gives the
    correlation.
    """
    step_s = tau_s / _STEPS_PER_TAU
    half = int(_TAUS_OF_FILTER * _STEPS_PER_TAU)
    weight = np.exp(-2.0 * np.square(np.arange(-half, half + 1) * step_s / tau_s))
    return Filter(step_s, weight / np.sqrt(np.sum(weight**2)))


def add_stationary(
    sensed: Sensed,
    std_m: float,
    rng: Generator,
    *,
    shape: Filter,
    reuse: Reuse,
) -> Release:
    """Return the raw estimates with a stationary Gaussian error on top.

    `std_m` is its standard deviation per axis, m. With the reuse `session` all releases
    of a walk have the same error at an instant.
    """
    unit = stationary_errors(
        t=sensed.t,
        offsets=sensed.offsets,
        walk=error_numbers(sensed, reuse, rng),
        shape=shape,
    )
    return add_isotropic(sensed, std_m, rng, unit_error=unit)


def stationary_errors(
    *, t: Floats, offsets: Ints, walk: Ints, shape: Filter, n_paths: int = 2
) -> Floats:
    """Return independent standardised errors that depend on the walk, (M, n_paths).

    They are exact on the grid of the filter and linear between its points, with unit
    variance everywhere. `t` are (M,) s, `offsets` (N + 1,), `walk`, (N,), are the
    numbers. An instant of a walk has the same errors in every release.
    """
    errors = np.empty((t.size, n_paths))
    neighbour = float(shape.weight[1:] @ shape.weight[:-1])
    for number, first, end in zip(
        walk.tolist(), offsets[:-1], offsets[1:], strict=True
    ):
        place = t[first:end] / shape.step_s
        block = np.floor(place / _BLOCK).astype(np.int64)
        known: dict[int, Floats] = {}
        for block_number in np.unique(block).tolist():
            path = _block_path(number, block_number, shape, n_paths, known)
            inside = np.flatnonzero(block == block_number)
            point = place[inside] - block_number * _BLOCK
            left = np.minimum(point.astype(np.int64), _BLOCK - 1)
            weight = (point - left)[:, None]
            mixed = (1.0 - weight) * path[left] + weight * path[left + 1]
            # A line between two points of correlation f has the variance
            # 1 - 2 w (1 - w) (1 - f).
            lost = 2.0 * (1.0 - neighbour) * weight * (1.0 - weight)
            errors[first + inside] = mixed / np.sqrt(1.0 - lost)
    return errors


def error_numbers(sensed: Sensed, reuse: Reuse, rng: Generator) -> Ints:
    """Return the numbers that the errors of N walks depend on, (N,).

    With the reuse `session` they are those of the walks, else fresh. Both kinds of
    reuse make the same draws from `rng`.
    """
    fresh = rng.integers(2**62, size=len(sensed))
    return sensed.walk if reuse == "session" else fresh


def _block_path(
    walk: int, block: int, shape: Filter, n_paths: int, known: dict[int, Floats]
) -> Floats:
    """Return a walk's errors at the points of a block and the next, (1024 + 1, P).

    `known` holds the draws of the blocks so far; new draws are added to it.
    """
    from scipy.signal import fftconvolve  # noqa: PLC0415 - heavy to import

    half = shape.weight.size // 2
    n_around = -(-(half + 1) // _BLOCK)
    around = range(block - n_around, block + n_around + 1)
    for number in around:
        if number not in known:
            rng = stream(0, "stationary errors", walk, number)
            known[number] = rng.standard_normal((_BLOCK, n_paths))
    white = np.concatenate([known[number] for number in around])
    first = n_around * _BLOCK - half
    white = white[first : first + _BLOCK + 1 + 2 * half]
    return np.asarray(fftconvolve(white, shape.weight[:, None], mode="valid", axes=0))
