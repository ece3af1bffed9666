"""Choosing a level: which one, whether the limits hold there, what cannot be said."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from helpers.summaries import (
    FID,
    FIXED,
    HALF,
    USUAL,
    asked,
    edit_manifest,
    edited,
    scheme,
    statuses,
    write_run,
)

from evaluation.reporting.design_words import notes, reasons, sentence, to_json
from evaluation.verdict.choose_level import WEAK, Limits
from isac_track.errors import SettingsError


def linear(out, **question):
    """The answer under linear adding, with the usual target."""
    return asked(out, adding=("linear",), **({"missed": 0.23} | question))


@pytest.fixture
def made(tmp_path):
    return partial(write_run, tmp_path / "run")


BUMPED = USUAL | {"fid": {1.0: 0.18, 10.0: 0.30, 100.0: 0.20, 1000.0: 0.15}}
OTHER = {"predictor": "kalman_cv"}
AT = "mechanism == 'fid' and level == '{}' and consumer == '{}'".format


class TestLevel:
    @pytest.mark.parametrize(
        ("run", "question", "whose", "levels"),
        [
            ({}, {"missed": 0.23}, {}, (100, 10)),  # 0.20 + 0.02; 10 has 0.25
            ({}, {"missed": 0.23}, {"adding": "independent"}, (100, 10)),  # 0.17; 10: 0.24
            # eta = 1000 leaks more than 100: the limit of PLR could pick neither.
            ({}, {"missed": 0.23, "plr": 0.25}, {}, (100, 10)),
            ({}, {"missed": 0.23}, {"family": "fixed"}, (0.5, 1)),
            # The estimate alone does not do: 100 has 0.20 [0.16, 0.24].
            ({"half": 0.04}, {"missed": 0.21}, {}, (1000, 100)),
            # False alarms of eta = 10, 100 and 1000: 0.125, 0.10, 0.075, each + 0.02.
            ({}, {"missed": 0.30, "false_alarm": 0.13}, {}, (100, 10)),
            # Nor does a level beyond one that fails.
            ({"rates": BUMPED}, {"missed": 0.23}, {}, (100, 10)),
            ({}, {"missed": 0.16}, {}, (None, 1000)),
            ({}, {"missed": 0.16} | OTHER, {}, (10, 1)),  # 0.125 + 0.02; 1 has 0.15
        ],
    )
    def test_is_the_strictest_whose_upper_end_meets_them(self, made, run, question, whose, levels):
        one = scheme(asked(made(**run), **question), **whose)
        assert tuple(each and each.level for each in (one.chosen, one.stricter)) == levels

    def test_with_an_upper_end_at_the_target_meets_it(self, made):
        out, at = made(), FID[100.0] + HALF
        chosen = [scheme(asked(out, missed=one)).chosen.level for one in (at, np.nextafter(at, 0))]
        assert chosen == [100.0, 1000.0]

    def test_says_why_a_stricter_one_is_not_chosen(self, made):
        one = scheme(asked(made(BUMPED), missed=0.23))
        assert one.also_meets == (1.0,)
        assert any("eta = 1 would meet the targets" in line for line in reasons(one))
        (line, *_) = reasons(scheme(asked(made.args[0], missed=0.33, false_alarm=0.13)))
        assert "eta = 10 does not (false alarm 15.0 % [13.0, 17.0]" in line
        assert "missed" not in line

    def test_is_judged_by_the_predictor_asked_for_where_it_was_run(self, made):
        out = made()
        assert asked(out, missed=0.16).predictor == "least_squares"
        left = f"not ({AT('10.0', 'kalman_cv')})"
        edited(out, "summary.csv", lambda frame: frame.query(left))
        assert scheme(asked(out, missed=0.16, **OTHER)).chosen.level == 100.0

    def test_with_an_unknown_rate_meets_nothing(self, made):
        out = made()

        def blanked(frame):
            here = frame.query(AT("100.0", "least_squares")).index
            frame.loc[here, ["value", "ci_low", "ci_high"]] = ""
            return frame

        edited(out, "summary.csv", blanked)
        answer = asked(out, missed=0.30)
        assert scheme(answer).chosen.level == 1000.0
        assert "cannot say" in reasons(scheme(answer))[0]
        assert to_json(answer)["schemes"][0]["stricter"]["missed"]["value"] is None

    def test_none_says_by_how_much_the_least_strict_one_fails(self, made):
        answer = linear(made(), missed=0.10)
        assert scheme(answer).chosen is None
        (line,) = reasons(scheme(answer))
        assert line == (
            "no eta of the run meets the targets, not even the largest: eta = 1000 does not "
            "(missed 15.0 % [13.0, 17.0]: the upper end is 7 points too high)"
        )
        assert any("raw positions, without any added error" in note for note in notes(answer))
        assert not answer.met


class TestLimits:
    @pytest.mark.parametrize(
        ("limits", "failing"),
        [
            ("plr .42, ael .22, mel .91", ""),
            ("plr .405", "plr"),
            ("ael .205", "ael"),
            ("mel .85", "mel"),
        ],
    )
    def test_hold_for_the_upper_end_of_what_was_shared(self, made, limits, failing):
        # PLR at eta = 100: 0.4 + 0.01, AEL 0.2 + 0.01, MEL 0.8 + 0.1.
        given = {name: float(limit) for name, limit in map(str.split, limits.split(", "))}
        answer = linear(made(), as_shared=True, only=["fid"], **given)
        not_met = {name for name, status in statuses(scheme(answer)).items() if status == "not met"}
        assert not_met == set(failing.split())
        assert statuses(scheme(answer)).keys() == {"missed", *given}
        assert answer.met == (not failing)

    def test_after_an_attack_are_those_of_the_strongest_but_the_oracles(self, made):
        out = made()
        answer = linear(out, plr=0.72, mel=4.2)
        found = scheme(answer).chosen.after_attack
        assert (found.attack, found.knowledge) == ("radial_rts", "informed")
        shown = [found.numbers[name].value for name in ("plr", "mel")]
        assert shown == pytest.approx([0.70, 4.0])
        assert answer.met
        below = scheme(linear(out, plr=0.70))
        assert statuses(below)["plr"] == "not met"
        assert any("PLR after radial_rts (informed) 70.0 %" in line for line in reasons(below))

    def test_after_an_attack_that_was_not_run_there_cannot_be_said(self, made):
        out = made()
        is_there = "level != '100.0' or knowledge == ''"
        edited(out, "summary.csv", lambda frame: frame.query(is_there))
        answer = linear(out, plr=0.99, only=["fid"])
        assert statuses(scheme(answer))["plr"] == "cannot say"
        assert not answer.met
        assert "cannot be judged by PLR" in sentence(answer)

    def test_of_a_dozen_people_without_an_interval_cannot_be_said(self, made):
        out = made()
        edited(out, "summary.csv", lambda frame: frame.assign(ci_low="", ci_high=""))
        answer = linear(out, plr=0.99)
        assert not answer.met
        why = "cannot be judged (so few people have no interval; 15 groups have)"
        assert sentence(answer).startswith(f"No: {why}: fid")
        assert not any("miss the targets themselves" in one for one in notes(answer))

    @pytest.mark.parametrize(
        ("name", "limit", "message"),
        [
            ("missed", 20.0, "--max-missed is a fraction from 0 to 1"),
            ("missed", np.nan, "--max-missed is a fraction"),
            ("false_alarm", -0.1, "--max-false-alarm is a fraction"),
            ("rank1", 1.1, "--max-rank1 is a fraction"),
            ("mel", -1.0, "--max-mel is a time in s"),
            ("ael", np.inf, "--max-ael is a time in s"),
        ],
    )
    def test_that_make_no_sense_are_refused(self, name, limit, message):
        given = {"missed": 0.2, name: limit}
        with pytest.raises(SettingsError, match=message):
            Limits(given)

    @pytest.mark.parametrize(
        ("limit", "half", "told"),
        [
            (0.21, 0.02, "about 8,000 scenes would tell"),  # 2,000 (0.02 / 0.01)^2, to show it
            (0.18, 0.03, "about 4,500 scenes would tell"),  # 2,000 (0.03 / 0.02)^2: it is not
            (0.205, 0.02, "about 16 times as many people would tell"),  # not 32,000 scenes of them
            (0.20, 0.02, "the value at the limit: no more data would tell"),
            (0.17, 0.02, "points too high)"),  # surely above it
        ],
    )
    def test_missed_within_the_interval_asks_for_more_scenes(self, made, limit, half, told):
        out = made({"fid": {100.0: 0.20}}, half=half)
        # The robot is read in all scenes; in those of another world as in the attacked ones.
        kinds = ("predictor", "least_squares"), ("shared", "shared"), ("predictor", "least_squares")
        files = [f"fid-100-sharing_{n:05}_{n:016}.parquet" for n in range(8)]
        at = {"mechanism": "fid", "family": "fid", "adding": "linear", "level": 100.0}
        at |= {"spec": "fid:100", "files": files[:2], "knowledge": "", "slow": False, "world": ""}
        cells = [at | {"kind": kind, "consumer": name} for kind, name in kinds]
        cells[0]["files"], cells[2]["world"] = files, "law=isotropic"
        edit_manifest(out, lambda manifest: manifest.update(cells=cells))
        (line, *_) = reasons(scheme(linear(out, missed=limit)))
        assert told in line
        assert ("would tell" in line) == ("would tell" in told)


class TestRank1:
    def test_is_of_the_strongest_attack_but_the_oracles(self, made):
        out = made()
        answer = linear(out, rank1=0.46)
        found = [
            (one.attack, one.knowledge, one.rank1.value, one.chance, one.dataset, one.limited)
            for one in scheme(answer).chosen.tasks
        ]
        assert found == [
            ("shape", "informed", 0.40, 0.01, "walks", True),
            ("shape", "blind", 0.80, 0.01, "plaza-two-sessions", False),
        ]
        assert statuses(scheme(answer)) == {"missed": "met", "rank1/rerelease": "met"}
        assert answer.met
        answer = linear(out, rank1=0.44)  # below its upper end
        assert statuses(scheme(answer))["rank1/rerelease"] == "not met"
        assert sentence(answer) == "No: more people needed for rank 1: fid, fixed."
        # 0.40 [0.35, 0.45]: 0.05 shrinks to 0.04, and links pass through no scenes.
        assert "about 1.6 times as many people would tell" in "".join(reasons(scheme(answer)))

    @pytest.mark.parametrize(
        ("rows", "best"),
        [
            # Nobody links better than the blind adversary.
            ({("shape", "blind"): (0.20, "links"), ("shape", "informed"): (0.10, "links")}, 0.20),
            # A valid attack, not a stronger one that is none.
            ({("shape", "informed"): (0.30, WEAK), ("dtw", "informed"): (0.20, "links")}, 0.20),
            # One that detects nobody is limited all the same, by its upper end.
            ({("shape", "informed"): (0.01, "no link detected")}, 0.01),
        ],
    )
    def test_is_of_the_best_that_counts(self, made, rows, best):
        cells = {
            ("split", *who): {"rank1": rank1, "outcome": outcome}
            for who, (rank1, outcome) in rows.items()
        }
        out = made(cells=cells)
        answer = linear(out, rank1=best + 0.06)
        (split,) = scheme(answer).chosen.tasks
        assert split.rank1.value == best == rows[split.attack, split.knowledge][0]
        assert answer.met
        assert not linear(out, rank1=best + 0.04).met

    @pytest.mark.parametrize(
        ("row", "reason"),
        [
            ({"outcome": "attack too weak"}, "every attack is too weak"),
            ({"invalid": "noise_level"}, "a shortcut (noise_level) gives people away"),
            ({"rank1": np.nan}, "no attack was run at this level"),
            (None, "no attack was run at this level"),
            ({"ci_high": np.nan}, "so few people have no interval; 15 groups have"),
        ],
    )
    def test_cannot_be_said_from_what_is_no_measure(self, made, row, reason):
        cells = {("split", "shape", "informed"): {"rank1": 0.01} | (row or {})}
        out = made(cells=cells)
        if row is None:
            edited(out, "linkability.csv", lambda frame: frame[frame["level"] != "100.0"])
        answer = linear(out, rank1=0.9, only=["fid"])
        assert statuses(scheme(answer))["rank1/split"] == "cannot say"
        assert not answer.met
        assert any(reason in line for line in reasons(scheme(answer)))


MINE = {0.1: 0.14, 0.5: 0.19, 2.0: 0.30}
"""Missed rate by level of a stranger's mechanism."""


class TestFamilies:
    """Any mechanism of the run is judged like FID and fixed noise."""

    def test_all_are_listed_and_answer(self, made):
        answer = asked(made(USUAL | {"mine": MINE, "mine:k=2": MINE}), missed=0.23)
        names = [(one.adding, one.name) for one in answer.schemes]
        assert names == [
            (rule, name)
            for rule in ("linear", "independent")
            for name in ("fid", "fixed", "mine", "mine:k=2")
        ]
        assert [*answer.answers] == ["fid", "fixed", "mine", "mine:k=2"]
        assert answer.met
        # By the family's name, or by that of one set of its parameters.
        for only, found in (("mine", {"mine", "mine:k=2"}), ("mine:k=2", {"mine:k=2"})):
            assert asked(answer.out, missed=0.23, only=[only]).answers.keys() == found
        # One without a declared rule is judged under both, and that is told.
        both = [scheme(answer, "mine", rule) for rule in ("linear", "independent")]
        assert [one.chosen.level for one in both] == [0.5, 0.5]
        assert any("mine, mine:k=2: declares no adding rule" in note for note in notes(answer))

    def test_whose_rule_cannot_be_chosen_answers_under_it(self, made):
        out = made(USUAL | {"mine": MINE})
        rule = "independent"
        edited(out, "summary.csv", lambda frame: frame.assign(
            adding=frame["adding"].where(frame["mechanism"] != "mine", rule)
        ))  # fmt: skip
        answer = asked(out, missed=0.23)
        assert [one.adding for one in answer.answers["mine"]] == [rule]
        assert "mine" not in asked(out, missed=0.23, adding=("linear",)).answers
        costs = {name: one.value for name, one in scheme(answer, "mine", rule).chosen.costs.items()}
        assert costs == pytest.approx({"least_squares": 0.19, "kalman_cv": 0.095})

    def test_what_who_knows_more_gets_is_told_beside_it(self, made):
        out = made()

        def known(frame):
            after = frame.query("consumer == 'radial_rts' and knowledge == 'informed'")
            more = after.assign(knowledge="repeats")
            more["value"] = more["value"].astype(float) * 1.1
            return pd.concat([frame, more])

        edited(out, "summary.csv", known)
        (beyond,) = scheme(linear(out, plr=0.72)).chosen.beyond
        assert (beyond.knowledge, beyond.numbers["plr"].value) == ("repeats", pytest.approx(0.77))
        said = reasons(scheme(linear(out, plr=0.72)))[-1]
        assert said.startswith("could break it: PLR after radial_rts (repeats) 77.0 %")
        assert "not measured: " in said

    def test_without_fid_it_is_what_is_asked_about(self, made):
        out = made({"mine": MINE, "fixed": {0.1: 0.9}})
        answer = asked(out, missed=0.23)
        assert answer.met
        assert sentence(answer).startswith("Yes: with mine level = 0.5 at most 23 %")
        assert not asked(out, missed=0.1).met
        assert sentence(asked(out, missed=0.1)) == "No: no level meets the targets: mine."

    def test_what_leaks_less_is_stricter(self, made):
        out = made({"mine": MINE})
        assert not scheme(asked(out, missed=0.23), "mine").falls

        def turned(frame):
            plr = frame.query("metric == 'plr' and mechanism == 'mine'")
            shown = (plr["level"].astype(float) / 10).astype(str)
            for end in ("value", "ci_low", "ci_high"):
                frame.loc[plr.index, end] = shown
            return frame

        edited(out, "summary.csv", turned)
        answer = asked(out, missed=0.40)
        assert scheme(answer, "mine").falls
        assert scheme(answer, "mine").chosen.level == 0.1

    def test_without_levels_it_is_judged_as_it_is(self, made):
        answer = linear(made({"fid": FID, "fixed": FIXED, "mine": {np.nan: 0.1}}))
        one = scheme(answer, "mine")
        assert (one.met, one.chosen.level, one.stricter) == (True, None, None)
