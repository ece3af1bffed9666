"""Link walks by all linkers: a conditional logit of their scores, learnt from mates."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from scipy.optimize import minimize
from scipy.special import logsumexp

from attacks.building_blocks import (
    FEATURES,
    LEAST_MATES,
    features,
    make_attack,
    mated_rows,
    memoised_by_track,
    noise_m2,
    select_pairs,
    select_tracks,
)
from further_attacks.parameters import require_positive
from isac_track.protocols import AttackContext, LinkageTrainingSet, Linker
from isac_track.types import Floats, Ints, Knowledge, Release

_MEMBERS = ("likelihood_ratio", "behaviour", "histogram")
# Linkers that link far more people behind `radial_rts`.
_SMOOTHED_MEMBERS = ("shape", "profile", "dtw")
_LEAST_M2 = 1e-4  # Of an error variance, whose logarithm is compared.
_WEAKEST = 0.01  # Quantile of strangers' scores: lower scores are raised to it.


@dataclass(frozen=True, slots=True)
class Fusion:
    """Conditional logit of the scores of all other linkers and of three differences.

    The features of a pair are the scores of `likelihood_ratio`, `behaviour` and
    `histogram`, and those of `shape`, `profile` and `dtw` behind `radial_rts`. Further
    ones are minus the squared differences of mean speed, log duration and log error
    variance. The training set scales and weighs them (`conditional_logit`); the weights
    are shrunk towards `likelihood_ratio` alone. They are learnt from either half of the
    mates, scored by linkers fitted on the other half. All linkers are then fitted on
    everybody.

    References
    ----------
    McFadden, "Conditional logit analysis of qualitative choice behavior", in *Frontiers
    in Econometrics*, 1974; Wolpert, "Stacked generalization", Neural Networks 5(2),
    1992.
    """

    ridge: float = 1.0

    kind: ClassVar[str] = "linkage"
    same_stretch: ClassVar[bool] = True
    requires: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.MECHANISM})

    def __post_init__(self) -> None:
        require_positive(ridge=self.ridge)

    def fit(self, context: AttackContext) -> Linker:
        """Return the linker, its weights learnt from the training set.

        With fewer than twice `LEAST_MATES` mates it is `likelihood_ratio` alone.
        """
        train = context.train
        rows = mated_rows(train)
        if rows.size < 2 * LEAST_MATES:
            alone: Linker = make_attack(_MEMBERS[0]).fit(context)
            return alone
        halves = [select_pairs(train, rows[half::2]) for half in (0, 1)]
        half_scores = [
            _stacked(_fitted(context, other), scored.probe, scored.gallery)
            for scored, other in (halves, halves[::-1])
        ]
        mates = [half.mate for half in halves]
        scale = _scaler(half_scores, mates)
        scaled = [scale(scores) for scores in half_scores]
        first_only = np.eye(half_scores[0].shape[2])[0]
        weights = conditional_logit(scaled, mates, prior=first_only, ridge=self.ridge)
        members = _fitted(context, train)
        return lambda p, g: np.asarray(scale(_stacked(members, p, g)) @ weights)


def _fitted(context: AttackContext, train: LinkageTrainingSet) -> Sequence[Linker]:
    """Return all linkers, fitted on a training set; the last three smooth first."""
    granted = context.granted & {Knowledge.TRAIN, Knowledge.MECHANISM}
    make_context = partial(
        AttackContext,
        rng=context.rng,
        epsilon_m=context.epsilon_m,
        granted=granted,
        mechanism=context.mechanism if Knowledge.MECHANISM in granted else None,
    )
    smooth = LinkageTrainingSet(
        _smoothed(train.probe), _smoothed(train.gallery), train.mate
    )
    behind = [
        partial(_link_smoothed, make_attack(name).fit(make_context(train=smooth)))
        for name in _SMOOTHED_MEMBERS
    ]
    direct = [make_attack(name).fit(make_context(train=train)) for name in _MEMBERS]
    return [*direct, *behind]


def _link_smoothed(linker: Linker, probe: Release, gallery: Release) -> Floats:
    """Return the scores of a linker on smoothed releases, (P, G)."""
    return linker(_smoothed(probe), _smoothed(gallery))


@memoised_by_track(select_tracks)
def _smoothed(release: Release) -> Release:
    """Return a release with positions smoothed by `radial_rts`."""
    blind = AttackContext(
        rng=np.random.default_rng(0), epsilon_m=0.3, granted=frozenset()
    )
    smoothed = make_attack("radial_rts").fit(blind)(release)
    return replace(release, xy=smoothed.xy)


def _stacked(members: Sequence[Linker], probe: Release, gallery: Release) -> Floats:
    """Return the features of each pair, (P, G, K): all scores, then the differences."""
    closeness = -((_summary(probe)[:, None] - _summary(gallery)) ** 2)
    scores = np.stack([linker(probe, gallery) for linker in members], axis=2)
    return np.concatenate([scores, closeness], axis=2)


def _summary(release: Release) -> Floats:
    """Return mean speed, log duration and log error variance of each walk, (N, 3)."""
    starts, ends = release.offsets[:-1], release.offsets[1:] - 1
    lasts_s = release.t[ends] - release.t[starts]
    speed = features(release)[:, list(FEATURES).index("mean speed")]
    noise = np.log(np.maximum(noise_m2(release), _LEAST_M2))
    return np.column_stack([speed, np.log(lasts_s + 1.0), noise])


def _scaler(
    half_scores: Sequence[Floats], mates: Sequence[Ints]
) -> Callable[[Floats], Floats]:
    """Return the function that scales features, (P, G, K), by those of strangers.

    It raises low features to a quantile, and divides all but the first by their spread.
    """
    strangers = np.concatenate(
        [
            scores[mate[:, None] != np.arange(scores.shape[1])]
            for scores, mate in zip(half_scores, mates, strict=True)
        ]
    )
    least = np.quantile(strangers, _WEAKEST, axis=0)
    spread = np.maximum(strangers, least).std(axis=0)
    spread[0] = 1.0
    spread = np.where(spread > 0.0, spread, 1.0)
    return lambda scores: np.asarray(np.maximum(scores, least) / spread)


def conditional_logit(
    galleries: Sequence[Floats], mates: Sequence[Ints], *, prior: Floats, ridge: float
) -> Floats:
    """Return the weights of K features that make the mates most probable, (K,).

    `galleries` are the features of several galleries, (P, G, K) each, and `mates` (P,)
    the column of each probe's mate in it. The weights maximise the log probability of
    the mates, softmax over the gallery, less ``ridge / 2`` times the squared distance
    of the weights from `prior`.
    """

    def loss(weights: Floats) -> tuple[float, Floats]:
        lost = 0.5 * ridge * float(((weights - prior) ** 2).sum())
        slope = ridge * (weights - prior)
        for pair_features, mate in zip(galleries, mates, strict=True):
            rows = np.arange(mate.size)
            value = pair_features @ weights
            log_p = value - logsumexp(value, axis=1, keepdims=True)
            lost -= float(log_p[rows, mate].sum())
            slope = (
                slope
                - pair_features[rows, mate].sum(axis=0)
                + np.einsum("ij,ijk->k", np.exp(log_p), pair_features)
            )
        return lost, slope

    return np.asarray(minimize(loss, prior, jac=True, method="L-BFGS-B").x)
