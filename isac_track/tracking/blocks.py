"""Intervals over blocks of a recording and seeds of its sensing.

They say how a number varies within the recording and over draws of the network's
errors. Another recording may differ by more.
"""

import numpy as np

from isac_track.intervals import (
    LEAST_CLUSTERS,
    Estimate,
    cluster_weights,
    effective_clusters,
    estimate_from_replicates,
)
from isac_track.types import Floats, Ints

_REPLICATES = 2000


def block_numbers(t: Floats, *, start_s: float, block_s: float) -> Ints:
    """Return the block of each instant, (M,)."""
    return np.floor((t - start_s) / block_s).astype(np.int64)


def block_ratio(
    *, numerator: Floats, denominator: Floats, seed: int, is_share: bool = True
) -> Estimate:
    """Return sum(numerator) / sum(denominator), (B, S) over B blocks and S seeds.

    The 95 % interval draws blocks and seeds with replacement, independently (Owen,
    Annals of Applied Statistics 1(2), 2007). Draws are the same for all ratios of so
    many blocks and seeds, so that comparisons are paired. Below `LEAST_CLUSTERS`
    effective blocks there is no interval, nor for a share of 0 or 1.
    """
    n_blocks, n_seeds = denominator.shape
    weights = [
        np.concatenate(
            [
                np.ones((1, n)),
                cluster_weights(
                    n_clusters=n,
                    n_replicates=_REPLICATES,
                    seed=seed,
                    stream_names=(name,),
                ),
            ]
        )
        for name, n in (("blocks", n_blocks), ("sensing seeds", n_seeds))
    ]
    top, bottom = (
        ((weights[0] @ part) * weights[1]).sum(axis=1)
        for part in (numerator, denominator)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        values = top / bottom
    by_block = denominator.sum(axis=1)
    effective = effective_clusters(by_block)
    n = int((by_block > 0).sum())
    if effective < LEAST_CLUSTERS or (is_share and values[0] in (0.0, 1.0)):
        return Estimate(
            float(values[0]), n=n, replicates=values[1:], effective=effective
        )
    return estimate_from_replicates(values, n=n, effective=effective)
