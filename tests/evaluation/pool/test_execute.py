"""Runs: their files, how they continue, what they refuse, what numbers depend on."""

import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers.cells import World, parsed
from helpers.recordings import write_csv
from helpers.runs import change_code, stored_consumers, stored_rows
from helpers.small_runs import smoke

import evaluation
from evaluation.estimates import summary
from evaluation.plan.consumer import Consumer
from evaluation.plan.plan import make_plan
from evaluation.plan.presets import DEFAULT, PRESETS
from evaluation.plan.settings import Settings
from evaluation.pool.execute import FailedCellsWarning
from evaluation.store.manifest import read_manifest
from isac_track.config import StageSettings
from isac_track.errors import DataError, PluginError, SettingsError

SPECS = ("raw", "fid:1000", "fixed:0.7")
KEY = ["dataset", "mechanism", "level", "consumer", "knowledge", "metric"]


def run_settings(dataset, out):
    return smoke(dataset, out, mechanisms=SPECS)


@pytest.fixture
def settings(csv_recording, tmp_path):
    return run_settings(csv_recording, tmp_path / "run")


@pytest.fixture(scope="module")
def drawn(tracks, tmp_path_factory):
    """A run with pictures, as it was left."""
    folder = tmp_path_factory.mktemp("drawn")
    return evaluation.run(
        run_settings(write_csv(folder / "walks.csv", tracks), folder / "run")
    )


@pytest.fixture
def finished(drawn, settings):
    """The settings of that run, and a copy of its folder."""
    shutil.copytree(drawn.out, settings.out)
    return settings


def run(settings, **changes):
    return evaluation.run(replace(settings, **changes), pictures=False)


def stamps(out):
    return {path: path.stat().st_mtime_ns for path in (out / "cells").iterdir()}


def assert_unchanged(before):
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in before.items())


def computed(tracks, *, spec="fid:100", stages=None, seed=0, predictor="least_squares"):
    """Rows of one block of 12 scenes: descriptors, then forecasts."""
    world = World(tracks, n_scenes=12, stages=stages or StageSettings(), seed=seed)
    consumers = (
        Consumer("shared"),
        Consumer("predictor", parsed("predictors", predictor)),
    )
    return [rows for *_, rows in world.cells([spec], consumers)]


@pytest.fixture(scope="module")
def usual(tracks):
    return computed(tracks)


def same(a, b):
    return all(
        np.array_equal(
            first[name], other[name], equal_nan=first[name].dtype.kind == "f"
        )
        for first, other in zip(a, b, strict=True)
        for name in first
    )


# min_duration_s chooses tracks, a decision by probability needs a covariance, and no
# spline of these tracks overshoots: all three have tests of their own. So have antennas,
# which measure bearings alone (tests/isac_track/test_measurement.py). What is linked
# passes through no scene: tests/attacks/tasks/test_build.py; nor do patrols and tracks:
# tests/isac_track/patrols/test_patrol.py, tests/evaluation/compute/test_tracking.py.
ELSEWHERE = (
    "resample.min_duration_s",
    "resample.max_overshoot_m",
    "conflict.decision",
    "conflict.probability_threshold",
    "attacks.repeats",
    "sensing.n_antennas",
)
CHANGES = {
    name: 0.8 * value if isinstance(value, float) else value - 1
    for name, value in StageSettings().flat().items()
    if name not in ELSEWHERE
    and not name.startswith(("linkage.", "patrol.", "tracking."))
    and not isinstance(value, str)
} | {"scenes.clearance_m": 2.5, "scenes.max_redraws": 1, "sensing.law": "isotropic"}


@pytest.mark.parametrize("name", CHANGES)
def test_every_setting_changes_the_result(tracks, usual, name):
    changed = StageSettings().changed({name: CHANGES[name]})
    assert not same(usual, computed(tracks, stages=changed))


def test_the_fixed_error_the_window_and_the_seed_change_the_result(tracks):
    fixed = computed(tracks, spec="fixed:0.5")
    assert not same(fixed, computed(tracks, spec="fixed:0.6"))
    assert not same(
        fixed, computed(tracks, spec="fixed:0.5", predictor="least_squares:8")
    )
    assert not same(fixed, computed(tracks, spec="fixed:0.5", seed=1))
    assert same(fixed, computed(tracks, spec="fixed:0.5"))


class TestWhatARunLeaves:
    def test_is_what_the_design_says(self, drawn):
        for name in ("manifest.json", "summary.csv", "paper_table.csv"):
            assert (drawn.out / name).is_file()
        # All levels of the block: the descriptors as shared and the predictor.
        (held,) = stored_consumers(drawn.out).values()
        assert held == {spec: {"shared", "least_squares"} for spec in SPECS}
        for name, kind in (
            ("cells", ".parquet"),
            ("figures", ".svg"),
            ("tables", ".tex"),
        ):
            assert {path.suffix for path in (drawn.out / name).iterdir()} == {kind}
        assert list(drawn.summary.columns) == [
            "dataset",
            "mechanism",
            "level",
            "consumer",
            "knowledge",
            "metric",
            "value",
            "ci_low",
            "ci_high",
            "n",
            "unit",
            "family",
            "adding",
            "policy",
        ]
        assert list(drawn.paper_table.columns) == [
            "mechanism",
            "level",
            "metric",
            "paper",
            "ours",
            "ci_low",
            "ci_high",
            "within",
        ]
        assert not drawn.summary.duplicated(KEY).any()
        assert set(drawn.summary["metric"]) == {
            "missed_conflict_rate",
            "missed_future_rate",
            "false_alarm_rate",
            "distance_mae",
            "plr",
            "ael",
            "mel",
            "plr_worst_tenth",
            "rmse",
            "plr_wide",
            "median_error",
        }
        assert set(drawn.summary["unit"]) == {"fraction", "s", "m"}
        assert set(drawn.summary["consumer"]) == {"shared", "least_squares"}
        assert (
            drawn.summary.loc[drawn.summary["mechanism"] == "raw", "level"].isna().all()
        )
        assert drawn.paper_table["within"].isna().all()  # not the paper's recording

    def test_the_summary_is_the_mean_over_the_rows_of_the_cells(self, drawn):
        table = drawn.summary.set_index(["mechanism", "consumer", "metric"])["value"]
        rows = stored_rows(drawn.out, "raw", "shared")
        assert len(rows) == 12 * 4
        for metric, column in {"plr": "plr", "mel": "mel_s", "ael": "ael_s"}.items():
            assert table["raw", "shared", metric] == pytest.approx(rows[column].mean())
        assert table["raw", "shared", "rmse"] == pytest.approx(
            np.sqrt(rows["mse_m2"].mean())
        )
        rows = stored_rows(drawn.out, "fixed:0.7", "least_squares")
        assert len(rows) == 12
        missed, alarms = (
            rows.loc[rows["conflict"] == item, "predicted"] for item in (True, False)
        )
        error = (rows["predicted_separation_m"] - rows["separation_m"]).abs()
        for metric, expected in {
            "missed_conflict_rate": (~missed).mean(),
            "false_alarm_rate": alarms.mean(),
            "distance_mae": error.mean(),
        }.items():
            assert table["fixed", "least_squares", metric] == pytest.approx(expected)

    def test_the_manifest_is_enough_to_run_it_again(self, finished):
        manifest = read_manifest(finished.out)
        assert manifest["state"] == "finished"
        assert manifest["dataset"]["sha256"] == make_plan(finished).dataset.sha256
        assert manifest["dataset"]["tracks"] == 12
        known = manifest["settings"]
        assert known["mechanisms"] == ["raw", "fid:1000", "fixed:0.7"]
        preset = PRESETS[finished.preset]
        patrols = {
            "patrol.fleets": preset.fleets,
            "patrol.segment_s": preset.patrol_segment_s,
        }
        assert known["stages"] == finished.stages.flat() | patrols
        assert {"isac_track", "python", "machine", "libraries", "git_commit"} <= (
            manifest["environment"].keys()
        )
        assert manifest["wall_time_s"] > 0
        names = ("preset", "scenes", "seed"), ("mechanisms", "predictors", "attacks")
        again = Settings(
            dataset=finished.dataset,
            out=finished.out.with_name("again"),
            stages=StageSettings().changed(known["stages"]),
            **{name: known[name] for name in names[0]},
            **{name: tuple(known[name]) for name in names[1]},
        )
        run(again)
        first = (finished.out / "summary.csv").read_bytes()
        assert (again.out / "summary.csv").read_bytes() == first


def test_workers_who_share_out_a_block_by_levels_change_no_bit(settings, drawn):
    """Several blocks for two workers: tests/robustness/test_faults.py."""
    run(settings, jobs=2)
    for name in ("summary.csv", "decisions.csv"):
        assert (settings.out / name).read_bytes() == (drawn.out / name).read_bytes()


def test_further_scenes_are_for_utility_and_change_none_of_the_attacked(
    csv_recording, tmp_path, monkeypatch
):
    """The attacked scenes are the first; a preset's cheap predictors see all."""
    specs = ("raw", "fid:1000", "correlated:0.75")
    predictors = ("least_squares", "kalman_cv", "kalman_ca")
    axes = {
        "mechanisms": specs,
        "predictors": predictors,
        "attacks": ("identity",),
        "tasks": (),
    }
    axes |= {
        "other_law_mechanisms": (),
        "model_mechanisms": (),
        "protections": (),
        "stronger_adversaries": (),
    }
    axes |= {"policies": ()}
    few = replace(PRESETS["paper"], scenes=4, utility_scenes=10, **axes)
    monkeypatch.setitem(PRESETS, DEFAULT, few)
    for name in ("plan.units", "pool.pieces"):
        monkeypatch.setattr(f"evaluation.{name}.BLOCK_SCENES", 4)
    own_horizon = {"conflict.horizons_s": ()}
    usual = Settings(
        dataset=str(csv_recording), jobs=1, out=tmp_path / "more", stages=own_horizon
    )
    run(usual)
    run(usual, scenes=4, out=tmp_path / "few")
    message = read_manifest(usual.out)
    assert [message["settings"][name] for name in ("scenes", "scenes_utility")] == [
        4,
        10,
    ]
    for entry in message["cells"]:
        address = entry.address
        place = entry.spec, address.consumer, address.adversary
        more, first = (stored_rows(tmp_path / name, *place) for name in ("more", "few"))
        assert set(more["scene"]) == set(range(10 if place[1] in predictors[:2] else 4))
        attacked = more[more["scene"] < 4].reset_index(drop=True)
        pd.testing.assert_frame_equal(attacked, first, check_exact=True)
    remaining = stamps(usual.out)
    run(usual)
    assert_unchanged(remaining)
    # Sharing of three blocks, and reconstruction of the first at each level.
    assert len(remaining) == 3 + len(specs)


class TestAnotherRunInTheSameFolder:
    def test_with_a_mechanism_more_computes_only_its_cells(self, finished, drawn):
        remaining = stamps(finished.out)
        after = run(
            finished, mechanisms=(*finished.mechanisms, "fixed:0.3", "clean")
        ).summary
        assert len(after) == len(drawn.summary) + 2 * 11
        common = after.merge(drawn.summary, on=list(drawn.summary.columns))
        assert len(common) == len(drawn.summary)
        assert_unchanged(remaining)

    def test_with_consumers_more_leaves_further_files(self, finished):
        remaining = stamps(finished.out)
        wider = replace(
            finished, predictors=("least_squares", "kalman_cv"), attacks=("identity",)
        )
        after = run(wider).summary
        assert_unchanged(remaining)
        names = {path.name for path in remaining}
        added = [
            held
            for name, held in stored_consumers(finished.out).items()
            if name not in names
        ]
        expected = [{spec: {"bound", "identity (blind)"}} for spec in SPECS]
        expected.append({spec: {"kalman_cv"} for spec in SPECS})
        assert sorted(added, key=repr) == sorted(expected, key=repr)
        afresh = run(wider, fresh=True).summary
        pd.testing.assert_frame_equal(afresh, after, check_exact=True)
        assert len(list((finished.out / "cells").iterdir())) == 1 + len(SPECS)

    def test_after_a_plug_in_changed_computes_it_and_no_neighbours(
        self, settings, monkeypatch
    ):
        wider = replace(settings, predictors=("least_squares", "kalman_cv"))
        run(wider)
        before, earlier = stored_consumers(settings.out), stamps(settings.out)
        change_code(monkeypatch, "predictors.kalman")
        assert run(wider).manifest["dropped_cells"] == 3
        assert_unchanged(earlier)
        new = [
            held
            for name, held in stored_consumers(settings.out).items()
            if name not in before
        ]
        assert new == [{spec: {"kalman_cv"} for spec in SPECS}]

    def test_that_is_narrower_keeps_the_rest_unless_the_code_changed(
        self, finished, monkeypatch
    ):
        narrow = run(finished, mechanisms=("raw",))
        assert set(narrow.summary["mechanism"]) == {"raw", "fid", "fixed"}
        change_code(monkeypatch, "isac_track.sensing")
        narrow = run(finished, mechanisms=("raw",))
        assert set(narrow.summary["mechanism"]) == {"raw"}
        assert narrow.manifest["dropped_cells"] == 6

    def test_computes_missing_cells_again_and_alike(self, finished):
        attacked = replace(finished, attacks=("identity",))
        run(attacked)
        expected = (finished.out / "summary.csv").read_bytes()
        for every in (2, 1):
            for path in sorted((finished.out / "cells").iterdir())[::every]:
                path.unlink()
            if every == 1:
                (finished.out / "cells").rmdir()
            run(attacked, out=str(finished.out))
            assert (finished.out / "summary.csv").read_bytes() == expected

    def test_of_other_settings_is_refused_with_the_choice(
        self, finished, csv_recording
    ):
        wider = StageSettings().changed({"privacy.epsilon_m": 0.5})
        for change, message in (
            ({"seed": 1}, "seed 0 -> 1"),
            ({"scenes": 14}, "scenes 12 -> 14"),
            ({"stages": wider}, r"privacy.epsilon_m 0.3 -> 0.5"),
        ):
            with pytest.raises(
                SettingsError, match=rf"{message}.*--fresh .* or another --out"
            ):
                run(finished, **change)
        text = csv_recording.read_text(encoding="utf-8").replace("0.40,w0,", "0.41,w0,")
        csv_recording.write_text(text, encoding="utf-8")
        with pytest.raises(SettingsError, match="sha256"):
            run(finished)

    def test_that_is_fresh_removes_only_what_a_run_wrote(self, finished):
        notes = [
            finished.out / place / "mine.txt"
            for place in (".", "cells", "figures", "tables")
        ]
        for note in notes:
            note.write_text("keep me", encoding="utf-8")
        wider = finished.stages.changed({"privacy.epsilon_m": 0.5})
        run(
            finished, mechanisms=("raw",), fresh=True, stages=wider
        )  # whatever was there
        assert all(note.read_text(encoding="utf-8") == "keep me" for note in notes)
        assert len(list((finished.out / "cells").glob("*.parquet"))) == 1
        assert [path.name for path in (finished.out / "figures").iterdir()] == [
            "mine.txt"
        ]

    @pytest.mark.parametrize("fresh", [False, True])
    def test_leaves_a_folder_of_something_else_alone(self, settings, fresh):
        own = settings.out / "cells" / "thesis.txt"
        own.parent.mkdir(parents=True)
        own.write_text("mine", encoding="utf-8")
        with pytest.raises(SettingsError, match="is not empty and holds no run"):
            run(settings, fresh=fresh)
        with pytest.raises(SettingsError, match="is a file"):
            run(settings, out=own)
        (settings.out / "manifest.json").write_text(
            '{"name": "an extension"}', encoding="utf-8"
        )
        with pytest.raises(DataError, match="is not the manifest of a run"):
            run(settings, fresh=fresh)
        assert own.is_file()


@pytest.mark.usefixtures("single_process")
def test_a_failed_plugin_leaves_the_folder_usable(settings):
    message = "bad_plugins:Raises.*' failed: RuntimeError: no luck"
    with pytest.raises(PluginError, match=message):  # before the run
        run(settings, mechanisms=("helpers.bad_plugins:Raises",))
    assert [item.name for item in settings.out.iterdir()] == ["plugin-error.txt"]
    spec = "helpers.bad_plugins:RaisesThen:0.5"
    with pytest.warns(
        FailedCellsWarning, match="2 cells failed and are left out: .*no luck"
    ) as caught:
        result = run(settings, mechanisms=("raw", spec))
    assert [warning.filename for warning in caught] == [__file__]
    assert set(result.summary["mechanism"]) == {"raw"}
    assert set(result.failed["spec"]) == {spec}
    results = run(settings, mechanisms=("fixed:0.7",))
    assert set(results.summary["mechanism"]) == {"raw", "fixed"}  # raw was finished


@pytest.mark.usefixtures("single_process")
def test_what_failed_is_told_until_it_is_mended_whatever_is_run_next(
    settings, monkeypatch
):
    sweep, entry = (
        ("helpers.bad_plugins:NotAt3:0.1..0.5/3",),
        ("helpers.bad_plugins:NotAt3:0.5",),
    )
    with pytest.warns(FailedCellsWarning, match="not at 0.3"):
        run(settings, mechanisms=sweep)
    missing = (settings.out / "failed.csv").read_text()
    assert (
        missing.count("RuntimeError: not at 0.3") == 2
    )  # as shared, and of the predictor
    assert len(run(settings, mechanisms=entry).failed) == 2
    assert (settings.out / "failed.csv").read_text() == missing
    monkeypatch.setenv("MENDED", "yes")
    remaining = stamps(settings.out)
    assert len(run(settings, mechanisms=sweep).failed) == 0
    assert_unchanged(remaining)
    assert len(stamps(settings.out)) == len(remaining) + 1
    monkeypatch.delenv("MENDED")
    assert len(run(settings, mechanisms=entry, fresh=True).failed) == 0


@pytest.mark.usefixtures("single_process")
def test_what_spoils_its_own_or_fails_in_the_gallery_costs_nothing_else(
    settings, drawn
):
    spoils, many = (f"helpers.bad_plugins:{name}" for name in ("Spoils", "NeedsMany"))
    axes = {"mechanisms": (f"{spoils}:0.5", f"{many}:0.5", "raw", "fixed:0.7")}
    axes["predictors"] = ("helpers.bad_plugins:Moves", *settings.predictors)
    results = run(settings, **axes)
    assert len(results.failed) == 0
    for spec in ("raw", "fixed:0.7"):
        for consumer in ("shared", *settings.predictors):
            pd.testing.assert_frame_equal(
                stored_rows(settings.out, spec, consumer),
                stored_rows(drawn.out, spec, consumer),
            )
    (without,) = results.manifest["gallery_without"]
    assert without.startswith(f"{many}:0.5: ")
    assert set(results.gallery["mechanism"]) == {f"{spoils}:0.5", "raw"}
    assert set(results.summary["mechanism"]) == {spoils, many, "raw", "fixed"}


def test_what_cannot_be_sent_to_a_worker_is_refused_by_name(settings):
    message = (
        r"helpers.bad_plugins:HasALock cannot be sent to a worker \(TypeError: cannot"
        r" pickle"
    )
    with pytest.raises(PluginError, match=message):
        run(settings, mechanisms=("raw",), predictors=("helpers.bad_plugins:HasALock",))


def test_some_levels_are_computed_under_the_other_law_too(
    csv_recording, tmp_path, monkeypatch
):
    """As a run under that law has them; the run's own are as without them."""
    axes = {"mechanisms": ("raw", "fid:1", "fixed:0.5"), "tasks": (), "scenes": 4}
    axes |= {"attacks": ("kalman_rts", "averaging"), "predictors": ("least_squares",)}
    axes |= {
        "protections": (),
        "model_mechanisms": (),
        "stronger_adversaries": (),
        "policies": (),
    }
    few = replace(
        PRESETS["paper"],
        utility_scenes=4,
        other_law_mechanisms=("fid:1", "fixed:0.5"),
        **axes,
    )
    monkeypatch.setitem(PRESETS, DEFAULT, few)
    stages = StageSettings().changed({"conflict.horizons_s": ()})
    settings = Settings(
        dataset=str(csv_recording), jobs=1, out=tmp_path / "both", stages=stages
    )
    both = run(settings)
    by_law = {
        law: (
            run(
                replace(settings, out=tmp_path / law, mechanisms=few.mechanisms),
                stages=stages.changed({"sensing.law": law}),
            ).summary
        )
        for law in ("radial", "isotropic")
    }
    other = by_law["isotropic"][by_law["isotropic"]["mechanism"] != "raw"]
    other = other.assign(dataset=other["dataset"] + ":law=isotropic")
    expected = pd.concat([by_law["radial"], other], ignore_index=True)
    pd.testing.assert_frame_equal(both.summary, expected, check_exact=True)
    remaining = stamps(settings.out)
    run(settings)
    assert_unchanged(remaining)
    message = both.summary["dataset"].unique()
    assert list(message) == [both.dataset, f"{both.dataset}:law=isotropic"]


def test_a_predictor_that_wants_more_than_a_robot_has_is_refused(settings):
    with pytest.raises(
        PluginError, match="requires TRAIN, which a robot is never granted"
    ):
        run(settings, predictors=("helpers.bad_plugins:Greedy",))


def test_a_decision_by_probability_needs_a_covariance(settings):
    by_probability = StageSettings().changed({"conflict.decision": "probability"})
    with pytest.raises(SettingsError, match="'least_squares' has no covariance"):
        run(settings, stages=by_probability)


def test_a_decision_by_probability_trades_misses_against_alarms(tracks):
    def rates(**changes):
        stages = StageSettings().changed(
            {f"conflict.{name}": value for name, value in changes.items()}
        )
        _, rows = computed(
            tracks, spec="fixed:0.7", stages=stages, predictor="kalman_cv"
        )
        return rows["predicted"].sum(), rows["probability"]

    alarms, probability = rates(decision="probability", probability_threshold=0.5)
    assert alarms == (probability >= 0.5).sum()
    bold, _ = rates(decision="probability", probability_threshold=0.9)
    wary, _ = rates(decision="probability", probability_threshold=0.05)
    assert bold < alarms < wary
    by_mean, same = rates()
    assert np.array_equal(
        same, probability
    )  # the decision changes, not what it is made of
    assert by_mean > 0


def test_intervals_cluster_by_group(settings, tmp_path, csv_recording):
    """Twelve people in two groups: intervals have two clusters, not twelve."""
    lines = csv_recording.read_text(encoding="utf-8").splitlines()
    grouped = ["t,id,x,y,group"] + [
        f"{line},g{int(line.split(',')[1][1:]) % 2}" for line in lines[1:]
    ]
    path = tmp_path / "grouped.csv"
    path.write_text("\n".join(grouped) + "\n", encoding="utf-8")
    results = run(settings, dataset=str(path))
    # Of either group somebody is in a conflict, but not in one that is still to come.
    every = results.summary[~results.summary["metric"].isin(["missed_future_rate"])]
    assert set(every["n"]) == {2}
    assert (
        len(summary.scene_numbers(settings.out, results.manifest).estimates) == 3 * 11
    )
