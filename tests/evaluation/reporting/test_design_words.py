"""The answer in words, as tables and JSON, and the command that looks closer."""

import io
import shlex
from functools import partial

import pytest
from helpers.summaries import FID, USUAL, asked, edit_manifest, edited, scheme, write_run
from rich.console import Console

from evaluation import matrix
from evaluation.analysis.families import ADDING_RULES
from evaluation.experiment.axes import axes
from evaluation.reporting.design_words import closer, notes, reasons, show, to_json
from isac_track.config import StageSettings

LIMITS = {"missed": 0.23, "plr": 0.42, "rank1": 0.44}


def shown(choice, *, width=116):
    raw = io.StringIO()
    show(choice, console=Console(file=raw, width=width, highlight=False))
    return raw.getvalue()


@pytest.fixture
def made(tmp_path):
    return partial(write_run, tmp_path / "run")


class TestShown:
    def test_numbers_are_those_of_the_json(self, made):
        answer = asked(made(), **LIMITS)
        text, found = shown(answer, width=200), to_json(answer)
        rows = [line.split() for line in text.splitlines() if line.startswith(("fid ", "fixed "))]
        for place, one in enumerate(found["schemes"]):
            level = one["chosen"]
            linked = {task["task"]: task["rank1"] for task in level["tasks"]}
            for table, (source, names) in enumerate(
                (
                    (level, ("missed", "false_alarm", "plr", "ael", "mel")),
                    (level["after_attack"], ("plr", "ael", "mel")),
                    (linked, tuple(linked)),
                )
            ):
                cells = [cell for cell in rows[4 * table + place] if cell[0].isdigit()]
                expected = []
                for name in names:
                    scale, digits = (1, 3) if name in ("ael", "mel") else (100, 1)
                    value, low, high = (
                        f"{scale * source[name][end]:.{digits}f}"
                        for end in ("value", "ci_low", "ci_high")
                    )
                    expected += [value, f"{low}-{high}"]
                assert float(cells[0]) == level["level"]
                assert cells[1:] == expected

    def test_keys_are_stable(self, made):
        found = to_json(asked(made(), **LIMITS))
        first = found["schemes"][0]
        every = "met answer out dataset simulated scenes seed predictor adding limits raw schemes"
        task = "task dataset limited attack knowledge rank1 chance outcome invalid"
        for one, names in (
            (found, f"{every} refine notes"),
            (first, "adding family met chosen stricter also_meets is_saturated checks reasons"),
            (first["chosen"], "mechanism level missed false_alarm plr ael mel after_attack tasks"),
            (first["chosen"]["after_attack"], "attack knowledge plr ael mel"),
            (first["chosen"]["tasks"][0], task),
            (first["checks"][0], "name limit measured status reason"),
        ):
            assert list(one) == names.split()
        rules = [(one["adding"], one["family"]) for one in found["schemes"]]
        assert rules == [(rule, name) for rule in ADDING_RULES for name in ("fid", "fixed")]
        assert found["raw"]["level"] is None

    def test_limits_stand_above_what_they_are_about(self, made):
        out = made()
        text = shown(asked(out, **LIMITS), width=200)
        limits = [line.split("<=")[1:] for line in text.splitlines() if "<=" in line]
        # Not above the simulated task; the title is the only other place.
        assert [[one.split()[0] for one in line] for line in limits] == [["23", "42"], ["44"]]
        after = shown(asked(out, missed=0.23, plr=0.9, after_attack=True))
        limits = [line.split() for line in after.splitlines() if "<=" in line]
        assert [line[:2] for line in limits] == [["<=", "23"], ["<=", "90"]]

    def test_a_mark_is_explained_and_lines_fit(self, made):
        cells = {("split", "shape", "informed"): {"rank1": 0.01, "outcome": "no link detected"}}
        text = shown(asked(made(cells=cells), **LIMITS), width=80)
        assert "~ no link detected" in text
        assert all(len(line) <= 80 or line.startswith("python -m") for line in text.splitlines())


class TestCloser:
    """The command that adds levels where the answer turns."""

    def words(self, answer):
        words = shlex.split(closer(answer))
        assert words[:3] == ["python", "-m", "evaluation.matrix"]
        return words[3:]

    def options(self, answer):
        return matrix.settings_from(matrix.parser().parse_args(self.words(answer)))

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

    def test_is_not_needed_where_the_error_is_full_already(self, made):
        out = made({"fid": FID})

        def saturated(frame):
            shared = frame["consumer"] == "shared"
            first, second = (shared & (frame["level"] == level) for level in ("1.0", "10.0"))
            names = ["value", "ci_low", "ci_high"]
            frame.loc[first, names] = frame.loc[second, names].to_numpy()
            return frame

        edited(out, "summary.csv", saturated)
        answer = asked(out, missed=0.40, adding=("linear",))
        assert closer(answer) is None
        assert "every sample has the full error" in reasons(scheme(answer))[0]

    def test_leaves_a_run_of_other_code_alone(self, made):
        out = made(USUAL | {"fid": {1.0: 0.1, 10.0: 0.1}}, code="older")
        answer = asked(out, missed=0.23)
        settings = self.options(answer)
        assert settings.out == out.with_name("run-closer")
        assert settings.mechanisms[0] == "raw"
        assert any("another version of the code" in note for note in notes(answer))
