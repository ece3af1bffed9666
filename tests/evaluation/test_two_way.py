"""Checked once: does it matter that scenes share their background agents, too?"""

import numpy as np
import pandas as pd
import pytest

import evaluation
from isac_track.rng import stream

N_REPLICATES = 4000


@pytest.mark.slow
def test_clustering_by_the_first_agent_is_wide_enough(students03, tmp_path):
    """The one-way interval against a two-way (pigeonhole) bootstrap, Owen (2007).

    A scene weighs the product of how often its first agent's group and its background agents'
    groups are drawn, each side with draws of its own.
    """
    assert students03.name == "students03"
    out = tmp_path / "run"
    settings = evaluation.Settings(dataset="students03", mechanisms=("fixed:0.7",), out=out)
    evaluation.run(settings)
    agents = pd.concat(pd.read_parquet(path) for path in sorted((out / "cells").glob("*shared*")))
    scenes = pd.concat(pd.read_parquet(path) for path in sorted((out / "cells").glob("*least*")))
    groups = {name: row for row, name in enumerate(sorted(set(agents["group"])))}
    role = agents.assign(group=agents["group"].map(groups).astype(int)).pivot_table(
        index="scene", columns="agent", values="group"
    )
    role = role.loc[scenes["scene"]].to_numpy().astype(int)
    hit = (~scenes["predicted"] & scenes["conflict"]).to_numpy()
    conflict = scenes["conflict"].to_numpy()
    rng = stream(0, "test", "two-way")
    draw = np.full(len(groups), 1 / len(groups))
    one_way, two_way = [], []
    for _ in range(N_REPLICATES):
        first = rng.multinomial(len(groups), draw)[role[:, 0]]
        background = rng.multinomial(len(groups), draw)[role[:, 1:]].mean(axis=1)
        one_way.append((first * hit).sum() / (first * conflict).sum())
        weight = first * background
        two_way.append((weight * hit).sum() / (weight * conflict).sum())
    narrow, wide = (np.ptp(np.quantile(values, [0.025, 0.975])) for values in (one_way, two_way))
    assert wide / narrow < 1.25, f"one-way {narrow:.4f}, two-way {wide:.4f}"
