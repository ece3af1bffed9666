"""The command that chooses a level: exit codes and messages."""

import json
import re
from functools import partial

import pytest
from helpers.commands import assert_refused
from helpers.summaries import (
    BAD,
    GOOD,
    PATROLS,
    RAW,
    SHIFTED,
    changed,
    edit_manifest,
    patrol_option,
    write_run,
)

from evaluation import design
from isac_track.kalman import spectra
from isac_track.mechanisms.shaped import Shaped


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
        message = (
            "Yes, against one release: slow noise of 0.4 m keeps within the limits."
            " Limits: 50 %"
        )
        assert (said.code, " ".join(said.out.split())[: len(message)]) == (0, message)

    def test_shaped_noise_is_named_where_a_run_has_it(self, made, ran):
        shaped = changed(mechanism="shaped", level=0.2)
        said = ran(design, made((RAW, BAD, shaped)), "--json")
        assert json.loads(said.out)["met"]
        assert "shaped" in said.out

    def test_is_1_if_a_control_alone_would(self, made, ran):
        said = ran(design, made((RAW, BAD, SHIFTED)), *IND)
        assert (said.code, "offset" in said.out) == (1, False)
        assert said.out.startswith("No: no level keeps within the limits.")

    @pytest.mark.parametrize(
        ("options", "code", "expected"),
        [
            (["--max-missed", "0.23"], 0, "23 % of future conflicts within 3 s missed"),
            (
                ["--max-missed", "0.21"],
                1,
                "up to 22 % of future conflicts within 3 s (limit 21 %)",
            ),
            (
                ["--max-plr", "0.3"],
                1,
                "knows up to 32 % of positions to 0.3 m (limit 30 %)",
            ),
            (
                ["--max-linkage-share", "0.41"],
                1,
                "up to 42 % of the raw re-identification aft",
            ),
            (
                ["--against", "anchor"],
                0,
                "Yes, against one release and an adversary with one true",
            ),
            (
                ["--against", "insider"],
                1,
                "and clock was not tried: add --adversary insider",
            ),
            (
                ["--horizon", "4"],
                1,
                "The run cannot say: conflicts within 4 s were not judged: add",
            ),
            (
                ["--horizon", "run", "--criterion", "missed", "--max-missed", "0.13"],
                0,
                "of all conflicts missed",
            ),
            (
                ["--predictor", "least_squares", "--max-missed", "0.4"],
                1,
                "straight line misses up to 42 %",
            ),
            (
                ["--family", "fixed"],
                1,
                "The nearest is fixed noise of 1 m (independent)",
            ),
        ],
    )
    def test_follows_what_is_asked_and_names_it(
        self, made, ran, options, code, expected
    ):
        said = ran(design, *options, *IND, made())
        assert (said.code, expected in " ".join(said.out.split())) == (code, True)

    def test_a_yes_says_who_breaks_it(self, made, ran):
        broken = changed(GOOD, beyond={"anchor": 0.92})
        said = " ".join(ran(design, made((RAW, broken))).out.split())
        assert said.startswith(
            "Yes, against one release, but not an adversary with one true pos"
        )
        assert "knows 92 % ±2 of positions; to make it count: --against anchor." in said
        assert "Not tried: --adversary repeats, companions or insider." in said

    def test_only_limits_that_were_asked_are_named(self, made, ran):
        said = ran(design, "--max-linkage-share", "1", made())
        first = " ".join(said.out.split()).partition(" ±")[0]
        assert first.endswith(
            "Limits: 50 % of positions known to 0.3 m and 0.4 m after an attack."
        )

    def test_limits_hold_after_attack_unless_asked_as_shared(self, made, ran):
        question = ["--max-plr", "0.29", made()]
        attacked, shared = (
            ran(design, *question, *more) for more in ([], ["--as-shared"])
        )
        assert (attacked.code, shared.code) == (1, 0)
        assert "known to 0.3 m and 0.4 m as sent" in " ".join(shared.out.split())

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
            (
                None,
                None,
                ["--adding", "linear"],
                "--mechanism fid:1..1000/10,adding=linear",
            ),
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
        result = json.loads(said.out)
        assert (said.code, said.err, result["met"]) == (1, "", False)
        assert "nobody walked here" in result["notes"]
        assert result["nearest"]["mechanism"] == "ou"
        whole = json.loads(ran(design, "--json", out).out)
        (proposed,) = whole["proposals"]
        assert proposed["after_attack"]["plr_wide"]["value"] == pytest.approx(0.4)
        assert [item.get("breaks") for item in proposed["beyond"]] == [
            False,
            False,
            None,
            None,
        ]
        assert whole["against"] == ["blind", "informed"]
        assert whole["answer"].startswith(
            "Yes (simulated people), against one release:"
        )

    def test_epsilon_is_that_of_the_run(self, made, ran):
        out = made()
        stages = {"privacy.epsilon_m": 0.6}
        edit_manifest(
            out, lambda manifest: manifest["settings"]["stages"].update(stages)
        )
        assert "to 0.6 m  to 0.8 m" in ran(design, out).out


class TestOnPatrol:
    @pytest.mark.parametrize(
        ("options", "code", "expected"),
        [
            (
                [],
                0,
                (
                    "On patrol: Under policy state:2 with raw positions a log knows"
                    " 20 % instead of 95 % of person-time, if a Kalman robot may miss"
                    " 5 points more conflicts. Conflicts within 3 s are counted, at"
                    " equal false alarms."
                ),
            ),
            (
                ["--max-missed", "0.6"],
                0,
                "Under policy near:3.5 with raw positions a log",
            ),
            (["--max-missed", "0.32"], 0, "A log of all answers knows 95 % of person"),
            (
                ["--max-missed", "0.25"],
                0,
                (
                    "No policy of this run keeps within the limits: a Kalman robot may"
                    " miss 25 % of conflicts. The nearest is policy everything with raw"
                    " positions: a Kalman robot misses up to 31 %. Conflicts within 3 s"
                    " are counted,"
                ),
            ),
            (
                ["--max-known", "0.25"],
                0,
                "Under policy state:2 with raw positions a log",
            ),
            (["--max-known", "0.15"], 1, "policy state:2 with raw positions: a log"),
            (["--max-followed", "0.04"], 1, "The nearest is policy state:2 with"),
            (
                ["--max-followed", "0.04", "--max-missed", "0.6"],
                0,
                "Under policy near:3.5 with raw positions a log knows 10 %",
            ),
            (
                ["--horizon", "run", "--max-known", "0.5"],
                1,
                "no conflicts within the run's own horizon were judged.",
            ),
            (
                ["--predictor", "least_squares"],
                0,
                "least_squares does not patrol; the robots of patrols are kalman_cv.",
            ),
        ],
    )
    def test_the_answer_is_a_policy_with_a_mechanism(
        self, made, ran, options, code, expected
    ):
        said = ran(design, *options, made(options=PATROLS))
        assert (said.code, expected in " ".join(said.out.split())) == (code, True)
        assert len(said.out.splitlines()) <= 12

    @pytest.mark.parametrize(("options", "code"), [([], 0), (["--max-known", "1"], 1)])
    def test_a_run_without_patrols_says_so_and_how_to_get_them(
        self, made, ran, options, code
    ):
        said = ran(design, *options, made())
        expected = "On patrol: nothing to compare; add --policy everything"
        assert (said.code, expected in " ".join(said.out.split())) == (code, True)

    def test_without_intervals_a_limit_is_not_kept(self, made, ran):
        few = [
            patrol_option(policy, missed, known, half=None)
            for policy, missed, known in (("everything", 0.3, 0.9), ("near:3", 0.3, 0))
        ]
        said = ran(design, "--max-known", "0.5", made(options=few))
        expected = "no limit holds: add --set patrol.fleets=20."
        assert (said.code, expected in " ".join(said.out.split())) == (1, True)

    def test_a_run_of_policies_alone_is_answered(self, made, ran):
        said = ran(design, made((RAW,), options=PATROLS))
        assert (said.code, "Under policy state:2 with raw" in said.out) == (1, True)

    def test_json_and_verbose_have_the_numbers(self, made, ran):
        out = made(options=PATROLS)
        said = json.loads(ran(design, "--max-known", "0.15", "--json", out).out)
        assert (said["met"], said["patrols"]["met"]) == (False, False)
        assert said["patrols"]["nearest"]["known_high"] == pytest.approx(0.21)
        assert said["patrols"]["limits"] == {"lost": 0.05, "known": 0.15}
        table = ran(design, "--verbose", out).out
        assert "state:2" in table
        assert "20.0 [19.0, 21.0]" in table

    @pytest.mark.parametrize("option", ["--max-known", "--max-followed"])
    def test_a_limit_is_a_fraction(self, made, ran, option):
        assert_refused(ran(design, option, "20", made()), f"{option} is a fraction")


class TestPlan:
    def test_says_the_total_error_first_and_needs_no_run(self, ran):
        first, *rest = ran(design, "--plan", "--max-plr", "0.2").out.splitlines()
        # [(sqrt 2 0.09 / -ln 0.8)^4 / (0.057 0.0836^3)]^(1/6)
        assert first.startswith("White noise: 3.83 m per axis in all")
        assert any("python -m evaluation.matrix" in line for line in rest)
        # 0.3 sqrt(8 / (-4 ln 0.8)) = 0.8981, no less
        assert any("--mechanism ou:0.90 " in line for line in rest)
        assert max(map(len, rest)) <= 80

    def test_names_the_lowest_level_of_shaped_that_keeps_the_limit(self, ran):
        said = ran(design, "--plan", "--max-plr", "0.2").out
        (level,) = re.findall(r"--mechanism shaped:(\S+)", said)
        known = {
            floor: spectra.known_shares(
                spectra.matern_density(
                    std_m=Shaped(floor).std_m,
                    theta_s=0.5 * Shaped(floor).tau_s,
                    order=spectra.SMOOTH_ORDER,
                ),
                epsilon_m=0.3,
                releases=1,
            )[0]
            for floor in (float(level), float(level) - 0.01)
        }
        within, beyond = known.values()
        assert within <= 0.2 < beyond
        assert f"A smoother knows {within:.1%} of positions" in said

    def test_says_that_no_level_of_shaped_is_large_enough(self, ran):
        said = ran(design, "--plan", "--max-plr", "0.001").out
        assert "No level of shaped is that large (1.2 m at most)." in said
        assert "--mechanism shaped" not in said

    def test_of_missed_conflicts_nothing_can_be_said(self, ran):
        said = ran(design, "--plan", "--max-plr", "0.2", "--max-missed", "0.15")
        assert (said.code, "Only a run tells" in said.out) == (1, True)

    @pytest.mark.parametrize(
        ("options", "says"),
        [
            (
                ["--max-plr", "1.5"],
                "the limit on PLR must lie between 0 and 1, got 1.5",
            ),
            (["--max-plr", "0.5", "--q", "0"], "--q must be positive, got 0"),
            (["--max-plr", "0.5", "--dt", "nan"], "--dt must be positive, got nan"),
            (
                ["--max-plr", "0.5", "--max-missed", "15"],
                "--max-missed is a fraction from 0 to 1",
            ),
            ([], "--max-plr"),
        ],
    )
    def test_a_mistake_is_one_line(self, options, says, ran):
        assert_refused(ran(design, "--plan", *options), says)
