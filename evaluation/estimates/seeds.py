"""One number of runs that differ in their seed alone: its mean over the seeds, with an interval.

The people are the same in all of these runs, so that more seeds do not make them more:
a person leaves all runs at once. What a seed changes for all people together, such as
the robot's place in the scenes or who trains an attack, differs between the runs by
more than the people's own draws explain; that part is estimated and added.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.special import expit, logit, ndtri, stdtrit

from evaluation.compute.link_scores import COMPANIONS
from evaluation.estimates.metrics import SUCCESS, SUCCESS_OF_100
from evaluation.estimates.summary import columns_of, ratios
from evaluation.store.cell_files import read_rows
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
_OF_PROBES: Final = ("group", "above", "tied", "chance", *COMPANIONS)


def over_seeds(sums: Floats, *, is_share: bool = True) -> Estimate:
    """Return the ratio of sums over all runs, with its interval.

    `sums`, (S, 2, C), are numerator and denominator of each run within each cluster of
    people. The variance is the delete-one-cluster jackknife's of the pooled ratio, and,
    of the S runs, the variance between them beyond what two runs of the same people
    differ by (by the jackknife of their differences), over S. Student's t has the
    degrees of freedom of both (Satterthwaite, Biometrics Bulletin 2, 1946). Of fewer
    than `LEAST_CLUSTERS` effective clusters there is no interval; that of exactly 0 or
    1 is Wilson's.
    """
    sums = sums[:, :, (sums[:, 1] > 0.0).any(axis=0)]
    n_runs, _, n = sums.shape
    without = sums.sum(axis=2, keepdims=True) - np.concatenate(
        [np.zeros((n_runs, 2, 1)), sums], 2
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        each = (
            without[:, 0] / without[:, 1]
        )  # (S, 1 + C) of each run: all, and without a cluster
        whole = without[:, 0].sum(axis=0) / without[:, 1].sum(axis=0)
    value, effective = float(whole[0]), effective_clusters(sums[:, 1].sum(axis=0))
    if not (math.isfinite(value) and effective >= LEAST_CLUSTERS):
        return Estimate(value, n=n, effective=effective)
    if is_share and value in (0.0, 1.0):
        return Estimate(
            value, *wilson(hits=value * effective, n=effective), n, effective=effective
        )
    people_variance, seed_variance = _jackknife_variance(whole), 0.0
    if n_runs > 1:
        pairs = combinations(each, 2)
        apart = float(
            np.mean([_jackknife_variance(first - second) for first, second in pairs])
        )
        seed_variance = max(0.0, float(each[:, 0].var(ddof=1)) - 0.5 * apart) / n_runs
    parts = (people_variance, effective - 1.0), (seed_variance, n_runs - 1.0)
    ends = _interval(value, parts, is_share=is_share)
    return Estimate(value, *ends, n, effective=effective)


def by_intervals(estimates: Sequence[Estimate]) -> Estimate:
    """Return the mean over runs of a number that is no ratio of sums over people.

    Either end is as far off as those of the runs (root mean square), for the people are
    the same, and as the variance between the runs over their number makes it: too far
    by what a person's own draws differ, which is in both. So few runs know that
    variance badly: Student's t has the degrees of freedom of both parts
    (Satterthwaite). NaN where a run has no interval.
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
    """Return how far an end is off by those of the runs, (S,), and the variance between them."""
    people = float((distances**2).mean()) / float(ndtri(_TAIL)) ** 2
    if not between > 0.0:
        return math.sqrt(people) * float(ndtri(_TAIL))
    freedom = (n_runs - 1.0) * ((people + between) / between) ** 2
    return float(stdtrit(freedom, _TAIL)) * math.sqrt(people + between)


def _jackknife_variance(values: Floats) -> float:
    """Return the delete-one-cluster variance of (1 + C,) values: of all, and without each."""
    n = values.size - 1
    return (n - 1.0) / n * float(np.nansum((values[1:] - values[0]) ** 2))


def _interval(
    value: float, parts: Sequence[tuple[float, float]], *, is_share: bool
) -> tuple[float, float]:
    """Return the interval of a number by parts of its variance, each with degrees of freedom."""
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
    """Return the sums of people by name as an array, (S, 2, C): who is not in a run has 0 there."""
    names = sorted(set().union(*runs))
    return np.array(
        [np.transpose([run.get(name, (0.0, 0.0)) for name in names]) for run in runs]
    )


def read_sums(
    out: Path, entry: Mapping[str, Any], metric: str
) -> dict[str, tuple[float, float]] | None:
    """Return numerator and denominator of a metric of a cell by the name of a cluster of people.

    `entry` is a run's entry of the cell. None if the metric is no ratio of sums over
    people, or was refused. Raises DataError if the cell cannot be read.
    """
    if entry["kind"] == "linkage":
        table = read_rows(out, entry, columns=_OF_PROBES)
        counts = {name: table[name].to_numpy() for name in _OF_PROBES[1:]}
        over, under = _hits(counts, metric)
    else:
        table = read_rows(out, entry, columns=columns_of(entry["kind"]))
        over, under = ratios(entry["kind"], table).get(metric, (None, None))
    if over is None or under is None or not np.isfinite(over).all():
        return None
    names, cluster = np.unique(
        table["group"].to_numpy().astype(str), return_inverse=True
    )
    sums = (
        cluster_sums(values=values, cluster=cluster, n_clusters=names.size)
        for values in (over, under)
    )
    return dict(
        zip(
            names.tolist(),
            zip(*(both.tolist() for both in sums), strict=True),
            strict=True,
        )
    )


def _hits(
    counts: Mapping[str, Floats], metric: str
) -> tuple[Floats | None, Floats | None]:
    """Return how often each probe's mate comes first, (P,), and which probes have one."""
    is_mated = counts["above"] >= 0
    some = {name: values[is_mated] for name, values in counts.items()}
    above, tied, *along = (
        some[name].astype(np.int64) for name in ("above", "tied", *COMPANIONS)
    )
    if metric == SUCCESS:
        hit = expected_hit(above, tied)
    elif metric == SUCCESS_OF_100:
        strangers = among_strangers(
            above, tied, some["chance"], np.stack(along, axis=1)
        )
        hit = first_among(strangers)
    else:
        return None, None
    hits = np.zeros(is_mated.size)
    hits[is_mated] = hit
    return hits, is_mated.astype(np.float64)
