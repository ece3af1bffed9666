"""A run with further horizons: what it adds, and that it changes nothing else."""

import numpy as np
import pandas as pd
import pytest
from helpers.small_runs import smoke, write_walks

import evaluation
from evaluation.analysis.decisions import curve
from evaluation.analysis.keys import horizons_in, worlds_of
from evaluation.analysis.metrics import MISSED_FUTURE, MISSED_RATE
from evaluation.analysis.summary import clusters, weights_of
from evaluation.experiment.constants import horizon_of, horizon_world, is_world
from evaluation.experiment.presets import PRESETS
from evaluation.runs.cell_files import read_rows
from evaluation.verdict.items import Draft
from isac_track.intervals import Estimate

ROBOTS = ("least_squares", "kalman_cv", "constant_position")
KEYS = ["dataset", "mechanism", "level", "consumer", "knowledge", "metric"]
WORLD = "horizon=3s"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("horizons")
    walks = write_walks(out / "walks.csv")
    levels = ("raw", "fixed:0.4", "fixed:0.7", "fixed:1", "fid:1", "fid:1000")
    own = {"scenes": 120, "predictors": ROBOTS, "mechanisms": levels}
    return {
        name: evaluation.run(
            smoke(walks, out / name, **own, stages={"conflict.horizons_s": horizons_s}),
            pictures=False,
            progress=False,
        )
        for name, horizons_s in (("alone", ()), ("both", (3.0,)))
    }


def test_nothing_of_the_papers_horizon_changes(made):
    alone, both = (made[name].summary for name in ("alone", "both"))
    own = both[worlds_of(both) == ""].reset_index(drop=True)
    pd.testing.assert_frame_equal(own, alone)
    assert set(worlds_of(both)) == {"", WORLD}
    assert set(worlds_of(alone)) == {""}
    later = both[worlds_of(both) == WORLD]
    assert set(later["dataset"]) == {f"{made['both'].dataset}:{WORLD}"}
    assert set(later["consumer"]) == set(ROBOTS)  # nobody else reads there
    assert not both[KEYS].duplicated().any()


@pytest.mark.parametrize("world", ["", WORLD])
def test_rates_are_those_that_counting_gives(made, world):
    run = made["both"]
    name = f"{run.dataset}:{world}" if world else run.dataset
    entries = [one for one in run.manifest["cells"] if one["kind"] == "predictor"]
    entries = [one for one in entries if (one["world"] or "") == world]
    assert len(entries) == 6 * len(ROBOTS)
    for entry in entries:
        columns = ["conflict", "predicted", "inside_now", "time_to_conflict_s", "separation_m"]
        rows = read_rows(run.out, entry, columns=columns).to_pandas()
        assert len(rows) == 120
        assert (rows["inside_now"] == (rows["time_to_conflict_s"] == 0.0)).all()
        assert (rows["time_to_conflict_s"].notna() == rows["conflict"]).all()
        assert (rows["conflict"] == (rows["separation_m"] < 0.9)).all()
        to_come = rows[rows["conflict"] & ~rows["inside_now"]]
        summary = run.summary[run.summary["dataset"] == name]
        summary = summary[summary["consumer"] == entry["consumer"]]
        summary = summary[summary["mechanism"] == entry["mechanism"]]
        level = np.nan if entry["level"] is None else entry["level"]
        summary = summary[np.isclose(summary["level"], level, equal_nan=True)]
        values = summary.set_index("metric")["value"]
        conflicts = rows[rows["conflict"]]
        assert values[MISSED_FUTURE] == pytest.approx(1.0 - to_come["predicted"].mean())
        assert values[MISSED_RATE] == pytest.approx(1.0 - conflicts["predicted"].mean())


def test_a_longer_horizon_has_more_conflicts_to_come(made):
    run = made["both"]
    shares = {}
    for entry in run.manifest["cells"]:
        if entry["kind"] == "predictor" and entry["mechanism"] == "raw":
            rows = read_rows(run.out, entry, columns=["conflict", "inside_now"]).to_pandas()
            inside = rows.loc[rows["conflict"], "inside_now"]
            shares.setdefault(entry["world"] or "", set()).add(inside.mean())
    assert all(len(of_robots) == 1 for of_robots in shares.values())  # whoever foresees
    assert shares[WORLD].pop() < shares[""].pop()


def test_decisions_hold_future_conflicts_at_the_same_false_alarms(made):
    run = made["both"]
    entry = next(one for one in run.manifest["cells"] if one.get("world") == WORLD)
    columns = ["group", "conflict", "inside_now", "predicted_separation_m"]
    table = read_rows(run.out, entry, columns=columns)
    rows = table.to_pandas()
    rows = rows.assign(cluster=clusters(table, run.manifest))
    rows = rows[~(rows["conflict"] & rows["inside_now"])]
    of_scenes = curve(
        score=-rows["predicted_separation_m"].to_numpy(),
        conflict=rows["conflict"].to_numpy(),
        cluster=rows["cluster"].to_numpy(),
        weights=weights_of(run.manifest),
    )
    told = run.decisions[run.decisions["dataset"] == f"{run.dataset}:{WORLD}"]
    told = told[(told["mechanism"] == "raw") & (told["consumer"] == entry["consumer"])].iloc[0]
    at = np.full(1001, told["false_alarm_rate"])
    assert told["missed_future_rate"] == pytest.approx(of_scenes.missed_at(at)[0])


def test_the_frontier_holds_each_criterion_at_each_horizon(made):
    run = made["both"]
    asked = run.frontier.groupby("dataset")["criterion"].unique().map(sorted).to_dict()
    criteria = ["missed", "missed_at_equal_false_alarms", "missed_future"]
    assert asked == {run.dataset: criteria, f"{run.dataset}:{WORLD}": criteria}
    own = run.frontier[run.frontier["dataset"] == run.dataset].reset_index(drop=True)
    pd.testing.assert_frame_equal(own, made["alone"].frontier)
    # Raw costs nothing, so that both curves begin there: what is left falls as the price rises.
    part = run.frontier[(run.frontier["metric"] == "plr") & (run.frontier["mechanism"] == "fixed")]
    for _, rows in part.groupby(["dataset", "robot", "criterion"]):
        left = rows["value"].dropna()
        assert (np.diff(left) <= 1e-9).all()


def test_the_claim_is_stated_with_future_conflicts_at_both_horizons(made):
    items = made["both"].verdict["items"]
    claims = [one for one in items if one["section"] == "claim"]
    asked = {(one["criterion"], one.get("horizon_s")) for one in claims}
    assert asked == {
        ("missed", None),
        ("missed_at_equal_false_alarms", None),
        ("missed_future", None),
        ("missed_future", 3.0),
    }
    assert len({one["id"] for one in claims}) == len(claims)
    said = {one["sentence"] for one in claims if one.get("horizon_s")}
    assert all(" (3 s ahead, " in one for one in said)


def test_every_preset_compares_its_robots_with_nobody_moving_on():
    assert all(preset.predictors[-1] == "constant_position" for preset in PRESETS.values())


def test_a_horizon_has_a_name():
    assert [horizon_world(3.0), horizon_world(1.5)] == ["horizon=3s", "horizon=1.5s"]
    assert horizon_of("horizon=1.5s") == 1.5
    for name in ("", "model", "horizon=", "horizon=s", "horizon=3", "xhorizon=3s", "law=isotropic"):
        assert horizon_of(name) is None
    assert is_world("model")
    assert is_world(WORLD)
    assert not is_world("students03")
    assert horizons_in([{"world": WORLD}, {"world": "model"}, {}, {"world": "horizon=1s"}]) == [
        1,
        3,
    ]


def test_items_of_two_horizons_have_two_names():
    about = {"adding": "linear", "effect": Estimate(0.0), "parted_at": 0.0, "unit": "fraction"}
    about |= {"above": "", "below": "", "sentences": {}, "criterion": "missed_future"}
    own, later = (Draft(**about, details=details) for details in ({}, {"horizon_s": 3.0}))
    assert own.names == ["linear", "missed_future"]
    assert later.names == ["linear", "missed_future", WORLD]
