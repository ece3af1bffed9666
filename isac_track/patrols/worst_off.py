"""The worst-off tenth of people: chosen on some fleets, scored on others.

The highest of many noisy shares are high partly by chance. So the tenth is chosen by
the logs of one half of the fleets and scored on the other half, and the reverse.
"""

from typing import Final

import numpy as np

from isac_track.intervals import (
    LEAST_CLUSTERS,
    Estimate,
    effective_clusters,
    estimate_from_replicates,
)
from isac_track.patrols.intervals import FEWEST_ROUTES, two_way_weights
from isac_track.types import Floats, Ints

_TENTH: Final = 0.1
LEAST_FLEETS: Final = 16  # Eight for the choice, and eight for the score.


def worst_tenth(*, known: Ints, instants: Ints, cluster: Ints, seed: int) -> Estimate:
    """Return the mean known share of the worst-off tenth of people, with its interval.

    `known`, (N, F), counts the known instants of N people in the logs of F fleets, of
    `instants`, (N,); `cluster`, (N,), numbers people who walk together. Every replicate
    of the two-way interval repeats the choice. NaN below `LEAST_FLEETS` fleets. Biased
    low with few fleets, whose chance puts others among the worst-off.
    """
    n_fleets = known.shape[1]
    n_clusters = int(cluster.max(initial=-1)) + 1
    if n_fleets < LEAST_FLEETS:
        return Estimate(np.nan, n=n_clusters)
    people, routes = two_way_weights(
        n_clusters=n_clusters, n_routes=n_fleets, seed=seed
    )
    weights = people[:, cluster].T  # (N, 1 + B)
    is_even = np.arange(n_fleets) % 2 == 0
    even = _mean_shares(known[:, is_even], instants, routes[:, is_even])
    odd = _mean_shares(known[:, ~is_even], instants, routes[:, ~is_even])
    values = (_top_mean(even, odd, weights) + _top_mean(odd, even, weights)) / 2.0
    effective = effective_clusters(np.bincount(cluster).astype(np.float64))
    if n_fleets < FEWEST_ROUTES or effective < LEAST_CLUSTERS:
        value = float(values[0])
        return Estimate(value, n=n_clusters, replicates=values[1:], effective=effective)
    return estimate_from_replicates(values, n=n_clusters, effective=effective)


def _mean_shares(known: Ints, instants: Ints, routes: Floats) -> Floats:
    """Return each person's known share over weighted fleets, (N, 1 + B)."""
    drawn = routes.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((known @ routes.T) / (instants[:, None] * drawn))


def _top_mean(chosen_by: Floats, scored: Floats, weights: Floats) -> Floats:
    """Return the mean score of the tenth with the largest `chosen_by`, (1 + B,).

    All arguments are (N, 1 + B). Of people at the edge of the tenth only a part of the
    weight counts. People with equal `chosen_by` count with equal parts, so that the
    order of the rows does not matter.
    """
    order = np.argsort(-chosen_by, axis=0, kind="stable")
    ranked, weight, score = (
        np.take_along_axis(values, order, axis=0)
        for values in (chosen_by, weights, scored)
    )
    above, through = _tied_weights(ranked, weight)
    tied = through - above
    places = np.clip(_TENTH * weight.sum(axis=0) - above, 0.0, tied)
    part = np.divide(places, tied, out=np.zeros_like(tied), where=tied > 0.0)
    inside = weight * part
    return np.asarray((inside * score).sum(axis=0) / inside.sum(axis=0))


def _tied_weights(ranked: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Return the weight above the equals of each row, and through them, (N, 1 + B).

    `ranked` and `weight`, (N, 1 + B), are in falling order of `ranked`.
    """
    n_people = len(ranked)
    row = np.arange(n_people)[:, None]
    is_edge = np.ones((n_people + 1, ranked.shape[1]), dtype=bool)
    is_edge[1:-1] = ranked[1:] != ranked[:-1]
    first = np.maximum.accumulate(np.where(is_edge[:-1], row, 0), axis=0)
    last = np.where(is_edge[1:], row, n_people - 1)
    last = np.minimum.accumulate(last[::-1], axis=0)[::-1]
    total = np.cumsum(weight, axis=0)
    above = np.take_along_axis(total - weight, first, axis=0)
    return above, np.take_along_axis(total, last, axis=0)
