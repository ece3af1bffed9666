"""The command that chooses a level: exit codes and messages."""

import json
from functools import partial

import pytest
from helpers.commands import assert_refused
from helpers.summaries import BAD, GOOD, RAW, SHIFTED, changed, edit_manifest, write_run

from evaluation import design


@pytest.fixture
def made(tmp_path):
    return partial(write_run, tmp_path / "run")


IND = ("--adding", "independent")


def holding(name, content=None):
    """Let a file of a run hold something else; by default it is gone."""

    def spoil(out):
        (out / name).unlink()
        if content is not None:
            (out / name).write_text(content)

    return spoil


class TestExitCode:
    def test_is_0_if_some_level_holds_everything(self, made, ran):
        said = ran(design, made())
        told = "Yes, against blind and informed: ou:0.4 ind. holds PLR after attack (at epsilon and"
        assert (said.code, " ".join(said.out.split())[: len(told)]) == (0, told)

    def test_is_1_if_a_control_alone_would(self, made, ran):
        said = ran(design, made((RAW, BAD, SHIFTED)), *IND)
        assert (said.code, "offset" in said.out) == (1, False)
        assert said.out.startswith("No: no level holds")

    @pytest.mark.parametrize(
        ("options", "code", "told"),
        [
            (["--max-missed", "0.23"], 0, "missed conflicts to come within 3 s <= 23 %"),
            (["--max-missed", "0.21"], 1, "missed conflicts 20.0 % [18.0, 22.0], above 21 %"),
            (["--max-plr", "0.3"], 1, "PLR after ou_rts (informed) 30.0 % [28.0, 32.0], above 30"),
            (["--max-linkage-share", "0.41"], 1, "linkage after 1 s 40.0 % [38.0, 42.0] of raw's"),
            (["--against", "anchor"], 0, "Yes, against blind and informed and anchor: ou:0.4 ind."),
            (["--against", "insider"], 1, "Not answerable: insider was not tried: add --adversary"),
            (
                ["--horizon", "4"],
                1,
                "Not answerable: conflicts within 4 s were not judged: add --s",
            ),
            (
                ["--horizon", "run", "--criterion", "missed", "--max-missed", "0.13"],
                0,
                "missed all ",
            ),
            (["--predictor", "least_squares", "--max-missed", "0.4"], 1, "missed conflicts 40.0 %"),
            (["--family", "fixed"], 1, "The nearest is fixed:1 ind.: PLR after ou_rts"),
        ],
    )
    def test_follows_what_is_asked_and_names_it(self, made, ran, options, code, told):
        said = ran(design, *options, *IND, made())
        assert (said.code, told in " ".join(said.out.split())) == (code, True)

    def test_a_yes_says_who_breaks_it(self, made, ran):
        broken = changed(GOOD, beyond={"anchor": 0.92})
        said = " ".join(ran(design, made((RAW, broken))).out.split())
        assert said.startswith("Yes, against blind and informed: ou:0.4 ind. holds")
        assert "; anchor breaks ou:0.4 ind.: 92.0 % [90.0, 94.0]." in said
        assert "Not tried: repeats, companions, insider (--adversary NAME)." in said

    def test_only_limits_that_were_asked_are_named(self, made, ran):
        said = ran(design, "--max-linkage-share", "1", made())
        first = " ".join(said.out.split()).partition(" walks:")[0]
        assert first.endswith("holds PLR after attack (at epsilon and at 4/3 of it) <= 50 %.")

    def test_limits_hold_after_attack_unless_asked_as_shared(self, made, ran):
        question = ["--max-plr", "0.29", made()]
        attacked, shared = (ran(design, *question, *more) for more in ([], ["--as-shared"]))
        assert (attacked.code, shared.code) == (1, 0)
        assert "PLR as shared (at epsilon" in " ".join(shared.out.split())

    @pytest.mark.parametrize(
        ("levels", "spoil", "options", "message"),
        [
            (None, None, ["--predictor", "kalman"], "--predictor kalman: "),
            (None, None, ["--adding", "mine"], "--adding"),
            (None, None, ["--max-plr", "much"], "--max-plr"),
            (None, None, ["--family", "fixd"], "did you mean 'fixed'?"),
            (None, None, ["--against", "anchr"], "did you mean 'anchor'?"),
            (None, None, ["--horizon", "soon"], "--horizon takes a time in s or `run`"),
            (None, None, ["--criterion", "mine"], "--criterion"),
            (None, None, ["--adding", "linear"], "--mechanism fid:1..1000/10,adding=linear"),
            ((RAW, SHIFTED), None, [], "has no level that claims to protect"),
            (None, holding("manifest.json"), [], "holds no run"),
            (None, holding("levels.csv"), [], "python -m evaluation.report"),
            *(
                (None, holding("levels.csv", content), [], "levels.csv cannot be read")
                for content in ("", "a,b\n1,2\n", "\0\0")
            ),
        ],
    )
    def test_is_2_with_one_line_for_what_the_run_cannot_answer(
        self, made, ran, levels, spoil, options, message
    ):
        out = made(levels) if levels else made()
        if spoil is not None:
            spoil(out)
        said = ran(design, *options, out)
        assert_refused(said, message)
        assert (said.out, said.err.count("\n")) == ("", 1)

    def test_json_is_one_object_and_nothing_else(self, made, ran):
        out = made(simulated=True, notice="nobody walked here")
        said = ran(design, "--max-plr", "0.1", "--json", out)
        found = json.loads(said.out)
        assert (said.code, said.err, found["met"]) == (1, "", False)
        assert "nobody walked here" in found["notes"]
        assert found["nearest"]["mechanism"] == "ou"
        whole = json.loads(ran(design, "--json", out).out)
        (proposed,) = whole["proposals"]
        assert proposed["after_attack"]["plr_wide"]["value"] == pytest.approx(0.4)
        assert [one.get("breaks") for one in proposed["beyond"]] == [False, False, None, None]
        assert whole["against"] == ["blind", "informed"]
        assert whole["answer"].startswith("Yes (simulated people), against blind and informed:")

    def test_epsilon_is_that_of_the_run(self, made, ran):
        out = made()
        stages = {"privacy.epsilon_m": 0.6}
        edit_manifest(out, lambda manifest: manifest["settings"]["stages"].update(stages))
        assert "40.0 % [38.0, 42.0] at 0.8 m" in " ".join(ran(design, out).out.split())


class TestPlan:
    def test_says_the_total_error_first_and_needs_no_run(self, ran):
        first, *rest = ran(design, "--plan", "--max-plr", "0.2").out.splitlines()
        # [(sqrt 2 0.09 / -ln 0.8)^4 / (0.057 0.0836^3)]^(1/6)
        assert first.startswith("total std per axis, raw and added: 3.83 m")
        assert any("python -m evaluation.matrix" in line for line in rest)
        # 0.3 sqrt(8 / (-4 ln 0.8)) = 0.8981, no less
        assert any("--mechanism ou:0.90 " in line for line in rest)
        assert max(map(len, rest)) <= 80

    def test_of_missed_conflicts_nothing_can_be_said(self, ran):
        said = ran(design, "--plan", "--max-plr", "0.2", "--max-missed", "0.15")
        assert (said.code, "only a run tells" in said.out) == (1, True)

    @pytest.mark.parametrize(
        ("options", "says"),
        [
            (["--max-plr", "1.5"], "the limit on PLR must lie between 0 and 1, got 1.5"),
            (["--max-plr", "0.5", "--q", "0"], "--q must be positive, got 0"),
            (["--max-plr", "0.5", "--dt", "nan"], "--dt must be positive, got nan"),
            (["--max-plr", "0.5", "--max-missed", "15"], "--max-missed is a fraction from 0 to 1"),
            ([], "--max-plr"),
        ],
    )
    def test_a_mistake_is_one_line(self, options, says, ran):
        assert_refused(ran(design, "--plan", *options), says)
