"""Closed forms beside the results of a smoother: `python -m benchmarks.closed_form`.

Students03, 250 scenes, isotropic sensing errors, white noise on top: PLR after
`kalman_rts`, with its interval, beside the closed form of the added noise alone and of
every sample's whole error.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

import evaluation
from isac_track import datasets
from isac_track.config import StageSettings
from isac_track.kalman import steady
from isac_track.scenes import cut, make_scenes, track_order
from isac_track.sensing import sense_scenes

STDS_M = (0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0)
NAME, N_SCENES, SEED = "students03", 250, 0
Q = steady.Q_M2_PER_S3


def main() -> int:
    """Print a row for each level; return 0."""
    stages = StageSettings().changed({"sensing.law": "isotropic"})
    rule = "adding=independent,law=isotropic"
    with tempfile.TemporaryDirectory() as folder:
        settings = evaluation.Settings(
            dataset=NAME,
            scenes=N_SCENES,
            seed=SEED,
            jobs=1,
            mechanisms=tuple(f"fixed:{std_m},{rule}" for std_m in STDS_M),
            predictors=(),
            attacks=("kalman_rts",),
            tasks=(),
            stages=stages,
            out=Path(folder) / "run",
        )
        summary = evaluation.run(settings, pictures=False).summary
    is_attack = (summary["consumer"] == "kalman_rts") & (
        summary["knowledge"] == "informed"
    )
    measured = summary[is_attack & (summary["metric"] == "plr")].set_index("level")

    tracks = cut(datasets.load(NAME).tracks, settings=stages, seed=SEED)
    agents = stages.scenes.agents
    order = track_order(
        n_tracks=len(tracks), n_scenes=N_SCENES, agents=agents, seed=SEED
    )
    scenes = make_scenes(tracks, order=order, first=0, settings=stages, seed=SEED)
    raw_m2 = sense_scenes(scenes, settings=stages.sensing, seed=SEED).sigma_raw ** 2
    rest = {"dt_s": steady.INTERVAL_S, "q": Q, "epsilon_m": stages.privacy.epsilon_m}
    print(f"raw std per axis, median: {np.sqrt(np.median(raw_m2)):.2f} m")
    for std_m in STDS_M:
        added_only = steady.attacked_plr(variance_m2=std_m**2, **rest)
        # Variances vary little along a track and much between tracks: the mean over all
        # samples.
        variances = np.quantile(raw_m2, (np.arange(200) + 0.5) / 200) + std_m**2
        total = np.mean(
            [steady.attacked_plr(variance_m2=m2, **rest) for m2 in variances]
        )
        row = measured.loc[std_m]
        low, high = 100 * row["ci_low"], 100 * row["ci_high"]
        value = f"{100 * row['value']:.1f} [{low:.1f}, {high:.1f}]"
        print(f"| {std_m:g} | {value} | {100 * total:.1f} | {100 * added_only:.1f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
