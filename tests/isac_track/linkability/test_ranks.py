"""Ranks and assignments against brute force and by hand."""

import math
from itertools import combinations

import numpy as np
import pytest
from helpers import linkability_oracles as oracles
from helpers.searches import search
from scipy.optimize import linear_sum_assignment

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
from isac_track.linkability.ranks import assign_in
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
        assert function(scores=scores, mate=mate) == pytest.approx(expected, abs=1e-12, nan_ok=True)


@pytest.mark.parametrize("levels", [2, 5, 100])
def test_rank1_among_is_the_mean_over_all_galleries_that_could_be_drawn(levels):
    rng, n, gallery = stream(levels, "test", "galleries"), 8, 4
    scores = rng.integers(0, levels, (n, n)).astype(float)
    expected = []
    for row in range(n):
        others = [column for column in range(n) if column != row]
        drawn = np.array([[row, *some] for some in combinations(others, gallery - 1)])
        hits = [oracles.over_mates(scores[row, one][None], [0], lambda r: r == 1) for one in drawn]
        expected.append(np.mean(hits))
    own = np.diag(scores)[:, None]
    counts = {"above": (scores > own).sum(axis=1), "tied": (scores == own).sum(axis=1)}
    found = rank1_among(**counts, candidates=np.full(n, n), gallery=gallery)
    assert found == pytest.approx(expected, abs=1e-12)
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
        assert value == pytest.approx(oracles.best_assignment(scores, no_match_score)[0])


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
    hits = [(assign(scores=np.zeros((8, 8)), rng=rng) == np.arange(8)).sum() for _ in range(2_000)]
    # A random permutation has one fixed point in the mean, with variance 1: error 0.022.
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
