"""Stronger adversaries try the levels that would be proposed, after all other cells."""

from dataclasses import replace

import pandas as pd
import pytest
from helpers.small_runs import single_process, smoke, write_walks

import evaluation
from attacks.reconstruction.ou_rts import OuRTS
from evaluation.plan.presets import PRESETS, STRONGER_ADVERSARIES
from evaluation.pool.execute import FailedCellsWarning
from evaluation.reporting.notices import notices
from evaluation.store.files import CELLS_FOLDER
from evaluation.store.manifest import read_manifest
from isac_track.types import Knowledge

LEVELS = ("raw", "ou:0.4", "ou:0.8", "offset:0.3")
HORIZON = {"conflict.horizons_s": (3.0,)}
KEYS = ["dataset", "mechanism", "level", "consumer", "knowledge", "metric"]


def asked(walks, out, **changes):
    usual = {
        "mechanisms": LEVELS,
        "predictors": ("kalman_cv",),
        "attacks": None,
        "tasks": None,
    }
    return smoke(walks, out, stages=HORIZON, **usual | changes)


def plainly(frame, *, without=()):
    """Rows in an order of their own; those of some adversaries left out."""
    rows = frame[~frame["knowledge"].isin(without)]
    return rows.sort_values(KEYS, ignore_index=True)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder, walks, and the results of three runs: with, without, and continued."""
    folder = tmp_path_factory.mktemp("candidates")
    walks = write_walks(folder / "walks.csv", n_people=40)
    few = {"attacks": ("radial_rts", "kinematic"), "tasks": ("handover-1s",)}
    without, tried = (
        replace(PRESETS["smoke"], stronger_adversaries=some, **few)
        for some in ((), STRONGER_ADVERSARIES)
    )
    result = {}
    with single_process(), pytest.MonkeyPatch.context() as patch:
        for name, preset, out in (
            ("tried", tried, "tried"),
            ("plain", without, "plain"),
            ("continued", tried, "plain"),
        ):
            patch.setitem(PRESETS, "smoke", preset)
            result[name] = evaluation.run(asked(walks, folder / out), pictures=False)
        files = {
            path.name: path.read_bytes()
            for path in (folder / "tried" / CELLS_FOLDER).iterdir()
        }
        result["again"] = evaluation.run(asked(walks, folder / "tried"), pictures=False)
        after = {
            path.name: path.read_bytes()
            for path in (folder / "tried" / CELLS_FOLDER).iterdir()
        }
        named = {
            "attacks": ("ou_rts",),
            "tasks": (),
            "adversaries": STRONGER_ADVERSARIES,
        }
        result["named"] = evaluation.run(
            asked(walks, folder / "named", **named), pictures=False
        )
    return folder, result, (files, after)


def test_only_candidates_are_tried_and_only_by_those_who_know_more(made):
    _, results, _ = made
    summary = results["tried"].summary
    tried = summary[summary["consumer"] == "ou_rts"]
    assert set(tried["knowledge"]) == set(STRONGER_ADVERSARIES)
    answer = results["plain"].recommendation()
    expected = {offer.mechanism_level for offer in answer.candidates}
    assert 1 <= len(expected) <= 5
    assert set(zip(tried["mechanism"], tried["level"], strict=True)) == expected
    assert "offset" not in {name for name, _ in expected}


def test_no_other_number_changes(made):
    _, results, _ = made
    with_trial = plainly(results["tried"].summary, without=STRONGER_ADVERSARIES)
    pd.testing.assert_frame_equal(with_trial, plainly(results["plain"].summary))


def test_it_is_the_same_whether_at_once_or_later_or_again(made):
    folder, results, (files, after) = made
    for other in ("continued", "again"):
        pd.testing.assert_frame_equal(results[other].summary, results["tried"].summary)
        pd.testing.assert_frame_equal(results[other].levels, results["tried"].levels)
    assert files == after  # Nothing was computed twice.
    manifests = [read_manifest(folder / name) for name in ("tried", "plain")]
    assert manifests[0]["cells"] == manifests[1]["cells"]
    assert {manifest["state"] for manifest in manifests} == {"finished"}


def test_it_is_what_naming_the_adversaries_computes(made):
    _, results, _ = made
    tried, named = (
        results[name]
        .summary[results[name].summary["knowledge"].isin(STRONGER_ADVERSARIES)]
        .set_index(KEYS)
        for name in ("tried", "named")
    )
    pd.testing.assert_frame_equal(tried, named.loc[tried.index])


def test_what_a_run_is_said_to_be_stays(made):
    folder, _, _ = made
    tried, plain = (read_manifest(folder / name) for name in ("tried", "plain"))
    assert tried["settings"] == plain["settings"]
    assert tried["settings"]["mechanisms"] == list(LEVELS)
    assert "adversaries" not in tried["settings"]


EDITED_MECHANISM = """
from isac_track.mechanisms.protections import Ou


class Mine(Ou):
    def share(self, sensed, rng):
        with open(__file__, "a") as source:  # As an editor does during a run.
            source.write("# edited\\n")
        return Ou.share(self, sensed, rng)
"""


def test_an_edit_during_the_run_loses_no_cell(tmp_path, monkeypatch):
    source = tmp_path / "edited_while_running.py"
    source.write_text(EDITED_MECHANISM)
    monkeypatch.syspath_prepend(str(tmp_path))
    walks = write_walks(tmp_path / "walks.csv", n_people=40)
    levels = ("raw", "ou:0.8", "edited_while_running:Mine:0.8")
    few = {"attacks": ("radial_rts", "kinematic"), "tasks": ("handover-1s",)}
    preset = replace(PRESETS["smoke"], stronger_adversaries=STRONGER_ADVERSARIES, **few)
    monkeypatch.setitem(PRESETS, "smoke", preset)
    settings = asked(walks, tmp_path / "run", mechanisms=levels)
    with single_process():
        results = evaluation.run(settings, pictures=False)
    manifest = results.manifest
    assert "edited_while_running" in manifest["edited_modules"]
    assert not manifest.get("dropped_cells")
    mine = results.summary[results.summary["mechanism"].str.startswith("edited")]
    assert set(mine["consumer"]) >= {"shared", "kalman_cv", "radial_rts"}
    assert not set(results.summary["knowledge"]) & set(STRONGER_ADVERSARIES)
    (notice,) = [text for text in notices(manifest) if "edited while" in text]
    assert "1 module was edited" in notice


def test_the_warning_of_a_failure_names_the_line_that_started_the_run(
    tmp_path, monkeypatch
):
    fit = OuRTS.fit

    def fit_without_repeats(attack, context):
        if Knowledge.REPEATS in context.granted:
            raise RuntimeError("no luck")
        return fit(attack, context)

    monkeypatch.setattr(OuRTS, "fit", fit_without_repeats)
    few = {"attacks": ("radial_rts", "kinematic"), "tasks": ("handover-1s",)}
    preset = replace(PRESETS["smoke"], stronger_adversaries=("repeats",), **few)
    monkeypatch.setitem(PRESETS, "smoke", preset)
    walks = write_walks(tmp_path / "walks.csv", n_people=40)
    with single_process(), pytest.warns(FailedCellsWarning, match="no luck") as caught:
        evaluation.run(asked(walks, tmp_path / "run"), pictures=False)
    assert [warning.filename for warning in caught] == [__file__]


def test_each_says_who_breaks_it(made):
    _, results, _ = made
    for offer in results["tried"].recommendation().candidates:
        sides = {side.adversary: side.breaks(0.5) for side in offer.beyond}
        assert {name for name, breaks in sides.items() if breaks is None} == {
            "companions",
            "insider",
        }
