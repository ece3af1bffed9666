"""The command that chooses a level: exit codes and messages."""

import json
from functools import partial

import pytest
from helpers.summaries import FID, FIXED, IND, USUAL, edit_manifest, edited, write_run

from evaluation.design import main


@pytest.fixture
def made(tmp_path):
    return partial(write_run, tmp_path / "run")


ONLY_FID = {"rates": {"fid": FID}}


def holding(name, content=None):
    """Let a file of a run hold something else; by default it is gone."""

    def spoil(out):
        (out / name).unlink()
        if content is not None:
            (out / name).write_text(content)

    return spoil


def unattacked(out):
    """Leave nobody who attacks the recording itself."""
    edited(out, "summary.csv", lambda frame: frame[frame["knowledge"] == ""])
    simulated = "consumer.str.startswith('new_traversal')"
    edited(out, "linkability.csv", lambda frame: frame.query(simulated))


def unpredicted(out):
    edit_manifest(out, lambda manifest: manifest["settings"].update(predictors=[]))


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

    @pytest.mark.parametrize(
        ("rates", "told"),
        [
            (USUAL | {"fixed": {0.1: 0.9}}, " fixed none "),
            ({"fid": FID, f"fid{IND}": FID}, "has no level of fixed with linear or independent"),
        ],
    )
    def test_does_not_depend_on_fixed_noise(self, made, capsys, rates, told):
        assert main([*self.ARGUMENTS, str(made(rates))]) == 0
        assert told in " ".join(capsys.readouterr().out.split())

    @pytest.mark.parametrize(
        ("run", "spoil", "options", "message"),
        [
            ({}, None, ["--predictor", "kalman"], "--predictor kalman: "),
            ({}, None, ["--adding", "mine"], "--adding"),
            ({}, None, ["--max-plr", "much"], "--max-plr"),
            ({}, None, ["--after-attack"], "--after-attack"),
            (ONLY_FID, None, [], "--mechanism fid:1..1000/10,adding=independent, or ask for"),
            (ONLY_FID, None, ["--adding", "independent"], "ask for --adding linear alone"),
            ({"rates": {"fixed": FIXED}}, None, ["--adding", "linear"], "fid:1..1000/10\n"),
            ({}, holding("manifest.json"), [], "holds no run"),
            ({}, holding("summary.csv"), [], "python -m evaluation.report"),
            ({}, holding("linkability.csv"), ["--max-rank1", "0.5"], "--max-rank1: "),
            *(
                ({}, holding("summary.csv", content), [], "summary.csv cannot be read")
                for content in ("", "a,b\n1,2\n", "\0\0")
            ),
            ({}, unattacked, ["--max-rank1", "0.5"], "links nobody of its recording"),
            ({}, unattacked, ["--max-plr", "0.5", "--after-attack"], "no reconstruction attack"),
            ({}, unpredicted, [], "--predictor least_squares"),
        ],
    )
    def test_is_2_with_one_line_for_what_the_run_cannot_answer(
        self, made, capsys, run, spoil, options, message
    ):
        out = made(**run)
        if spoil is not None:
            spoil(out)
        assert main([*self.ARGUMENTS, *options, str(out)]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.startswith("error: ")
        assert said.err.count("\n") == 1
        assert message in said.err

    def test_is_2_without_a_target(self, made, capsys):
        assert main([str(made())]) == 2
        assert "--max-missed" in capsys.readouterr().err

    def test_is_0_without_linkability_if_nobody_asks(self, made, capsys):
        assert main([*self.ARGUMENTS, str(made(cells=None))]) == 0
        assert "Rank 1" not in capsys.readouterr().out

    def test_json_is_one_object_and_nothing_else(self, made, capsys):
        out = made(simulated=True, notice="nobody walked here")
        assert main([*self.ARGUMENTS, "--max-plr", "0.1", "--json", str(out)]) == 1
        said = capsys.readouterr()
        found = json.loads(said.out)
        assert said.err == ""
        assert not found["met"]
        assert "nobody walked here" in found["notes"]
