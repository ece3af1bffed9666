"""The command that chooses a level: exit codes and messages, and a real run."""

import json
import shlex
from functools import partial

import pandas as pd
import pytest
from helpers.small_runs import write_tracks
from helpers.summaries import FID, FIXED, USUAL, asked, edit_manifest, edited, scheme, write_run

import evaluation
from evaluation import matrix
from evaluation.__main__ import main as isac_track
from evaluation.design import main
from evaluation.experiment.axes import axes
from evaluation.experiment.settings import Settings
from evaluation.reporting.design_words import closer, sentence


@pytest.fixture
def made(tmp_path):
    return partial(write_run, tmp_path / "run")


class TestExitCode:
    ARGUMENTS = ("--max-missed", "0.23")

    def test_is_0_if_fid_meets_everything_under_both_rules(self, made, capsys):
        assert main([*self.ARGUMENTS, str(made())]) == 0
        assert capsys.readouterr().out.startswith(
            "Yes: with fid eta = 100 (linear) and fid eta = 100 (independent) at most 23 % of the"
        )

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
        ("name", "options", "message"),
        [
            ("manifest.json", [], "holds no run"),
            ("summary.csv", [], "python -m evaluation.report"),
            ("linkability.csv", ["--max-rank1", "0.5"], "--max-rank1: "),
        ],
    )
    def test_is_2_without_a_file_that_is_needed(self, made, capsys, name, options, message):
        out = made()
        (out / name).unlink()
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

    @pytest.mark.parametrize("content", ["", "a,b\n1,2\n", "\0\0"])
    def test_is_2_for_a_broken_table(self, made, capsys, content):
        out = made()
        (out / "summary.csv").write_text(content)
        assert main([*self.ARGUMENTS, str(out)]) == 2
        assert "summary.csv cannot be read" in capsys.readouterr().err

    def test_json_is_one_object_and_nothing_else(self, made, capsys):
        out = made(simulated=True, notice="nobody walked here")
        assert main([*self.ARGUMENTS, "--max-plr", "0.1", "--json", str(out)]) == 1
        said = capsys.readouterr()
        found = json.loads(said.out)
        assert said.err == ""
        assert not found["met"]
        assert "nobody walked here" in found["notes"]

    def test_is_the_same_by_the_console_script(self, made, capsys):
        assert isac_track(["design", "--max-missed", "0.1", str(made())]) == 1
        assert capsys.readouterr().out.startswith("No:")


@pytest.fixture(scope="module")
def real_run(tmp_path_factory, tracks):
    folder = tmp_path_factory.mktemp("design")
    recording = write_tracks(folder / "walks.csv", tracks)
    evaluation.run(
        Settings(
            dataset=str(recording),
            scenes=20,
            mechanisms=("raw", "fid:100", "fid:1e6", "fixed:0.5"),
            predictors=("least_squares",),
            attacks=("kalman_rts",),
            tasks=(),
            jobs=1,
            out=folder / "run",
        ),
        pictures=False,
    )
    return folder / "run"


class TestRealRun:
    def test_gives_the_numbers_of_its_summary(self, real_run):
        answer = asked(real_run, missed=1.0, adding=("linear",))
        assert answer.met
        chosen = scheme(answer).chosen
        assert chosen.level == 100.0
        frame = pd.read_csv(real_run / "summary.csv").query("mechanism == 'fid' and level == 100")
        frame = frame.set_index(["consumer", "knowledge", "metric"])["value"]
        plain = {key[0::2]: value for key, value in frame.items() if not isinstance(key[1], str)}
        assert chosen.numbers["missed"].value == plain["least_squares", "missed_conflict_rate"]
        assert chosen.numbers["plr"].value == plain["shared", "plr"]
        assert chosen.after_attack.attack == "kalman_rts"
        assert chosen.after_attack.numbers["plr"].value == frame["kalman_rts", "informed", "plr"]
        assert sentence(answer).startswith("Yes: with fid eta = 100 (linear)")

    def test_continues_by_the_command_for_a_closer_look(self, real_run, capsys):
        answer = asked(real_run, missed=1.0, adding=("linear",))
        words = shlex.split(closer(answer))[3:]
        assert matrix.main([*words, "--dry-run"]) == 0
        # Finished are the ends of the new sweeps.
        ends = {"fid:100", "fixed:0.5"}
        said = capsys.readouterr().err
        levels = axes(matrix.settings_from(matrix.parser().parse_args(words))).mechanisms
        assert ends < {one.spec for one in levels}
        per_level = 1 + 1 + 3  # shared, the predictor, and the attack of three adversaries
        assert f"{per_level * len(levels)} cells, {per_level * len(ends)} of them finished" in said
