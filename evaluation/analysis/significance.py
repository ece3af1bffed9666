"""Many tests at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from isac_track.types import Floats


def holm(p_values: Floats) -> Floats:
    """Return p-values adjusted for all of them, (K,): Holm (Scand. J. Statistics 6, 1979).

    The chance of even one false discovery is at most the level, however the numbers depend on each
    other. An unknown one (NaN) stays so and does not count.
    """
    adjusted: Floats = np.full(p_values.shape, np.nan)
    known = np.flatnonzero(~np.isnan(p_values))
    order = known[np.argsort(p_values[known], kind="stable")]
    times = np.arange(order.size, 0, -1)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(p_values[order] * times))
    return adjusted
