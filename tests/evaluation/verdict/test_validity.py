"""What the validity of a descriptor is read from, and what is said where the truth is known."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import evaluation
from evaluation.estimates.families import Family
from evaluation.verdict import rules
from evaluation.verdict.validity import ATTACKS, CONSTRUCTION, SHOWN, validity

ROOT = Path(evaluation.__file__).parent.parent


@pytest.fixture(scope="module")
def worlds():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT))
        yield import_module("benchmarks.verdict_worlds")


@pytest.fixture(scope="module")
def equal(worlds):
    """Return a task of a world in which all mechanisms are equal."""
    return worlds.linked_task(worlds.World(people=400), seed=1)


def said_of(worlds, task, **families):
    known = worlds.families() | families
    return validity([task], families=known, preset="paper", dataset="worlds", seed=0)


def item(said, name="validity/linear/plr/rerelease"):
    return next(one for one in said["items"] if one["id"] == name)


def gaps(one):
    return {gap["mechanism"]: gap for gap in one["contrasts"]}


def shifted(task, mechanism, points):
    """Return a task in which a mechanism links more or fewer people."""

    def moved(one):
        more = one.success + points * one.probes
        return replace(one, success=more) if one.mechanism == mechanism else one

    return replace(task, levels=tuple(map(moved, task.levels)))


@pytest.mark.parametrize(
    ("name", "most_wrong", "least_right"),
    [
        ("all equal", 1, 0.0),
        ("10 points in one family", 1, 0.0),
        ("random descriptor", 0, 0.8),
        ("constant descriptor", 0, 0.8),
    ],
)
def test_in_simulated_worlds_little_is_wrong(worlds, name, most_wrong, least_right):
    """Six worlds each; `benchmarks.verdict_worlds` does 200."""
    world = replace(worlds.WORLDS[name], people=300)
    one = worlds.tally(world, times=6)
    assert one.wrong <= most_wrong
    assert one.controls == 0
    assert one.decisions[world.right] >= least_right * one.decisions.total()
    assert one.kept >= 0.8 * one.promised


def test_every_item_carries_what_it_promises(worlds, equal):
    said = said_of(worlds, equal)
    assert len(said["items"]) == 6
    for one in said["items"]:
        assert 0 <= one["spread_low"] <= one["spread"] <= one["spread_high"] <= 1
        assert one["decision"] == rules.BETWEEN
        assert one["evidence"] == []
        assert one["why"] in one["sentence"]
        assert one["n_needed"] > one["n"] == min(gap["n"] for gap in one["contrasts"])
        assert set(one["power"]) == {rules.TRACKS, rules.DOES_NOT}
        assert f"about {one['n_needed'] / 1000:,.1f}"[:7] in one["sentence"]
        assert one["prediction_error"] < one["prediction_error_null"]
    assert [gap["quartile"] for gap in item(said)["contrasts"][:3]] == [0.25, 0.5, 0.75]
    assert {one["descriptor"] for one in said["on_trial"]} == {"plr", "ael", "mel"}


@pytest.mark.parametrize(
    ("mechanism", "points", "decision", "evidence"),
    [
        ("correlated", -0.4, rules.DOES_NOT, [ATTACKS]),
        ("correlated", 0.4, rules.DOES_NOT, [SHOWN]),
        # The frame is hidden in this task: that a moved walk is linked as well is no
        # news.
        ("offset", 0.4, rules.BETWEEN, []),
    ],
)
def test_a_decision_names_its_kind_of_evidence(
    worlds, equal, mechanism, points, decision, evidence
):
    found = item(said_of(worlds, shifted(equal, mechanism, points)))
    assert (found["decision"], found["evidence"]) == (decision, evidence)
    gap = gaps(found)[mechanism]
    assert gap["reading"] == "differs"
    assert gap["evidence"] == (evidence or [CONSTRUCTION])[0]
    # What decides nothing is no evidence of what others decide.
    both = shifted(shifted(equal, mechanism, points), "offset", 0.4)
    assert item(said_of(worlds, both))["evidence"] == evidence


def test_a_mechanism_of_somebody_elses_is_beside_the_panel(worlds, equal):
    own = replace(equal.levels[5], mechanism="mine:Ou", success=equal.levels[5].probes)
    task = replace(equal, levels=(*equal.levels, own))
    told = said_of(worlds, task, **{"mine:Ou": Family("mine:Ou", "mine:Ou", "")})
    alone = item(said_of(worlds, equal))
    found = item(told)
    assert gaps(found)["mine:Ou"]["reading"] == "differs"
    assert not gaps(found)["mine:Ou"]["in_panel"]
    assert found["contrasts"][:-1] == alone["contrasts"]
    assert found["spread_high"] == alone["spread_high"]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (
            lambda level: level.mechanism != "correlated",
            "lacks correlated 0.75 of the panel",
        ),
        (lambda level: level.mechanism != "fid", "lacks a sweep of fid"),
    ],
)
def test_with_less_than_the_panel_nothing_tracks(worlds, equal, change, why):
    task = replace(equal, levels=tuple(filter(change, equal.levels)))
    found = item(said_of(worlds, task))
    assert found["decision"] == rules.NOT_TESTABLE
    assert why in found["why"]
    assert found["n_needed"] is None


def changed(task, **of):
    def one(level):
        return replace(level, **{name: make(level) for name, make in of.items()})

    return replace(task, levels=tuple(map(one, task.levels)))


def few(level):
    keep = np.arange(level.probes.size) < 7
    return {name: sums * keep for name, sums in level.descriptors.items()}


def test_what_rests_on_few_or_on_nobody_is_not_testable(worlds, equal):
    found = item(said_of(worlds, changed(equal, descriptors=few)))
    assert found["n"] == 7
    assert "7 people" in found["why"]
    nobody = item(
        said_of(worlds, changed(equal, success=lambda one: 0.02 * one.probes))
    )
    still = item(said_of(worlds, changed(equal, success=lambda one: one.probes)))
    assert nobody["decision"] == still["decision"] == rules.NOT_TESTABLE
    assert "alike" in nobody["why"]
    high = changed(equal, success=lambda one: 0.8 * one.probes + 0.2 * one.success)
    assert "anything would track" in item(said_of(worlds, high))["why"]


def test_beyond_the_sweep_one_direction_can_be_shown(worlds, equal):
    def tenth(level):
        share = 0.05 if level.mechanism == "correlated" else 1.0
        return {name: sums * [[share], [1]] for name, sums in level.descriptors.items()}

    below = changed(equal, descriptors=tenth)
    found = item(said_of(worlds, shifted(below, "correlated", -0.45)))
    assert found["decision"] == rules.NOT_TESTABLE
    assert "correlated 0.75 has a lower PLR than any fixed noise" in found["why"]
    assert gaps(found)["correlated"]["only"] == "more"
    more = item(said_of(worlds, below))
    assert (more["decision"], more["evidence"]) == (rules.DOES_NOT, [SHOWN])


def test_without_fixed_noise_there_is_nothing_to_compare_with(worlds, equal):
    task = replace(
        equal, levels=tuple(one for one in equal.levels if "fixed" not in one.mechanism)
    )
    assert said_of(worlds, task) == {"items": [], "controls": [], "on_trial": []}
