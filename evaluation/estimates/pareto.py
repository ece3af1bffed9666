"""Pareto dominance: which points no other point beats. Less is better on each axis."""

import numpy as np

from isac_track.types import Bools, Floats


def beats(values: Floats) -> Bools:
    """Return whether point i beats point j: no worse on any axis, and better on one.

    `values` are (N, D), the result is (N, N). A point with a NaN beats none, and none
    beats it.
    """
    row, column = values[:, None], values[None]
    is_no_worse = np.all(row <= column, axis=2)
    return np.asarray(is_no_worse & np.any(row < column, axis=2))


def front(values: Floats) -> Bools:
    """Return which of the points, (N, D), no other beats, (N,); none with a NaN."""
    is_known = ~np.isnan(values).any(axis=1)
    return np.asarray(is_known & ~beats(values).any(axis=0))
