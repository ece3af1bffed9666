"""How well `radial_rts` infers the error law: `python -m benchmarks.error_law`.

For each recording and law: the share of twenty releases of each level (half the people
of 250 scenes, ten seeds) whose law it infers rightly. Then PLR in 500 scenes with the
radial law built in, inferred blind, and learnt, and the gain of ten passes, with
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
from evaluation.estimates.metrics import PLR
from evaluation.estimates.summary import scene_numbers
from evaluation.plan.address import Address, parse_consumer
from evaluation.plan.axes import expand_axes
from evaluation.plan.presets import PUBLISHED_LEVELS
from isac_track import datasets
from isac_track.config import StageSettings
from isac_track.intervals import percentile_interval
from isac_track.scenes import cut, make_scenes, track_order
from isac_track.sensing import sense_scenes

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isac_track.plugins import Plugin
    from isac_track.types import Release

LEVELS = (
    *PUBLISHED_LEVELS,
    *(f"{level},adding=independent" for level in PUBLISHED_LEVELS[1:]),
)
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
                    is_right = looks_radial(release) == (law == "radial")
                    rights.setdefault(level.spec, []).append(is_right)
            _show(settings, rights)
    return 0


def _releases(
    settings: evaluation.Settings, seed: int
) -> Iterator[tuple[Plugin, Release]]:
    """Yield both halves of the release of every level."""
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
    for level in expand_axes(settings).mechanisms:
        release = sharing.share(level, sensed, "block", 0, seed=seed).without_sigma()
        yield from ((level, release.tracks(half)) for half in block.halves)


def _show(settings: evaluation.Settings, rights: dict[str, list[bool]]) -> None:
    """Print the rows of a recording and law."""
    law = settings.stages.sensing.law
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        manifest = evaluation.run(replace(settings, out=out), pictures=False).manifest
        by_key = scene_numbers(out, manifest).estimates
    for level in expand_axes(settings).mechanisms:

        def plr(attack: str, knowledge: str, mechanism: Plugin = level) -> Address:
            measure = parse_consumer(attack, knowledge).measured(PLR)
            return measure.at(mechanism.name, mechanism.level)

        readers = (
            ("kalman_rts", "blind"),
            (BUILT_IN, "blind"),
            ("radial_rts", "blind"),
            ("radial_rts", "informed"),
        )
        values = [by_key[plr(*reader)] for reader in readers]
        learnt = [by_key[plr(spec, "informed")] for spec in (BUILT_IN, "radial_rts")]
        low, high = percentile_interval(learnt[1].replicates - learnt[0].replicates)
        gain = 100 * (learnt[1].value - learnt[0].value)
        ends = f"{gain:+.1f} [{100 * low:+.1f}, {100 * high:+.1f}]"
        right = f"{sum(rights[level.spec])}/{len(rights[level.spec])}"
        cells = [str(settings.dataset), law, level.spec, right]
        cells += [f"{100 * estimate.value:.1f}" for estimate in values]
        print(f"| {' | '.join([*cells, ends])} |")


if __name__ == "__main__":
    sys.exit(main())
