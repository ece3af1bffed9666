"""The example that compares policies: a small run, its table, and what it refuses."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from helpers.patrols import make_network

import isac_track
from attacks.testing import run_checks
from isac_track.config import StageSettings
from isac_track.patrols import make_patrol
from isac_track.patrols.answers import disclose
from isac_track.plugins import parse
from isac_track.sharing import Raw

EXAMPLE = Path(isac_track.__file__).parents[1] / "examples" / "need_to_know.py"
FEW = {"patrol.fleets": 2, "patrol.segment_s": 8.0}


def load_example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLE.with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def example():
    return load_example("need_to_know")


def compare_rows(
    example, tracks, *, policies, mechanisms=("raw",), predictors=("least_squares",)
):
    return list(
        example.compare(
            tracks,
            mechanisms=example.plugins_named("mechanisms", mechanisms),
            policies=example.plugins_named("policies", policies),
            predictors=example.plugins_named("predictors", predictors),
            adversaries=example.ADVERSARIES,
            settings=StageSettings().changed(FEW),
            seed=0,
        )
    )


def numbers(row):
    return {
        name: (estimate.value, estimate.n) for name, estimate in row.metrics.items()
    }


def test_a_row_depends_on_no_other_policy_mechanism_or_robot(example, tracks):
    alone = compare_rows(example, tracks, policies=["random:0.5"])
    among = compare_rows(
        example,
        tracks,
        policies=["ahead:2", "random:0.5", "everything"],
        mechanisms=["fid:1", "raw"],
        predictors=["kalman_cv", "least_squares"],
    )
    assert len(alone) == 6  # The log, three adversaries, and two horizons of a robot.
    for row in alone:
        (same,) = (
            other
            for other in among
            if (other.mechanism, other.policy) == (row.mechanism, row.policy)
            and (other.predictor, other.horizon_s) == (row.predictor, row.horizon_s)
            and other.adversary == row.adversary
        )
        np.testing.assert_equal(numbers(same), numbers(row))


def test_prints_a_row_for_every_policy_mechanism_robot_and_horizon(
    example, capsys, csv_recording
):
    words = ["--dataset", str(csv_recording), "--policy", "near:3", "--policy", "flag"]
    words += ["--set", "patrol.fleets=2", "--set", "patrol.segment_s=8"]
    example.main(words)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("2 fleets of 1 robot(s)")
    for policy in ("near:3", "flag"):
        for mechanism in ("raw", "fid:1"):
            rows = [
                line for line in lines if line.startswith(f"| {mechanism} | {policy} |")
            ]
            # The log, an adversary who follows people by it, robots and horizons.
            assert len(rows) == 1 + 1 + 2 * 2
    assert sum(line.startswith("Robot kalman_cv, horizon") for line in lines) == 2


def test_prints_the_posterior_adversary(example, capsys, csv_recording):
    words = ["--dataset", str(csv_recording), "--posterior", "2", "--policy", "near:3"]
    words += ["--set", "patrol.fleets=2", "--set", "patrol.segment_s=8"]
    example.main(words)
    lines = capsys.readouterr().out.splitlines()
    for kind in ("blind", "informed"):
        rows = [line for line in lines if line.startswith(f"| raw | near:3 | {kind} |")]
        # Its scores, and a row for every stated probability that occurs.
        assert len(rows) >= 2


def test_prints_the_adversary_who_probes(example, capsys, csv_recording):
    words = ["--dataset", str(csv_recording), "--probing", "2", "--policy", "flag"]
    words += ["--rate", "1", "--rate", "2", "--set", "patrol.segment_s=14"]
    example.main([*words, "--set", "patrol.fleets=2"])
    lines = capsys.readouterr().out.splitlines()
    assert sum(line.startswith("| flag | none |") for line in lines) == 2
    assert sum(line.startswith("| flag | commitment |") for line in lines) == 2
    assert sum(line.startswith("| flag | limit | 2 |") for line in lines) == 1
    assert "a commitment of 3 s refuses" in lines[-2]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--policy", "neer:3"], "unknown policy 'neer'; did you mean 'near'"),
        (["--policy", "near:-3"], "metres must be positive"),
        (["--mechanism", "window:1"], "a policy selects samples"),
        (["--set", "patrol.robots=0"], "patrol.robots must lie within 1 to 100"),
        (["--posterior", "0"], "--posterior needs at least 1 person"),
        (["--probing", "3", "--rate", "-1"], "--rate must not be negative"),
        (["--probing", "3"], "nobody of 12 people stays the 11 s"),
        (["--posterior", "3", "--policy", "window:0"], "seconds must be positive"),
    ],
)
def test_a_mistake_is_one_clear_line(example, csv_recording, words, message):
    with pytest.raises(SystemExit) as ended:
        example.main(
            ["--dataset", str(csv_recording), "--set", "patrol.segment_s=8", *words]
        )
    assert message in str(ended.value)
    assert "\n" not in str(ended.value)


def test_the_usual_names_exist(example):
    for kind, specs in (
        ("policies", example.COMPARED_POLICIES),
        ("mechanisms", example.MECHANISMS),
        ("predictors", example.PREDICTORS),
    ):
        assert [plugin.spec for spec in specs for plugin in parse(kind, spec)] == list(
            specs
        )


def test_the_policy_with_a_budget_sends_no_more_people_than_it_says(tracks):
    soonest = load_example("soonest").Soonest
    for policy in (soonest(), soonest(people=1)):
        results = run_checks(policy)
        assert {result.status for result in results} == {"passed"}
    settings = StageSettings().changed(FEW)
    patrol = make_patrol(tracks, settings=settings, seed=0)
    network = make_network(patrol, Raw(), settings=settings)
    few, most = (disclose(network, soonest(people=n, metres=9.0)) for n in (1, 9))
    pairs = patrol.presences
    for answers, budget in ((few, 1), (most, 9)):
        places = np.stack([pairs.query[answers.presence], answers.robot])
        _, people = np.unique(places, axis=1, return_counts=True)
        assert people.max() <= budget
    assert few.presence.size < most.presence.size
    with pytest.raises(ValueError, match="people must be positive"):
        soonest(people=0)
