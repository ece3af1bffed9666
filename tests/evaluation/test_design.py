"""The command that chooses a level: exit codes and messages."""

import json
from functools import partial

import pytest
from helpers.commands import assert_refused
from helpers.summaries import FID, FIXED, IND, USUAL, edit_manifest, edited, write_run

from evaluation import design


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

    def test_is_0_if_fid_meets_everything_under_both_rules(self, made, ran):
        said = ran(design, *self.ARGUMENTS, made())
        told = "Yes: with fid eta = 100 (linear) and eta = 100 (independent), or fixed d_sig"
        assert (said.code, " ".join(said.out.split())[: len(told)]) == (0, told)

    @pytest.mark.parametrize(("rules", "code"), [("", 1), ("independent", 0), ("linear", 1)])
    def test_is_1_if_one_rule_fails_and_0_if_it_is_not_asked_about(self, made, ran, rules, code):
        asked = ["--adding", rules] if rules else []
        out = made(USUAL | {"fid": {1.0: 0.4, 1000.0: 0.3}})
        assert ran(design, *self.ARGUMENTS, "--family", "fid", *asked, out).code == code

    @pytest.mark.parametrize(
        ("rates", "families", "code", "told"),
        [
            (USUAL | {"fid": {1.0: 0.9}}, [], 0, "Yes: with fixed d_sigma = 0.5 (linear) and"),
            (USUAL | {"fid": {1.0: 0.9}}, ["fid"], 1, "with linear adding: fid."),
            (USUAL | {"fixed": {0.1: 0.9}}, ["fixed"], 1, "with linear adding: fixed."),
            (USUAL | {"fixed": {0.1: 0.9}}, ["fid", "fixed"], 0, "Yes: with fid eta = 100 (l"),
            # What has no level under one of the rules gives no answer.
            ({"fid": {1.0: 0.9}, f"fid{IND}": {1.0: 0.9}, "fixed": FIXED}, [], 1, "targets: fid."),
        ],
    )
    def test_is_0_if_some_family_asked_about_meets_everything(
        self, made, ran, rates, families, code, told
    ):
        named = [word for name in families for word in ("--family", name)]
        said = ran(design, *self.ARGUMENTS, *named, made(rates))
        assert (said.code, told in " ".join(said.out.split())) == (code, True)

    def test_limits_hold_after_attack_unless_asked_as_shared(self, made, ran):
        # PLR at eta = 100: 0.4 as shared, 0.7 after the strongest attack.
        question = [*self.ARGUMENTS, "--family", "fid", "--max-plr", "0.5", made()]
        attacked, shared = (ran(design, *question, *more) for more in ([], ["--as-shared"]))
        assert attacked.out.startswith("No: above the limits of PLR: fid.")
        assert "privacy limit holds as shared." in " ".join(shared.out.split())
        assert (attacked.code, shared.code) == (1, 0)

    @pytest.mark.parametrize(
        ("run", "spoil", "options", "message"),
        [
            ({}, None, ["--predictor", "kalman"], "--predictor kalman: "),
            ({}, None, ["--adding", "mine"], "--adding"),
            ({}, None, ["--max-plr", "much"], "--max-plr"),
            ({}, None, ["--family", "fixd"], "did you mean 'fixed'?"),
            (ONLY_FID, None, [], "--mechanism fid:1..1000/10,adding=independent, or ask for"),
            (ONLY_FID, None, ["--adding", "independent"], "ask for --adding linear alone"),
            ({"rates": {"fixed": FIXED}}, None, [], "fixed:0.1..1/10,adding=independent, or"),
            ({"rates": {}}, None, ["--adding", "linear"], "fid:1..1000/10"),
            ({}, holding("manifest.json"), [], "holds no run"),
            ({}, holding("summary.csv"), [], "python -m evaluation.report"),
            ({}, holding("linkability.csv"), ["--max-rank1", "0.5"], "--max-rank1: "),
            *(
                ({}, holding("summary.csv", content), [], "summary.csv cannot be read")
                for content in ("", "a,b\n1,2\n", "\0\0")
            ),
            ({}, unattacked, ["--max-rank1", "0.5"], "links nobody of its recording"),
            ({}, unattacked, ["--max-plr", "0.5"], "ask for --as-shared"),
            ({}, unpredicted, [], "--predictor least_squares"),
        ],
    )
    def test_is_2_with_one_line_for_what_the_run_cannot_answer(
        self, made, ran, run, spoil, options, message
    ):
        out = made(**run)
        if spoil is not None:
            spoil(out)
        said = ran(design, *self.ARGUMENTS, *options, out)
        assert_refused(said, message)
        assert (said.out, said.err.count("\n")) == ("", 1)

    def test_is_2_without_a_target(self, made, ran):
        assert_refused(ran(design, made()), "--max-missed")

    def test_is_0_without_linkability_if_nobody_asks(self, made, ran):
        said = ran(design, *self.ARGUMENTS, made(cells=None))
        assert (said.code, "Rank 1" in said.out) == (0, False)

    def test_json_is_one_object_and_nothing_else(self, made, ran):
        out = made(simulated=True, notice="nobody walked here")
        said = ran(design, *self.ARGUMENTS, "--max-plr", "0.1", "--json", out)
        found = json.loads(said.out)
        assert (said.code, said.err, found["met"]) == (1, "", False)
        assert "nobody walked here" in found["notes"]


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
