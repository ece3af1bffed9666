"""What is left at a price, over seeds: ``python -m benchmarks.frontier_seeds OUT OUT ...``.

Every number of a level is averaged over the runs, person by person: the people are
drawn once for all seeds, so that an interval is that of people, and an error that is
constant over a track has been drawn as often as there are runs. Linkage is left out.
One run is that run.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from evaluation.estimates.decisions import decisions
from evaluation.estimates.families import families_in
from evaluation.estimates.frontier import frontier
from evaluation.estimates.matching import Sweeps
from evaluation.estimates.summary import estimates
from evaluation.store.manifest import read_manifest
from isac_track.intervals import Estimate

ALL = slice(None)
SHOWN = ["mechanism", "target", "level", "consumer", "value", "ci_low", "ci_high"]


def pooled(outs: Sequence[Path]) -> pd.DataFrame:
    """Return the frontier of runs that differ in their seeds alone.

    ValueError if they are not of one recording.
    """
    manifests: list[dict[str, Any]] = [read_manifest(out) for out in outs]
    if len({one["identity"]["sha256"] for one in manifests}) != 1:
        raise ValueError("the runs are not of one recording")
    groups = sorted({group for one in manifests for group in one["groups"]})
    runs = []
    for out, one in zip(outs, manifests, strict=True):
        same = one | {"groups": groups, "identity": one["identity"] | {"seed": 0}}
        found, scored, attacked = estimates(out, same)
        decided = decisions(scored, same, found, dataset=same["dataset"]["name"])
        runs.append((found | decided[2], attacked, same))
    shared = set.intersection(*(set(of) for of, _, _ in runs))
    found = {
        key: _mean([of[key] for of, _, _ in runs])
        for key in runs[0][0]
        if key in shared
    }
    sums = {
        # Each seed draws people of its own into its scenes.
        key: one._replace(
            sums=np.mean([of[key].whole() for _, of, _ in runs], axis=0), used=ALL
        )
        for key, one in runs[0][1].items()
        if key in shared
    }
    known = families_in(runs[0][2]["cells"])
    known = {
        name: of
        for name, of in known.items()
        if any(key.mechanism == name for key in found)
    }
    predictors = manifests[0]["settings"]["predictors"]
    dataset = manifests[0]["dataset"]["name"]
    return frontier(
        Sweeps(found, known), predictors=predictors, dataset=dataset, sums=sums
    )


def _mean(of: Sequence[Estimate]) -> Estimate:
    drawn = np.mean([one.replicates for one in of], axis=0)
    return replace(
        of[0], value=float(np.mean([one.value for one in of])), replicates=drawn
    )


def main(arguments: Sequence[str]) -> None:
    """Print the attacked PLR of every family at every target, for the robot that is aware."""
    table = pooled([Path(one) for one in arguments])
    of = table[
        (table["criterion"] == "missed_at_equal_false_alarms")
        & (table["metric"] == "plr")
    ]
    of = of[
        of["robot"].str.contains("aware") & of["knowledge"].isin(["blind", "informed"])
    ]
    with pd.option_context("display.width", 200, "display.max_rows", None):
        print(
            of[[*SHOWN, "vs_white", "vs_white_low", "vs_white_high", "n"]].to_string(
                index=False
            )
        )


if __name__ == "__main__":
    main(sys.argv[1:])
