"""Intervals against scipy, closed forms and their own coverage."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.estimates import ratio_estimate
from scipy.stats import binomtest, t

from isac_track.intervals import (
    CONFIDENCE,
    LEAST_CLUSTERS,
    Estimate,
    cluster_sums,
    cluster_weights,
    difference,
    effective_clusters,
    estimate_from_replicates,
    exact_binomial,
    jackknife_interval,
    percentile_interval,
    percentile_intervals,
    ratio_estimates,
    wilson,
)
from isac_track.rng import stream


@pytest.mark.parametrize(
    ("hits", "n"), [(0, 5), (3, 20), (17, 20), (250, 500), (20, 20)]
)
def test_wilson_is_scipys(hits, n):
    expected = binomtest(hits, n).proportion_ci(method="wilson")
    assert wilson(hits=hits, n=n) == pytest.approx(
        (expected.low, expected.high), abs=1e-12
    )


@pytest.mark.parametrize(("hits", "n"), [(0, 7), (1, 7), (5, 7), (7, 7), (1, 1)])
def test_the_exact_interval_of_a_count_is_scipys(hits, n):
    expected = binomtest(hits, n).proportion_ci(method="exact")
    assert exact_binomial(hits=hits, n=n) == pytest.approx(
        (expected.low, expected.high), abs=1e-9
    )


@pytest.mark.parametrize("interval", [wilson, exact_binomial])
@pytest.mark.parametrize(("hits", "n"), [(1, 0), (-1, 5), (6, 5)])
def test_what_is_no_share_is_refused(interval, hits, n):
    with pytest.raises(ValueError, match="a share needs"):
        interval(hits=hits, n=n)


def test_weights_draw_as_many_clusters_as_there_are_and_depend_on_the_seed_alone():
    options = {"n_clusters": 7, "n_replicates": 20_000}
    weights = cluster_weights(**options, seed=3)
    assert (weights.sum(axis=1) == 7).all()
    # Seven draws with replacement; the error of the covariances is below 0.01.
    assert np.allclose(np.cov(weights.T), np.eye(7) - 1 / 7, atol=0.05)
    assert np.array_equal(weights, cluster_weights(**options, seed=3))
    assert not np.array_equal(weights, cluster_weights(**options, seed=4))


def test_sums_and_a_ratio_by_hand():
    sums = cluster_sums(
        values=np.array([1.0, 2.0, 4.0]), cluster=np.array([2, 0, 2]), n_clusters=4
    )
    assert sums.tolist() == [2.0, 0.0, 5.0, 0.0]
    weights = np.array([[2.0, 0.0], [0.0, 2.0], [1.0, 1.0]])
    estimate = ratio_estimate(
        numerator=np.array([1.0, 3.0]),
        denominator=np.array([2.0, 4.0]),
        weights=weights,
    )
    assert estimate.value == pytest.approx(4 / 6)
    assert estimate.replicates.tolist() == pytest.approx([0.5, 0.75, 4 / 6])
    assert estimate.n == 2


def test_a_share_of_zero_takes_wilson_over_clusters_and_not_a_point():
    estimate = ratio_estimate(
        numerator=np.zeros(30),
        denominator=np.full(30, 10.0),
        weights=cluster_weights(n_clusters=30, n_replicates=100, seed=0),
        is_share=True,
    )
    assert (estimate.ci_low, estimate.ci_high) == wilson(hits=0, n=30)
    assert estimate.ci_high > 0.1


def test_too_few_clusters_have_no_interval():
    weights = cluster_weights(n_clusters=2, n_replicates=10, seed=0)
    estimate = ratio_estimate(
        numerator=np.array([1.0, 0.0]),
        denominator=np.array([4.0, 0.0]),
        weights=weights,
    )
    assert estimate.value == 0.25
    assert estimate.n == 1
    assert np.isnan([estimate.ci_low, estimate.ci_high]).all()
    empty = ratio_estimate(
        numerator=np.zeros(2), denominator=np.zeros(2), weights=weights
    )
    assert np.isnan([empty.value, empty.ci_low, empty.ci_high]).all()
    assert empty.n == 0


ENDS = [(1.0 - CONFIDENCE) / 2.0, 1.0 - (1.0 - CONFIDENCE) / 2.0]


@pytest.mark.parametrize("n_replicates", [1, 2, 41, 1000])
def test_percentiles_of_many_rows_are_numpys_to_the_last_bit(n_replicates):
    rng = stream(1, "test", "percentiles", n_replicates)
    rows = rng.standard_normal((400, n_replicates)) * 10.0 ** rng.integers(
        -9, 9, (400, 1)
    )
    rows[100:200] = rows[100:200].round(0)  # ties
    rows[rng.random(rows.shape) < np.linspace(-0.2, 0.9, 400)[:, None]] = np.nan
    rows[-1] = np.nan
    rows[-2] = np.r_[1.0, rows[-1, 1:]]
    intervals = percentile_intervals(rows)
    for row, ends in zip(rows, intervals.T, strict=True):
        known = row[~np.isnan(row)]
        expected = np.quantile(known, ENDS) if known.size else [np.nan, np.nan]
        np.testing.assert_array_equal(ends, expected)
        np.testing.assert_array_equal(percentile_interval(row), expected)
    assert percentile_intervals(rows[:0]).shape == (2, 0)
    assert np.isnan(percentile_intervals(rows[:3, :0])).all()


def test_many_ratios_equal_single_ratios():
    weights = cluster_weights(n_clusters=6, n_replicates=30, seed=0)
    values, first = stream(2, "test", "ratios").random(6), np.eye(6)[0]
    rows = [
        (values, np.ones(6), False),
        (values, np.ones(6), True),
        (np.ones(6), np.ones(6), True),  # shares of 1 and 0
        (np.zeros(6), np.ones(6), True),
        (np.ones(6), np.ones(6), False),
        (values * first, first, True),  # a single cluster, and none
        (np.zeros(6), np.zeros(6), True),
    ]
    top, bottom, is_share = zip(*rows, strict=True)
    sums = {"numerator": np.array(top), "denominator": np.array(bottom)}
    estimates = ratio_estimates(**sums, weights=weights, is_share=is_share)
    for estimate, (over, under, share) in zip(estimates, rows, strict=True):
        single = ratio_estimate(
            numerator=over, denominator=under, weights=weights, is_share=share
        )
        for name in ("value", "ci_low", "ci_high", "n", "replicates"):
            expected = getattr(single, name)
            np.testing.assert_allclose(
                getattr(estimate, name), expected, rtol=1e-12, err_msg=name
            )


def test_the_clustered_interval_covers_and_the_naive_one_does_not():
    # 60 clusters of 10 trials that share a random rate: trials within a cluster
    # correlate.
    rng = stream(0, "test", "coverage")
    weights = cluster_weights(n_clusters=60, n_replicates=400, seed=0)
    clustered = naive = 0
    n_runs = 400
    for _ in range(n_runs):
        hits = rng.binomial(10, rng.beta(0.9, 2.1, 60)).astype(float)  # mean rate 0.3
        estimate = ratio_estimate(
            numerator=hits, denominator=np.full(60, 10.0), weights=weights
        )
        clustered += estimate.ci_low <= 0.3 <= estimate.ci_high
        low, high = wilson(hits=hits.sum(), n=600)
        naive += low <= 0.3 <= high
    # 0.95 +- 3 standard errors of 400 runs is 0.917..0.983; the percentile interval is
    # a little short with 60 clusters.
    assert 0.90 <= clustered / n_runs <= 0.985
    assert naive / n_runs < 0.85


def test_an_estimate_has_the_spread_and_the_interval_of_its_replicates():
    values = np.concatenate([[1.0], np.arange(101.0), [np.nan, np.inf]])
    estimate = estimate_from_replicates(values, n=12)
    assert (estimate.value, estimate.n) == (1.0, 12)
    assert estimate.standard_error == pytest.approx(np.arange(101.0).std(ddof=1))
    assert (estimate.ci_low, estimate.ci_high) == pytest.approx((2.5, 97.5))
    assert replace(estimate, closed_error=0.5).standard_error == 0.5
    assert np.isnan(Estimate(1.0).standard_error)


def test_a_difference_is_paired_in_the_replicates_that_both_have():
    rng = np.random.default_rng(0)
    drawn = rng.normal(size=200)
    a = estimate_from_replicates(np.concatenate([[2.0], 2.0 + drawn]), n=30)
    b = estimate_from_replicates(np.concatenate([[0.5], 0.5 + drawn[:100]]), n=20)
    result = difference(a, b)
    assert (result.value, result.n) == (1.5, 20)
    assert result.replicates == pytest.approx(np.full(100, 1.5))
    assert (result.ci_low, result.ci_high) == pytest.approx((1.5, 1.5))


def test_a_difference_of_few_effective_clusters_has_no_interval():
    values = np.linspace(0.0, 1.0, 101)
    many = estimate_from_replicates(values, n=40, effective=40.0)
    few = estimate_from_replicates(values, n=40, effective=14.0)
    for a, b in ((many, few), (few, many)):
        result = difference(a, b)
        assert (result.value, result.n, result.effective) == (0.0, 40, 14.0)
        assert np.isnan([result.ci_low, result.ci_high]).all()
    assert np.isfinite(difference(many, many).ci_high)


def test_effective_clusters_are_the_clusters_if_all_are_equal():
    for sizes, expected in (
        ([3.0, 3.0, 3.0, 0.0], 3),
        ([6.0, 1.0, 1.0], 64 / 38),
        ([0.0], 0),
    ):
        assert effective_clusters(np.array(sizes)) == pytest.approx(expected)


def without_each(values):
    """The sum of values, (C,), then the sum without each in turn."""
    return values.sum() - np.append(0.0, values)


def test_the_jackknife_of_a_mean_is_students_interval():
    values = stream(3, "test", "mean").random(30)
    interval = jackknife_interval(
        without_each(values) / without_each(np.ones(30)), effective=30.0
    )
    mean, error = values.mean(), values.std(ddof=1) / np.sqrt(30)
    # On the scale of the logit, whose slope is 1 / p (1 - p).
    half = t(29).ppf(0.975) * error / (mean * (1 - mean))
    assert interval == pytest.approx(
        tuple(1 / (1 + (1 / mean - 1) * np.exp([half, -half])))
    )


@pytest.mark.parametrize(
    ("hits", "trials", "ends"),
    [
        (np.arange(14) % 2, np.ones(14), exact_binomial(hits=7, n=14)),
        (2.0 * (np.arange(7) < 7), np.full(7, 2.0), exact_binomial(hits=7, n=7)),
        # The trials of a person differ in outcome.
        (np.arange(14) % 3, np.full(14, 2.0), (np.nan, np.nan)),
        (np.arange(14) % 2, 1.0 + np.arange(14) % 2, (np.nan, np.nan)),
        (np.zeros(20), np.ones(20), wilson(hits=0, n=20)),
        (np.zeros(0), np.zeros(0), (np.nan, np.nan)),
    ],
)
def test_very_few_people_have_the_interval_of_their_count_or_none(hits, trials, ends):
    weights = cluster_weights(n_clusters=max(trials.size, 1), n_replicates=9, seed=0)
    (estimate,) = ratio_estimates(
        numerator=hits[None] * 1.0,
        denominator=trials[None],
        weights=weights[:, : trials.size],
        is_share=[True],
    )
    assert (estimate.ci_low, estimate.ci_high) == pytest.approx(ends, nan_ok=True)
    assert estimate.replicates.size == 9


def test_what_is_no_share_has_students_interval_of_few_and_the_percentiles_of_many():
    weights = cluster_weights(n_clusters=40, n_replicates=50, seed=0)
    times = stream(4, "test", "many").random((2, 40))
    trials = np.ones((2, 40))
    trials[1, 20:] = times[1, 20:] = 0.0
    many, few = ratio_estimates(
        numerator=times, denominator=trials, weights=weights, is_share=(True, False)
    )
    assert (many.ci_low, many.ci_high) == percentile_interval(many.replicates)
    own = times[1, :20]
    expected = own.mean() + own.std(ddof=1) / np.sqrt(20) * t(19).ppf([0.025, 0.975])
    assert (few.ci_low, few.ci_high) == pytest.approx(expected)
    assert np.isnan(
        estimate_from_replicates(np.arange(9.0), n=9, effective=14.0).ci_low
    )


def beta_binomial(rng, chances, sizes, within=0.4):
    """Hits of each person, whose own chance varies around the common one."""
    scale = 1 / within - 1
    own = rng.beta(chances * scale, (1 - chances) * scale, sizes.shape)
    return rng.binomial(sizes.astype(int), own) * 1.0


@pytest.mark.parametrize("n_clusters", [15, 20])
@pytest.mark.parametrize("chance", [0.2, 0.5, 0.85])
def test_intervals_of_fifteen_to_twenty_clusters_cover(n_clusters, chance):
    rng = stream(5, "test", "coverage", n_clusters, str(chance))
    covers = []
    for _ in range(1000):
        sizes = 2.0 * np.ones(n_clusters)
        sizes[: n_clusters - 15] += 2.0  # at least 15 in effect
        hits = beta_binomial(rng, np.array(chance), sizes)
        effective = effective_clusters(sizes)
        low, high = jackknife_interval(
            without_each(hits) / without_each(sizes), effective=effective
        )
        covers.append(low <= chance <= high)
    assert effective >= LEAST_CLUSTERS
    # Hits are counts: the interval covers rather too often than too seldom.
    assert 0.93 <= np.mean(covers) <= 0.99
