"""The stage *reconstruction*: what each adversary's reconstruction of a block reveals.

People are split into two halves, whole groups at a time. An attack that learns does so
on the other half; every attack prepares anew for every mechanism level.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from attacks.reconstruction.kalman_rts import KalmanRTS
from attacks.reconstruction.learning import N_CANDIDATES
from attacks.reconstruction.own_motion import PRIOR_STD
from evaluation.compute import sharing
from evaluation.compute.sharing import SHOWS, Frame, reconstructed, showing, view_of
from evaluation.compute.tables import Rows, described_rows, track_columns, track_means
from evaluation.plan.constants import MOST_SCENES
from isac_track import privacy
from isac_track.errors import DataError, PluginError
from isac_track.kalman import Batch, smooth_positions
from isac_track.model_world import (
    Motion,
    OwnMotions,
    errors_of,
    fitted_motion,
    known_share,
    own_motions,
    simulated,
)
from isac_track.protocols import OF_WALKS, AttackContext, TrainingSet
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

TRAINING_PEOPLE = 20  # At most train an attack: more would cost time and change little.
BENCHMARK_Q = KalmanRTS.DEFAULT_Q  # m^2/s^3, motion of the benchmark.
_BENCHMARK = ("benchmark_mse_m2", "benchmark_plr")
_FOLDS = (0, 1)
_SCENE = frozenset({Knowledge.SCENE})
_LEAST_VARIANCE_M2 = 1e-12


class Victims(NamedTuple):
    """Some n of the tracks of a block, which are attacked at once: m samples, end to end."""

    tracks: Ints  # (n,) which of the block
    own: Release  # of them, in the true frame
    truth: Floats  # (m, 2) m


@dataclass(frozen=True, eq=False, slots=True)
class AttackedBlock:
    """What all attacks on a block of N tracks share, whatever the mechanism."""

    scenes: Scenes
    sensed: Sensed
    halves: tuple[Ints, ...]  # Which tracks are of each half of the people.
    # (N,) pass over the recording: none has a walk twice, the first has all of them.
    turn: Ints
    training: tuple[tuple[Scenes, Sensed] | None, ...]
    """For each half people of the other one, each once; None if there are none."""
    is_model: bool  # Whether they are walks of a model, in place of the recorded ones.
    tracks: Cut
    again: tuple[Sensed, ...]  # The walks of the block sensed anew, for REPEATS.
    stages: StageSettings
    seed: int


@dataclass(frozen=True, eq=False, slots=True)
class AttackedLevel:
    """What all attacks on one mechanism level of a block share."""

    mechanism: Plugin
    block: AttackedBlock
    key: tuple[str | int, ...]  # Names of its random streams; what follows is the half.
    scenes: Scenes  # Without the samples that the release left out.
    release: Release
    victims: tuple[Victims, ...]  # Each half of its tracks.
    views: Mapping[tuple[int, frozenset[Knowledge]], tuple[Release, Frame]]
    """Each half of the release as it shows to who is granted so much of `SHOWS`, and its frame."""
    training: Mapping[tuple[int, frozenset[Knowledge]], TrainingSet]
    """People to learn from for each half, in a frame of theirs; none where there are none."""
    again: tuple[Release, ...]  # Further releases of the same walks, in the true frame.
    beside: tuple[Release, ...]  # Of who walks along with each track, for COMPANIONS.
    benchmark: Rows  # Columns of what the benchmark expects of each track.
    bound: Rows  # Columns of what nobody knows better of each.


def folds(groups: tuple[str, ...], *, seed: int) -> Ints:
    """Return the half of each track, (N,) 0 or 1: members of one group stay together."""
    names = sorted(set(groups))
    order = stream(seed, "folds").permutation(len(names))
    half_of = {names[name]: place % 2 for place, name in enumerate(order)}
    return np.array([half_of[group] for group in groups], dtype=np.int64)


def slow_cost_s(consumers: Sequence[Consumer], *, tracks: Cut, n_levels: int) -> float:
    """Return about how long slow attacks take in one process, by their ``seconds_per_sample``.

    One that learns tries a few candidates on the training people first. NaN if one does
    not say.
    """
    n_samples = np.diff(tracks.offsets)
    n_training = 2 * min(TRAINING_PEOPLE, len(tracks) // 2) * float(n_samples.mean())
    total_s = 0.0
    for consumer in consumers:
        said = getattr(consumer.plugins[0].instance, "seconds_per_sample", None)
        n_learnt = (
            N_CANDIDATES * n_training if Knowledge.TRAIN in consumer.granted else 0.0
        )
        each_s = said if isinstance(said, int | float) else np.nan
        total_s += each_s * (n_samples.sum() + n_learnt)
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

    `repeats` says whether an attack is granted REPEATS; `is_model` that `scenes` and
    `sensed` are of a model, and all others shall be.
    """
    of: dict[str, Any] = {
        "tracks": tracks,
        "is_model": is_model,
        "stages": stages,
        "seed": seed,
    }
    half_of = folds(tracks.group, seed=seed)
    half = half_of[scenes.track]
    seats = scenes.index[0] * scenes.n_agents + np.arange(scenes.track.size)
    turn = seats // len(tracks)  # each pass over the tracks takes each once
    if np.unique(turn * len(tracks) + scenes.track).size < scenes.track.size:
        raise AssertionError("a walk occurs twice in one pass")
    training: list[tuple[Scenes, Sensed] | None] = []
    for fold in _FOLDS:
        people = _people(half_of, fold=1 - fold, seed=seed)
        taught = {tracks.group[row] for row in people}
        if any(
            tracks.group[row] in taught for row in np.unique(scenes.track[half == fold])
        ):
            raise AssertionError("a victim's group is among the training people")
        if not people.size:
            training.append(None)
            continue
        # Placed and sensed like a scene's first agent, beyond the scenes of any run.
        first = MOST_SCENES + fold * len(tracks)
        walks = make_scenes(
            tracks, order=people[:, None], first=first, settings=stages, seed=seed
        )
        training.append(sensed_scenes(walks, **of))
    n_again = stages.attacks.repeats if repeats else 0
    return AttackedBlock(
        **of,
        scenes=scenes,
        sensed=sensed,
        halves=tuple(np.flatnonzero(half == fold) for fold in _FOLDS),
        turn=turn,
        training=tuple(training),
        again=tuple(sensed_scenes(scenes, "again", n, **of)[1] for n in range(n_again)),
    )


def _victims(scenes: Scenes, release: Release, tracks: Ints) -> Victims:
    rows = sharing.samples_of(scenes.offsets, tracks).rows
    return Victims(tracks, release.tracks(tracks), scenes.xy.take(rows, axis=0))


def _people(half: Ints, *, fold: int, seed: int) -> Ints:
    """Return which tracks of a half train an attack."""
    rows = np.flatnonzero(half == fold)
    return stream(seed, "training", fold).permutation(rows)[:TRAINING_PEOPLE]


def attacked_level(
    mechanism: Plugin,
    release: Release,
    block: AttackedBlock,
    consumers: Sequence[Consumer],
) -> AttackedLevel:
    """Prepare a mechanism level for its attacks; `release` is what was shared of the block."""
    seed, epsilon_m = block.seed, block.stages.privacy.epsilon_m
    left = sharing.samples_shared(release, block.sensed)
    granted = frozenset[Knowledge]().union(
        *(consumer.granted for consumer in consumers)
    )
    first_scene = int(block.scenes.index[0])
    key = (mechanism.spec, "scene", first_scene, "part")
    scenes = sharing.restricted(block.scenes, left)
    victims = tuple(_victims(scenes, release, half) for half in block.halves)
    shows = {consumer.granted & SHOWS for consumer in consumers}
    views, training = {}, {}
    for fold, others in enumerate(block.training):
        if others is not None and Knowledge.TRAIN in granted:
            walks, sensed = others
            shared = sharing.share(mechanism, sensed, "training", fold, seed=seed)
            truth_m = sharing.restricted(
                walks, sharing.samples_shared(shared, sensed)
            ).xy
            for what, (shown, frame) in _views(
                shared, shows, *key, fold, "training", seed=seed
            ):
                training[fold, what] = TrainingSet(shown, frame.points(truth_m))
        for what, view in _views(victims[fold].own, shows, *key, fold, seed=seed):
            views[fold, what] = view
    repeats = block.again if Knowledge.REPEATS in granted else ()
    names = ("scenes", first_scene, "again")
    again = [
        sharing.share(mechanism, one, *names, n, seed=seed)
        for n, one in enumerate(repeats)
    ]
    if not all(sharing.same_samples(one, release) for one in again):
        raise PluginError(
            f"mechanism {mechanism.spec!r} leaves out other samples when the same walks"
            " are shared again; an attack that is granted REPEATS gets them at the"
            " same instants: leave samples out by their times, or leave out the"
            " attacks that use repeats"
        )
    known = sharing.restricted(block.sensed, left)
    return AttackedLevel(
        mechanism=mechanism,
        block=block,
        key=key,
        scenes=scenes,
        release=release,
        victims=victims,
        views=views,
        training=training,
        again=tuple(again),
        beside=(beside(block, mechanism),) if Knowledge.COMPANIONS in granted else (),
        benchmark=benchmark(
            release, sensed=known, mechanism=mechanism, epsilon_m=epsilon_m
        ),
        bound=_bound(mechanism, release, known, block),
    )


def _views(
    release: Release,
    shows: Collection[frozenset[Knowledge]],
    *key: str | int,
    seed: int,
) -> Iterator[tuple[frozenset[Knowledge], tuple[Release, Frame]]]:
    """Yield a release as it shows to who is granted so much: whoever has no SCENE, in one frame."""
    for scene in {what & _SCENE for what in shows}:
        rng = stream(seed, "frames", *key)
        seen, frame = view_of(release, granted=SHOWS - _SCENE | scene, rng=rng)
        alike = (what for what in shows if what & _SCENE == scene)
        yield from ((what, (showing(seen, what), frame)) for what in alike)


def attack_rows(consumer: Consumer, level: AttackedLevel) -> Rows:
    """Return the descriptors of every attacked track, in the order of the block.

    Without an attack, what none exceeds of every track, as far as the motion holds. A
    release holds every walk once: of two copies an adversary could make one better one.
    The built-in attacks work track by track (tested) and take all passes in one call.
    """
    if consumer.plugin is None:
        return {
            **track_columns(level.scenes, np.arange(len(level.release))),
            **level.bound,
        }
    who, block, granted = f"attack {consumer.label}", level.block, consumer.granted
    at_once = consumer.is_built_in and not consumer.is_slow
    found = np.empty((privacy.N_DESCRIBED, len(level.release)))
    is_attacked = np.zeros(len(level.release), dtype=bool)
    for fold, half in enumerate(level.victims):
        parts = [half]
        if not at_once:
            turn = block.turn[half.tracks]
            turns = [0] if consumer.is_slow else np.unique(turn)
            some = (half.tracks[turn == one] for one in turns)
            parts = [_victims(level.scenes, level.release, tracks) for tracks in some]
        attack: Callable[..., object] | None = None
        for number, part in enumerate(parts):
            if not part.tracks.size:
                continue
            if at_once:
                shown, frame = level.views[fold, granted & SHOWS]
            else:
                rng = stream(block.seed, "frames", *level.key, fold, "pass", number)
                shown, frame = view_of(part.own, granted=granted, rng=rng)
            if attack is None or granted & OF_WALKS:
                context = _context(
                    consumer, level, fold=fold, victims=part, frame=frame
                )
                attack = sharing.guarded(
                    who, partial(consumer.plugin.instance.fit, context)
                )
            rebuilt = reconstructed(
                attack, sharing.handed(shown, consumer.plugin), who=who
            )
            # Only the correction is turned back: what is left alone stays as it was,
            # bit by bit.
            found[:, part.tracks] = privacy.described(
                xy=part.own.xy,
                truth=part.truth,
                t=part.own.t,
                offsets=part.own.offsets,
                settings=block.stages.privacy,
                moved=(rebuilt.xy, shown.xy),
                turn=complex(frame.turn),
            )
            is_attacked[part.tracks] = True
    rows = np.flatnonzero(is_attacked)
    columns = {
        **track_columns(level.scenes, rows),
        **described_rows(found[:, rows]),
        **{name: values[rows] for name, values in level.benchmark.items()},
    }
    if block.is_model:
        # Who has more than the one release is beyond the bound.
        best = np.nan if granted & OF_WALKS else level.bound["plr_ceiling"][rows]
        columns["plr_gap"] = best - columns["plr"]
    return columns


@lru_cache(maxsize=2)
def motion_of(tracks: Cut) -> Motion:
    """Return how people of a recording walk, fitted once."""
    return fitted_motion(tracks)


@lru_cache(maxsize=2)
def own_motions_of(tracks: Cut) -> OwnMotions:
    """Return how each of them walks, fitted once."""
    return own_motions(tracks)


def sensed_scenes(
    scenes: Scenes,
    *names: str | int,
    tracks: Cut,
    is_model: bool,
    stages: StageSettings,
    seed: int,
) -> tuple[Scenes, Sensed]:
    """Return scenes and what is sensed of them, of a model with agents who walk as that says.

    `names` are of the streams of what is sensed. A model's walk has the motion that was
    fitted to the recorded one; it starts where that does and is sensed at the same
    instants with the very same errors: that these depend on where somebody is, nobody
    can make use of.
    """
    sensed = sense_scenes(scenes, settings=stages.sensing, seed=seed, names=names)
    if not is_model:
        return scenes, sensed
    parts, motions = [], own_motions_of(tracks).take(scenes.track)
    for at, index in enumerate(scenes.index.tolist()):
        seats = scenes.offsets[at * scenes.n_agents : (at + 1) * scenes.n_agents + 1]
        lo, hi = seats[0], seats[-1]
        rng = stream(seed, "model walks", index)
        walk = {
            "t": scenes.t[lo:hi],
            "offsets": seats - lo,
            "start": scenes.xy[seats[:-1]],
        }
        own = motions.take(np.arange(at * scenes.n_agents, (at + 1) * scenes.n_agents))
        parts.append(simulated(**walk, motion=own, rng=rng))
    xy = np.concatenate(parts)
    errors = sensed.sigma_raw[:, None] * sensed.unit_error
    return derived(scenes, xy=xy), derived(sensed, xy=xy + errors)


def _bound(
    mechanism: Plugin, release: Release, sensed: Sensed, block: AttackedBlock
) -> Rows:
    """Return PLR of the genie, and of the exact posterior where a model's errors are Gaussian.

    Both know how each person moves. Of recorded walks neither is a bound: these follow
    no model.
    """
    rng = stream(block.seed, "genie", mechanism.spec, int(block.scenes.index[0]))
    errors = errors_of(
        release=release, sensed=sensed, mechanism=mechanism.instance, rng=rng
    )
    nothing = np.full(len(release), np.nan)
    if errors is None:  # of a mechanism that even the genie is blind to
        return {"plr_ceiling": nothing, "plr_optimum": nothing}
    known = known_share(
        t=release.t,
        offsets=release.offsets,
        errors=errors,
        motion=own_motions_of(block.tracks).take(block.scenes.track),
        epsilon_m=block.stages.privacy.epsilon_m,
    )
    is_exact = block.is_model and errors.is_gaussian
    return {"plr_ceiling": known, "plr_optimum": known if is_exact else nothing}


def _context(
    consumer: Consumer,
    level: AttackedLevel,
    *,
    fold: int,
    victims: Victims,
    frame: Frame,
) -> AttackContext:
    """Return what an attack on some tracks of one half prepares with."""
    granted = consumer.granted
    train = level.training.get((fold, granted & SHOWS))
    if train is not None and not consumer.is_built_in:
        train = TrainingSet(sharing.copied(train.release), train.truth.copy())
    if Knowledge.TRAIN in granted and train is None:
        raise DataError(
            f"attack {consumer.spec!r} needs other people to train on, but all tracks"
            " belong to one person or group; use a recording of more people or leave"
            " the attack out"
        )
    companions = (one.tracks(victims.tracks) for one in level.beside)
    repeats, seed = [], level.block.seed
    for number, release in enumerate(
        level.again if Knowledge.REPEATS in granted else ()
    ):
        rng = stream(seed, "frames", *level.key, fold, "again", number)
        own = release.tracks(victims.tracks)
        repeats.append(view_of(own, granted=granted, rng=rng)[0])
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
        companions=tuple(frame.release(showing(one, granted)) for one in companions),
    )


def _anchor(level: AttackedLevel, victims: Victims, frame: Frame) -> Release:
    """Return where each victim truly was at one of her instants, any of them, in a frame."""
    scenes, offsets = level.scenes, level.scenes.offsets
    drawn = stream(level.block.seed, "anchors", int(scenes.index[0])).random(
        offsets.size - 1
    )
    at = (offsets[:-1] + drawn * np.diff(offsets)).astype(np.int64)[victims.tracks]
    whose = victims.own.pseudonym
    return frame.release(
        Release(scenes.t[at], scenes.xy[at], None, np.arange(at.size + 1), whose)
    )


def beside(block: AttackedBlock, mechanism: Plugin) -> Release:
    """Return what is shared of who walks along with each of the N tracks of a block.

    That is who of the same group is there longest at the same time, sensed and shared
    with errors of their own; one sample, of the track itself, where nobody is.
    """
    scenes, tracks, seed = block.scenes, block.tracks, block.seed
    group = np.unique(tracks.group, return_inverse=True)[1]
    parts: list[tuple[Floats, Floats]] = []
    for seat, row in enumerate(scenes.track):
        lo, hi = scenes.offsets[seat : seat + 2]
        start = tracks.offsets[row]
        moved_m = scenes.xy[lo] - tracks.xy[start]
        best, longest_s = (scenes.t[lo : lo + 1], scenes.xy[lo : lo + 1]), 0.0
        for other in np.flatnonzero(group == group[row]):
            first, end = tracks.offsets[other], tracks.offsets[other + 1]
            t = tracks.t[first:end]
            both_s = min(t[-1], scenes.t[hi - 1]) - max(t[0], scenes.t[lo])
            if other != row and both_s > longest_s:
                best, longest_s = (t, tracks.xy[first:end] + moved_m), both_s
        parts.append(best)
    sizes = np.array([t.size for t, _ in parts])
    t, xy = (np.concatenate(of) for of in zip(*parts, strict=True))
    first_scene, offsets = int(scenes.index[0]), np.concatenate([[0], np.cumsum(sizes)])
    keys = [("beside", first_scene, seat) for seat in range(sizes.size)]
    sensing = block.stages.sensing
    channel = draw_channel(
        walked_m=walked_within(xy, offsets),
        n_samples=sizes[:, None],
        keys=keys,
        settings=sensing,
        seed=seed,
    )
    walk = walk_numbers("beside", first_scene, n_walks=sizes.size, seed=seed)
    sensed = sense(
        t=t, xy=xy, offsets=offsets, channel=channel, settings=sensing, walk=walk
    )
    return sharing.share(mechanism, sensed, "scenes", first_scene, "beside", seed=seed)


def benchmark(
    release: Release, *, sensed: Sensed, mechanism: Plugin, epsilon_m: float
) -> Rows:
    """Return mean squared error and PLR that the linear benchmark expects of each track, (N,).

    The benchmark is the exact smoother of a constant-velocity walk that knows the
    variance of every sample: no linear estimator has a smaller expected squared error,
    and none at all if the errors are Gaussian. Its posterior covariance P per axis
    depends on no position: the expected squared error is 2 P, and a Gaussian error of
    that size leaks with probability 1 - exp(-epsilon^2 / 2P). NaN for a mechanism whose
    `errors_are_independent` says that they are not, from sample to sample.
    """
    if not getattr(mechanism.instance, "errors_are_independent", True):
        return dict.fromkeys(_BENCHMARK, np.full(len(release), np.nan))
    law = getattr(mechanism.instance, "law", None) or sensed.law
    assert release.sigma is not None  # `share` refuses what declares none
    shared_m2, raw_m2 = release.sigma**2, sensed.sigma_raw**2
    # What a mechanism takes away it takes from the raw error, what it adds has its own
    # law; of an error of standard deviation 1 a law has so much variance per axis.
    sensed_share, own_share = (
        0.5 if one == "radial" else 1.0 for one in (sensed.law, law)
    )
    variance = sensed_share * np.minimum(shared_m2, raw_m2)
    variance += own_share * np.maximum(shared_m2 - raw_m2, 0.0)
    variance = np.maximum(variance, _LEAST_VARIANCE_M2, out=variance)
    batch = Batch(release.t, release.xy, variance, release.offsets, PRIOR_STD)
    square_m2 = 2.0 * smooth_positions(batch, q=BENCHMARK_Q)[1]
    expected = square_m2, -np.expm1(-(epsilon_m**2) / square_m2)
    means = (track_means(values, release.offsets) for values in expected)
    return dict(zip(_BENCHMARK, means, strict=True))
