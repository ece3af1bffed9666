"""The stages of linkage: how well each adversary links at one level of a task.

An attack that learns does so on people of the other half, and is fitted again for every
mechanism level. Beside the attacks a cell has a row for every window, with its own
descriptors: a person's linkability is compared with these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from numpy.random import Generator

from attacks.linkage.alignment import Shape
from attacks.remembered import record_shared, select_tracks
from attacks.tasks.controls import CONTROLS, Control, closeness
from evaluation.compute import sharing
from evaluation.compute.candidates import (
    AT_ONCE,
    CHECKED,
    among_candidates,
    first_stage,
)
from evaluation.compute.link_scores import (
    LinkResult,
    fit_score_scale,
    fit_scores,
    match_pairs,
    score_links,
)
from evaluation.compute.link_setup import (
    SIDES,
    FoldPairings,
    Pairing,
    SensedSessions,
)
from evaluation.compute.sharing import (
    declared,
    hide_sigma,
    reconstructed,
)
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
from isac_track.model_world import START_STD_M, Motion, log_ratios, release_errors
from isac_track.protocols import (
    AttackContext,
    LinkageAttack,
    LinkageTrainingSet,
    TrainingSet,
)
from isac_track.rng import stream
from isac_track.types import Floats, Knowledge, Release, derived, lengths

if TYPE_CHECKING:
    from attacks.tasks.sessions import Sessions, Windows
    from evaluation.plan.consumer import Consumer
    from isac_track.linkability import Calibration
    from isac_track.plugins import Plugin

# Columns of the rows of a cell of windows.
WINDOW_COLUMNS = (
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
class _View:
    """Both releases as some linkers see them, and the windows of pairings so far."""

    releases: tuple[Release, ...]
    # (M,) m of either release, as the reconstruction in front claims.
    claimed_std: tuple[Floats | None, ...] = ()
    windows: dict[int, tuple[Release, Release]] = field(default_factory=dict)
    """A memo by the id of the pairing; `LinkedLevel.forget_views` empties it."""

    def pair_windows(self, pairing: Pairing) -> tuple[Release, Release]:
        """Return the windows of a pairing, the same objects every time."""
        if id(pairing) not in self.windows:
            probe, gallery = self.releases
            self.windows[id(pairing)] = (
                select_tracks(probe, pairing.probe),
                select_tracks(gallery, pairing.gallery),
            )
        return self.windows[id(pairing)]


@dataclass(frozen=True, eq=False, slots=True)
class LinkedLevel:
    """All that the consumers of a linkage task share at one mechanism level."""

    mechanism: Plugin
    full_setup: SensedSessions  # With all samples.
    # Without the samples that were left out; `full_setup` itself if none were.
    setup: SensedSessions
    # Of the probe and of the gallery side, in the true frame.
    shared: tuple[Release, ...]
    blind: _View  # The same in the frames of the adversary,
    seen: _View  # and with the declared standard deviations.
    views: dict[tuple[object, ...], _View] = field(default_factory=dict)
    """A memo of smoothed views; `forget_views` empties it.

    The key is whether SIGMA shows, the reconstruction, its knowledge, and the fold."""

    def forget_views(self) -> None:
        """Drop all windows and smoothed views, and what linkers remember of them."""
        self.views.clear()
        self.blind.windows.clear()
        self.seen.windows.clear()

    def view_for(self, granted: frozenset[Knowledge]) -> _View:
        """Return both releases as they show, the same objects every time."""
        return self.seen if Knowledge.SIGMA in granted else self.blind

    def context(
        self,
        granted: frozenset[Knowledge],
        *names: str | int,
        train: TrainingSet | LinkageTrainingSet | None = None,
    ) -> AttackContext:
        """Return the context of an attack with knowledge; `names` are of its stream."""
        return AttackContext(
            rng=stream(self.setup.seed, *names),
            epsilon_m=self.setup.privacy.epsilon_m,
            granted=granted,
            mechanism=self.mechanism.instance,
            train=train,
        )


def linked_level(mechanism: Plugin, full_setup: SensedSessions) -> LinkedLevel:
    """Return the releases of both sessions of a task under a mechanism."""
    family = full_setup.sessions.task.family
    setup, shared, seen = full_setup, [], list[Release]()
    for number, (side, sensed) in enumerate(zip(SIDES, full_setup.sensed, strict=True)):
        release = sharing.share(
            mechanism, sensed, "linkage", family, side, seed=full_setup.seed
        )
        samples = sharing.samples_shared(release, sensed)
        if samples is not None:
            windows = sharing.restricted(getattr(full_setup.sessions, side), samples)
            setup = replace(setup, sessions=replace(setup.sessions, **{side: windows}))
        shared.append(release)
        if full_setup.frames:
            frame = full_setup.frames[number].per_sample(release.offsets)
            release = frame.release(release)
        seen.append(release)
    return LinkedLevel(
        mechanism=mechanism,
        full_setup=full_setup,
        setup=setup,
        shared=tuple(shared),
        blind=_View(tuple(release.without_sigma() for release in seen)),
        seen=_View(tuple(seen)),
    )


def level_of_releases(
    mechanism: Plugin, setup: SensedSessions, releases: tuple[Release, ...]
) -> LinkedLevel:
    """Return a level whose releases of both sessions are made already, in their frames."""
    return LinkedLevel(
        mechanism=mechanism,
        full_setup=setup,
        setup=setup,
        shared=releases,
        blind=_View(tuple(release.without_sigma() for release in releases)),
        seen=_View(releases),
    )


def sees_times_alone(consumer: Consumer, level: LinkedLevel) -> bool:
    """Whether a control has the same result at all levels that leave out no sample."""
    is_control = (
        consumer.kind == "control" and CONTROLS[consumer.control].sees_times_only
    )
    return is_control and level.setup is level.full_setup


def view_key(consumer: Consumer) -> tuple[str, str]:
    """Return the smoother before a linker, and its knowledge: equal keys, equal views.

    Consumers are sorted by it, so that the memory holds the releases of one key only.
    """
    if consumer.reconstruction is None:
        return "", ""
    granted = consumer.granted & declared(consumer.reconstruction)
    return consumer.reconstruction.spec, ",".join(sorted(item.name for item in granted))


def link(consumer: Consumer, level: LinkedLevel) -> LinkResult:
    """Return what a linkage attack or control achieves at one mechanism level."""
    if consumer.kind == "control":
        return _link_control(consumer, level)
    setup = level.setup
    if setup.n_candidates:
        return _link_candidates(consumer, level)
    scores: dict[int, Floats] = {}
    calibration: dict[int, Calibration] = {}
    matched: dict[int, Floats] = {}
    for fold, pairings in enumerate(setup.folds):
        score, view = _fitted_linker(consumer, level, fold)
        _add_scores(scores, score, view, pairings)
        calibrating = [
            (score(*view.pair_windows(pairing)), pairing)
            for pairing in pairings.calibrates
        ]
        if (fold_calibration := fit_scores(calibrating)) is not None:
            calibration[fold] = fold_calibration
        is_open = setup.sessions.task.is_open
        scale = fit_score_scale(calibrating) if is_open else None
        if scale is not None:
            for number in pairings.searches:
                matched[number] = match_pairs(
                    scores[number], scale=scale, mate_rate=pairings.mate_rate
                )
    return score_links(
        scores,
        setup=setup,
        calibration=calibration,
        matched=matched,
        drawn_from=(consumer.spec, consumer.adversary),
    )


def search_scores(consumer: Consumer, level: LinkedLevel) -> dict[int, Floats]:
    """Return the scores of an attack or control in every search, (P, G) each."""
    if consumer.control:
        rng = _control_stream(consumer, level)
        return _control_scores(CONTROLS[consumer.control], level, rng)
    scores: dict[int, Floats] = {}
    for fold, pairings in enumerate(level.setup.folds):
        score, view = _fitted_linker(consumer, level, fold)
        _add_scores(scores, score, view, pairings)
    return scores


def _add_scores(
    scores: dict[int, Floats],
    score: Callable[[Release, Release], Floats],
    view: _View,
    pairings: FoldPairings,
) -> None:
    """Add a fold's scores to those of its searches, which folds may have split."""
    for number, pairing in pairings.searches.items():
        fold_scores = score(*view.pair_windows(pairing))
        earlier = scores.get(number, fold_scores[:0])
        scores[number] = np.concatenate([earlier, fold_scores])


def bound(level: LinkedLevel, motion: Motion | None) -> LinkResult:
    """Return the links of the optimum: the likelihood ratio of pairs in a model world.

    The optimum knows the motion, the variance of every sample and the distribution of
    lags. No adversary that looks at one probe at a time links more of them, in
    expectation, where errors are Gaussian. Raises PluginError for a mechanism whose
    errors are not white, or of unknown laws.
    """
    assert motion is not None
    setup, mechanism = level.setup, level.mechanism
    lags_s, weight = _lag_distribution(setup.sessions)
    variances = []
    for side, release, sensed in zip(SIDES, level.shared, setup.sensed, strict=True):
        rng = stream(setup.seed, "genie", "linkage", mechanism.spec, side)
        errors = release_errors(
            release=release, sensed=sensed, mechanism=mechanism.instance, rng=rng
        )
        if errors is None or errors.slow is not None:
            raise PluginError(f"the optimum behind {mechanism.spec} is not known")
        variances.append(errors.variance)
    scores, prior = {}, (START_STD_M, motion.speed_mps)
    for number, pairing in setup.searches.items():
        walks = []
        for side, release, variance in zip(SIDES, level.shared, variances, strict=True):
            samples = sharing.track_samples(release.offsets, getattr(pairing, side))
            rows = samples.rows
            walks.append(
                Batch(
                    release.t[rows],
                    release.xy[rows],
                    variance[rows],
                    samples.offsets,
                    prior,
                )
            )
        scores[number] = log_ratios(*walks, motion=motion, lags_s=lags_s, weight=weight)
    return score_links(scores, setup=setup, drawn_from=(BOUND,))


def _lag_distribution(sessions: Sessions) -> tuple[Floats, Floats]:
    """Return lags of the gallery's window after the probe's, (L,) s, and weights."""
    probe, gallery = sessions.probe, sessions.gallery
    probe_start_s = probe.t[probe.offsets[:-1]]
    gallery_start_s = gallery.t[gallery.offsets[:-1]]
    mated = np.flatnonzero(sessions.mate >= 0)
    lag_s = gallery_start_s[sessions.mate[mated]] - probe_start_s[mated]
    most = int(np.ceil(np.abs(lag_s).max(initial=0.0) / _LAG_STEP_S)) + _LAG_WIDTH
    lags_s = np.arange(-most, most + 1, dtype=np.float64) * _LAG_STEP_S
    away_s = lags_s[:, None] - np.concatenate([lag_s, -lag_s])
    width_s = _LAG_WIDTH * _LAG_STEP_S
    weight = np.maximum(1.0 - np.abs(away_s) / width_s, 0.0).sum(axis=1) + _LEAST_WEIGHT
    return lags_s, weight / weight.sum()


def _link_candidates(consumer: Consumer, level: LinkedLevel) -> LinkResult:
    """Return the result of an attack that scores only each probe's best candidates."""
    setup, name = level.setup, (consumer.spec, consumer.adversary)
    rng = stream(setup.seed, "linkage", "candidates", *name)
    results = {}
    for fold, pairings in enumerate(setup.folds):
        score, view = _fitted_linker(consumer, level, fold)
        for number, pairing in pairings.searches.items():
            ranking = _score_untrained(
                first_stage(setup.sessions.task), level, view, pairing
            )
            results[number] = among_candidates(
                score,
                *view.pair_windows(pairing),
                mate=pairing.mate,
                first_scores=ranking,
                n_candidates=setup.n_candidates,
                n_checked=-(-CHECKED // len(setup.searches)),
                n_at_once=AT_ONCE if consumer.is_built_in else 1,
                rng=rng,
            )
    losses = np.concatenate(
        [result.exact - result.approximate for result in results.values()]
    )
    scores = {number: result.scores for number, result in results.items()}
    return score_links(scores, setup=setup, drawn_from=name, losses=losses)


def _score_untrained(
    attack: LinkageAttack, level: LinkedLevel, view: _View, pairing: Pairing
) -> Floats:
    """Return the scores of a built-in linker that knows what the task grants to all."""
    granted = attack.requires & level.setup.sessions.task.everyone
    linker = attack.fit(level.context(granted, "linkage", "untaught"))
    return linker(*view.pair_windows(pairing))


def _link_control(consumer: Consumer, level: LinkedLevel) -> LinkResult:
    """Return what a control links: it learns nothing and knows what is declared."""
    control, rng = CONTROLS[consumer.control], _control_stream(consumer, level)
    scores = _control_scores(control, level, rng)
    return score_links(
        scores, setup=level.setup, drawn_from=rng, is_audit=control.is_audit
    )


def _control_stream(consumer: Consumer, level: LinkedLevel) -> Generator:
    sees_times_only = CONTROLS[consumer.control].sees_times_only
    key = () if sees_times_only else (level.mechanism.spec,)
    return stream(level.setup.seed, "controls", consumer.spec, *key)


def _control_scores(
    control: Control, level: LinkedLevel, rng: Generator
) -> dict[int, Floats]:
    """Return a control's scores in every search, (P, G) each."""
    setup = level.setup
    task, scores = setup.sessions.task, dict[int, Floats]()
    score = control.scorer(task)
    probe_about = setup.sessions.probe.about
    gallery_about = setup.sessions.gallery.about
    columns = list(control.circumstance)
    for number, pairing in setup.searches.items():
        if columns and probe_about is not None and gallery_about is not None:
            scores[number] = closeness(
                probe_about[pairing.probe][:, columns],
                gallery_about[pairing.gallery][:, columns],
            )
        elif score is not None:
            scores[number] = score(*level.seen.pair_windows(pairing), rng)
        else:
            attack: LinkageAttack = Shape()
            if task.shows_scene or setup.n_candidates:
                attack = first_stage(task)
            real = _score_untrained(attack, level, level.blind, pairing)
            scores[number] = real[:, rng.permutation(real.shape[1])].astype(np.float64)
    return scores


def _linker_view(consumer: Consumer, level: LinkedLevel, fold: int) -> _View:
    """Return both releases as a linker sees them: smoothed behind a smoother."""
    reconstruction, shows = consumer.reconstruction, consumer.granted
    if consumer.plugin is not None:
        shows &= declared(consumer.plugin)
    if reconstruction is None:
        return level.view_for(shows)
    granted = consumer.granted & declared(reconstruction)
    # Built-in attacks draw nothing: without training they are the same in both folds.
    is_built_in = reconstruction.origin.startswith(sharing.OURS)
    is_same_in_folds = Knowledge.TRAIN not in granted and is_built_in
    key_fold = None if is_same_in_folds else fold
    key = (Knowledge.SIGMA in shows, reconstruction.spec, granted, key_fold)
    if key not in level.views:
        smoothed = _smoothed_view(consumer, reconstruction, level, fold, shows)
        # The smoother may choose equally in both folds: share the earlier view, so that
        # linkers compute their descriptors of a release once.
        equal_views = (
            view
            for view in level.views.values()
            if _are_same(view.releases, smoothed.releases)
        )
        level.views[key] = next(equal_views, smoothed)
    return level.views[key]


def _are_same(releases: Iterable[Release], others: Iterable[Release]) -> bool:
    """Whether releases of one level hold the very same arrays."""
    return all(
        release.xy is other.xy
        and release.sigma is other.sigma
        and release.cov is other.cov
        for release, other in zip(releases, others, strict=True)
    )


def _smoothed_view(
    consumer: Consumer,
    reconstruction: Plugin,
    level: LinkedLevel,
    fold: int,
    shows: frozenset[Knowledge],
) -> _View:
    """Return both releases with the positions that a reconstruction estimates."""
    name, setup = f"attack {reconstruction.spec} (behind {consumer.label})", level.setup
    granted = consumer.granted & declared(reconstruction)
    view = level.view_for(granted)
    learns, train = setup.folds[fold].learns, None
    if learns.probe.size:
        samples = sharing.track_samples(setup.sessions.probe.offsets, learns.probe)
        truth = _true_walks(level, 0)[samples.rows]
        probe, _ = view.pair_windows(learns)
        train = TrainingSet(sharing.copy_for_user_plugin(probe, reconstruction), truth)
    names = ("attacks", reconstruction.spec, "linkage", level.mechanism.spec, fold)
    context = level.context(granted, *names, train=train)
    attack = sharing.guarded(name, lambda: reconstruction.instance.fit(context))
    smoothed, claimed_std = list[Release](), []
    for release, visible in zip(level.seen.releases, view.releases, strict=True):
        result = reconstructed(
            attack, sharing.copy_for_user_plugin(visible, reconstruction), name=name
        )
        smooth = hide_sigma(derived(release, xy=result.xy), shows)
        smoothed.append(record_shared(smooth, visible))
        claimed_std.append(result.std)
    return _View(tuple(smoothed), tuple(claimed_std))


def _true_walks(level: LinkedLevel, side: int) -> Floats:
    """Return the true positions of a side, (M, 2) m, in the adversary's frames."""
    windows: Windows = getattr(level.setup.sessions, SIDES[side])
    frames = level.setup.frames
    if not frames:
        return windows.xy
    return frames[side].per_sample(windows.offsets).points(windows.xy)


def _fitted_linker(
    consumer: Consumer, level: LinkedLevel, fold: int
) -> tuple[Callable[[Release, Release], Floats], _View]:
    """Return the scoring function of a linker fitted for a fold, and its view."""
    assert consumer.plugin is not None
    plugin, setup, name = consumer.plugin, level.setup, f"attack {consumer.label}"
    view = _linker_view(consumer, level, fold)
    granted = consumer.granted & declared(plugin)
    learns = setup.folds[fold].learns
    train = None
    if Knowledge.TRAIN in granted:
        if not ((learns.mate >= 0).any() and learns.gallery.size):
            task = setup.sessions.task.name
            raise DataError(
                f"{name} needs other people to train on, and task {task} has none; "
                "use a recording of more people or leave the attack out"
            )
        probe, gallery = (
            sharing.copy_for_user_plugin(release, plugin)
            for release in view.pair_windows(learns)
        )
        train = LinkageTrainingSet(probe, gallery, learns.mate.copy())
    names = ("attacks", consumer.spec, consumer.adversary, level.mechanism.spec, fold)
    context = level.context(granted, *names, train=train)
    attack = sharing.guarded(name, lambda: plugin.instance.fit(context))
    return partial(score_releases, attack, plugin=plugin, name=name), view


def score_releases(
    attack: Callable[..., object],
    probe: Release,
    gallery: Release,
    *,
    plugin: Plugin,
    name: str,
) -> Floats:
    """Return a fitted linker's scores of two releases: (p, g), rounded to float32.

    Raises PluginError if the linker raises or returns anything else; the message says
    its `name`.
    """
    shown = [
        sharing.copy_for_user_plugin(release, plugin) for release in (probe, gallery)
    ]
    result = sharing.guarded(name, lambda: attack(*shown))
    if np.ma.isMaskedArray(result):
        raise PluginError(
            f"{name} must return a score for every pair, got a masked array"
        )
    scores, expected = np.asarray(result), (len(probe), len(gallery))
    if scores.shape != expected or scores.dtype.kind not in "fiu":
        got = f"{scores.shape} of {scores.dtype}"
        raise PluginError(f"{name} must return scores {expected}, got {got}")
    with np.errstate(over="ignore"):
        single = scores.astype(np.float32)
    if not np.isfinite(single).all():
        raise PluginError(f"{name} returned a score that is not finite")
    return single.astype(np.float64)


def window_tables(consumer: Consumer, level: LinkedLevel) -> Tables:
    """Return the table of a cell of windows: `WINDOW_COLUMNS` for each of both sides.

    `side` is probe or gallery, `search` a half or the instant of a handover. Of the
    shared samples: `n_samples`, `sigma_m` (mean declared standard deviation) and
    `DESCRIPTORS`. Of the true walk, the same at all levels: `duration_s` and
    `speed_mps` (NaN for a window of a single sample). After the reconstruction that the
    consumer stands behind, whatever else is in the run: `ON_TRIAL`, which are the
    descriptors, `privacy.alignment_error`, and the mean standard deviation that it
    claims.
    """
    smoothed = _linker_view(consumer, level, 0)
    sides = [_side_table(level, smoothed, side) for side in range(len(SIDES))]
    return {ROWS: pa.concat_tables(sides).combine_chunks()}


def _side_table(level: LinkedLevel, smoothed: _View, side: int) -> pa.Table:
    """Return the rows of `window_tables` of one side, 0 or 1."""
    setup, sessions = level.setup, level.full_setup.sessions
    release, offsets = level.shared[side], level.shared[side].offsets
    assert release.sigma is not None  # `share` refuses a release without
    windows: Windows = getattr(sessions, SIDES[side])
    # The full windows: these do not depend on which samples were shared.
    duration_s, speed_mps = _durations_and_speeds(windows)
    attacked_xy, claimed_std = smoothed.releases[side].xy, smoothed.claimed_std[side]
    if claimed_std is None:
        claimed_std = np.full(release.t.size, np.nan)
    true_xy = getattr(setup.sessions, SIDES[side]).xy
    walked_xy = _true_walks(level, side)
    as_shared = descriptors(release, truth=true_xy, settings=setup.privacy)
    rebuilt = derived(release, xy=attacked_xy)
    attacked = descriptors(rebuilt, truth=walked_xy, settings=setup.privacy)
    columns = (
        [SIDES[side]] * len(windows),
        names_column(windows.search, sessions.searches),
        names_column(windows.person, sessions.source),
        names_column(windows.person, sessions.group),
        np.diff(offsets),
        duration_s,
        speed_mps,
        track_means(release.sigma, offsets),
        *(as_shared[name] for name in DESCRIPTORS),
        *(attacked[name] for name in DESCRIPTORS),
        privacy.alignment_error(xy=attacked_xy, truth=walked_xy, offsets=offsets),
        track_means(claimed_std, offsets),
    )
    return table(dict(zip(WINDOW_COLUMNS, columns, strict=True)))


def _durations_and_speeds(windows: Windows) -> tuple[Floats, Floats]:
    """Return the duration of each window, s, and the speed of its walk, m/s."""
    step_m = np.zeros(windows.t.size)
    step_m[1:] = lengths(np.diff(windows.xy, axis=0))
    step_m[windows.offsets[:-1]] = 0.0  # between windows
    duration_s = windows.t[windows.offsets[1:] - 1] - windows.t[windows.offsets[:-1]]
    path_m = np.add.reduceat(step_m, windows.offsets[:-1])
    speed_mps = np.full(duration_s.size, np.nan)
    np.divide(path_m, duration_s, out=speed_mps, where=duration_s > 0)
    return duration_s, speed_mps
