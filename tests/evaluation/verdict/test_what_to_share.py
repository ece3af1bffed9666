"""Recommended levels: which hold, which are named, and which cannot be judged."""

from itertools import product

import numpy as np
import pytest
from helpers.summaries import (
    ALL,
    BAD,
    GOOD,
    HALF,
    OTHER_ROBOT,
    RAW,
    ROBOT,
    SHIFTED,
    USUAL,
    asked,
    changed,
    names,
    table,
)

from evaluation.plan.address import parse_consumer
from evaluation.verdict.offers import AttackNumbers, Check
from evaluation.verdict.question import USUAL as LIMITS
from evaluation.verdict.question import Criterion, Question
from evaluation.verdict.what_to_share import (
    MOST_PROPOSALS,
    cheapest,
    non_dominated,
    recommend,
)
from isac_track.errors import SettingsError
from isac_track.intervals import Estimate

AT = ("ou", 0.4)


def statuses(offer):
    """What became of every limit."""
    return {(check.name, check.adversary): check.status for check in offer.checks}


def failing(levels, **question):
    """The limits that the only rival does not hold, each with what became of it."""
    answer = asked(levels, **question)
    assert not answer.met
    return {(check.name, check.status) for check in answer.nearest.failing}


class TestControls:
    def test_are_never_proposed_though_they_would_win(self):
        wins = asked((RAW, GOOD, changed(SHIFTED, protects=True)))
        assert names(wins.proposals) == [("offset", 0.3)]
        assert names(asked(USUAL).proposals) == [AT]
        alone = asked((RAW, SHIFTED))
        assert (alone.met, alone.proposals, alone.refused) == (False, (), ())

    def test_of_strangers_are_not_either(self):
        own = changed(mechanism="mine:Noise", family="mine:Noise", missed=0.1)
        assert names(asked((RAW, GOOD, own)).proposals)[0] == ("mine:Noise", 0.4)
        control = changed(own, protects=False)
        assert names(asked((RAW, GOOD, control)).proposals) == [AT]

    def test_cannot_be_asked_for(self):
        with pytest.raises(
            SettingsError, match="--family offset: the run has no such family"
        ):
            asked(USUAL, only=("offset",))


class TestEachLimit:
    """Every demand is missed alone by a level that holds all others."""

    def test_holds_with_the_usual_numbers(self):
        answer = asked((RAW, GOOD))
        assert (names(answer.proposals), answer.nearest, answer.missing) == (
            [AT],
            None,
            (),
        )
        assert set(statuses(answer.proposals[0]).values()) == {"met"}

    def test_of_plr_at_epsilon(self):
        expected = {("plr", "not met"), ("plr_wide", "not met")}
        assert failing((RAW, changed(plr=0.6, wide=0.7))) == expected

    def test_of_plr_beyond_epsilon(self):
        # Errors parked at 1.1 epsilon: nothing leaks at epsilon, everything at 4/3 of
        # it.
        parked = changed(plr=0.05, wide=0.98, median=0.33)
        assert failing((RAW, parked)) == {("plr_wide", "not met")}

    def test_of_linkage(self):
        assert failing((RAW, changed(share=0.6))) == {("linkage_share", "not met")}
        # Surely: the upper end of the paired interval, not the value.
        assert failing((RAW, changed(share=0.49))) == {("linkage_share", "not met")}
        assert asked((RAW, changed(share=0.48))).met

    def test_of_missed_conflicts(self):
        limits = {**LIMITS, "missed": 0.21}
        assert failing((RAW, GOOD), limits=limits) == {("missed", "not met")}
        assert asked((RAW, GOOD), limits=limits | {"missed": 0.20 + HALF}).met

    @pytest.mark.parametrize("name", ["repeats", "anchor"])
    def test_of_an_adversary_that_was_asked_for(self, name):
        broken = changed(beyond={"repeats": 0.40, "anchor": 0.35, name: 0.70})
        assert asked(
            (RAW, broken)
        ).met  # He was not asked for; it is said that he breaks it.
        (side,) = [
            item
            for item in asked((RAW, broken)).proposals[0].beyond
            if item.adversary == name
        ]
        assert side.breaks(0.5)
        expected = {("plr", "not met"), ("plr_wide", "not met")}
        assert failing((RAW, broken), against=(name,)) == expected
        assert asked((RAW, GOOD), against=("repeats", "anchor")).met

    @pytest.mark.parametrize(
        ("plr", "wide", "breaks"),
        [
            (Estimate(0.1, 0.0, 0.2, 50), Estimate(0.2, 0.1, 0.3, 50), False),
            (Estimate(0.1, 0.0, 0.2, 50), Estimate(0.5, 0.4, 0.6, 50), True),
            # Without an interval, or with too few people, nothing is known.
            (Estimate(0.1, n=14), Estimate(0.1, n=14), None),
            (Estimate(0.1, 0.0, 0.2, 19), Estimate(0.9, 0.8, 1.0, 19), None),
            (Estimate(0.1, 0.0, 0.2, 50), Estimate(0.1), None),
            (Estimate(0.1), Estimate(0.9, 0.8, 1.0, 50), True),
        ],
    )
    def test_an_adversary_breaks_a_limit_only_where_that_is_known(
        self, plr, wide, breaks
    ):
        reader = parse_consumer("ou_rts", "insider")
        side = AttackNumbers("insider", reader, {"plr": plr, "plr_wide": wide})
        assert side.breaks(0.5) is breaks
        assert AttackNumbers("insider").breaks(0.5) is None

    def test_beyond_epsilon_counts_for_an_adversary_too(self):
        near = changed(
            beyond={"anchor": 0.46}
        )  # 0.46 + 0.02 holds, 0.51 + 0.02 does not
        assert failing((RAW, near), against=("anchor",)) == {("plr_wide", "not met")}

    def test_of_what_was_not_tried_cannot_be_said(self):
        answer = asked((RAW, GOOD), against=("companions",))
        assert (answer.met, names(answer.unsettled)) == (False, [AT])
        assert answer.missing == ("adversary not tried",)

    def test_further_ones_are_judged_where_they_are_asked(self):
        limits = {**LIMITS, "ael": 0.9, "rank1": 0.25, "false_alarm": 0.05}
        expected = {
            ("ael", "not met"),
            ("rank1/handover-1s", "not met"),
            ("false_alarm", "not met"),
        }
        assert failing((RAW, GOOD), limits=limits) == expected
        limits = {**LIMITS, "ael": 1.02, "rank1": 0.33, "false_alarm": 0.13}
        assert asked(
            (RAW, GOOD), limits=limits
        ).met  # simulated people at 99 % do not count

    def test_as_shared_is_about_what_was_shared(self):
        leaking = changed(plr=0.9, wide=0.95)
        assert asked((RAW, leaking), as_shared=True).met
        assert not asked(
            (RAW, leaking), as_shared=True, limits={**LIMITS, "plr": 0.26}
        ).met


class TestUnknown:
    def test_horizon(self):
        answer = asked((RAW, GOOD), criterion=Criterion("missed", 2.0))
        assert (answer.met, answer.missing, answer.robot) == (
            False,
            ("no horizon",),
            "",
        )

    def test_handover(self):
        answer = asked((changed(RAW, task=""), changed(task="")))
        assert (answer.met, answer.missing, answer.task) == (
            False,
            ("no handover",),
            "",
        )
        # Who does not ask for it has an answer.
        assert asked((changed(RAW, task=""), changed(task="")), limits={"plr": 0.5}).met
        re_release = tuple(changed(item, task="rerelease") for item in (RAW, GOOD))
        assert asked(re_release).missing == ("no handover",)

    def test_the_first_handover_leads_where_the_leading_one_is_missing(self):
        later = tuple(changed(item, task="handover-5s") for item in (RAW, GOOD))
        assert (asked(later).task, asked(later).met) == ("handover-5s", True)

    def test_attack(self):
        answer = asked((RAW, changed(is_attacked=False)))
        assert (answer.met, answer.missing) == (False, ("no attack",))

    @pytest.mark.parametrize(
        ("values", "why"),
        [
            ({"invalid": "noise_level"}, "shortcut"),
            ({"outcome": "attack too weak"}, "attack too weak"),
            ({"share": np.nan}, "no value"),
        ],
    )
    def test_linkage(self, values, why):
        answer = asked((RAW, changed(**values)))
        (check,) = answer.nearest.failing
        assert (answer.met, check.name, check.unknown) == (False, "linkage_share", why)

    def test_a_dozen_people_have_no_interval(self):
        answer = asked((RAW, changed(half=np.nan)))
        assert (answer.met, answer.missing) == (False, ("too few people",))
        assert names([answer.nearest]) == [AT]

    def test_what_fails_surely_is_no_open_question(self):
        answer = asked((RAW, BAD), against=("companions",))
        assert (answer.met, answer.unsettled) == (False, ())


class TestSet:
    def test_is_that_of_brute_force(self):
        rng = np.random.default_rng(5)
        for _ in range(40):
            numbers = rng.integers(1, 5, (9, 3)) / 20
            levels = [
                changed(level=float(at), missed=missed, plr=plr, wide=plr, rank1=rank1)
                for at, (missed, plr, rank1) in enumerate(numbers)
            ]
            answer = asked((RAW, *levels))
            front = [
                at
                for at, own in enumerate(numbers)
                if not any(
                    (other <= own).all() and (other < own).any() for other in numbers
                )
                and not any((other == own).all() for other in numbers[:at])
            ]
            front.sort(key=lambda at: tuple(numbers[at]))
            expected = [("ou", float(at)) for at in front[:MOST_PROPOSALS]]
            assert names(answer.proposals) == expected
            assert names(cheapest(non_dominated(answer.proposals))) == expected

    @pytest.mark.parametrize("name", ["plr", "rank1"])
    def test_an_unknown_number_beats_no_known_number(self, name):
        # Without limits every level holds.
        known, unknown = changed(level=0.3), changed(level=0.2, **{name: np.nan})
        answer = asked((RAW, unknown, known), limits={})
        assert names(answer.proposals) == [("ou", 0.3)]

    def test_of_unknown_numbers_the_first_stays(self):
        levels = [changed(level=level, rank1=np.nan) for level in (0.2, 0.3)]
        assert names(asked((RAW, *levels), limits={}).proposals) == [("ou", 0.2)]

    def test_is_of_those_that_hold(self):
        cheap = changed(level=0.1, missed=0.1, plr=0.7, wide=0.8, rank1=0.1)
        assert names(asked((RAW, cheap, GOOD)).proposals) == [AT]

    def test_the_nearest_misses_fewest_limits_by_least(self):
        near = changed(level=0.2, share=0.55)
        far = changed(level=0.3, share=0.9)
        both = changed(level=0.1, share=0.53, plr=0.55, wide=0.6)
        assert names(asked((RAW, far, both, near, BAD)).refused)[:2] == [
            ("ou", 0.2),
            ("ou", 0.3),
        ]

    def test_candidates_are_what_would_be_proposed_or_the_nearest(self):
        assert names(asked(USUAL).candidates) == [AT]
        assert names(asked((RAW, BAD)).candidates) == [(BAD.mechanism, 1.0)]
        untried = asked(
            (changed(RAW, task=""), changed(task=""), changed(BAD, task=""))
        )
        assert names(untried.candidates) == [AT]


class TestRobot:
    def test_is_the_best_of_the_run_at_raws_false_alarms(self):
        answer = asked((RAW, GOOD))
        assert (answer.robot, answer.proposals[0].cost.value) == (ROBOT, 0.20)
        other = asked((RAW, GOOD), robot=OTHER_ROBOT)
        assert (other.robot, other.proposals[0].cost.value) == (
            OTHER_ROBOT,
            pytest.approx(0.40),
        )

    def test_has_its_cross_fitted_number_and_says_which_robot_either_half_chose(self):
        levels = tuple(
            changed(level, chosen=(ROBOT, OTHER_ROBOT), extra=0.03)
            for level in (RAW, GOOD)
        )
        answer = asked(levels, limits={**LIMITS, "missed": 0.24})
        assert (answer.robots, answer.robot) == (
            (ROBOT, OTHER_ROBOT),
            f"{ROBOT} or {OTHER_ROBOT}",
        )
        (check,) = (
            answer.nearest.failing
        )  # 0.23 + 0.02, though the better robot has 0.20 + 0.02
        assert (check.name, check.measured.value) == ("missed", pytest.approx(0.23))
        assert answer.nearest.robots.keys() == {ROBOT, OTHER_ROBOT}
        # The robot that is named keeps its own number.
        named = asked(levels, robot=ROBOT, limits={**LIMITS, "missed": 0.24})
        assert (named.robots, named.met) == ((ROBOT,), True)
        limits = {**LIMITS, "false_alarm": 0.11}
        assert ("false_alarm", "not met") in failing(levels, limits=limits)

    def test_is_judged_by_the_conflicts_asked_for(self):
        answer = asked((RAW, GOOD), criterion=Criterion("missed", None))
        assert answer.proposals[0].cost.value == pytest.approx(0.10)
        assert Criterion("missed", None).metric == ALL

    def test_that_is_not_there_is_refused(self):
        with pytest.raises(
            SettingsError, match="--predictor nobody: the run has kalman_cv, "
        ):
            asked((RAW, GOOD), robot="nobody")


class TestRules:
    LINEAR = changed(mechanism="mine", family="mine", adding="linear")
    INDEPENDENT = changed(
        mechanism="mine:adding=independent",
        family="mine",
        adding="independent",
        missed=0.1,
    )
    BOTH = ("linear", "independent")

    def test_all_that_are_asked_for_must_hold(self):
        both = asked((RAW, self.LINEAR, self.INDEPENDENT), adding=self.BOTH)
        # Cheaper, and no worse: it is no use to who cannot add so.
        assert names(both.proposals) == [
            ("mine:adding=independent", 0.4),
            ("mine", 0.4),
        ]
        fails = changed(self.LINEAR, share=0.9)
        alone = asked((RAW, fails, self.INDEPENDENT), adding=self.BOTH)
        assert (alone.met, alone.nearest.lacks_rule) == (False, "linear")
        assert asked((RAW, fails, self.INDEPENDENT), adding=("independent",)).met

    def test_one_that_no_parameter_sets_answers_under_its_own(self):
        assert asked((RAW, GOOD), adding=self.BOTH).met


@pytest.mark.parametrize(
    ("name", "limit", "message"),
    [
        ("missed", 20.0, "--max-missed is a fraction from 0 to 1"),
        ("missed", np.nan, "--max-missed is a fraction"),
        ("false_alarm", -0.1, "--max-false-alarm is a fraction"),
        ("rank1", 1.1, "--max-rank1 is a fraction"),
        ("linkage_share", 1.5, "--max-linkage-share is a fraction"),
        ("mel", -1.0, "--max-mel is a time in s"),
        ("ael", np.inf, "--max-ael is a time in s"),
    ],
)
def test_limits_that_make_no_sense_are_refused(name, limit, message):
    with pytest.raises(SettingsError, match=message):
        Question(limits={name: limit})


def test_an_unknown_adversary_is_refused():
    with pytest.raises(
        SettingsError, match=r"--against anchr: .*did you mean 'anchor'"
    ):
        Question(against=("anchr",))


@pytest.mark.parametrize(
    ("limit", "half", "times", "asks"),
    [
        (0.21, 0.02, 4.0, "scenes"),  # (0.02 / 0.01)^2, to show it
        (0.18, 0.03, 2.25, "scenes"),  # (0.03 / 0.02)^2: it is not
        (0.205, 0.02, 16.0, "people"),  # no scenes of the same people would
        (0.20, 0.02, np.inf, "people"),
        (0.17, 0.02, np.nan, "people"),  # surely above it
    ],
)
def test_a_limit_missed_within_the_interval_asks_for_more(limit, half, times, asks):
    check = Check(
        "missed", limit, Estimate(0.20, 0.20 - half, 0.20 + half), scenes=2000
    )
    assert check.status == "not met"
    assert check.times_more == pytest.approx(times, nan_ok=True)
    assert check.asks == asks


def test_a_table_in_another_order_says_the_same():
    rows = table((RAW, GOOD, BAD, SHIFTED))
    mixed = rows.sample(frac=1.0, random_state=3, ignore_index=True)
    for question in (
        Question(adding=rules) for rules in product(("linear", "independent"))
    ):
        first, second = (
            recommend(item, question, dataset="walks") for item in (rows, mixed)
        )
        assert names(first.proposals) == names(second.proposals)
