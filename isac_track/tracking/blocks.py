"""Intervals over blocks of a recording and seeds of its sensing.

They say how a number varies within the recording and over draws of the network's
errors. Another recording may differ by more.
"""

from collections.abc import Callable

import numpy as np

from isac_track.intervals import (
    LEAST_CLUSTERS,
    Estimate,
    cluster_weights,
    effective_clusters,
    estimate_from_replicates,
)
from isac_track.patrols.equal_alarms import AlarmCurve, drawn_misses
from isac_track.tracking.hota import hota_from_sums
from isac_track.types import Floats, Ints

_REPLICATES = 2000
_AT_A_TIME = 200  # Replicates of some thousand rows each.


def block_numbers(t: Floats, *, start_s: float, block_s: float) -> Ints:
    """Return the block of each instant, (M,)."""
    return np.floor((t - start_s) / block_s).astype(np.int64)


def _drawn_weights(n_blocks: int, n_seeds: int, *, seed: int) -> list[Floats]:
    """Return how often blocks and seeds are drawn, (1 + R, B) and (1 + R, S).

    The first row draws each once: it gives the estimate.
    """
    return [
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


def _block_estimate(
    values: Floats, by_block: Floats, *, is_share: bool = False
) -> Estimate:
    """Return the estimate of a value and its replicates, (1 + R,).

    `by_block`, (B,), says how much each block counts: with few effective blocks there
    is no interval, nor for a share of 0 or 1.
    """
    effective, n = effective_clusters(by_block), int((by_block > 0).sum())
    if effective < LEAST_CLUSTERS or (is_share and values[0] in (0.0, 1.0)):
        return Estimate(
            float(values[0]), n=n, replicates=values[1:], effective=effective
        )
    return estimate_from_replicates(values, n=n, effective=effective)


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
    blocks, seeds = _drawn_weights(n_blocks, n_seeds, seed=seed)
    top, bottom = (
        ((blocks @ part) * seeds).sum(axis=1) for part in (numerator, denominator)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        values = top / bottom
    return _block_estimate(values, denominator.sum(axis=1), is_share=is_share)


def block_missed_at_equal_alarms(
    *, alarms: Floats, warned: Floats, allowed: Floats, seed: int
) -> Estimate:
    """Return the share of future conflicts missed at the false alarms of a reference.

    `alarms`, (D, B, S), and `warned`, (D + 1, B, S), are those of
    `isac_track.tracking.counts.AlarmBlocks`; `allowed`, (B, S), are the reference's
    queries with a false alarm. As `isac_track.patrols.equal_alarms`, with an interval
    as in `block_ratio`: every replicate sets an alarm distance of its own.
    """
    n_distances, n_blocks, n_seeds = alarms.shape
    blocks, seeds = _drawn_weights(n_blocks, n_seeds, seed=seed)
    weights = (blocks[:, :, None] * seeds[:, None, :]).reshape(len(blocks), -1)
    trials = warned.sum(axis=0)
    missed = trials - np.cumsum(warned[:-1], axis=0)
    curve = AlarmCurve(
        alarms=alarms.reshape(n_distances, -1),
        missed=missed.reshape(n_distances, 1, -1),
        trials=trials.reshape(1, -1),
    )
    values = drawn_misses(
        curve,
        reference=allowed.reshape(-1),
        people=np.ones((len(weights), 1)),
        routes=weights,
    )
    return _block_estimate(values, trials.sum(axis=1))


def block_hota(*, association: Floats, n_union: Floats, seed: int) -> Estimate:
    """Return HOTA of its parts, (A, B, S), with an interval as in `block_ratio`."""
    blocks, seeds = _drawn_weights(*n_union.shape[1:], seed=seed)
    sums = [
        np.einsum("abs,rb,rs->ra", part, blocks, seeds, optimize=True)
        for part in (association, n_union)
    ]
    values = hota_from_sums(*sums)
    return _block_estimate(values, n_union[0].sum(axis=1), is_share=True)


def block_statistic(
    statistic: Callable[[Floats], Floats],
    *,
    block: Ints,
    seed_number: Ints,
    counted: Floats,
    seed: int,
) -> Estimate:
    """Return a statistic of weights, (R, K) -> (R,), with an interval as `block_ratio`.

    Each of K rows has a `block` and a `seed_number`; `counted`, (B, S), says how many
    rows with a weight there are in each block.
    """
    blocks, seeds = _drawn_weights(*counted.shape, seed=seed)
    parts = [
        statistic(blocks[rows][:, block] * seeds[rows][:, seed_number])
        for rows in (
            slice(first, first + _AT_A_TIME)
            for first in range(0, len(blocks), _AT_A_TIME)
        )
    ]
    values = np.concatenate(parts)
    return _block_estimate(values, counted.sum(axis=1))
