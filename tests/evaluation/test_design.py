"""The command that chooses a level: exit codes and messages."""

import json
from functools import partial

import pytest
from helpers.summaries import FID, FIXED, USUAL, edit_manifest, edited, write_run

from evaluation.design import main


@pytest.fixture
def made(tmp_path):
    return partial(write_run, tmp_path / "run")


class TestExitCode:
    ARGUMENTS = ("--max-missed", "0.23")

    def test_is_0_if_fid_meets_everything_under_both_rules(self, made, capsys):
        assert main([*self.ARGUMENTS, str(made())]) == 0
        said = capsys.readouterr().out.replace("\n", " ")
        assert said.startswith(
            "Yes: with fid eta = 100 (linear) and fid eta = 100 (independent) at most 23 % of the"
        )
        assert " linear adding " in said
        assert "adding adding" not in said

    def test_is_1_if_one_rule_fails_and_0_if_it_is_not_asked_about(self, made, capsys):
        out = made(USUAL | {"fid": {1.0: 0.4, 1000.0: 0.3}})
        assert main([*self.ARGUMENTS, str(out)]) == 1
        said = capsys.readouterr().out.replace("\n", " ")
        assert said.startswith("No: no eta of the run meets the targets with linear adding;")
        assert "fid eta = 100 (independent) meets everything" in said
        assert main([*self.ARGUMENTS, "--adding", "independent", str(out)]) == 0
        assert main([*self.ARGUMENTS, "--adding", "linear", str(out)]) == 1

    def test_does_not_depend_on_fixed_noise(self, made, capsys):
        assert main([*self.ARGUMENTS, str(made(USUAL | {"fixed": {0.1: 0.9}}))]) == 0
        rows = [line.split() for line in capsys.readouterr().out.splitlines()]
        assert ["fixed", "none"] in [row[:2] for row in rows]

    def test_is_0_without_fixed_noise(self, made, capsys):
        rates = {name: of for name, of in USUAL.items() if name.startswith("fid")}
        assert main([*self.ARGUMENTS, str(made(rates))]) == 0
        assert "has no level of fixed with linear or independent" in capsys.readouterr().out

    @pytest.mark.parametrize(
        ("rates", "options", "message"),
        [
            (USUAL, ["--predictor", "kalman"], "--predictor kalman: "),
            (USUAL, ["--adding", "mine"], "--adding"),
            (USUAL, ["--max-plr", "much"], "--max-plr"),
            (USUAL, ["--after-attack"], "--after-attack"),
            ({"fid": FID}, [], "--mechanism fid:1..1000/10,adding=independent, or ask for"),
            ({"fid": FID}, ["--adding", "independent"], "ask for --adding linear alone"),
            ({"fixed": FIXED}, ["--adding", "linear"], "--mechanism fid:1..1000/10\n"),
        ],
    )
    def test_is_2_with_one_line_for_what_the_run_cannot_answer(
        self, made, capsys, rates, options, message
    ):
        assert main([*self.ARGUMENTS, *options, str(made(rates))]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.startswith("error: ")
        assert said.err.count("\n") == 1
        assert message in said.err

    def test_is_2_without_a_target(self, made, capsys):
        assert main([str(made())]) == 2
        assert "--max-missed" in capsys.readouterr().err

    @pytest.mark.parametrize(
        ("name", "content", "options", "message"),
        [
            ("manifest.json", None, [], "holds no run"),
            ("summary.csv", None, [], "python -m evaluation.report"),
            ("linkability.csv", None, ["--max-rank1", "0.5"], "--max-rank1: "),
            ("summary.csv", "", [], "summary.csv cannot be read"),
            ("summary.csv", "a,b\n1,2\n", [], "summary.csv cannot be read"),
            ("summary.csv", "\0\0", [], "summary.csv cannot be read"),
        ],
    )
    def test_is_2_without_a_file_that_is_needed(
        self, made, capsys, name, content, options, message
    ):
        out = made()
        (out / name).unlink()
        if content is not None:
            (out / name).write_text(content)
        assert main([*self.ARGUMENTS, *options, str(out)]) == 2
        assert message in capsys.readouterr().err

    def test_is_0_without_linkability_if_nobody_asks(self, made, capsys):
        assert main([*self.ARGUMENTS, str(made(cells=None))]) == 0
        assert "Rank 1" not in capsys.readouterr().out

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            (["--max-rank1", "0.5"], "links nobody of its recording"),
            (["--max-plr", "0.5", "--after-attack"], "has no reconstruction attack"),
        ],
    )
    def test_is_2_where_no_attack_was_run(self, made, capsys, options, message):
        out = made(cells={("new_traversal", "shape", "blind"): {"rank1": 0.80}})
        edited(out, "summary.csv", lambda frame: frame[frame["knowledge"] == ""])
        assert main([*self.ARGUMENTS, *options, str(out)]) == 2
        assert message in capsys.readouterr().err

    def test_is_2_without_a_predictor(self, made, capsys):
        out = made()
        edit_manifest(out, lambda manifest: manifest["settings"].update(predictors=[]))
        assert main([*self.ARGUMENTS, str(out)]) == 2
        assert "--predictor least_squares" in capsys.readouterr().err

    def test_json_is_one_object_and_nothing_else(self, made, capsys):
        out = made(simulated=True, notice="nobody walked here")
        assert main([*self.ARGUMENTS, "--max-plr", "0.1", "--json", str(out)]) == 1
        said = capsys.readouterr()
        found = json.loads(said.out)
        assert said.err == ""
        assert not found["met"]
        assert "nobody walked here" in found["notes"]
