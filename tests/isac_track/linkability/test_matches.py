"""Matching with slack: against all matchings, and against its margins."""

from itertools import combinations, permutations

import numpy as np
import pytest

from isac_track.linkability import fit_scale, open_matches
from isac_track.linkability.matches import most_probable


def marginals(log_ratios, alone):
    """The probability of each pair over all matchings; `alone` weighs unmatched."""
    n_probes, n_gallery = log_ratios.shape
    total, pairs = 0.0, np.zeros(log_ratios.shape)
    for size in range(min(n_probes, n_gallery) + 1):
        for probes in combinations(range(n_probes), size):
            for columns in permutations(range(n_gallery), size):
                pair = list(probes), list(columns)
                weight = np.exp(log_ratios[pair].sum()) * alone ** (
                    n_probes + n_gallery - 2 * size
                )
                total += weight
                pairs[pair] += weight
    return pairs / total


def test_margins_have_the_expected_sums():
    scores = 3.0 * np.random.default_rng(0).normal(size=(7, 10))
    pairs = open_matches(scores, n_links=5.5)
    assert pairs.sum() == pytest.approx(5.5, abs=1e-3)
    assert pairs.sum(axis=0).max() < 1.0 + 1e-6
    assert pairs.sum(axis=1).max() < 1.0 + 1e-6
    # A factor common to all pairs says nothing.
    assert open_matches(scores + 40.0, n_links=5.5) == pytest.approx(pairs, abs=1e-6)


def test_it_names_whom_the_exact_marginals_name():
    """The probabilities themselves are only near: scaling approximates permanents."""
    rng, exact_mates = np.random.default_rng(1), []
    for _ in range(30):
        scores = rng.normal(size=(4, 5))
        scores[np.arange(3), np.arange(3)] += 3.0
        exact = marginals(scores, 0.8)
        pairs = open_matches(scores, n_links=float(exact.sum()))
        exact_mates.append((pairs.argmax(axis=1) == exact.argmax(axis=1)).mean())
    assert np.mean(exact_mates) >= 0.9


def test_a_candidate_that_fits_another_probe_better_is_no_mate():
    scores = np.array([[4.0, 3.9], [4.0, 0.0]])
    pairs = open_matches(scores, n_links=2.0)
    assert most_probable(np.arange(2), pairs)[0].tolist() == [1, 0]
    alone = most_probable(
        np.arange(2), open_matches(np.array([[9.0, 0.0], [0.0, 0.0]]), n_links=1)
    )
    assert alone[1].tolist() == [False, True]


def test_a_scale_is_that_of_ratios():
    """Mates are drawn by a logit of the scores, which are then divided by 7."""
    rng = np.random.default_rng(2)
    ratios = rng.normal(scale=2.0, size=(4000, 6))
    chance = np.exp(ratios) / np.exp(ratios).sum(axis=1, keepdims=True)
    mates = (rng.random((4000, 1)) > chance.cumsum(axis=1)).sum(axis=1).clip(max=5)
    mates[:50] = -1
    assert fit_scale([ratios / 7.0], [mates]) == pytest.approx(7.0, rel=0.06)
    assert fit_scale([ratios], [np.full(4000, -1)]) == 1.0
    with pytest.raises(ValueError, match="finite"):
        open_matches(np.array([[np.nan]]), n_links=1.0)
