"""Success of the best of many rivals without the bias of its choice (cross-fitting).

Chance has raised the highest of many noisy numbers. Here two halves of the
clusters choose for each other: the rival chosen on one half is scored on the other.
Every replicate of an interval repeats the choice, so that the interval contains the
uncertainty of the choice.

References
----------
Chernozhukov, Chetverikov, Demirer, Duflo, Hansen, Newey, Robins, "Double/debiased
machine learning for treatment and structural parameters", Econometrics Journal 21(1),
2018.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from isac_track.intervals import (
    FEW_CLUSTERS,
    LEAST_CLUSTERS,
    Estimate,
    effective_clusters,
    jackknife_interval,
    percentile_interval,
    ratio_estimates,
    wilson,
)
from isac_track.types import Bools, Floats, Ints

_NO_VALUES: Final = np.zeros(0)


@dataclass(frozen=True, eq=False, slots=True)
class _Contest:
    """Sums of K rivals within each of C clusters, at L levels and of J numbers."""

    # (K, L, 2, C) numerator and denominator of the number that ranks the rivals
    choosing: Floats
    scored: Floats  # (K, J, 2, C) the same of the numbers that are scored
    is_first: Bools  # (C,) which clusters are in the first half
    least: bool  # Whether the lowest is the best.

    def best(self, half: Bools, rows: Floats, otherwise: int = 0) -> Ints:
        """Return the best rival on a half of the clusters, (R,).

        `rows`, (R, C), weigh the clusters. `otherwise` stands where there is no trial.
        """
        over, under = np.moveaxis(self.choosing[..., half] @ rows[:, half].T, 2, 0)
        return best_rival(over, under, least=self.least, otherwise=otherwise)

    def joined(self, rows: Floats) -> tuple[Floats, Ints]:
        """Return the scored sums, (J, 2, R), and the choice of either half, (2, R)."""
        halves = self.is_first, ~self.is_first
        everybody = np.ones_like(self.is_first)
        overall = int(self.best(everybody, np.ones((1, everybody.size)))[0])
        best = np.stack([self.best(half, rows, overall) for half in halves])
        sums = np.zeros((self.scored.shape[1], 2, len(rows)))
        for half, choice in zip(halves, best[::-1], strict=True):
            for rival in np.unique(choice).tolist():
                chosen = np.flatnonzero(choice == rival)
                weights = rows[np.ix_(chosen, half)]
                sums[..., chosen] += self.scored[rival][..., half] @ weights.T
        return sums, best


def cross_fit(
    *,
    choosing: Floats,
    scored: Floats,
    is_first: Bools,
    weights: Floats,
    is_share: Sequence[bool],
    least: bool = False,
) -> tuple[list[Estimate], tuple[int, int]]:
    """Return the numbers of the best of K rivals, and the rival that each half chose.

    On either half the rival is chosen whose ratio of sums has the highest mean over the
    levels of `choosing` (with `least` the lowest; among equals the first). All J
    numbers of `scored` then join the sums of either half under the other half's choice.
    Intervals are those of `isac_track.intervals.ratio_estimates`, but every replicate,
    and every deletion of the jackknife, chooses again (`interval_of_choice`).

    Parameters
    ----------
    choosing : (K, L, 2, C)
        Numerator and denominator within each cluster, of each rival at each level.
    scored : (K, J, 2, C)
        Numerator and denominator of each number that is scored.
    is_first : (C,)
        Which clusters are in the first half.
    weights : (B, C)
        How often each cluster is drawn in each bootstrap replicate.
    is_share : (J,)
        Whether each number is a share of trials.
    least : bool
        Whether the lowest is the best.
    """
    contest = _Contest(choosing, scored, is_first, least)
    sums, best = contest.joined(np.concatenate([np.ones((1, is_first.size)), weights]))
    values = ratio_of_sums(sums.transpose(1, 0, 2))
    choice = np.where(is_first, best[1, 0], best[0, 0])
    # Every cluster's sums under the choice of the other half, (J, 2, C).
    joined = scored[choice, :, :, np.arange(choice.size)].transpose(1, 2, 0)
    plain = ratio_estimates(
        numerator=joined[:, 0],
        denominator=joined[:, 1],
        weights=weights[:1],
        is_share=is_share,
    )
    fixed = ratio_of_sums(joined.transpose(1, 0, 2) @ weights.T)
    deletions = _deletions(contest, joined)
    estimates = [
        interval_of_choice(
            estimate,
            drawn=values[place],
            fixed=fixed[place],
            without=deletions[place],
            is_share=is_share[place],
            may_be_negative=bool(joined[place, 0].min() < 0.0),
        )
        for place, estimate in enumerate(plain)
    ]
    return estimates, (int(best[0, 0]), int(best[1, 0]))


def _deletions(contest: _Contest, joined: Floats) -> list[Floats]:
    """Return each number without each cluster in turn; empty where not needed.

    `joined`, (J, 2, C), has the sums of the numbers. Only clusters with trials count.
    """
    few = [is_few(effective_clusters(trials)) for trials in joined[:, 1]]
    if not any(few):
        return [_NO_VALUES for _ in few]
    sums, _ = contest.joined(1.0 - np.eye(joined.shape[-1]))
    return [
        ratio_of_sums(sums[place])[joined[place, 1] > 0.0] if is_needed else _NO_VALUES
        for place, is_needed in enumerate(few)
    ]


def best_rival(over: Floats, under: Floats, *, least: bool, otherwise: int) -> Ints:
    """Return the rival with the best mean over the levels in each row, (R,).

    `over` and `under`, (K, L, R), are numerators and denominators of K rivals at L
    levels; a level counts where all rivals have trials. `otherwise` stands where no
    level counts.
    """
    is_known = (under > 0.0).all(axis=0)
    ratio = np.divide(over, under, out=np.zeros_like(over), where=is_known)
    mean = ratio.sum(axis=1)
    place = mean.argmin(axis=0) if least else mean.argmax(axis=0)
    return np.where(is_known.any(axis=0), place, otherwise)


def is_few(effective: float) -> bool:
    """Whether so few effective clusters need a jackknife's interval."""
    return LEAST_CLUSTERS <= effective < FEW_CLUSTERS


def interval_of_choice(
    plain: Estimate,
    *,
    drawn: Floats,
    fixed: Floats,
    without: Floats,
    is_share: bool,
    may_be_negative: bool = False,
) -> Estimate:
    """Return an estimate with an interval that repeats the choice of the best rival.

    `drawn`, (1 + B,), are the number and its replicates, each with a choice of its own;
    `fixed`, (B,), the replicates under the choice of all clusters; `without`, (D,), the
    number without each cluster that counts. A replicate has more noise than the people
    themselves and chooses worse. All replicates are therefore shifted back by the
    amount by which these choices move their mean. Few clusters have the jackknife's
    interval (`is_few`); fewer keep the interval of `plain`, which also has the number
    of clusters.
    """
    replicates = drawn[1:] - (_mean(drawn[1:]) - _mean(fixed))
    ends = plain.ci_low, plain.ci_high
    is_extreme = is_share and plain.value in {0.0, 1.0}
    if is_few(plain.effective):
        low, high = jackknife_interval(
            np.append(drawn[0], without), effective=plain.effective, is_share=is_share
        )
        ends = (low if may_be_negative else max(0.0, low)), high
    elif plain.effective >= FEW_CLUSTERS and is_extreme:
        ends = wilson(hits=plain.value * plain.n, n=plain.n)
    elif plain.effective >= FEW_CLUSTERS:
        low, high = percentile_interval(replicates)
        ends = (max(0.0, low), min(high, 1.0)) if is_share else (low, high)
    return replace(plain, ci_low=ends[0], ci_high=ends[1], replicates=replicates)


def ratio_of_sums(sums: Floats) -> Floats:
    """Return the ratios of sums, (2, ...): numerators over denominators, NaN over 0."""
    over, under = sums
    return np.asarray(
        np.divide(over, under, out=np.full(over.shape, np.nan), where=under > 0.0)
    )


def _mean(replicates: Floats) -> float:
    """Return the mean of the replicates that are known; 0 without any."""
    known = replicates[np.isfinite(replicates)]
    return float(known.mean()) if known.size else 0.0
