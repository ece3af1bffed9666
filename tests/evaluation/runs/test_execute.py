"""Runs: the files they leave, what continues, what is refused, and on what numbers depend."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers.runs import arrays, change_code, held_by, rows_of

import evaluation
from evaluation.analysis import summary
from evaluation.cells.work import Block, cells
from evaluation.experiment.axes import Consumer
from evaluation.experiment.plan import plan
from evaluation.experiment.settings import Settings
from evaluation.results import build
from evaluation.runs import folder
from evaluation.runs.execute import FailedCellsWarning
from isac_track import plugins, sharing
from isac_track.config import StageSettings
from isac_track.errors import DataError, PluginError, SettingsError
from isac_track.rng import stream
from isac_track.scenes import cut, make_scenes, track_order
from isac_track.sensing import sense_scenes

KEY = ["dataset", "mechanism", "level", "consumer", "knowledge", "metric"]


@pytest.fixture
def settings(csv_recording, tmp_path):
    return Settings(
        preset="smoke",
        dataset=str(csv_recording),
        scenes=12,
        mechanisms=("raw", "fid:1000", "fixed:0.7"),
        predictors=("least_squares",),
        attacks=(),
        out=tmp_path / "run",
    )


def computed(tracks, *, spec="fid:100", stages=None, seed=0, predictor="least_squares"):
    """Rows of one block of 12 scenes: descriptors, then forecasts."""
    stages = stages or StageSettings()
    known = cut(tracks, settings=stages, seed=seed)
    order = track_order(n_tracks=len(known), n_scenes=12, agents=stages.scenes.agents, seed=seed)
    (mechanism,) = plugins.parse("mechanisms", spec)
    (forecaster,) = plugins.parse("predictors", predictor)
    consumers = (Consumer("shared"), Consumer("predictor", forecaster))
    block = Block(number=0, first_scene=0, order=order, levels=((mechanism, consumers),))
    found = cells(block, tracks=known, stages=stages, seed=seed)
    return [arrays(tables) for *_, tables in found]


def same(a, b):
    return all(
        np.array_equal(one[name], other[name], equal_nan=one[name].dtype.kind == "f")
        for one, other in zip(a, b, strict=True)
        for name in one
    )


CHANGES = {
    "resample.rate_min_hz": 6.0,
    "resample.rate_max_hz": 20.0,
    "resample.rate_hold_s": 0.5,
    "scenes.agents": 3,
    "scenes.history_ratio": 0.6,
    "scenes.robot_x_m": 1.0,
    "scenes.robot_y_m": 1.0,
    "scenes.robot_spread_m": 3.0,
    "scenes.near_miss_max_m": 1.2,
    "scenes.ring_min_m": 3.0,
    "scenes.ring_max_m": 5.0,
    "scenes.clearance_m": 2.5,
    "scenes.max_redraws": 1,
    "sensing.bs_x_m": 20.0,
    "sensing.bs_y_m": 60.0,
    "sensing.carrier_ghz": 28.0,
    "sensing.bandwidth_mhz": 50.0,
    "sensing.n_paths": 2,
    "sensing.delay_spread_s": 1e-6,
    "sensing.power_dbm": 45.0,
    "sensing.noise_dbm": -85.0,
    "sensing.path_loss_exponent": 3.0,
    "sensing.beam_fluctuation_db": 4.0,
    "sensing.resource_share": 0.5,
    "sensing.rcs_m2": 0.5,
    "sensing.large_scale_db": 6.0,
    "sensing.processing_gain_db": 30.0,
    "sensing.crb_gap_db": 5.0,
    "sensing.sigma_cap_m": 0.5,
    "sensing.law": "isotropic",
    "conflict.robot_speed_mps": 2.0,
    "conflict.horizon_steps": 8,
    "conflict.window": 4,
    "conflict.safety_radius_m": 0.7,
    "privacy.epsilon_m": 0.2,
}


def test_every_setting_is_in_the_list_below():
    # min_duration_s chooses tracks, and a decision by probability needs a covariance: both
    # have tests of their own.
    others = {
        "resample.min_duration_s",
        "conflict.decision",
        "conflict.probability_threshold",
    }
    # What is linked passes through no scene: tests/attacks/tasks/test_build.py.
    known = StageSettings().flat().keys()
    linked = {name for name in known if name.startswith("linkage.")}
    assert CHANGES.keys() == known - others - linked


def test_a_setting_that_cannot_matter_changes_nothing(tracks):
    # Nobody needs a hundred redraws: one more of them must not move any other draw.
    more = StageSettings().changed({"scenes.max_redraws": 101})
    assert same(computed(tracks), computed(tracks, stages=more))


@pytest.mark.parametrize("name", CHANGES)
def test_every_setting_changes_the_result(tracks, name):
    changed = StageSettings().changed({name: CHANGES[name]})
    assert not same(computed(tracks), computed(tracks, stages=changed))


@pytest.mark.parametrize(
    "spec", ["fid:200", "fid:100,alpha=0.4", "fid:100,beta=1.2", "fid:100,adding=independent"]
)
def test_every_parameter_of_the_rule_changes_the_result(tracks, spec):
    assert not same(computed(tracks), computed(tracks, spec=spec))


def test_the_fixed_error_the_window_and_the_seed_change_the_result(tracks):
    fixed = computed(tracks, spec="fixed:0.5")
    assert not same(fixed, computed(tracks, spec="fixed:0.6"))
    assert not same(fixed, computed(tracks, spec="fixed:0.5", predictor="least_squares:8"))
    assert not same(fixed, computed(tracks, spec="fixed:0.5", seed=1))
    assert same(fixed, computed(tracks, spec="fixed:0.5"))


@pytest.mark.parametrize("adding", ["linear", "independent"])
def test_fid_at_eta_1_is_fixed_075_sample_by_sample(tracks, adding):
    stages = StageSettings()
    known = cut(tracks, settings=stages, seed=0)
    order = track_order(n_tracks=len(known), n_scenes=12, agents=4, seed=0)
    scenes = make_scenes(known, order=order, first=0, settings=stages, seed=0)
    sensed = sense_scenes(scenes, settings=stages.sensing, seed=0)
    assert sensed.fid.min() > 38  # rho - 1 > 37: the exponential is lost in rounding
    fid = sharing.Fid(1.0, adding=adding).share(sensed, stream(0, "sharing", "block", 0))
    fixed = sharing.Fixed(0.75, adding=adding).share(sensed, stream(0, "sharing", "block", 0))
    assert np.array_equal(fid.xy, fixed.xy)


def test_a_run_leaves_what_the_design_says(settings):
    results = evaluation.run(settings)
    out = settings.out
    for name in ("manifest.json", "summary.csv", "paper_table.csv"):
        assert (out / name).is_file()
    held = held_by(out)  # a level each: the descriptors as shared and the predictor together
    assert list(held.values()) == [{"shared", "least_squares"}] * 3
    assert {name.rpartition(".")[2] for name in held} == {"parquet"}
    assert {path.suffix for path in (out / "figures").iterdir()} == {".svg", ".pdf"}
    assert {path.suffix for path in (out / "tables").iterdir()} == {".tex"}
    assert list(results.summary.columns) == [
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
    ]
    assert list(results.paper_table.columns) == [
        "mechanism",
        "level",
        "metric",
        "paper",
        "ours",
        "ci_low",
        "ci_high",
        "within",
    ]
    assert not results.summary.duplicated(KEY).any()
    assert set(results.summary["metric"]) == {
        "missed_conflict_rate",
        "false_alarm_rate",
        "distance_mae",
        "plr",
        "ael",
        "mel",
        "rmse",
    }
    assert set(results.summary["unit"]) == {"fraction", "s", "m"}
    assert set(results.summary["consumer"]) == {"shared", "least_squares"}
    raw = results.summary[results.summary["mechanism"] == "raw"]
    assert raw["level"].isna().all()
    assert results.paper_table["within"].isna().all()  # not the paper's recording


def test_the_frames_are_the_files(settings):
    results = evaluation.run(settings, pictures=False)
    read = pd.read_csv(settings.out / "summary.csv", keep_default_na=True)
    assert read["value"].to_numpy() == pytest.approx(results.summary["value"].to_numpy(), abs=0)
    assert len(read) == len(results.summary) == 3 * 7


def test_pictures_of_an_earlier_report_do_not_stay_beside_new_numbers(settings):
    evaluation.run(settings, pictures=False)
    folder.note_figures(settings.out, ["headline"])  # as a report that draws does
    own = settings.out / "figures" / "mine.svg"
    stale = [settings.out / name for name in ("report.html", "figures/headline.svg")]
    own.parent.mkdir(parents=True)
    for path in (own, *stale):
        path.write_text("earlier")
    evaluation.run(settings, pictures=False)
    assert own.exists()
    assert not any(path.exists() for path in stale)


def test_the_summary_is_the_mean_over_the_rows_of_the_cells(settings):
    results = evaluation.run(settings, pictures=False)
    table = results.summary.set_index(["mechanism", "consumer", "metric"])["value"]
    rows = rows_of(settings.out, "raw", "shared")
    assert len(rows) == 12 * 4
    assert table["raw", "shared", "plr"] == pytest.approx(rows["plr"].mean())
    assert table["raw", "shared", "mel"] == pytest.approx(rows["mel_s"].mean())
    assert table["raw", "shared", "ael"] == pytest.approx(rows["ael_s"].mean())
    assert table["raw", "shared", "rmse"] == pytest.approx(np.sqrt(rows["mse_m2"].mean()))
    rows = rows_of(settings.out, "fixed:0.7", "least_squares")
    assert len(rows) == 12
    conflicts = rows[rows["conflict"]]
    assert table["fixed", "least_squares", "missed_conflict_rate"] == pytest.approx(
        (~conflicts["predicted"]).mean()
    )
    others = rows[~rows["conflict"]]
    assert table["fixed", "least_squares", "false_alarm_rate"] == pytest.approx(
        others["predicted"].mean()
    )
    error = (rows["predicted_separation_m"] - rows["separation_m"]).abs()
    assert table["fixed", "least_squares", "distance_mae"] == pytest.approx(error.mean())


def test_workers_change_no_bit(settings, tmp_path):
    # 600 scenes: three blocks for two workers.
    alone = replace(settings, scenes=600)
    evaluation.run(alone, pictures=False)
    two = replace(alone, jobs=2, out=tmp_path / "two")
    evaluation.run(two, pictures=False)
    one_block = replace(settings, out=tmp_path / "levels", jobs=2)
    evaluation.run(one_block, pictures=False)  # one block, shared out by levels
    evaluation.run(replace(one_block, jobs=1, out=tmp_path / "single"), pictures=False)
    for a, b in (("run", "two"), ("levels", "single")):
        first = (tmp_path / a / "summary.csv").read_bytes()
        assert first == (tmp_path / b / "summary.csv").read_bytes()


def test_adding_a_mechanism_changes_no_other_row_and_computes_only_its_cells(settings):
    before = evaluation.run(settings, pictures=False).summary
    stamps = {path: path.stat().st_mtime_ns for path in (settings.out / "cells").iterdir()}
    wider = replace(settings, mechanisms=(*settings.mechanisms, "fixed:0.3", "clean"))
    after = evaluation.run(wider, pictures=False).summary
    assert len(after) == len(before) + 2 * 7
    common = after.merge(before, on=list(before.columns))
    assert len(common) == len(before)
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())


def test_a_consumer_that_is_added_later_leaves_a_further_file(settings):
    evaluation.run(settings, pictures=False)
    stamps = {path: path.stat().st_mtime_ns for path in (settings.out / "cells").iterdir()}
    wider = replace(settings, predictors=("least_squares", "kalman_cv"), attacks=("identity",))
    after = evaluation.run(wider, pictures=False).summary
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())
    names = {path.name for path in stamps}
    added = [held for name, held in held_by(settings.out).items() if name not in names]
    assert sorted(map(sorted, added)) == [["identity (blind)"]] * 3 + [["kalman_cv"]] * 3
    afresh = evaluation.run(replace(wider, fresh=True), pictures=False).summary
    pd.testing.assert_frame_equal(afresh, after, check_exact=True)
    assert len(list((settings.out / "cells").iterdir())) == 6


def test_a_changed_plug_in_is_computed_again_and_its_neighbours_are_not(settings, monkeypatch):
    wider = replace(settings, predictors=("least_squares", "kalman_cv"))
    evaluation.run(wider, pictures=False)
    before = held_by(settings.out)
    stamps = {path: path.stat().st_mtime_ns for path in (settings.out / "cells").iterdir()}
    change_code(monkeypatch, "predictors.kalman")
    again = evaluation.run(wider, pictures=False)
    assert again.manifest["dropped_cells"] == 3
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())
    new = [held for name, held in held_by(settings.out).items() if name not in before]
    assert new == [{"kalman_cv"}] * 3


def test_a_folder_of_the_earlier_layout_is_refused_with_the_way_out(settings):
    evaluation.run(settings, pictures=False)
    path = settings.out / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8"))
    del manifest["layout"]
    path.write_text(json.dumps(manifest), encoding="utf-8")
    earlier = settings.out / "cells" / "raw-shared_00000_0123456789abcdef.parquet"
    earlier.write_bytes(b"of a consumer of its own")
    for use in (lambda: evaluation.run(settings), lambda: evaluation.load(settings.out)):
        with pytest.raises(DataError, match=r"another version.*again with --fresh or another --"):
            use()
    evaluation.run(replace(settings, fresh=True), pictures=False)
    assert not earlier.exists()


def test_a_narrower_run_keeps_what_the_folder_already_has(settings):
    evaluation.run(settings, pictures=False)
    narrow = evaluation.run(replace(settings, mechanisms=("raw",)), pictures=False)
    assert set(narrow.summary["mechanism"]) == {"raw", "fid", "fixed"}


def test_missing_cells_are_computed_again_and_alike(settings):
    evaluation.run(settings, pictures=False)
    expected = (settings.out / "summary.csv").read_bytes()
    for path in sorted((settings.out / "cells").iterdir())[::2]:
        path.unlink()
    evaluation.run(settings, pictures=False)
    assert (settings.out / "summary.csv").read_bytes() == expected


def test_cells_of_other_code_are_not_mixed_in(settings, monkeypatch):
    evaluation.run(settings, pictures=False)
    change_code(monkeypatch, "isac_track.sensing")
    narrow = evaluation.run(replace(settings, mechanisms=("raw",)), pictures=False)
    assert set(narrow.summary["mechanism"]) == {"raw"}
    assert narrow.manifest["dropped_cells"] == 6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 1}, "seed 0 -> 1"),
        ({"scenes": 14}, "scenes 12 -> 14"),
        (
            {"stages": StageSettings().changed({"privacy.epsilon_m": 0.5})},
            r"privacy.epsilon_m 0.3 -> 0.5",
        ),
    ],
)
def test_another_run_in_the_same_folder_is_refused_with_the_choice(settings, change, message):
    evaluation.run(settings, pictures=False)
    with pytest.raises(SettingsError, match=rf"{message}.*--fresh .* or another --out"):
        evaluation.run(replace(settings, **change), pictures=False)
    evaluation.run(replace(settings, **change, fresh=True), pictures=False)


def test_a_changed_recording_is_refused(settings, csv_recording):
    evaluation.run(settings, pictures=False)
    text = csv_recording.read_text(encoding="utf-8").replace("0.40,w0,", "0.41,w0,")
    csv_recording.write_text(text, encoding="utf-8")
    with pytest.raises(SettingsError, match="sha256"):
        evaluation.run(settings, pictures=False)


def test_fresh_removes_only_what_a_run_wrote(settings):
    evaluation.run(settings)
    notes = [settings.out / place / "mine.txt" for place in (".", "cells", "figures", "tables")]
    for note in notes:
        note.write_text("keep me", encoding="utf-8")
    evaluation.run(replace(settings, mechanisms=("raw",), fresh=True))
    assert all(note.read_text(encoding="utf-8") == "keep me" for note in notes)
    assert len(list((settings.out / "cells").glob("*.parquet"))) == 1


def test_fresh_leaves_a_folder_with_somebody_elses_manifest_alone(settings):
    (settings.out / "cells").mkdir(parents=True)
    (settings.out / "manifest.json").write_text('{"name": "an extension"}', encoding="utf-8")
    (settings.out / "cells" / "thesis.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(DataError, match="is not the manifest of a run"):
        evaluation.run(replace(settings, fresh=True), pictures=False)
    assert (settings.out / "cells" / "thesis.txt").is_file()


def test_a_failed_plugin_leaves_the_folder_usable(settings, tmp_path, monkeypatch):
    (tmp_path / "bad_plugins.py").write_text(BAD_PLUGINS, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.warns(FailedCellsWarning, match="2 cells failed and are left out: .*no luck"):
        found = evaluation.run(
            replace(settings, mechanisms=("raw", "bad_plugins:Raises")), pictures=False
        )
    assert set(found.summary["mechanism"]) == {"raw"}
    assert set(found.failed["spec"]) == {"bad_plugins:Raises"}
    results = evaluation.run(replace(settings, mechanisms=("fixed:0.7",)), pictures=False)
    assert set(results.summary["mechanism"]) == {"raw", "fixed"}  # raw was finished


def test_a_lost_cell_folder_is_made_again(settings):
    evaluation.run(settings, pictures=False)
    expected = (settings.out / "summary.csv").read_bytes()
    for path in (settings.out / "cells").iterdir():
        path.unlink()
    (settings.out / "cells").rmdir()
    evaluation.run(replace(settings, out=str(settings.out)), pictures=False)
    assert (settings.out / "summary.csv").read_bytes() == expected


def test_a_folder_of_something_else_is_left_alone(settings):
    settings.out.mkdir()
    (settings.out / "thesis.txt").write_text("mine", encoding="utf-8")
    for fresh in (False, True):
        with pytest.raises(SettingsError, match="is not empty and holds no run"):
            evaluation.run(replace(settings, fresh=fresh), pictures=False)
    file = settings.out / "thesis.txt"
    with pytest.raises(SettingsError, match="is a file"):
        evaluation.run(replace(settings, out=file), pictures=False)


def test_a_broken_manifest_or_cell_is_named(settings):
    evaluation.run(settings)
    cell = min((settings.out / "cells").iterdir())
    cell.write_bytes(b"not parquet")
    with pytest.raises(DataError, match=f"{cell.name}.*delete it"):
        build(settings.out)
    (settings.out / "manifest.json").write_text("{", encoding="utf-8")
    with pytest.raises(DataError, match=r"manifest.json cannot be read"):
        build(settings.out)
    (settings.out / "manifest.json").write_text("[]", encoding="utf-8")
    with pytest.raises(DataError, match="is not the manifest of a run"):
        build(settings.out)
    with pytest.raises(DataError, match="holds no run"):
        build(settings.out / "nowhere")


def test_the_manifest_is_enough_to_run_it_again(settings):
    evaluation.run(settings, pictures=False)
    manifest = json.loads((settings.out / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["state"] == "finished"
    assert manifest["dataset"]["sha256"] == plan(settings).dataset.sha256
    assert manifest["dataset"]["tracks"] == 12
    assert manifest["settings"]["mechanisms"] == ["raw", "fid:1000", "fixed:0.7"]
    assert manifest["settings"]["stages"] == StageSettings().flat()
    assert {"isac_track", "python", "machine", "libraries", "git_commit"} <= (
        manifest["environment"].keys()
    )
    assert manifest["wall_time_s"] > 0
    again = Settings(
        preset=manifest["settings"]["preset"],
        dataset=settings.dataset,
        scenes=manifest["settings"]["scenes"],
        seed=manifest["settings"]["seed"],
        mechanisms=tuple(manifest["settings"]["mechanisms"]),
        predictors=tuple(manifest["settings"]["predictors"]),
        attacks=tuple(manifest["settings"]["attacks"]),
        stages=StageSettings().changed(manifest["settings"]["stages"]),
        out=settings.out.with_name("again"),
    )
    evaluation.run(again, pictures=False)
    first = (settings.out / "summary.csv").read_bytes()
    assert (again.out / "summary.csv").read_bytes() == first


def test_nothing_dropped_goes_uncounted(settings, tmp_path):
    text = "t,id,x,y\n" + "".join(
        f"{t * 0.4:.1f},{name},{t * 0.3 + place},{place}\n"
        for place, (name, n) in enumerate(
            [("long1", 80), ("long2", 80), ("long3", 80), ("long4", 80), ("short", 9), ("dot", 1)]
        )
        for t in range(n)
    )
    path = tmp_path / "mixed.csv"
    path.write_text(text, encoding="utf-8")
    manifest = evaluation.run(replace(settings, dataset=str(path)), pictures=False).manifest[
        "dataset"
    ]
    dropped = sum(repair["count"] for repair in manifest["repairs"] if "one" in repair["kind"])
    assert dropped == 1
    assert manifest["tracks_used"] == 4
    assert manifest["too_short"] == 1
    assert manifest["tracks"] == 5


def test_predictors_may_be_left_out(settings):
    results = evaluation.run(replace(settings, predictors=()), pictures=False)
    assert set(results.summary["consumer"]) == {"shared"}


def test_the_report_redraws_without_computing(settings):
    evaluation.run(settings)
    expected = (settings.out / "summary.csv").read_bytes()
    (settings.out / "summary.csv").unlink()
    build(settings.out)
    assert (settings.out / "summary.csv").read_bytes() == expected


BAD_PLUGINS = """
from dataclasses import dataclass, replace
import numpy as np
from isac_track.sharing import perturb
from isac_track.types import Knowledge, Prediction

@dataclass(frozen=True)
class Raises:
    def share(self, sensed, rng):
        raise RuntimeError("no luck")

@dataclass(frozen=True)
class Exits:
    def share(self, sensed, rng):
        raise SystemExit(0)

@dataclass(frozen=True)
class Blind:
    def share(self, sensed, rng):
        return replace(perturb(sensed, 0.0, rng), sigma=np.full(sensed.t.size, np.nan))

@dataclass(frozen=True)
class Greedy:
    requires = frozenset({Knowledge.TRAIN})
    def predict(self, release, t_future):
        return Prediction(np.zeros((*t_future.shape, 2)))

@dataclass(frozen=True)
class Nothing:
    def share(self, sensed, rng):
        return None

@dataclass(frozen=True)
class Mutates:
    def share(self, sensed, rng):
        sensed.xy[0] = 0
        return perturb(sensed, 0.0, rng)

@dataclass(frozen=True)
class Retimes:
    def share(self, sensed, rng):
        release = perturb(sensed, 0.0, rng)
        return replace(release, t=release.t + 1)

@dataclass(frozen=True)
class Shapeless:
    requires = frozenset()
    def predict(self, release, t_future):
        return Prediction(np.zeros((1, 1, 2)))

@dataclass(frozen=True)
class NotANumber:
    requires = frozenset()
    def predict(self, release, t_future):
        return Prediction(np.full((*t_future.shape, 2), np.nan))

@dataclass(frozen=True)
class Peeks:
    requires = frozenset()
    def predict(self, release, t_future):
        return Prediction(np.zeros((*t_future.shape, 2)) + release.sigma.max())
"""


@pytest.mark.parametrize(
    ("axis", "name", "message"),
    [
        ("mechanisms", "Raises", "mechanism 'bad_plugins:Raises' failed: RuntimeError: no luck"),
        ("mechanisms", "Exits", "failed: SystemExit"),
        ("mechanisms", "Blind", "declared a sigma below 0 or NaN"),
        ("predictors", "Greedy", "requires TRAIN, which a robot is never granted"),
        ("mechanisms", "Nothing", "must return a Release, got NoneType"),
        ("mechanisms", "Mutates", "failed: ValueError: assignment destination is read-only"),
        ("mechanisms", "Retimes", "changed the tracks or their times"),
        ("predictors", "Shapeless", r"must return a Prediction with mean \(48, 12, 2\)"),
        ("predictors", "NotANumber", "failed: ValueError: a predicted position is not finite"),
        ("predictors", "Peeks", "failed: AttributeError"),
    ],
)
def test_a_plugin_that_breaks_its_contract_is_named(
    settings, tmp_path, monkeypatch, axis, name, message
):
    (tmp_path / "bad_plugins.py").write_text(BAD_PLUGINS, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    changed = replace(settings, **{axis: (f"bad_plugins:{name}",)})
    if axis == "mechanisms" or name == "Greedy":  # nothing at all is left
        with pytest.raises(PluginError, match=message):
            evaluation.run(changed, pictures=False)
        return
    with pytest.warns(FailedCellsWarning, match=message):
        results = evaluation.run(changed, pictures=False)
    assert set(results.failed["consumer"]) == {f"bad_plugins:{name}"}
    assert set(results.summary["consumer"]) == {"shared"}


def test_a_decision_by_probability_needs_a_covariance(settings):
    by_probability = StageSettings().changed({"conflict.decision": "probability"})
    with pytest.raises(SettingsError, match="'least_squares' has no covariance"):
        evaluation.run(replace(settings, stages=by_probability), pictures=False)


def test_a_decision_by_probability_trades_misses_against_alarms(tracks):
    def rates(**changes):
        stages = StageSettings().changed(
            {f"conflict.{name}": value for name, value in changes.items()}
        )
        _, rows = computed(tracks, spec="fixed:0.7", stages=stages, predictor="kalman_cv")
        return rows["predicted"].sum(), rows["probability"]

    alarms, probability = rates(decision="probability", probability_threshold=0.5)
    assert alarms == (probability >= 0.5).sum()
    bold, _ = rates(decision="probability", probability_threshold=0.9)
    wary, _ = rates(decision="probability", probability_threshold=0.05)
    assert bold < alarms < wary
    by_mean, same = rates()
    assert np.array_equal(same, probability)  # the decision changes, not what it is made of
    assert by_mean > 0


def test_the_trackers_run_by_name_and_filterpy_agrees(settings):
    names = ("kalman_cv", "kalman_cv:engine=filterpy", "kalman_imm", "kalman_imm:engine=filterpy")
    chosen = replace(settings, scenes=4, mechanisms=("fixed:0.7",), predictors=names)
    results = evaluation.run(chosen, pictures=False)
    table = results.summary.set_index(["consumer", "metric"])["value"]
    for name in ("kalman_cv", "kalman_imm"):
        theirs = table[f"{name}:engine=filterpy"]
        assert table[name].to_numpy() == pytest.approx(theirs.to_numpy(), abs=1e-9)
    assert set(results.decisions["score"]) == {"separation", "probability"}


def test_the_independent_rule_has_rows_of_its_own(settings):
    specs = ("raw", "fixed:0.5", "fixed:0.5,adding=independent")
    results = evaluation.run(replace(settings, mechanisms=specs), pictures=False)
    assert set(results.summary["mechanism"]) == {"raw", "fixed", "fixed:adding=independent"}


def test_intervals_cluster_by_group(settings, tmp_path, csv_recording):
    """Twelve people in two groups: the intervals know of two clusters, not of twelve."""
    lines = csv_recording.read_text(encoding="utf-8").splitlines()
    grouped = ["t,id,x,y,group"] + [
        f"{line},g{int(line.split(',')[1][1:]) % 2}" for line in lines[1:]
    ]
    path = tmp_path / "grouped.csv"
    path.write_text("\n".join(grouped) + "\n", encoding="utf-8")
    results = evaluation.run(replace(settings, dataset=str(path)), pictures=False)
    assert set(results.summary["n"]) == {2}
    assert len(summary.estimates(settings.out, results.manifest)[0]) == 3 * 7
