"""The frontier over seeds: ``python -m benchmarks.frontier_seeds OUT OUT ...``.

Every number of a level is averaged over the runs, person by person. The people are
drawn once for all seeds, so that an interval is over people. An error that is constant
over a track is drawn in each run. Linkage is left out.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from evaluation.estimates.decisions import decisions
from evaluation.estimates.families import entry_families
from evaluation.estimates.frontier import frontier
from evaluation.estimates.summary import scene_numbers
from evaluation.estimates.sweeps import Sweeps
from evaluation.store.manifest import read_manifest
from isac_track.intervals import Estimate

ALL = slice(None)
SHOWN = ["mechanism", "target", "level", "consumer", "value", "ci_low", "ci_high"]


def pooled(outs: Sequence[Path]) -> pd.DataFrame:
    """Return the frontier of runs that differ only in their seeds.

    Raises ValueError if they are not of the same recording.
    """
    manifests: list[dict[str, Any]] = [read_manifest(out) for out in outs]
    if len({manifest["identity"]["sha256"] for manifest in manifests}) != 1:
        raise ValueError("the runs are not of one recording")
    groups = sorted({group for manifest in manifests for group in manifest["groups"]})
    runs = []
    for out, manifest in zip(outs, manifests, strict=True):
        identity = manifest["identity"] | {"seed": 0}
        same = manifest | {"groups": groups, "identity": identity}
        numbers = scene_numbers(out, same)
        decided = decisions(numbers, same, dataset=same["dataset"]["name"])
        estimates = numbers.estimates | decided.at_raw_alarms
        runs.append((estimates, numbers.attacked, same))
    shared = set.intersection(*(set(numbers) for numbers, _, _ in runs))
    means = {
        key: _mean([numbers[key] for numbers, _, _ in runs])
        for key in runs[0][0]
        if key in shared
    }
    sums = {}
    for key, first in runs[0][1].items():
        if key in shared:
            # Each seed draws people of its own into its scenes.
            totals = [attacked[key].whole() for _, attacked, _ in runs]
            sums[key] = first._replace(sums=np.mean(totals, axis=0), used=ALL)
    mechanisms = {key.mechanism for key in means}
    known = {
        name: family
        for name, family in entry_families(runs[0][2]["cells"]).items()
        if name in mechanisms
    }
    predictors = manifests[0]["settings"]["predictors"]
    dataset = manifests[0]["dataset"]["name"]
    return frontier(
        Sweeps(means, known), predictors=predictors, dataset=dataset, sums=sums
    )


def _mean(estimates: Sequence[Estimate]) -> Estimate:
    """Return the mean of the estimates of several seeds, with mean replicates."""
    replicates = np.mean([estimate.replicates for estimate in estimates], axis=0)
    value = float(np.mean([estimate.value for estimate in estimates]))
    return replace(estimates[0], value=value, replicates=replicates)


def main(arguments: Sequence[str]) -> None:
    """Print attacked PLR of every family at every target, for the aware robot."""
    table = pooled([Path(out) for out in arguments])
    is_shown = (
        (table["criterion"] == "missed_at_equal_false_alarms")
        & (table["metric"] == "plr")
        & table["robot"].str.contains("aware")
        & table["knowledge"].isin(["blind", "informed"])
    )
    columns = [*SHOWN, "vs_white", "vs_white_low", "vs_white_high", "n"]
    with pd.option_context("display.width", 200, "display.max_rows", None):
        print(table.loc[is_shown, columns].to_string(index=False))


if __name__ == "__main__":
    main(sys.argv[1:])
