"""What do all linkers say together? A conditional logit of their scores, learnt from mates."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
from scipy.optimize import minimize
from scipy.special import logsumexp

from attacks.linkage.alignment import Profile, Shape
from attacks.linkage.behaviour import FEATURES, Behaviour, features
from attacks.linkage.dtw import DTW
from attacks.linkage.histogram import Histogram
from attacks.linkage.learning import LEAST_MATES, among, mated
from attacks.linkage.likelihood_ratio import LikelihoodRatio
from attacks.parameters import positive
from attacks.reconstruction.kalman_rts import RadialRTS
from attacks.remembered import by_track, noise_m2, part
from isac_track.protocols import AttackContext, LinkageTrainingSet, Linker
from isac_track.types import Floats, Ints, Knowledge, Release, derived

_MEMBERS = (LikelihoodRatio(), Behaviour(), Histogram())
_SMOOTHED_MEMBERS = (
    Shape(),
    Profile(),
    DTW(),
)  # Behind `radial_rts` they find far more.
_LEAST_M2 = 1e-4  # Of an error variance, whose logarithm is compared.
_WEAKEST = 0.01  # Quantile of strangers' scores below which a score says no more.


@dataclass(frozen=True, slots=True)
class Fusion:
    """Conditional logit of the scores of all other linkers and of what a pair has in common.

    Scores of `likelihood_ratio`, `behaviour` and `histogram`, of `shape`, `profile` and
    `dtw` behind `radial_rts`, and minus the squared differences of mean speed, log
    duration and log error variance, scaled by what the training set holds, weighted
    (`conditional_logit`) and shrunk towards `likelihood_ratio` alone. Learnt from is
    either half of the mates, scored by linkers fitted on the other. All linkers are
    then fitted on everybody.

    References
    ----------
    McFadden, "Conditional logit analysis of qualitative choice behavior", in *Frontiers
    in Econometrics*, 1974; Wolpert, "Stacked generalization", Neural Networks 5(2),
    1992.
    """

    ridge: float = 1.0

    kind: ClassVar[str] = "linkage"
    one_stretch: ClassVar[bool] = True
    requires: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.MECHANISM})

    def __post_init__(self) -> None:
        positive(ridge=self.ridge)

    def fit(self, context: AttackContext) -> Linker:
        """Return what scores walks like those in the training set.

        With fewer than twice `LEAST_MATES` mates it is `likelihood_ratio` alone.
        """
        train = context.train
        rows = mated(train)
        if rows.size < 2 * LEAST_MATES:
            return _MEMBERS[0].fit(context)
        halves = [among(train, rows[half::2]) for half in (0, 1)]
        found = [
            _stacked(_fitted(context, other), one.probe, one.gallery)
            for one, other in (halves, halves[::-1])
        ]
        mates = [half.mate for half in halves]
        scaled = _scaler(found, mates)
        alone = np.eye(found[0].shape[2])[0]
        weights = conditional_logit(
            list(map(scaled, found)), mates, prior=alone, ridge=self.ridge
        )
        members = _fitted(context, train)
        return lambda p, g: np.asarray(scaled(_stacked(members, p, g)) @ weights)


def _fitted(context: AttackContext, train: LinkageTrainingSet) -> Sequence[Linker]:
    """Return all linkers, fitted on a training set; the last ones smooth before they score."""
    granted = context.granted & {Knowledge.TRAIN, Knowledge.MECHANISM}
    told = context.mechanism if Knowledge.MECHANISM in granted else None
    common = partial(AttackContext, rng=context.rng, epsilon_m=context.epsilon_m)
    knowing = partial(common, granted=granted, mechanism=told)
    smooth = LinkageTrainingSet(
        _smoothed(train.probe), _smoothed(train.gallery), train.mate
    )
    behind = [one.fit(knowing(train=smooth)) for one in _SMOOTHED_MEMBERS]
    return [
        *(one.fit(knowing(train=train)) for one in _MEMBERS),
        *(lambda p, g, one=one: one(_smoothed(p), _smoothed(g)) for one in behind),
    ]


@by_track(part)
def _smoothed(release: Release) -> Release:
    """Return a release with the positions that `radial_rts` makes of it."""
    blind = AttackContext(
        rng=np.random.default_rng(0), epsilon_m=0.3, granted=frozenset()
    )
    return derived(release, xy=RadialRTS().fit(blind)(release).xy)


def _stacked(members: Sequence[Linker], probe: Release, gallery: Release) -> Floats:
    """Return the scores of all members and what each pair has in common, (P, G, K)."""
    sides = [_summary(one) for one in (probe, gallery)]
    apart = -((sides[0][:, None] - sides[1]) ** 2)
    scores = np.stack([one(probe, gallery) for one in members], axis=2)
    return np.concatenate([scores, apart], axis=2)


def _summary(release: Release) -> Floats:
    """Return mean speed, log duration and log error variance of each walk, (N, 3)."""
    starts, ends = release.offsets[:-1], release.offsets[1:] - 1
    lasts_s = release.t[ends] - release.t[starts]
    speed = features(release)[:, list(FEATURES).index("mean speed")]
    noise = np.log(np.maximum(noise_m2(release), _LEAST_M2))
    return np.column_stack([speed, np.log(lasts_s + 1.0), noise])


def _scaler(
    found: Sequence[Floats], mates: Sequence[Ints]
) -> Callable[[Floats], Floats]:
    """Return what cuts scores off and divides all but the first by the spread of strangers'."""
    each = zip(found, mates, strict=True)
    strangers = np.concatenate(
        [x[mate[:, None] != np.arange(x.shape[1])] for x, mate in each]
    )
    least = np.quantile(strangers, _WEAKEST, axis=0)
    spread = np.maximum(strangers, least).std(axis=0)
    spread[0] = 1.0
    spread = np.where(spread > 0.0, spread, 1.0)
    return lambda scores: np.asarray(np.maximum(scores, least) / spread)


def conditional_logit(
    found: Sequence[Floats], mates: Sequence[Ints], *, prior: Floats, ridge: float
) -> Floats:
    """Return the weights of K features that make the mates most probable, (K,).

    `found` are features of several galleries, (P, G, K) each, and `mates` (P,) the
    column of each probe's mate in it. The log probability of the mates, softmax over
    the gallery, is maximised less ``ridge / 2`` times the squared distance of the
    weights from `prior`.
    """

    def loss(weights: Floats) -> tuple[float, Floats]:
        lost = 0.5 * ridge * float(((weights - prior) ** 2).sum())
        slope = ridge * (weights - prior)
        for x, mate in zip(found, mates, strict=True):
            rows = np.arange(mate.size)
            value = x @ weights
            log_p = value - logsumexp(value, axis=1, keepdims=True)
            lost -= float(log_p[rows, mate].sum())
            slope = (
                slope
                - x[rows, mate].sum(axis=0)
                + np.einsum("ij,ijk->k", np.exp(log_p), x)
            )
        return lost, slope

    return np.asarray(minimize(loss, prior, jac=True, method="L-BFGS-B").x)
