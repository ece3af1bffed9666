"""What the fronts of the compiled loops are called with: contiguous, finite, of the right shape."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints


def ragged_times(t: Floats, offsets: Ints) -> tuple[Floats, Ints]:
    """Return times and offsets as contiguous arrays, or raise ValueError."""
    offsets = np.ascontiguousarray(offsets)
    if offsets.ndim != 1 or offsets.dtype.kind not in "iu":
        raise ValueError("offsets must be a one-dimensional array of integers")
    t = np.ascontiguousarray(t, dtype=np.float64)
    if t.ndim != 1:
        raise ValueError(f"t must have shape (M,), got {t.shape}")
    if offsets.size == 0 or offsets[0] != 0 or offsets[-1] != t.size:
        raise ValueError(f"offsets must run from 0 to {t.size}")
    if (offsets[1:] <= offsets[:-1]).any():
        raise ValueError("every track needs at least one sample: offsets must increase")
    if not np.isfinite(t).all():
        raise ValueError("times must be finite and strictly increasing within a track")
    rising = t[1:] > t[:-1]
    rising[offsets[1:-1] - 1] = True  # from one track to the next
    if not rising.all():
        raise ValueError("times must be finite and strictly increasing within a track")
    return t, offsets.astype(np.int64, copy=False)


def floats(name: str, value: Floats, shape: tuple[int, ...]) -> Floats:
    """Return a contiguous array of finite numbers of that shape, or raise ValueError."""
    array = np.ascontiguousarray(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite")
    return array


def variances(value: Floats, n_samples: int) -> Floats:
    """Return the measurement variances, or raise ValueError."""
    array = floats("variance", value, (n_samples,))
    if not (array > 0).all():
        raise ValueError("variance must be positive")
    return array


def covariances(name: str, value: Floats, shape: tuple[int, ...]) -> Floats:
    """Return symmetric positive definite matrices, or raise ValueError."""
    array = floats(name, value, shape)
    turned = array.swapaxes(-1, -2)
    # Most are symmetric to the last bit, which takes a tenth of the time to see.
    if not (np.array_equal(array, turned) or np.allclose(array, turned, rtol=1e-12, atol=0)):
        raise ValueError(f"{name} must be symmetric")
    try:
        np.linalg.cholesky(array)
    except np.linalg.LinAlgError:
        raise ValueError(f"{name} must be positive definite") from None
    return array


def positive(name: str, value: float, *, finite: bool = True) -> float:
    """Return a positive number, or raise ValueError."""
    if not value > 0 or (finite and not np.isfinite(value)):
        raise ValueError(f"{name} must be positive, got {value}")
    return float(value)
