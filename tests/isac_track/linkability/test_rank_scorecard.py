"""The scorecard of ranks against the one of all pairs, on the same searches."""

import numpy as np
import pytest
from helpers.searches import card, random_searches

from isac_track.intervals import cluster_weights
from isac_track.linkability import permutation_p, rank_scorecard
from isac_track.linkability.scales import METRICS
from isac_track.rng import stream

REFUSED = {*METRICS, "d_sys_corrected", "rank1_assigned", "false_link_rate"}


@pytest.mark.parametrize("decimals", [0, 8])
@pytest.mark.parametrize("seed", range(5))
def test_rank_metrics_are_the_same_and_all_others_refused(decimals, seed):
    searches = random_searches(stream(seed, "test", "searches"), decimals)
    weights = cluster_weights(n_clusters=6, n_replicates=20, seed=0)
    rng = stream(seed, "test", "shuffles")
    ranks = rank_scorecard(searches, weights=weights, rng=rng)
    whole = card(searches, n_clusters=6)
    assert ranks.estimates.keys() == whole.estimates.keys()
    for name, estimate in ranks.estimates.items():
        expected = whole.estimates[name]
        assert estimate.n == expected.n
        assert estimate.replicates.shape == expected.replicates.shape
        numbers = [
            estimate.value,
            estimate.ci_low,
            estimate.ci_high,
            *estimate.replicates,
        ]
        if name in REFUSED:
            assert np.isnan(numbers).all()
        else:
            usual = [
                expected.value,
                expected.ci_low,
                expected.ci_high,
                *expected.replicates,
            ]
            assert np.array_equal(numbers, usual, equal_nan=True)
    rng = stream(seed, "test", "shuffles")
    assert ranks.p_value == permutation_p(searches=searches, rng=rng)
    for name in ("p_rank1", "n_probes", "n_mated", "gallery_sizes", "n_clusters"):
        assert getattr(ranks, name) == getattr(whole, name)
    for name in ("above", "tied", "chance", "companions", "cluster"):
        assert np.array_equal(getattr(ranks.probes, name), getattr(whole.probes, name))


def test_two_tails_hold_all_shuffles_between_them():
    searches = random_searches(stream(7, "test", "searches"), 8)
    weights = cluster_weights(n_clusters=6, n_replicates=20, seed=0)
    result = rank_scorecard(
        searches, weights=weights, rng=stream(7, "test", "shuffles")
    )
    assert result.p_value + result.p_value_low >= 1.0
    with pytest.raises(ValueError, match="n_shuffles must be at least 999"):
        rank_scorecard(searches, weights=weights, rng=stream(0, "test"), n_shuffles=99)
