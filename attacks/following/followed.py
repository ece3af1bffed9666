"""The metrics of being followed, each a number with its two-way interval.

A two-way interval draws both the people and the routes of the fleets anew.

References
----------
Hoh, Gruteser, Xiong, Alrabady, "Preserving privacy in GPS traces via uncertainty-aware
path cloaking", CCS 2007 (time to confusion). Kaplan, Meier, JASA 53, 1958.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from attacks.following.logs import Ending, Following
from isac_track.intervals import (
    LEAST_CLUSTERS,
    Estimate,
    effective_clusters,
    estimate_from_replicates,
)
from isac_track.patrols.intervals import (
    FEWEST_ROUTES,
    cluster_numbers,
    sum_clusters,
    two_way_ratio,
    two_way_weights,
)
from isac_track.types import Bools, Floats, Ints

LONGEST_S: Final = 30.0  # Times to confusion are averaged up to here.
_QUANTILE: Final = 0.9
_AT_A_TIME: Final = 200  # Replicates, of some megabytes each.


class _Ratio(NamedTuple):
    """A metric that is a ratio of sums over N people and F fleets."""

    numerator: Floats | Ints | Bools  # (N, F)
    denominator: Floats | Bools  # (N, F)
    is_share: bool  # Whether it lies in 0..1.


def following_metrics(
    following: Following, *, group: tuple[str, ...], seed: int
) -> dict[str, Estimate]:
    """Return the metrics of being followed, by name.

    `group` names each person's cluster. The metrics are:

    - `known_share`: person-time at which a chain states a person's place within
      epsilon.
    - `followed_s`: mean time within one pure chain, s; `followed_90_s`: its 90 %
      quantile; `followed_ceiling_s`: the mean with true identities.
    - `followed_10s`, `followed_30s`: share followed so long, of people present so long.
    - `time_to_confusion_s`: mean time to confusion, s, up to `LONGEST_S`, of the people
      seen.
    - `confident_wrong_share`: share of the people seen that end in a sure and wrong
      link.
    """
    cluster = cluster_numbers(group)
    n_people, n_fleets = following.followed_s.shape
    everybody = np.ones((n_people, n_fleets))
    seen = following.ending != Ending.UNSEEN
    instants = following.instants[:, None] * everybody
    ratios = {
        "known_share": _Ratio(following.known, instants, is_share=True),
        "followed_s": _Ratio(following.followed_s, everybody, is_share=False),
        "followed_ceiling_s": _Ratio(following.ceiling_s, everybody, is_share=False),
        "confident_wrong_share": _Ratio(
            following.ending == Ending.WRONG, seen, is_share=True
        ),
    }
    for limit_s in (10, 30):
        is_present = following.present_s[:, None] >= limit_s
        present = np.broadcast_to(is_present, everybody.shape)
        reached = present & (following.followed_s >= limit_s)
        ratios[f"followed_{limit_s}s"] = _Ratio(reached, present, is_share=True)
    metrics = {
        name: two_way_ratio(
            numerator=sum_clusters(ratio.numerator, cluster),
            denominator=sum_clusters(ratio.denominator, cluster),
            seed=seed,
            is_share=ratio.is_share,
        )
        for name, ratio in ratios.items()
    }
    metrics["followed_90_s"] = _weighted_statistic(
        lambda weights: _weighted_quantile(following.followed_s.ravel(), weights),
        counted=everybody,
        cluster=cluster,
        seed=seed,
    )
    is_confused = (following.ending == Ending.CONFUSED).ravel()
    metrics["time_to_confusion_s"] = _weighted_statistic(
        lambda weights: restricted_mean_s(
            following.until_s.ravel(), is_confused, weights
        ),
        counted=seen.astype(np.float64),
        cluster=cluster,
        seed=seed,
    )
    return metrics


def _weighted_statistic(
    statistic: Callable[[Floats], Floats], *, counted: Floats, cluster: Ints, seed: int
) -> Estimate:
    """Return a statistic of weights, (B, N F) -> (B,), with its two-way interval.

    `counted`, (N, F), weighs people and fleets before replicates are drawn.
    """
    sizes = sum_clusters(counted, cluster)
    people, routes = two_way_weights(
        n_clusters=len(sizes), n_routes=sizes.shape[1], seed=seed
    )
    parts = []
    for first in range(0, len(people), _AT_A_TIME):
        rows = slice(first, first + _AT_A_TIME)
        weights = people[rows][:, cluster, None] * routes[rows][:, None, :] * counted
        parts.append(statistic(weights.reshape(len(weights), -1)))
    drawn = np.concatenate(parts)
    effective = effective_clusters(sizes.sum(axis=1))
    n = int((sizes.sum(axis=1) > 0).sum())
    # Too few routes or people: their replicates show too little spread for an interval.
    if (sizes.sum(axis=0) > 0).sum() < FEWEST_ROUTES or effective < LEAST_CLUSTERS:
        return Estimate(float(drawn[0]), n=n, replicates=drawn[1:], effective=effective)
    return estimate_from_replicates(drawn, n=n, effective=effective)


def _weighted_quantile(values: Floats, weights: Floats) -> Floats:
    """Return the 90 % quantile of values, (K,), under each row of weights, (B, K)."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[:, order], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = total / total[:, -1:]
    return np.asarray(values[order][(share >= _QUANTILE).argmax(axis=1)])


def restricted_mean_s(until_s: Floats, is_event: Bools, weights: Floats) -> Floats:
    """Return the mean time to an event under each row of weights, (B, K) -> (B,) s.

    It is the area under Kaplan and Meier's curve up to `LONGEST_S`. Of the K times
    `until_s`, those without an event are censored. NaN where all weights are 0.
    """
    # At equal times, events come before censored times.
    order = np.lexsort((~np.asarray(is_event, dtype=bool), until_s))
    times, events = until_s[order], np.asarray(is_event, dtype=np.float64)[order]
    drawn = weights[:, order]
    at_risk = np.cumsum(drawn[:, ::-1], axis=1)[:, ::-1]
    with np.errstate(invalid="ignore", divide="ignore"):
        survival = np.cumprod(
            np.where(at_risk > 0.0, 1.0 - drawn * events / at_risk, 1.0), axis=1
        )
    # The curve is a step function: its height up to each time, and from the last time
    # to `LONGEST_S`.
    height = np.column_stack([np.ones(len(drawn)), survival])
    ends_s = np.minimum(np.append(times, LONGEST_S), LONGEST_S)
    area = height @ np.diff(ends_s, prepend=0.0)
    return np.where(drawn.sum(axis=1) > 0.0, area, np.nan)
