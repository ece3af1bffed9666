"""As many scenes as a half-width takes: found by a pilot, told, kept; or refused."""

import json
import math

import pandas as pd
import pytest
from helpers.commands import assert_refused

import evaluation
from evaluation import matrix
from evaluation.api import sized
from isac_track.errors import SettingsError

pytestmark = pytest.mark.usefixtures("cut_once")

FEW = {
    "preset": "smoke",
    "dataset": "plaza",
    "mechanisms": ["raw", "fixed:1"],
    "attacks": [],
}
LITTLE = FEW | {"predictors": ["constant_position"], "tasks": [], "jobs": 1}
QUIET = {"progress": False, "pictures": False}


@pytest.fixture(scope="module")
def precise(tmp_path_factory):
    out = tmp_path_factory.mktemp("precise") / "run"
    return evaluation.run(**LITTLE, precision=0.05, out=out, **QUIET), out


def test_the_number_of_scenes_follows_from_the_widest_interval_of_the_pilot(precise):
    results, out = precise
    pilot = pd.read_csv(out.with_name("run-pilot") / "summary.csv")
    missed = pilot[pilot["metric"] == "missed_conflict_rate"]
    half = ((missed["ci_high"] - missed["ci_low"]) / 2).max()
    said = json.loads((out / "manifest.json").read_text())["settings"]
    assert said["precision"] == 0.05
    assert said["pilot_half_width"] == pytest.approx(half)
    assert said["scenes_utility"] == 250 * math.ceil((half / 0.05) ** 2) > 250
    assert said["scenes"] == 40  # what is attacked stays the preset's
    reached = results.summary[results.summary["metric"] == "missed_conflict_rate"]
    assert ((reached["ci_high"] - reached["ci_low"]) / 2).max() < 1.5 * 0.05


def test_a_finished_pilot_is_read_and_says_the_same(precise):
    results, out = precise
    before = (out.with_name("run-pilot") / "manifest.json").stat().st_mtime_ns
    again = evaluation.run(**LITTLE, precision=0.05, out=out, **QUIET)
    assert (out.with_name("run-pilot") / "manifest.json").stat().st_mtime_ns == before
    pd.testing.assert_frame_equal(again.summary, results.summary)


def test_a_precision_that_250_scenes_reach_takes_250(precise):
    _, out = precise
    asked = evaluation.Settings(**LITTLE, precision=0.4, out=out)
    assert sized(asked, progress=lambda *_: None).n_all_scenes == 250


def test_the_pilot_of_a_run_with_further_adversaries_is_that_of_one_without(precise):
    results, out = precise
    asked = LITTLE | {"attacks": ["ou_rts"], "adversaries": ["repeats"]}
    settings = evaluation.Settings(**asked, precision=0.05, out=out)
    read = sized(settings, progress=lambda *_: None)
    said = results.manifest["settings"]
    assert read.n_all_scenes == said["scenes_utility"]
    assert read.pilot_half_width == said["pilot_half_width"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--precision", "0"], "between 0 and 0.5"),
        (["--precision", "nan"], "between 0 and 0.5"),
        (["--precision", "0.01", "--scenes", "40"], "leave out --scenes"),
        (["--precision", "0.1", "--predictor", "none"], "add --predictor"),
        (["--precision", "0.1", "--dry-run"], "leave out --dry-run"),
    ],
)
def test_what_cannot_be_is_one_line_and_exit_2(options, says, tmp_path, ran):
    few = "--preset smoke --mechanism raw --attack none --task none --out"
    assert_refused(ran(matrix, *options, *few.split(), tmp_path / "run"), says)


def test_more_scenes_than_a_run_takes_are_refused(precise):
    asked = evaluation.Settings(**LITTLE, precision=1e-5, out=precise[1])
    with pytest.raises(SettingsError, match="a run has at most 10,000,000"):
        sized(asked, progress=lambda *_: None)
