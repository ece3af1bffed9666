"""Mean over seeds of a number from runs that differ in their seed alone, with interval.

The people are the same in all of these runs: more seeds do not make more people, and a
person is left out of all runs at once. A seed also changes things for all people
together, such as the robot's place in the scenes or the people who train an attack. The
runs then differ by more than the people's own draws explain; that part of the variance
is estimated and added.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np
from scipy.special import expit, logit, ndtri, stdtrit

from evaluation.compute.link_tables import COMPANIONS
from evaluation.estimates.metrics import RANK1, RANK1_AMONG_100
from evaluation.estimates.summary import cell_columns, ratios
from evaluation.store.cell_files import read_rows
from evaluation.store.entries import Entry
from isac_track.intervals import (
    CONFIDENCE,
    LEAST_CLUSTERS,
    Estimate,
    cluster_sums,
    effective_clusters,
    wilson,
)
from isac_track.linkability.ranks import among_strangers, expected_hit, first_among
from isac_track.types import Floats

_TAIL: Final = 0.5 + CONFIDENCE / 2.0
_PROBE_COLUMNS: Final = ("group", "above", "tied", "chance", *COMPANIONS)


def over_seeds(sums: Floats, *, is_share: bool = True) -> Estimate:
    """Return the ratio of sums over all runs, with its interval.

    `sums`, (S, 2, C), are numerator and denominator of each run within each cluster of
    people. The variance has two parts. The first is the delete-one-cluster jackknife's
    of the pooled ratio. The second is the variance between the S runs over S, less the
    part that the people's own draws explain (from the jackknife of the runs'
    differences). Student's t has the degrees of freedom of both (Satterthwaite,
    Biometrics Bulletin 2, 1946). With fewer than `LEAST_CLUSTERS` effective clusters
    there is no interval; that of exactly 0 or 1 is Wilson's.
    """
    sums = sums[:, :, (sums[:, 1] > 0.0).any(axis=0)]
    n_runs, _, n = sums.shape
    without = sums.sum(axis=2, keepdims=True) - np.concatenate(
        [np.zeros((n_runs, 2, 1)), sums], 2
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        # (S, 1 + C) ratio of each run: of all clusters, and without each cluster.
        rates = without[:, 0] / without[:, 1]
        pooled = without[:, 0].sum(axis=0) / without[:, 1].sum(axis=0)
    value, effective = float(pooled[0]), effective_clusters(sums[:, 1].sum(axis=0))
    if not (math.isfinite(value) and effective >= LEAST_CLUSTERS):
        return Estimate(value, n=n, effective=effective)
    if is_share and value in (0.0, 1.0):
        return Estimate(
            value, *wilson(hits=value * effective, n=effective), n, effective=effective
        )
    people_variance, seed_variance = _jackknife_variance(pooled), 0.0
    if n_runs > 1:
        variances = [
            _jackknife_variance(first - second)
            for first, second in combinations(rates, 2)
        ]
        explained = 0.5 * float(np.mean(variances))
        between = float(rates[:, 0].var(ddof=1))
        seed_variance = max(0.0, between - explained) / n_runs
    parts = (people_variance, effective - 1.0), (seed_variance, n_runs - 1.0)
    ends = _interval(value, parts, is_share=is_share)
    return Estimate(value, *ends, n, effective=effective)


def by_intervals(estimates: Sequence[Estimate]) -> Estimate:
    """Return the mean over runs of a number that is no ratio of sums over people.

    The distance to either end has two parts: the root mean square of the runs' own
    distances, since the people are the same, and the variance between the runs over
    their number. A person's own draws are in both, so that the interval is somewhat too
    wide. Few runs estimate the variance between them badly: Student's t has the degrees
    of freedom of both parts (Satterthwaite). NaN where a run has no interval.
    """
    values = np.array([run.value for run in estimates])
    below = np.array([run.value - run.ci_low for run in estimates])
    above = np.array([run.ci_high - run.value for run in estimates])
    between = float(values.var(ddof=1)) / values.size if values.size > 1 else 0.0
    n_runs, value = values.size, float(values.mean())
    low, high = (
        _distance(distances, between, n_runs=n_runs) for distances in (below, above)
    )
    return Estimate(value, value - low, value + high, min(run.n for run in estimates))


def _distance(distances: Floats, between: float, *, n_runs: int) -> float:
    """Return the distance to an end from the runs' own, (S,), and their variance."""
    people = float((distances**2).mean()) / float(ndtri(_TAIL)) ** 2
    if not between > 0.0:
        return math.sqrt(people) * float(ndtri(_TAIL))
    freedom = (n_runs - 1.0) * ((people + between) / between) ** 2
    return float(stdtrit(freedom, _TAIL)) * math.sqrt(people + between)


def _jackknife_variance(values: Floats) -> float:
    """Return the jackknife variance of (1 + C,) values: all, and leave-one-out."""
    n = values.size - 1
    return (n - 1.0) / n * float(np.nansum((values[1:] - values[0]) ** 2))


def _interval(
    value: float, parts: Sequence[tuple[float, float]], *, is_share: bool
) -> tuple[float, float]:
    """Return the interval of a number from variances, each with degrees of freedom."""
    variance = sum(part for part, _ in parts)
    if variance == 0.0:
        return value, value
    spread = sum(part**2 / freedom for part, freedom in parts if part > 0.0)
    half = float(stdtrit(variance**2 / spread, _TAIL)) * math.sqrt(variance)
    if not is_share:
        return value - half, value + half
    centre, half = float(logit(value)), half / (value * (1.0 - value))
    return float(expit(centre - half)), float(expit(centre + half))


def stacked_sums(runs: Sequence[Mapping[str, tuple[float, float]]]) -> Floats:
    """Return people's sums as an array, (S, 2, C); 0 for people not in a run."""
    names = sorted(set().union(*runs))
    return np.array(
        [np.transpose([run.get(name, (0.0, 0.0)) for name in names]) for run in runs]
    )


def read_sums(
    out: Path, entry: Entry, metric: str
) -> dict[str, tuple[float, float]] | None:
    """Return numerator and denominator of a cell's metric by the name of each cluster.

    `entry` is the cell's entry in a manifest. None if the metric is no ratio of sums
    over people, or was refused. Raises DataError if the cell cannot be read.
    """
    if entry.kind == "linkage":
        table = read_rows(out, entry, columns=_PROBE_COLUMNS)
        counts = {name: table[name].to_numpy() for name in _PROBE_COLUMNS[1:]}
        over, under = _hits(counts, metric)
    else:
        table = read_rows(out, entry, columns=cell_columns(entry.kind))
        over, under = ratios(entry.kind, table).get(metric, (None, None))
    if over is None or under is None or not np.isfinite(over).all():
        return None
    names, cluster = np.unique(
        table["group"].to_numpy().astype(str), return_inverse=True
    )
    numerators, denominators = (
        cluster_sums(values=values, cluster=cluster, n_clusters=names.size).tolist()
        for values in (over, under)
    )
    sums = zip(numerators, denominators, strict=True)
    return dict(zip(names.tolist(), sums, strict=True))


def _hits(
    counts: Mapping[str, Floats], metric: str
) -> tuple[Floats | None, Floats | None]:
    """Return each probe's share of hits, and whether it has a mate, (P,) each."""
    is_mated = counts["above"] >= 0
    mated = {name: values[is_mated] for name, values in counts.items()}
    above, tied, *along = (
        mated[name].astype(np.int64) for name in ("above", "tied", *COMPANIONS)
    )
    if metric == RANK1:
        hit = expected_hit(above, tied)
    elif metric == RANK1_AMONG_100:
        strangers = among_strangers(
            above, tied, mated["chance"], np.stack(along, axis=1)
        )
        hit = first_among(strangers)
    else:
        return None, None
    hits = np.zeros(is_mated.size)
    hits[is_mated] = hit
    return hits, is_mated.astype(np.float64)
