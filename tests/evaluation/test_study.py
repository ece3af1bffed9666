"""Several runs, one answer: table and page, runs read again, and refusals."""

import math

import pandas as pd
import pytest
from helpers.commands import assert_refused
from helpers.small_runs import without_pictures, write_walks

from evaluation import study
from evaluation.api import study as answer
from evaluation.estimates import pooled
from evaluation.plan.settings import Settings
from evaluation.reporting import study_page
from evaluation.store.manifest import read_manifest
from isac_track import datasets
from isac_track.config import StageSettings
from isac_track.datasets import load

pytestmark = pytest.mark.usefixtures("cut_once")

LITTLE = {
    "preset": "smoke",
    "dataset": "plaza",
    "mechanisms": ["raw", "fid:1"],
    "predictors": ["least_squares"],
    "attacks": ["radial_rts", "likelihood_ratio"],
    "tasks": ["rerelease"],
    "stages": StageSettings().changed({"linkage.most_people": 60}),
    "jobs": 1,
}
COLUMNS = (
    "question,recording,adding,law,seed,value,ci_low,ci_high,n,tau2,settings,distance_m"
)


@pytest.fixture(scope="module")
def answered(tmp_path_factory):
    out = tmp_path_factory.mktemp("study")
    asked = [
        ("radial", Settings(**LITTLE, seed=seed, out=out / f"plaza-{seed}"))
        for seed in (0, 1)
    ]
    with without_pictures():
        return *answer(asked, out=out), out, asked


def test_the_table_has_a_row_a_seed_and_their_mean_and_pools_nothing_simulated(
    answered,
):
    _, n_failed, out, _ = answered
    table = pd.read_csv(out / "study.csv", dtype={"seed": str})
    assert n_failed == 0
    assert ",".join(table.columns) == COLUMNS
    assert set(table["recording"]) == {
        "plaza"
    }  # never pooled: it is simulated, and one
    message = table[
        (table["question"] == "left_after_attack") & (table["adding"] == "linear")
    ]
    assert list(message["seed"]) == ["0", "1", "mean"]
    values = message.set_index("seed")["value"]
    assert values["mean"] == pytest.approx((values["0"] + values["1"]) / 2)
    assert {"robot_loses", "left_after_attack"} <= set(table["question"])
    assert set(table["settings"]) == {"linkage.most_people=60"}
    page = (out / "study.html").read_text()
    (distance_m,) = set(table["distance_m"])
    assert "Settings: linkage.most_people=60." in page
    assert f"Median distance to the base station: plaza {distance_m:.0f} m." in page


def test_future_conflicts_are_those_of_the_robot_3_s_ahead(answered):
    _, _, out, _ = answered
    table = pd.read_csv(out / "study.csv", dtype={"seed": str})
    asked = table["question"] == "robot_loses_future"
    (row,) = table[
        asked & (table["adding"] == "linear") & (table["seed"] == "0")
    ].itertuples()
    summary = pd.read_csv(out / "plaza-0" / "summary.csv")
    ahead = summary[
        (summary["dataset"] == "plaza:horizon=3s")
        & (summary["metric"] == "missed_future_rate")
        & (summary["consumer"] == "least_squares")
    ].set_index("mechanism")["value"]
    assert row.value == pytest.approx(ahead["fid"] - ahead["raw"])


def test_who_has_fewer_than_100_candidates_is_compared_with_nobody(answered):
    answers, _, out, _ = answered
    (name,) = {
        item for item in pd.read_csv(out / "study.csv")["question"] if "linked" in item
    }
    assert name == "people_linked_own_gallery"
    rows = [
        {**answers[0].rows[0], "question": name, "recording": item} for item in "abcde"
    ]
    rows[0] |= {"ci_low": math.nan, "ci_high": math.nan}
    (answer,) = pooled.answered(rows, simulated=frozenset())
    page = study_page.render([answer], simulated=frozenset(), runs=[])
    assert page.count("too few people for an interval") == 1
    assert (answer.pooled, answer.sentence[:12]) == (None, "Neither comp")


@pytest.mark.usefixtures("undrawn")
def test_what_is_finished_is_read_again(answered, capsys, monkeypatch):
    answers, _, out, asked = answered
    read = []
    monkeypatch.setattr(
        datasets,
        "load",
        lambda *name, **answers: read.append(name) or load(*name, **answers),
    )
    before = (out / "study.csv").read_bytes()
    cells = {path: path.stat().st_mtime_ns for path in out.glob("*/cells/*")}
    again, _ = answer(asked, out=out)
    assert capsys.readouterr().err.count("finished before") == len(asked)
    assert len(read) == 1  # the recording, once for all runs
    assert [item.sentence for item in again] == [item.sentence for item in answers]
    assert (out / "study.csv").read_bytes() == before
    assert {path: path.stat().st_mtime_ns for path in out.glob("*/cells/*")} == cells


def test_what_fid_is_held_against_fixed_noise_by_is_no_other_mechanism(answered):
    _, _, out, _ = answered
    result = {
        "section": "claim",
        "criterion": "missed",
        "of": "after-attack",
        "descriptor": "plr",
    }
    result |= {"adding": "linear", "ci_low": 0.01, "ci_high": 0.03, "n": 50}
    items = [result | {"effect": 0.02}, result | {"effect": -0.4, "mechanism": "ou"}]
    folder = out / "plaza-0"
    message = pooled.run_answers(
        folder, read_manifest(folder), {"items": items}, law="radial"
    )
    assert [
        item["value"] for item in message if item["question"] == "fid_against_fixed"
    ] == [0.02]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--dataset", "plazza"], "plazza"),
        (["--dataset", "plaza", "--law", "round"], "round"),
        (["--dataset", "plaza", "--seed", "-1"], "must not be negative"),
        (["--dataset", "plaza", "--jobs", "0"], "at least 1"),
        (["--dataset", "plaza", "--set", "sensing.bs_x_m"], "STAGE.KEY=VALUE"),
        (["--dataset", "plaza", "--set", "sensing.bs_z_m=3"], "unknown setting"),
        (["--dataset", "plaza", "--set", "sensing.law=radial"], "--law"),
        ([], "--dataset"),
    ],
)
def test_a_mistake_is_told_before_anything_runs(options, says, tmp_path, ran):
    assert_refused(
        ran(study, *options, "--preset", "smoke", "--out", tmp_path / "study"), says
    )
    assert not (tmp_path / "study").exists()


def test_the_same_bytes_twice_are_one_recording(tmp_path, ran):
    write_walks(tmp_path / "monday.csv", n_people=24)
    (tmp_path / "copy.csv").write_bytes((tmp_path / "monday.csv").read_bytes())
    names = [tmp_path / name for name in ("monday.csv", "copy.csv")]
    words = [word for path in names for word in ("--dataset", path)]
    ended = ran(study, *words, "--preset", "smoke", "--out", tmp_path / "out")
    assert_refused(ended, "hold the same bytes", "leave out one")
    assert not (tmp_path / "out").exists()
