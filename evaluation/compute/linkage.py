"""The stages of linkage: how well each adversary links at one mechanism level of a task.

An attack that learns does so on people of the other half, and prepares anew for every
mechanism level. Beside the attacks a cell has a row for every window, of what it gives
away by itself: what a person's linkability is compared with.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from attacks.linkage.alignment import Shape
from attacks.remembered import part, reconstructed_from
from attacks.tasks.controls import CONTROLS, closeness
from evaluation.compute import sharing
from evaluation.compute.candidates import (
    AT_ONCE,
    CHECKED,
    among_candidates,
    first_stage,
)
from evaluation.compute.link_scores import (
    Linked,
    calibrated,
    matched_pairs,
    read_off,
    score_scale,
)
from evaluation.compute.link_setup import SIDES, Pairing, SensedSessions
from evaluation.compute.sharing import declared, reconstructed, showing
from evaluation.compute.tables import (
    DESCRIPTORS,
    ON_TRIAL,
    ROWS,
    Tables,
    descriptors,
    names_column,
    table,
    track_means,
)
from evaluation.plan.constants import BOUND
from isac_track import privacy
from isac_track.errors import DataError, PluginError
from isac_track.kalman import Batch
from isac_track.model_world import START_STD_M, Motion, errors_of, log_ratios
from isac_track.protocols import (
    AttackContext,
    LinkageAttack,
    LinkageTrainingSet,
    TrainingSet,
)
from isac_track.rng import stream
from isac_track.types import Floats, Knowledge, Release, derived

if TYPE_CHECKING:
    from attacks.tasks.sessions import Sessions, Windows
    from evaluation.plan.axes import Consumer
    from isac_track.linkability import Calibration
    from isac_track.plugins import Plugin

WINDOW_COLUMNS = (  # Of the rows of a cell of windows.
    "side",
    "search",
    "source",
    "group",
    "n_samples",
    "duration_s",
    "speed_mps",
    "sigma_m",
    *DESCRIPTORS,
    *ON_TRIAL,
)
_LAG_STEP_S = 0.2
_LAG_WIDTH = 3  # Steps over which a lag counts.
_LEAST_WEIGHT = 0.1


@dataclass(frozen=True, eq=False, slots=True)
class _Sides:
    """Both releases as some linkers get them, and the windows of each pairing so far."""

    both: tuple[Release, ...]
    std: tuple[
        Floats | None, ...
    ] = ()  # (M,) m of either, that the reconstruction in front claims
    found: dict[int, tuple[Release, Release]] = field(default_factory=dict)

    def of(self, pairing: Pairing) -> tuple[Release, Release]:
        """Return the windows of a pairing, the same ones every time."""
        if id(pairing) not in self.found:
            probe, gallery = self.both
            self.found[id(pairing)] = (
                part(probe, pairing.probe),
                part(gallery, pairing.gallery),
            )
        return self.found[id(pairing)]


@dataclass(frozen=True, eq=False, slots=True)
class LinkedLevel:
    """What all that link at one mechanism level of a task share."""

    mechanism: Plugin
    whole: SensedSessions
    # Without the samples that were left out; `whole` if there are none.
    known: SensedSessions
    shared: tuple[
        Release, ...
    ]  # Of the probe and of the gallery side, in the true frame.
    blind: _Sides  # The same in the frames of the adversary,
    seen: _Sides  # and with the declared standard deviations.
    sides: dict[tuple[object, ...], _Sides] = field(default_factory=dict)
    """By whether SIGMA shows, the reconstruction in front, what it was granted, and fold."""

    def showing(self, granted: frozenset[Knowledge]) -> _Sides:
        """Return both releases as they show, the same ones every time."""
        return self.seen if Knowledge.SIGMA in granted else self.blind

    def context(
        self,
        granted: frozenset[Knowledge],
        *names: str | int,
        train: TrainingSet | LinkageTrainingSet | None = None,
    ) -> AttackContext:
        """Return what an attack prepares with that is granted so much; `names` are its stream's."""
        return AttackContext(
            rng=stream(self.known.seed, *names),
            epsilon_m=self.known.privacy.epsilon_m,
            granted=granted,
            mechanism=self.mechanism.instance,
            train=train,
        )


def linked_level(mechanism: Plugin, whole: SensedSessions) -> LinkedLevel:
    """Share both sessions of a task."""
    family = whole.sessions.task.family
    known, shared, seen = whole, [], list[Release]()
    for number, (side, network) in enumerate(zip(SIDES, whole.sensed, strict=True)):
        release = sharing.share(
            mechanism, network, "linkage", family, side, seed=whole.seed
        )
        left = sharing.samples_shared(release, network)
        if left is not None:
            windows = sharing.restricted(getattr(whole.sessions, side), left)
            known = replace(known, sessions=replace(known.sessions, **{side: windows}))
        shared.append(release)
        if whole.frames:
            release = whole.frames[number].of(release.offsets).release(release)
        seen.append(release)
    blind = _Sides(tuple(one.without_sigma() for one in seen))
    return LinkedLevel(
        mechanism, whole, known, tuple(shared), blind, _Sides(tuple(seen))
    )


def sees_times_alone(consumer: Consumer, level: LinkedLevel) -> bool:
    """Whether a consumer is a control that is alike at every level that leaves nothing out."""
    is_control = (
        consumer.kind == "control" and CONTROLS[consumer.control].sees_times_only
    )
    return is_control and level.known is level.whole


def who_sees_alike(consumer: Consumer) -> tuple[str, str]:
    """Return which reconstruction is in front and what it is granted: who has both sees alike.

    If they come one after the other, the releases that they see are alone in memory.
    """
    if consumer.behind is None:
        return "", ""
    granted = consumer.granted & declared(consumer.behind)
    return consumer.behind.spec, ",".join(sorted(one.name for one in granted))


def link(consumer: Consumer, level: LinkedLevel) -> Linked:
    """Return what a linkage attack or control achieves at one mechanism level."""
    if consumer.kind == "control":
        return _controlled(consumer, level)
    known = level.known
    if known.candidates:
        return _approximated(consumer, level)
    scores: dict[int, Floats] = {}
    calibration: dict[int, Calibration] = {}
    matched: dict[int, Floats] = {}
    for fold, half in enumerate(known.halves):
        score, sides = _fitted(consumer, level, fold)
        for number, pairing in half.searches:
            found = score(*sides.of(pairing))
            scores[number] = np.concatenate([scores.get(number, found[:0]), found])
        others = [(score(*sides.of(one)), one) for one in half.calibrates]
        if (on_others := calibrated(others)) is not None:
            calibration[fold] = on_others
        scale = score_scale(others) if known.sessions.task.is_open else None
        if scale is not None:
            for number, _ in half.searches:
                matched[number] = matched_pairs(
                    scores[number], scale=scale, mate_rate=half.mate_rate
                )
    name = consumer.spec, consumer.knowledge
    return read_off(
        scores, known=known, calibration=calibration, matched=matched, drawn_from=name
    )


def bound(level: LinkedLevel, motion: Motion | None) -> Linked:
    """Return what the likelihood ratio of pairs links where people walk as a motion says.

    It is told the motion, the variance of every sample and how lags are distributed:
    nobody who looks at one probe at a time links more of them, in expectation, where
    errors are Gaussian. PluginError for a mechanism whose errors are not white and of
    known laws.
    """
    assert motion is not None
    known, batches, (lags_s, weight) = level.known, [], _lags(level.known.sessions)
    for side, release, sensed in zip(SIDES, level.shared, known.sensed, strict=True):
        rng = stream(known.seed, "genie", "linkage", level.mechanism.spec, side)
        mechanism = level.mechanism.instance
        errors = errors_of(release=release, sensed=sensed, mechanism=mechanism, rng=rng)
        if errors is None or errors.slow is not None:
            raise PluginError(f"the optimum behind {level.mechanism.spec} is not known")
        batches.append((release, errors.variance))
    scores, prior = {}, (START_STD_M, motion.speed_mps)
    for number, pairing in known.searches.items():
        walks = []
        for side, (release, variance) in zip(SIDES, batches, strict=True):
            samples = sharing.samples_of(release.offsets, getattr(pairing, side))
            t, xy, var = (
                one[samples.rows] for one in (release.t, release.xy, variance)
            )
            walks.append(Batch(t, xy, var, samples.offsets, prior))
        scores[number] = log_ratios(*walks, motion=motion, lags_s=lags_s, weight=weight)
    return read_off(scores, known=known, drawn_from=(BOUND,))


def _lags(sessions: Sessions) -> tuple[Floats, Floats]:
    """Return lags of the gallery's window after the probe's, (L,) s, and how often they are so."""
    starts = [one.t[one.offsets[:-1]] for one in (sessions.probe, sessions.gallery)]
    mated = np.flatnonzero(sessions.mate >= 0)
    lag_s = starts[1][sessions.mate[mated]] - starts[0][mated]
    most = int(np.ceil(np.abs(lag_s).max(initial=0.0) / _LAG_STEP_S)) + _LAG_WIDTH
    lags_s = np.arange(-most, most + 1, dtype=np.float64) * _LAG_STEP_S
    away_s, width_s = (
        lags_s[:, None] - np.concatenate([lag_s, -lag_s]),
        _LAG_WIDTH * _LAG_STEP_S,
    )
    weight = np.maximum(1.0 - np.abs(away_s) / width_s, 0.0).sum(axis=1) + _LEAST_WEIGHT
    return lags_s, weight / weight.sum()


def _approximated(consumer: Consumer, level: LinkedLevel) -> Linked:
    """Return what a linkage attack achieves that scores the best candidates of each probe alone."""
    known, found, name = level.known, {}, (consumer.spec, consumer.knowledge)
    rng = stream(known.seed, "linkage", "candidates", *name)
    for fold, half in enumerate(known.halves):
        score, sides = _fitted(consumer, level, fold)
        for number, pairing in half.searches:
            found[number] = among_candidates(
                score,
                *sides.of(pairing),
                mate=pairing.mate,
                first=_untaught(
                    first_stage(known.sessions.task), level, sides, pairing
                ),
                n_candidates=known.candidates,
                n_checked=-(-CHECKED // len(known.searches)),
                n_at_once=AT_ONCE if consumer.is_built_in else 1,
                rng=rng,
            )
    losses = np.concatenate([one.exact - one.approximate for one in found.values()])
    scores = {number: one.scores for number, one in found.items()}
    return read_off(scores, known=known, drawn_from=name, losses=losses)


def _untaught(
    attack: LinkageAttack, level: LinkedLevel, sides: _Sides, pairing: Pairing
) -> Floats:
    """Return the scores of a linker of ours that is granted what the task grants to everyone."""
    granted = attack.requires & level.known.sessions.task.everyone
    return attack.fit(level.context(granted, "linkage", "untaught"))(*sides.of(pairing))


def _controlled(consumer: Consumer, level: LinkedLevel) -> Linked:
    """Return what a control links: it learns nothing and knows what is declared."""
    known, control = level.known, CONTROLS[consumer.control]
    key = () if control.sees_times_only else (level.mechanism.spec,)
    rng = stream(known.seed, "controls", consumer.spec, *key)
    task, scores = known.sessions.task, dict[int, Floats]()
    score = control.scorer(task)
    first, second = known.sessions.probe.about, known.sessions.gallery.about
    columns = list(control.circumstance)
    for number, pairing in known.searches.items():
        if columns and first is not None and second is not None:
            scores[number] = closeness(
                first[pairing.probe][:, columns], second[pairing.gallery][:, columns]
            )
        elif score is not None:
            scores[number] = score(*level.seen.of(pairing), rng)
        else:
            attack = (
                Shape()
                if not (task.shows_scene or known.candidates)
                else first_stage(task)
            )
            real = _untaught(attack, level, level.blind, pairing)
            scores[number] = real[:, rng.permutation(real.shape[1])].astype(np.float64)
    return read_off(scores, known=known, drawn_from=rng, is_audit=control.is_audit)


def _sides(consumer: Consumer, level: LinkedLevel, fold: int) -> _Sides:
    """Return both releases as a linker gets them: smoothed first, where it stands behind that."""
    behind, shows = consumer.behind, consumer.granted
    if consumer.plugin is not None:
        shows &= declared(consumer.plugin)
    if behind is None:
        return level.showing(shows)
    granted = consumer.granted & declared(behind)
    # Ours draw nothing: what has learnt nothing either is the same in both folds.
    is_alike = Knowledge.TRAIN not in granted and behind.origin.startswith(sharing.OURS)
    key = (Knowledge.SIGMA in shows, behind.spec, granted, None if is_alike else fold)
    if key not in level.sides:
        made = _smoothed(consumer, behind, level, fold, shows)
        # Both folds may have chosen alike: what linkers make of a release is then made
        # once.
        alike = (one for one in level.sides.values() if _are_same(one.both, made.both))
        level.sides[key] = next(alike, made)
    return level.sides[key]


def _are_same(some: Iterable[Release], others: Iterable[Release]) -> bool:
    """Whether releases of one level hold the very same arrays."""
    pairs = zip(some, others, strict=True)
    return all(one.xy is other.xy and one.sigma is other.sigma for one, other in pairs)


def _smoothed(
    consumer: Consumer,
    behind: Plugin,
    level: LinkedLevel,
    fold: int,
    shows: frozenset[Knowledge],
) -> _Sides:
    """Return both releases with the positions that a reconstruction attack makes of them."""
    who, known = f"attack {behind.spec} (behind {consumer.label})", level.known
    granted = consumer.granted & declared(behind)
    sides = level.showing(granted)
    train, rows = None, known.halves[fold].learns.probe
    if rows.size:
        truth = _true_walks(level, 0)[
            sharing.samples_of(known.sessions.probe.offsets, rows).rows
        ]
        probe, _ = sides.of(known.halves[fold].learns)
        train = TrainingSet(sharing.handed(probe, behind), truth)
    names = ("attacks", behind.spec, "linkage", level.mechanism.spec, fold)
    context = level.context(granted, *names, train=train)
    attack = sharing.guarded(who, lambda: behind.instance.fit(context))
    rebuilt, std = list[Release](), []
    for release, view in zip(level.seen.both, sides.both, strict=True):
        found = reconstructed(attack, sharing.handed(view, behind), who=who)
        smooth = showing(derived(release, xy=found.xy), shows)
        rebuilt.append(reconstructed_from(smooth, view))
        std.append(found.std)
    return _Sides(tuple(rebuilt), tuple(std))


def _true_walks(level: LinkedLevel, side: int) -> Floats:
    """Return the true positions of a side's samples, (M, 2) m, in the frames of the adversary."""
    windows: Windows = getattr(level.known.sessions, SIDES[side])
    frames = level.known.frames
    return frames[side].of(windows.offsets).points(windows.xy) if frames else windows.xy


def _fitted(
    consumer: Consumer, level: LinkedLevel, fold: int
) -> tuple[Callable[[Release, Release], Floats], _Sides]:
    """Return `scores_of` a linker that is prepared for a fold, and the releases that it gets."""
    assert consumer.plugin is not None
    plugin, known, who = consumer.plugin, level.known, f"attack {consumer.label}"
    sides = _sides(consumer, level, fold)
    granted = consumer.granted & declared(plugin)
    learns = known.halves[fold].learns
    train = None
    if Knowledge.TRAIN in granted:
        if not ((learns.mate >= 0).any() and learns.gallery.size):
            task = known.sessions.task.name
            raise DataError(
                f"{who} needs other people to train on, and task {task} has none; "
                "use a recording of more people or leave the attack out"
            )
        probes, gallery = (sharing.handed(one, plugin) for one in sides.of(learns))
        train = LinkageTrainingSet(probes, gallery, learns.mate.copy())
    names = ("attacks", consumer.spec, consumer.knowledge, level.mechanism.spec, fold)
    context = level.context(granted, *names, train=train)
    attack = sharing.guarded(who, lambda: plugin.instance.fit(context))
    return partial(scores_of, attack, plugin=plugin, who=who), sides


def scores_of(
    attack: Callable[..., object],
    probe: Release,
    gallery: Release,
    *,
    plugin: Plugin,
    who: str,
) -> Floats:
    """Return what a fitted linker makes of two releases: (p, g), rounded to float32.

    Raises PluginError if it raises or returns anything else; the message names it.
    """
    shown = [sharing.handed(one, plugin) for one in (probe, gallery)]
    found = sharing.guarded(who, lambda: attack(*shown))
    if np.ma.isMaskedArray(found):
        raise PluginError(
            f"{who} must return a score for every pair, got a masked array"
        )
    scores, expected = np.asarray(found), (len(probe), len(gallery))
    if scores.shape != expected or scores.dtype.kind not in "fiu":
        got = f"{scores.shape} of {scores.dtype}"
        raise PluginError(f"{who} must return scores {expected}, got {got}")
    with np.errstate(over="ignore"):
        single = scores.astype(np.float32)
    if not np.isfinite(single).all():
        raise PluginError(f"{who} returned a score that is not finite")
    return single.astype(np.float64)


def window_tables(consumer: Consumer, level: LinkedLevel) -> Tables:
    """Return the table of a cell of windows: a row for each of both sides, `WINDOW_COLUMNS`.

    `side` (probe or gallery), `search` (a half, or the instant of a handover),
    `source`, `group`; of what was shared `n_samples`, `sigma_m` (mean declared standard
    deviation) and `DESCRIPTORS`; of the true walk, alike at all levels, `duration_s`
    and `speed_mps` (NaN for a window of one sample); after the reconstruction that the
    consumer stands behind, whatever else is in the run, `ON_TRIAL`: the descriptors,
    `privacy.alignment_error`, and the mean standard deviation that it claims.
    """
    known, sessions = level.known, level.whole.sessions
    smooth = _sides(consumer, level, 0)
    sides = []
    for number, side in enumerate(SIDES):
        release, attacked, std = (
            level.shared[number],
            smooth.both[number].xy,
            smooth.std[number],
        )
        whole: Windows = getattr(sessions, side)
        assert release.sigma is not None  # `share` refuses what declares none
        truth, walked = getattr(known.sessions, side).xy, _true_walks(level, number)
        rebuilt = derived(release, xy=attacked)
        exposed = descriptors(release, truth=truth, settings=known.privacy)
        left = descriptors(rebuilt, truth=walked, settings=known.privacy)
        columns = (
            [side] * len(whole),
            names_column(whole.search, sessions.searches),
            names_column(whole.person, sessions.source),
            names_column(whole.person, sessions.group),
            np.diff(release.offsets),
            *_walked(whole),  # which does not depend on which samples were shared
            track_means(release.sigma, release.offsets),
            *(exposed[name] for name in DESCRIPTORS),
            *(left[name] for name in DESCRIPTORS),
            privacy.alignment_error(xy=attacked, truth=walked, offsets=release.offsets),
            track_means(
                np.full(release.t.size, np.nan) if std is None else std, release.offsets
            ),
        )
        sides.append(table(dict(zip(WINDOW_COLUMNS, columns, strict=True))))
    return {ROWS: pa.concat_tables(sides).combine_chunks()}


def _walked(windows: Windows) -> tuple[Floats, Floats]:
    """Return how long each window lasted, s, and how fast its walk was, m/s."""
    step_m = np.zeros(windows.t.size)
    step_m[1:] = np.hypot(*np.diff(windows.xy, axis=0).T)
    step_m[windows.offsets[:-1]] = 0.0  # from one window to the next
    duration_s = windows.t[windows.offsets[1:] - 1] - windows.t[windows.offsets[:-1]]
    path_m = np.add.reduceat(step_m, windows.offsets[:-1])
    speed_mps = np.full(duration_s.size, np.nan)
    np.divide(path_m, duration_s, out=speed_mps, where=duration_s > 0)
    return duration_s, speed_mps
