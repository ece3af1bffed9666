"""The sentences of the first screen agree with the tables of the run."""

import re
from functools import cache

import numpy as np
import pandas as pd
import pytest
from helpers.finished_runs import (
    ITEM,
    STRONGEST,
    emptied,
    levels,
    make_linkability,
    make_run,
    make_summary,
    with_links,
)
from helpers.summaries import BAD, SHIFTED, changed, table
from helpers.summaries import RAW as PLANTED_RAW

from evaluation.plan.address import parse_consumer
from evaluation.reporting.amounts import round_percent
from evaluation.reporting.answers import answers
from evaluation.reporting.headline import headline, headline_table
from evaluation.reporting.table import plugin_label

SHARE = re.compile(r"(\d+|<1) %(?: ±(\d+|<1))?")
LIMITS = {"50"}
"""Shares of the question itself, in %."""


def written_shares(run):
    """All shares of a run with half of their intervals, as texts show them."""
    rows = pd.concat([run.summary, run.levels])
    ends = 100.0 * rows[["value", "ci_low", "ci_high"]].to_numpy(dtype=float)
    values = {round_percent(value) for value, _, _ in ends}
    upper = {round_percent(high) for _, _, high in ends}
    pairs = {
        (round_percent(value), round_percent(0.5 * (high - low)))
        for value, low, high in ends
    }
    return pairs | {(value, "") for value in values | upper}


RUNS = {
    "all": lambda: with_links(make_run()),
    "raw alone": lambda: with_links(make_run(at=[("raw", np.nan)])),
    "clean alone": lambda: with_links(make_run(at=[("clean", np.nan)])),
    "independent alone": lambda: with_links(
        make_run(at=levels(rules=(":adding=independent",)))
    ),
    "a stranger": lambda: with_links(make_run(at=[("ou", 0.2), ("ou", 0.4)])),
    "no predictor": lambda: make_run(summary=make_summary(predictors=())),
    "no attack": lambda: make_run(summary=make_summary(attacks=()), strongest={}),
    "no linker": lambda: make_run(strongest={"": STRONGEST[""]}),
    "another predictor": lambda: make_run(summary=make_summary(predictors=("mine",))),
    "no verdict": lambda: make_run(verdict={}),
    "nothing": lambda: make_run(**emptied(make_run()), verdict={}, strongest={}),
}


@cache
def made_up_run(name):
    """A made-up run, shared by tests that do not change it."""
    return RUNS[name]()


@pytest.mark.parametrize("name", RUNS)
def test_every_number_of_an_answer_is_in_the_tables(name):
    run = made_up_run(name)
    five_answers = answers(run)
    assert len(five_answers) == 5
    for answer in five_answers:
        assert answer.sentence.endswith(".")
        assert "nan" not in answer.sentence
    shares = {
        pair for answer in five_answers for pair in SHARE.findall(answer.sentence)
    }
    assert {pair for pair in shares if pair[0] not in LIMITS} <= written_shares(run)
    assert shares or name == "nothing"
    (percent,) = re.findall(r"by at least (\d+) points", five_answers[3].sentence) or [
        None
    ]
    items = run.verdict.get("items", ())
    spreads = {
        f"{100 * i['spread_low']:.0f}" for i in items if i["section"] == "validity"
    }
    assert percent in (spreads or {None})
    untested = [
        answer.topic
        for answer in five_answers
        if answer.sentence.startswith("Not tested")
    ]
    expected = {
        "no predictor": ["Robot", "Links"],
        "no attack": ["Links"],
        "no linker": ["Links"],
        "another predictor": ["Links"],
        "no verdict": ["Links", "Descriptors"],
        "nothing": ["Robot", "Leak", "Links", "Descriptors"],
    }
    assert untested == expected.get(name, [])


@pytest.mark.parametrize("name", RUNS)
def test_without_the_level_an_answer_has_the_same_numbers(name):
    run = made_up_run(name)
    named, short = answers(run), answers(run, names_level=False)
    for long, brief in zip(named, short, strict=True):
        assert SHARE.findall(long.sentence) == SHARE.findall(brief.sentence)
        assert len(brief.sentence) <= len(long.sentence)


SPREAD = {"spread": 0.12, "spread_low": 0.08, "spread_high": 0.21, "n_needed": 412.0}
EQUAL = "at equal values, linkage differs by"
LINKABLE = "say how linkable people are"


@pytest.mark.parametrize(
    ("decision", "evidence", "low", "expected"),
    [
        (
            "does not track",
            ["attacks"],
            0.08,
            f"does not {LINKABLE}: {EQUAL} at least 8 points",
        ),
        (
            "does not track",
            ["construction"],
            0.08,
            f"does not {LINKABLE}: {EQUAL} at least 8",
        ),
        (
            "does not track",
            ["attacks"],
            0.0,
            f"does not {LINKABLE}: linkage falls where the priv",
        ),
        (
            "tracks",
            ["attacks"],
            0.0,
            "says how linkable people are: at equal values, linkage",
        ),
        (
            "between",
            [],
            0.02,
            "The run cannot say whether the privacy leakage ratio tells",
        ),
        ("not testable", [], 0.0, "The run cannot test the descriptors: nobody links."),
    ],
)
def test_the_fourth_answer_says_what_was_decided_and_how_wide_it_is(
    decision, evidence, low, expected
):
    item = (
        ITEM | SPREAD | {"decision": decision, "evidence": evidence, "spread_low": low}
    )
    item |= {"why": "nobody links"}
    other = item | {
        "decision": "not testable",
        "evidence": [],
        "spread_low": -1.0,
        "why": "x",
    }
    answer = answers(make_run(verdict={"items": [item, other]}))[3]
    assert expected in answer.sentence
    details = " ".join(answer.details)
    assert ("as far as these attacks go" in details) == ("attacks" in evidence)
    assert "on all 2 items" in details
    assert ("About 410 people" in answer.sentence) == (decision == "between")


def test_nobody_is_asked_for_millions_of_people():
    item = ITEM | SPREAD | {"decision": "between", "n_needed": 5089845.0}
    sentence = answers(make_run(verdict={"items": [item]}))[3].sentence
    assert sentence.endswith("No realistic number of people would decide it.")


def test_where_the_adding_rules_disagree_the_fourth_answer_says_so():
    item = ITEM | SPREAD | {"decision": "does not track", "evidence": []}
    other = item | {"decision": "between", "adding": "independent"}
    sentence = answers(make_run(verdict={"items": [item, other]}))[3].sentence
    assert sentence.endswith(" (noise as in the paper).")
    agreed = answers(
        make_run(verdict={"items": [item, item | {"adding": "independent"}]})
    )[3]
    assert "(" not in agreed.sentence


def test_where_the_adding_rules_disagree_the_first_three_say_so():
    run = make_run(at=levels(others=()), summary=make_summary(levels(others=())))
    columns = ["value", "ci_low", "ci_high"]
    far = run.summary["mechanism"] == "fid:adding=independent"
    run.summary.loc[far, columns] = 0.001
    robot, leak, *_ = answers(run)
    assert robot.sentence.endswith(
        "With noise independent of the sensing error: <1 % ±0."
    )
    assert leak.sentence.endswith(
        "With noise independent of the sensing error: <1 % ±0 and <1 % ±0."
    )


def test_attacks_are_compared_with_the_optimum_where_that_is_known():
    rows = [
        ("rank1", "rerelease/shape", "blind", 0.47),
        ("rank1_gap", "rerelease/shape", "blind", 0.04),
        ("rank1_optimum", "rerelease/bound", "", 0.51),
    ]
    world = pd.DataFrame(rows, columns=["metric", "consumer", "knowledge", "value"])
    world = world.assign(
        unit="fraction", dataset="students03:model,law=isotropic", mechanism="fid"
    )
    world = world.assign(
        level=1.0, ci_low=0.0, ci_high=0.6, n=84, family="fid", adding="linear"
    )
    item = ITEM | SPREAD | {"decision": "tracks", "evidence": ["attacks"]}
    run = make_run(
        summary=pd.concat([make_summary(), world]), verdict={"items": [item]}
    )
    beside = (
        "In the model world the closest attack lacks 4.0 of 100 people of the optimum."
    )
    assert beside in answers(run)[3].details


def test_a_run_without_errors_is_answered_with_what_it_has():
    run = make_run(at=[("clean", np.nan)])
    start = "With no error at all, the paper's straight line misses "
    assert answers(run)[0].sentence.startswith(start)


def share_sentence(*levels):
    """The last answer of a run with these levels."""
    planted = table((PLANTED_RAW, *levels))
    named = planted["dataset"].str.replace("walks", "students03")
    return answers(make_run(levels=planted.assign(dataset=named)))[4].sentence


def test_nothing_is_proposed_for_a_dozen_people_without_intervals():
    sentence = share_sentence(changed(half=np.nan))
    assert sentence.startswith(
        "The run cannot say: there are too few people: a decision takes 20."
    )
    assert sentence.endswith("All other limits hold with slow noise of 0.4 m.")


def test_a_level_is_proposed_with_its_cost_and_what_breaks_it():
    sentence = share_sentence(changed(beyond={"anchor": 0.92}))
    assert sentence.startswith(
        "Slow noise of 0.4 m is the cheapest level with at most 50 % of pos"
    )
    cost = "Held to the false alarms of raw positions, a Kalman robot misses 20 % ±2"
    assert f"{cost} (raw: 5 %)." in sentence
    assert sentence.endswith(
        "An adversary with one true position (knows 92 %) breaks it."
    )


def test_an_adversary_that_too_few_people_tell_of_neither_breaks_it_nor_holds():
    planted = table((PLANTED_RAW, changed(beyond={"anchor": 0.2})))
    is_anchor = planted["adversary"] == "anchor"
    planted.loc[is_anchor, ["ci_low", "ci_high"]] = np.nan
    named = planted["dataset"].str.replace("walks", "students03")
    run = make_run(levels=planted.assign(dataset=named))
    assert answers(run)[4].sentence.endswith(
        "The run cannot say whether it holds against an adversary with one true"
        " position."
    )


def test_without_a_level_within_the_limits_the_nearest_is_named_but_never_a_control():
    sentence = share_sentence(BAD, SHIFTED)
    limits = "50 % of positions known and 50 % of the raw re-identification"
    nearest = "the nearest is fixed noise of 1 m (independent)"
    assert sentence.startswith(f"No level has at most {limits}; {nearest}. An attack")
    assert "shift" not in sentence
    expected = "Not answerable: the run has no level that claims to protect."
    assert share_sentence(SHIFTED) == expected


def test_a_robot_that_knows_the_mechanism_is_in_the_first_answer_beside_the_others():
    robots = ("least_squares", "kalman_cv", "kalman_cv:aware=true")
    run = make_run(summary=make_summary(predictors=robots))
    first = answers(run)[0]
    text = " ".join([first.sentence, *first.details])
    assert "a kalman robot misses" in text.lower()
    assert "A Kalman robot that knows the noise misses" in text
    heads = [column.name for column in headline_table(run.headline).columns]
    missed = ["missed conflicts, paper's line", "missed conflicts, Kalman"]
    assert [head for head in heads if head.startswith("missed")] == missed


def test_a_plug_in_is_called_by_its_class_where_a_person_reads():
    table = make_run(summary=make_summary(predictors=("my_robot.it:MyRobot",))).headline
    assert table.robots[0].name == "MyRobot"
    names = ("my_noise.mine:MyNoise", "fixed", "kalman_cv:aware=true")
    assert [plugin_label(name) for name in names] == ["MyNoise", *names[1:]]


def test_linkage_across_sessions_is_in_the_table_and_the_third_answer():
    tasks = ("handover-1s", "handover-5s", "rerelease", "cross_session")
    linked = make_linkability(tasks={task: {"shape": 0.4} for task in tasks})
    best = STRONGEST | dict.fromkeys(tasks, parse_consumer("shape", "informed"))
    run = with_links(make_run(linkability=linked, strongest=best))
    assert "In another session, the strongest" in " ".join(answers(run)[2].details)
    heads = [column.name for column in headline_table(run.headline).columns]
    assert [head for head in heads if head.startswith("re-identified")] == [
        f"re-identified, {head}" for head in ("after 5 s", "session 2", "two logs")
    ]


def test_the_second_answer_and_the_table_have_both_error_laws():
    run = make_run()
    other = run.summary.assign(dataset="students03:law=isotropic")
    is_attack = other["consumer"] == STRONGEST[""].consumer
    other = other[is_attack].assign(value=0.123, ci_low=0.11, ci_high=0.14)
    both_laws = make_run(summary=pd.concat([run.summary, other]))
    text = " ".join(answers(both_laws)[1].details)
    assert "The run assumes the error law of the paper" in text
    assert "With isotropic errors the attack knows 12 % ±2." in text
    heads = [column.name for column in headline_table(both_laws.headline).columns]
    own = [column.name for column in headline_table(run.headline).columns]
    assert set(heads) - set(own) == {"known to 0.3 m, attacked, isotropic error"}
    assert answers(run)[0] == answers(both_laws)[0]


@pytest.mark.parametrize("n", [55, 12])
def test_the_worst_off_tenth_stands_beside_the_mean_or_says_why_it_does_not(n):
    run = make_run()
    is_attack = run.summary["consumer"] == STRONGEST[""].consumer
    worst = run.summary[is_attack & (run.summary["metric"] == "plr")]
    numbers = {"value": 0.876, "ci_low": 0.8, "ci_high": 0.92}
    refused = dict.fromkeys(numbers, np.nan)
    worst = worst.assign(
        metric="plr_worst_tenth", n=n, **(numbers if n > 20 else refused)
    )
    with_tenth = make_run(summary=pd.concat([run.summary, worst]))
    details = " ".join(answers(with_tenth)[1].details)
    table = headline_table(with_tenth.headline)
    heads = [column.name for column in table.columns]
    sentence = "Of the most exposed tenth of people it knows 88 % ±6."
    assert (sentence in details) == (n > 20)
    assert ("known to 0.3 m, attacked, worst tenth of people" in heads) == (n > 20)
    (note,) = table.notes
    expected = "the most exposed tenth of 55 people" if n > 20 else "it takes 20 people"
    assert expected in note
    assert "at least 8 releases" in note


def test_the_worst_tenth_under_slow_noise_is_by_the_attack_that_is_strongest_there():
    rows = [
        ("raw", np.nan, "raw", "radial_rts", "plr", 0.9),
        ("ou", 0.4, "ou", "radial_rts", "plr", 0.2),
        ("ou", 0.4, "ou", "radial_rts", "plr_worst_tenth", 0.25),
        ("ou", 0.4, "ou", "ou_rts", "plr", 0.3),
        ("ou", 0.4, "ou", "ou_rts", "plr_worst_tenth", 0.6),
    ]
    names = ["mechanism", "level", "family", "consumer", "metric", "value"]
    summary = pd.DataFrame(rows, columns=names).assign(
        dataset="walks", knowledge="informed", adding="", n=40, unit="fraction"
    )
    summary["ci_low"], summary["ci_high"] = (
        summary["value"] - 0.02,
        summary["value"] + 0.02,
    )
    attacked = summary[(summary["consumer"] == "ou_rts") & (summary["metric"] == "plr")]
    attacked = attacked.assign(task="", adversary="one release")
    for given in (None, attacked):
        first = headline(
            summary,
            attacks={"": parse_consumer("radial_rts", "informed")},
            attacked=given,
        )
        assert first.worst is not None
        worst = first.at(("ou", 0.4), first.worst)
        assert worst is not None
        assert worst.value == 0.6
