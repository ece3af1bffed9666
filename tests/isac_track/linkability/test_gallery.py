"""Rank 1 in larger galleries: the law against its closed form and known truths."""

import numpy as np
import pytest
from scipy.special import ndtr

from isac_track.linkability.ranks import predicted_rank1, reach


@pytest.mark.parametrize(("a", "b"), [(0.05, 1.0), (0.4, 30.0), (2.0, 5000.0)])
def test_two_rates_of_the_law_predict_a_third(a, b):
    def rank1(gallery):
        return np.array([(1.0 + (gallery - 1) / b) ** -a])

    rate = predicted_rank1(
        small=rank1(100), large=rank1(1000), sizes=(100, 1000), gallery=7545
    )
    assert rate == pytest.approx(rank1(7545), rel=1e-6)


def test_no_failure_stays_none_and_no_hit_none():
    small, large = np.array([1.0, 0.2, np.nan]), np.array([1.0, 0.0, 0.5])
    rates = predicted_rank1(small=small, large=large, sizes=(10, 100), gallery=1000)
    assert rates[:2].tolist() == [1.0, 0.0]
    assert np.isnan(rates[2])


@pytest.mark.parametrize("sizes", [(1, 10), (10, 10), (10, 2000)])
def test_galleries_must_grow(sizes):
    with pytest.raises(ValueError, match="must grow"):
        predicted_rank1(small=np.ones(1), large=np.ones(1), sizes=sizes, gallery=1000)


def test_nothing_is_predicted_beyond_ten_times_nor_without_room_to_try_the_step():
    assert reach(1000) == 10_000
    assert reach(100) == 333
    assert reach(20) == 0


def test_the_law_predicts_different_people_better_than_their_own_shares():
    """Mates lie d + N(0, s) above impostors of N(0, 1): p and every r(G) are known."""
    rng = np.random.default_rng(5)
    for centre, spread in ((2.0, 1.0), (3.0, 0.5), (2.5, 2.0)):
        p = ndtr(-(centre + spread * rng.normal(size=200_000)))
        truth = {n: float(((1.0 - p) ** (n - 1)).mean()) for n in (100, 1000, 7545)}
        rates = {"small": np.array([truth[100]]), "large": np.array([truth[1000]])}
        predicted = predicted_rank1(**rates, sizes=(100, 1000), gallery=7545)[0]
        plain = ((1.0 - rng.binomial(999, p) / 999) ** 7544).mean()
        assert plain - truth[7545] > 0.03  # Too high.
        assert abs(predicted - truth[7545]) < 0.5 * (plain - truth[7545])
