"""Success of the strongest linker of each task over the gallery's size: `gallery.csv`.

Up to the smallest gallery that all probes were compared with, every number is measured:
the mean over all galleries of that size that could be drawn, without companions. Rank 1
in larger galleries is predicted; the TPR is of pairs and does not depend on the size.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from evaluation.estimates.keys import EstimatesByAddress
from evaluation.estimates.linked_people import LinkedProbes
from evaluation.estimates.metrics import RANK1
from evaluation.estimates.recordings import in_run
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
    estimates: EstimatesByAddress,
    *,
    dataset: str,
    seed: int,
) -> pd.DataFrame:
    """Return rank 1, TPR and expected rank over the gallery's size: `COLUMNS`.

    `probes` is the result of `read_probes`, `estimates` are those of all linkers.
    """
    rows: list[tuple[Any, ...]] = []
    for task, levels in probes.items():
        if not levels:
            continue
        n, name = len(levels[0].clusters), ("gallery", task)
        weights = intervals.cluster_weights(
            n_clusters=n, n_replicates=_DRAWS, seed=seed, stream_names=name
        )
        for linked in levels:
            about = (
                in_run(linked.linker, dataset=dataset).dataset,
                linked.mechanism,
                np.nan if linked.level is None else linked.level,
                linked.linker.consumer,
                linked.linker.adversary,
            )
            measure = linked.linker.measured(TPR)
            tpr = estimates.get(measure.at(linked.mechanism, linked.level))
            for row in _sizes(linked, weights, tpr):
                estimate = row.estimate
                if np.isfinite(estimate.value):
                    ends = estimate.value, estimate.ci_low, estimate.ci_high
                    rows.append((*about, row.size, row.metric, *ends, row.is_predicted))
    return pd.DataFrame(rows, columns=COLUMNS)


class _SizeRow(NamedTuple):
    """A metric at a size of the gallery."""

    size: int
    metric: str
    estimate: Estimate
    is_predicted: bool  # Whether the size is beyond the largest gallery measured.


def _sizes(
    probes: LinkedProbes, weights: Floats, tpr: Estimate | None
) -> Iterator[_SizeRow]:
    """Yield the metrics at each size of the gallery."""
    above, tied, candidates = probes.strangers
    measured = int(candidates.min()) if candidates.size else 0
    larger = [size for size in SIZES if measured < size <= reach(measured)]
    within = sorted(size for size in {*SIZES, measured} if 1 < size <= measured)
    # `_predicted` tries each step within the measured gallery, and needs a tenth of it.
    tried = [measured * measured // size for size in larger]
    tenths = (max(2, size // REACH) for size in (*tried, measured) if larger)
    needed = sorted({*within, *tried, *tenths})
    hits = [first_among(probes.strangers, size) for size in needed]
    rank1_by_size = dict(zip(needed, _means(probes, hits, weights), strict=True))
    (ahead,) = _means(
        probes, [(above + 0.5 * (tied - 1)) / np.maximum(candidates - 1, 1)], weights
    )
    for size in [*within, *larger]:
        if size <= measured:
            rank1 = rank1_by_size[size]
        else:
            rank1 = _predicted(rank1_by_size, measured, size)
        is_predicted = size > measured
        yield _SizeRow(size, RANK1, rank1, is_predicted)
        ends = ahead.value, ahead.ci_low, ahead.ci_high
        value, low, high = (1.0 + (size - 1) * end for end in ends)
        expected = Estimate(value, low, high)
        yield _SizeRow(size, "expected_rank", expected, is_predicted)
        if tpr is not None:
            yield _SizeRow(size, TPR, tpr, is_predicted)


def _predicted(
    rank1_by_size: Mapping[int, Estimate], measured: int, size: int
) -> Estimate:
    """Return rank 1 in a larger gallery, corrected by the same step's error within.

    A step is predicted from a gallery and a tenth of it. The same step is tried up to
    the gallery that was measured; its error divides the prediction, and widens the
    interval on both sides.
    """

    def step(start: int, end: int) -> Floats:
        sizes = max(2, start // REACH), start
        small, large = (rank1_by_size[gallery].drawn for gallery in sizes)
        return predicted_rank1(small=small, large=large, sizes=sizes, gallery=end)

    trial = step(measured * measured // size, measured)
    predicted = step(measured, size)
    known = rank1_by_size[measured].drawn
    factor = np.divide(known, trial, out=np.ones_like(trial), where=trial > 0.0)
    # No larger gallery is easier.
    corrected = np.minimum(predicted * factor, known)
    changed = abs(float(predicted[0] - corrected[0]))
    low, high = np.nan, np.nan
    if rank1_by_size[measured].n_effective >= intervals.LEAST_CLUSTERS:
        low, high = intervals.percentile_interval(corrected[1:])
        low = max(0.0, low - changed)
        high = min(high + changed, rank1_by_size[measured].ci_high)
    return Estimate(float(corrected[0]), low, high)


def _means(
    probes: LinkedProbes, numbers: Sequence[Floats], weights: Floats
) -> list[Estimate]:
    """Return the mean of each of some numbers of the probes, (N,) each."""
    if not numbers or not probes.cluster.size:
        return [Estimate(np.nan) for _ in numbers]
    summed = partial(
        intervals.cluster_sums, cluster=probes.cluster, n_clusters=len(probes.clusters)
    )
    *sums, count = (
        summed(values=values) for values in (*numbers, np.ones(probes.cluster.size))
    )
    return intervals.ratio_estimates(
        numerator=np.stack(sums),
        denominator=np.tile(count, (len(numbers), 1)),
        weights=weights,
        is_share=[True] * len(numbers),
    )
