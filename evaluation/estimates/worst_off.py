"""Mean of a metric over the most exposed tenth of the people, without a choice's bias.

The largest of noisy values are too large. So the tenth is chosen on every other release
of each person, and its mean is taken on the other releases; then the reverse, and both
means are averaged (cross-fitting; Chernozhukov et al., Econometrics Journal 21, 2018).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from isac_track.intervals import FEWEST_EFFECTIVE, Estimate, jackknife_interval
from isac_track.types import Floats, Ints

SHARE: Final = 0.1  # Of the people, the most exposed.
# Fewest releases of a person: half of fewer would be a poor basis for the choice.
LEAST_RELEASES: Final = 8
LEAST_PEOPLE: Final = FEWEST_EFFECTIVE  # A tenth of fewer is not even two people.


@dataclass(frozen=True, eq=False, slots=True)
class PersonMeans:
    """Mean of a metric over the odd (first, third, ...) and the even releases."""

    person: Ints  # (P,) clusters with at least `LEAST_RELEASES`
    odd: Floats  # (P,)
    even: Floats  # (P,)


def person_means(
    *, values: Floats, scene: Ints, cluster: Ints, n_clusters: int
) -> PersonMeans:
    """Return means over either half of the releases of each person with enough of them.

    A person is a cluster: a source track, or a group that walks together. A release of
    a person is a scene that shows it; releases are numbered in the order of the scenes.
    `values`, (R,), are of the tracks shown; `scene` and `cluster`, (R,), are the scene
    and the person of each.
    """
    n_scenes = int(scene.max(initial=0)) + 1
    releases, release = np.unique(cluster * n_scenes + scene, return_inverse=True)
    person = releases // n_scenes
    number = np.arange(releases.size) - np.searchsorted(person, person)
    enough = np.flatnonzero(np.bincount(person, minlength=n_clusters) >= LEAST_RELEASES)
    is_even = number[release] % 2 == 1
    means = []
    for half in (~is_even, is_even):
        sums = np.bincount(cluster[half], weights=values[half], minlength=n_clusters)
        means.append(
            sums[enough] / np.bincount(cluster[half], minlength=n_clusters)[enough]
        )
    return PersonMeans(enough, *means)


def worst_tenth(means: PersonMeans, *, weights: Floats) -> Estimate:
    """Return the mean of a share, 0..1, over the most exposed tenth of the people.

    The interval is the delete-one-person jackknife's, which repeats the choice. Its
    degrees of freedom are the people that carry its variance, less one: most people are
    not in the tenth. With fewer than `LEAST_PEOPLE` the value is refused (NaN).
    `weights`, (B, C), are how often each cluster is drawn in a replicate.
    """
    n = means.person.size
    if n < LEAST_PEOPLE:
        return Estimate(np.nan, n=n, replicates=np.full(len(weights), np.nan))
    left_out = np.ones((n + 1, n))
    np.fill_diagonal(left_out[1:], 0.0)
    jackknifed = cross_fitted_tail(means, left_out)
    replicates = cross_fitted_tail(means, weights[:, means.person])
    ends = jackknife_interval(jackknifed, effective=_carriers(jackknifed))
    return Estimate(float(jackknifed[0]), *ends, n, replicates)


def cross_fitted_tail(means: PersonMeans, weights: Floats) -> Floats:
    """Return the tenth's mean, (R,), chosen on one half and taken on the other.

    Each row of `weights`, (R, P), gives a result.
    """
    first = tail_mean(means.even, chosen_by=means.odd, weights=weights)
    return 0.5 * (first + tail_mean(means.odd, chosen_by=means.even, weights=weights))


def tail_mean(values: Floats, *, chosen_by: Floats, weights: Floats) -> Floats:
    """Return the mean of `values`, (P,), over people with the largest `chosen_by`.

    The weights of these people make `SHARE` of all. The last person counts in part, and
    equals share the remaining places. Each row of `weights`, (R, P), gives a result,
    (R,).
    """
    places = SHARE * weights.sum(axis=1, keepdims=True)
    order = np.argsort(-chosen_by, kind="stable")
    order = order[: _n_needed(chosen_by, order, weights, places)]
    ranked, ranked_weights = chosen_by[order], weights[:, order]
    starts = np.flatnonzero(np.append(True, ranked[1:] != ranked[:-1]))
    weight = np.add.reduceat(ranked_weights, starts, axis=1)
    total = np.add.reduceat(ranked_weights * values[order], starts, axis=1)
    taken = np.clip(places - (np.cumsum(weight, axis=1) - weight), 0.0, weight)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(weight > 0.0, total / weight, 0.0)
        return np.asarray((taken * mean).sum(axis=1) / places[:, 0])


def _n_needed(chosen_by: Floats, order: Ints, weights: Floats, places: Floats) -> int:
    """Return how many people fill all places, equals of the last included.

    Of a thousand people a sixth is enough, which saves most of the time.
    """
    n, usual = order.size, SHARE * order.size
    m = min(n, int(usual + 6.0 * np.sqrt(usual)) + 2)
    while m < n and (weights[:, order[:m]].sum(axis=1, keepdims=True) < places).any():
        m = min(n, 2 * m)
    return int((chosen_by >= chosen_by[order[m - 1]]).sum())


def _carriers(jackknifed: Floats) -> float:
    """Return how many people carry the variance of a jackknife: (sum d^2)^2 / sum d^4.

    At least one more than the people in the tenth are counted: with so many the
    interval covers (tested), and a few people that seem to carry all of the variance do
    not make it as wide as the whole range.
    """
    squares = (jackknifed[1:] - jackknifed[0]) ** 2
    fourth = float(squares @ squares)
    carriers = float(squares.sum()) ** 2 / fourth if fourth > 0.0 else 0.0
    return float(max(carriers, SHARE * squares.size + 1.0))
