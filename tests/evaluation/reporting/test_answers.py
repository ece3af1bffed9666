"""What the first screen says in words is what the tables of the run hold."""

import re

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

from evaluation.analysis.keys import Source
from evaluation.reporting.answers import answers, headline_of
from evaluation.reporting.headline import headline_table
from evaluation.reporting.rows import spoken

SHARE = re.compile(r"(\d+\.\d) % \[(\d+\.\d), (\d+\.\d)\]")
PEOPLE = re.compile(r"(\d+) of 100 people, at least (\d+)")


def held(run):
    """All shares of a run with their intervals, as they are written."""
    both = pd.concat([run.summary, run.levels])
    ends = (100.0 * both[["value", "ci_low", "ci_high"]]).to_numpy(dtype=float)
    return {tuple(f"{one:.1f}" for one in row) for row in ends}


def spreads_of(verdict):
    """By how many of 100 people linkage differs, of all items."""
    ends = [
        [100 * one[key] for key in ("spread", "spread_low")]
        for one in verdict.get("items", ())
        if one["section"] == "validity"
    ]
    return {(f"{value:.0f}", f"{low:.0f}") for value, low in ends}


RUNS = {
    "all": lambda: with_links(make_run()),
    "raw alone": lambda: with_links(make_run(at=[("raw", np.nan)])),
    "clean alone": lambda: with_links(make_run(at=[("clean", np.nan)])),
    "independent alone": lambda: with_links(make_run(at=levels(rules=(":adding=independent",)))),
    "a stranger": lambda: with_links(make_run(at=[("ou", 0.2), ("ou", 0.4)])),
    "no predictor": lambda: make_run(summary=make_summary(predictors=())),
    "no attack": lambda: make_run(summary=make_summary(attacks=()), strongest={}),
    "no linker": lambda: make_run(strongest={"": STRONGEST[""]}),
    "another predictor": lambda: make_run(summary=make_summary(predictors=("mine",))),
    "no verdict": lambda: make_run(verdict={}),
    "nothing": lambda: make_run(**emptied(make_run()), verdict={}, strongest={}),
}


@pytest.mark.parametrize("name", RUNS)
def test_every_number_of_an_answer_is_in_the_tables(name):
    run = RUNS[name]()
    said = answers(run)
    assert len(said) == 5
    assert all(one.sentence.endswith(".") and "nan" not in one.sentence for one in said)
    found = SHARE.findall(" ".join(one.sentence for one in said))
    assert set(found) <= held(run)
    assert found or name == "nothing"
    spreads = PEOPLE.findall(said[3].sentence)
    assert set(spreads) <= spreads_of(run.verdict)
    assert len(spreads) == (name not in ("no verdict", "nothing"))
    untested = [one.topic for one in said if one.sentence.startswith("Not tested")]
    expected = {
        "no predictor": ["Robot", "Links"],
        "no attack": ["Links"],
        "no linker": ["Links"],
        "another predictor": ["Links"],
        "no verdict": ["Links", "Tells"],
        "nothing": ["Robot", "Leak", "Links", "Tells"],
    }
    assert untested == expected.get(name, [])


SPREAD = {"spread": 0.12, "spread_low": 0.08, "spread_high": 0.21, "n_needed": 412.0}
AT, SO_FAR = "at equal PLR linkage differs by", "as far as these attacks go"


@pytest.mark.parametrize(
    ("decision", "evidence", "low", "said"),
    [
        ("does not track", ["attacks"], 0.08, f"No (PLR): {AT} 12 of {{}}, {SO_FAR}"),
        ("does not track", ["construction", "shown"], 0.08, f"No (PLR): {AT} 12 of {{}}, shown by"),
        ("does not track", ["attacks"], 0.0, "No (PLR): linkage falls where PLR hardly changes ("),
        ("tracks", ["attacks"], 0.0, f"Yes (PLR): {AT} 0 to 21 of {{}}, {SO_FAR}"),
        ("between", [], 0.02, f"Not shown either way (PLR): {AT} 2 to 21 of {{}}; were it equal, "),
        (
            "not testable",
            [],
            0.0,
            "Not testable (PLR): rerelease, linear: nobody links; of 2 items",
        ),
    ],
)
def test_the_fourth_answer_says_what_was_decided_and_how_wide_it_is(decision, evidence, low, said):
    item = ITEM | SPREAD | {"decision": decision, "evidence": evidence, "spread_low": low}
    item |= {"why": "nobody links"}
    other = item | {"decision": "not testable", "evidence": [], "spread_low": -1.0, "why": "x"}
    people = f"100 people{', at least 8' * (decision == 'does not track')} (rerelease, linear)"
    sentence = answers(make_run(verdict={"items": [item, other]}))[3].sentence
    assert sentence.startswith(said.format(people))
    assert sentence.endswith("1 not testable.") or decision == "not testable"


def test_what_attacks_find_is_held_against_the_optimum_where_that_is_known():
    shown = {"rank1": 0.47, "rank1_gap": 0.04, "rank1_optimum": 0.51}
    rows = [
        {
            "consumer": "rerelease/" + ("bound" if name == "rank1_optimum" else "shape"),
            "value": value,
        }
        | {
            "knowledge": "" if name == "rank1_optimum" else "blind",
            "metric": name,
            "unit": "fraction",
        }
        for name, value in shown.items()
    ]
    world = pd.DataFrame(rows).assign(dataset="students03:model,law=isotropic", mechanism="fid")
    world = world.assign(level=1.0, ci_low=0.0, ci_high=0.6, n=84, family="fid", adding="linear")
    item = ITEM | SPREAD | {"decision": "tracks", "evidence": ["attacks"]}
    run = make_run(summary=pd.concat([make_summary(), world]), verdict={"items": [item]})
    beside = f"{SO_FAR} (in the model world 4.0 of 100 people below the optimum at fid:1);"
    assert beside in answers(run)[3].sentence


def test_a_run_without_errors_is_answered_with_what_it_has():
    run = make_run(at=[("clean", np.nan)])
    assert answers(run)[0].sentence.startswith("Missed conflicts at clean: the paper's line ")


def proposed(*levels):
    """The last answer of a run with planted levels."""
    planted = table((PLANTED_RAW, *levels))
    named = planted["dataset"].str.replace("walks", "students03")
    return answers(make_run(levels=planted.assign(dataset=named)))[4].sentence


def test_of_a_dozen_people_without_intervals_nothing_is_proposed():
    said = proposed(changed(half=np.nan))
    assert said.startswith("Not answerable: so few people have no interval; 15 groups have.")
    assert said.endswith("At ou:0.4 ind. all else holds.")


def test_a_level_is_proposed_with_what_could_undo_it():
    said = proposed(changed(beyond={"anchor": 0.92}))
    assert "It falls to anchor 92.0 % [90.0, 94.0]. Not tried: repeats, companions" in said
    assert "of raw's is ou:0.4 ind.: Kalman misses 20.0 % [18.0, 22.0] of conflicts to come" in said
    assert "median error 0.50 m [0.48, 0.52], linked after 1 s 30.0 % [28.0, 32.0]" in said


def test_if_none_holds_the_nearest_is_told_and_a_control_never():
    said = proposed(BAD, SHIFTED)
    assert said.startswith("No level holds PLR after attack (at epsilon and at 4/3 of it) <= 50 %")
    assert "The nearest, fixed:1 ind., has PLR 80.0 % [78.0, 82.0], at 4/3 of epsilon" in said
    assert "offset" not in said
    assert proposed(SHIFTED) == "Not answerable: no level of the run claims to protect."


def test_a_robot_that_knows_the_mechanism_is_in_the_first_answer_beside_the_others():
    robots = ("least_squares", "kalman_cv", "kalman_cv:aware=true")
    run = make_run(summary=make_summary(predictors=robots))
    assert re.search(
        "the paper's line .*, Kalman .*, Kalman that is aware ", answers(run)[0].sentence
    )
    heads = [column.name for column in headline_table(headline_of(run)).columns]
    assert [one for one in heads if one.startswith("missed")] == ["missed, line", "missed, Kalman"]


def test_a_plug_in_is_called_by_its_class_where_a_person_reads():
    of = headline_of(make_run(summary=make_summary(predictors=("my_robot.it:MyRobot",))))
    assert of.robots[0].name == "MyRobot"
    names = ("my_noise.mine:MyNoise", "fixed", "kalman_cv:aware=true")
    assert [spoken(one) for one in names] == ["MyNoise", *names[1:]]


def test_who_comes_back_in_another_session_is_in_the_table_and_the_third_answer():
    tasks = ("handover-1s", "handover-5s", "rerelease", "cross_session")
    linked = make_linkability(tasks={task: {"shape": 0.4} for task in tasks})
    best = STRONGEST | dict.fromkeys(tasks, Source("shape", "informed"))
    run = with_links(make_run(linkability=linked, strongest=best))
    assert " in another session, " in answers(run)[2].sentence
    heads = [column.name for column in headline_table(headline_of(run)).columns]
    assert [one for one in heads if one.startswith("found")] == [
        f"found again, {head}" for head in ("5 s", "back", "rerel.")
    ]


def test_what_leaks_is_told_under_both_error_laws_and_tabled():
    run = make_run()
    other = run.summary.assign(dataset="students03:law=isotropic")
    is_attack = other["consumer"] == STRONGEST[""].consumer
    other = other[is_attack].assign(value=0.123, ci_low=0.11, ci_high=0.14)
    both = make_run(summary=pd.concat([run.summary, other]))
    assert " (12.3 % [11.0, 14.0] if errors are isotropic) after " in answers(both)[1].sentence
    heads = [column.name for column in headline_table(headline_of(both)).columns]
    own = [column.name for column in headline_table(headline_of(run)).columns]
    assert set(heads) - set(own) == {"known in 0.3 m, attack, isotropic error"}
    assert answers(run)[0] == answers(both)[0]


@pytest.mark.parametrize("n", [55, 12])
def test_the_worst_off_tenth_stands_beside_the_mean_or_says_why_it_does_not(n):
    run = make_run()
    is_attack = run.summary["consumer"] == STRONGEST[""].consumer
    worst = run.summary[is_attack & (run.summary["metric"] == "plr")]
    numbers = {"value": 0.876, "ci_low": 0.8, "ci_high": 0.92}
    refused = dict.fromkeys(numbers, np.nan)
    worst = worst.assign(metric="plr_worst_tenth", n=n, **(numbers if n > 20 else refused))
    both = make_run(summary=pd.concat([run.summary, worst]))
    sentence, table = answers(both)[1].sentence, headline_table(headline_of(both))
    heads = [column.name for column in table.columns]
    is_told = "(the worst-off tenth of people: 87.6 % [80.0, 92.0])" in sentence
    assert is_told == (n > 20) == ("known in 0.3 m, attack, worst tenth of people" in heads)
    (note,) = table.notes
    expected = "the most exposed tenth of 55 people" if n > 20 else "it takes 20 people"
    assert expected in note
    assert "at least 8 releases" in note
