"""What an adversary is given of a linkage task at one mechanism level, and how well it links.

Both releases of a task are sensed and shared like everything else. Unless the task shows the
scene, every walk is turned and shifted by itself and put on a clock of its own. An attack that
learns does so on people of the other half, and prepares anew for every mechanism level.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from attacks.controls import CONTROLS
from attacks.linkage.kinematic import Kinematic
from attacks.linkage.shape import Shape
from attacks.linkage.tasks import build
from isac_track.datasets import load
from isac_track.errors import DataError, PluginError
from isac_track.intervals import cluster_sums, cluster_weights, ratio_estimate
from isac_track.linkability import (
    Calibration,
    Scorecard,
    Search,
    fit_calibration,
    rank1,
    rank1_p,
    scorecard,
)
from isac_track.protocols import AttackContext, LinkageTrainingSet, TrainingSet
from isac_track.rng import stream
from isac_track.sensing import draw_channel, sense
from isac_track.types import Knowledge, Reconstruction, Release, Tracks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from numpy.random import Generator

    from attacks.linkage.task_list import Task
    from attacks.linkage.tasks import Sessions, Windows
    from evaluation.grid import Consumer
    from isac_track.config import StageSettings
    from isac_track.intervals import Estimate
    from isac_track.registry import Plugin
    from isac_track.types import Bools, Floats, Ints, Sensed

N_REPLICATES = 1000
WITHOUT_GROUPS, WITHOUT_FROZEN = "without_groups", "without_frozen"
"""Without people who walk in a group, and move alike; without nearly frozen annotations."""
_SIDES = ("probe", "gallery")
_FAR_M = 1000.0
_LONG_S = 86_400.0
_NEVER = 1e300
"""A score that no pair reaches."""

Linker: TypeAlias = "Callable[[Release, Release], Floats]"
Share: TypeAlias = "Callable[[Sensed, tuple[str | int, ...]], Release]"


@dataclass(frozen=True, eq=False, slots=True)
class Frames:
    """A frame and a clock for each of N walks: turned by the angle, then shifted."""

    cos: Floats
    """(M,)"""
    sin: Floats
    """(M,)"""
    shift_m: Floats
    """(M, 2)"""
    clock_s: Floats
    """(M,)"""

    def points(self, xy: Floats) -> Floats:
        """Return positions, (M, 2) m, each in the frame of its walk."""
        turned = np.empty_like(xy)
        turned[:, 0] = self.cos * xy[:, 0] - self.sin * xy[:, 1]
        turned[:, 1] = self.sin * xy[:, 0] + self.cos * xy[:, 1]
        return turned + self.shift_m

    def release(self, release: Release) -> Release:
        """Return a release, every walk in its frame and on its clock."""
        return replace(release, xy=self.points(release.xy), t=release.t + self.clock_s)


@dataclass(frozen=True, eq=False, slots=True)
class Part:
    """Some windows of both sides, and who is who in them: a search, or a training set."""

    probe: Ints
    """(p,) rows of the probe side."""
    gallery: Ints
    """(g,) rows of the gallery side."""
    mate: Ints
    """(p,) place in `gallery`, or -1."""


@dataclass(frozen=True, eq=False, slots=True)
class Half:
    """What belongs to one fold: whom its adversary attacks, and from whom it learns."""

    searches: tuple[tuple[int, Part], ...]
    """Number of the search, and its windows."""
    learns: Part
    calibrates: tuple[Part, ...]
    """Searches of the people on whose scores those of this fold are calibrated."""


@dataclass(frozen=True, eq=False, slots=True)
class Ground:
    """What all levels of a task share."""

    sessions: Sessions
    sensed: tuple[Sensed, Sensed]
    """Probe and gallery."""
    frames: tuple[Frames, Frames] | None
    """None where the task shows the scene."""
    halves: tuple[Half, ...]
    weights: Floats
    """(B, C) bootstrap weights of the clusters."""
    cluster: Ints
    """(K,) cluster of each person: a column of the weights."""
    controlled: dict[str, Linked]
    """Controls that are alike at every level, as far as they are known."""


@dataclass(frozen=True, eq=False, slots=True)
class Cohort:
    """Rank 1 among some of the people: probes and candidates are theirs alone."""

    rank1: Estimate
    chance: float
    p_rank1: float
    n_mated: int


@dataclass(frozen=True, eq=False, slots=True)
class Linked:
    """Outcome of one cell: raw scores, and all that is read off them."""

    searches: tuple[Search, ...]
    probe_person: tuple[Ints, ...]
    """Person of each probe, search by search."""
    gallery_person: tuple[Ints, ...]
    calibration: Mapping[int, Calibration]
    """By fold."""
    card: Scorecard
    parts: Mapping[str, Cohort]
    """By cohort, without the confounders; none for a control."""


def sessions_of(task: Task, *, tracks: Tracks, stages: StageSettings, seed: int) -> Sessions:
    """Return the sessions of a task: of the recording, or of the two-session crowd.

    Raises
    ------
    DataError
        If there are too few people for the task.
    """
    if not task.simulated:
        return build(task, tracks=tracks, later=None, settings=stages, seed=seed)
    first, second = _crowd(stages.linkage.trait_strength)
    return build(task, tracks=first, later=second, settings=stages, seed=seed)


def _crowd(trait_strength: float) -> tuple[Tracks, Tracks]:
    """Return the two sessions of the crowd: the bundled ones, or simulated anew."""
    if trait_strength == 1.0:
        return load("plaza").tracks, load("plaza-session2").tracks
    from isac_track.datasets.crowd import BUNDLED_SEED, generate  # noqa: PLC0415 - seldom needed
    from isac_track.datasets.crowd_plan import CrowdSettings  # noqa: PLC0415

    crowd = CrowdSettings(trait_strength=trait_strength)
    first, second = (generate(crowd, seed=BUNDLED_SEED, session=number) for number in (1, 2))
    return first, second


def ground(
    sessions: Sessions, *, groups: Sequence[str], stages: StageSettings, seed: int
) -> Ground:
    """Sense both sessions of a task and prepare its folds.

    Parameters
    ----------
    sessions : Sessions
    groups : sequence of str
        Clusters of the run's scenes: who is in both is drawn alike in both.
    stages : StageSettings
    seed : int
    """
    weights, cluster = _weights(sessions, groups=groups, seed=seed)
    frames = None
    if not sessions.task.shows_scene:
        frames = (_frames(sessions, "probe", seed=seed), _frames(sessions, "gallery", seed=seed))
    return Ground(
        sessions=sessions,
        sensed=(
            _sensed(sessions, "probe", stages=stages, seed=seed),
            _sensed(sessions, "gallery", stages=stages, seed=seed),
        ),
        frames=frames,
        halves=tuple(_half(sessions, fold) for fold in np.unique(sessions.fold).tolist()),
        weights=weights,
        cluster=cluster,
        controlled={},
    )


def link_level(
    mechanism: Plugin,
    consumers: Sequence[Consumer],
    *,
    ground: Ground,
    share: Share,
    epsilon_m: float,
    seed: int,
) -> Iterator[tuple[Consumer, Linked]]:
    """Yield what each consumer links at one mechanism level.

    Parameters
    ----------
    mechanism : Plugin
    consumers : sequence of Consumer
        Linkage attacks and controls of the task.
    ground : Ground
    share : callable
        From what was sensed and the name of a stream to a release of the mechanism.
    epsilon_m : float
    seed : int

    Raises
    ------
    PluginError
        If an attack raises or breaks its contract; the message names it.
    """
    task = ground.sessions.task.name
    shared = [
        share(sensed, ("linkage", task, side))
        for sensed, side in zip(ground.sensed, _SIDES, strict=True)
    ]
    if ground.frames is not None:
        shared = [frames.release(one) for frames, one in zip(ground.frames, shared, strict=True)]
    level = _Level(
        mechanism=mechanism,
        released=(shared[0], shared[1]),
        ground=ground,
        epsilon_m=epsilon_m,
        seed=seed,
        smoothed={},
    )
    for consumer in consumers:
        if consumer.kind == "control":
            yield consumer, _controlled(consumer, level)
        else:
            yield consumer, _linked(consumer, level)


@dataclass(frozen=True, eq=False, slots=True)
class _Level:
    mechanism: Plugin
    released: tuple[Release, Release]
    """As an adversary sees them, with the declared standard deviations."""
    ground: Ground
    epsilon_m: float
    seed: int
    smoothed: dict[tuple[str, frozenset[Knowledge], int], tuple[Release, Release]]
    """By reconstruction, what it was granted, and fold: many linkers stand behind one."""


def _linked(consumer: Consumer, level: _Level) -> Linked:
    assert consumer.plugin is not None
    ground = level.ground
    scores: dict[int, Floats] = {}
    calibration: dict[int, Calibration] = {}
    no_match: dict[int, float] = {}
    for fold, half in enumerate(ground.halves):
        sides = _seen(consumer, level, fold=fold)
        fitted = _fitted(consumer, level, sides=sides, fold=fold)
        score = partial(_scored, consumer, fitted, sides)
        for number, part in half.searches:
            scores[number] = score(part)
        found = [(score(part), part) for part in half.calibrates]
        known = _calibrated(found)
        if known is not None:
            calibration[fold] = known
            no_match[fold] = _no_match_score(known, half)
    rng = stream(level.seed, "linkage", "scorecard", consumer.spec, consumer.knowledge)
    return _read(
        scores,
        ground=ground,
        calibration=calibration,
        no_match=no_match if ground.sessions.task.shows_scene else {},
        rng=rng,
        cohorts=True,
    )


def _controlled(consumer: Consumer, level: _Level) -> Linked:
    """Return what a control links: it learns nothing and knows what is declared."""
    ground, control = level.ground, CONTROLS[consumer.control]
    if consumer.control in ground.controlled:
        return ground.controlled[consumer.control]
    key = () if control.sees_times_only else (level.mechanism.spec,)
    rng = stream(level.seed, "controls", consumer.spec, *key)
    scores: dict[int, Floats] = {}
    for half in ground.halves:
        for number, part in half.searches:
            probe = _taken(level.released[0], part.probe)
            gallery = _taken(level.released[1], part.gallery)
            score = control.scorer(ground.sessions.task)
            if score is not None:
                scores[number] = score(probe, gallery, rng)
            else:
                attack = Kinematic() if ground.sessions.task.shows_scene else Shape()
                context = AttackContext(
                    rng=rng,
                    epsilon_m=level.epsilon_m,
                    granted=attack.requires & ground.sessions.task.everyone,
                )
                real = attack.fit(context)(probe.without_sigma(), gallery.without_sigma())
                scores[number] = real[:, rng.permutation(real.shape[1])]
    found = _read(scores, ground=ground, calibration={}, no_match={}, rng=rng, cohorts=False)
    if control.sees_times_only:
        ground.controlled[consumer.control] = found
    return found


# What an attack is given


def _seen(consumer: Consumer, level: _Level, *, fold: int) -> tuple[Release, Release]:
    """Return both releases as a linker gets them: smoothed first, where it stands behind that."""
    assert consumer.plugin is not None
    knows_sigma = Knowledge.SIGMA in consumer.granted & _declared(consumer.plugin)
    behind = consumer.behind
    released = level.released
    if behind is not None:
        granted = consumer.granted & _declared(behind)
        key = (behind.spec, granted, fold)
        if key not in level.smoothed:
            level.smoothed[key] = _smoothed(consumer, behind, level, granted=granted, fold=fold)
        released = level.smoothed[key]
    if knows_sigma:
        return released
    return released[0].without_sigma(), released[1].without_sigma()


def _smoothed(
    consumer: Consumer,
    behind: Plugin,
    level: _Level,
    *,
    granted: frozenset[Knowledge],
    fold: int,
) -> tuple[Release, Release]:
    """Return both releases with the positions that a reconstruction attack makes of them."""
    granted = _without_undeclared(granted, behind, level)
    learns = level.ground.halves[fold].learns
    seen = [one if Knowledge.SIGMA in granted else one.without_sigma() for one in level.released]
    context = AttackContext(
        rng=stream(level.seed, "attacks", behind.spec, "linkage", level.mechanism.spec, fold),
        epsilon_m=level.epsilon_m,
        granted=granted,
        mechanism=level.mechanism.instance,
        train=TrainingSet(
            _copied(_taken(seen[0], learns.probe)),
            _truth(level.ground, side=0, rows=learns.probe),
        )
        if learns.probe.size
        else None,
    )
    who = f"attack {behind.spec} (behind {consumer.label})"
    fitted = _guarded(who, lambda: behind.instance.fit(context))
    smoothed = []
    for one, shown in zip(level.released, seen, strict=True):
        found = _guarded(who, partial(fitted, _copied(shown)))
        if not isinstance(found, Reconstruction) or found.xy.shape != one.xy.shape:
            got = getattr(getattr(found, "xy", None), "shape", type(found).__name__)
            raise PluginError(
                f"{who} must return a Reconstruction with xy {one.xy.shape}, got {got}"
            )
        smoothed.append(replace(one, xy=found.xy))
    return smoothed[0], smoothed[1]


def _fitted(
    consumer: Consumer, level: _Level, *, sides: tuple[Release, Release], fold: int
) -> Linker:
    assert consumer.plugin is not None
    granted = consumer.granted & _declared(consumer.plugin)
    granted = _without_undeclared(granted, consumer.plugin, level)
    learns = level.ground.halves[fold].learns
    train = None
    if Knowledge.TRAIN in granted:
        if not ((learns.mate >= 0).any() and learns.gallery.size):
            raise DataError(
                f"attack {consumer.label} learns from other people, but there is nobody to learn "
                f"from in {level.ground.sessions.task.name}; use a recording of more people or "
                "leave the attack out"
            )
        train = LinkageTrainingSet(
            _copied(_taken(sides[0], learns.probe)),
            _copied(_taken(sides[1], learns.gallery)),
            learns.mate.copy(),
        )
    context = AttackContext(
        rng=stream(
            level.seed, "attacks", consumer.spec, consumer.knowledge, level.mechanism.spec, fold
        ),
        epsilon_m=level.epsilon_m,
        granted=granted,
        mechanism=level.mechanism.instance,
        train=train,
    )
    attack = consumer.plugin.instance
    fitted: Linker = _guarded(f"attack {consumer.label}", lambda: attack.fit(context))
    return fitted


def _scored(
    consumer: Consumer, fitted: Linker, sides: tuple[Release, Release], part: Part
) -> Floats:
    """Return what a linker makes of a search, (p, g); as single floats, as they are stored."""
    probe, gallery = _taken(sides[0], part.probe), _taken(sides[1], part.gallery)
    if not consumer.is_built_in:  # a stranger may unlock arrays: what it writes to is its own
        probe, gallery = _copied(probe), _copied(gallery)
    found = _guarded(f"attack {consumer.label}", lambda: fitted(probe, gallery))
    expected = (part.probe.size, part.gallery.size)
    scores = np.asarray(found)
    if scores.shape != expected or scores.dtype.kind not in "fiu":
        raise PluginError(
            f"attack {consumer.label} must return scores {expected}, got {scores.shape} of "
            f"{scores.dtype}"
        )
    with np.errstate(over="ignore"):
        single = scores.astype(np.float32)
    if not np.isfinite(single).all():
        raise PluginError(f"attack {consumer.label} returned a score that is not finite")
    return single.astype(np.float64)


def _guarded(who: str, call: Callable[[], Any]) -> Any:  # noqa: ANN401 - whatever a plug-in returns
    try:
        return call()
    except (Exception, SystemExit) as error:  # a plug-in may do anything
        raise PluginError(f"{who} failed: {type(error).__name__}: {error}") from error


def _declared(plugin: Plugin) -> frozenset[Knowledge]:
    declared: frozenset[Knowledge] = plugin.instance.requires | plugin.instance.uses
    return declared


def _without_undeclared(
    granted: frozenset[Knowledge], plugin: Plugin, level: _Level
) -> frozenset[Knowledge]:
    """Return what a plug-in gets: without SIGMA where the mechanism declares none."""
    if Knowledge.SIGMA not in granted or all(one.sigma is not None for one in level.released):
        return granted
    if Knowledge.SIGMA in plugin.instance.requires:
        raise PluginError(
            f"attack {plugin.spec} requires SIGMA, but mechanism {level.mechanism.spec!r} "
            "declares none; leave one of the two out"
        )
    return granted - {Knowledge.SIGMA}


def _truth(ground: Ground, *, side: int, rows: Ints) -> Floats:
    """Return true positions in the frames that the adversary sees, (m, 2) m."""
    windows = ground.sessions.probe if side == 0 else ground.sessions.gallery
    xy = windows.xy if ground.frames is None else ground.frames[side].points(windows.xy)
    return xy[_samples(windows.offsets, rows)[0]]


# What is read off the scores


def _read(
    scores: Mapping[int, Floats],
    *,
    ground: Ground,
    calibration: Mapping[int, Calibration],
    no_match: Mapping[int, float],
    rng: Generator,
    cohorts: bool,
) -> Linked:
    sessions = ground.sessions
    part_of = {number: part for half in ground.halves for number, part in half.searches}
    numbers = sorted(scores)
    probe_person = [sessions.probe.person[part_of[number].probe] for number in numbers]
    gallery_person = [sessions.gallery.person[part_of[number].gallery] for number in numbers]
    searches = [
        Search(
            scores=scores[number],
            mate=part_of[number].mate,
            probe_cluster=ground.cluster[probe],
            gallery_cluster=ground.cluster[gallery],
            scale=int(sessions.fold[number]),
        )
        for number, probe, gallery in zip(numbers, probe_person, gallery_person, strict=True)
    ]
    scales = {search.scale for search in searches}
    card = scorecard(
        searches,
        weights=ground.weights,
        calibration=calibration if scales <= set(calibration) else None,
        no_match_score=no_match if scales <= set(no_match) else None,
        rng=rng,
    )
    parts = {}
    if cohorts:
        parts = {
            name: _cohort(
                searches,
                [kept[one] for one in probe_person],
                [kept[one] for one in gallery_person],
                weights=ground.weights,
            )
            for name, kept in (
                (WITHOUT_GROUPS, sessions.alone),
                (WITHOUT_FROZEN, sessions.moving),
            )
        }
    return Linked(
        searches=tuple(searches),
        probe_person=tuple(probe_person),
        gallery_person=tuple(gallery_person),
        calibration=calibration,
        card=card,
        parts=parts,
    )


def _cohort(
    searches: Sequence[Search],
    probes: Sequence[Bools],
    galleries: Sequence[Bools],
    *,
    weights: Floats,
) -> Cohort:
    """Return rank 1 where only some people are probes and candidates."""
    hits, chances, clusters = [], [], []
    for search, probe, gallery in zip(searches, probes, galleries, strict=True):
        place = np.cumsum(gallery) - 1
        mate = np.where((search.mate >= 0) & gallery[search.mate], place[search.mate], -1)[probe]
        if not (mate >= 0).any():
            continue
        hit = rank1(scores=search.scores[probe][:, gallery], mate=mate)
        has = mate >= 0
        hits.append(hit[has])
        chances.append(np.full(int(has.sum()), 1.0 / gallery.sum()))
        clusters.append(search.probe_cluster[probe][has])
    hit, chance = (np.concatenate([*parts, np.zeros(0)]) for parts in (hits, chances))
    cluster = np.concatenate([*clusters, np.zeros(0, dtype=np.int64)])
    sums = [
        cluster_sums(values=values, cluster=cluster, n_clusters=weights.shape[1])
        for values in (hit, np.ones_like(hit))
    ]
    return Cohort(
        rank1=ratio_estimate(
            numerator=sums[0], denominator=sums[1], weights=weights, is_share=True
        ),
        chance=float(chance.mean()) if chance.size else float("nan"),
        p_rank1=rank1_p(hits=hit, chance=chance) if chance.size else float("nan"),
        n_mated=hit.size,
    )


def _calibrated(found: Sequence[tuple[Floats, Part]]) -> Calibration | None:
    """Return the calibration on people who are neither attacked nor learnt from."""
    mated, non_mated = [np.zeros(0)], [np.zeros(0)]
    for scores, part in found:
        is_mate = np.zeros(scores.shape, dtype=bool)
        has = np.flatnonzero(part.mate >= 0)
        is_mate[has, part.mate[has]] = True
        mated.append(scores[is_mate])
        non_mated.append(scores[~is_mate])
    first, second = np.concatenate(mated), np.concatenate(non_mated)
    if not (first.size and second.size):
        return None
    return fit_calibration(mated=first, non_mated=second)


def _no_match_score(calibration: Calibration, half: Half) -> float:
    """Return the score at which a pair is as likely mates as not, among so many candidates."""
    n_mated = sum(int((part.mate >= 0).sum()) for part in half.calibrates)
    n_pairs = sum(part.probe.size * part.gallery.size for part in half.calibrates)
    needed = float(np.log((n_pairs - n_mated) / n_mated))
    if calibration.slope <= 0.0:  # scores tell nothing, and mates are rare: nobody is linked
        return _NEVER
    return min((needed - calibration.intercept) / calibration.slope, _NEVER)


# Preparation


def _half(sessions: Sessions, fold: int) -> Half:
    mine = np.flatnonzero(sessions.fold == fold)
    others = np.flatnonzero(sessions.fold != fold)

    def part(searches: Ints, people: Bools | None) -> Part:
        probe = np.isin(sessions.probe.search, searches)
        gallery = np.isin(sessions.gallery.search, searches)
        if people is not None:
            probe &= people[sessions.probe.person]
            gallery &= people[sessions.gallery.person]
        place = np.where(gallery, np.cumsum(gallery) - 1, -1)
        mate = sessions.mate[probe]
        return Part(
            probe=np.flatnonzero(probe),
            gallery=np.flatnonzero(gallery),
            mate=np.where(mate >= 0, place[mate], -1),
        )

    calibrates = (part(np.array([number]), sessions.calibrates[fold]) for number in others)
    return Half(
        searches=tuple((int(number), part(np.array([number]), None)) for number in mine),
        learns=part(others, sessions.learns[fold]),
        calibrates=tuple(one for one in calibrates if (one.mate >= 0).any()),
    )


def _weights(sessions: Sessions, *, groups: Sequence[str], seed: int) -> tuple[Floats, Ints]:
    """Return bootstrap weights, (B, C), and the column of each person, (K,).

    Clusters that the run's scenes have as well are drawn as they are there; the others are drawn
    among themselves.
    """
    names = sorted(set(sessions.group))
    column = {name: place for place, name in enumerate(names)}
    weights = np.empty((N_REPLICATES, len(names)))
    known = {name: place for place, name in enumerate(groups)}
    again = [name for name in names if name in known]
    if again:
        drawn = cluster_weights(n_clusters=len(groups), n_replicates=N_REPLICATES, seed=seed)
        weights[:, [column[name] for name in again]] = drawn[:, [known[name] for name in again]]
    further = [column[name] for name in names if name not in known]
    if further:
        rng = stream(seed, "bootstrap", "linkage", sessions.task.name)
        share = np.full(len(further), 1.0 / len(further))
        weights[:, further] = rng.multinomial(len(further), share, N_REPLICATES)
    return weights, np.array([column[name] for name in sessions.group], dtype=np.int64)


def _side(sessions: Sessions, side: str) -> Windows:
    return sessions.probe if side == "probe" else sessions.gallery


def _sensed(sessions: Sessions, side: str, *, stages: StageSettings, seed: int) -> Sensed:
    """Return what the network senses of one side; every window draws from its own streams."""
    windows, task = _side(sessions, side), sessions.task
    drawn = []
    for size, person, search in zip(
        np.diff(windows.offsets), windows.person, windows.search, strict=True
    ):
        # The number of a closed search is a half, which may change with who else is there.
        key = ("linkage", task.name, side, sessions.source[person])
        drawn.append(
            draw_channel(
                n_samples=np.array([[size]]),
                keys=[(*key, int(search)) if task.shows_scene else key],
                settings=stages.sensing,
                seed=seed,
            )
        )
    channel = type(drawn[0])(
        *(np.concatenate([getattr(one, item.name) for one in drawn]) for item in fields(drawn[0]))
    )
    return sense(
        t=windows.t,
        xy=windows.xy,
        offsets=windows.offsets,
        channel=channel,
        settings=stages.sensing,
    )


def _frames(sessions: Sessions, side: str, *, seed: int) -> Frames:
    """Return the frames of one side: those of a walk are its own, whoever else is there."""
    windows = _side(sessions, side)
    drawn = np.empty((len(windows), 4))
    for row, person in enumerate(windows.person):
        rng = stream(seed, "frames", "linkage", sessions.task.name, side, sessions.source[person])
        drawn[row] = rng.random(4)
    angle, *shift, clock = np.repeat(drawn, np.diff(windows.offsets), axis=0).T
    return Frames(
        cos=np.cos(2.0 * np.pi * angle),
        sin=np.sin(2.0 * np.pi * angle),
        shift_m=_FAR_M * (2.0 * np.column_stack(shift) - 1.0),
        clock_s=_LONG_S * clock,
    )


def _samples(offsets: Ints, rows: Ints) -> tuple[Ints, Ints]:
    """Return the samples of some tracks, and the tracks' offsets among them."""
    sizes = np.diff(offsets)[rows]
    taken = np.concatenate([[0], np.cumsum(sizes)])
    return np.repeat(offsets[rows] - taken[:-1], sizes) + np.arange(taken[-1]), taken


def _taken(release: Release, rows: Ints) -> Release:
    samples, offsets = _samples(release.offsets, rows)
    return Release(
        t=release.t[samples],
        xy=release.xy.take(samples, axis=0),
        sigma=None if release.sigma is None else release.sigma[samples],
        offsets=offsets,
        pseudonym=tuple(release.pseudonym[row] for row in rows),
    )


def _copied(release: Release) -> Release:
    return replace(
        release,
        t=release.t.copy(),
        xy=release.xy.copy(),
        sigma=None if release.sigma is None else release.sigma.copy(),
        offsets=release.offsets.copy(),
    )
