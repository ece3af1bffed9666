"""Rank 1 in larger galleries: the law against its closed form and worlds whose truth is known."""

import numpy as np
import pytest
from scipy.special import ndtr

from isac_track.linkability.ranks import predicted_rank1, reach


@pytest.mark.parametrize(("a", "b"), [(0.05, 1.0), (0.4, 30.0), (2.0, 5000.0)])
def test_the_law_is_found_again_through_two_of_its_rates(a, b):
    def rank1(gallery):
        return np.array([(1.0 + (gallery - 1) / b) ** -a])

    found = predicted_rank1(
        small=rank1(100), large=rank1(1000), sizes=(100, 1000), gallery=7545
    )
    assert found == pytest.approx(rank1(7545), rel=1e-6)


def test_no_failure_stays_none_and_no_hit_none():
    small, large = np.array([1.0, 0.2, np.nan]), np.array([1.0, 0.0, 0.5])
    found = predicted_rank1(small=small, large=large, sizes=(10, 100), gallery=1000)
    assert found[:2].tolist() == [1.0, 0.0]
    assert np.isnan(found[2])


@pytest.mark.parametrize("sizes", [(1, 10), (10, 10), (10, 2000)])
def test_galleries_must_grow(sizes):
    with pytest.raises(ValueError, match="must grow"):
        predicted_rank1(small=np.ones(1), large=np.ones(1), sizes=sizes, gallery=1000)


def test_nothing_is_predicted_beyond_ten_times_nor_without_room_to_try_the_step():
    assert reach(1000) == 10_000
    assert reach(100) == 333
    assert reach(20) == 0


def test_people_who_differ_are_foretold_better_than_by_their_own_shares():
    """Mates lie d + N(0, s) above impostors of N(0, 1): p is known, and so is every r(G)."""
    rng = np.random.default_rng(5)
    for centre, spread in ((2.0, 1.0), (3.0, 0.5), (2.5, 2.0)):
        p = ndtr(-(centre + spread * rng.normal(size=200_000)))
        truth = {n: float(((1.0 - p) ** (n - 1)).mean()) for n in (100, 1000, 7545)}
        rates = {"small": np.array([truth[100]]), "large": np.array([truth[1000]])}
        found = predicted_rank1(**rates, sizes=(100, 1000), gallery=7545)[0]
        plain = ((1.0 - rng.binomial(999, p) / 999) ** 7544).mean()
        assert plain - truth[7545] > 0.03  # what is too high
        assert abs(found - truth[7545]) < 0.5 * (plain - truth[7545])
