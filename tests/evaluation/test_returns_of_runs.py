"""Runs on people who come back: the numbers of the library, and a first screen."""

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers.returners import write_sessions

import evaluation
from attacks.tasks.passage_releases import hide_frames
from attacks.tasks.passages import find_passages
from attacks.tasks.return_study import FUSION, LINKERS, study_returns
from attacks.tasks.task_list import FUSED
from evaluation import matrix
from evaluation.estimates.differences import compare
from evaluation.plan.plan import make_plan
from evaluation.plan.settings import Settings
from evaluation.plan.workers import most_workers
from evaluation.reporting.figures.figure import make_figures
from evaluation.reporting.first_screen import first_screen
from evaluation.reporting.notices import plan_notices
from evaluation.reporting.page import render
from evaluation.reporting.return_words import return_sentence
from isac_track import datasets
from isac_track.place import placed

KEY = ["dataset", "mechanism", "level", "consumer", "knowledge", "metric"]
ENDS = ["value", "ci_low", "ci_high", "n"]


def run(sessions, out, **changes):
    """A run of two levels, without pictures."""
    usual = {"preset": "smoke", "mechanisms": ("raw", "fixed:1"), "jobs": 1}
    settings = Settings(sessions=sessions, out=out, **(usual | changes))
    return evaluation.run(settings, progress=False, pictures=False)


@pytest.fixture(scope="module")
def sessions(tmp_path_factory):
    return write_sessions(tmp_path_factory.mktemp("sessions"))


@pytest.fixture(scope="module")
def made(sessions, tmp_path_factory):
    return run(sessions, tmp_path_factory.mktemp("returns") / "run")


@pytest.fixture(scope="module")
def study(sessions):
    """The same passages without error, from the library alone."""
    tracks = datasets.load(None, sessions=sessions).tracks
    walks = find_passages(placed(tracks, settings=Settings().stages))
    release = hide_frames(t=walks.t, xy=walks.xy, offsets=walks.offsets, seed=0)
    return study_returns(walks, release, enrolled=(None,))


def number(made, consumer, metric, *, mechanism="clean"):
    rows = made.summary[made.summary["mechanism"] == mechanism]
    rows = rows[(rows["consumer"] == consumer) & (rows["metric"] == metric)]
    (row,) = rows[ENDS].to_numpy()
    return row


def ends(estimate):
    return [estimate.value, estimate.ci_low, estimate.ci_high, estimate.n]


def test_rows_are_those_of_the_library(made, study):
    for (name, _), cell in study.cells.items():
        np.testing.assert_equal(
            number(made, f"returns/{name}", "rank1"), ends(cell.rank1)
        )
        assert number(made, f"returns/{name}", "chance")[0] == cell.chance
        assert number(made, f"returns/{name}", "rank1_gain")[0] == cell.gain.value
    for name, cell in study.controls.items():
        consumer = f"returns/control-{name.replace(' ', '-')}"
        np.testing.assert_equal(number(made, consumer, "rank1"), ends(cell.rank1))
    strongest = number(made, "returns/control-strongest", "rank1")
    np.testing.assert_equal(strongest, ends(study.primary.control))
    same_session = number(made, "returns/control-same-run", "rank1")
    np.testing.assert_equal(same_session, ends(study.same_session.rank1))
    nested_p = number(made, f"returns/{FUSION}", "nested_p")
    assert nested_p[0] == study.regression.p_value


def test_every_level_has_rows_and_none_stands_twice(made):
    assert not made.summary.duplicated(KEY).any()
    assert set(made.returns["mechanism"]) == {"clean", "raw", "fixed"}
    assert len(made.returns) == len(made.summary)
    raw = number(made, f"returns/{FUSION}", "rank1", mechanism="raw")
    assert raw[0] < number(made, f"returns/{FUSION}", "rank1")[0]
    assert set(made.returns.loc[made.returns["metric"] == "rank1", "unit"]) == {
        "fraction"
    }


def test_the_decision_is_that_of_the_rule(made, study):
    answer = json.loads((made.out / "verdict.json").read_text())["returns"]
    assert answer["decision"] == study.decision.decision == "not decided"
    assert answer["why"] == study.decision.why
    assert answer["n"] == study.decision.n < 20
    assert answer["n_needed"] == study.decision.n_needed
    assert answer["nested_p"] == study.regression.p_value
    assert answer["gain"] == study.primary.gain.value
    assert sum(answer["controls"].values()) == answer["n"]


def test_a_run_without_scenes_has_a_first_screen_that_says_so(made):
    lines = first_screen(made)
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    (left_out,) = [line for line in lines if line.startswith("Left out:")]
    assert "0 of 37 tracks last 21.6 s" in left_out
    text = " ".join(" ".join(lines).split())
    n = made.verdict["returns"]["n"]
    assert f"Return: With {n} people we cannot tell whether a walk identifies" in text
    assert re.search(r"are named first, guessing \d+ %, [\w ]+ \d+ %\.", text)
    assert "resample.min_duration_s=" in (made.out / "tables.txt").read_text()


def test_a_run_without_scenes_says_how_many_people_it_leaves_out(
    sessions, tmp_path, monkeypatch
):
    monkeypatch.setattr("evaluation.plan.plan.MOST_SCORES", 2000)
    settings = Settings(preset="smoke", sessions=sessions, out=tmp_path / "run")
    plan = make_plan(settings)
    assert plan.axes.why_no_scenes
    assert plan.passages.not_drawn > 0
    (notice,) = [
        text for text in plan_notices(plan, slow=()) if "people of task returns" in text
    ]
    assert notice.startswith(f"notice: left out: {plan.passages.not_drawn} people")


def test_workers_without_scenes_are_as_many_as_levels(sessions, tmp_path):
    settings = Settings(preset="smoke", sessions=sessions, out=tmp_path / "run")
    plan = make_plan(settings)
    assert most_workers(plan.axes, settings) == len(plan.units)


def test_the_page_has_sentence_figure_and_tables(made):
    figures = make_figures(made)
    (figure,) = [drawn for drawn in figures if drawn.name == "returns"]
    assert figure.caption == return_sentence(made)
    (_, chart), *_ = figure.panels
    assert [text for _, text in chart.y_ticks][:2] == [
        "no error at all",
        "raw positions",
    ]
    text = render(made, figures=figures).replace("\u00a0", " ")
    section = text[text.index('<section id="returns">') :]
    for part in (return_sentence(made), 'id="fig-returns"', "strongest control"):
        assert part in section
    assert '<section id="record">' not in text
    assert '<a href="#level">' not in text
    assert "8 people who come back, at 3 levels" in text


@pytest.mark.parametrize(
    ("decision", "says"),
    [
        ("yes", "A walk identifies a person in another run: of 30 people, 41 % ["),
        ("no", "A walk does not identify a person in another run: of 30 people,"),
        ("not decided", "With 30 people we cannot tell whether a walk identifies"),
    ],
)
def test_each_decision_has_its_sentence_with_guessing_and_control(made, decision, says):
    answer = made.verdict["returns"] | {
        "decision": decision,
        "n": 30,
        "rank1": 0.41,
        "control": 0.09,
        "rank1_low": 0.3,
        "rank1_high": 0.5,
        "chance": 0.033,
        "controls": {"neighbours": 30},
    }
    sentence = return_sentence(replace(made, verdict={"returns": answer}))
    assert sentence.startswith(says)
    assert sentence.endswith("are named first, guessing 3 %, neighbours 9 %.")


def test_rows_depend_neither_on_workers_nor_on_what_else_is_in_a_run(
    made, sessions, tmp_path
):
    scenes = {
        "preset": "quick",
        "jobs": 2,
        "mechanisms": ("fixed:1",),
        "predictors": ("least_squares",),
        "attacks": (),
        "policies": (),
        "scenes": 4,
        "stages": {"resample.min_duration_s": 4.0, "conflict.horizons_s": ()},
    }
    more = run(sessions, tmp_path / "more", **scenes)
    assert more.has_scenes
    assert (more.summary["metric"] == "missed_conflict_rate").any()
    known = made.returns[made.returns["mechanism"] != "raw"].reset_index(drop=True)
    pd.testing.assert_frame_equal(
        known, more.returns.reset_index(drop=True), check_exact=True
    )
    lines = first_screen(more)
    assert len(lines) <= 24
    assert any(line.startswith("Return: With") for line in lines)
    assert not any(line.startswith("Left out") for line in lines)
    page = render(more, figures=make_figures(more))
    assert "<h2>6 Does a walk identify a person in another run</h2>" in page
    assert page.index('<section id="returns">') < page.index('<section id="level">')


def test_two_people_and_mechanisms_that_withhold_samples_are_no_fault(tmp_path):
    few = write_sessions(tmp_path, sessions=((2, 1, 3.6), (2, 1, 4.5)), n_people=2)
    made = run(few, tmp_path / "run", mechanisms=("thin:20", "window:1"))
    assert not len(made.failed)
    assert set(made.returns["mechanism"]) == {"clean", "thin", "window"}
    ranks = made.returns.loc[made.returns["metric"] == "rank1", "value"]
    assert ranks.between(0.0, 1.0).all()
    assert made.verdict["returns"]["decision"] == "not decided"
    assert "2 people are too few" in made.verdict["returns"]["why"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--predictor", "kalman_cv"), "no track lasts 21.6 s"),
        (("--task", "+rerelease"), "no track lasts 21.6 s"),
        (("--scenes", "8"), "no track lasts 21.6 s"),
        (("--task", "returns", "--attack", "shape"), "task returns has gait, behav"),
        (("--confirming", "run4"), "no session is called 'run4'"),
        (("--confirming", "run1", "--task", "rerelease"), "--task +returns"),
    ],
)
def test_what_was_named_is_never_left_out_silently(sessions, capsys, words, says):
    named = [word for path in sessions for word in ("--session", path)]
    assert matrix.main([*named, *words, "--dry-run"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert says in line


def test_scenes_of_fewer_people_than_decide_are_made_only_if_named(sessions, capsys):
    named = [word for path in sessions for word in ("--session", path)]
    few = [*named, "--set", "resample.min_duration_s=5.5", "--dry-run"]
    assert matrix.main(few) == 0
    said = " ".join(capsys.readouterr().err.split())
    n_long = int(re.search(r"linkage; (\d+) of 37 tracks last 5.5 s", said)[1])
    assert 4 <= n_long < 20
    assert matrix.main([*few, "--scenes", "8"]) == 0
    said = capsys.readouterr().err
    assert f"{n_long} of 37 tracks used, 8 scenes" in said
    assert "other linkage" not in said


def test_a_linker_of_the_fusion_may_be_named(sessions, capsys):
    named = [word for path in sessions for word in ("--session", path)]
    words = [*named, "--task", "returns", "--attack", "gait", "--dry-run"]
    assert matrix.main(words) == 0
    said = capsys.readouterr().err
    assert "37 of 37 passages used; 10 cells" in said
    assert "left out: scenes, patrols and other linkage; 0 of 37 tracks" in said
    assert tuple(LINKERS) == FUSED


def test_a_recording_of_nobody_who_comes_back_is_refused_by_name(sessions, capsys):
    first = ["--dataset", sessions[0]]
    assert matrix.main([*first, "--task", "returns", "--dry-run"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "task returns: returning people need a person and a session" in line
    assert "a column person" in line


def write_text(path, labels, *, rate=10, second_begins=0):
    """Write a run of PedPy text with passages 1 and 2, of 6 s each."""
    rows = [
        f"{number} {begin + frame} {0.1 * frame:.1f} {number} 1.7"
        for number, begin in ((1, 0), (2, second_begins))
        for frame in range(6 * rate)
    ]
    lines = [f"# framerate: {rate}", *labels, "# id frame x y z", *rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("labels", "rate", "says"),
    [
        (["# 1 M 1", "# 9 F 2"], 10, ["line 3", "passage 9", "no rows", "remove"]),
        (["# 1 M 1", "# 2 M 1"], 10, ["person M1", "two places at once", "correct"]),
        (["# 1 M 1", "# 2 F 2"], 25, ["every 0.1 and 0.04 s", "resample one"]),
    ],
    ids=["a label without a passage", "a person twice at once", "other rates"],
)
def test_faulty_labels_and_rates_end_in_a_line(tmp_path, capsys, labels, rate, says):
    write_text(tmp_path / "a.txt", ["# 1 M 1", "# 2 F 2"])
    write_text(tmp_path / "b.txt", labels, rate=rate)
    words = ["--format", "pedpy", "--out", tmp_path / "run"]
    words += ["--session", tmp_path / "a.txt", "--session", tmp_path / "b.txt"]
    assert matrix.main([*map(str, words)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert [text for text in says if text not in line] == []
    assert not (tmp_path / "run").exists()


def test_sessions_that_name_nobody_say_how_people_are_named(tmp_path, capsys):
    write_text(tmp_path / "a.txt", [])
    write_text(tmp_path / "b.txt", [], second_begins=5)
    words = ["--session", tmp_path / "a.txt", "--session", tmp_path / "b.txt"]
    words += ["--format", "pedpy", "--out", tmp_path / "run"]
    for task in ("returns", "cross_session"):
        own = [*words, "--task", task, "--set", "resample.min_duration_s=3"]
        assert matrix.main([*map(str, own)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        for text in (f"task {task}", "column person", "# 14 M 17", "--persistent-ids"):
            assert text in line


def test_two_runs_are_compared_in_their_links_and_in_their_decision(made, sessions):
    other = run(sessions, made.out.parent / "reseeded", seed=1)
    result = compare(made.out, other.out)
    rows = result.rows.set_index(["mechanism", "consumer", "metric"])
    fusion = rows.loc[("fixed", f"returns/{FUSION}", "rank1")]
    before, after = (
        number(each, f"returns/{FUSION}", "rank1", mechanism="fixed")
        for each in (made, other)
    )
    assert fusion["difference"] == pytest.approx(after[0] - before[0])
    # So few people have no interval.
    assert fusion["finding"] == "untested"
    assert fusion["headline"]
    # No draw touches the passages without error.
    assert rows.loc[("clean", f"returns/{FUSION}", "rank1"), "finding"] == "identical"
    assert result.verdicts["in_both"] == 1
    assert result.verdicts["changed"] == []
