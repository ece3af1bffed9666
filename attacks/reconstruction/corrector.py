"""What is left to learn after the best smoother: boosted trees correct what it does to a walk."""

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from threadpoolctl import threadpool_limits

from attacks.parameters import positive
from attacks.reconstruction.kalman_rts import RadialRTS, information
from attacks.reconstruction.learning import TOLD, exposure_loss
from attacks.remembered import noise_m2
from isac_track.protocols import AttackContext, Reconstructor
from isac_track.types import Complexes, Floats, Ints, Knowledge, Reconstruction, Release

_EDGES_S = np.geomspace(0.05, 3.0, 6) * np.sqrt(1.01)
"""Of the stretches whose means are looked at, to either side of a sample. No clock of round steps
has a sample just there, which rounding would let in or out."""
_REACH_S = 0.503  # To either side: where a walk heads for, and how fast.
# Who moves no farther heads nowhere: the less they move, the less is corrected.
_STILL_M = 1e-3
_LEAST_WALKS = 5
_FOLDS = 3
_one_thread = partial(threadpool_limits, limits=1, user_api="openmp")
"""Processes share the cores: trees that take all of them as well would wait for each other."""
_STAGES = 4  # At which the number of trees is tried.
_SHARES = (0.5, 1.0)
_LEAST_GAIN = 1e-3  # Of `exposure_loss`.


@dataclass(frozen=True, slots=True)
class Corrector:
    """A learnt correction on top of `RadialRTS`.

    Boosted trees are taught on other people's walks, shared by the same mechanism, what
    to add along and across, by what `_looked_at` sees around every sample. How many
    trees, and what share of what they say, is decided by whole walks that they were not
    grown on; where these gain nothing, or fewer than five are known, this is the
    smoother alone. The claimed `std` is its own.

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
    uses: ClassVar[frozenset[Knowledge]] = TOLD

    def __post_init__(self) -> None:
        positive(rate=self.rate)
        if self.trees < _STAGES:
            raise ValueError(f"trees must be at least {_STAGES}, got {self.trees}")

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return what smooths and corrects releases like those in the training set."""
        smooth = RadialRTS().fit(context)
        release, truth = context.train.release, context.train.truth
        if len(release) < _LEAST_WALKS:
            return smooth
        found = smooth(release)
        about, ahead = _looked_at(release, found)
        wanted = _turned(truth - found.xy, np.conj(ahead))
        offsets = release.offsets
        owner = np.repeat(np.arange(len(release)), np.diff(offsets))
        seed = int(context.rng.integers(2**31))
        every = self.trees // _STAGES
        said = np.empty((_STAGES, *wanted.shape))
        for fold in range(_FOLDS):
            judges = owner % _FOLDS == fold
            models = self._grown(about[~judges], wanted[~judges], every * _STAGES, seed)
            for axis, model in enumerate(models):
                with _one_thread():
                    stages = list(model.staged_predict(about[judges]))
                said[:, judges, axis] = stages[every - 1 :: every]

        def loss(added: Floats) -> float:
            xy = found.xy + _turned(added, ahead)
            return exposure_loss(
                xy=xy, truth=truth, offsets=offsets, epsilon_m=context.epsilon_m
            )

        tried = {
            (every * (stage + 1), share): loss(share * added)
            for stage, added in enumerate(said)
            for share in _SHARES
        }
        trees, share = min(tried, key=tried.__getitem__)
        if tried[trees, share] > loss(np.zeros_like(wanted)) - _LEAST_GAIN:
            return smooth
        models = self._grown(about, wanted, trees, seed)

        def correct(release: Release) -> Reconstruction:
            found = smooth(release)
            about, ahead = _looked_at(release, found)
            with _one_thread():
                said = np.stack([model.predict(about) for model in models], axis=1)
            return replace(found, xy=found.xy + share * _turned(said, ahead))

        return correct

    def _grown(self, about: Floats, wanted: Floats, trees: int, seed: int) -> list[Any]:
        """Return the trees for what to add along and across."""
        from sklearn.base import clone  # noqa: PLC0415 - heavy, seldom
        from sklearn.ensemble import (  # noqa: PLC0415 - as said
            HistGradientBoostingRegressor,
        )

        model = HistGradientBoostingRegressor(
            max_iter=trees,
            learning_rate=self.rate,
            max_leaf_nodes=8,
            max_bins=31,
            min_samples_leaf=min(200, len(about) // 10 + 1),
            l2_regularization=1.0,
            early_stopping=False,  # by walks, above: samples of one are no witnesses
            random_state=seed,
        )
        with _one_thread():
            return [clone(model).fit(about, one) for one in wanted.T]


def _turned(xy: Floats, by: Complexes) -> Floats:
    """Return vectors, (M, 2), times complex numbers, (M,)."""
    z = (xy[:, 0] + 1j * xy[:, 1]) * by
    return np.stack([z.real, z.imag], axis=1)


def _looked_at(release: Release, found: Reconstruction) -> tuple[Floats, Complexes]:
    """Return what is known about each sample, (M, F), and where its walk heads for, (M,).

    In the frame of its heading (of length 1, or less where nobody moves), over each of
    the stretches about it, means of what the smoother left over and of where it puts
    the walk, and the logarithm of the information there; speed, time to either end, how
    noisy and how sure it is.
    """
    assert found.std is not None
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
    z = found.xy[:, 0] + 1j * found.xy[:, 1]
    left = release.xy[:, 0] + 1j * release.xy[:, 1] - z
    # The sums at sample M are of nobody: a stretch may begin there, and is empty then.
    totals = [np.append(one, 0.0) for one in (weight, weight * left, z)]

    def place(after_s: float) -> Ints:
        return np.asarray(np.searchsorted(clock_s, clock_s + after_s))

    ends = [np.minimum(place(at), last - 1) for at in (-_REACH_S, _REACH_S)]
    chord, took_s = z[ends[1]] - z[ends[0]], clock_s[ends[1]] - clock_s[ends[0]]
    ahead = chord / np.hypot(np.abs(chord), _STILL_M)
    about = []
    edges = [place(at) for at in np.concatenate([-_EDGES_S[::-1], _EDGES_S]).tolist()]
    with np.errstate(
        invalid="ignore", divide="ignore"
    ):  # nobody is there: NaN, which trees take
        for start, end in pairwise(edges):
            around = np.column_stack([start, end]).ravel()
            told, pulled, walked = (  # nothing over a stretch of none
                np.where(start < end, np.add.reduceat(one, around)[::2], 0.0)
                for one in totals
            )
            for one in (pulled / told, walked / (end - start) - z):
                turned = one * np.conj(ahead)
                about += [turned.real, turned.imag]
            about.append(np.log(np.where(told > 0.0, told, np.nan)))
        about.append(np.abs(chord) / took_s)
    about += [np.log(found.std), 0.5 * np.log(noise_m2(release))[row]]
    about += [since_s, since_s[last - 1] - since_s, np.abs(left)]
    if release.sigma is not None:
        about.append(release.sigma)
    return np.stack(about, axis=1), ahead
