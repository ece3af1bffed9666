"""Two-way intervals: against plain loops, and their coverage."""

import numpy as np
import pytest

from isac_track.intervals import cluster_weights
from isac_track.patrols.intervals import cluster_numbers, sum_clusters, two_way_ratio
from isac_track.rng import stream


def planted(*, n_clusters=60, n_routes=24, seed=0, spread=(0.6, 0.4)):
    """Hits of trials whose chance depends on the person and on the route."""
    rng = stream(seed, "test", "two-way")
    person, route = (
        size * rng.standard_normal(n)
        for size, n in zip(spread, (n_clusters, n_routes), strict=True)
    )
    chance = 1.0 / (1.0 + np.exp(1.0 - person[:, None] - route))
    trials = rng.poisson(3.0, chance.shape)
    return rng.binomial(trials, chance).astype(float), trials.astype(float)


def truth(spread=(0.6, 0.4)):
    """The share in the long run, by integration over both normal effects."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    total = np.hypot(*spread) * nodes
    return float((weights / (1.0 + np.exp(1.0 - total))).sum() / weights.sum())


def test_clusters_are_numbered_by_first_appearance_and_summed():
    cluster = cluster_numbers(("b", "a", "b", "c"))
    assert cluster.tolist() == [0, 1, 0, 2]
    sums = sum_clusters(np.array([[1, 2], [3, 4], [5, 6], [7, 8]]), cluster)
    assert sums.tolist() == [[6, 8], [3, 4], [7, 8]]


def test_value_and_replicates_are_those_of_a_plain_loop():
    hits, trials = planted(n_clusters=20, n_routes=20)
    estimate = two_way_ratio(numerator=hits, denominator=trials, seed=3, n_replicates=5)
    people = cluster_weights(
        n_clusters=20, n_replicates=5, seed=3, stream_names=("people",)
    )
    routes = cluster_weights(
        n_clusters=20, n_replicates=5, seed=3, stream_names=("routes",)
    )
    assert estimate.value == hits.sum() / trials.sum()
    for b in range(5):
        sums = np.zeros(2)
        for person in range(20):
            for route in range(20):
                weight = people[b, person] * routes[b, route]
                sums += weight * np.array([hits[person, route], trials[person, route]])
        assert estimate.replicates[b] == pytest.approx(sums[0] / sums[1])
    assert estimate.n == 20


def test_the_coverage_is_about_nominal():
    share, n_held = truth(), 0
    for seed in range(200):
        hits, trials = planted(seed=seed)
        estimate = two_way_ratio(
            numerator=hits, denominator=trials, seed=0, n_replicates=400
        )
        n_held += estimate.ci_low <= share <= estimate.ci_high
    assert 0.90 <= n_held / 200 <= 0.99


def test_an_interval_over_people_alone_would_be_too_narrow():
    hits, trials = planted(spread=(0.2, 1.0))
    both = two_way_ratio(numerator=hits, denominator=trials, seed=0)
    averaged = np.repeat(hits.sum(axis=1, keepdims=True) / 24, 24, axis=1)
    averaged_trials = np.repeat(trials.sum(axis=1, keepdims=True) / 24, 24, axis=1)
    people = two_way_ratio(numerator=averaged, denominator=averaged_trials, seed=0)
    assert people.value == pytest.approx(both.value)
    assert both.ci_high - both.ci_low > 2.0 * (people.ci_high - people.ci_low)


@pytest.mark.parametrize(
    ("n_clusters", "n_routes"), [(60, 19), (10, 30), (1, 30), (60, 1)]
)
def test_few_people_or_few_routes_have_a_value_and_no_interval(n_clusters, n_routes):
    hits, trials = planted(n_clusters=n_clusters, n_routes=n_routes)
    estimate = two_way_ratio(
        numerator=hits, denominator=trials, seed=0, n_replicates=50
    )
    assert estimate.value == hits.sum() / trials.sum()
    assert np.isnan([estimate.ci_low, estimate.ci_high]).all()


def test_a_share_of_nothing_has_wilsons_interval():
    _, trials = planted()
    estimate = two_way_ratio(
        numerator=np.zeros(trials.shape), denominator=trials, seed=0
    )
    assert (estimate.value, estimate.ci_low) == (0.0, 0.0)
    assert 0.05 < estimate.ci_high < 0.2  # about 24 routes


def test_without_a_trial_there_is_no_number():
    nothing = np.zeros((30, 30))
    estimate = two_way_ratio(
        numerator=nothing, denominator=nothing, seed=0, n_replicates=50
    )
    assert np.isnan([estimate.value, estimate.ci_low, estimate.ci_high]).all()
    assert estimate.n == 0


def test_comparisons_are_paired_by_the_draws():
    hits, trials = planted()
    first, second = (
        two_way_ratio(numerator=top, denominator=trials, seed=0)
        for top in (hits, 0.5 * hits)
    )
    np.testing.assert_allclose(second.replicates, 0.5 * first.replicates)
