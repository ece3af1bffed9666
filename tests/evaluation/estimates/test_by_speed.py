"""PLR by net speed: against the cells of a small run, summed by hand."""

import numpy as np
import pytest
from helpers.runs import stored_rows
from helpers.small_runs import smoke, write_walks

from evaluation.api import load, run
from evaluation.estimates import by_speed as tested
from evaluation.store.manifest import read_manifest

_ENDS = ["speed_low_mps", "speed_high_mps"]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run in which slow and fast people are attacked."""
    folder = tmp_path_factory.mktemp("speeds")
    dataset = write_walks(folder / "walks.csv", n_people=24)
    settings = smoke(
        dataset,
        folder / "run",
        scenes=60,
        mechanisms=("raw", "fixed:1", "fixed:0.7"),
        attacks=("radial_rts",),
        predictors=(),
    )
    return run(settings, progress=False, pictures=False)


def strongest_rows(finished):
    """The rows of the strongest reconstruction, at the fixed noise that is shown."""
    best = finished.strongest[""]
    return stored_rows(finished.out, "fixed:1", best.consumer, best.adversary)


def test_every_bin_is_the_mean_of_its_people(finished):
    speeds = finished.speeds
    assert set(speeds["mechanism"]) == {"raw", "fixed"}
    assert set(speeds["level"].dropna()) == {1.0}  # not 0.7
    shared = stored_rows(finished.out, "raw", "shared")
    speed_by_source = dict(zip(shared["source"], shared["speed_mps"], strict=True))
    rows = strongest_rows(finished)
    own = rows["source"].map(speed_by_source).astype(float)
    known = speeds[(speeds["mechanism"] == "fixed") & (speeds["knowledge"] != "")]
    assert len(known) > 1
    for row in known.itertuples():
        inside = (row.speed_low_mps <= own) & (own < row.speed_high_mps)
        assert row.value == pytest.approx(rows.loc[inside, "plr"].mean())
        assert row.speed_mps == pytest.approx(own[inside].mean())
        assert row.n == rows.loc[inside, "group"].nunique()
    sizes = [((a <= own) & (own < b)).sum() for a, b in known[_ENDS].to_numpy()]
    assert sum(sizes) == len(rows)


def test_net_speed_is_that_of_the_true_history(finished):
    shared = stored_rows(finished.out, "raw", "shared")
    noisy = stored_rows(finished.out, "fixed:1", "shared")
    assert np.allclose(shared["speed_mps"], noisy["speed_mps"], rtol=1e-5)
    speeds = shared.groupby("source")["speed_mps"]
    assert np.allclose(
        speeds.min(), speeds.max(), rtol=1e-4
    )  # wherever a scene places it
    assert shared["speed_mps"].between(0.0, 1.4).all()  # the walks' own steps


def test_a_finished_run_has_the_table_again(finished):
    again = load(finished.out).speeds
    assert list(again.columns) == tested.COLUMNS
    assert np.allclose(again["value"], finished.speeds["value"])


def test_a_run_without_these_levels_has_no_row(finished):
    table = tested.by_speed(
        finished.out,
        read_manifest(finished.out) | {"cells": []},
        {},
        families=finished.families,
        best={},
    )
    assert table.empty
    assert list(table.columns) == tested.COLUMNS


def test_the_summary_has_the_worst_off_tenth_of_what_was_shared_and_attacked(finished):
    summary = finished.summary[finished.summary["metric"] == "plr_worst_tenth"]
    cells = {("shared", ""), ("radial_rts", "blind"), ("radial_rts", "informed")}
    assert set(zip(summary["consumer"], summary["knowledge"], strict=True)) >= cells
    rows = strongest_rows(finished)
    halves = []
    for _, releases in rows.groupby("source", observed=True):
        by_scene = releases.sort_values("scene")["plr"].to_numpy()
        assert by_scene.size == 10  # of 24 people in 60 scenes of 4
        halves.append((by_scene[::2].mean(), by_scene[1::2].mean()))
    odd, even = np.array(halves).T
    expected = []
    for chosen, values in ((odd, even), (even, odd)):
        first, second, third = np.argsort(-chosen)[:3]  # 2.4 people
        expected.append((values[first] + values[second] + 0.4 * values[third]) / 2.4)
    row = summary[
        (summary["mechanism"] == "fixed")
        & (summary["level"] == 1.0)
        & (summary["consumer"] == finished.strongest[""].consumer)
        & (summary["knowledge"] == finished.strongest[""].adversary)
    ]
    assert row["value"].item() == pytest.approx(np.mean(expected), abs=1e-6)
    assert row["ci_low"].item() < row["value"].item() < row["ci_high"].item()
    assert row["n"].item() == 24
    assert row["unit"].item() == "fraction"
