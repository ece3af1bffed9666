"""Choosing a level: which one, whether the limits hold there, what cannot be said."""

import io
import json
import shlex
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

import evaluation
from evaluation import matrix
from evaluation.__main__ import main as isac_track
from evaluation.analysis import linkability, summary
from evaluation.design import Limits, design, main
from evaluation.experiment.axes import axes
from evaluation.experiment.fingerprint import code_hash
from evaluation.experiment.presets import PRESETS
from evaluation.experiment.settings import Settings
from evaluation.reporting.design_tables import show, to_json
from isac_track.config import StageSettings
from isac_track.errors import SettingsError

IND = ":adding=independent"
HALF = 0.02
"""Half an interval of a rate."""
FID = {1.0: 0.30, 10.0: 0.25, 100.0: 0.20, 1000.0: 0.15}
"""Missed rate by eta."""
FIXED = {0.1: 0.14, 0.5: 0.19, 1.0: 0.30}
USUAL = {
    "fid": FID,
    "fixed": FIXED,
    f"fid{IND}": {eta: missed - 0.03 for eta, missed in FID.items()},
    f"fixed{IND}": {d_sigma: missed - 0.03 for d_sigma, missed in FIXED.items()},
}
LINKS = {"outcome": "links", "invalid": ""}


def leak(mechanism, level):
    """PLR as shared: the less is added, the more is left."""
    order = np.log10(level) / 10 if mechanism.startswith("fid") else (1 - level) / 4
    return 0.2 + float(order)


def numbers(mechanism, level, missed, *, half=HALF):
    """Rows of the summary at one level: consumer, adversary, metric, value, half interval."""
    plr = 0.5 if level is None else leak(mechanism, level)
    return [
        ("shared", "", "plr", plr, 0.01),
        ("shared", "", "ael", plr / 2, 0.01),
        ("shared", "", "mel", 2 * plr, 0.1),
        ("shared", "", "rmse", 1.0, 0.1),
        ("least_squares", "", "missed_conflict_rate", missed, half),
        ("least_squares", "", "false_alarm_rate", missed / 2, half),
        ("kalman_cv", "", "missed_conflict_rate", missed / 2, half),
        ("kalman_cv", "", "false_alarm_rate", missed / 4, half),
        ("kalman_rts", "blind", "plr", plr + 0.40, 0.01),  # better than when it knows more
        ("kalman_rts", "informed", "plr", plr + 0.20, 0.01),
        ("kalman_rts", "informed", "ael", 9.0, 0.1),
        ("kalman_rts", "informed", "mel", 9.9, 0.1),
        ("radial_rts", "informed", "plr", plr + 0.30, 0.01),
        ("radial_rts", "informed", "ael", 2.0, 0.1),
        ("radial_rts", "informed", "mel", 4.0, 0.1),
        ("averaging", "oracle", "plr", 0.99, 0.005),
    ]


def summary_frame(rates, *, half=HALF):
    levels = [("raw", None, 0.12)]
    levels += [(name, at, missed) for name, of in rates.items() for at, missed in of.items()]
    rows = [
        {
            "dataset": "walks",
            "mechanism": mechanism,
            "level": np.nan if level is None else level,
            "consumer": consumer,
            "knowledge": knowledge,
            "metric": metric,
            "value": value,
            "ci_low": value - spread,
            "ci_high": value + spread,
            "n": 55,
        }
        for mechanism, level, missed in levels
        for consumer, knowledge, metric, value, spread in numbers(
            mechanism, level, missed, half=half
        )
    ]
    return pd.DataFrame(rows, columns=summary.COLUMNS)


def linked_frame(rates, cells):
    """`cells`: (task, attack, adversary) -> rank 1 and what else a row says, at every level."""
    levels = [("raw", np.nan), *[(name, at) for name, of in rates.items() for at in of]]
    rows = []
    for mechanism, level in levels:
        for (task, attack, knowledge), row in cells.items():
            consumer = f"{task}/{attack}"
            value = row["rank1"]
            cell = {"mechanism": mechanism, "level": level, "consumer": consumer}
            cell |= {"dataset": linkability.dataset_of(consumer, dataset="walks")}
            cell |= {"knowledge": knowledge, "chance": 0.01}
            cell |= LINKS | {"ci_low": value - 0.05, "ci_high": value + 0.05} | row
            # Walking groups left out it links more, but that is another question.
            rows += [
                cell | {"cohort": "without_groups", "rank1": 0.98, "outcome": np.nan},
                cell | {"cohort": "all"},
            ]
    return pd.DataFrame(rows, columns=linkability.COLUMNS)


ATTACKS = {
    ("rerelease", "control-random", ""): {"rank1": 0.97},
    ("rerelease", "shape", "blind"): {"rank1": 0.90},
    ("rerelease", "shape", "informed"): {"rank1": 0.40},
    ("rerelease", "dtw", "informed"): {"rank1": 0.30},
    ("rerelease", "dtw", "oracle"): {"rank1": 0.95},
    ("new_traversal", "shape", "blind"): {"rank1": 0.80},
}


@pytest.fixture
def made(tmp_path):
    def make(rates=USUAL, *, half=HALF, cells=ATTACKS, code=None, **manifest):
        out = tmp_path / "run"
        (out / "cells").mkdir(parents=True)
        stages = StageSettings().flat()
        content = {
            "identity": {"scenes": 500, "seed": 0, "fps": None, **stages},
            "cells": [],
            "code": code_hash() if code is None else code,
            "settings": {
                "preset": "paper",
                "predictors": ["least_squares", "kalman_cv"],
                "attacks": list(PRESETS["paper"].attacks),
                "tasks": list(PRESETS["paper"].tasks),
                "stages": stages,
            },
            "dataset": {"name": "walks", "path": "my walks.csv", "format": "csv"},
        }
        content["dataset"] |= {"simulated": False, "notice": None} | manifest
        (out / "manifest.json").write_text(json.dumps(content))
        summary_frame(rates, half=half).to_csv(out / "summary.csv", index=False)
        if cells is not None:
            linked_frame(rates, cells).to_csv(out / "linkability.csv", index=False)
        return out

    return make


def scheme(answer, family="fid", adding="linear"):
    (one,) = [one for one in answer.schemes if (one.family, one.adding) == (family, adding)]
    return one


def statuses(one):
    return {check.name: check.status for check in one.checks}


def shown(answer, *, width=116):
    raw = io.StringIO()
    show(answer, console=Console(file=raw, width=width, highlight=False))
    return raw.getvalue()


def edited(out, name, change):
    frame = pd.read_csv(out / name, keep_default_na=False, dtype=str)
    change(frame).to_csv(out / name, index=False)


class TestLevel:
    def test_is_the_smallest_eta_whose_upper_end_meets_the_target(self, made):
        answer = design(made(), limits=Limits(missed=0.23))
        assert scheme(answer).chosen.level == 100.0  # 0.20 + 0.02; 10 has 0.25
        assert scheme(answer).stricter.level == 10.0
        assert scheme(answer, adding="independent").chosen.level == 100.0  # 0.17; 10: 0.24

    def test_is_the_largest_d_sigma(self, made):
        answer = design(made(), limits=Limits(missed=0.23))
        assert scheme(answer, "fixed").chosen.level == 0.5
        assert scheme(answer, "fixed").stricter.level == 1.0

    def test_with_an_upper_end_at_the_target_meets_it(self, made):
        out = made()
        high = pd.read_csv(out / "summary.csv").query(
            "mechanism == 'fid' and level == 100 and consumer == 'least_squares'"
        )
        at = float(high.set_index("metric")["ci_high"]["missed_conflict_rate"])
        assert scheme(design(out, limits=Limits(missed=at))).chosen.level == 100.0
        below = Limits(missed=np.nextafter(at, 0))
        assert scheme(design(out, limits=below)).chosen.level == 1000.0

    def test_does_not_meet_the_target_with_its_estimate_alone(self, made):
        answer = design(made(half=0.04), limits=Limits(missed=0.21))
        assert scheme(answer).chosen.level == 1000.0  # 100 has 0.20 [0.16, 0.24]

    def test_meets_the_false_alarms_as_well(self, made):
        # False alarms of eta = 10, 100 and 1000: 0.125, 0.10, 0.075, each + 0.02.
        answer = design(made(), limits=Limits(missed=0.30, false_alarm=0.13))
        assert scheme(answer).chosen.level == 100.0
        (line, *_) = scheme(answer).reasons
        assert "eta = 10 does not (false alarm 12.5 % [10.5, 14.5]" in line
        assert "missed" not in line

    def test_beyond_one_that_fails_is_not_chosen(self, made):
        rates = USUAL | {"fid": {1.0: 0.18, 10.0: 0.30, 100.0: 0.20, 1000.0: 0.15}}
        answer = design(made(rates), limits=Limits(missed=0.23))
        assert scheme(answer).chosen.level == 100.0
        assert scheme(answer).also_meets == (1.0,)
        assert any("eta = 1 would meet the targets" in line for line in scheme(answer).reasons)

    def test_is_judged_by_the_predictor_asked_for(self, made):
        out = made()
        usual = design(out, limits=Limits(missed=0.16))
        assert usual.predictor == "least_squares"
        assert scheme(usual).chosen is None
        other = design(out, limits=Limits(missed=0.16), predictor="kalman_cv")
        assert scheme(other).chosen.level == 10.0  # 0.125 + 0.02; 1 has 0.15

    def test_that_this_predictor_was_not_run_on_does_not_count(self, made):
        out = made()

        def without(frame):
            here = (frame["mechanism"] == "fid") & (frame["level"] == "100.0")
            return frame[~(here & (frame["consumer"] == "kalman_cv"))]

        edited(out, "summary.csv", without)
        answer = design(out, limits=Limits(missed=0.16), predictor="kalman_cv")
        assert scheme(answer).chosen.level == 10.0

    def test_with_an_unknown_rate_meets_nothing(self, made):
        out = made()

        def blanked(frame):
            here = (frame["mechanism"] == "fid") & (frame["level"] == "100.0")
            here &= frame["consumer"] == "least_squares"
            frame.loc[here, ["value", "ci_low", "ci_high"]] = ""
            return frame

        edited(out, "summary.csv", blanked)
        answer = design(out, limits=Limits(missed=0.30))
        assert scheme(answer).chosen.level == 1000.0
        assert "cannot say" in scheme(answer).reasons[0]
        assert json.loads(to_json(answer))["schemes"][0]["stricter"]["missed"]["value"] is None

    def test_none_says_by_how_much_the_least_strict_one_fails(self, made):
        answer = design(made(), limits=Limits(missed=0.10), adding=("linear",))
        assert scheme(answer).chosen is None
        (line,) = scheme(answer).reasons
        assert line == (
            "no eta of the run meets the targets, not even the largest: eta = 1000 does not "
            "(missed 15.0 % [13.0, 17.0]: the upper end is 7 points too high)"
        )
        assert any("raw positions, without any added error" in note for note in answer.notes)
        assert answer.refine is None
        assert not answer.met


class TestLimits:
    def test_hold_for_what_was_shared(self, made):
        # PLR at eta = 100: 0.4 + 0.01, AEL 0.2 + 0.01, MEL 0.8 + 0.1.
        limits = Limits(missed=0.23, plr=0.42, ael=0.22, mel=0.91)
        answer = design(made(), limits=limits, adding=("linear",))
        assert statuses(scheme(answer)) == dict.fromkeys(("missed", "plr", "ael", "mel"), "met")
        assert answer.met

    @pytest.mark.parametrize("name", ["plr", "ael", "mel"])
    def test_above_an_estimate_but_below_its_upper_end_do_not_hold(self, made, name):
        values = {"plr": 0.405, "ael": 0.205, "mel": 0.85}
        limits = Limits(missed=0.23, **{name: values[name]})
        answer = design(made(), limits=limits, adding=("linear",))
        assert statuses(scheme(answer)) == {"missed": "met", name: "not met"}
        assert not answer.met

    def test_after_an_attack_are_those_of_the_best_informed_one(self, made):
        # Blind kalman_rts and the oracle leave more, but neither is who is asked about.
        out = made()
        limits = Limits(missed=0.23, plr=0.72, mel=4.2, after_attack=True)
        answer = design(out, limits=limits, adding=("linear",))
        found = scheme(answer).chosen.after_attack
        assert (found.attack, found.knowledge) == ("radial_rts", "informed")
        assert (found.plr.value, found.mel.value) == (pytest.approx(0.70), 4.0)
        assert answer.met
        below = design(out, limits=replace(limits, plr=0.70), adding=("linear",))
        assert statuses(scheme(below))["plr"] == "not met"
        assert any("PLR after radial_rts (informed) 70.0 %" in x for x in scheme(below).reasons)

    def test_after_an_attack_that_was_not_run_there_cannot_be_said(self, made):
        out = made()

        def without(frame):
            return frame[(frame["level"] != "100.0") | (frame["knowledge"] == "")]

        edited(out, "summary.csv", without)
        limits = Limits(missed=0.23, plr=0.99, after_attack=True)
        answer = design(out, limits=limits, adding=("linear",))
        assert statuses(scheme(answer))["plr"] == "cannot say"
        assert not answer.met
        assert "cannot be judged by PLR" in answer.answer

    def test_choose_no_level(self, made):
        # eta = 1000 leaks more than 100: the limit of PLR could pick neither.
        answer = design(made(), limits=Limits(missed=0.23, plr=0.25))
        assert scheme(answer).chosen.level == 100.0

    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"missed": 20.0}, "--max-missed is a fraction from 0 to 1"),
            ({"missed": np.nan}, "--max-missed is a fraction"),
            ({"missed": 0.2, "false_alarm": -0.1}, "--max-false-alarm is a fraction"),
            ({"missed": 0.2, "rank1": 1.1}, "--max-rank1 is a fraction"),
            ({"missed": 0.2, "mel": -1.0}, "--max-mel is a time in s"),
            ({"missed": 0.2, "ael": np.inf}, "--max-ael is a time in s"),
            ({"missed": 0.2, "after_attack": True}, "--after-attack says where"),
        ],
    )
    def test_that_make_no_sense_are_refused(self, given, message):
        with pytest.raises(SettingsError, match=message):
            Limits(**given)


class TestRank1:
    def test_is_of_the_strongest_informed_attack(self, made):
        out = made()
        answer = design(out, limits=Limits(missed=0.23, rank1=0.46), adding=("linear",))
        (rerelease, simulated) = scheme(answer).chosen.tasks
        assert (rerelease.attack, rerelease.knowledge) == ("shape", "informed")
        assert (rerelease.rank1.value, rerelease.chance) == (0.40, 0.01)
        assert (simulated.dataset, simulated.limited) == ("plaza-two-sessions", False)
        assert (simulated.attack, simulated.knowledge) == ("shape", "blind")
        assert statuses(scheme(answer)) == {"missed": "met", "rank1/rerelease": "met"}
        assert answer.met

    def test_below_its_upper_end_is_exceeded(self, made):
        answer = design(made(), limits=Limits(missed=0.23, rank1=0.44), adding=("linear",))
        assert statuses(scheme(answer))["rank1/rerelease"] == "not met"
        assert "exceeds the limits of rank 1 in rerelease" in answer.answer

    def test_is_of_the_blind_adversary_where_nobody_knows_more(self, made):
        cells = {("split", "shape", "blind"): {"rank1": 0.20}}
        answer = design(made(cells=cells), limits=Limits(missed=0.23), adding=("linear",))
        (split,) = scheme(answer).chosen.tasks
        assert (split.attack, split.knowledge, split.rank1.value) == ("shape", "blind", 0.20)

    @pytest.mark.parametrize(
        ("row", "reason"),
        [
            ({"outcome": "attack too weak"}, "every attack is too weak"),
            ({"invalid": "noise_level"}, "a shortcut (noise_level) gives people away"),
            ({"rank1": np.nan}, "no informed or blind attack was run at this level"),
            ({"ci_high": np.nan}, "the value or its interval is unknown"),
        ],
    )
    def test_cannot_be_said_from_what_is_no_measure(self, made, row, reason):
        cells = {("split", "shape", "informed"): {"rank1": 0.01} | row}
        limits = Limits(missed=0.23, rank1=0.9)
        answer = design(made(cells=cells), limits=limits, adding=("linear",))
        assert statuses(scheme(answer))["rank1/split"] == "cannot say"
        assert not answer.met
        assert any(reason in line for line in scheme(answer).reasons)

    def test_without_a_detected_link_is_still_limited_by_its_upper_end(self, made):
        cells = {("split", "shape", "informed"): {"rank1": 0.01, "outcome": "no link detected"}}
        out = made(cells=cells)
        fine = design(out, limits=Limits(missed=0.23, rank1=0.07), adding=("linear",))
        assert fine.met
        tight = design(out, limits=Limits(missed=0.23, rank1=0.05), adding=("linear",))
        assert not tight.met
        assert "~ no link detected" in shown(fine)

    def test_prefers_a_valid_attack_to_a_stronger_one_that_is_not(self, made):
        cells = {
            ("split", "shape", "informed"): {"rank1": 0.30, "outcome": "attack too weak"},
            ("split", "dtw", "informed"): {"rank1": 0.20},
        }
        answer = design(
            made(cells=cells), limits=Limits(missed=0.23, rank1=0.26), adding=("linear",)
        )
        (split,) = scheme(answer).chosen.tasks
        assert split.attack == "dtw"
        assert answer.met

    def test_cannot_be_said_at_a_level_where_nothing_was_linked(self, made):
        out = made()
        edited(out, "linkability.csv", lambda frame: frame[frame["level"] != "100.0"])
        answer = design(out, limits=Limits(missed=0.23, rank1=0.9), adding=("linear",))
        assert statuses(scheme(answer))["rank1/rerelease"] == "cannot say"


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
        manifest = json.loads((out / "manifest.json").read_text())
        manifest["settings"]["predictors"] = []
        (out / "manifest.json").write_text(json.dumps(manifest))
        assert main([*self.ARGUMENTS, str(out)]) == 2
        assert "--predictor least_squares" in capsys.readouterr().err

    @pytest.mark.parametrize("content", ["", "a,b\n1,2\n", "\0\0"])
    def test_is_2_for_a_broken_table(self, made, capsys, content):
        out = made()
        (out / "summary.csv").write_text(content)
        assert main([*self.ARGUMENTS, str(out)]) == 2
        assert "summary.csv cannot be read" in capsys.readouterr().err

    def test_is_the_same_by_the_console_script(self, made, capsys):
        assert isac_track(["design", "--max-missed", "0.1", str(made())]) == 1
        assert capsys.readouterr().out.startswith("No:")


class TestShown:
    LIMITS = Limits(missed=0.23, plr=0.42, rank1=0.44)

    def test_numbers_are_those_of_the_json(self, made):
        answer = design(made(), limits=self.LIMITS)
        text, found = shown(answer, width=200), json.loads(to_json(answer))
        rows = [line.split() for line in text.splitlines() if line.startswith(("fid ", "fixed "))]
        bands = [rows[start : start + 4] for start in range(0, 12, 4)]
        for place, one in enumerate(found["schemes"]):
            level, attacked = one["chosen"], one["chosen"]["after_attack"]
            for band, source, metrics in (
                (bands[0], level, ("missed", "false_alarm", "plr", "ael", "mel")),
                (bands[1], attacked, ("plr", "ael", "mel")),
                (bands[2], {task["task"]: task["rank1"] for task in level["tasks"]}, None),
            ):
                cells = [cell for cell in band[place] if cell[0].isdigit()]
                assert float(cells[0]) == level["level"]
                names = metrics or list(source)
                expected = []
                for name in names:
                    scale, digits = (1, 3) if name in ("ael", "mel") else (100, 1)
                    value, low, high = (
                        f"{scale * source[name][end]:.{digits}f}"
                        for end in ("value", "ci_low", "ci_high")
                    )
                    expected += [value, f"{low}-{high}"]
                assert cells[1:] == expected

    def test_keys_are_stable(self, made):
        found = json.loads(to_json(design(made(), limits=self.LIMITS)))
        assert list(found) == [
            "met", "answer", "out", "dataset", "simulated", "scenes", "seed", "predictor",
            "adding", "limits", "raw", "schemes", "refine", "notes",
        ]  # fmt: skip
        assert list(found["schemes"][0]) == [
            "adding", "family", "met", "chosen", "stricter", "also_meets", "is_saturated",
            "checks", "reasons",
        ]  # fmt: skip
        assert list(found["schemes"][0]["chosen"]) == [
            "mechanism", "level", "missed", "false_alarm", "plr", "ael", "mel", "after_attack",
            "tasks",
        ]  # fmt: skip
        assert list(found["schemes"][0]["checks"][0]) == [
            "name", "limit", "measured", "status", "reason",
        ]  # fmt: skip
        assert [(one["adding"], one["family"]) for one in found["schemes"]] == [
            ("linear", "fid"),
            ("linear", "fixed"),
            ("independent", "fid"),
            ("independent", "fixed"),
        ]
        assert found["raw"]["level"] is None

    def test_json_is_one_object_and_nothing_else(self, made, capsys):
        out = made(simulated=True, notice="nobody walked here")
        assert main(["--max-missed", "0.23", "--max-plr", "0.1", "--json", str(out)]) == 1
        said = capsys.readouterr()
        found = json.loads(said.out)
        assert said.err == ""
        assert not found["met"]
        assert "nobody walked here" in found["notes"]

    @pytest.mark.parametrize("width", [80, 116])
    def test_lines_fit_and_columns_line_up(self, made, width):
        answer = design(made(), limits=self.LIMITS)
        lines = shown(answer, width=width).splitlines()
        assert max(len(line) for line in lines if not line.startswith("python -m")) <= width
        band = [n for n, line in enumerate(lines) if "missed" in line and "false alarm" in line]
        table = lines[band[0] : band[0] + 10]
        dots = {line.index(".") for line in table if line.startswith(("raw", "fid"))}
        assert len(dots) == 1

    def test_limits_stand_above_what_they_are_about(self, made):
        out = made()
        text = shown(design(out, limits=self.LIMITS), width=200)
        first, last = [line.split() for line in text.splitlines() if line.startswith("limit")]
        assert first == ["limit", "<=", "23", "<=", "42"]
        assert last == ["limit", "<=", "44"]  # not for the simulated task
        after = shown(design(out, limits=Limits(0.23, plr=0.9, after_attack=True)))
        second = [line.split() for line in after.splitlines() if line.startswith("limit")]
        assert second == [["limit", "<=", "23"], ["limit", "<=", "90"]]


class TestCloser:
    """The command that adds levels where the answer turns."""

    def words(self, answer):
        words = shlex.split(answer.refine)
        assert words[:3] == ["python", "-m", "evaluation.matrix"]
        return words[3:]

    def options(self, answer):
        return matrix.settings_from(matrix.parser().parse_args(self.words(answer)))

    def test_is_between_the_chosen_level_and_the_next_stricter_one(self, made):
        out = made()
        settings = self.options(design(out, limits=Limits(missed=0.23)))
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
        manifest = json.loads((out / "manifest.json").read_text())
        manifest["identity"] |= {"scenes": 40, "seed": 7, "fps": 12.5}
        manifest["settings"]["stages"]["privacy.epsilon_m"] = 0.5
        manifest["settings"]["tasks"] = []
        manifest["dataset"]["format"] = "obsmat"
        (out / "manifest.json").write_text(json.dumps(manifest))
        settings = self.options(design(out, limits=Limits(missed=0.23)))
        assert (settings.scenes, settings.seed, settings.preset) == (40, 7, "paper")
        assert (settings.dataset, settings.format) == ("my walks.csv", "obsmat")
        assert settings.fps == 12.5
        assert settings.stages == StageSettings().changed({"privacy.epsilon_m": "0.5"})
        assert settings.predictors == ("least_squares", "kalman_cv")
        assert settings.attacks is None  # the preset's
        assert settings.tasks == ()

    def test_goes_on_where_every_level_meets_or_none_does(self, made):
        rates = {"fid": {1.0: 0.30, 10.0: 0.10}, "fixed": {0.1: 0.10, 0.5: 0.11}}
        answer = design(made(rates), limits=Limits(missed=0.40), adding=("linear",))
        assert self.options(answer).mechanisms == ("fid:0.01..1/10", "fixed:0.5..1/10")

    def test_goes_towards_raw_where_none_meets(self, made):
        rates = {"fid": {1.0: 0.30, 10.0: 0.25}, "fixed": {0.2: 0.25, 0.5: 0.30}}
        answer = design(made(rates), limits=Limits(missed=0.20), adding=("linear",))
        assert self.options(answer).mechanisms == ("fid:10..1000/10", "fixed:0.02..0.2/10")

    def test_is_not_needed_where_the_error_is_full_already(self, made):
        out = made({"fid": FID})

        def saturated(frame):
            shared = frame["consumer"] == "shared"
            first, second = (shared & (frame["level"] == level) for level in ("1.0", "10.0"))
            names = ["value", "ci_low", "ci_high"]
            frame.loc[first, names] = frame.loc[second, names].to_numpy()
            return frame

        edited(out, "summary.csv", saturated)
        answer = design(out, limits=Limits(missed=0.40), adding=("linear",))
        assert answer.refine is None
        assert "every sample has the full error" in scheme(answer).reasons[0]

    def test_leaves_a_run_of_other_code_alone(self, made):
        out = made(USUAL | {"fid": {1.0: 0.1, 10.0: 0.1}}, code="older")
        answer = design(out, limits=Limits(missed=0.23))
        settings = self.options(answer)
        assert settings.out == out.with_name("run-closer")
        assert settings.mechanisms[0] == "raw"
        assert any("another version of the code" in note for note in answer.notes)


@pytest.fixture(scope="module")
def real_run(tmp_path_factory, tracks):
    folder = tmp_path_factory.mktemp("design")
    recording = folder / "walks.csv"
    rows = [
        f"{t:.2f},{source},{x:.4f},{y:.4f}"
        for source, track in zip(tracks.source, tracks, strict=True)
        for t, (x, y) in zip(track.t, track.xy, strict=True)
    ]
    recording.write_text("t,id,x,y\n" + "\n".join(rows) + "\n")
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
        answer = design(real_run, limits=Limits(missed=1.0), adding=("linear",))
        assert answer.met
        chosen = scheme(answer).chosen
        assert chosen.level == 100.0
        frame = pd.read_csv(real_run / "summary.csv").query("mechanism == 'fid' and level == 100")
        frame = frame.set_index(["consumer", "knowledge", "metric"])["value"]
        plain = {key[0::2]: value for key, value in frame.items() if not isinstance(key[1], str)}
        assert chosen.missed.value == plain["least_squares", "missed_conflict_rate"]
        assert chosen.plr.value == plain["shared", "plr"]
        assert chosen.after_attack.attack == "kalman_rts"
        assert chosen.after_attack.plr.value == frame["kalman_rts", "informed", "plr"]
        assert shown(answer).startswith("Yes: with fid eta = 100 (linear)")

    def test_continues_by_the_command_for_a_closer_look(self, real_run, capsys):
        answer = design(real_run, limits=Limits(missed=1.0), adding=("linear",))
        words = shlex.split(answer.refine)[3:]
        assert matrix.main([*words, "--dry-run"]) == 0
        # Finished are the ends of the new sweeps.
        ends = {"fid:100", "fixed:0.5"}
        said = capsys.readouterr().err
        levels = axes(matrix.settings_from(matrix.parser().parse_args(words))).mechanisms
        assert ends < {one.spec for one in levels}
        per_level = 1 + 1 + 3  # shared, the predictor, and the attack of three adversaries
        assert f"{per_level * len(levels)} cells, {per_level * len(ends)} of them finished" in said
