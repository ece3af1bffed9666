"""How many candidates there are, and how often the right one comes first: `gallery.csv`.

Of the strongest linker of each task. Up to the smallest gallery that all probes were
compared with, every number is measured: the mean over all galleries of that size that
could be drawn, without companions. Rank 1 in larger ones is predicted; the TPR is of
pairs and does not depend on the size.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
import pandas as pd

from evaluation.estimates.keys import Found
from evaluation.estimates.linkability import dataset_of
from evaluation.estimates.linked_people import LinkedProbes
from isac_track import intervals
from isac_track.intervals import Estimate
from isac_track.linkability.ranks import REACH, first_among, predicted_rank1, reach
from isac_track.types import Floats

SIZES: Final = (10, 30, 100, 300, 1000, 3000, 7545)
COLUMNS = [
    "dataset",
    "mechanism",
    "level",
    "consumer",
    "knowledge",
    "gallery",
    "metric",
    "value",
    "ci_low",
    "ci_high",
    "predicted",
]
_DRAWS = 400
TPR: Final = "tpr_at_fpr_1pct"


def galleries(
    probes: Mapping[str, Sequence[LinkedProbes]],
    found: Found,
    *,
    dataset: str,
    seed: int,
) -> pd.DataFrame:
    """Return rank 1, TPR and expected rank over the gallery's size; the columns are `COLUMNS`.

    `probes` is what `read_probes` returns, `found` all estimates of linkers.
    """
    rows: list[tuple[Any, ...]] = []
    for task, levels in probes.items():
        if not levels:
            continue
        n, name = len(levels[0].clusters), ("gallery", task)
        weights = intervals.cluster_weights(
            n_clusters=n, n_replicates=_DRAWS, seed=seed, of=name
        )
        for one in levels:
            own = dataset_of(one.linker.consumer, dataset=dataset)
            about = (
                own,
                one.mechanism,
                np.nan if one.level is None else one.level,
                *one.linker,
            )
            tpr = found.get(one.linker.measure(TPR).at(one.mechanism, one.level))
            rows += [
                (*about, size, metric, of.value, of.ci_low, of.ci_high, size > measured)
                for measured, size, metric, of in _of_level(one, weights, tpr)
                if np.isfinite(of.value)
            ]
    return pd.DataFrame(rows, columns=COLUMNS)


def _of_level(
    one: LinkedProbes, weights: Floats, tpr: Estimate | None
) -> Iterator[tuple[int, int, str, Estimate]]:
    """Yield the largest gallery measured, a size, a metric and its estimate."""
    above, tied, candidates = one.strangers
    measured = int(candidates.min()) if candidates.size else 0
    steps = [size for size in SIZES if measured < size <= reach(measured)]
    within = sorted(size for size in {*SIZES, measured} if 1 < size <= measured)
    tried = [measured * measured // size for size in steps]  # see `_predicted`
    parts = (max(2, size // REACH) for size in (*tried, measured) if steps)
    every = sorted({*within, *tried, *parts})
    rates = _ratios(one, [first_among(one.strangers, size) for size in every], weights)
    first = dict(zip(every, rates, strict=True))
    (ahead,) = _ratios(
        one, [(above + 0.5 * (tied - 1)) / np.maximum(candidates - 1, 1)], weights
    )
    for size in [*within, *steps]:
        rank1 = first[size] if size <= measured else _predicted(first, measured, size)
        yield measured, size, "rank1", rank1
        ends = ahead.value, ahead.ci_low, ahead.ci_high
        value, low, high = (1.0 + (size - 1) * end for end in ends)
        yield measured, size, "expected_rank", Estimate(value, low, high)
        if tpr is not None:
            yield measured, size, TPR, tpr


def _predicted(first: Mapping[int, Estimate], measured: int, size: int) -> Estimate:
    """Return rank 1 in a larger gallery, corrected by what the same step misses within.

    A step is predicted from one gallery and a tenth of it. The same one is tried up to
    the gallery that was measured; its miss divides the prediction, and widens the
    interval on both sides.
    """

    def step(of: int, to: int) -> Floats:
        sizes = max(2, of // REACH), of
        small, large = (first[one].drawn for one in sizes)
        return predicted_rank1(small=small, large=large, sizes=sizes, gallery=to)

    trial, found = step(measured * measured // size, measured), step(measured, size)
    known = first[measured].drawn
    factor = np.divide(known, trial, out=np.ones_like(trial), where=trial > 0.0)
    corrected = np.minimum(found * factor, known)  # no larger gallery is easier
    changed = abs(float(found[0] - corrected[0]))
    low, high = np.nan, np.nan
    if first[measured].n_effective >= intervals.LEAST_CLUSTERS:
        low, high = intervals.percentile_interval(corrected[1:])
        low, high = (
            max(0.0, low - changed),
            min(high + changed, first[measured].ci_high),
        )
    return Estimate(float(corrected[0]), low, high)


def _ratios(one: LinkedProbes, of: Sequence[Floats], weights: Floats) -> list[Estimate]:
    """Return the means of some values of each probe, (N,)."""
    if not of or not one.cluster.size:
        return [Estimate(np.nan) for _ in of]
    summed = partial(
        intervals.cluster_sums, cluster=one.cluster, n_clusters=len(one.clusters)
    )
    *sums, count = (
        summed(values=values) for values in (*of, np.ones(one.cluster.size))
    )
    over, under = np.stack(sums), np.tile(count, (len(of), 1))
    return intervals.ratio_estimates(
        numerator=over, denominator=under, weights=weights, is_share=[True] * len(of)
    )
