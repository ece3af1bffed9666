"""What an adversary is given of a block of scenes, and what its reconstruction reveals.

People are split into two halves, whole groups at a time. An attack that learns does so on the
other half; every attack prepares anew for every mechanism level.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from attacks.reconstruction.kalman_rts import KalmanRTS, smooth
from attacks.reconstruction.learning import N_CANDIDATES
from evaluation.cells.left_out import kept, reduced
from evaluation.cells.plugin_calls import copied, guarded
from evaluation.experiment.presets import MOST_SCENES
from isac_track import privacy
from isac_track.errors import DataError, PluginError
from isac_track.protocols import AttackContext, TrainingSet
from isac_track.rng import stream
from isac_track.scenes import make_scenes
from isac_track.sensing import sense_scenes
from isac_track.types import Knowledge, Reconstruction, Release

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from numpy.random import Generator

    from evaluation.cells.left_out import Kept
    from evaluation.experiment.axes import Consumer
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin
    from isac_track.scenes import Cut
    from isac_track.types import Floats, Ints, Scenes, Sensed

N_REPEATS = 2
"""Further releases of the same walks, for who is granted REPEATS."""
TRAINING_PEOPLE = 20
"""At most so many source tracks train an attack: more would cost time and change little."""
BENCHMARK_Q = KalmanRTS.DEFAULT_Q
"""m^2/s^3, motion of the benchmark."""
_FOLDS = (0, 1)
_SHOWS = frozenset({Knowledge.SIGMA, Knowledge.SCENE})
"""Knowledge that shows in the release itself."""
_FAR_M = 1000.0
_LONG_S = 86_400.0
_LEAST_VARIANCE_M2 = 1e-12

Rows: TypeAlias = dict[str, np.ndarray[Any, np.dtype[Any]]]
Share: TypeAlias = "Callable[[Sensed, tuple[str | int, ...]], Release]"


@dataclass(frozen=True, eq=False, slots=True)
class Part:
    """Some tracks of a block, one after the other."""

    rows: Ints
    """(n,) which tracks of the block."""
    samples: Ints
    """(m,) which samples of the block."""
    offsets: Ints
    """(n + 1,)"""
    t: Floats
    """(m,) s"""
    truth: Floats
    """(m, 2) m"""


@dataclass(frozen=True, eq=False, slots=True)
class Ground:
    """What all attacks on a block share, whatever the mechanism."""

    scenes: Scenes
    sensed: Sensed
    parts: tuple[Part, Part]
    """The tracks of either half of the people."""
    first_parts: tuple[Part, Part]
    """The same, only the first release of each source track in the run: for slow attacks."""
    passes: tuple[tuple[Part, ...], tuple[Part, ...]]
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


def ground(
    *,
    scenes: Scenes,
    sensed: Sensed,
    tracks: Cut,
    repeats: bool,
    stages: StageSettings,
    seed: int,
) -> Ground:
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
    first, second = (_part(scenes, np.flatnonzero(victims_half == fold)) for fold in _FOLDS)
    passes = tuple(
        tuple(
            _part(scenes, np.flatnonzero((victims_half == fold) & (number == one)))
            for one in np.unique(number[victims_half == fold])
        )
        for fold in _FOLDS
    )
    _assert_distinct(passes, scenes=scenes)
    first_once, second_once = (
        _part(scenes, np.flatnonzero((victims_half == fold) & (number == 0))) for fold in _FOLDS
    )
    return Ground(
        scenes=scenes,
        sensed=sensed,
        parts=(first, second),
        first_parts=(first_once, second_once),
        passes=(passes[0], passes[1]),
        training=tuple(training),
        again=again,
    )


def ground_without(ground: Ground, left: Kept) -> Ground:
    """Return a block as it is for a release that left samples out: the same tracks, the rest."""
    scenes = reduced(ground.scenes, left)

    def part(whole: Part) -> Part:
        return _part(scenes, whole.rows)

    return replace(
        ground,
        scenes=scenes,
        sensed=reduced(ground.sensed, left),
        parts=(part(ground.parts[0]), part(ground.parts[1])),
        first_parts=(part(ground.first_parts[0]), part(ground.first_parts[1])),
        passes=(tuple(map(part, ground.passes[0])), tuple(map(part, ground.passes[1]))),
    )


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """A release in an adversary's frame: turned by the angle, then shifted."""

    release: Release
    angle: float
    """radians"""
    shift: Floats
    """(2,) m"""


@dataclass(frozen=True, eq=False, slots=True)
class Level:
    """What all attacks on one mechanism level of a block share."""

    mechanism: Plugin
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


def level(
    *,
    mechanism: Plugin,
    release: Release,
    share: Share,
    ground: Ground,
    consumers: Sequence[Consumer],
    stages: StageSettings,
    seed: int,
) -> Level:
    """Prepare a mechanism level for its attacks.

    Parameters
    ----------
    mechanism : Plugin
    release : Release
        What was shared of the block.
    share : callable
        From what was sensed and the name of a stream to a release of the mechanism.
    ground : Ground
    consumers : sequence of Consumer
        The attacks.
    stages : StageSettings
    seed : int
    """
    granted = frozenset[Knowledge]().union(*(consumer.granted for consumer in consumers))
    first_scene = int(ground.scenes.index[0])
    key = (mechanism.spec, "scene", first_scene)
    victims = (_taken(release, ground.parts[0]), _taken(release, ground.parts[1]))
    shows = {consumer.granted & _SHOWS for consumer in consumers}
    training: dict[tuple[int, frozenset[Knowledge]], TrainingSet] = {}
    for fold, others in enumerate(ground.training):
        if others is None or Knowledge.TRAIN not in granted:
            continue
        scenes, sensed = others
        released = share(sensed, ("training", fold))
        left = kept(released, sensed)
        truth_m = (scenes if left is None else reduced(scenes, left)).xy
        for what in shows:
            view = seen(released, granted=what, rng=_frame(key, fold, "training", seed=seed))
            truth = _turned(truth_m, angle=view.angle, shift=view.shift)
            training[fold, what] = TrainingSet(view.release, truth)
    mse_m2, plr = benchmark(
        release, sensed=ground.sensed, mechanism=mechanism, epsilon_m=stages.privacy.epsilon_m
    )
    return Level(
        mechanism=mechanism,
        key=key,
        release=release,
        victims=victims,
        views={
            (fold, what): seen(one, granted=what, rng=_frame(key, fold, seed=seed))
            for fold, one in enumerate(victims)
            if len(one)
            for what in shows
        },
        training=training,
        again=tuple(
            _repeat(
                share(sensed, ("scenes", first_scene, "again", number)), of=release, by=mechanism
            )
            for number, sensed in enumerate(ground.again)
            if Knowledge.REPEATS in granted
        ),
        benchmark_mse_m2=mse_m2,
        benchmark_plr=plr,
    )


def attack_rows(
    consumer: Consumer, *, level: Level, ground: Ground, epsilon_m: float, seed: int
) -> Rows:
    """Return the descriptors of every attacked track, in the order of the block.

    Raises
    ------
    PluginError
        If the attack raises or breaks its contract; the message names it.
    DataError
        If there is nobody to learn from.
    """
    parts: list[Part] = []
    found: list[Rows] = []
    for part, xy in _attacked(consumer, level=level, ground=ground, epsilon_m=epsilon_m, seed=seed):
        parts.append(part)
        found.append(
            descriptors(
                xy=xy, truth=part.truth, t=part.t, offsets=part.offsets, epsilon_m=epsilon_m
            )
        )
    rows = np.concatenate([*(part.rows for part in parts), np.zeros(0, dtype=np.int64)])
    order = np.argsort(rows)
    rows = rows[order]
    names = descriptors(
        xy=np.zeros((0, 2)),
        truth=np.zeros((0, 2)),
        t=np.zeros(0),
        offsets=np.zeros(1, dtype=np.int64),
        epsilon_m=epsilon_m,
    )
    joined = {name: np.concatenate([one[name] for one in (*found, names)])[order] for name in names}
    return {
        **track_columns(ground.scenes, rows),
        **joined,
        "benchmark_mse_m2": level.benchmark_mse_m2[rows],
        "benchmark_plr": level.benchmark_plr[rows],
    }


def track_columns(scenes: Scenes, rows: Ints) -> Rows:
    """Return what names the tracks of a block: scene, agent and source track."""
    return {
        "scene": np.repeat(scenes.index, scenes.n_agents)[rows],
        "agent": np.tile(np.arange(scenes.n_agents), len(scenes))[rows],
        "track": scenes.track[rows],
        "n_samples": np.diff(scenes.offsets)[rows],
    }


def descriptors(*, xy: Floats, truth: Floats, t: Floats, offsets: Ints, epsilon_m: float) -> Rows:
    """Return PLR, AEL, MEL and mean squared error of every track, shared or reconstructed.

    Parameters
    ----------
    xy, truth : (M, 2) m
    t : (M,) s
    offsets : (N + 1,) int
    epsilon_m : float
    """
    away_m = privacy.distance_m(shared_xy=xy, true_xy=truth)
    # `privacy.leakage_indicator`, on a distance that the squared error needs as well
    exposure = privacy.exposure(leaked=away_m < epsilon_m, t=t, offsets=offsets)
    starts = offsets[:-1]
    return {
        "plr": exposure.plr,
        "ael_s": exposure.ael_s,
        "mel_s": exposure.mel_s,
        "segments": exposure.segments,
        "mse_m2": np.add.reduceat(away_m**2, starts) / np.diff(offsets)
        if starts.size
        else np.zeros(0),
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
    consumer: Consumer, *, level: Level, ground: Ground, epsilon_m: float, seed: int
) -> Iterator[tuple[Part, Floats]]:
    """Yield the attacked parts and their reconstructed positions in the true frame, (m, 2) m.

    A release holds every walk once: of two copies an adversary could make one better one. The
    built-in attacks work track by track (tested) and take all passes in one call.
    """
    granted = _granted(consumer, level=level)
    shows = consumer.granted & _SHOWS
    whole = consumer.is_built_in and not consumer.is_slow
    for fold in _FOLDS:
        if consumer.is_slow:
            parts: tuple[Part, ...] = (ground.first_parts[fold],)
        else:
            parts = (ground.parts[fold],) if whole else ground.passes[fold]
        fitted: Callable[[Release], Reconstruction] | None = None
        for number, part in enumerate(parts):
            if not part.rows.size:
                continue
            if whole:
                own, view = level.victims[fold], level.views[fold, shows]
                release, training = view.release, level.training.get((fold, shows))
            else:
                own = _taken(level.release, part)
                rng = _frame(level.key, fold, "pass", number, seed=seed)
                view = seen(own, granted=granted, rng=rng)
                # A stranger may unlock arrays: what it writes to is its own.
                release = copied(view.release)
                training = level.training.get((fold, shows))
                if training is not None:
                    training = TrainingSet(copied(training.release), training.truth.copy())
            if fitted is None or Knowledge.REPEATS in granted:
                fitted = _fitted(
                    consumer,
                    granted=granted,
                    level=level,
                    part=part,
                    fold=fold,
                    training=training,
                    epsilon_m=epsilon_m,
                    seed=seed,
                )
            found = _called(fitted, release, consumer=consumer)
            # Only the correction is turned back: what is left alone stays as it was, bit by bit.
            yield part, own.xy + _turned(found - view.release.xy, angle=-view.angle)


def _granted(consumer: Consumer, *, level: Level) -> frozenset[Knowledge]:
    """Return what an attack gets: without SIGMA where the mechanism declares none."""
    assert consumer.plugin is not None
    if Knowledge.SIGMA not in consumer.granted or level.release.sigma is not None:
        return consumer.granted
    if Knowledge.SIGMA in consumer.plugin.instance.requires:
        raise PluginError(
            f"attack {consumer.label} requires SIGMA, but mechanism {level.mechanism.spec!r} "
            "declares none; leave one of the two out"
        )
    return consumer.granted - {Knowledge.SIGMA}


def _fitted(
    consumer: Consumer,
    *,
    granted: frozenset[Knowledge],
    level: Level,
    part: Part,
    fold: int,
    training: TrainingSet | None,
    epsilon_m: float,
    seed: int,
) -> Callable[[Release], Reconstruction]:
    assert consumer.plugin is not None
    if Knowledge.TRAIN in granted and training is None:
        raise DataError(
            f"attack {consumer.spec!r} learns from other people, but all tracks belong to one "
            "person or group; use a recording of more people or leave the attack out"
        )
    repeats = tuple(
        seen(
            _taken(release, part),
            granted=granted,
            rng=_frame(level.key, fold, "again", number, seed=seed),
        ).release
        for number, release in enumerate(level.again)
        if Knowledge.REPEATS in granted
    )
    context = AttackContext(
        rng=stream(seed, "attacks", consumer.spec, consumer.knowledge, *level.key, "part", fold),
        epsilon_m=epsilon_m,
        granted=granted,
        mechanism=level.mechanism.instance,
        train=training,
        repeats=repeats,
    )
    attack = consumer.plugin.instance
    fitted: Callable[[Release], Reconstruction] = guarded(
        f"attack {consumer.label}", lambda: attack.fit(context)
    )
    return fitted


def _called(
    fitted: Callable[[Release], Reconstruction], release: Release, *, consumer: Consumer
) -> Floats:
    """Return what an attack makes of a release, (m, 2) m in its frame."""
    expected = release.xy.shape
    found: object = guarded(f"attack {consumer.label}", lambda: fitted(release))
    if not isinstance(found, Reconstruction) or found.xy.shape != expected:
        got = getattr(getattr(found, "xy", None), "shape", type(found).__name__)
        raise PluginError(
            f"attack {consumer.label} must return a Reconstruction with xy {expected}, got {got}"
        )
    return found.xy


def seen(release: Release, *, granted: frozenset[Knowledge], rng: Generator) -> View:
    """Return a release as it shows: without SCENE turned, shifted, and on another clock."""
    if Knowledge.SIGMA not in granted:
        release = release.without_sigma()
    if Knowledge.SCENE in granted:
        return View(release, 0.0, np.zeros(2))
    angle = float(rng.uniform(0.0, 2.0 * np.pi))
    shift = rng.uniform(-_FAR_M, _FAR_M, 2)
    moved = replace(
        release,
        xy=_turned(release.xy, angle=angle, shift=shift),
        t=release.t + rng.uniform(0.0, _LONG_S),
    )
    return View(moved, angle, shift)


def _frame(key: tuple[str | int, ...], fold: int, *names: str | int, seed: int) -> Generator:
    """Return the stream of a frame: one for each release, whoever attacks it."""
    return stream(seed, "frames", *key, "part", fold, *names)


def _turned(
    xy: Floats, *, angle: float, shift: Floats | tuple[float, float] = (0.0, 0.0)
) -> Floats:
    """Return positions turned by an angle and shifted, (M, 2)."""
    # Not a matrix product: for two columns its threads cost more than they bring.
    cos, sin = np.cos(angle), np.sin(angle)
    turned = np.empty_like(xy)
    turned[:, 0] = cos * xy[:, 0] - sin * xy[:, 1] + shift[0]
    turned[:, 1] = sin * xy[:, 0] + cos * xy[:, 1] + shift[1]
    return turned


def _part(scenes: Scenes, rows: Ints) -> Part:
    sizes = np.diff(scenes.offsets)[rows]
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    samples = np.repeat(scenes.offsets[rows] - offsets[:-1], sizes) + np.arange(offsets[-1])
    return Part(
        rows=rows,
        samples=samples,
        offsets=offsets,
        t=scenes.t[samples],
        truth=scenes.xy.take(samples, axis=0),
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


def _taken(release: Release, part: Part) -> Release:
    return Release(
        t=part.t,
        xy=release.xy.take(part.samples, axis=0),
        sigma=None if release.sigma is None else release.sigma[part.samples],
        offsets=part.offsets,
        pseudonym=tuple(release.pseudonym[row] for row in part.rows),
    )


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


def _assert_distinct(passes: tuple[tuple[Part, ...], ...], *, scenes: Scenes) -> None:
    """Assert that no release shows a walk twice."""
    for part in (part for half in passes for part in half):
        walks = scenes.track[part.rows]
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
