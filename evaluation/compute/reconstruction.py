"""The section *reconstruction*: the privacy descriptors after each adversary's attack.

People are split into two halves, whole groups at a time. An attack that learns does so
on the other half; every attack is fitted again for every mechanism level. A half, 0 or
1, is a `fold`. Attacks that are not tested to work track by track get its tracks pass
by pass (`AttackedBlock.passes`): tracks that are attacked at once are `Victims`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from attacks.reconstruction.learning import N_CANDIDATES
from evaluation.compute import sharing
from evaluation.compute.companions import companion_release
from evaluation.compute.frames import Frame, adversary_view, hide_sigma
from evaluation.compute.guards import copied, copy_for_user_plugin, guarded
from evaluation.compute.model_walks import sensed_scenes
from evaluation.compute.sharing import SHOWS, call_attack
from evaluation.compute.tables import Rows, described_rows, track_columns
from evaluation.compute.walk_bounds import benchmark, genie_plr
from evaluation.plan.constants import MOST_SCENES
from isac_track import privacy
from isac_track.errors import DataError, PluginError
from isac_track.protocols import WALK_KNOWLEDGE, AttackContext, TrainingSet
from isac_track.rng import stream
from isac_track.scenes import Cut, make_scenes
from isac_track.types import Floats, Ints, Knowledge, Release, Scenes, Sensed

if TYPE_CHECKING:
    from evaluation.plan.consumer import Consumer
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin

# At most so many people train an attack: more would cost time and change little.
TRAINING_PEOPLE = 20
_FOLDS = (0, 1)
_SCENE = frozenset({Knowledge.SCENE})


class HalfAsSeen(NamedTuple):
    """A half of the people and what of it shows: a key of what adversaries share."""

    fold: int  # 0 or 1
    shows: frozenset[Knowledge]  # Of `SHOWS`.


class AttackView(NamedTuple):
    """A release as an adversary sees it."""

    release: Release
    frame: Frame


class TrainingWalks(NamedTuple):
    """Walks of the people that an attack learns from."""

    walks: Scenes
    sensed: Sensed


class Victims(NamedTuple):
    """Tracks of a block, n of them, attacked at once: m samples, end to end."""

    tracks: Ints  # (n,) rows of the block.
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
    training: tuple[TrainingWalks | None, ...]
    """For each half people of the other half, each once; None if there are none."""
    is_model: bool  # Whether walks of a model replace the recorded walks.
    tracks: Cut
    sensed_again: tuple[Sensed, ...]  # The walks of the block sensed anew, for REPEATS.
    stages: StageSettings
    seed: int


@dataclass(frozen=True, eq=False, slots=True)
class AttackedLevel:
    """All that attacks on one mechanism level of a block share."""

    mechanism: Plugin
    block: AttackedBlock
    # Names of its random streams: the half and what is drawn for it follow.
    key: tuple[str | int, ...]
    scenes: Scenes  # Without the samples that the release left out.
    release: Release
    victims: tuple[Victims, ...]  # Each half of its tracks.
    views: Mapping[HalfAsSeen, AttackView]
    training: Mapping[HalfAsSeen, TrainingSet]
    """People to learn from, in a frame of theirs, for each half that has any."""
    repeats: tuple[Release, ...]  # Further releases of the walks, in the true frame.
    companions: tuple[Release, ...]  # Of each track's companion, for COMPANIONS.
    benchmark: Rows  # Columns that the benchmark expects of each track.
    bound: Rows  # Columns of the best estimate that is possible of each track.


def draw_halves(groups: tuple[str, ...], *, seed: int) -> Ints:
    """Return the half of each track, (N,) 0 or 1: members of a group stay together."""
    names = sorted(set(groups))
    order = stream(seed, "folds").permutation(len(names))
    half_by_group = {names[row]: place % 2 for place, row in enumerate(order)}
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
    sense_walks = partial(
        sensed_scenes, tracks=tracks, is_model=is_model, stages=stages, seed=seed
    )
    half_by_track = draw_halves(tracks.group, seed=seed)
    half = half_by_track[scenes.track]
    # Agents are numbered over the whole run: each pass takes each track once.
    agents = scenes.index[0] * scenes.n_agents + np.arange(scenes.track.size)
    passes = agents // len(tracks)
    if np.unique(passes * len(tracks) + scenes.track).size < scenes.track.size:
        raise AssertionError("a walk occurs twice in one pass")
    training: list[TrainingWalks | None] = []
    for fold in _FOLDS:
        people = _training_people(half_by_track, fold=1 - fold, seed=seed)
        attacked = np.unique(scenes.track[half == fold])
        if {tracks.group[row] for row in people} & {
            tracks.group[row] for row in attacked
        }:
            raise AssertionError("a victim's group is among the training people")
        if not people.size:
            training.append(None)
            continue
        # Placed and sensed like a scene's first agent, beyond the scenes of any run.
        first = MOST_SCENES + fold * len(tracks)
        walks = make_scenes(
            tracks, order=people[:, None], first=first, settings=stages, seed=seed
        )
        training.append(TrainingWalks(*sense_walks(walks)))
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
    scenes = sharing.take_samples(block.scenes, samples)
    victims = tuple(_victims(scenes, release, half) for half in block.halves)
    visible = {consumer.granted & SHOWS for consumer in consumers}
    training: dict[HalfAsSeen, TrainingSet] = {}
    if Knowledge.TRAIN in granted:
        training = _training_sets(mechanism, block, visible, key)
    views = {
        HalfAsSeen(fold, knowledge): view
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
        companions = (_companions(mechanism, block),)
    sensed = sharing.take_samples(block.sensed, samples)
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


def _companions(mechanism: Plugin, block: AttackedBlock) -> Release:
    """Return the shared walk of the companion of each track of a block."""
    return companion_release(
        mechanism,
        block.scenes,
        tracks=block.tracks,
        stages=block.stages,
        seed=block.seed,
    )


def _bound(
    mechanism: Plugin, release: Release, sensed: Sensed, block: AttackedBlock
) -> Rows:
    """Return the genie's PLR of each track of a block; `sensed` are its samples."""
    return genie_plr(
        mechanism,
        release,
        scenes=block.scenes,
        sensed=sensed,
        tracks=block.tracks,
        is_model=block.is_model,
        epsilon_m=block.stages.privacy.epsilon_m,
        seed=block.seed,
    )


def _training_sets(
    mechanism: Plugin,
    block: AttackedBlock,
    visible: Collection[frozenset[Knowledge]],
    key: tuple[str | int, ...],
) -> dict[HalfAsSeen, TrainingSet]:
    """Return the people to learn from as they are shared, for each half that has any."""
    training = {}
    for fold, others in enumerate(block.training):
        if others is None:
            continue
        shared = sharing.share(
            mechanism, others.sensed, "training", fold, seed=block.seed
        )
        samples = sharing.samples_shared(shared, others.sensed)
        truth_m = sharing.take_samples(others.walks, samples).xy
        views = _views(shared, visible, *key, fold, "training", seed=block.seed)
        for knowledge, view in views:
            training[HalfAsSeen(fold, knowledge)] = TrainingSet(
                view.release, view.frame.points(truth_m)
            )
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
) -> Iterator[tuple[frozenset[Knowledge], AttackView]]:
    """Yield a release as it shows by knowledge; without SCENE, in one drawn frame."""
    for sees_scene in {Knowledge.SCENE in knowledge for knowledge in visible}:
        rng = stream(seed, "frames", *key)
        most = SHOWS if sees_scene else SHOWS - _SCENE
        seen, frame = adversary_view(release, granted=most, rng=rng)
        for knowledge in visible:
            if (Knowledge.SCENE in knowledge) == sees_scene:
                yield knowledge, AttackView(hide_sigma(seen, knowledge), frame)


def attack_rows(consumer: Consumer, level: AttackedLevel) -> Rows:
    """Return the descriptors of every attacked track, in the order of the block.

    The consumer `bound` has no attack: its rows are the genie's PLR of every track. An
    adversary gets a release that holds every walk once, of a single pass: from two
    copies it could make a better estimate. The built-in attacks work track by track
    (tested) and take all passes in one call.
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
            shown, frame = level.views[HalfAsSeen(fold, granted & SHOWS)]
        else:
            rng = stream(block.seed, "frames", *level.key, fold, "pass", number)
            shown, frame = adversary_view(part.release, granted=granted, rng=rng)
        # An adversary that knows more of the walks themselves knows it by part.
        if attack is None or granted & WALK_KNOWLEDGE:
            context = _context(consumer, level, fold=fold, victims=part, frame=frame)
            fit = partial(consumer.plugin.instance.fit, context)
            attack = guarded(name, fit)
        rebuilt = call_attack(
            attack, copy_for_user_plugin(shown, consumer.plugin), name=name
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
    train = level.training.get(HalfAsSeen(fold, granted & SHOWS))
    if train is not None and not consumer.is_built_in:
        train = TrainingSet(copied(train.release), train.truth.copy())
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
            seed, "attacks", consumer.spec, consumer.adversary, *level.key, fold
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
