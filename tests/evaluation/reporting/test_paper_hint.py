"""The hint of a quick run: the command of preset `paper`."""

import pytest

from evaluation.plan.plan import make_plan
from evaluation.plan.settings import Settings
from evaluation.pool.duration import expected_s
from evaluation.reporting.paper_hint import paper_hint
from evaluation.store.describe import describe_run


def manifest(*words, preset="quick", **changes):
    return {
        "settings": {"preset": preset, "seed": 3},
        "dataset": {"name": "plaza"},
        "identity": {"scenes": 250, "scenes_utility": 2000, "scenes.agents": 4},
        "history": {"points": 350.0},
        "linkage": {
            "tasks": {"rerelease": {"candidates": {"half 1": 100, "half 2": 100}}}
        },
        "environment": {"command": ["matrix.py", *words]},
        **changes,
    }


@pytest.mark.parametrize(
    ("words", "rest"),
    [
        ((), "--dataset plaza --seed 3"),
        (
            ("--preset", "quick", "--out", "runs/a", "--fresh"),
            "--dataset plaza --seed 3",
        ),
        (("--preset=quick", "--seed", "3"), "--seed 3 --dataset plaza"),
    ],
)
def test_the_command_is_that_of_the_run_with_the_other_preset(words, rest):
    hint = paper_hint(manifest(*words))
    assert hint.command == f"python -m evaluation.matrix {rest} --preset paper"


def test_the_time_is_the_estimate_of_a_dry_run():
    plan = make_plan(Settings(preset="paper", dataset="plaza", jobs=2, fresh=True))
    described = describe_run(plan) | {"identity": plan.identity}
    described["environment"]["command"] = ["matrix.py", "--jobs", "2"]
    described["settings"]["preset"] = "quick"
    assert paper_hint(described).seconds == pytest.approx(expected_s(plan), rel=0.05)


def test_more_people_and_fewer_workers_take_longer():
    usual, single = (
        paper_hint(manifest("--jobs", "2")),
        paper_hint(manifest("--jobs=1")),
    )
    assert single.seconds > usual.seconds
    unlinked = paper_hint(manifest("--jobs", "2", linkage={}))
    assert unlinked.seconds < usual.seconds


def test_other_presets_name_no_further_command():
    assert paper_hint(manifest(preset="smoke")) is None
