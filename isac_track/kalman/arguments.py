"""What the fronts of the compiled loops are called with: contiguous, finite, of the right shape."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isac_track.types import check_offsets, check_times

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints


def ragged_times(t: Floats, offsets: Ints) -> tuple[Floats, Ints]:
    """Return times and offsets as contiguous arrays, or raise ValueError."""
    offsets = np.ascontiguousarray(offsets)
    if offsets.ndim != 1 or offsets.dtype.kind not in "iu":
        raise ValueError("offsets must be a one-dimensional array of integers")
    offsets = offsets.astype(np.int64, copy=False)
    t = np.ascontiguousarray(t, dtype=np.float64)
    if t.ndim != 1:
        raise ValueError(f"t must have shape (M,), got {t.shape}")
    check_offsets(offsets, t.size)
    check_times(t, offsets)
    return t, offsets


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
