"""A run in a notebook: options, read from its tables, as frames and plots."""

import io
import re
import shutil
from contextlib import redirect_stderr
from dataclasses import replace
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from helpers.commands import run
from helpers.small_runs import write_walks

import evaluation
from evaluation.api import rebuild
from evaluation.store.files import FRAMES
from isac_track.errors import DataError, SettingsError

MECHANISMS = ["raw", "fid:1", "fixed:0.7", "fixed:1", "fid:1,adding=independent"]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A small run, its printed text, and the same run read again."""
    folder = tmp_path_factory.mktemp("notebook")
    said = io.StringIO()
    with redirect_stderr(said):
        run = evaluation.run(
            evaluation.Settings(preset="smoke", tasks=("rerelease",)),
            dataset=write_walks(folder / "walks.csv"),
            scenes=np.int64(20),
            mechanisms=MECHANISMS,
            predictors=["least_squares", "kalman_cv"],
            attacks=["identity", "kalman_rts", "savgol", "shape"],
            stages={"privacy.epsilon_m": 0.4},
            out=folder / "run",
            pictures=False,
        )
    return SimpleNamespace(
        run=run, said=said.getvalue(), loaded=evaluation.load(folder / "run")
    )


def test_a_run_takes_options_over_settings_and_says_what_it_is_about(made):
    manifest = made.run.manifest
    assert manifest["identity"]["scenes"] == 20
    assert manifest["identity"]["privacy.epsilon_m"] == 0.4
    assert manifest["settings"]["tasks"] == ["rerelease"]
    assert made.said.startswith("walks: 30 of 30 tracks used, 20 scenes;")
    assert "all cells after" in made.said


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mechanisms": "raw"}, "write mechanisms=['raw']"),
        ({"predictors": "none"}, "write predictors=["),
        ({"tasks": ["none"]}, "write tasks=[]"),
        ({"attacks": 3}, "attacks takes a list"),
        ({"scenes": "40"}, "scenes must be a whole number, as scenes=40; got '40'"),
        ({"seed": True}, "seed must be a whole number"),
        ({"fps": "25"}, "fps must be a number"),
        ({"preset": ["smoke"]}, "preset must be text"),
        ({"out": 3}, "out must be the path of a folder"),
        ({"scene": 40}, "did you mean 'scenes'?"),
        ({"mechanisms": ["rw"]}, "did you mean 'raw'?"),
        ({"stages": {"privacy.epsilon": 1}}, "did you mean privacy.epsilon_m?"),
        ({"plan": object(), "scenes": 40}, "leave out all others"),
    ],
)
def test_wrong_options_are_refused_as_on_the_command_line(options, message):
    with pytest.raises(SettingsError, match=re.escape(message)):
        evaluation.run(**options)


def test_the_earlier_name_of_a_plan_warns_and_still_works():
    with (
        pytest.warns(FutureWarning, match="plan= for ready="),
        pytest.raises(SettingsError, match="leave out all others"),
    ):
        evaluation.run(ready=object(), scenes=40)


def test_a_run_is_read_as_it_was_returned(made):
    for name in FRAMES:
        frame, read = getattr(made.run, name), getattr(made.loaded, name)
        frame = frame.reset_index(drop=True).convert_dtypes()
        if name == "linkability":  # A cohort has no outcome: it is empty in a file.
            frame["outcome"] = frame["outcome"].fillna("")
        frame = frame.dropna(axis="columns", how="all")
        read = read.dropna(axis="columns", how="all")
        pd.testing.assert_frame_equal(
            read.convert_dtypes(), frame, check_dtype=bool(len(frame))
        )
    for name in ("manifest", "verdict", "strongest"):
        assert getattr(made.loaded, name) == getattr(made.run, name)
    assert [*made.loaded.flags] == [*made.run.flags]


def test_reading_writes_nothing_and_imports_nothing_slow(made):
    before = {path: path.stat().st_mtime_ns for path in made.run.out.rglob("*")}
    slow = "{'numba', 'scipy', 'sklearn', 'matplotlib', 'jinja2', 'rich'}"
    code = (
        f"import evaluation, sys; evaluation.load('run'); print({slow} &"
        " set(sys.modules))"
    )
    assert run(made.run.out.parent, "-c", code).out == "set()\n"
    assert {path: path.stat().st_mtime_ns for path in made.run.out.rglob("*")} == before


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda out: (out / "manifest.json").unlink(), "holds no run"),
        (
            lambda out: (out / "frontier.csv").unlink(),
            "frontier.csv is missing; python -m evalua",
        ),
        (lambda out: (out / "summary.csv").write_text(""), "cannot be read"),
        (lambda out: (out / "verdict.json").write_text("{"), "cannot be read"),
    ],
)
def test_a_missing_table_has_a_way_out(made, tmp_path, spoil, message):
    out = shutil.copytree(made.run.out, tmp_path / "run")
    spoil(out)
    with pytest.raises(DataError, match=re.escape(message)):
        evaluation.load(out)
    if message != "holds no run":
        rebuild(out)
        assert evaluation.load(out).verdict == made.run.verdict


CSV = {"metric": "plr", "consumer": "shared"}


@pytest.mark.parametrize(
    ("asked", "rows", "attack"),
    [
        ({"metric": "plr"}, CSV, ""),
        ({"metric": "plr", "after": "savgol"}, CSV | {"consumer": "savgol"}, "savgol"),
        (
            {"metric": "rmse", "after": "identity"},
            {"metric": "rmse", "consumer": "identity"},
            None,
        ),
        (
            {"metric": "missed"},
            {"metric": "missed_conflict_rate", "consumer": "least_squares"},
            "",
        ),
        (
            {"metric": "false_alarm", "robot": "kalman_cv"},
            {"metric": "false_alarm_rate", "consumer": "kalman_cv"},
            "",
        ),
        (
            {"metric": "rank1", "after": "shape"},
            {"metric": "rank1", "consumer": "rerelease/shape"},
            "shape",
        ),
    ],
)
def test_a_frame_has_the_rows_of_the_summary(made, asked, rows, attack):
    frame = made.loaded.frame(**asked)
    names = [
        "family",
        "level",
        "adding",
        "attack",
        "knowledge",
        "value",
        "ci_low",
        "ci_high",
    ]
    assert [*frame] == names
    summary = pd.read_csv(
        made.run.out / "summary.csv", keep_default_na=False, na_values=[""]
    )
    rows = rows | {"dataset": made.run.dataset}  # not those of a further horizon
    want = summary.query(
        " and ".join(f"{name} == {value!r}" for name, value in rows.items())
    )
    assert [*frame["value"]] == [*want["value"]]
    assert [*frame["family"]] == [*want["family"]]
    raw = frame[frame["family"] == "raw"]
    assert set(raw["level"]) == {0.0}
    assert [*frame.query("family != 'raw'")["level"]] == [
        *want.query("family != 'raw'")["level"].fillna(0)
    ]
    if attack is not None:
        assert set(frame["attack"]) == {attack}


def test_the_strongest_attack_is_the_verdicts(made):
    best = made.run.strongest[""]
    frame = made.loaded.frame("plr", after="strongest")
    assert set(frame["attack"] + frame["knowledge"]) == {best.consumer + best.adversary}
    every = made.loaded.frame("plr", after=best.consumer)
    assert len(frame) == len(MECHANISMS) < len(every)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"metric": "plrr"}, "did you mean 'plr'?"),
        ({"metric": "plr", "after": "dtw"}, "it has that of shared, identity"),
        ({"metric": "rank1", "task": "split"}, "nobody in this task"),
        (
            {"metric": "missed", "robot": "mine"},
            "it has that of least_squares, kalman_cv",
        ),
    ],
)
def test_a_frame_that_the_run_lacks_is_refused_with_those_that_it_has(
    made, asked, message
):
    with pytest.raises(SettingsError, match=re.escape(message)):
        made.loaded.frame(**asked)


def test_a_plot_has_units_and_a_line_with_intervals_for_each_family_and_rule(made):
    axes = made.loaded.plot(x="missed", y="plr_after")
    best = made.run.strongest[""]
    assert axes.get_xlabel() == "missed (%), least_squares"
    assert axes.get_ylabel() == f"PLR (%), after {best.label}"
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == ["raw", "fid linear", "fixed linear", "fid independent"]
    line, _, bars = axes.containers[names.index("fixed linear")]
    frames = [made.loaded.frame("missed"), made.loaded.frame("plr", after="strongest")]
    points = [
        100 * frame.query("family == 'fixed'")["value"].to_numpy() for frame in frames
    ]
    assert np.array(line.get_data()) == pytest.approx(np.array(points))
    assert len(bars) == 2
    marks = [bar[0] for bar in axes.containers]
    shapes = [mark.get_marker() for mark in marks]
    are_hollow = [mark.get_markerfacecolor() == "none" for mark in marks]
    assert shapes == ["*", "o", "s", "o"]
    assert are_hollow == [False, False, False, True]
    again = made.loaded.plot(x="level", y="rank1", ax=axes)
    assert again is axes
    assert axes.get_xscale() == "log"
    # The intervals of raw, and of clean.
    assert [patch.get_alpha() for patch in axes.patches] == [0.1, 0.1]
    assert "d_sigma in m" in axes.get_xlabel()
    plt.close(axes.figure)


def test_its_line_says_how_many_scenes_are_attacked_and_how_many_the_robots_have(made):
    identity = made.run.manifest["identity"] | {"scenes": 500, "scenes_utility": 2000}
    run = replace(made.run, manifest=made.run.manifest | {"identity": identity})
    assert "2,000 scenes, 500 of them attacked, seed 0" in repr(run)
