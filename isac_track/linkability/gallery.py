"""Rank 1 in a gallery larger than any that was measured.

With p_i the share of impostors ahead of a probe's mate, r(G) = mean of (1 - p_i)^(G - 1) probes
find their mate first among G candidates. Up to the gallery that was measured, `rank1_among` is that
mean without bias. Beyond it, a probe with nobody ahead is not one whom nobody would ever be ahead
of: who puts p_i = 0 there is too high. Here the p_i have a gamma distribution, so that r(G) = (1 +
(G - 1) / b)^-a, through rank 1 in the gallery measured and in a tenth of it: what matters beyond is
how many small p_i there are, and these two rates tell it.
"""

from typing import Final

import numpy as np

from isac_track.types import Floats

REACH: Final = 10
"""No gallery larger than so many times the one measured, and the other rate is of so small a part
of it."""
FEWEST: Final = 3  # Candidates of the smallest gallery that a rate is read of.
_STEPS = 60
_ENDS = np.log([1e-6, 1e9])


def predicted_rank1(
    *, small: Floats, large: Floats, sizes: tuple[int, int], gallery: int
) -> Floats:
    """Return rank 1 in a `gallery` by the law through two rates, (B,), of galleries of two `sizes`.

    1 where the larger has no failure, 0 where it has no hit.

    Raises ValueError unless 2 <= sizes[0] < sizes[1] <= gallery.
    """
    if not 2 <= sizes[0] < sizes[1] <= gallery:  # noqa: PLR2004 - a mate and an impostor
        raise ValueError(f"galleries must grow from 2, got {sizes} and {gallery}")
    first, second, wanted = (float(one - 1) for one in (*sizes, gallery))
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(np.clip(large, 0.0, 1.0))
        steepness = np.nan_to_num(logs / np.log(np.clip(small, 0.0, 1.0)), nan=1.0, posinf=np.inf)
    # The ratio of both logarithms grows with b, from 1 to that of the galleries.
    low, high = np.full(large.shape, _ENDS[0]), np.full(large.shape, _ENDS[1])
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        scale = np.exp(middle)
        below = np.log1p(second / scale) < steepness * np.log1p(first / scale)
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    scale = np.exp(0.5 * (low + high))
    found = np.exp(logs * (np.log1p(wanted / scale) / np.log1p(second / scale)))
    return np.asarray(np.where(np.isnan(large) | np.isnan(small), np.nan, found))


def reach(measured: int) -> int:
    """Return the largest gallery that is predicted from one that was measured; 0 for none.

    At most `REACH` times as large, and such that the same step could be tried within what was
    measured: from galleries of `FEWEST` and more.
    """
    most = min(REACH * measured, measured * measured // (REACH * FEWEST))
    return most if most > measured else 0
