"""Tests of a link: their law, their size, their power."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import linkability_oracles as oracles
from helpers.searches import gaussian, search
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import binom

from isac_track.linkability import (
    Search,
    log_rank,
    minimum_detectable_rank1,
    outcome,
    permutation_p,
    rank1,
    rank1_p,
    reciprocal_rank,
)
from isac_track.linkability.significance import (
    add_shuffles,
    holm,
    mated_probes,
    rank_rows,
    searched_people,
    shuffled_log_ranks,
    shuffled_mates,
)
from isac_track.rng import stream


@given(scores=arrays(np.int64, (6, 6), elements=st.integers(-3, 3)))
@settings(deadline=None, max_examples=60)
def test_rising_maps_leave_ranks_and_p_alone(scores):
    before, after = search(scores), search(np.exp(scores / 3) + scores**3)
    for metric in (rank1, reciprocal_rank, log_rank):
        assert np.array_equal(
            metric(scores=after.scores, mate=after.mate),
            metric(scores=before.scores, mate=before.mate),
        )
    assert permutation_p(searches=[after], rng=stream(0, "test")) == permutation_p(
        searches=[before], rng=stream(0, "test")
    )


def clustered(rng, sizes):
    """A search with shuffled clusters of these sizes; two probes have no mate."""
    n = sum(sizes)
    cluster = 3 * np.repeat(np.arange(len(sizes)), sizes)
    mate, probes = np.full(n + 2, -1), rng.permutation(n + 2)[:n]
    mate[probes] = rng.permutation(n + 1)[:n]
    # A probe without a mate belongs to a cluster, too.
    probe_cluster = np.zeros(n + 2, dtype=int)
    gallery_cluster = np.zeros(n + 1, dtype=int)
    probe_cluster[probes] = cluster
    gallery_cluster[mate[probes]] = cluster
    return Search(
        rng.standard_normal((n + 2, n + 1)), mate, probe_cluster, gallery_cluster
    )


CLUSTERED = {
    (1, 1, 1, 1, 1): 120,
    (2, 2, 2): 3 * 2 * 2**3,
    (3, 1, 3, 1): 2 * 2 * 6**2,
    (2, 3, 1, 2): 2 * 2**2 * 6,
    (1, 2, 4): 2 * 24,
    (): 1,
}
"""Numbers of sets of mates that the null allows: products of factorials."""


def test_the_shuffles_are_those_of_all_rows_however_many_are_ranked_at_a_time(
    monkeypatch,
):
    whole = gaussian(stream(15, "test", "rows"), 30, 0.5, decimals=1)
    mates = np.where(np.arange(30) % 3 > 0, whole.mate, -1)
    clustered = replace(whole, mate=mates, probe_cluster=np.arange(30) // 4)
    results = []
    for n_at_once in (1, 100, 10**6):
        monkeypatch.setattr(
            "isac_track.linkability.significance._SCORES_AT_ONCE", n_at_once
        )
        results.append(
            shuffled_log_ranks([clustered, whole], stream(0, "test", "shuffles"), 999)
        )
    *in_parts, whole_rows = results
    for result in in_parts:
        assert result.observed == pytest.approx(whole_rows.observed, abs=1e-10)
        assert result.null == pytest.approx(whole_rows.null, abs=1e-10)
        assert all(map(np.array_equal, result.standings, whole_rows.standings))


@pytest.mark.parametrize("sizes", CLUSTERED)
def test_the_null_is_the_law_over_all_possible_mates(sizes):
    rng = stream(16, "test", "law")
    case = clustered(rng, sizes)
    score_bin = rng.integers(0, 3, case.scores.shape, dtype=np.uint8)
    mates = oracles.possible_mates(case)
    sums = [np.nansum(log_rank(scores=case.scores, mate=mate)) for mate in mates]
    bins = [
        np.bincount(score_bin[mate >= 0, mate[mate >= 0]], minlength=3)
        for mate in mates
    ]
    n = 300 * len(mates)
    null, null_bins = np.zeros(n), np.zeros((3, n), np.uint16)
    mated, counts = mated_probes(searched_people(case)), np.zeros((1, 2), dtype=int)
    ranked = rank_rows(case.scores, case.mate, np.empty(0), counts).log_rank
    columns = shuffled_mates(mated, stream(17, "test", "law"), n)
    observed = add_shuffles(mated, columns, ranked, score_bin, null, null_bins)
    assert observed == pytest.approx(
        np.nansum(log_rank(scores=case.scores, mate=case.mate))
    )
    # Jointly: the bins are those of the same mates as the sum. Each holds less than
    # ten.
    (expected, weight), (actual, counts) = (
        np.unique(np.round(rows, 9) + 1j * (held @ [1, 10, 100]), return_counts=True)
        for rows, held in ((sums, np.array(bins)), (null, null_bins.T))
    )
    assert actual == pytest.approx(expected)
    assert (np.abs(counts - 300 * weight) < 5 * np.sqrt(300 * weight)).all()
    # And so says the test.
    p = permutation_p(searches=[case], rng=stream(18, "test", "law"), n_shuffles=20_000)
    assert p == pytest.approx((np.array(sums) >= observed - 1e-9).mean(), abs=0.018)


def test_sums_and_bins_of_many_probes_are_those_of_the_mates_that_were_drawn():
    rng = stream(19, "test", "many")
    case = clustered(rng, [1] * 40 + [2] * 20)
    mated, n = mated_probes(searched_people(case)), 25
    columns = shuffled_mates(mated, rng, n)
    assert (np.sort(columns.T, axis=1) == np.sort(mated.mate)).all()
    ranks = rng.random(case.scores.shape)
    score_bin = rng.integers(0, 5, case.scores.shape)
    null, null_bins = np.ones(n), np.ones((5, n), np.uint16)
    add_shuffles(mated, columns, ranks, score_bin.astype(np.uint8), null, null_bins)
    drawn = mated.probes, columns.T
    assert null == pytest.approx(1 + ranks[drawn].sum(axis=1))
    held = score_bin[drawn]
    assert np.array_equal(null_bins, [1 + (held == k).sum(axis=1) for k in range(5)])


@pytest.mark.parametrize(("n_candidates", "fits"), [(65_536, True), (65_537, False)])
def test_a_mate_beyond_sixteen_bits_is_refused_and_not_wrapped(n_candidates, fits):
    mated = mated_probes(
        searched_people(search(np.zeros((1, n_candidates)), mate=[n_candidates - 1]))
    )
    rng = stream(0, "test", "bits")
    if fits:
        assert (shuffled_mates(mated, rng, 3) == n_candidates - 1).all()
    else:
        with pytest.raises(ValueError, match="at most 65,536 candidates"):
            shuffled_mates(mated, rng, 3)


def test_the_permutation_test_has_its_size_on_null_data_of_several_searches():
    rng = stream(7, "test", "size", 0)
    pairs = ([gaussian(rng, n, 0.0, decimals=0) for n in (15, 8)] for _ in range(1_000))
    p = np.array([permutation_p(searches=searches, rng=rng) for searches in pairs])
    # 3 standard deviations are 2.1 points at 5 %, 3.8 at 20 %.
    assert 0.029 <= (p <= 0.05).mean() <= 0.071
    assert 0.162 <= (p <= 0.2).mean() <= 0.238


def similar_groups(rng, sizes):
    """Scores of people who resemble their group within a session only."""
    group = np.repeat(np.arange(len(sizes)), sizes)
    probes, gallery = (
        rng.standard_normal((len(sizes), 3))[group]
        + 0.5 * rng.standard_normal((group.size, 3))
        for _ in range(2)
    )
    return search(-np.linalg.norm(probes[:, None] - gallery, axis=2), cluster=group)


def test_the_permutation_test_has_its_size_where_groups_are_similar():
    rng = stream(19, "test", "groups", "mixed")
    groups = [1] * 30 + [2] * 15 + [3] * 5 + [4] * 3
    p = [
        permutation_p(searches=[similar_groups(rng, groups)], rng=rng)
        for _ in range(1_000)
    ]
    # Three standard deviations are 2 points.
    assert 0.03 <= np.mean(np.array(p) <= 0.05) <= 0.07


def test_a_link_is_detected_between_clusters_and_among_members_but_not_without_choice():
    rng = stream(21, "test", "found")
    pairs, own = np.repeat(np.arange(15), 2), np.eye(30)
    pair_scores = (pairs[:, None] == pairs).astype(float)
    noise = 0.1 * rng.standard_normal((30, 30))
    together, apart = np.zeros(30, dtype=int), np.arange(30)
    for scores, cluster in (
        (pair_scores, pairs),
        (own, pairs),
        (own, together),
        (own, apart),
    ):
        case = search(scores + noise, cluster=cluster)
        assert permutation_p(searches=[case], rng=rng) == 1 / 1000
        assert (
            permutation_p(searches=[replace(case, scores=-case.scores)], rng=rng) > 0.99
        )
    # Two clusters of different sizes cannot be mistaken for each other: only members
    # count.
    sizes = np.repeat([0, 1], [10, 20])
    case = search((sizes[:, None] == sizes) + noise, cluster=sizes)
    assert permutation_p(searches=[case], rng=rng) > 0.05


@pytest.mark.parametrize("n_hits", [0, 1, 2.5, 3, 6])
def test_rank1_p_is_the_poisson_binomial_tail(n_hits):
    chances = np.array([0.5, 0.2, 0.2, 0.1, 0.5, 0.05])
    hits = np.full(6, n_hits / 6)
    expected = oracles.poisson_binomial_tail(chances, math.floor(n_hits))
    assert rank1_p(hits=hits, chance=chances) == pytest.approx(expected, abs=1e-12)
    equal = rank1_p(hits=hits, chance=np.full(6, 0.2))
    assert equal == pytest.approx(binom.sf(math.floor(n_hits) - 1, 6, 0.2), abs=1e-12)


def test_three_thirds_of_a_hit_are_a_hit():
    thirds = np.full(3, 1 / 3)
    assert rank1_p(hits=thirds, chance=thirds) == pytest.approx(1 - (2 / 3) ** 3)
    assert rank1_p(hits=np.empty(0), chance=np.empty(0)) == 1.0


@pytest.mark.parametrize(("n", "rate"), [(20, 0.05), (140, 1 / 140), (320, 1 / 40)])
def test_the_minimum_detectable_rate_is_detected_as_often_as_promised(n, rate):
    least = minimum_detectable_rank1(n=n, chance=rate)
    hits = stream(9, "test", "power", n).binomial(n, least, 20_000)
    p = np.array(
        [rank1_p(hits=np.arange(n) < k, chance=np.full(n, rate)) for k in range(n + 1)]
    )
    # The standard error is 0.0028.
    assert (p[hits] <= 0.05).mean() == pytest.approx(0.8, abs=0.01)


def test_too_few_probes_detect_no_rate():
    for n, rate in ((1, 0.1), (0, 0.1), (50, 1.0)):
        assert minimum_detectable_rank1(n=n, chance=rate) == math.inf
    assert minimum_detectable_rank1(n=1, chance=0.04) == pytest.approx(0.8)


def test_outcomes():
    assert outcome(p_value=0.05, ceiling_p_value=1.0) == "links"
    assert outcome(p_value=0.06, ceiling_p_value=0.05) == "no link detected"
    assert outcome(p_value=0.06, ceiling_p_value=0.06) == "attack too weak"


@pytest.mark.parametrize(
    ("function", "values", "message"),
    [
        (rank1_p, {"hits": np.ones(3), "chance": np.ones(2)}, "one shape"),
        (rank1_p, {"hits": np.full(3, 2.0), "chance": np.ones(3)}, r"0\.\.1"),
        (minimum_detectable_rank1, {"n": -1, "chance": 0.1}, "n >= 0"),
        (outcome, {"p_value": 0.1, "ceiling_p_value": math.nan}, "p-value"),
        (
            permutation_p,
            {"searches": [search(np.eye(2))], "n_shuffles": 10},
            "at least 999",
        ),
    ],
)
def test_numbers_out_of_range_are_refused(function, values, message):
    draws = {"rng": stream(0, "test")} if function is permutation_p else {}
    with pytest.raises(ValueError, match=message):
        function(**values, **draws)


def test_holm_is_the_closed_test_by_bonferroni_of_what_is_known():
    # A number differs if every set that it belongs to holds a difference, by
    # Bonferroni.
    p_values = np.random.default_rng(0).uniform(0, 0.4, 6)
    sets = [
        list(members)
        for size in range(1, 7)
        for members in itertools.combinations(range(6), size)
    ]
    closed = [
        max(
            min(1.0, len(members) * p_values[members].min())
            for members in sets
            if n in members
        )
        for n in range(6)
    ]
    assert holm(np.array([*p_values, np.nan])) == pytest.approx(
        [*closed, np.nan], nan_ok=True
    )
