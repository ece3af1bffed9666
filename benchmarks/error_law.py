"""Does `radial_rts` see the error law, and what is that worth? `python -m benchmarks.error_law`.

For either recording and law: of twenty releases of each level (half the people of 250
scenes, ten seeds) the share whose law is told rightly; then PLR in 500 scenes with the
radial law built in, as inferred blind and as learnt, and what ten passes gain, with
intervals over people.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import evaluation
from attacks.reconstruction.kalman_rts import looks_radial
from evaluation.compute import sharing
from evaluation.compute.reconstruction import attacked_block
from evaluation.estimates.keys import Key
from evaluation.estimates.metrics import EXPOSURE
from evaluation.estimates.summary import estimates
from evaluation.plan.axes import axes
from evaluation.plan.presets import SMOKE_LEVELS
from isac_track import datasets
from isac_track.config import StageSettings
from isac_track.intervals import percentile_interval
from isac_track.scenes import cut, make_scenes, track_order
from isac_track.sensing import sense_scenes

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isac_track.plugins import Plugin
    from isac_track.types import Release

LEVELS = (*SMOKE_LEVELS, *(f"{one},adding=independent" for one in SMOKE_LEVELS[1:]))
BUILT_IN = "radial_rts:passes=5"
N_SEEDS, N_SCENES = 10, 250


def main() -> int:
    """Print both tables; return 0."""
    for name in ("students03", "plaza"):
        for law in ("radial", "isotropic"):
            settings = evaluation.Settings(
                dataset=name,
                scenes=500,
                mechanisms=LEVELS,
                predictors=(),
                attacks=("kalman_rts", BUILT_IN, "radial_rts"),
                tasks=(),
                stages=StageSettings().changed({"sensing.law": law}),
            )
            rights: dict[str, list[bool]] = {}
            for seed in range(N_SEEDS):
                for level, release in _releases(settings, seed):
                    told = looks_radial(release) == (law == "radial")
                    rights.setdefault(level.spec, []).append(told)
            _show(settings, rights)
    return 0


def _releases(
    settings: evaluation.Settings, seed: int
) -> Iterator[tuple[Plugin, Release]]:
    """Yield both halves of what is shared at every level."""
    stages = settings.stages
    tracks = cut(datasets.load(settings.dataset).tracks, settings=stages, seed=seed)
    agents = stages.scenes.agents
    order = track_order(
        n_tracks=len(tracks), n_scenes=N_SCENES, agents=agents, seed=seed
    )
    scenes = make_scenes(tracks, order=order, first=0, settings=stages, seed=seed)
    sensed = sense_scenes(scenes, settings=stages.sensing, seed=seed)
    block = attacked_block(
        scenes=scenes,
        sensed=sensed,
        tracks=tracks,
        repeats=False,
        stages=stages,
        seed=seed,
    )
    for level in axes(settings).mechanisms:
        release = sharing.share(level, sensed, "block", 0, seed=seed).without_sigma()
        yield from ((level, release.tracks(half)) for half in block.halves)


def _show(settings: evaluation.Settings, rights: dict[str, list[bool]]) -> None:
    """Print the rows of a recording and law."""
    law = settings.stages.sensing.law
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        manifest = evaluation.run(replace(settings, out=out), pictures=False).manifest
        found = estimates(out, manifest)[0]
    for level in axes(settings).mechanisms:

        def plr(attack: str, knowledge: str, at: Plugin = level) -> Key:
            return Key(at.name, at.level, attack, EXPOSURE, knowledge)

        sources = ("kalman_rts", "blind"), (BUILT_IN, "blind"), ("radial_rts", "blind")
        values = [found[plr(*one)] for one in (*sources, ("radial_rts", "informed"))]
        learnt = [found[plr(one, "informed")] for one in (BUILT_IN, "radial_rts")]
        low, high = percentile_interval(learnt[1].replicates - learnt[0].replicates)
        gain = 100 * (learnt[1].value - learnt[0].value)
        ends = f"{gain:+.1f} [{100 * low:+.1f}, {100 * high:+.1f}]"
        right = f"{sum(rights[level.spec])}/{len(rights[level.spec])}"
        cells = [str(settings.dataset), law, level.spec, right]
        print(
            f"| {' | '.join([*cells, *(f'{100 * one.value:.1f}' for one in values), ends])} |"
        )


if __name__ == "__main__":
    sys.exit(main())
