"""Validity of a descriptor: its contrasts, and its sentences in known worlds."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import evaluation
from evaluation.estimates.families import Family
from evaluation.verdict import rules
from evaluation.verdict.rules import ATTACKS, CONSTRUCTION, SHOWN
from evaluation.verdict.validity import validity
from evaluation.verdict.verdict_json import control_json, item_json, trial_json

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


def run_validity(worlds, task, **families):
    known = worlds.families() | families
    result = validity([task], families=known, preset="paper", dataset="worlds", seed=0)
    return {
        "items": [item_json(item) for item in result.items],
        "controls": [control_json(control) for control in result.controls],
        "on_trial": [trial_json(trial) for trial in result.trials],
    }


def item(verdict, name="validity/linear/plr/rerelease"):
    return next(entry for entry in verdict["items"] if entry["id"] == name)


def gaps(item):
    return {gap["mechanism"]: gap for gap in item["contrasts"]}


def shifted(task, mechanism, points):
    """Return a task in which a mechanism links more or fewer people."""

    def moved(level):
        more = level.success + points * level.probes
        return replace(level, success=more) if level.mechanism == mechanism else level

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
    result = worlds.tally(world, times=6)
    assert result.wrong <= most_wrong
    assert result.controls == 0
    assert result.decisions[world.right] >= least_right * result.decisions.total()
    assert result.right >= 0.8 * result.promised


def test_every_item_carries_what_it_promises(worlds, equal):
    verdict = run_validity(worlds, equal)
    assert len(verdict["items"]) == 6
    for entry in verdict["items"]:
        assert 0 <= entry["spread_low"] <= entry["spread"] <= entry["spread_high"] <= 1
        assert entry["decision"] == rules.BETWEEN
        assert entry["evidence"] == []
        assert entry["why"] in entry["sentence"]
        assert (
            entry["n_needed"]
            > entry["n"]
            == min(gap["n"] for gap in entry["contrasts"])
        )
        assert set(entry["power"]) == {rules.TRACKS, rules.DOES_NOT}
        assert f"about {entry['n_needed'] / 1000:,.1f}"[:7] in entry["sentence"]
        assert entry["prediction_error"] < entry["prediction_error_null"]
    assert [gap["quartile"] for gap in item(verdict)["contrasts"][:3]] == [
        0.25,
        0.5,
        0.75,
    ]
    assert {entry["descriptor"] for entry in verdict["on_trial"]} == {
        "plr",
        "ael",
        "mel",
    }


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
    result = item(run_validity(worlds, shifted(equal, mechanism, points)))
    assert (result["decision"], result["evidence"]) == (decision, evidence)
    gap = gaps(result)[mechanism]
    assert gap["reading"] == "differs"
    assert gap["evidence"] == (evidence or [CONSTRUCTION])[0]
    # What decides nothing is no evidence of what others decide.
    both = shifted(shifted(equal, mechanism, points), "offset", 0.4)
    assert item(run_validity(worlds, both))["evidence"] == evidence


def test_a_mechanism_of_somebody_elses_is_beside_the_panel(worlds, equal):
    own = replace(equal.levels[5], mechanism="mine:Ou", success=equal.levels[5].probes)
    task = replace(equal, levels=(*equal.levels, own))
    verdict = run_validity(
        worlds, task, **{"mine:Ou": Family("mine:Ou", "mine:Ou", "")}
    )
    alone = item(run_validity(worlds, equal))
    result = item(verdict)
    assert gaps(result)["mine:Ou"]["reading"] == "differs"
    assert not gaps(result)["mine:Ou"]["in_panel"]
    assert result["contrasts"][:-1] == alone["contrasts"]
    assert result["spread_high"] == alone["spread_high"]


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
    result = item(run_validity(worlds, task))
    assert result["decision"] == rules.NOT_TESTABLE
    assert why in result["why"]
    assert result["n_needed"] is None


def changed(task, **changes):
    def change_level(level):
        return replace(level, **{name: make(level) for name, make in changes.items()})

    return replace(task, levels=tuple(map(change_level, task.levels)))


def few(level):
    keep = np.arange(level.probes.size) < 7
    return {name: sums * keep for name, sums in level.descriptors.items()}


def test_what_rests_on_few_or_on_nobody_is_not_testable(worlds, equal):
    result = item(run_validity(worlds, changed(equal, descriptors=few)))
    assert result["n"] == 7
    assert "7 people" in result["why"]
    nobody = item(
        run_validity(worlds, changed(equal, success=lambda level: 0.02 * level.probes))
    )
    still = item(
        run_validity(worlds, changed(equal, success=lambda level: level.probes))
    )
    assert nobody["decision"] == still["decision"] == rules.NOT_TESTABLE
    assert "fare the same" in nobody["why"]
    high = changed(
        equal, success=lambda level: 0.8 * level.probes + 0.2 * level.success
    )
    assert "anything would track" in item(run_validity(worlds, high))["why"]


def test_beyond_the_sweep_one_direction_can_be_shown(worlds, equal):
    def tenth(level):
        share = 0.05 if level.mechanism == "correlated" else 1.0
        return {name: sums * [[share], [1]] for name, sums in level.descriptors.items()}

    below = changed(equal, descriptors=tenth)
    result = item(run_validity(worlds, shifted(below, "correlated", -0.45)))
    assert result["decision"] == rules.NOT_TESTABLE
    assert "correlated 0.75 has a lower PLR than any fixed noise" in result["why"]
    assert gaps(result)["correlated"]["only"] == "more"
    more = item(run_validity(worlds, below))
    assert (more["decision"], more["evidence"]) == (rules.DOES_NOT, [SHOWN])


def test_without_fixed_noise_there_is_nothing_to_compare_with(worlds, equal):
    task = replace(
        equal,
        levels=tuple(level for level in equal.levels if "fixed" not in level.mechanism),
    )
    assert run_validity(worlds, task) == {"items": [], "controls": [], "on_trial": []}
