"""Ranks and assignments against brute force and by hand."""

import math
from itertools import combinations, permutations

import numpy as np
import pytest
from helpers import linkability_oracles as oracles
from helpers.searches import search
from scipy.optimize import linear_sum_assignment
from scipy.special import logsumexp

from isac_track.linkability import (
    Search,
    assign,
    chance,
    log_rank,
    mean_log_rank,
    rank1,
    rank1_among,
    reciprocal_rank,
    residual_risk,
)
from isac_track.linkability.ranks import assign_in, log_sum_exp, soft_matches
from isac_track.rng import stream


@pytest.mark.parametrize("levels", [2, 4, 100])
def test_ranks_are_means_over_the_orders_of_ties(levels):
    rng = stream(levels, "test", "ranks")
    scores = rng.integers(0, levels, (30, 9)).astype(float)
    mate = np.full(30, -1)
    mate[rng.choice(30, 9, replace=False)] = rng.permutation(9)
    for function, value in (
        (rank1, lambda rank: rank == 1),
        (reciprocal_rank, lambda rank: 1 / rank),
        (log_rank, lambda rank: -math.log(rank / 9)),
    ):
        expected = oracles.over_mates(scores, mate, value)
        assert function(scores=scores, mate=mate) == pytest.approx(
            expected, abs=1e-12, nan_ok=True
        )


@pytest.mark.parametrize("levels", [2, 5, 100])
def test_rank1_among_is_the_mean_over_all_galleries_that_could_be_drawn(levels):
    rng, n, gallery = stream(levels, "test", "galleries"), 8, 4
    scores = rng.integers(0, levels, (n, n)).astype(float)
    expected = []
    for row in range(n):
        others = [column for column in range(n) if column != row]
        drawn = np.array([[row, *some] for some in combinations(others, gallery - 1)])
        hits = [
            oracles.over_mates(scores[row, columns][None], [0], lambda r: r == 1)
            for columns in drawn
        ]
        expected.append(np.mean(hits))
    own = np.diag(scores)[:, None]
    counts = {"above": (scores > own).sum(axis=1), "tied": (scores == own).sum(axis=1)}
    rate = rank1_among(**counts, candidates=np.full(n, n), gallery=gallery)
    assert rate == pytest.approx(expected, abs=1e-12)
    few = rank1_among(**counts, candidates=np.full(n, gallery - 1), gallery=gallery)
    assert np.isnan(few).all()


def test_chance_and_log_ranks_by_hand():
    # Ranks: 1; one of 1 and 2; and 3, in galleries of three and four.
    first = search([[9.0, 1.0, 2.0], [5.0, 5.0, 0.0]])
    second = search([[1.0, 2.0, 3.0, 0.0]])
    assert chance([first, second]) == pytest.approx((1 / 3 + 1 / 3 + 1 / 4) / 3)
    expected = (math.log(3) + math.log(3) - math.log(2) / 2 + math.log(4 / 3)) / 3
    assert mean_log_rank([first, second]) == pytest.approx(expected)
    nobody = search(np.zeros((2, 3)), mate=[-1, -1])
    for metric in (chance, mean_log_rank):
        assert np.isnan(metric([nobody])).all()


@pytest.mark.parametrize("shape", [(3, 3), (2, 4), (4, 2), (1, 3)])
@pytest.mark.parametrize("no_match_score", [None, 0.0, 0.6])
def test_assignments_are_the_best_of_all(shape, no_match_score):
    rng = stream(1, "test", "assign", *shape)
    for _ in range(20):
        scores = np.round(rng.standard_normal(shape), 1)
        assigned = assign(scores=scores, rng=rng, no_match_score=no_match_score)
        probes = np.flatnonzero(assigned >= 0)
        assert np.unique(assigned[probes]).size == probes.size
        value = scores[probes, assigned[probes]].sum()
        if no_match_score is None:
            assert probes.size == min(shape)
        else:
            assert (scores[probes, assigned[probes]] > no_match_score).all()
            value += no_match_score * (shape[0] - probes.size)
        assert value == pytest.approx(
            oracles.best_assignment(scores, no_match_score)[0]
        )


@pytest.mark.parametrize("levels", [1, 2, 5, 10**6])
def test_assignments_are_scipys_also_among_ties(levels):
    rng = stream(levels, "test", "scipy")
    for n_probes, n_gallery in rng.integers(1, 25, (60, 2)):
        scores = rng.integers(-levels, levels, (n_probes, n_gallery)) / 3.0
        assigned = assign_in(np.arange(n_gallery), scores, None)
        rows, columns = linear_sum_assignment(scores, maximize=True)
        assert np.array_equal(np.flatnonzero(assigned >= 0), rows)
        assert np.array_equal(assigned[rows], columns)


def test_assignments_of_ties_are_at_chance():
    rng = stream(2, "test", "ties")
    hits = [
        (assign(scores=np.zeros((8, 8)), rng=rng) == np.arange(8)).sum()
        for _ in range(2_000)
    ]
    # A random permutation has one fixed point in the mean, with variance 1: error
    # 0.022.
    assert np.mean(hits) == pytest.approx(1.0, abs=0.09)


def test_residual_risk_by_hand():
    assert residual_risk(success=0.6, control=0.2) == pytest.approx(0.5)
    assert residual_risk(success=0.0, control=0.2) == pytest.approx(-0.25)
    assert math.isnan(residual_risk(success=1.0, control=1.0))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scores": np.zeros(3)}, "shape"),
        ({"scores": np.zeros((2, 0))}, "shape"),
        ({"scores": np.full((2, 3), np.nan)}, "finite"),
        ({"scores": np.full((2, 3), np.inf)}, "finite"),
        ({"mate": np.array([0])}, "mate must be integers"),
        ({"mate": np.array([0.0, 1.0])}, "mate must be integers"),
        ({"mate": np.array([0, 3])}, "mates must be columns"),
        ({"mate": np.array([0, -2])}, "mates must be columns"),
        ({"mate": np.array([1, 1])}, "share a mate"),
        ({"probe_cluster": np.arange(3)}, "probe_cluster"),
        ({"gallery_cluster": np.arange(2)}, "gallery_cluster"),
        ({"gallery_cluster": np.arange(3.0)}, "gallery_cluster"),
        ({"probe_cluster": np.array([-1, 0])}, "negative"),
    ],
)
def test_a_search_refuses(changes, message):
    right = {
        "scores": np.zeros((2, 3)),
        "mate": np.array([0, -1]),
        "probe_cluster": np.arange(2),
        "gallery_cluster": np.arange(3),
    }
    assert Search(**right).scale == 0
    with pytest.raises(ValueError, match=message):
        Search(**right | changes)


class TestSoftMatches:
    def test_it_is_the_one_scaling_of_the_scores_whose_rows_and_columns_sum_to_one(
        self,
    ):
        # Sinkhorn: no other matrix has these sums and the same cross ratios as the
        # scores.
        scores = stream(0, "test", "soft").normal(0.0, 4.0, (9, 9))
        log_p = soft_matches(scores)
        for axis in (0, 1):
            assert np.exp(log_p).sum(axis=axis) == pytest.approx(np.ones(9), abs=1e-5)
        factor = log_p - scores  # of a row, and of a column
        alone = factor - factor[:1] - factor[:, :1] + factor[0, 0]
        assert alone == pytest.approx(np.zeros((9, 9)), abs=1e-9)

    @pytest.mark.parametrize("spread", [0.1, 4.0, 40.0, 400.0])
    def test_it_is_what_sweeps_of_logarithms_give(self, spread):
        scores = stream(1, "test", "soft").normal(0.0, spread, (30, 30))
        log_p = scores
        for _ in range(100):
            row_sums = logsumexp(log_p, axis=1, keepdims=True)
            log_p = log_p - row_sums
            log_p = log_p - logsumexp(log_p, axis=0, keepdims=True)
            if np.abs(row_sums).max() < 1e-6:
                break
        np.testing.assert_allclose(soft_matches(scores), log_p, rtol=1e-9, atol=1e-9)

    def test_it_finds_more_mates_than_each_probe_by_itself_as_the_exact_marginals_do(
        self,
    ):
        hits = np.zeros(3)
        for number in range(300):
            rng = stream(number, "test", "matches")
            ratio = rng.normal(-1.0, np.sqrt(2.0), (6, 6)) + 2.0 * np.eye(6)
            orders = np.array(list(permutations(range(6))))
            log_p = ratio[np.arange(6), orders].sum(axis=1)
            chance = np.exp(log_p - log_p.max())
            exact = np.stack(
                [chance @ (orders == column) for column in range(6)], axis=1
            )
            for place, scores in enumerate((ratio, soft_matches(ratio), exact)):
                hits[place] += (scores.argmax(axis=1) == np.arange(6)).sum()
        alone, softly, exactly = hits / 1800
        assert alone + 0.05 < softly < exactly + 0.01
        assert softly > exactly - 0.03

    @pytest.mark.parametrize("scores", [np.zeros((2, 3)), np.full((2, 2), np.nan)])
    def test_what_has_no_such_matching_is_refused(self, scores):
        with pytest.raises(ValueError, match=r"candidates|finite"):
            soft_matches(scores)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_the_logarithm_of_a_sum_is_scipys(axis, scale):
    values = scale * np.random.default_rng(5).normal(size=(40, 30))
    expected = logsumexp(values, axis=axis, keepdims=True)
    np.testing.assert_allclose(
        log_sum_exp(values, axis=axis), expected, rtol=1e-14, atol=1e-14
    )
