"""What the first screen says in words is what the tables of the run hold."""

import re

import numpy as np
import pytest
from helpers.finished_runs import (
    STRONGEST,
    emptied,
    levels,
    make_run,
    make_summary,
    with_links,
)

from evaluation.reporting.answers import answers

SHARE = re.compile(r"(\d+\.\d) % \[(\d+\.\d), (\d+\.\d)\]")
PEOPLE = re.compile(r"(\d+) \[(\d+), (\d+)\] of 100")


def held(run):
    """All shares of a summary with their intervals, as they are written."""
    ends = (100.0 * run.summary[["value", "ci_low", "ci_high"]]).to_numpy()
    return {tuple(f"{one:.1f}" for one in row) for row in ends}


def spreads_of(verdict):
    """By how many of 100 people linkage differs, of all items."""
    ends = [
        sorted(abs(100 * one[key]) for key in ("ci_low", "effect", "ci_high"))
        for one in verdict.get("items", ())
        if one["section"] == "validity"
    ]
    return {(f"{value:.0f}", f"{low:.0f}", f"{high:.0f}") for low, value, high in ends}


RUNS = {
    "all": lambda: with_links(make_run()),
    "raw alone": lambda: with_links(make_run(at=[("raw", np.nan)])),
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
        "no predictor": ["Robot", "Links", "Level"],
        "no attack": ["Links", "Level"],
        "no linker": ["Links"],
        "another predictor": ["Links"],
        "no verdict": ["Links", "Tells"],
        "nothing": ["Robot", "Leak", "Links", "Tells", "Level"],
    }
    assert untested == expected.get(name, [])
