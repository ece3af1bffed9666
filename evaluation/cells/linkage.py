"""The stages of linkage: how well each adversary links at one mechanism level of a task.

An attack that learns does so on people of the other half, and prepares anew for every mechanism
level.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from attacks.linkage.kinematic import Kinematic
from attacks.linkage.shape import Shape
from attacks.tasks.controls import CONTROLS
from evaluation.cells.adversary import declared, fitted, granted_at, reconstructed, showing
from evaluation.cells.link_scores import (
    AUDIT_SHUFFLES,
    SHUFFLES,
    calibrated,
    no_match_score,
    read_off,
)
from evaluation.cells.link_setup import SIDES, without
from evaluation.cells.plugin_calls import copied, guarded
from evaluation.cells.samples import samples_of, tracks_of
from evaluation.cells.sharing import share
from evaluation.cells.windows import window_rows
from isac_track.errors import DataError, PluginError
from isac_track.protocols import AttackContext, LinkageTrainingSet, TrainingSet
from isac_track.rng import stream
from isac_track.types import Knowledge

if TYPE_CHECKING:
    from collections.abc import Callable

    from evaluation.cells.link_scores import Linked
    from evaluation.cells.link_setup import Pairing, SensedSessions
    from evaluation.cells.tables import Rows
    from evaluation.experiment.axes import Consumer
    from isac_track.linkability import Calibration
    from isac_track.plugins import Plugin
    from isac_track.types import Floats, Ints, Release


@dataclass(frozen=True, eq=False, slots=True)
class LinkedLevel:
    """What all that link at one mechanism level of a task share."""

    mechanism: Plugin
    shared: tuple[Release, Release]
    """Of the probe and of the gallery side, in the true frame."""
    released: tuple[Release, Release]
    """As an adversary sees them, with the declared standard deviations."""
    known: SensedSessions
    """Without the samples that were left out."""
    leaves_out: bool
    """Whether there are such samples."""
    epsilon_m: float
    seed: int
    sides: dict[tuple[object, ...], _Sides]
    """By the reconstruction in front, what it was granted, fold, and whether SIGMA shows."""


@dataclass(frozen=True, eq=False, slots=True)
class _Sides:
    """Both releases as some linkers get them, and the windows of each pairing so far."""

    probe: Release
    gallery: Release
    found: dict[int, tuple[Release, Release]]

    def of(self, pairing: Pairing) -> tuple[Release, Release]:
        """Return the windows of a pairing, the same ones every time."""
        if id(pairing) not in self.found:
            self.found[id(pairing)] = (
                tracks_of(self.probe, pairing.probe),
                tracks_of(self.gallery, pairing.gallery),
            )
        return self.found[id(pairing)]


def linked_level(
    mechanism: Plugin, *, known: SensedSessions, epsilon_m: float, seed: int
) -> LinkedLevel:
    """Share both sessions of a task.

    Raises
    ------
    PluginError
        If the mechanism raises or breaks its contract; the message names it.
    """
    family = known.sessions.task.family
    probe, gallery = (
        share(mechanism, sensed, "linkage", family, side, seed=seed)
        for sensed, side in zip(known.sensed, SIDES, strict=True)
    )
    rest = without(known, (probe, gallery))
    released = (probe, gallery)
    if rest.frames is not None:
        released = (rest.frames[0].release(probe), rest.frames[1].release(gallery))
    return LinkedLevel(
        mechanism=mechanism,
        shared=(probe, gallery),
        released=released,
        known=rest,
        leaves_out=rest is not known,
        epsilon_m=epsilon_m,
        seed=seed,
        sides={},
    )


def link(
    consumer: Consumer,
    level: LinkedLevel,
    *,
    whole: SensedSessions,
    controls: dict[str, Linked],
) -> Linked | Rows:
    """Return what a consumer links at one mechanism level, or the rows of the windows.

    Parameters
    ----------
    consumer : Consumer
        A linkage attack or control of the task, or its windows.
    level : LinkedLevel
    whole : SensedSessions
        With the samples that the level left out.
    controls : dict
        Those that are alike at every level that leaves nothing out, as far as they are known; it
        is added to.

    Raises
    ------
    PluginError
        If an attack raises or breaks its contract; the message names it.
    """
    if consumer.kind == "windows":
        return window_rows(
            level.shared, known=level.known, sessions=whole.sessions, epsilon_m=level.epsilon_m
        )
    if consumer.kind != "control":
        return _linked(consumer, level)
    if not CONTROLS[consumer.control].sees_times_only or level.leaves_out:
        return _controlled(consumer, level)
    if consumer.control not in controls:
        controls[consumer.control] = _controlled(consumer, level)
    return controls[consumer.control]


def _linked(consumer: Consumer, level: LinkedLevel) -> Linked:
    known = level.known
    scores: dict[int, Floats] = {}
    calibration: dict[int, Calibration] = {}
    no_match: dict[int, float] = {}
    for fold, half in enumerate(known.halves):
        sides = _sides(consumer, level, fold=fold)
        attack = _fitted(consumer, level, sides=sides, fold=fold)
        score = partial(_scored, consumer, attack, sides)
        for number, pairing in half.searches:
            scores[number] = score(pairing)
        on_others = calibrated([(score(pairing), pairing) for pairing in half.calibrates])
        if on_others is not None:
            calibration[fold] = on_others
            for number, pairing in half.searches:
                no_match[number] = no_match_score(on_others, pairing, mate_rate=half.mate_rate)
    return read_off(
        scores,
        known=known,
        calibration=calibration,
        no_match=no_match if known.sessions.task.shows_scene else None,
        rng=stream(level.seed, "linkage", "scorecard", consumer.spec, consumer.knowledge),
        is_control=False,
    )


def _controlled(consumer: Consumer, level: LinkedLevel) -> Linked:
    """Return what a control links: it learns nothing and knows what is declared."""
    known, control = level.known, CONTROLS[consumer.control]
    key = () if control.sees_times_only else (level.mechanism.spec,)
    rng = stream(level.seed, "controls", consumer.spec, *key)
    task = known.sessions.task
    scores: dict[int, Floats] = {}
    for half in known.halves:
        for number, pairing in half.searches:
            probe = tracks_of(level.released[0], pairing.probe)
            gallery = tracks_of(level.released[1], pairing.gallery)
            score = control.scorer(task)
            if score is not None:
                scores[number] = score(probe, gallery, rng)
                continue
            attack = Kinematic() if task.shows_scene else Shape()
            context = AttackContext(
                rng=rng, epsilon_m=level.epsilon_m, granted=attack.requires & task.everyone
            )
            real = attack.fit(context)(probe.without_sigma(), gallery.without_sigma())
            scores[number] = real[:, rng.permutation(real.shape[1])]
    return read_off(
        scores,
        known=known,
        calibration={},
        no_match={} if task.shows_scene else None,
        rng=rng,
        is_control=True,
        n_shuffles=AUDIT_SHUFFLES if control.is_audit else SHUFFLES,
    )


def _sides(consumer: Consumer, level: LinkedLevel, *, fold: int) -> _Sides:
    """Return both releases as a linker gets them: smoothed first, where it stands behind that."""
    assert consumer.plugin is not None
    knows_sigma = Knowledge.SIGMA in consumer.granted & declared(consumer.plugin)
    behind = consumer.behind
    key: tuple[object, ...] = (knows_sigma,)
    if behind is not None:
        key = (knows_sigma, behind.spec, consumer.granted & declared(behind), fold)
    if key not in level.sides:
        probe, gallery = level.released
        if behind is not None:
            probe, gallery = _smoothed(consumer, behind, level, fold=fold)
        if not knows_sigma:
            probe, gallery = probe.without_sigma(), gallery.without_sigma()
        level.sides[key] = _Sides(probe, gallery, {})
    return level.sides[key]


def _smoothed(
    consumer: Consumer, behind: Plugin, level: LinkedLevel, *, fold: int
) -> tuple[Release, Release]:
    """Return both releases with the positions that a reconstruction attack makes of them."""
    who = f"attack {behind.spec} (behind {consumer.label})"
    granted = _granted(consumer, behind, level)
    learns = level.known.halves[fold].learns
    probe, gallery = (showing(one, granted) for one in level.released)
    train = None
    if learns.probe.size:
        train = TrainingSet(
            copied(tracks_of(probe, learns.probe)), _truth_of_probes(level.known, learns.probe)
        )
    attack = fitted(
        behind,
        who=who,
        granted=granted,
        mechanism=level.mechanism,
        rng=stream(level.seed, "attacks", behind.spec, "linkage", level.mechanism.spec, fold),
        epsilon_m=level.epsilon_m,
        train=train,
    )
    first, second = (
        replace(one, xy=reconstructed(attack, copied(shown), who=who))
        for one, shown in zip(level.released, (probe, gallery), strict=True)
    )
    return first, second


def _fitted(
    consumer: Consumer, level: LinkedLevel, *, sides: _Sides, fold: int
) -> Callable[..., object]:
    assert consumer.plugin is not None
    granted = _granted(consumer, consumer.plugin, level)
    learns = level.known.halves[fold].learns
    train = None
    if Knowledge.TRAIN in granted:
        if not ((learns.mate >= 0).any() and learns.gallery.size):
            raise DataError(
                f"attack {consumer.label} learns from other people, but there is nobody to learn "
                f"from in {level.known.sessions.task.name}; use a recording of more people or "
                "leave the attack out"
            )
        probe, gallery = sides.of(learns)
        train = LinkageTrainingSet(copied(probe), copied(gallery), learns.mate.copy())
    key = (consumer.spec, consumer.knowledge, level.mechanism.spec, fold)
    return fitted(
        consumer.plugin,
        who=f"attack {consumer.label}",
        granted=granted,
        mechanism=level.mechanism,
        rng=stream(level.seed, "attacks", *key),
        epsilon_m=level.epsilon_m,
        train=train,
    )


def _granted(consumer: Consumer, plugin: Plugin, level: LinkedLevel) -> frozenset[Knowledge]:
    """Return what one of a consumer's plug-ins gets at a level."""
    return granted_at(
        consumer.granted & declared(plugin),
        plugin,
        who=f"attack {plugin.spec}",
        mechanism=level.mechanism,
        has_sigma=all(one.sigma is not None for one in level.released),
    )


def _scored(
    consumer: Consumer, attack: Callable[..., object], sides: _Sides, pairing: Pairing
) -> Floats:
    """Return what a linker makes of a search, (p, g), in single precision."""
    probe, gallery = sides.of(pairing)
    if not consumer.is_built_in:  # a stranger may unlock arrays: what it writes to is its own
        probe, gallery = copied(probe), copied(gallery)
    found = guarded(f"attack {consumer.label}", lambda: attack(probe, gallery))
    expected = (pairing.probe.size, pairing.gallery.size)
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


def _truth_of_probes(known: SensedSessions, rows: Ints) -> Floats:
    """Return true positions of some probes in the frames that the adversary sees, (m, 2) m."""
    windows = known.sessions.probe
    xy = windows.xy if known.frames is None else known.frames[0].points(windows.xy)
    return xy[samples_of(windows.offsets, rows).rows]
