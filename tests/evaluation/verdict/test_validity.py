"""What the validity of a descriptor is read from: mechanisms, rules, and an attack that links."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.mechanisms import sweeps_of
from helpers.planted_worlds import TASK, World, simulated
from scipy.stats import kendalltau

from evaluation.analysis.keys import Source
from evaluation.verdict.validity import kendall_tau, validity

SUCCESS = {TASK: Source("rerelease/shape", "informed")}


def drafts(found):
    return list(validity(sweeps_of(found), success=SUCCESS))


def contrasts(draft):
    """The contrasts of an item, each by its mechanism."""
    return {one["mechanism"]: one for one in draft.details["contrasts"]}


def made(world, seed, *, only=lambda _key: True, factor=lambda _key: 1.0):
    """Return the estimates of a world, some of them, and multiplied."""
    found, _ = simulated(world, rng=np.random.default_rng(seed))
    return {
        key: replace(one, value=one.value * factor(key), replicates=one.replicates * factor(key))
        for key, one in found.items()
        if only(key)
    }


def test_without_a_dissociation_control_nothing_tracks():
    paper = {"raw", "fid", "fix"}
    world = World("valid", n_people=3000)
    found = drafts(made(world, 8, only=lambda key: key.mechanism[:3] in paper))
    assert found
    for draft in found:
        assert [p for name, p in draft.options.items() if "tracks" in name] == [1, 1]
        assert "no dissociation control" in draft.why_undecided


def test_an_attack_that_links_nobody_tells_nothing():
    guessing = made(World("fooled", n_people=1000), 9)
    guessing |= {
        key: replace(one, value=0.01, replicates=one.replicates * 0 + 0.01)
        for key, one in guessing.items()
        if key.metric == "rank1"
    }
    for draft in drafts(guessing):
        assert all(p > 0.05 for p in draft.options.values())
        assert "hardly links anybody" in draft.why_undecided


def test_mechanisms_are_compared_under_their_own_rule_and_without_one_under_both():
    found = drafts(made(World("valid", n_people=100, stranger=True), 10))
    for rule, suffix in (("linear", ""), ("independent", ":adding=independent")):
        named = {name for draft in found if draft.adding == rule for name in contrasts(draft)}
        own = {f"fid{suffix}", f"correlated{suffix}"}
        assert named == own | {"offset", "thin", "mine:Ou"}


def test_beyond_the_fixed_sweep_there_is_no_contrast():
    def factor(key):
        return 1 / 9 if (key.mechanism, key.consumer) == ("offset", "shared") else 1.0

    for draft in drafts(made(World("fooled", n_people=400), 10, factor=factor)):
        assert "offset" not in contrasts(draft)
        assert "thin" in contrasts(draft)


@pytest.mark.parametrize(("linker", "subject"), [("dtw", "dtw (blind)"), ("", "shape (informed)")])
def test_against_a_control_the_strongest_there_counts(linker, subject):
    found = made(World("fooled", n_people=400), 11)
    if linker:
        found |= {
            key._replace(consumer="rerelease/dtw", knowledge="blind"): replace(
                one, value=min(1.0, one.value + (0.2 if key.mechanism == "offset" else -0.2))
            )
            for key, one in found.items()
            if key.metric == "rank1"
        }
    for draft in drafts(found):
        assert contrasts(draft)["offset"]["subject"] == subject
        assert contrasts(draft)["thin"]["subject"] == draft.subject == "shape (informed)"


def test_a_mechanism_without_a_level_is_one_contrast():
    found = made(World("valid", n_people=400), 12)
    found |= {
        key._replace(mechanism="mine:Ou", level=None): one
        for key, one in found.items()
        if key.mechanism == "thin"
    }
    for draft in drafts(found):
        mine = [one for one in draft.details["contrasts"] if one["mechanism"] == "mine:Ou"]
        assert [one["level"] for one in mine] == [None]


@pytest.mark.parametrize("n_values", [2, 4, 50])
def test_tau_is_that_of_scipy_with_ties_and_unknown_without_any_change(n_values):
    pairs = np.random.default_rng(n_values).integers(0, n_values, (20, 2)) / n_values
    assert kendall_tau(pairs) == pytest.approx(kendalltau(*pairs.T).statistic, abs=1e-12)
    assert np.isnan(kendall_tau(np.array([[1.0, 2.0], [1.0, 3.0], [1.0, 1.0]])))
