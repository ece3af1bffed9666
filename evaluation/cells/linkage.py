"""How well each adversary links at one mechanism level of a task.

An attack that learns does so on people of the other half, and prepares anew for every mechanism
level.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from attacks.linkage.kinematic import Kinematic
from attacks.linkage.shape import Shape
from attacks.tasks.controls import CONTROLS
from evaluation.cells.link_scores import (
    AUDIT_SHUFFLES,
    SHUFFLES,
    calibrated,
    no_match_score,
    read_off,
)
from evaluation.cells.link_setup import SIDES, ground_without, samples_of, taken
from evaluation.cells.plugin_calls import copied, guarded
from evaluation.cells.progress import note
from evaluation.cells.windows import window_rows
from isac_track.errors import DataError, PluginError
from isac_track.protocols import AttackContext, LinkageTrainingSet, TrainingSet
from isac_track.rng import stream
from isac_track.types import Knowledge, Reconstruction, Release

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from evaluation.cells.link_scores import Linked
    from evaluation.cells.link_setup import Ground, Part
    from evaluation.cells.reconstruction import Rows
    from evaluation.experiment.axes import Consumer
    from isac_track.linkability import Calibration
    from isac_track.plugins import Plugin
    from isac_track.types import Floats, Ints, Sensed

Linker: TypeAlias = "Callable[[Release, Release], Floats]"
Share: TypeAlias = "Callable[[Sensed, tuple[str | int, ...]], Release]"


def link_level(
    mechanism: Plugin,
    consumers: Sequence[Consumer],
    *,
    ground: Ground,
    controlled: dict[str, Linked],
    share: Share,
    epsilon_m: float,
    seed: int,
) -> Iterator[tuple[Consumer, Linked | Rows]]:
    """Yield what each consumer links at one mechanism level, or the rows of the windows.

    Parameters
    ----------
    mechanism : Plugin
    consumers : sequence of Consumer
        Linkage attacks and controls of the task, and its windows.
    ground : Ground
    controlled : dict
        Controls that are alike at every level that leaves no sample out, as far as they are known;
        it is added to.
    share : callable
        From what was sensed and the name of a stream to a release of the mechanism.
    epsilon_m : float
    seed : int

    Raises
    ------
    PluginError
        If an attack raises or breaks its contract; the message names it.
    """
    task = ground.sessions.task
    shared = [
        share(sensed, ("linkage", task.family, side))
        for sensed, side in zip(ground.sensed, SIDES, strict=True)
    ]
    sessions, whole = ground.sessions, ground
    ground = ground_without(whole, shared)
    in_frame = shared
    if ground.frames is not None:
        in_frame = [frames.release(one) for frames, one in zip(ground.frames, shared, strict=True)]
    level = _Level(
        mechanism=mechanism,
        released=(in_frame[0], in_frame[1]),
        ground=ground,
        epsilon_m=epsilon_m,
        seed=seed,
        sides={},
    )
    for consumer in consumers:
        note(mechanism.spec, consumer.label)
        if consumer.kind == "windows":
            yield (
                consumer,
                window_rows(shared, ground=ground, sessions=sessions, epsilon_m=epsilon_m),
            )
        elif consumer.kind == "control":
            yield consumer, _controlled(consumer, level, controlled if ground is whole else {})
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
    sides: dict[tuple[object, ...], _Sides]
    """By the reconstruction in front, what it was granted, fold, and whether SIGMA shows."""


@dataclass(frozen=True, eq=False, slots=True)
class _Sides:
    """Both releases as some linkers get them, and what was taken of them already."""

    probe: Release
    gallery: Release
    known: dict[int, tuple[Release, Release]]

    def taken(self, part: Part) -> tuple[Release, Release]:
        """Return the windows of a part; those of a part of the ground are taken once."""
        if id(part) not in self.known:
            self.known[id(part)] = taken(self.probe, part.probe), taken(self.gallery, part.gallery)
        return self.known[id(part)]


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
        known = calibrated(found)
        if known is not None:
            calibration[fold] = known
            for number, part in half.searches:
                no_match[number] = no_match_score(known, part, mate_rate=half.mate_rate)
    rng = stream(level.seed, "linkage", "scorecard", consumer.spec, consumer.knowledge)
    return read_off(
        scores,
        ground=ground,
        calibration=calibration,
        no_match=no_match if ground.sessions.task.shows_scene else None,
        rng=rng,
        cohorts=True,
    )


def _controlled(consumer: Consumer, level: _Level, known: dict[str, Linked]) -> Linked:
    """Return what a control links: it learns nothing and knows what is declared."""
    ground, control = level.ground, CONTROLS[consumer.control]
    if consumer.control in known:
        return known[consumer.control]
    key = () if control.sees_times_only else (level.mechanism.spec,)
    rng = stream(level.seed, "controls", consumer.spec, *key)
    scores: dict[int, Floats] = {}
    for half in ground.halves:
        for number, part in half.searches:
            probe = taken(level.released[0], part.probe)
            gallery = taken(level.released[1], part.gallery)
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
    found = read_off(
        scores,
        ground=ground,
        calibration={},
        no_match={} if ground.sessions.task.shows_scene else None,
        rng=rng,
        cohorts=False,
        n_shuffles=AUDIT_SHUFFLES if control.is_audit else SHUFFLES,
    )
    if control.sees_times_only:
        known[consumer.control] = found
    return found


# What an attack is given


def _seen(consumer: Consumer, level: _Level, *, fold: int) -> _Sides:
    """Return both releases as a linker gets them: smoothed first, where it stands behind that."""
    assert consumer.plugin is not None
    knows_sigma = Knowledge.SIGMA in consumer.granted & _declared(consumer.plugin)
    behind = consumer.behind
    key: tuple[object, ...] = (knows_sigma,)
    if behind is not None:
        granted = consumer.granted & _declared(behind)
        key = (knows_sigma, behind.spec, granted, fold)
    if key not in level.sides:
        probe, gallery = level.released
        if behind is not None:
            probe, gallery = _smoothed(consumer, behind, level, granted=granted, fold=fold)
        if not knows_sigma:
            probe, gallery = probe.without_sigma(), gallery.without_sigma()
        level.sides[key] = _Sides(probe, gallery, {})
    return level.sides[key]


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
            copied(taken(seen[0], learns.probe)),
            _truth(level.ground, side=0, rows=learns.probe),
        )
        if learns.probe.size
        else None,
    )
    who = f"attack {behind.spec} (behind {consumer.label})"
    fitted = guarded(who, lambda: behind.instance.fit(context))
    smoothed = []
    for one, shown in zip(level.released, seen, strict=True):
        found = guarded(who, partial(fitted, copied(shown)))
        if not isinstance(found, Reconstruction) or found.xy.shape != one.xy.shape:
            got = getattr(getattr(found, "xy", None), "shape", type(found).__name__)
            raise PluginError(
                f"{who} must return a Reconstruction with xy {one.xy.shape}, got {got}"
            )
        smoothed.append(replace(one, xy=found.xy))
    return smoothed[0], smoothed[1]


def _fitted(consumer: Consumer, level: _Level, *, sides: _Sides, fold: int) -> Linker:
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
        probe, gallery = sides.taken(learns)
        train = LinkageTrainingSet(copied(probe), copied(gallery), learns.mate.copy())
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
    fitted: Linker = guarded(f"attack {consumer.label}", lambda: attack.fit(context))
    return fitted


def _scored(consumer: Consumer, fitted: Linker, sides: _Sides, part: Part) -> Floats:
    """Return what a linker makes of a search, (p, g); as single floats, as they are stored."""
    probe, gallery = sides.taken(part)
    if not consumer.is_built_in:  # a stranger may unlock arrays: what it writes to is its own
        probe, gallery = copied(probe), copied(gallery)
    found = guarded(f"attack {consumer.label}", lambda: fitted(probe, gallery))
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
    return xy[samples_of(windows.offsets, rows)[0]]
