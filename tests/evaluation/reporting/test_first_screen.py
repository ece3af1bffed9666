"""The first screen of a run: few lines, none too wide, with every doubt."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from helpers.finished_runs import (
    VERDICT,
    emptied,
    everything,
    levels,
    make_flags,
    make_linkability,
    make_run,
    make_summary,
)
from helpers.summaries import BAD, GOOD, RAW, patrol_option, table

from evaluation.reporting.announcements import condense_notices
from evaluation.reporting.doubts import doubts
from evaluation.reporting.first_screen import LINES, first_screen, fitting_lines
from evaluation.reporting.notices import cost_text, data_notices, geometry, notices
from evaluation.reporting.progress import Clock
from evaluation.reporting.recommendation import named_levels

MANY = [*levels(), *[(f"ou{n}", at) for n in range(20) for at in (0.2, 0.4)]]


def on_patrol(*, is_proposed):
    """A made-up run of two noises whose robots patrol, without intervals."""
    option = patrol_option("state:2", missed=0.4, known=0.18, half=None)
    proposal = {
        "robot": "kalman_cv",
        "horizon_s": 3.0,
        "limits": {"lost": 0.05},
        "everything": patrol_option("everything", missed=0.3, known=0.95, half=None),
        "best": option if is_proposed else None,
        "nearest": None if is_proposed else option,
        "has_interval": False,
    }
    return make_run(at=MANY, verdict=VERDICT | {"patrols": {"recommended": proposal}})


RUNS = {
    "many": lambda: make_run(at=MANY),
    "on patrol": lambda: on_patrol(is_proposed=True),
    "on patrol, nothing proposed": lambda: on_patrol(is_proposed=False),
    "everything": everything,
    "raw alone": lambda: make_run(at=[("raw", np.nan)]),
    "clean alone": lambda: make_run(at=[("clean", np.nan)]),
    "no predictor": lambda: make_run(summary=make_summary(predictors=())),
    "no attack": lambda: make_run(summary=make_summary(attacks=()), strongest={}),
    "no verdict": lambda: make_run(verdict={}),
    "nothing": lambda: make_run(**emptied(make_run()), verdict={}, strongest={}),
}


@cache
def made_up_run(name):
    """A made-up run, shared by tests that do not change it."""
    return RUNS[name]()


@pytest.mark.parametrize("before", [0, 3, 11])
@pytest.mark.parametrize("name", RUNS)
def test_it_fits_a_terminal_whatever_was_said_before(name, before):
    lines = first_screen(made_up_run(name), before=before)
    assert len(lines) <= LINES == 24
    assert max(map(len, lines)) <= 80
    assert not any("?" in line or "nan" in line for line in lines)
    assert lines[0].startswith(
        "Students03: 428 people recorded, 106 long enough to use; 2,000"
    )
    assert any(line.startswith("raw positions ") for line in lines) == (
        name not in ("clean alone", "nothing")
    )


def test_the_last_sentences_of_the_longest_answer_give_way():
    texts = ["A: First. " + "Word " * 40 + "end. Last.", "B: Only a sentence."]
    whole = fitting_lines(texts, most=24)
    assert fitting_lines(texts, most=len(whole)) == whole
    assert fitting_lines(texts, most=2) == ["A: First.", "B: Only a sentence."]
    assert fitting_lines(texts, most=1) == ["A: First.", "B: Only a sentence."]


def test_the_level_that_the_last_answer_names_has_a_row_where_there_is_room_for_few():
    planted = table((RAW, GOOD, BAD)).assign(
        dataset=lambda rows: rows["dataset"].str.replace("walks", "students03")
    )
    run = make_run(at=[("ou", 0.4), *MANY], levels=planted)
    assert named_levels(run) == [("ou", 0.4)]
    lines = first_screen(run, before=12)
    assert any(line.startswith("slow noise, 0.4 m ") for line in lines)
    text = " ".join(" ".join(lines).split())
    assert (
        "Share: Slow noise of 0.4 m is the cheapest level with at most 50 % of" in text
    )
    assert "It holds against an adversary with several releases" in text


def test_raw_comes_first_then_a_level_of_every_mechanism_of_the_paper():
    lines = first_screen(make_run(at=MANY))
    start = (
        lines.index(next(line for line in lines if line.startswith("what is shared")))
        + 1
    )
    rows = [line.split("  ")[0] for line in lines[start:]]
    assert rows[0] == "raw positions"
    assert {"FID noise, eta 1", "fixed noise, 0.7 m"} <= {*rows[1:7]}
    # The same noise under the other adding rule comes only after all that.
    assert "FID noise, eta 1 *" not in rows


def test_a_mark_of_independent_noise_is_explained_once():
    lines = first_screen(make_run(at=levels(rules=(":adding=independent",), others=())))
    assert any(line.startswith("FID noise, eta 1 *") for line in lines)
    assert sum(line.startswith("* noise independent of") for line in lines) == 1


def test_what_simulates_says_so_first_and_doubts_are_counted():
    linked = make_linkability()
    linked.loc[linked["mechanism"] == "raw", "invalid"] = "duration"
    row = {"spec": "fid:1", "kind": "attack", "consumer": "mine", "knowledge": "blind"}
    failed = pd.DataFrame([row | {"block": 0, "why": "it broke"}])
    run = make_run(flags=make_flags(), failed=failed, linkability=linked)
    run.manifest["dataset"]["simulated"] = True
    run.manifest["linkage"] = {
        "tasks": {
            "rerelease": {"frozen": 7, "people": 9, "too_short": 0, "not_drawn": 0}
        },
        "skipped": {"split": "x"},
    }
    text = " ".join(" ".join(first_screen(run)).split())
    assert text.startswith("Simulated crowd students03: 428 people, 106 long enough")
    assert "Doubts: 1 cell FAILED (it broke)" in text
    assert re.search(r"Doubts: .* \d more in tables.txt\.", text)
    texts = doubts(run)
    assert texts[1:4] == [
        "1 sign of a weak attack",
        "6 of 96 linkage results invalid (track length)",
        "not linked: split",
    ]
    assert texts[-2:] == ["7 tracks nearly frozen", "1 notice"]
    assert [*notices(run.manifest)] == ["rerelease: 7 of 9 tracks are nearly frozen."]


@pytest.mark.parametrize(
    ("n_linked", "n_tests", "text"),
    [
        (0, 0, ""),
        (1, 10, ""),  # So many in 40 % of runs if no control links.
        (2, 10, ""),  # In 9 %.
        (3, 10, "3 of 10 controls link people (0.5 expected)"),  # In 1 %.
        (5, 50, ""),  # In 10 %.
        (6, 50, "6 of 50 controls link people (2.5 expected)"),  # In 4 %.
    ],
)
def test_controls_that_link_are_a_doubt_if_chance_hardly_explains_them(
    n_linked, n_tests, text, monkeypatch
):
    outcomes = [True] * n_linked + [False] * (n_tests - n_linked)
    monkeypatch.setattr(
        "evaluation.reporting.doubts.control_tests", lambda _: {"duration": outcomes}
    )
    run = make_run()
    assert len(run.tasks) == 1
    lines = [line for line in doubts(run) if "controls link" in line]
    assert lines == [text] * bool(text)


def test_too_few_people_are_a_doubt_from_the_start_to_the_end():
    run = make_run()
    dataset = run.manifest["dataset"]
    dataset |= {"tracks_used": 18, "would_help": "the longest last 9.0 s"}
    text = " ".join(" ".join(first_screen(run)).split())
    assert "Doubts: 18 usable tracks: too few to decide anything" in text
    assert "Share: With 18 usable tracks nothing is decided." in text
    assert data_notices(dataset)[0].endswith(
        "too few to decide anything (the longest last 9.0 s)."
    )


def test_units_in_doubt_are_a_doubt_and_what_was_mended_a_notice():
    run = make_run()
    doubt = {
        "kind": "doubt",
        "count": 1,
        "detail": "f: units may be wrong: likely feet?",
    }
    bent = {"kind": "overshoot", "count": 1234, "detail": "pieces"}
    run.manifest["dataset"]["repairs"] = [doubt, bent]
    assert "units of the recording may be wrong" in " ".join(doubts(run))
    first, second = data_notices(run.manifest["dataset"])
    assert first == doubt["detail"]
    assert "1,234 pieces of walks made straight where a spline overshoots" in second


@pytest.mark.parametrize(
    "name", ["students03-paper-0", "a-recording-with-a-long-name-paper-0"]
)
def test_where_to_read_on_can_be_copied_and_fits(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "runs" / name
    out.mkdir(parents=True)
    (out / "report.html").touch()
    lines = first_screen(make_run(out, at=MANY), before=5)
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    assert any(line.startswith(f"Page: runs/{name}/report.html") for line in lines)


@pytest.mark.parametrize(
    ("predictors", "shown"),
    [
        (
            ("kalman_cv", "least_squares", "mine:gain=0.5"),
            "A robot with mine:gain=0.5 misses ",
        ),
        (
            ("kalman_ca", "kalman_cv", "least_squares"),
            "The paper's straight line misses ",
        ),
        (("kalman_ca", "kalman_cv"), "A Kalman robot with acceleration misses "),
        (("constant_position", "another"), "A robot with another misses "),
        (("constant_position",), "A robot that expects people to stand still misses "),
    ],
)
def test_a_user_s_own_robot_is_shown(predictors, shown):
    run = make_run(summary=make_summary(predictors=predictors))
    lines = first_screen(run)
    assert any(line.startswith(f"Robot: {shown}"[:78]) for line in lines)
    assert max(map(len, lines)) <= 80


def test_numbers_without_an_interval_say_why():
    assert "no intervals" not in " ".join(first_screen(make_run()))
    run = make_run()  # Its numbers are read once: they change before that.
    run.summary.loc[
        run.summary["metric"] == "missed_conflict_rate", ["ci_low", "ci_high"]
    ] = np.nan
    text = " ".join(" ".join(first_screen(run)).split())
    assert "Doubts: no intervals on missed conflicts (few people)" in text


def test_the_next_question_is_one_that_the_run_can_answer(tmp_path):
    lines = first_screen(make_run(tmp_path / "run"))
    assert any("evaluation.design --max-missed 0.20" in line for line in lines)
    single_rule = make_run(tmp_path / "run", at=levels(rules=("",), others=()))
    *_, first, second = first_screen(single_rule)
    assert first.endswith(" --max-missed 0.20 \\")
    assert second.startswith("  --adding linear ")
    assert not any("--adding" in line for line in lines)
    no_robot = first_screen(
        make_run(tmp_path / "run", summary=make_summary(predictors=()))
    )
    assert "evaluation.report --verbose" in no_robot[-2] + no_robot[-1]


@pytest.mark.parametrize(
    ("cost_s", "text"),
    [(25.2, "about 25 s"), (180, "about 3 min"), (np.nan, "an unknown time")],
)
def test_a_cost_is_rounded_and_an_unknown_cost_says_so(cost_s, text):
    assert cost_text(cost_s) == text


def test_notices_are_cut_where_they_can_be_read_in_full():
    notices = ["a " * 100, "b"]
    assert len(condense_notices(notices, most=None, where="x")) == 4
    lines = condense_notices(notices, most=3, where="tables.txt")
    assert len(lines) == 3
    assert lines[-1] == "  ... 2 notices in full: tables.txt"
    assert condense_notices(["b"], most=2, where="x") == ["b"]


def test_the_time_left_goes_by_what_was_finished_after_the_first_cell():
    at = iter([0.0, 1.0, 30.0, 31.0, 40.0, 4130.0])
    clock = Clock(now=lambda: next(at))
    assert clock.text(0, 1000) == "0:01"
    # 29 s of compiling tell nothing about the other cells.
    assert clock.text(10, 1000) == "0:30"
    assert clock.text(20, 1000) == "0:31"
    # 100 cells in 10 s: 89 s for 890; then an eighth of 129 s for the report.
    assert clock.text(110, 1000) == "0:40, about 1:44 left"
    assert clock.text(1000, 1000) == "1:08:50"


@pytest.mark.parametrize(
    ("distance_m", "at_cap", "expected"),
    [
        (30.0, 0.13, ""),
        (53.2, 0.1, "(usual: 20 to 40 m)."),
        (30.0, 0.48, "; 48 % have the larg"),
    ],
)
def test_an_unusual_geometry_is_on_the_first_screen(distance_m, at_cap, expected):
    known = {
        "distance_m": distance_m,
        "sigma_raw_m": 1.92,
        "at_cap": at_cap,
        "tracks": 9,
    }
    run = make_run()
    run = replace(run, manifest=run.manifest | {"geometry": known})
    shown = " ".join(" ".join(first_screen(run)).split())
    assert ("Geometry: people are" in shown) == bool(expected)
    assert expected in shown
    assert geometry(run.manifest)
    assert geometry(make_run().manifest) == []


@pytest.mark.parametrize(
    ("place", "distance_m", "has_way_out"),
    [("file", 5.3e6, True), ("file", 30.0, False), ("centred", 53.0, False)],
)
def test_a_station_far_from_a_file_says_the_way_out(place, distance_m, has_way_out):
    known = {"distance_m": distance_m, "sigma_raw_m": 2.0, "at_cap": 1.0, "tracks": 9}
    manifest = make_run().manifest | {"geometry": known}
    stages = manifest["settings"]["stages"] | {"sensing.place": place}
    manifest["settings"] = manifest["settings"] | {"stages": stages}
    (line,) = geometry(manifest)
    way_out = "--set sensing.bs_x_m and bs_y_m move the station; sensing.place=centred"
    assert (way_out in line) == has_way_out
