"""Correct the errors that the best smoother leaves, with boosted trees."""

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from threadpoolctl import threadpool_limits

from attacks.parameters import require_positive
from attacks.reconstruction.kalman_rts import RadialRTS, information
from attacks.reconstruction.learning import COMMON_KNOWLEDGE, exposure_loss
from attacks.remembered import noise_m2
from isac_track.protocols import AttackContext, Reconstructor
from isac_track.types import Complexes, Floats, Ints, Knowledge, Reconstruction, Release

_EDGES_S = np.geomspace(0.05, 3.0, 6) * np.sqrt(1.01)
"""Edges of the stretches to either side of a sample whose means are features.

No clock of round steps has a sample just at an edge, where rounding would decide.
"""
_REACH_S = 0.503  # Heading and speed are taken over so long to either side.
# Below so short a way, a walk has no heading; the less it moves, the less is corrected.
_STILL_M = 1e-3
_LEAST_WALKS = 5
_FOLDS = 3
_limit_to_one_thread = partial(threadpool_limits, limits=1, user_api="openmp")
"""Worker processes share the cores already: trees with threads would only wait."""
_STAGES = 4  # So many numbers of trees are tried.
_SHARES = (0.5, 1.0)
_LEAST_GAIN = 1e-3  # Of `exposure_loss`.


@dataclass(frozen=True, slots=True)
class Corrector:
    """A learnt correction on top of `RadialRTS`.

    Boosted trees learn corrections along and across a walk from `_sample_features`, on
    other people's walks, shared by the same mechanism. The number of trees, and the
    share of their prediction that is added, are chosen on whole walks that the trees
    were not grown on. If these gain nothing, or there are fewer than five walks, the
    attack is the smoother alone. The claimed `std` is that of the smoother.

    References
    ----------
    Friedman, "Greedy function approximation: a gradient boosting machine", Annals of
    Statistics 29(5), 2001. Learning what a Kalman smoother leaves: Garcia Satorras,
    Akata, Welling, "Combining generative and discriminative models for hybrid
    inference", NeurIPS 2019.
    """

    rate: float = 0.15  # How much of each tree is believed.
    trees: int = 40  # At most, along and across.

    requires: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    uses: ClassVar[frozenset[Knowledge]] = COMMON_KNOWLEDGE

    def __post_init__(self) -> None:
        require_positive(rate=self.rate)
        if self.trees < _STAGES:
            raise ValueError(f"trees must be at least {_STAGES}, got {self.trees}")

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return the function that smooths and corrects a release."""
        smooth = RadialRTS().fit(context)
        release, truth = context.train.release, context.train.truth
        if len(release) < _LEAST_WALKS:
            return smooth
        smoothed = smooth(release)
        features, ahead = _sample_features(release, smoothed)
        wanted = _rotate(truth - smoothed.xy, np.conj(ahead))
        offsets = release.offsets
        owner = np.repeat(np.arange(len(release)), np.diff(offsets))
        seed = int(context.rng.integers(2**31))
        predicted = self._predict_held_out(features, wanted, owner, seed)

        def loss(added: Floats) -> float:
            xy = smoothed.xy + _rotate(added, ahead)
            return exposure_loss(
                xy=xy, truth=truth, offsets=offsets, epsilon_m=context.epsilon_m
            )

        trees_per_stage = self.trees // _STAGES
        losses = {
            (trees_per_stage * (stage + 1), share): loss(share * added)
            for stage, added in enumerate(predicted)
            for share in _SHARES
        }
        trees, share = min(losses, key=losses.__getitem__)
        if losses[trees, share] > loss(np.zeros_like(wanted)) - _LEAST_GAIN:
            return smooth
        models = self._grow_trees(features, wanted, trees=trees, seed=seed)

        def correct(release: Release) -> Reconstruction:
            smoothed = smooth(release)
            features, ahead = _sample_features(release, smoothed)
            with _limit_to_one_thread():
                predicted = np.stack(
                    [model.predict(features) for model in models], axis=1
                )
            return replace(smoothed, xy=smoothed.xy + share * _rotate(predicted, ahead))

        return correct

    def _predict_held_out(
        self, features: Floats, wanted: Floats, owner: Ints, seed: int
    ) -> Floats:
        """Return corrections by trees grown on other walks, (_STAGES, M, 2) m.

        `owner`, (M,), is the walk of each sample. Stage k has k + 1 parts of all trees.
        """
        trees_per_stage = self.trees // _STAGES
        predicted = np.empty((_STAGES, *wanted.shape))
        for fold in range(_FOLDS):
            held_out = owner % _FOLDS == fold
            models = self._grow_trees(
                features[~held_out],
                wanted[~held_out],
                trees=trees_per_stage * _STAGES,
                seed=seed,
            )
            for axis, model in enumerate(models):
                with _limit_to_one_thread():
                    stages = list(model.staged_predict(features[held_out]))
                predicted[:, held_out, axis] = stages[
                    trees_per_stage - 1 :: trees_per_stage
                ]
        return predicted

    def _grow_trees(
        self, features: Floats, wanted: Floats, *, trees: int, seed: int
    ) -> list[Any]:
        """Return the boosted trees of the corrections along and across."""
        from sklearn.base import clone  # noqa: PLC0415 - heavy, seldom
        from sklearn.ensemble import (  # noqa: PLC0415 - as said
            HistGradientBoostingRegressor,
        )

        model = HistGradientBoostingRegressor(
            max_iter=trees,
            learning_rate=self.rate,
            max_leaf_nodes=8,
            max_bins=31,
            min_samples_leaf=min(200, len(features) // 10 + 1),
            l2_regularization=1.0,
            # The number of trees is chosen by whole walks, above: samples of one walk
            # are no independent test.
            early_stopping=False,
            random_state=seed,
        )
        with _limit_to_one_thread():
            return [clone(model).fit(features, target) for target in wanted.T]


def _rotate(xy: Floats, factor: Complexes) -> Floats:
    """Return vectors, (M, 2), times complex numbers, (M,)."""
    z = (xy[:, 0] + 1j * xy[:, 1]) * factor
    return np.stack([z.real, z.imag], axis=1)


def _sample_features(
    release: Release, smoothed: Reconstruction
) -> tuple[Floats, Complexes]:
    """Return the features of each sample, (M, F), and the heading of its walk, (M,).

    The heading is a complex number of length 1, or less where nobody moves. Features in
    its frame, over each of the stretches about a sample, are the means of the
    smoother's residuals and positions; further features are the logarithm of the
    information there, speed, time to either end of the walk, noise and claimed std.
    """
    assert smoothed.std is not None
    offsets = release.offsets
    row = np.repeat(np.arange(len(release)), np.diff(offsets))
    first, last = offsets[row], offsets[row + 1]
    # One clock for all: tracks follow each other with a gap that no stretch bridges.
    lasting_s = (
        release.t[offsets[1:] - 1] - release.t[offsets[:-1]] + 2.0 * _EDGES_S[-1]
    )
    since_s = release.t - release.t[first]
    clock_s = since_s + np.concatenate([[0.0], np.cumsum(lasting_s)])[row]
    weight = information(release, RadialRTS.USUAL_PASSES)
    z = smoothed.xy[:, 0] + 1j * smoothed.xy[:, 1]
    residual = release.xy[:, 0] + 1j * release.xy[:, 1] - z
    # An empty stretch may begin at sample M, behind the last walk.
    totals = [np.append(total, 0.0) for total in (weight, weight * residual, z)]

    def index_at(after_s: float) -> Ints:
        return np.asarray(np.searchsorted(clock_s, clock_s + after_s))

    ends = [np.minimum(index_at(at), last - 1) for at in (-_REACH_S, _REACH_S)]
    chord, took_s = z[ends[1]] - z[ends[0]], clock_s[ends[1]] - clock_s[ends[0]]
    ahead = chord / np.hypot(np.abs(chord), _STILL_M)
    features = []
    edges = [
        index_at(at) for at in np.concatenate([-_EDGES_S[::-1], _EDGES_S]).tolist()
    ]
    # A stretch without samples has NaN, which trees can handle.
    with np.errstate(invalid="ignore", divide="ignore"):
        for start, end in pairwise(edges):
            bounds = np.column_stack([start, end]).ravel()
            information_sum, pull_sum, position_sum = (
                np.where(start < end, np.add.reduceat(total, bounds)[::2], 0.0)
                for total in totals
            )
            for mean in (pull_sum / information_sum, position_sum / (end - start) - z):
                turned = mean * np.conj(ahead)
                features += [turned.real, turned.imag]
            features.append(
                np.log(np.where(information_sum > 0.0, information_sum, np.nan))
            )
        features.append(np.abs(chord) / took_s)
    features += [np.log(smoothed.std), 0.5 * np.log(noise_m2(release))[row]]
    features += [since_s, since_s[last - 1] - since_s, np.abs(residual)]
    if release.sigma is not None:
        features.append(release.sigma)
    return np.stack(features, axis=1), ahead
