"""What a quick run says of the command that computes the whole sweep."""

import pytest

from evaluation.reporting.paper_hint import paper_hint


def manifest(*words, preset="quick", **times):
    return {
        "settings": {"preset": preset, "seed": 3},
        "dataset": {"name": "plaza"},
        "environment": {"command": ["matrix.py", *words]},
        "wall_time_s": 30.0,
        **times,
    }


@pytest.mark.parametrize(
    ("words", "rest"),
    [
        ((), "--dataset plaza --seed 3"),
        (("--preset", "quick", "--out", "runs/a", "--fresh"), "--dataset plaza --seed 3"),
        (("--preset=quick", "--seed", "3"), "--seed 3 --dataset plaza"),
    ],
)
def test_the_command_is_that_of_the_run_with_the_other_preset(words, rest):
    hint = paper_hint(manifest(*words))
    assert hint.command == f"python -m evaluation.matrix {rest} --preset paper"


def test_the_time_goes_by_that_of_the_run_without_compiling():
    cold, warm = paper_hint(manifest(compiling_s=10.0)), paper_hint(manifest())
    assert cold.seconds == pytest.approx(warm.seconds * 2 / 3)


def test_other_presets_name_no_further_command():
    assert paper_hint(manifest(preset="smoke")) is None
