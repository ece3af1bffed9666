"""The best of many rivals without the bias of its choice: planted, and brute force."""

import numpy as np
import pytest

from evaluation.estimates.cross_fit import cross_fit
from evaluation.estimates.strongest import first_half
from isac_track.intervals import cluster_weights, jackknife_interval, ratio_estimates


def planted(rates, *, n, n_levels, rng):
    """Return hits and trials, (K, L, 2, C), of rivals with success rates, (K,)."""
    trials = np.full(n, 3.0)
    hits = (
        rng.binomial(3, np.asarray(rates)[:, None, None], (len(rates), n_levels, n))
        * 1.0
    )
    return np.stack([hits, np.broadcast_to(trials, hits.shape)], axis=2)


def fitted(sums, weights, **options):
    """Return estimates and choices of rivals, chosen and scored by the same number."""
    names = tuple(f"person {number}" for number in range(sums.shape[-1]))
    return cross_fit(
        choosing=sums,
        scored=sums,
        is_first=first_half(names),
        weights=weights,
        is_share=[True] * sums.shape[1],
        **options,
    )


def test_a_half_is_a_cluster_s_own():
    names = tuple(f"person {number}" for number in range(400))
    halves = first_half(names)
    assert 160 < halves.sum() < 240
    assert first_half(names[::-1]).tolist() == halves[::-1].tolist()
    assert first_half(names[:7]).tolist() == halves[:7].tolist()


def test_the_best_of_many_equal_ones_is_not_better_than_they_are():
    rng, truth = np.random.default_rng(1), 0.4
    weights = cluster_weights(n_clusters=50, n_replicates=200, seed=0)
    naive, crossed, covered = [], [], []
    for _ in range(150):
        sums = planted([truth] * 25, n=50, n_levels=1, rng=rng)
        rates = sums[:, 0, 0].sum(axis=1) / sums[:, 0, 1].sum(axis=1)
        (estimate,), _ = fitted(sums, weights)
        naive.append(rates.max())
        crossed.append(estimate.value)
        covered.append(estimate.ci_low <= truth <= estimate.ci_high)
    error = np.std(crossed) / np.sqrt(len(crossed))
    assert np.mean(naive) > truth + 0.06
    assert abs(np.mean(crossed) - truth) < 3.0 * error
    assert np.mean(covered) > 0.88


def test_who_is_clearly_better_is_chosen_by_both_halves_and_keeps_the_number():
    rng = np.random.default_rng(2)
    weights = cluster_weights(n_clusters=80, n_replicates=300, seed=0)
    sums = planted([0.2, 0.8, 0.3], n=80, n_levels=2, rng=rng)
    estimates, choices = fitted(sums, weights)
    assert choices == (1, 1)
    alone = ratio_estimates(
        numerator=sums[1, :, 0],
        denominator=sums[1, :, 1],
        weights=weights,
        is_share=[True, True],
    )
    for estimate, expected in zip(estimates, alone, strict=True):
        assert estimate.value == pytest.approx(expected.value)
        assert estimate.replicates == pytest.approx(expected.replicates)
        assert (estimate.ci_low, estimate.ci_high) == pytest.approx(
            (expected.ci_low, expected.ci_high)
        )
    assert fitted(sums, weights, least=True)[1] == (0, 0)


def test_every_replicate_and_every_deletion_chooses_anew():
    """Against loops over rows of weights, with few clusters (jackknife)."""
    rng = np.random.default_rng(3)
    sums = planted([0.5] * 8, n=24, n_levels=3, rng=rng)
    sums[..., 0, :] += rng.random((*sums.shape[:2], 24))  # so that no two are equal
    sums[..., 1, :] += 1.0 + rng.integers(0, 2, 24)
    weights = cluster_weights(n_clusters=24, n_replicates=60, seed=1)
    is_first = first_half(tuple(f"person {number}" for number in range(24)))

    def by_hand(weight):
        total, chosen = np.zeros((3, 2)), []
        for half in (is_first, ~is_first):
            other = ~half
            over, under = (sums[:, :, n] * weight * other for n in (0, 1))
            best = int((over.sum(axis=2) / under.sum(axis=2)).mean(axis=1).argmax())
            total += (sums[best] * weight * half).sum(axis=2)
            chosen.append(best)
        return total[:, 0] / total[:, 1], chosen

    estimates, choices = fitted(sums, weights)
    value, (by_second, by_first) = by_hand(np.ones(24))
    assert choices == (by_first, by_second)
    every = np.array([by_hand(weight)[0] for weight in weights])
    joined = np.where(is_first, sums[by_second], sums[by_first])
    fixed = (joined[:, 0] @ weights.T) / (joined[:, 1] @ weights.T)
    raised = every.T - every.mean(axis=0)[:, None] + fixed.mean(axis=1)[:, None]
    without = np.array([by_hand(row)[0] for row in 1.0 - np.eye(24)])
    for place, estimate in enumerate(estimates):
        assert estimate.value == pytest.approx(value[place])
        assert estimate.replicates == pytest.approx(raised[place])
        ends = jackknife_interval(
            np.append(value[place], without[:, place]), effective=estimate.effective
        )
        assert (estimate.ci_low, estimate.ci_high) == pytest.approx(ends)
    assert len({tuple(by_hand(row)[1]) for row in 1.0 - np.eye(24)}) > 1


def test_a_half_without_a_trial_follows_everybody():
    sums = planted([0.3, 0.7], n=40, n_levels=1, rng=np.random.default_rng(4))
    weights = cluster_weights(n_clusters=40, n_replicates=20, seed=0)
    is_first = np.ones(40, dtype=bool)
    (estimate,), choices = cross_fit(
        choosing=sums, scored=sums, is_first=is_first, weights=weights, is_share=[True]
    )
    assert choices == (1, 1)
    assert estimate.value == pytest.approx(sums[1, 0, 0].sum() / sums[1, 0, 1].sum())
