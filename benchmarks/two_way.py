"""The effect of shared background agents on intervals: `python -m benchmarks.two_way`.

Intervals of scene rates cluster by the first agent alone. Scenes that share a
background group would covary if it mattered who walks there: the sum of squared group
totals of the missed-rate residuals is compared with what it is when the background
agents are dealt to other scenes (999 permutations); only the excess counts. It is
itself noisy (several tenths for no effect at all): whether there is one is for the
permutations to say. Two made-up cases, with an effect planted and without, show that
the check would see one.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import evaluation
from evaluation.store.cell_files import read_rows
from isac_track.rng import stream

MECHANISMS = ("raw", "fixed:0.7", "fixed:1", "fid:1", "fid:1000")
N_SCENES = 5000


def main() -> int:
    """Print the table; return 0."""
    print(f"{'case':<12}{'times as wide':>15}{'p':>8}")
    cases = {name: planted(is_seen=name == "planted") for name in ("planted", "none")}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        settings = evaluation.Settings(
            dataset="students03",
            scenes=N_SCENES,
            mechanisms=MECHANISMS,
            predictors=("least_squares",),
            attacks=(),
            out=out,
        )
        cells = evaluation.run(settings, pictures=False).manifest["cells"]
        columns = {
            "shared": ["scene", "agent", "group"],
            "least_squares": ["scene", "conflict", "predicted"],
        }
        for name in MECHANISMS:
            entries = {
                cell.address.consumer: cell for cell in cells if cell.spec == name
            }
            agents, scenes = (
                read_rows(out, entries[consumer], columns=wanted).to_pandas()
                for consumer, wanted in columns.items()
            )
            cases[name] = agents, scenes
    for name, (agents, scenes) in cases.items():
        wider, p_value = background_excess(agents, scenes, name)
        print(f"{name:<12}{wider:>15.3f}{p_value:>8.3f}")
    return 0


def background_excess(
    agents: pd.DataFrame, scenes: pd.DataFrame, name: str
) -> tuple[float, float]:
    """Return how much wider an interval with the background would be, and its p-value.

    The variance by first agents is the sum of squares of their group totals.
    """
    groups = {group: row for row, group in enumerate(sorted(set(agents["group"])))}
    placed = agents.assign(row=agents["group"].map(groups).astype(int))
    conflicts = scenes[scenes["conflict"]]
    table = placed.pivot_table(index="scene", columns="agent", values="row")
    role = table.loc[conflicts["scene"]].to_numpy().astype(int)
    residual = (~conflicts["predicted"]).to_numpy().astype(float)
    residual -= residual.mean()

    def squares(members: Any) -> float:  # noqa: ANN401 - an array
        weights = np.repeat(residual, members.shape[1])
        totals = np.bincount(
            members.reshape(-1), weights=weights, minlength=len(groups)
        )
        return float((totals**2).sum())

    first, background = squares(role[:, :1]), squares(role[:, 1:])
    rng = stream(0, "test", "background", name)
    dealt = np.array([squares(rng.permutation(role[:, 1:])) for _ in range(999)])
    p_value = (1 + (dealt >= background).sum()) / 1000
    wider = np.sqrt(1 + max(background - dealt.mean(), 0.0) / first)
    return float(wider), float(p_value)


def planted(*, is_seen: bool) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return made-up agents and scenes, with an effect of the background or without."""
    rng = stream(0, "test", "planted background")
    n_scenes, n_groups = 2000, 40
    person = rng.integers(0, n_groups, (n_scenes, 4))
    effect = rng.normal(0, 0.15, n_groups)
    chance = 0.5 + is_seen * effect[person[:, 1:]].sum(axis=1)
    scene, agent = np.divmod(np.arange(person.size), person.shape[1])
    groups = [f"g{row}" for row in person.ravel()]
    agents = pd.DataFrame({"scene": scene, "agent": agent, "group": groups})
    predicted = rng.random(n_scenes) >= chance
    return agents, pd.DataFrame(
        {"scene": np.arange(n_scenes), "conflict": True, "predicted": predicted}
    )


if __name__ == "__main__":
    sys.exit(main())
