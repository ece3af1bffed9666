"""`gallery.csv`: measured as by brute force, predicted with an honest error."""

import numpy as np
import pytest
from scipy.special import ndtr

from evaluation.estimates.galleries import COLUMNS, galleries
from evaluation.estimates.linked_people import LinkedProbes
from evaluation.plan.address import parse_consumer
from isac_track.intervals import Estimate

LINKER = parse_consumer("rerelease/histogram", "informed")


def make_probes(above, candidates):
    n = above.size
    counts = np.stack([above, np.ones(n, dtype=int), np.full(n, candidates)])
    nothing = np.zeros(n)
    return LinkedProbes(
        "raw",
        None,
        LINKER,
        nothing,
        nothing,
        nothing,
        np.arange(n),
        tuple(map(str, range(n))),
        {},
        np.zeros((n, 1)),
        counts,
    )


def make_table(above, candidates):
    tpr = {LINKER.measured("tpr_at_fpr_1pct").at("raw", None): Estimate(0.5, 0.4, 0.6)}
    probes = {"rerelease": [make_probes(above, candidates)], "split": []}
    return galleries(probes, tpr, dataset="hall", seed=0)


def world(rng, *, n, centre, spread):
    """Candidates above each mate among n, and rank 1 of any gallery: the truth."""
    p = ndtr(-(centre + spread * rng.normal(size=n)))
    many = ndtr(-(centre + spread * rng.normal(size=100_000)))
    return rng.binomial(n - 1, p), lambda size: ((1.0 - many) ** (size - 1)).mean()


def test_measured_is_what_drawn_galleries_give():
    rng = np.random.default_rng(0)
    above = rng.integers(0, 40, size=60)
    table = make_table(above, 60)
    assert list(table.columns) == COLUMNS
    assert {*table["gallery"]} == {10, 30, 60, 100}  # as far as the step could be tried
    assert table[table["predicted"]]["gallery"].unique().tolist() == [100]
    rank1 = table[table["metric"] == "rank1"].set_index("gallery")["value"]
    ahead = [
        rng.permuted(np.tile(np.arange(59) < m, (4000, 1)), axis=1)[:, :9]
        for m in above
    ]
    brute = np.mean([~draws.any(axis=1) for draws in ahead])
    assert rank1[10] == pytest.approx(brute, abs=0.01)
    assert rank1[60] == pytest.approx((above == 0).mean())
    rank = table[table["metric"] == "expected_rank"].set_index("gallery")["value"]
    assert rank[60] == pytest.approx(1.0 + above.mean())
    tpr = table[table["metric"] == "tpr_at_fpr_1pct"]
    assert (tpr[["value", "ci_low", "ci_high"]] == [0.5, 0.4, 0.6]).all(axis=None)


@pytest.mark.slow
def test_the_interval_of_what_is_predicted_holds_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(1)
    held = []
    for centre, spread in ((2.0, 1.0), (3.0, 0.5), (2.5, 2.0), (1.5, 1.5)):
        for _ in range(25):
            above, truth = world(rng, n=1000, centre=centre, spread=spread)
            table = make_table(above, 1000)
            rank1 = table[(table["metric"] == "rank1") & table["predicted"]].set_index(
                "gallery"
            )
            assert rank1.index.tolist() == [3000, 7545]
            row = rank1.loc[7545]
            held.append(row["ci_low"] <= truth(7545) <= row["ci_high"])
    assert np.mean(held) >= 0.93


def test_nothing_is_said_of_galleries_out_of_reach():
    table = make_table(np.zeros(20, dtype=int), 20)
    assert table["gallery"].max() == 20
    assert not table["predicted"].any()
