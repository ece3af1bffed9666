"""Intervals of ratios over people and routes, which are drawn independently.

An estimate on patrols rests on which people were recorded and on which routes robots
took. The pigeonhole bootstrap draws both with replacement and is conservative (Owen,
Annals of Applied Statistics 1(2), 2007, 386-411).
"""

from typing import Final

import numpy as np

from isac_track.intervals import (
    LEAST_CLUSTERS,
    Estimate,
    cluster_weights,
    effective_clusters,
    estimate_from_replicates,
    wilson,
)
from isac_track.types import Bools, Floats, Ints

# Least number of independent routes, or fleets, for an interval.
FEWEST_ROUTES: Final = 20
REPLICATES: Final = 2000  # Bootstrap replicates.


def cluster_numbers(group: tuple[str, ...]) -> Ints:
    """Return the cluster of each person, (N,), numbered by first appearance."""
    number: dict[str, int] = {}
    return np.array([number.setdefault(name, len(number)) for name in group])


def sum_clusters(values: Floats | Ints | Bools, cluster: Ints) -> Floats:
    """Return the sums of rows within each cluster, (N, F) -> (C, F)."""
    sums = np.zeros((int(cluster.max(initial=-1)) + 1, values.shape[1]))
    np.add.at(sums, cluster, values)
    return sums


def two_way_weights(
    *, n_clusters: int, n_routes: int, seed: int, n_replicates: int = REPLICATES
) -> tuple[Floats, Floats]:
    """Return how often each cluster and each route is drawn, (1 + B, C) and (1 + B, F).

    The first row draws each once: it gives the estimate. Below `FEWEST_ROUTES` routes,
    where there is no interval, it is the only row.
    """
    if n_routes < FEWEST_ROUTES:
        return np.ones((1, n_clusters)), np.ones((1, n_routes))
    people = cluster_weights(
        n_clusters=n_clusters,
        n_replicates=n_replicates,
        seed=seed,
        stream_names=("people",),
    )
    routes = cluster_weights(
        n_clusters=n_routes,
        n_replicates=n_replicates,
        seed=seed,
        stream_names=("routes",),
    )
    return (
        np.concatenate([np.ones((1, n_clusters)), people]),
        np.concatenate([np.ones((1, n_routes)), routes]),
    )


def two_way_ratio(
    *,
    numerator: Floats,
    denominator: Floats,
    seed: int,
    n_replicates: int = REPLICATES,
    is_share: bool = True,
) -> Estimate:
    """Return sum(numerator) / sum(denominator) with its two-way interval.

    Both are (C, F), sums within C clusters of people and F routes; the numerator of a
    share never exceeds its denominator. Draws are the same for all ratios of C clusters
    and F routes, so that comparisons are paired. `n` counts clusters with a
    denominator. A share of 0 or 1 has Wilson's interval. If all denominators are 0
    there is no number; below `FEWEST_ROUTES` routes or `LEAST_CLUSTERS` effective
    clusters there is no interval.
    """
    n_clusters, n_routes = denominator.shape
    people, routes = two_way_weights(
        n_clusters=n_clusters, n_routes=n_routes, seed=seed, n_replicates=n_replicates
    )
    drawn_numerator = ((people @ numerator) * routes).sum(axis=1)
    drawn_denominator = ((people @ denominator) * routes).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        values = drawn_numerator / drawn_denominator
    by_cluster, by_route = denominator.sum(axis=1), denominator.sum(axis=0)
    effective = effective_clusters(by_cluster)
    n = int((by_cluster > 0).sum())
    estimate = estimate_from_replicates(values, n=n, effective=effective)
    if (by_route > 0).sum() < FEWEST_ROUTES or effective < LEAST_CLUSTERS:
        return Estimate(estimate.value, n=n, replicates=values[1:], effective=effective)
    if is_share and estimate.value in (0.0, 1.0):
        n_trials = min(effective, effective_clusters(by_route))
        ends = wilson(hits=estimate.value * n_trials, n=n_trials)
        return Estimate(estimate.value, *ends, n, values[1:], effective=effective)
    return estimate
