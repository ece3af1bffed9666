"""Compare attacks by person: ``python -m benchmarks.paired_attacks ATTACK...``.

PLR after an attack less that of the usual smoothers, in points, paired by person (95 %
intervals), and its cost. An informed adversary learns on the recording's other half or
on another one, a blind one sees the release alone.
"""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.compute.reconstruction import draw_halves
from evaluation.plan.constants import MOST_SCENES
from isac_track import datasets, intervals, plugins, privacy
from isac_track.command_line import DONE, Parser, exit_code
from isac_track.config import StageSettings
from isac_track.protocols import AttackContext, TrainingSet
from isac_track.rng import stream
from isac_track.scenes import Cut, cut, make_scenes
from isac_track.sensing import sense_scenes
from isac_track.types import Floats, Ints, Knowledge

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    from isac_track.plugins import Plugin
    from isac_track.protocols import Reconstructor

LEVELS = ("fid:1", "fid:10", "fid:1000", "fixed:0.7", "fixed:1")
MECHANISMS = (*LEVELS, *(f"{level},adding=independent" for level in LEVELS), "ou:0.3")
OTHERS = ("radial_rts", "kalman_rts")
STAGES = StageSettings()
INFORMED = frozenset({Knowledge.MECHANISM, Knowledge.TRAIN})


def walks(
    tracks: Cut, people: Ints, mechanism: Plugin, *, first: int, seed: int
) -> tuple[TrainingSet, Ints]:
    """Share each of some walks once, as the only agent of a scene.

    Returns the releases with their truth, and the number of each person, (N,).
    """
    scenes = make_scenes(
        tracks, order=people[:, None], first=first, settings=STAGES, seed=seed
    )
    sensed = sense_scenes(scenes, settings=STAGES.sensing, seed=seed)
    release = mechanism.instance.share(sensed, stream(seed, "paired attacks", first))
    person = np.unique(np.array(tracks.group), return_inverse=True)[1][people]
    return TrainingSet(release.without_sigma(), scenes.xy), person


def timed(function: Callable[..., Any], *arguments: object) -> tuple[Any, float]:
    """Return the result of a function, and the time that it took, s."""
    began = time.perf_counter()
    return function(*arguments), time.perf_counter() - began


def fitted(
    attack: Plugin,
    taught: TrainingSet,
    mechanism: Plugin,
    adversary: frozenset[Knowledge],
) -> Reconstructor:
    """Return the fitted attack of an adversary."""
    context = AttackContext(
        rng=stream(0, "paired attacks", attack.spec),
        epsilon_m=STAGES.privacy.epsilon_m,
        granted=adversary & (attack.instance.requires | attack.instance.uses),
        mechanism=mechanism.instance,
        train=taught,
    )
    ready: Reconstructor = attack.instance.fit(context)
    return ready


def plr(attack: Reconstructor, seen: TrainingSet) -> Floats:
    """Return the PLR of each track after an attack, (N,)."""
    release = seen.release
    described_tracks = privacy.described(
        xy=attack(release).xy,
        truth=seen.truth,
        t=release.t,
        offsets=release.offsets,
        settings=STAGES.privacy,
    )
    return np.asarray(described_tracks[0])


def means(rows: Floats, person: Ints) -> list[intervals.Estimate]:
    """Return the mean of each row, (K, N), with the same replicates for all."""
    n = int(person.max()) + 1
    sums = np.stack(
        [
            intervals.cluster_sums(values=row, cluster=person, n_clusters=n)
            for row in rows
        ]
    )
    return intervals.ratio_estimates(
        numerator=sums,
        denominator=np.broadcast_to(
            np.bincount(person, minlength=n), sums.shape
        ).astype(float),
        weights=intervals.cluster_weights(n_clusters=n, n_replicates=2000, seed=0),
        is_share=[False] * len(rows),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    parser = Parser(prog="python -m benchmarks.paired_attacks", description=__doc__)
    parser.add_argument("attack", nargs="+")
    parser.add_argument(
        "--dataset", default="students03", help="the one that is attacked"
    )
    parser.add_argument("--learn-on", help="another one; none: its other half")
    parser.add_argument(
        "--people", type=int, default=500, help="so many tracks are attacked"
    )
    parser.add_argument(
        "--taught", type=int, default=20, help="so many are learnt from"
    )
    parser.add_argument("--passes", type=int, default=4)
    parser.add_argument(
        "--over", action="append", metavar="SPEC", help="attacks to compare with"
    )
    parser.add_argument(
        "--blind", action="store_true", help="the adversary knows nothing"
    )
    parser.add_argument("--mechanism", action="append", metavar="SPEC")
    parser.add_argument("--seed", type=int, default=0)
    return exit_code(lambda: _run(parser.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    seed = options.seed
    attacks = plugins.parse_all("attacks", (*options.attack, *(options.over or OTHERS)))
    rivals = plugins.parse_all("attacks", tuple(options.over or OTHERS))
    adversary = frozenset[Knowledge]() if options.blind else INFORMED
    victims, others = (
        cut(datasets.load(name).tracks, settings=STAGES, seed=seed)
        for name in (options.dataset, options.learn_on or options.dataset)
    )
    attacked = stream(seed, "victims").permutation(len(victims))[: options.people]
    taught = stream(seed, "taught").permutation(len(others))
    parts = [(attacked, taught)]
    if not options.learn_on:
        half = draw_halves(victims.group, seed=seed)
        parts = [
            (attacked[half[attacked] == fold], taught[half[taught] != fold])
            for fold in (0, 1)
        ]
    mechanisms = plugins.parse_all("mechanisms", tuple(options.mechanism or MECHANISMS))
    for mechanism in mechanisms:
        rows, person, fit_s, use_s = [], [], [], []
        for own, learnt in parts:
            training, _ = walks(
                others,
                learnt[: options.taught],
                mechanism,
                first=MOST_SCENES,
                seed=seed,
            )
            runs = [
                timed(fitted, attack, training, mechanism, adversary)
                for attack in attacks
            ]
            ready = [attack for attack, _ in runs]
            fit_s.append([seconds for _, seconds in runs])
            for first in range(0, options.passes * len(victims), len(victims)):
                seen, people = walks(victims, own, mechanism, first=first, seed=seed)
                runs = [timed(plr, attack, seen) for attack in ready]
                rows.append([values for values, _ in runs])
                person.append(people)
                use_s.append([seconds for _, seconds in runs])
        cluster = np.unique(np.concatenate(person), return_inverse=True)[1]
        estimates = means(np.concatenate(rows, axis=1), cluster)
        fit_mean_s = np.mean(fit_s, axis=0)
        use_mean_s = 1000.0 * np.sum(use_s, axis=0) / cluster.size
        specs = [attack.spec for attack in attacks]
        by_spec = dict(zip(specs, estimates, strict=True))
        for i in range(len(options.attack)):
            text = f"{mechanism.spec:24} {specs[i]:12} {100 * estimates[i].value:5.1f}"
            for rival in rivals:
                gain = intervals.difference(estimates[i], by_spec[rival.spec])
                value, low, high = (
                    100.0 * end for end in (gain.value, gain.ci_low, gain.ci_high)
                )
                text += f"  {value:+5.2f} [{low:+.2f}, {high:+.2f}] over {rival.spec}"
            text += f"  {fit_mean_s[i]:.1f} s to fit,"
            text += f" {use_mean_s[i]:.1f} s per 1,000 tracks"
            print(f"{text}, {estimates[i].n} people", flush=True)
    return DONE


if __name__ == "__main__":
    sys.exit(main())
