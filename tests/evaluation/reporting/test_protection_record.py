"""The data-protection record: numbers of the run, risks of the opinion."""

from dataclasses import replace

import pandas as pd
from helpers.finished_runs import emptied, make_run, with_links

from evaluation.reporting.amounts import precise_percent
from evaluation.reporting.answers import reference_level
from evaluation.reporting.protection_record import protection_record
from isac_track.intervals import Estimate

TOPICS = [
    "What is processed",
    "Recipients who may link",
    "Singling out",
    "Linkability",
    "Inference",
    "Limits",
    "Not tested",
]


def entries(run, table=None):
    record = protection_record(run, run.headline if table is None else table)
    assert [entry.topic for entry in record] == TOPICS
    assert all(entry.sentences for entry in record)
    return {entry.topic: " ".join(entry.sentences) for entry in record}


def test_numbers_are_those_of_the_run_with_intervals():
    run = with_links(make_run())
    table = run.headline
    text, where = entries(run), reference_level(table)
    assert precise_percent(table.at(where, table.linked[0])) in text["Singling out"]
    assert precise_percent(table.at(where, table.attacked)) in text["Inference"]
    assert precise_percent(table.at(where, table.shared)) in text["Inference"]
    assert f"{run.manifest['dataset']['tracks_used']:,} of" in text["What is processed"]


def test_risks_are_quoted_and_none_else():
    run = with_links(make_run())
    record = protection_record(run, run.headline)
    quoted = [entry.topic for entry in record if entry.quotation]
    assert quoted == ["Singling out", "Linkability", "Inference"]


def test_only_an_interval_above_chance_shows_a_risk():
    run = with_links(make_run())
    table = run.headline
    task, where = table.linked[0], reference_level(table)
    key = task.measure.at(*where)
    low = replace(table, numbers={**table.numbers, key: Estimate(0.02, 0.0, 0.3, n=9)})
    assert "is not ruled out" in entries(run)["Singling out"]
    assert "does not show more than chance" in entries(run, low)["Singling out"]


def test_a_run_without_attacks_says_that_nothing_was_tested():
    text = entries(make_run(**emptied(make_run()), verdict={}, strongest={}))
    assert "No attack was run." in text["Recipients who may link"]
    assert text["Linkability"] == "Not tested in this run."
    assert "after 1 s of silence" in text["Not tested"]


def test_simulated_people_and_failed_cells_are_named():
    run = with_links(make_run())
    run.manifest["dataset"]["simulated"] = True
    run = replace(run, failed=pd.DataFrame({"why": ["killed", "late"]}))
    text = entries(run)
    assert "simulated people" in text["What is processed"]
    assert "say nothing about real people" in text["Limits"]
    assert "2 cells could not be computed." in text["Not tested"]
    run.manifest["dataset"]["simulated"] = False
