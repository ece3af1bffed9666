"""A run with further horizons: what it adds, and that it changes nothing else."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers.finished_runs import make_summary
from helpers.small_runs import smoke, write_walks

import evaluation
from evaluation.estimates.conflict_times import TIME_COLUMNS
from evaluation.estimates.decisions import decision_curve
from evaluation.estimates.frontier import usual_price
from evaluation.estimates.keys import row_worlds
from evaluation.estimates.metrics import MISSED_FUTURE, MISSED_RATE
from evaluation.estimates.standing_still import beaten_by_standing_still
from evaluation.estimates.summary import bootstrap_weights, clusters
from evaluation.plan.address import Address, parse_consumer
from evaluation.plan.presets import BASELINE, PRESETS
from evaluation.plan.world import OWN_WORLD, World
from evaluation.reporting import tables
from evaluation.reporting.answers import answers, lead_robot
from evaluation.reporting.figures.conflict_times import figures
from evaluation.reporting.first_screen import first_screen, screen_columns
from evaluation.reporting.headline import HeadlineColumn, headline
from evaluation.reporting.notices import notices
from evaluation.store.cell_files import read_rows
from evaluation.store.entries import Entry, horizons_in
from evaluation.verdict import rules
from evaluation.verdict.items import Topic
from isac_track.intervals import Estimate, estimate_from_replicates
from isac_track.rng import stream

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
    own = both[row_worlds(both) == OWN_WORLD].reset_index(drop=True)
    pd.testing.assert_frame_equal(own, alone)
    assert set(row_worlds(both)) == {OWN_WORLD, World(horizon_s=3.0)}
    assert set(row_worlds(alone)) == {OWN_WORLD}
    later = both[row_worlds(both) == World(horizon_s=3.0)]
    assert set(later["dataset"]) == {f"{made['both'].dataset}:{WORLD}"}
    assert set(later["consumer"]) == set(ROBOTS)  # nobody else reads there
    assert not both[KEYS].duplicated().any()


@pytest.mark.parametrize("world", ["", WORLD])
def test_rates_are_those_that_counting_gives(made, world):
    run = made["both"]
    name = f"{run.dataset}:{world}" if world else run.dataset
    entries = [entry for entry in run.manifest["cells"] if entry.kind == "predictor"]
    entries = [entry for entry in entries if entry.address.world.text == world]
    assert len(entries) == 6 * len(ROBOTS)
    for entry in entries:
        columns = [
            "conflict",
            "predicted",
            "inside_now",
            "time_to_conflict_s",
            "separation_m",
        ]
        rows = read_rows(run.out, entry, columns=columns).to_pandas()
        assert len(rows) == 120
        assert (rows["inside_now"] == (rows["time_to_conflict_s"] == 0.0)).all()
        assert (rows["time_to_conflict_s"].notna() == rows["conflict"]).all()
        assert (rows["conflict"] == (rows["separation_m"] < 0.9)).all()
        to_come = rows[rows["conflict"] & ~rows["inside_now"]]
        summary = run.summary[run.summary["dataset"] == name]
        summary = summary[summary["consumer"] == entry.address.consumer]
        summary = summary[summary["mechanism"] == entry.address.mechanism]
        level = np.nan if entry.address.level is None else entry.address.level
        summary = summary[np.isclose(summary["level"], level, equal_nan=True)]
        values = summary.set_index("metric")["value"]
        conflicts = rows[rows["conflict"]]
        assert values[MISSED_FUTURE] == pytest.approx(1.0 - to_come["predicted"].mean())
        assert values[MISSED_RATE] == pytest.approx(1.0 - conflicts["predicted"].mean())


def test_a_longer_horizon_has_more_conflicts_to_come(made):
    run = made["both"]
    shares = {}
    for entry in run.manifest["cells"]:
        if entry.kind == "predictor" and entry.address.mechanism == "raw":
            rows = read_rows(
                run.out, entry, columns=["conflict", "inside_now"]
            ).to_pandas()
            inside = rows.loc[rows["conflict"], "inside_now"]
            shares.setdefault(entry.address.world.text, set()).add(inside.mean())
    assert all(
        len(robot_rows) == 1 for robot_rows in shares.values()
    )  # whoever foresees
    assert shares[WORLD].pop() < shares[""].pop()


def test_decisions_hold_future_conflicts_at_the_same_false_alarms(made):
    run = made["both"]
    entry = next(
        entry for entry in run.manifest["cells"] if entry.address.world.text == WORLD
    )
    columns = ["group", "conflict", "inside_now", "predicted_separation_m"]
    table = read_rows(run.out, entry, columns=columns)
    rows = table.to_pandas()
    rows = rows.assign(cluster=clusters(table, run.manifest))
    rows = rows[~(rows["conflict"] & rows["inside_now"])]
    scene_rows = decision_curve(
        score=-rows["predicted_separation_m"].to_numpy(),
        conflict=rows["conflict"].to_numpy(),
        cluster=rows["cluster"].to_numpy(),
        weights=bootstrap_weights(run.manifest),
    )
    shown = run.decisions[run.decisions["dataset"] == f"{run.dataset}:{WORLD}"]
    shown = shown[
        (shown["mechanism"] == "raw") & (shown["consumer"] == entry.address.consumer)
    ].iloc[0]
    at = np.full(1001, shown["false_alarm_rate"])
    assert shown["missed_future_rate"] == pytest.approx(scene_rows.missed_at(at)[0])


def test_the_frontier_holds_each_criterion_at_each_horizon(made):
    run = made["both"]
    asked = run.frontier.groupby("dataset")["criterion"].unique().map(sorted).to_dict()
    criteria = ["missed", "missed_at_equal_false_alarms", "missed_future"]
    assert asked == {run.dataset: criteria, f"{run.dataset}:{WORLD}": criteria}
    own = run.frontier[run.frontier["dataset"] == run.dataset].reset_index(drop=True)
    pd.testing.assert_frame_equal(own, made["alone"].frontier)
    # Raw costs nothing, so that both curves begin there: what is left falls as the
    # price rises.
    part = run.frontier[
        (run.frontier["metric"] == "plr") & (run.frontier["mechanism"] == "fixed")
    ]
    for _, rows in part.groupby(["dataset", "robot", "criterion"]):
        left = rows["value"].dropna()
        assert (np.diff(left) <= 1e-9).all()


def test_the_claim_is_stated_with_future_conflicts_at_both_horizons(made):
    items = made["both"].verdict["items"]
    claims = [entry for entry in items if entry["section"] == "claim"]
    asked = {(entry["criterion"], entry.get("horizon_s")) for entry in claims}
    assert asked == {
        ("missed", None),
        ("missed_at_equal_false_alarms", None),
        ("missed_future", None),
        ("missed_future", 3.0),
    }
    assert len({entry["id"] for entry in claims}) == len(claims)
    said = {entry["sentence"] for entry in claims if entry.get("horizon_s")}
    assert all(" (3 s ahead, " in entry for entry in said)


def test_every_preset_compares_its_robots_with_nobody_moving_on():
    assert all(
        preset.predictors[-1] == "constant_position" for preset in PRESETS.values()
    )


def test_a_run_has_the_further_horizons_of_its_cells():
    worlds = (
        World(horizon_s=3.0),
        World(is_model=True),
        OWN_WORLD,
        World(horizon_s=1.0),
    )
    entries = [
        Entry(Address(mechanism="raw", world=world), kind="shared", spec="raw")
        for world in worlds
    ]
    assert horizons_in(entries) == [1, 3]


def test_items_of_two_horizons_have_two_names():
    own, later = (
        Topic(rules.CLAIM, "linear", criterion="missed_future", horizon_s=horizon_s)
        for horizon_s in (None, 3.0)
    )
    assert own.item_id == "claim/linear/missed_future"
    assert later.item_id == f"claim/linear/missed_future/{WORLD}"


class TestTimesToConflict:
    def test_are_the_shares_that_counting_gives(self, made):
        run = made["both"]
        assert list(run.conflict_times.columns) == TIME_COLUMNS
        for world in ("", WORLD):
            name = f"{run.dataset}:{world}" if world else run.dataset
            entry = next(
                entry
                for entry in run.manifest["cells"]
                if entry.kind == "predictor" and entry.address.world.text == world
            )
            times = read_rows(
                run.out, entry, columns=["time_to_conflict_s"]
            ).to_pandas()
            times = times["time_to_conflict_s"].dropna().to_numpy()
            shown = run.conflict_times[run.conflict_times["dataset"] == name]
            expected = [(times <= by_s + 1e-9).mean() for by_s in shown["by_s"]]
            assert shown["value"].to_numpy() == pytest.approx(expected)
            assert shown["by_s"].iloc[0] == 0.0
            assert shown["by_s"].iloc[-1] == times.max()
            assert shown["value"].iloc[-1] == 1.0
            assert np.isnan(shown["ci_low"].iloc[-1])  # by construction
            assert (np.diff(shown["value"]) >= 0).all()

    def test_are_a_figure_with_a_panel_for_each_horizon(self, made):
        (figure,) = figures(made["both"])
        assert figure.name == "time_to_conflict"
        headings = [heading for heading, _ in figure.panels]
        assert headings[0].startswith("the run's own horizon: ")
        assert headings[1].startswith("3 s ahead: ")
        assert {chart.x_label for _, chart in figure.panels} == {"time from now (s)"}
        assert not list(figures(replace(made["both"], conflict_times=pd.DataFrame())))


class TestStandingStill:
    WHERE = ("fixed", 0.7)

    def robots(self, missed, *, robot="least_squares", clusters=40):
        """Misses of a robot and of standing still, in replicates that differ alike."""
        noise = stream(0, "test", "standing").normal(0.0, 0.01, 400)
        ends = {"n": clusters, "effective": float(clusters)}
        return {
            parse_consumer(robot)
            .measured(MISSED_RATE)
            .at(*self.WHERE): estimate_from_replicates(
                np.append(missed, missed + noise), **ends
            ),
            parse_consumer(BASELINE)
            .measured(MISSED_RATE)
            .at(*self.WHERE): estimate_from_replicates(
                np.append(0.3, 0.3 + 0.9 * noise), **ends
            ),
        }

    def test_a_robot_that_surely_misses_more_is_told_so(self):
        own, later = self.robots(0.29), {3.0: self.robots(0.31)}
        first, second = beaten_by_standing_still(own, later)
        assert (first["robot"], first["horizon_s"], first["levels"]) == (
            "least_squares",
            None,
            1,
        )
        assert first["loses"] == []
        (level,) = second["loses"]
        assert second["horizon_s"] == 3.0
        assert (level["mechanism"], level["level"]) == self.WHERE
        assert level["difference"] == pytest.approx(0.01)
        # Paired: both intervals by themselves, +- 2 points, would tell nothing.
        assert 0.0 < level["ci_low"] < 0.01 < level["ci_high"] < 0.02

    def test_few_people_tell_nothing_and_standing_still_is_no_robot(self):
        (record,) = beaten_by_standing_still(self.robots(0.5, clusters=19), {})
        assert record["loses"] == []
        assert record["robot"] == "least_squares"
        unequal = {
            key: replace(item, effective=3.0) if key.consumer == BASELINE else item
            for key, item in self.robots(0.5).items()
        }
        (record,) = beaten_by_standing_still(unequal, {})
        assert record["loses"] == []
        assert beaten_by_standing_still({}, {3.0: {}}) == []

    def test_the_first_screen_says_so(self, made):
        run = made["both"]
        loses = [{"mechanism": "fixed", "level": 0.7}] * 2
        robots = [
            {
                "robot": "least_squares",
                "horizon_s": None,
                "levels": 6,
                "loses": loses[:1],
            },
            {"robot": "least_squares", "horizon_s": 3.0, "levels": 6, "loses": loses},
            {"robot": "kalman_cv", "horizon_s": 3.0, "levels": 6, "loses": []},
        ]
        shown = answers(replace(run, verdict=run.verdict | {"robots": robots}))[
            0
        ].sentence
        beaten = (
            "At 2 of 6 levels, expecting people to stand beats the paper's straight"
            " line."
        )
        assert shown.endswith(beaten)
        assert "of future conflicts (raw positions: " in shown
        alone = answers(replace(made["alone"], verdict={}))[0].sentence
        assert "future" not in alone
        assert "standing still" not in alone


def test_the_first_table_shows_future_conflicts_and_fits(made):
    lines = first_screen(made["both"])
    # No path is broken, however long.
    assert max(len(line) for line in lines if str(made["both"].out) not in line) <= 80
    heads = next(line for line in lines if line.startswith("what is shared"))
    assert heads.removeprefix("what is shared").split()[:2] == ["future,", "%"]
    assert "future" not in " ".join(first_screen(made["alone"]))


@pytest.mark.parametrize("n_linked", [0, 1, 2, 3])
def test_the_screen_has_six_columns_at_most(n_linked):
    first = headline(make_summary(predictors=("least_squares", "kalman_cv")))
    robots = first.robots
    linked = [
        HeadlineColumn("found", f"task-{n}", parse_consumer(f"t{n}").measured("rank1"))
        for n in range(n_linked)
    ]
    later = {
        robot.measure.measured(MISSED_FUTURE).at(*where): Estimate(0.5, 0.4, 0.6)
        for robot in robots
        for where in first.levels
    }
    wide = replace(first, linked=linked, horizon_s=3.0, later=later)
    best = lead_robot(wide, best="kalman_cv")
    assert best.measure.consumer == "kalman_cv"
    assert best.is_later
    pairs = screen_columns(wide, best)
    assert [group.title for group, _ in pairs][:2] == [
        "Kalman misses",
        "known to 0.3 m, %",
    ]
    assert all(len(group.heads) == len(columns) for group, columns in pairs)
    assert sum(len(columns) for _, columns in pairs) == 3 + min(n_linked, 2)


def test_the_frontier_is_read_at_the_price_of_future_conflicts_at_the_longest_horizon():
    rows = [
        {
            "dataset": f"walks{world}",
            "criterion": criterion,
            "level": level,
            "value": 0.5,
        }
        for world in ("", ":horizon=1s", ":horizon=3s")
        for criterion in ("missed", "missed_at_equal_false_alarms", "missed_future")
        for level in (0.1, np.nan)
    ]
    every = pd.DataFrame(rows)
    read = usual_price(every)
    assert set(read["dataset"]) == {"walks:horizon=3s"}
    assert set(read["criterion"]) == {"missed_future"}
    own = usual_price(every[every["dataset"] == "walks"])
    assert set(own["criterion"]) == {"missed_future"}
    without = every[every["criterion"] != "missed_future"]
    assert set(usual_price(without)["criterion"]) == {"missed_at_equal_false_alarms"}


def test_tables_of_a_run_hold_each_horizon(made):
    pages = tables.page_tables(made["both"])
    table = pages["horizon-3s"]
    names = [column.name for column in table.columns]
    assert "missed future, constant_position" in names
    assert len(table.rows) == 6
    assert "horizon-3s" not in tables.page_tables(made["alone"])
    shown = (made["both"].out / "tables.txt").read_text("utf-8")
    assert "Conflicts made for 3 s ahead" in shown


def test_the_papers_claim_is_stated_with_future_conflicts(made):
    claims = set(made["both"].claims["claim"])
    for rate in (
        "missed-conflict rate",
        "missed-future rate",
        "missed-future rate 3 s ahead",
    ):
        assert f"at every matched {rate}: FID has lower PLR" in claims


def test_tracks_that_end_before_the_horizon_are_said(made):
    manifest = made["both"].manifest
    used = manifest["dataset"]["tracks_used"]
    assert manifest["horizons"] == {
        "3": {"tracks_used": used, "no_future": 0, "exhausted_redraws": 0}
    }
    assert made["alone"].manifest["horizons"] == {}
    few = {"3": {"tracks_used": used - 2, "no_future": 2, "exhausted_redraws": 1}}
    shown = notices(
        manifest | {"horizons": few | {"9": {"tracks_used": 0, "no_future": used}}}
    )
    assert "3 s ahead: 2 tracks end before that and cannot be used there." in shown
    assert (
        "No conflicts 9 s ahead: too few recordings last so long after the history."
        in shown
    )
    start = "3 s ahead: 1 background agent keeps its last draw"
    assert any(line.startswith(start) for line in shown)
