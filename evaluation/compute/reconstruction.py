"""The stage *reconstruction*: the privacy descriptors after each adversary's attack.

People are split into two halves, whole groups at a time. An attack that learns does so
on the other half; every attack is fitted again for every mechanism level.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from attacks.reconstruction.kalman_rts import KalmanRTS
from attacks.reconstruction.learning import N_CANDIDATES
from attacks.reconstruction.own_motion import PRIOR_STD
from evaluation.compute import sharing
from evaluation.compute.sharing import (
    SHOWS,
    Frame,
    adversary_view,
    hide_sigma,
    reconstructed,
)
from evaluation.compute.tables import Rows, described_rows, track_columns, track_means
from evaluation.plan.constants import MOST_SCENES
from isac_track import privacy
from isac_track.errors import DataError, PluginError
from isac_track.kalman import Batch, smooth_positions
from isac_track.model_world import (
    Motion,
    OwnMotions,
    fit_motion,
    fit_own_motions,
    known_share,
    release_errors,
    simulate_walks,
)
from isac_track.protocols import WALK_KNOWLEDGE, AttackContext, TrainingSet
from isac_track.rng import stream
from isac_track.scenes import Cut, make_scenes
from isac_track.sensing import (
    draw_channel,
    sense,
    sense_scenes,
    walk_numbers,
    walked_within,
)
from isac_track.types import Floats, Ints, Knowledge, Release, Scenes, Sensed, derived

if TYPE_CHECKING:
    from evaluation.plan.axes import Consumer
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin

# At most so many people train an attack: more would cost time and change little.
TRAINING_PEOPLE = 20
BENCHMARK_Q = KalmanRTS.DEFAULT_Q  # m^2/s^3, motion of the benchmark.
_BENCHMARK = ("benchmark_mse_m2", "benchmark_plr")
_FOLDS = (0, 1)
_SCENE = frozenset({Knowledge.SCENE})
_LEAST_VARIANCE_M2 = 1e-12


class Victims(NamedTuple):
    """Tracks of a block, n of them, attacked at once: m samples, end to end."""

    tracks: Ints  # (n,) places in the block.
    release: Release  # Of these tracks, in the true frame.
    truth: Floats  # (m, 2) m


@dataclass(frozen=True, eq=False, slots=True)
class AttackedBlock:
    """All that attacks on a block of N tracks share, whatever the mechanism."""

    scenes: Scenes
    sensed: Sensed
    halves: tuple[Ints, ...]  # Tracks of each half of the people.
    # (N,) number of the pass over the recording: none has a walk twice, the first has
    # all of them.
    passes: Ints
    training: tuple[tuple[Scenes, Sensed] | None, ...]
    """For each half people of the other half, each once; None if there are none."""
    is_model: bool  # Whether walks of a model replace the recorded ones.
    tracks: Cut
    sensed_again: tuple[Sensed, ...]  # The walks of the block sensed anew, for REPEATS.
    stages: StageSettings
    seed: int


@dataclass(frozen=True, eq=False, slots=True)
class AttackedLevel:
    """All that attacks on one mechanism level of a block share."""

    mechanism: Plugin
    block: AttackedBlock
    key: tuple[str | int, ...]  # Names of its random streams, before the half.
    scenes: Scenes  # Without the samples that the release left out.
    release: Release
    victims: tuple[Victims, ...]  # Each half of its tracks.
    views: Mapping[tuple[int, frozenset[Knowledge]], tuple[Release, Frame]]
    """Each half as it shows, and its frame, by half and knowledge of `SHOWS`."""
    training: Mapping[tuple[int, frozenset[Knowledge]], TrainingSet]
    """People to learn from, in a frame of theirs, for each half that has any."""
    repeats: tuple[Release, ...]  # Further releases of the walks, in the true frame.
    companions: tuple[Release, ...]  # Of each track's companion, for COMPANIONS.
    benchmark: Rows  # Columns that the benchmark expects of each track.
    bound: Rows  # Columns of the best estimate that is possible of each track.


def folds(groups: tuple[str, ...], *, seed: int) -> Ints:
    """Return the half of each track, (N,) 0 or 1: members of a group stay together."""
    names = sorted(set(groups))
    order = stream(seed, "folds").permutation(len(names))
    half_by_group = {names[name]: place % 2 for place, name in enumerate(order)}
    return np.array([half_by_group[group] for group in groups], dtype=np.int64)


def slow_cost_s(consumers: Sequence[Consumer], *, tracks: Cut, n_levels: int) -> float:
    """Return the approximate time of slow attacks in one process, s.

    It is estimated from their ``seconds_per_sample``; NaN if an attack does not declare
    it. An attack that learns tries a few candidates on the training people first.
    """
    n_samples = np.diff(tracks.offsets)
    n_training = 2 * min(TRAINING_PEOPLE, len(tracks) // 2) * float(n_samples.mean())
    total_s = 0.0
    for consumer in consumers:
        declared_s = getattr(consumer.plugins[0].instance, "seconds_per_sample", None)
        sample_cost_s = declared_s if isinstance(declared_s, int | float) else np.nan
        n_learnt = 0.0
        if Knowledge.TRAIN in consumer.granted:
            n_learnt = N_CANDIDATES * n_training
        total_s += sample_cost_s * (n_samples.sum() + n_learnt)
    return n_levels * total_s


def attacked_block(
    *,
    scenes: Scenes,
    sensed: Sensed,
    tracks: Cut,
    repeats: bool,
    is_model: bool = False,
    stages: StageSettings,
    seed: int,
) -> AttackedBlock:
    """Prepare a block of scenes of `tracks` for its attacks.

    `repeats` says whether an attack is granted REPEATS. `is_model` says that `scenes`
    and `sensed` are of a model; so are the other walks then.
    """

    def sense_walks(walks: Scenes, *names: str | int) -> tuple[Scenes, Sensed]:
        return sensed_scenes(
            walks, *names, tracks=tracks, is_model=is_model, stages=stages, seed=seed
        )

    half_by_track = folds(tracks.group, seed=seed)
    half = half_by_track[scenes.track]
    seats = scenes.index[0] * scenes.n_agents + np.arange(scenes.track.size)
    passes = seats // len(tracks)  # each pass over the tracks takes each once
    if np.unique(passes * len(tracks) + scenes.track).size < scenes.track.size:
        raise AssertionError("a walk occurs twice in one pass")
    training: list[tuple[Scenes, Sensed] | None] = []
    for fold in _FOLDS:
        people = _training_people(half_by_track, fold=1 - fold, seed=seed)
        taught = {tracks.group[row] for row in people}
        attacked_rows = np.unique(scenes.track[half == fold])
        if any(tracks.group[row] in taught for row in attacked_rows):
            raise AssertionError("a victim's group is among the training people")
        if not people.size:
            training.append(None)
            continue
        # Placed and sensed like a scene's first agent, beyond the scenes of any run.
        first = MOST_SCENES + fold * len(tracks)
        walks = make_scenes(
            tracks, order=people[:, None], first=first, settings=stages, seed=seed
        )
        training.append(sense_walks(walks))
    n_repeats = stages.attacks.repeats if repeats else 0
    return AttackedBlock(
        tracks=tracks,
        is_model=is_model,
        stages=stages,
        seed=seed,
        scenes=scenes,
        sensed=sensed,
        halves=tuple(np.flatnonzero(half == fold) for fold in _FOLDS),
        passes=passes,
        training=tuple(training),
        sensed_again=tuple(
            sense_walks(scenes, "again", number)[1] for number in range(n_repeats)
        ),
    )


def _victims(scenes: Scenes, release: Release, tracks: Ints) -> Victims:
    rows = sharing.track_samples(scenes.offsets, tracks).rows
    return Victims(tracks, release.tracks(tracks), scenes.xy.take(rows, axis=0))


def _training_people(half_by_track: Ints, *, fold: int, seed: int) -> Ints:
    """Return the tracks of a half that train an attack."""
    rows = np.flatnonzero(half_by_track == fold)
    return stream(seed, "training", fold).permutation(rows)[:TRAINING_PEOPLE]


def attacked_level(
    mechanism: Plugin,
    release: Release,
    block: AttackedBlock,
    consumers: Sequence[Consumer],
) -> AttackedLevel:
    """Prepare a mechanism level for its attacks; `release` is that of the block."""
    granted = frozenset[Knowledge]().union(
        *(consumer.granted for consumer in consumers)
    )
    key = (mechanism.spec, "scene", int(block.scenes.index[0]), "part")
    samples = sharing.samples_shared(release, block.sensed)
    scenes = sharing.restricted(block.scenes, samples)
    victims = tuple(_victims(scenes, release, half) for half in block.halves)
    visible = {consumer.granted & SHOWS for consumer in consumers}
    training = {}
    if Knowledge.TRAIN in granted:
        training = _training_sets(mechanism, block, visible, key)
    views = {
        (fold, knowledge): view
        for fold, half in enumerate(victims)
        for knowledge, view in _views(
            half.release, visible, *key, fold, seed=block.seed
        )
    }
    repeats: tuple[Release, ...] = ()
    if Knowledge.REPEATS in granted:
        repeats = _share_again(mechanism, release, block)
    companions: tuple[Release, ...] = ()
    if Knowledge.COMPANIONS in granted:
        companions = (companion_release(block, mechanism),)
    sensed = sharing.restricted(block.sensed, samples)
    return AttackedLevel(
        mechanism=mechanism,
        block=block,
        key=key,
        scenes=scenes,
        release=release,
        victims=victims,
        views=views,
        training=training,
        repeats=repeats,
        companions=companions,
        benchmark=benchmark(
            release,
            sensed=sensed,
            mechanism=mechanism,
            epsilon_m=block.stages.privacy.epsilon_m,
        ),
        bound=_bound(mechanism, release, sensed, block),
    )


def _training_sets(
    mechanism: Plugin,
    block: AttackedBlock,
    visible: Collection[frozenset[Knowledge]],
    key: tuple[str | int, ...],
) -> dict[tuple[int, frozenset[Knowledge]], TrainingSet]:
    """Return training sets by half and visible knowledge: the people, as shared."""
    training = {}
    for fold, others in enumerate(block.training):
        if others is None:
            continue
        walks, sensed = others
        shared = sharing.share(mechanism, sensed, "training", fold, seed=block.seed)
        samples = sharing.samples_shared(shared, sensed)
        truth_m = sharing.restricted(walks, samples).xy
        views = _views(shared, visible, *key, fold, "training", seed=block.seed)
        for knowledge, (shown, frame) in views:
            training[fold, knowledge] = TrainingSet(shown, frame.points(truth_m))
    return training


def _share_again(
    mechanism: Plugin, release: Release, block: AttackedBlock
) -> tuple[Release, ...]:
    """Share the walks of a block again, as often as REPEATS grants.

    Raises PluginError if the mechanism leaves out other samples than in `release`.
    """
    names = ("scenes", int(block.scenes.index[0]), "again")
    repeats = tuple(
        sharing.share(mechanism, sensed, *names, number, seed=block.seed)
        for number, sensed in enumerate(block.sensed_again)
    )
    if not all(sharing.same_samples(repeat, release) for repeat in repeats):
        raise PluginError(
            f"mechanism {mechanism.spec!r} leaves out other samples when the same walks"
            " are shared again; an attack that is granted REPEATS gets them at the"
            " same instants: leave samples out by their times, or leave out the"
            " attacks that use repeats"
        )
    return repeats


def _views(
    release: Release,
    visible: Collection[frozenset[Knowledge]],
    *key: str | int,
    seed: int,
) -> Iterator[tuple[frozenset[Knowledge], tuple[Release, Frame]]]:
    """Yield a release as it shows by knowledge; without SCENE, in one drawn frame."""
    for scene in {knowledge & _SCENE for knowledge in visible}:
        rng = stream(seed, "frames", *key)
        seen, frame = adversary_view(release, granted=SHOWS - _SCENE | scene, rng=rng)
        for knowledge in visible:
            if knowledge & _SCENE == scene:
                yield knowledge, (hide_sigma(seen, knowledge), frame)


def attack_rows(consumer: Consumer, level: AttackedLevel) -> Rows:
    """Return the descriptors of every attacked track, in the order of the block.

    Without an attack these are the bounds of every track, which hold as far as the
    motion does. A release holds every walk once: from two copies an adversary could
    make a better estimate. The built-in attacks work track by track (tested) and take
    all passes in one call.
    """
    if consumer.plugin is None:
        return {
            **track_columns(level.scenes, np.arange(len(level.release))),
            **level.bound,
        }
    block = level.block
    described = np.empty((privacy.N_DESCRIBED, len(level.release)))
    is_attacked = np.zeros(len(level.release), dtype=bool)
    for fold in range(len(level.victims)):
        for part, values in _attack_half(consumer, level, fold):
            described[:, part.tracks] = values
            is_attacked[part.tracks] = True
    rows = np.flatnonzero(is_attacked)
    columns = {
        **track_columns(level.scenes, rows),
        **described_rows(described[:, rows]),
        **{name: values[rows] for name, values in level.benchmark.items()},
    }
    if block.is_model:
        # An adversary with more than this release may exceed the bound.
        knows_more = bool(consumer.granted & WALK_KNOWLEDGE)
        best = np.nan if knows_more else level.bound["plr_ceiling"][rows]
        columns["plr_gap"] = best - columns["plr"]
    return columns


def _attack_half(
    consumer: Consumer, level: AttackedLevel, fold: int
) -> Iterator[tuple[Victims, Floats]]:
    """Attack one half of a block; yield its parts with their descriptors, (D, n)."""
    assert consumer.plugin is not None
    name, block, granted = f"attack {consumer.label}", level.block, consumer.granted
    in_one_call = consumer.is_built_in and not consumer.is_slow
    half = level.victims[fold]
    parts = [half] if in_one_call else _passes(half, level, is_slow=consumer.is_slow)
    attack: Callable[..., object] | None = None
    for number, part in enumerate(parts):
        if not part.tracks.size:
            continue
        if in_one_call:
            shown, frame = level.views[fold, granted & SHOWS]
        else:
            rng = stream(block.seed, "frames", *level.key, fold, "pass", number)
            shown, frame = adversary_view(part.release, granted=granted, rng=rng)
        if attack is None or granted & WALK_KNOWLEDGE:
            context = _context(consumer, level, fold=fold, victims=part, frame=frame)
            fit = partial(consumer.plugin.instance.fit, context)
            attack = sharing.guarded(name, fit)
        rebuilt = reconstructed(
            attack, sharing.copy_for_user_plugin(shown, consumer.plugin), name=name
        )
        # Only the correction is turned back: positions that the attack leaves as they
        # are stay the same bit by bit.
        values = privacy.described(
            xy=part.release.xy,
            truth=part.truth,
            t=part.release.t,
            offsets=part.release.offsets,
            settings=block.stages.privacy,
            moved=(rebuilt.xy, shown.xy),
            turn=complex(frame.turn),
        )
        yield part, values


def _passes(half: Victims, level: AttackedLevel, *, is_slow: bool) -> list[Victims]:
    """Return the tracks of a half by pass over the recording; if slow, the first."""
    passes = level.block.passes[half.tracks]
    numbers = [0] if is_slow else np.unique(passes)
    return [
        _victims(level.scenes, level.release, half.tracks[passes == number])
        for number in numbers
    ]


# The motions of the newest recordings of this process.
@lru_cache(maxsize=2)
def recording_motion(tracks: Cut) -> Motion:
    """Return the motion of a recording's people, fitted once."""
    return fit_motion(tracks)


# As above.
@lru_cache(maxsize=2)
def recording_own_motions(tracks: Cut) -> OwnMotions:
    """Return the motion of each person of a recording, fitted once."""
    return fit_own_motions(tracks)


def sensed_scenes(
    scenes: Scenes,
    *names: str | int,
    tracks: Cut,
    is_model: bool,
    stages: StageSettings,
    seed: int,
) -> tuple[Scenes, Sensed]:
    """Sense scenes; in a model world, with agents that walk by the model.

    `names` name the streams of the sensing errors. A model's walk has the motion that
    was fitted to the recorded walk; it has the same start, the same instants and the
    very same errors. The errors depend on the recorded place, which no adversary can
    use.
    """
    sensed = sense_scenes(scenes, settings=stages.sensing, seed=seed, names=names)
    if not is_model:
        return scenes, sensed
    walks, motions = [], recording_own_motions(tracks).take(scenes.track)
    for place, index in enumerate(scenes.index.tolist()):
        first, end = place * scenes.n_agents, (place + 1) * scenes.n_agents
        offsets = scenes.offsets[first : end + 1]
        walk = simulate_walks(
            t=scenes.t[offsets[0] : offsets[-1]],
            offsets=offsets - offsets[0],
            start=scenes.xy[offsets[:-1]],
            motion=motions.take(np.arange(first, end)),
            rng=stream(seed, "model walks", index),
        )
        walks.append(walk)
    xy = np.concatenate(walks)
    errors = sensed.sigma_raw[:, None] * sensed.unit_error
    return derived(scenes, xy=xy), derived(sensed, xy=xy + errors)


def _bound(
    mechanism: Plugin, release: Release, sensed: Sensed, block: AttackedBlock
) -> Rows:
    """Return the PLR of the genie, and of the exact posterior where it is known.

    That is in a model world with Gaussian errors. Both know how each person moves. For
    recorded walks neither is a bound: these follow no model.
    """
    rng = stream(block.seed, "genie", mechanism.spec, int(block.scenes.index[0]))
    errors = release_errors(
        release=release, sensed=sensed, mechanism=mechanism.instance, rng=rng
    )
    unknown = np.full(len(release), np.nan)
    if errors is None:  # a mechanism whose errors even the genie does not know
        return {"plr_ceiling": unknown, "plr_optimum": unknown}
    known = known_share(
        t=release.t,
        offsets=release.offsets,
        errors=errors,
        motion=recording_own_motions(block.tracks).take(block.scenes.track),
        epsilon_m=block.stages.privacy.epsilon_m,
    )
    is_exact = block.is_model and errors.is_gaussian
    return {"plr_ceiling": known, "plr_optimum": known if is_exact else unknown}


def _context(
    consumer: Consumer,
    level: AttackedLevel,
    *,
    fold: int,
    victims: Victims,
    frame: Frame,
) -> AttackContext:
    """Return the context of an attack on some tracks of one half."""
    granted, seed = consumer.granted, level.block.seed
    train = level.training.get((fold, granted & SHOWS))
    if train is not None and not consumer.is_built_in:
        train = TrainingSet(sharing.copied(train.release), train.truth.copy())
    if Knowledge.TRAIN in granted and train is None:
        raise DataError(
            f"attack {consumer.spec!r} needs other people to train on, but all tracks"
            " belong to one person or group; use a recording of more people or leave"
            " the attack out"
        )
    repeats = []
    if Knowledge.REPEATS in granted:
        for number, release in enumerate(level.repeats):
            rng = stream(seed, "frames", *level.key, fold, "again", number)
            again = release.tracks(victims.tracks)
            repeats.append(adversary_view(again, granted=granted, rng=rng)[0])
    companions = (release.tracks(victims.tracks) for release in level.companions)
    return AttackContext(
        rng=stream(
            seed, "attacks", consumer.spec, consumer.knowledge, *level.key, fold
        ),
        epsilon_m=level.block.stages.privacy.epsilon_m,
        granted=granted,
        mechanism=level.mechanism.instance,
        train=train,
        repeats=tuple(repeats),
        anchor=_anchor(level, victims, frame) if Knowledge.ANCHOR in granted else None,
        companions=tuple(
            frame.release(hide_sigma(release, granted)) for release in companions
        ),
    )


def _anchor(level: AttackedLevel, victims: Victims, frame: Frame) -> Release:
    """Return the true position of each victim at a random instant, in a frame."""
    scenes, offsets = level.scenes, level.scenes.offsets
    drawn = stream(level.block.seed, "anchors", int(scenes.index[0])).random(
        offsets.size - 1
    )
    rows = (offsets[:-1] + drawn * np.diff(offsets)).astype(np.int64)[victims.tracks]
    anchor = Release(
        scenes.t[rows],
        scenes.xy[rows],
        None,
        np.arange(rows.size + 1),
        victims.release.pseudonym,
    )
    return frame.release(anchor)


def companion_release(block: AttackedBlock, mechanism: Plugin) -> Release:
    """Return the shared walks of the companions of the N tracks of a block.

    A companion is the person of the same group who is present longest at the same time,
    sensed and shared with errors of its own. A track without one has a single sample,
    of the track itself.
    """
    scenes, seed = block.scenes, block.seed
    group = np.unique(block.tracks.group, return_inverse=True)[1]
    walks = [_companion_walk(block, seat, group) for seat in range(scenes.track.size)]
    n_samples = np.array([t.size for t, _ in walks])
    t = np.concatenate([instants for instants, _ in walks])
    xy = np.concatenate([places for _, places in walks])
    first_scene = int(scenes.index[0])
    offsets = np.concatenate([[0], np.cumsum(n_samples)])
    keys = [("beside", first_scene, seat) for seat in range(n_samples.size)]
    sensing = block.stages.sensing
    channel = draw_channel(
        walked_m=walked_within(xy, offsets),
        n_samples=n_samples[:, None],
        keys=keys,
        settings=sensing,
        seed=seed,
    )
    walk = walk_numbers("beside", first_scene, n_walks=n_samples.size, seed=seed)
    sensed = sense(
        t=t, xy=xy, offsets=offsets, channel=channel, settings=sensing, walk=walk
    )
    return sharing.share(mechanism, sensed, "scenes", first_scene, "beside", seed=seed)


def _companion_walk(
    block: AttackedBlock, seat: int, group: Ints
) -> tuple[Floats, Floats]:
    """Return instants, (m,) s, and positions, (m, 2) m, of a track's companion.

    The companion is moved into the scene as its track is. `group` has the number of the
    group of every track of the recording.
    """
    scenes, tracks = block.scenes, block.tracks
    row = scenes.track[seat]
    lo, hi = scenes.offsets[seat : seat + 2]
    moved_m = scenes.xy[lo] - tracks.xy[tracks.offsets[row]]
    walk, longest_s = (scenes.t[lo : lo + 1], scenes.xy[lo : lo + 1]), 0.0
    for other in np.flatnonzero(group == group[row]):
        first, end = tracks.offsets[other], tracks.offsets[other + 1]
        t = tracks.t[first:end]
        together_s = min(t[-1], scenes.t[hi - 1]) - max(t[0], scenes.t[lo])
        if other != row and together_s > longest_s:
            walk, longest_s = (t, tracks.xy[first:end] + moved_m), together_s
    return walk


def benchmark(
    release: Release, *, sensed: Sensed, mechanism: Plugin, epsilon_m: float
) -> Rows:
    """Return the linear benchmark's expected squared error and PLR of each track, (N,).

    The benchmark is the exact smoother of a constant-velocity walk that knows the
    variance of every sample: no linear estimator has a smaller expected squared error,
    and none at all if the errors are Gaussian. Its posterior covariance P per axis
    depends on no position: the expected squared error is 2 P, and a Gaussian error of
    that size leaks with probability 1 - exp(-epsilon^2 / 2P). NaN for a mechanism that
    denies `errors_are_independent`: its errors depend on each other.
    """
    if not getattr(mechanism.instance, "errors_are_independent", True):
        return dict.fromkeys(_BENCHMARK, np.full(len(release), np.nan))
    law = getattr(mechanism.instance, "law", None) or sensed.law
    assert release.sigma is not None  # `share` refuses a release without
    shared_m2, raw_m2 = release.sigma**2, sensed.sigma_raw**2
    # A mechanism that reduces the error scales the raw one; an added error has the law
    # of the mechanism. An error of standard deviation 1 has this variance per axis.
    variance = _axis_variance(sensed.law) * np.minimum(shared_m2, raw_m2)
    variance += _axis_variance(law) * np.maximum(shared_m2 - raw_m2, 0.0)
    variance = np.maximum(variance, _LEAST_VARIANCE_M2, out=variance)
    batch = Batch(release.t, release.xy, variance, release.offsets, PRIOR_STD)
    square_m2 = 2.0 * smooth_positions(batch, q=BENCHMARK_Q)[1]
    leaked = -np.expm1(-(epsilon_m**2) / square_m2)
    return {
        "benchmark_mse_m2": track_means(square_m2, release.offsets),
        "benchmark_plr": track_means(leaked, release.offsets),
    }


def _axis_variance(law: str) -> float:
    """Return the variance per axis of an error of standard deviation 1."""
    return 0.5 if law == "radial" else 1.0
