"""The metrics of the posterior adversary, each a number with its two-way interval."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from attacks.following.posterior import PosteriorScores
from isac_track.intervals import Estimate
from isac_track.patrols.intervals import cluster_numbers, two_way_ratio
from isac_track.types import Bools, Floats, Ints

CLAIM_EDGES: Final = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
"""Edges of the stated probabilities in a reliability table."""


@dataclass(frozen=True, slots=True)
class Reliability:
    """Instants at which the adversary states a probability between two edges."""

    low: float
    high: float
    share: float  # Of all instants.
    claimed: float  # Mean stated probability; NaN without an instant.
    known: Estimate  # Realised share.


def posterior_metrics(
    scores: PosteriorScores, *, group: tuple[str, ...], n_fleets: int, seed: int
) -> dict[str, Estimate]:
    """Return the metrics of P targets, by name; `group` names the cluster of each.

    `log_score` is the mean log density of the true place, in nats above the map's;
    `known_share` the share of instants at which the truth lies within epsilon of the
    best place, and `claimed_share` its stated probability.
    """
    values = {
        "log_score": (scores.log_score, False),
        "known_share": (scores.is_known.astype(np.float64), True),
        "claimed_share": (np.minimum(scores.claimed, 1.0), True),
    }
    return {
        name: _ratio(
            scores, value, group=group, n_fleets=n_fleets, seed=seed, is_share=is_share
        )
        for name, (value, is_share) in values.items()
    }


def reliability_table(
    scores: PosteriorScores, *, group: tuple[str, ...], n_fleets: int, seed: int
) -> list[Reliability]:
    """Return the realised share of known instants by stated probability."""
    rows = []
    for low, high in pairwise(CLAIM_EDGES):
        inside = (scores.claimed >= low) & (scores.claimed < high)
        if high >= CLAIM_EDGES[-1]:
            inside |= scores.claimed >= high
        known = _ratio(
            scores,
            scores.is_known.astype(np.float64),
            group=group,
            n_fleets=n_fleets,
            seed=seed,
            rows=inside,
        )
        claimed = float(scores.claimed[inside].mean()) if inside.any() else np.nan
        rows.append(Reliability(low, high, float(inside.mean()), claimed, known))
    return rows


def _ratio(
    scores: PosteriorScores,
    value: Floats,
    *,
    group: tuple[str, ...],
    n_fleets: int,
    seed: int,
    is_share: bool = True,
    rows: Bools | None = None,
) -> Estimate:
    """Return the mean of a value over some instants, with its two-way interval."""
    cluster: Ints = cluster_numbers(group)
    weight = np.ones(value.size) if rows is None else rows.astype(np.float64)
    shape = int(cluster.max()) + 1, n_fleets
    top, bottom = np.zeros(shape), np.zeros(shape)
    place = cluster[scores.person], scores.fleet
    np.add.at(top, place, weight * value)
    np.add.at(bottom, place, weight)
    return two_way_ratio(
        numerator=top, denominator=bottom, seed=seed, is_share=is_share
    )
