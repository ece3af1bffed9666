"""Linking: how well each adversary links at one level of a task.

A linker that is trained has people of the other fold for it, and is fitted again for
every mechanism level. `link` computes the cells of attacks and controls.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import Generator

from attacks.linkage.alignment import Shape
from attacks.tasks.controls import CONTROLS, Control, closeness
from evaluation.compute import sharing
from evaluation.compute.candidates import (
    AT_ONCE,
    CHECKED,
    among_candidates,
    first_stage,
)
from evaluation.compute.guards import copy_for_user_plugin, guarded
from evaluation.compute.link_scores import (
    LinkResult,
    evaluate_links,
    fit_calibration,
    fit_score_scale,
    match_pairs,
)
from evaluation.compute.link_setup import SIDES, FoldPairings, Pairing
from evaluation.compute.link_views import LinkedLevel, LinkerView, linker_view
from evaluation.compute.sharing import declared_knowledge
from evaluation.plan.constants import BOUND
from isac_track.errors import DataError, PluginError
from isac_track.kalman import Batch
from isac_track.model_world import START_STD_M, Motion, log_ratios, release_errors
from isac_track.protocols import LinkageAttack, LinkageTrainingSet
from isac_track.rng import stream
from isac_track.types import Floats, Knowledge, Release

if TYPE_CHECKING:
    from attacks.tasks.windows import TaskWindows
    from evaluation.plan.consumer import Consumer
    from isac_track.linkability import Calibration
    from isac_track.plugins import Plugin

# The prior of the optimum on lags, a smoothed histogram over a grid of lags.
_LAG_STEP_S = 0.2  # Step of the grid.
# Half-width in steps of the triangle that smooths each lag: a few mates have few lags.
_LAG_HALF_WIDTH = 3
_PSEUDO_COUNT = 0.1  # At each lag of the grid, so that none is impossible.


def is_same_at_all_levels(consumer: Consumer, level: LinkedLevel) -> bool:
    """Whether a consumer has one result for all levels that leave out no sample.

    So has a control that sees times alone. False at a level that leaves out samples.
    """
    sees_times_only = (
        consumer.kind == "control" and CONTROLS[consumer.control].sees_times_only
    )
    return sees_times_only and level.setup is level.full_setup


@dataclass(frozen=True, eq=False, slots=True)
class _FittedLinker:
    """A linker that is fitted for a fold, and what it sees."""

    score: Callable[[Release, Release], Floats]
    view: LinkerView

    def score_pairing(self, pairing: Pairing) -> Floats:
        """Return the scores of all pairs of a pairing, (p, g)."""
        return self.score(*self.view.pair_windows(pairing))


def link(consumer: Consumer, level: LinkedLevel) -> LinkResult:
    """Return what a linkage attack or control achieves at one mechanism level."""
    if consumer.kind == "control":
        return _link_control(consumer, level)
    if level.setup.n_candidates:
        return _link_candidates(consumer, level)
    return _link_all(consumer, level)


def _link_all(consumer: Consumer, level: LinkedLevel) -> LinkResult:
    """Return the result of an attack that scores every pair of each search."""
    setup = level.setup
    scores: dict[int, Floats] = {}
    calibration: dict[int, Calibration] = {}
    matched: dict[int, Floats] = {}
    for fold, pairings in enumerate(setup.folds):
        linker = _fit_linker(consumer, level, fold)
        _add_scores(scores, linker, pairings)
        calibrating = [
            (linker.score_pairing(pairing), pairing) for pairing in pairings.calibrating
        ]
        if (fold_calibration := fit_calibration(calibrating)) is not None:
            calibration[fold] = fold_calibration
        if setup.task_windows.task.is_open:
            matched |= _match_searches(scores, pairings, calibrating)
    return evaluate_links(
        scores,
        setup=setup,
        calibration=calibration,
        matched=matched,
        attack_names=(consumer.spec, consumer.adversary),
    )


def _match_searches(
    scores: Mapping[int, Floats],
    pairings: FoldPairings,
    calibrating: Sequence[tuple[Floats, Pairing]],
) -> dict[int, Floats]:
    """Return the probabilities of all pairs in a fold's open searches, (P, G) each.

    Empty without mates among the people to calibrate on.
    """
    scale = fit_score_scale(calibrating)
    if scale is None:
        return {}
    return {
        number: match_pairs(scores[number], scale=scale, mate_rate=pairings.mate_rate)
        for number in pairings.searches
    }


def search_scores(consumer: Consumer, level: LinkedLevel) -> dict[int, Floats]:
    """Return the scores of an attack or control in every search, (P, G) each."""
    if consumer.control:
        rng = _control_stream(consumer, level)
        return _control_scores(CONTROLS[consumer.control], level, rng)
    scores: dict[int, Floats] = {}
    for fold, pairings in enumerate(level.setup.folds):
        _add_scores(scores, _fit_linker(consumer, level, fold), pairings)
    return scores


def _add_scores(
    scores: dict[int, Floats], linker: _FittedLinker, pairings: FoldPairings
) -> None:
    """Add a fold's scores to those of its searches, which folds may have split.

    Folds must come in the order of `SensedTask.folds`. In this order `whole_searches`
    joins the probes of a split search, whose rows the scores are.
    """
    for number, pairing in pairings.searches.items():
        fold_scores = linker.score_pairing(pairing)
        earlier = scores.get(number, fold_scores[:0])
        scores[number] = np.concatenate([earlier, fold_scores])


def link_optimum(level: LinkedLevel, motion: Motion | None) -> LinkResult:
    """Return the links of the optimum: the likelihood ratio of pairs in a model world.

    The optimum knows the motion, the variance of every sample and a smoothed, mirrored
    prior of the lags. Suppose that errors are Gaussian and that lags follow this prior.
    Then no adversary that looks at each probe by itself links more people, in
    expectation. Raises PluginError for a mechanism whose errors are not white, or of
    unknown laws.
    """
    assert motion is not None
    setup, mechanism = level.setup, level.mechanism
    lags_s, weights = _lag_prior(setup.task_windows)
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
        scores[number] = log_ratios(
            *walks, motion=motion, lags_s=lags_s, weight=weights
        )
    return evaluate_links(scores, setup=setup, attack_names=(BOUND,))


def _lag_prior(task_windows: TaskWindows) -> tuple[Floats, Floats]:
    """Return a smoothed, mirrored prior of the lags: lags, (L,) s, and weights, (L,).

    A lag is the start of the gallery's window after that of the probe's. The lag of
    each pair of mates counts as it is and with the other sign, so that the prior is
    symmetric about 0.
    """
    probe, gallery = task_windows.probe, task_windows.gallery
    probe_start_s = probe.t[probe.offsets[:-1]]
    gallery_start_s = gallery.t[gallery.offsets[:-1]]
    mated = np.flatnonzero(task_windows.mate >= 0)
    lag_s = gallery_start_s[task_windows.mate[mated]] - probe_start_s[mated]
    largest_s = np.abs(lag_s).max(initial=0.0)
    n_steps = int(np.ceil(largest_s / _LAG_STEP_S)) + _LAG_HALF_WIDTH
    lags_s = np.arange(-n_steps, n_steps + 1, dtype=np.float64) * _LAG_STEP_S
    away_s = lags_s[:, None] - np.concatenate([lag_s, -lag_s])
    half_width_s = _LAG_HALF_WIDTH * _LAG_STEP_S
    triangles = np.maximum(1.0 - np.abs(away_s) / half_width_s, 0.0)
    weights = triangles.sum(axis=1) + _PSEUDO_COUNT
    return lags_s, weights / weights.sum()


def _link_candidates(consumer: Consumer, level: LinkedLevel) -> LinkResult:
    """Return the result of an attack that scores only each probe's best candidates."""
    setup, attack_names = level.setup, (consumer.spec, consumer.adversary)
    rng = stream(setup.seed, "linkage", "candidates", *attack_names)
    results = {}
    for fold, pairings in enumerate(setup.folds):
        linker = _fit_linker(consumer, level, fold)
        for number, pairing in pairings.searches.items():
            ranking = _score_untrained(
                first_stage(setup.task_windows.task), level, linker.view, pairing
            )
            results[number] = among_candidates(
                linker.score,
                *linker.view.pair_windows(pairing),
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
    return evaluate_links(scores, setup=setup, attack_names=attack_names, losses=losses)


def _score_untrained(
    attack: LinkageAttack, level: LinkedLevel, view: LinkerView, pairing: Pairing
) -> Floats:
    """Return the scores of a built-in linker that knows what the task grants to all."""
    granted = attack.requires & level.setup.task_windows.task.granted_to_all
    linker = attack.fit(level.context(granted, "linkage", "untaught"))
    return linker(*view.pair_windows(pairing))


def _link_control(consumer: Consumer, level: LinkedLevel) -> LinkResult:
    """Return what a control links: it learns nothing and knows what is declared."""
    control, rng = CONTROLS[consumer.control], _control_stream(consumer, level)
    scores = _control_scores(control, level, rng)
    return evaluate_links(
        scores, setup=level.setup, control_rng=rng, is_audit=control.is_audit
    )


def _control_stream(consumer: Consumer, level: LinkedLevel) -> Generator:
    sees_times_only = CONTROLS[consumer.control].sees_times_only
    key = () if sees_times_only else (level.mechanism.spec,)
    return stream(level.setup.seed, "controls", consumer.spec, *key)


def _control_scores(
    control: Control, level: LinkedLevel, rng: Generator
) -> dict[int, Floats]:
    """Return a control's scores in every search, (P, G) each."""
    return {
        number: _score_control(control, level, pairing, rng)
        for number, pairing in level.setup.searches.items()
    }


def _score_control(
    control: Control, level: LinkedLevel, pairing: Pairing, rng: Generator
) -> Floats:
    """Return a control's scores in a search, (P, G)."""
    task_windows = level.setup.task_windows
    if control.circumstance:
        columns = list(control.circumstance)
        probe = task_windows.probe.circumstances
        gallery = task_windows.gallery.circumstances
        assert probe is not None  # the task of returning people measures them
        assert gallery is not None
        return closeness(
            probe[pairing.probe][:, columns], gallery[pairing.gallery][:, columns]
        )
    score = control.scorer(task_windows.task)
    if score is None:
        return _shuffled_scores(level, pairing, rng)
    return score(*level.seen.pair_windows(pairing), rng)


def _shuffled_scores(level: LinkedLevel, pairing: Pairing, rng: Generator) -> Floats:
    """Return the scores of a real attack with the gallery in another order, (P, G)."""
    task = level.setup.task_windows.task
    attack: LinkageAttack = Shape()
    if task.shows_scene or level.setup.n_candidates:
        attack = first_stage(task)
    scores = _score_untrained(attack, level, level.blind, pairing)
    return scores[:, rng.permutation(scores.shape[1])].astype(np.float64)


def _fit_linker(consumer: Consumer, level: LinkedLevel, fold: int) -> _FittedLinker:
    """Return a linker that is fitted for a fold."""
    assert consumer.plugin is not None
    plugin, name = consumer.plugin, f"attack {consumer.label}"
    view = linker_view(consumer, level, fold)
    granted = consumer.granted & declared_knowledge(plugin)
    train = None
    if Knowledge.TRAIN in granted:
        train = _training_set(plugin, name, level, view, fold)
    names = ("attacks", consumer.spec, consumer.adversary, level.mechanism.spec, fold)
    context = level.context(granted, *names, train=train)
    attack = guarded(name, lambda: plugin.instance.fit(context))
    return _FittedLinker(
        partial(score_releases, attack, plugin=plugin, name=name), view
    )


def _training_set(
    plugin: Plugin, name: str, level: LinkedLevel, view: LinkerView, fold: int
) -> LinkageTrainingSet:
    """Return mated windows of people of the other fold, as a linker sees them.

    DataError without any; the message says the linker's `name`.
    """
    training = level.setup.folds[fold].training
    if not training.has_mates:
        task = level.setup.task_windows.task.name
        raise DataError(
            f"{name} needs other people to train on, and task {task} has none; "
            "use a recording of more people or leave the attack out"
        )
    probe, gallery = (
        copy_for_user_plugin(release, plugin) for release in view.pair_windows(training)
    )
    return LinkageTrainingSet(probe, gallery, training.mate.copy())


def score_releases(
    attack: Callable[..., object],
    probe: Release,
    gallery: Release,
    *,
    plugin: Plugin,
    name: str,
) -> Floats:
    """Return a fitted linker's scores of two releases: (p, g), rounded to float32.

    Ranks must not depend on the last bits of a double, which differ between machines.
    Numbers of single precision also sort faster (`rank_rows`) and take half the memory.

    Raises PluginError if the linker raises or returns anything else; the message says
    its `name`.
    """
    shown = [copy_for_user_plugin(release, plugin) for release in (probe, gallery)]
    result = guarded(name, lambda: attack(*shown))
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
