"""Attacks beside the optimum of model worlds, in a run from settings to sentences."""

from dataclasses import replace

import pandas as pd
import pytest

from evaluation import Settings, run
from evaluation.estimates.bounds import ClosestAttack, gaps
from evaluation.estimates.weak_attacks import far_from_optimum, lines
from evaluation.plan.address import parse_consumer
from evaluation.plan.presets import DEFAULT, PRESETS
from evaluation.plan.world import World
from evaluation.reporting.bounds import bound_table, gap_text, linked_bound_table
from isac_track.config import StageSettings
from isac_track.intervals import Estimate

CERTAIN = Estimate(1.0, 1.0, 1.0)


def test_in_worlds_of_the_fitted_motion_attacks_stand_beside_the_optimum(
    csv_recording, tmp_path, monkeypatch
):
    axes = {
        "mechanisms": ("raw", "fixed:0.5"),
        "tasks": (),
        "scenes": 4,
        "other_law_mechanisms": (),
    }
    axes |= {"attacks": ("identity", "kalman_rts", "averaging")}
    axes |= {"predictors": (), "protections": (), "policies": ()}
    model = replace(
        PRESETS["paper"], utility_scenes=4, model_mechanisms=("fixed:0.5",), **axes
    )
    monkeypatch.setitem(PRESETS, DEFAULT, model)
    usual = Settings(dataset=str(csv_recording), jobs=1, out=tmp_path / "model")
    results = run(usual, pictures=False)
    plain = replace(usual, mechanisms=("raw", "fixed:0.5"), out=tmp_path / "a")
    alone = run(plain, pictures=False)
    own = results.summary[results.summary["dataset"] == results.dataset].reset_index(
        drop=True
    )
    pd.testing.assert_frame_equal(own, alone.summary, check_exact=True)
    keys = ["dataset", "consumer", "knowledge", "metric"]
    rows = results.summary.fillna({"knowledge": ""}).set_index(keys)["value"].to_dict()
    radial, isotropic = (
        f"{results.dataset}:model",
        f"{results.dataset}:model,law=isotropic",
    )
    assert {world for world, *_ in rows} == {results.dataset, radial, isotropic}
    # Only of Gaussian errors the genie's is the exact posterior.
    assert (radial, "bound", "", "plr_optimum") not in rows
    ceiling = {
        world: rows[world, "bound", "", "plr_ceiling"] for world in (radial, isotropic)
    }
    assert rows[isotropic, "bound", "", "plr_optimum"] == ceiling[isotropic]
    gap = {
        world: rows[world, "kalman_rts", "blind", "plr_gap"]
        for world in (radial, isotropic)
    }
    for world in (radial, isotropic):
        reached = rows[world, "kalman_rts", "blind", "plr"]
        assert gap[world] == pytest.approx(ceiling[world] - reached)
        # Who has further releases of the walk is beyond the bound.
        assert (world, "averaging", "oracle", "plr") in rows
        assert (world, "averaging", "oracle", "plr_gap") not in rows
    assert abs(gap[isotropic]) < gap[radial]
    assert len(bound_table(results).rows) == 2
    assert [gap_row.mechanism_level for gap_row in gaps(results.summary)] == [
        ("fixed", 0.5)
    ] * 2
    assert {gap_row.attack.consumer for gap_row in gaps(results.summary)} == {
        "kalman_rts"
    }
    assert gap_text(gaps(results.summary), ("fixed", 0.5)).startswith(
        "In the model world the closest attack lacks at most "
    )


def test_linkers_stand_beside_the_optimal_ratio_where_errors_are_gaussian(
    tmp_path, monkeypatch
):
    axes = {
        "mechanisms": ("raw", "fixed:0.5"),
        "tasks": ("rerelease",),
        "predictors": (),
        "policies": (),
    }
    axes |= {"attacks": ("shape",), "protections": (), "other_law_mechanisms": ()}
    model = {
        "model_mechanisms": ("fixed:0.5",),
        "model_linked_mechanisms": ("fixed:0.5",),
        "model_people": 40,
    }
    monkeypatch.setitem(
        PRESETS, DEFAULT, replace(PRESETS["paper"], scenes=4, **axes, **model)
    )
    stages = StageSettings().changed({"linkage.most_people": 60})
    results = run(
        Settings(dataset="plaza", jobs=1, out=tmp_path / "model", stages=stages)
    )
    rows = results.summary.fillna({"knowledge": ""})
    linked = rows[rows["dataset"] == "plaza:model,law=isotropic"]
    linked = linked.set_index(["consumer", "knowledge", "metric"])[
        ["value", "ci_low", "ci_high"]
    ]
    best, gap = (
        linked.loc[at]
        for at in (
            ("rerelease/bound", "", "rank1_optimum"),
            ("rerelease/shape", "blind", "rank1_gap"),
        )
    )
    reached = linked.loc["rerelease/shape", "blind", "rank1"]["value"]
    assert gap["value"] == pytest.approx(best["value"] - reached)
    assert gap["ci_low"] < gap["value"] < gap["ci_high"]
    assert gap["ci_high"] > 0.0  # nobody surely beats the optimum
    assert not (
        rows["dataset"] == "plaza:model"
    ).any()  # nobody rebuilds, and these are radial
    text = gap_text(gaps(results.summary), ("fixed", 0.5), "rerelease")
    # Of the adversaries that of whom the optimum is closest.
    closest = min(
        linked.loc["rerelease/shape", knowledge, "rank1_gap"]["value"]
        for knowledge in ("blind", "informed")
    )
    assert (
        text
        == f"In the model world the closest attack lacks {max(100 * closest, 0):.1f} of"
        " 100 people of the optimum."
    )
    table = linked_bound_table(results)
    assert len(table.rows) == 1
    page = (results.out / "report.html").read_text(encoding="utf-8")
    assert page.count(f'aria-label="Table: {table.title}"') == 1
    # What a person sees of the recording has none of it.
    assert set(results.linkability["consumer"]) >= {"rerelease/shape"}
    assert not results.linkability["consumer"].str.contains("bound").any()


def test_who_is_far_from_the_optimum_even_where_he_is_closest_is_flagged():
    near, far = (
        ClosestAttack(
            World(is_model=True),
            ("fid", 1.0),
            parse_consumer(name, "blind"),
            Estimate(0.6, 0.5, 0.7),
            gap,
            CERTAIN,
            True,
        )
        for name, gap in (
            ("a", Estimate(0.06, 0.04, 0.08)),
            ("b", Estimate(0.2, 0.1, 0.3)),
        )
    )
    ceiling = far._replace(is_exact=False)  # of a genie: nobody need reach it
    rows = far_from_optimum([near, far, ceiling])
    assert rows["attack"].tolist() == ["b"]
    assert rows["compared"].tolist() == [2]
    (line,) = lines(rows)
    assert (
        "b (blind) is closest to the optimum at 1 of 2 levels of model worlds" in line
    )
