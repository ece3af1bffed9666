"""Every linker of preset `paper` in every task, against its numbers of before.

The preset `smoke` has three linkers and two tasks. Here are all, on few people of plaza
and at a single level. A number that moves on purpose: run with APPROVE=1, and read the
difference.
"""

import os
from pathlib import Path

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from attacks.tasks.task_list import TASKS
from evaluation.compute.link_tables import ESTIMATES
from evaluation.compute.work import compute_cells
from evaluation.plan.plan import make_plan
from evaluation.plan.presets import PRESETS
from evaluation.plan.settings import Settings
from evaluation.pool.pieces import cut_work
from isac_track.config import StageSettings

APPROVED = Path(__file__).with_suffix(".csv")
KEY = ["consumer", "knowledge", "metric"]
ALONE = (
    "identity",
    "moving_average",
    "savgol",
    "kalman_rts",
    "radial_rts",
    "averaging",
)
"""Attacks that link nobody."""
FEW = {"linkage.most_people": 40, "linkage.handover_instants": 2}


def computed():
    """Every stored estimate of all linkers and controls at one level."""
    ready = make_plan(
        Settings(
            preset="paper",
            dataset="plaza",
            scenes=4,
            mechanisms=("fid:1",),
            predictors=(),
            policies=(),
            stages=StageSettings().changed(FEW),
            jobs=1,
            out=Path("not-written"),
        )
    )
    units = [
        unit for unit in ready.units if unit.section in TASKS and unit.mechanism.level
    ]
    rows = []
    with threadpool_limits(limits=1, user_api="blas"):
        for work in cut_work(units, ready):
            for _, _, consumer, tables in compute_cells(
                work, tracks=ready.scene_tracks, stages=ready.settings.stages, seed=0
            ):
                if ESTIMATES in tables:
                    about = {"consumer": consumer.spec, "knowledge": consumer.adversary}
                    rows.append(tables[ESTIMATES].to_pandas().assign(**about))
    return pd.concat(rows)[[*KEY, "value", "ci_low", "ci_high", "n"]]


def test_each_links_as_many_people_as_ever():
    fresh = computed()
    if os.environ.get("APPROVE"):
        fresh.to_csv(APPROVED, index=False)
    approved = pd.read_csv(APPROVED).fillna({"knowledge": ""})
    linked = {name.partition("/")[2] for name in fresh["consumer"]}
    assert {*PRESETS["paper"].attacks} - linked == {*ALONE}
    merged = approved.merge(
        fresh, on=KEY, suffixes=("", "_fresh"), how="outer", indicator=True
    )
    assert (merged["_merge"] == "both").all()
    for name in ("value", "ci_low", "ci_high", "n"):
        actual, expected = merged[f"{name}_fresh"].to_numpy(), merged[name].to_numpy()
        np.testing.assert_allclose(actual, expected, rtol=1e-9, atol=1e-9, err_msg=name)
