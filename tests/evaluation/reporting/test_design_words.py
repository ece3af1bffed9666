"""The answer in words, as tables and JSON, and the command that looks closer."""

import io
import json
import shlex
from functools import partial
from pathlib import Path

import pytest
from helpers.pages import assert_as_approved
from helpers.summaries import USUAL, asked, edit_manifest, write_run
from rich.console import Console

from evaluation import matrix
from evaluation.experiment.axes import axes
from evaluation.reporting.design_words import closer, notes, show, to_json
from isac_track.config import StageSettings

LIMITS = {"missed": 0.23, "plr": 0.42, "rank1": 0.44}


def shown(choice, *, width=116):
    raw = io.StringIO()
    show(choice, console=Console(file=raw, width=width, highlight=False))
    return raw.getvalue()


@pytest.fixture
def made(tmp_path):
    return partial(write_run, tmp_path / "run")


def test_the_answer_is_letter_for_letter_what_was_read_and_approved(made, tmp_path):
    # Limits stand above what they are about, but not above a simulated task.
    cells = {
        ("split", "shape", "informed"): {"rank1": 0.01, "outcome": "no link detected"},
        ("rerelease", "shape", "informed"): {"rank1": 0.40},
        ("new_traversal", "shape", "blind"): {"rank1": 0.80},
    }
    out = made(cells=cells)
    answer = asked(out, as_shared=True, **LIMITS)
    after = asked(out, missed=0.23, plr=0.9, adding=("linear",))
    parts = [shown(answer, width=80), shown(after), json.dumps(to_json(after), indent=1)]
    text = "\n".join(parts).replace(str(tmp_path), "")
    assert_as_approved(text, Path(__file__).with_name("design.txt"))


class TestCloser:
    """The command that adds levels where the answer turns."""

    def options(self, answer):
        python, flag, module, *words = shlex.split(closer(answer))
        assert (python, flag, module) == ("python", "-m", "evaluation.matrix")
        return matrix.settings_from(matrix.parser().parse_args(words))

    def test_is_between_the_chosen_level_and_the_next_stricter_one(self, made):
        out = made()
        settings = self.options(asked(out, missed=0.23))
        assert settings.mechanisms == (
            "fid:10..100/10",
            "fixed:0.5..1/10",
            "fid:10..100/10,adding=independent",
            "fixed:0.5..1/10,adding=independent",
        )
        assert settings.out == out
        levels = [one.level for one in axes(settings).mechanisms if one.name == "fid"]
        assert (levels[0], levels[-1], len(levels)) == (10.0, 100.0, 10)

    def test_has_the_identity_and_the_consumers_of_the_run(self, made):
        out = made()

        def other(manifest):
            manifest["identity"] |= {"scenes": 40, "seed": 7, "fps": 12.5}
            manifest["settings"]["stages"]["privacy.epsilon_m"] = 0.5
            manifest["settings"]["tasks"] = []
            manifest["dataset"]["format"] = "obsmat"

        edit_manifest(out, other)
        settings = self.options(asked(out, missed=0.23))
        assert (settings.scenes, settings.seed, settings.preset) == (40, 7, "paper")
        assert (settings.dataset, settings.format) == ("my walks.csv", "obsmat")
        assert settings.fps == 12.5
        assert settings.stages == StageSettings().changed({"privacy.epsilon_m": "0.5"})
        assert settings.predictors == ("least_squares", "kalman_cv")
        assert settings.attacks is None  # the preset's
        assert settings.tasks == ()

    @pytest.mark.parametrize(
        ("missed", "mechanisms"),
        [
            (0.40, ("fid:0.01..1/10", "fixed:0.5..1/10")),  # every level meets it
            (0.20, ("fid:10..1000/10", "fixed:0.02..0.2/10")),  # none does: towards raw
        ],
    )
    def test_goes_on_beyond_the_last_level(self, made, missed, mechanisms):
        rates = {"fid": {1.0: 0.30, 10.0: 0.25}, "fixed": {0.2: 0.25, 0.5: 0.30}}
        answer = asked(made(rates), missed=missed, adding=("linear",))
        assert self.options(answer).mechanisms == mechanisms

    def test_leaves_a_run_of_other_code_alone(self, made):
        out = made(USUAL | {"fid": {1.0: 0.1, 10.0: 0.1}, "offset": {0.3: 0.1}}, code="older")
        answer = asked(out, missed=0.23)
        assert closer(answer).count("offset:0.3") == 1  # though it is judged under both rules
        settings = self.options(answer)
        assert settings.out == out.with_name("run-closer")
        assert settings.mechanisms[0] == "raw"
        assert any("another version of the code" in note for note in notes(answer))
