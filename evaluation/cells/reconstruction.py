"""The stage *reconstruction*: what each adversary's reconstruction of a block reveals.

People are split into two halves, whole groups at a time. An attack that learns does so on the
other half; every attack prepares anew for every mechanism level.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from attacks.reconstruction.kalman_rts import KalmanRTS, smooth
from attacks.reconstruction.learning import N_CANDIDATES
from evaluation.cells.adversary import (
    SHOWS,
    fitted,
    granted_at,
    reconstructed,
    turned,
    view_of,
)
from evaluation.cells.descriptors import descriptors, track_columns
from evaluation.cells.plugin_calls import copied
from evaluation.cells.samples import (
    restricted,
    samples_of,
    samples_shared,
    tracks_of,
)
from evaluation.cells.sharing import share
from evaluation.experiment.constants import MOST_SCENES
from isac_track.errors import DataError, PluginError
from isac_track.protocols import TrainingSet
from isac_track.rng import stream
from isac_track.scenes import make_scenes
from isac_track.sensing import sense_scenes
from isac_track.types import Knowledge

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from numpy.random import Generator

    from evaluation.cells.adversary import View
    from evaluation.cells.samples import Samples
    from evaluation.cells.tables import Rows
    from evaluation.experiment.axes import Consumer
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin
    from isac_track.scenes import Cut
    from isac_track.types import Floats, Ints, Release, Scenes, Sensed

N_REPEATS = 2
"""Further releases of the same walks, for who is granted REPEATS."""
TRAINING_PEOPLE = 20
"""At most so many source tracks train an attack: more would cost time and change little."""
BENCHMARK_Q = KalmanRTS.DEFAULT_Q
"""m^2/s^3, motion of the benchmark."""
_FOLDS = (0, 1)
_LEAST_VARIANCE_M2 = 1e-12


@dataclass(frozen=True, eq=False, slots=True)
class Victims:
    """Some tracks of a block, one after the other."""

    rows: Ints
    """(n,) which tracks of the block."""
    offsets: Ints
    """(n + 1,)"""
    t: Floats
    """(m,) s"""
    truth: Floats
    """(m, 2) m"""


@dataclass(frozen=True, eq=False, slots=True)
class AttackedBlock:
    """What all attacks on a block share, whatever the mechanism."""

    scenes: Scenes
    sensed: Sensed
    halves: tuple[Victims, Victims]
    """The tracks of either half of the people."""
    first_halves: tuple[Victims, Victims]
    """The same, only the first release of each source track in the run: for slow attacks."""
    passes: tuple[tuple[Victims, ...], tuple[Victims, ...]]
    """The same, cut by the passes over the recording: in none does a walk occur twice."""
    training: tuple[tuple[Scenes, Sensed] | None, ...]
    """For each part people of the other half, each once; None if there are none. All samples."""
    again: tuple[Sensed, ...]
    """The walks of the block sensed anew, for REPEATS. All samples."""


def folds(groups: tuple[str, ...], *, seed: int) -> Ints:
    """Return the half of each track, (N,) 0 or 1: members of one group stay together."""
    names = sorted(set(groups))
    order = stream(seed, "folds").permutation(len(names))
    half_of = {names[name]: place % 2 for place, name in enumerate(order)}
    return np.array([half_of[group] for group in groups], dtype=np.int64)


def slow_cost_s(consumers: Sequence[Consumer], *, tracks: Cut, n_levels: int) -> float:
    """Return about how long slow attacks take in one process, from what they say of themselves.

    An attack says its ``seconds_per_sample``; one that learns tries a few candidates on the
    training people first. NaN if one does not say.
    """
    n_samples = np.diff(tracks.offsets)
    n_training = 2 * min(TRAINING_PEOPLE, len(tracks) // 2) * float(n_samples.mean())
    total_s = 0.0
    for consumer in consumers:
        assert consumer.plugin is not None
        said = getattr(consumer.plugin.instance, "seconds_per_sample", np.nan)
        each_s = float(said) if isinstance(said, int | float) else np.nan
        learns = Knowledge.TRAIN in consumer.granted
        total_s += each_s * (n_samples.sum() + (N_CANDIDATES * n_training if learns else 0.0))
    return n_levels * total_s


def attacked_block(
    *,
    scenes: Scenes,
    sensed: Sensed,
    tracks: Cut,
    repeats: bool,
    stages: StageSettings,
    seed: int,
) -> AttackedBlock:
    """Prepare a block for its attacks.

    Parameters
    ----------
    scenes, sensed
        The block.
    tracks : Cut
        What the scenes were made of.
    repeats : bool
        Whether an attack is granted REPEATS.
    stages : StageSettings
    seed : int
    """
    half = folds(tracks.group, seed=seed)
    victims_half = half[scenes.track]
    seats = scenes.index[0] * scenes.n_agents + np.arange(scenes.track.size)
    number = seats // len(tracks)  # each pass over the tracks takes each once
    training = []
    for fold in _FOLDS:
        others = _people(half, fold=1 - fold, seed=seed)
        _assert_apart(others, scenes.track[victims_half == fold], tracks=tracks)
        training.append(
            _training(tracks, people=others, fold=fold, stages=stages, seed=seed)
            if others.size
            else None
        )
    again = tuple(
        sense_scenes(scenes, settings=stages.sensing, seed=seed, names=("again", number))
        for number in range(N_REPEATS if repeats else 0)
    )
    first, second = (_victims(scenes, np.flatnonzero(victims_half == fold)) for fold in _FOLDS)
    passes = tuple(
        tuple(
            _victims(scenes, np.flatnonzero((victims_half == fold) & (number == one)))
            for one in np.unique(number[victims_half == fold])
        )
        for fold in _FOLDS
    )
    _assert_distinct(passes, scenes=scenes)
    first_once, second_once = (
        _victims(scenes, np.flatnonzero((victims_half == fold) & (number == 0))) for fold in _FOLDS
    )
    return AttackedBlock(
        scenes=scenes,
        sensed=sensed,
        halves=(first, second),
        first_halves=(first_once, second_once),
        passes=(passes[0], passes[1]),
        training=tuple(training),
        again=again,
    )


def _without(block: AttackedBlock, shared: Samples) -> AttackedBlock:
    """Return a block as it is for a release that left samples out: the same tracks, the rest."""
    scenes = restricted(block.scenes, shared)

    def rest(whole: Victims) -> Victims:
        return _victims(scenes, whole.rows)

    return replace(
        block,
        scenes=scenes,
        sensed=restricted(block.sensed, shared),
        halves=(rest(block.halves[0]), rest(block.halves[1])),
        first_halves=(rest(block.first_halves[0]), rest(block.first_halves[1])),
        passes=(tuple(map(rest, block.passes[0])), tuple(map(rest, block.passes[1]))),
    )


@dataclass(frozen=True, eq=False, slots=True)
class AttackedLevel:
    """What all attacks on one mechanism level of a block share."""

    mechanism: Plugin
    block: AttackedBlock
    """Without the samples that the release left out."""
    key: tuple[str | int, ...]
    """Names of its random streams."""
    release: Release
    victims: tuple[Release, Release]
    """The parts of the release, in the true frame."""
    views: Mapping[tuple[int, frozenset[Knowledge]], View]
    """The same as they show to who is granted SIGMA, SCENE, both or neither."""
    training: Mapping[tuple[int, frozenset[Knowledge]], TrainingSet]
    """People to learn from for each part, in a frame of theirs; none where there are none."""
    again: tuple[Release, ...]
    """Further releases of the same walks, in the true frame."""
    benchmark_mse_m2: Floats
    """(N,) mean over a track's samples of the squared error that the benchmark expects."""
    benchmark_plr: Floats
    """(N,) the benchmark's expected PLR."""


def attacked_level(
    *,
    mechanism: Plugin,
    release: Release,
    block: AttackedBlock,
    consumers: Sequence[Consumer],
    stages: StageSettings,
    seed: int,
) -> AttackedLevel:
    """Prepare a mechanism level for its attacks.

    Parameters
    ----------
    mechanism : Plugin
    release : Release
        What was shared of the block.
    block : AttackedBlock
    consumers : sequence of Consumer
        The attacks.
    stages : StageSettings
    seed : int
    """
    left = samples_shared(release, block.sensed)
    if left is not None:
        block = _without(block, left)
    granted = frozenset[Knowledge]().union(*(consumer.granted for consumer in consumers))
    first_scene = int(block.scenes.index[0])
    key = (mechanism.spec, "scene", first_scene)
    victims = (tracks_of(release, block.halves[0].rows), tracks_of(release, block.halves[1].rows))
    shows = {consumer.granted & SHOWS for consumer in consumers}
    training: dict[tuple[int, frozenset[Knowledge]], TrainingSet] = {}
    for fold, others in enumerate(block.training):
        if others is None or Knowledge.TRAIN not in granted:
            continue
        scenes, sensed = others
        released = share(mechanism, sensed, "training", fold, seed=seed)
        left = samples_shared(released, sensed)
        truth_m = (scenes if left is None else restricted(scenes, left)).xy
        for what in shows:
            view = view_of(released, granted=what, rng=_frame(key, fold, "training", seed=seed))
            truth = turned(truth_m, angle=view.angle, shift=view.shift)
            training[fold, what] = TrainingSet(view.release, truth)
    mse_m2, plr = benchmark(
        release, sensed=block.sensed, mechanism=mechanism, epsilon_m=stages.privacy.epsilon_m
    )
    return AttackedLevel(
        mechanism=mechanism,
        block=block,
        key=key,
        release=release,
        victims=victims,
        views={
            (fold, what): view_of(one, granted=what, rng=_frame(key, fold, seed=seed))
            for fold, one in enumerate(victims)
            if len(one)
            for what in shows
        },
        training=training,
        again=tuple(
            _repeat(
                share(mechanism, sensed, "scenes", first_scene, "again", number, seed=seed),
                of=release,
                by=mechanism,
            )
            for number, sensed in enumerate(block.again)
            if Knowledge.REPEATS in granted
        ),
        benchmark_mse_m2=mse_m2,
        benchmark_plr=plr,
    )


def attack_rows(consumer: Consumer, *, level: AttackedLevel, epsilon_m: float, seed: int) -> Rows:
    """Return the descriptors of every attacked track, in the order of the block.

    Raises
    ------
    PluginError
        If the attack raises or breaks its contract; the message names it.
    DataError
        If there is nobody to learn from.
    """
    rows: list[Ints] = [np.zeros(0, dtype=np.int64)]
    found: list[Rows] = []
    for victims, xy in _attacked(consumer, level=level, epsilon_m=epsilon_m, seed=seed):
        rows.append(victims.rows)
        found.append(
            descriptors(
                xy=xy,
                truth=victims.truth,
                t=victims.t,
                offsets=victims.offsets,
                epsilon_m=epsilon_m,
            )
        )
    joined = np.concatenate(rows)
    order = np.argsort(joined)
    in_order = joined[order]
    none = descriptors(
        xy=np.zeros((0, 2)),
        truth=np.zeros((0, 2)),
        t=np.zeros(0),
        offsets=np.zeros(1, dtype=np.int64),
        epsilon_m=epsilon_m,
    )
    return {
        **track_columns(level.block.scenes, in_order),
        **{name: np.concatenate([one[name] for one in (*found, none)])[order] for name in none},
        "benchmark_mse_m2": level.benchmark_mse_m2[in_order],
        "benchmark_plr": level.benchmark_plr[in_order],
    }


def benchmark(
    release: Release, *, sensed: Sensed, mechanism: Plugin, epsilon_m: float
) -> tuple[Floats, Floats]:
    """Return mean squared error and PLR that the linear benchmark expects of each track, (N,).

    The benchmark is the exact smoother of a constant-velocity walk that knows the variance of
    every sample: no linear estimator has a smaller expected squared error, and none at all if the
    errors are Gaussian. Its posterior covariance P per axis depends on no position: the expected
    squared error is 2 P, and a Gaussian error of that size leaks with probability
    1 - exp(-epsilon^2 / 2P). NaN for a mechanism that declares no sigma, and for one that says
    (`errors_are_independent`) that its errors depend on each other from sample to sample.
    """
    n_samples = np.diff(release.offsets)
    independent = getattr(mechanism.instance, "errors_are_independent", True)
    if release.sigma is None or not independent:
        return np.full(n_samples.size, np.nan), np.full(n_samples.size, np.nan)
    law = getattr(mechanism.instance, "law", None) or sensed.law
    shared_m2, raw_m2 = release.sigma**2, sensed.sigma_raw**2
    # What a mechanism takes away it takes from the raw error, what it adds has its own law.
    variance = per_axis(sensed.law) * np.minimum(shared_m2, raw_m2)
    variance += per_axis(law) * np.maximum(shared_m2 - raw_m2, 0.0)
    std = smooth(release, np.maximum(variance, _LEAST_VARIANCE_M2), q=BENCHMARK_Q).std
    assert std is not None
    posterior = std**2
    leaks = -np.expm1(-(epsilon_m**2) / (2.0 * posterior))
    starts = release.offsets[:-1]
    return (
        np.add.reduceat(2.0 * posterior, starts) / n_samples,
        np.add.reduceat(leaks, starts) / n_samples,
    )


def per_axis(law: str) -> float:
    """Return the variance per axis of an error of standard deviation 1 under a law."""
    return 0.5 if law == "radial" else 1.0


def _attacked(
    consumer: Consumer, *, level: AttackedLevel, epsilon_m: float, seed: int
) -> Iterator[tuple[Victims, Floats]]:
    """Yield the victims and their reconstructed positions in the true frame, (m, 2) m.

    A release holds every walk once: of two copies an adversary could make one better one. The
    built-in attacks work track by track (tested) and take all passes in one call.
    """
    assert consumer.plugin is not None
    who = f"attack {consumer.label}"
    granted = granted_at(
        consumer.granted,
        consumer.plugin,
        who=who,
        mechanism=level.mechanism,
        has_sigma=level.release.sigma is not None,
    )
    shows = consumer.granted & SHOWS
    whole = consumer.is_built_in and not consumer.is_slow
    for fold in _FOLDS:
        if consumer.is_slow:
            passes: tuple[Victims, ...] = (level.block.first_halves[fold],)
        else:
            passes = (level.block.halves[fold],) if whole else level.block.passes[fold]
        attack: Callable[..., object] | None = None
        for number, victims in enumerate(passes):
            if not victims.rows.size:
                continue
            training = level.training.get((fold, shows))
            if whole:
                own, view = level.victims[fold], level.views[fold, shows]
                release = view.release
            else:
                own = tracks_of(level.release, victims.rows)
                rng = _frame(level.key, fold, "pass", number, seed=seed)
                view = view_of(own, granted=granted, rng=rng)
                # A stranger may unlock arrays: what it writes to is its own.
                release = copied(view.release)
                if training is not None:
                    training = TrainingSet(copied(training.release), training.truth.copy())
            if attack is None or Knowledge.REPEATS in granted:
                attack = _fitted(
                    consumer,
                    granted=granted,
                    level=level,
                    victims=victims,
                    fold=fold,
                    training=training,
                    epsilon_m=epsilon_m,
                    seed=seed,
                )
            found = reconstructed(attack, release, who=who)
            # Only the correction is turned back: what is left alone stays as it was, bit by bit.
            yield victims, own.xy + turned(found - view.release.xy, angle=-view.angle)


def _fitted(
    consumer: Consumer,
    *,
    granted: frozenset[Knowledge],
    level: AttackedLevel,
    victims: Victims,
    fold: int,
    training: TrainingSet | None,
    epsilon_m: float,
    seed: int,
) -> Callable[..., object]:
    assert consumer.plugin is not None
    if Knowledge.TRAIN in granted and training is None:
        raise DataError(
            f"attack {consumer.spec!r} learns from other people, but all tracks belong to one "
            "person or group; use a recording of more people or leave the attack out"
        )
    repeats = tuple(
        view_of(
            tracks_of(release, victims.rows),
            granted=granted,
            rng=_frame(level.key, fold, "again", number, seed=seed),
        ).release
        for number, release in enumerate(level.again)
        if Knowledge.REPEATS in granted
    )
    return fitted(
        consumer.plugin,
        who=f"attack {consumer.label}",
        granted=granted,
        mechanism=level.mechanism,
        rng=stream(seed, "attacks", consumer.spec, consumer.knowledge, *level.key, "part", fold),
        epsilon_m=epsilon_m,
        train=training,
        repeats=repeats,
    )


def _frame(key: tuple[str | int, ...], fold: int, *names: str | int, seed: int) -> Generator:
    """Return the stream of a frame: one for each release, whoever attacks it."""
    return stream(seed, "frames", *key, "part", fold, *names)


def _victims(scenes: Scenes, rows: Ints) -> Victims:
    samples = samples_of(scenes.offsets, rows)
    return Victims(
        rows=rows,
        offsets=samples.offsets,
        t=scenes.t[samples.rows],
        truth=scenes.xy.take(samples.rows, axis=0),
    )


def _repeat(again: Release, *, of: Release, by: Plugin) -> Release:
    """Return a further release of the same walks; it has to be at the same instants.

    Raises
    ------
    PluginError
    """
    if not (np.array_equal(again.offsets, of.offsets) and np.array_equal(again.t, of.t)):
        raise PluginError(
            f"mechanism {by.spec!r} leaves out other samples when the same walks are shared again; "
            "an attack that is granted REPEATS gets them at the same instants: leave samples out "
            "by their times, or leave out the attacks that use repeats"
        )
    return again


def _people(half: Ints, *, fold: int, seed: int) -> Ints:
    """Return which tracks of a half train an attack."""
    rows = np.flatnonzero(half == fold)
    drawn: Ints = stream(seed, "training", fold).permutation(rows)[:TRAINING_PEOPLE]
    return drawn


def _assert_apart(training: Ints, victims: Ints, *, tracks: Cut) -> None:
    """Assert that nobody is attacked by who learnt from them or from their group."""
    taught = {tracks.group[row] for row in training}
    if any(tracks.group[row] in taught for row in np.unique(victims)):
        raise AssertionError("a victim's group is among the training people")


def _assert_distinct(passes: tuple[tuple[Victims, ...], ...], *, scenes: Scenes) -> None:
    """Assert that no release shows a walk twice."""
    for victims in (one for half in passes for one in half):
        walks = scenes.track[victims.rows]
        if np.unique(walks).size < walks.size:
            raise AssertionError("a walk occurs twice in one pass")


def _training(
    tracks: Cut, *, people: Ints, fold: int, stages: StageSettings, seed: int
) -> tuple[Scenes, Sensed]:
    """Return training walks, placed and sensed like those of a scene's first agent."""
    scenes = make_scenes(
        tracks,
        order=people[:, None],
        first=MOST_SCENES + fold * len(tracks),  # beyond the scenes of any run
        settings=stages,
        seed=seed,
    )
    return scenes, sense_scenes(scenes, settings=stages.sensing, seed=seed)
