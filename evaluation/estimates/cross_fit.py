"""Success of the best of many rivals without the bias of its choice (cross-fitting).

Chance has raised the highest of many noisy numbers. Here two halves of the
clusters choose for each other: the rival chosen on one half is scored on the other.
Every replicate of an interval repeats the choice, so that the interval contains the
uncertainty of the choice.

The number is the success of a rival that is chosen on half of the people. That is not
always the true best, so the number falls somewhat short of the success of the true best.

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
    rechosen = ratio_of_sums(sums.transpose(1, 0, 2))
    choice = np.where(is_first, best[1, 0], best[0, 0])
    # Every cluster's sums under the choice of the other half, (J, 2, C).
    joined = scored[choice, :, :, np.arange(choice.size)].transpose(1, 2, 0)
    fixed_estimates = ratio_estimates(
        numerator=joined[:, 0],
        denominator=joined[:, 1],
        weights=weights[:1],
        is_share=is_share,
    )
    fixed_choice = ratio_of_sums(joined.transpose(1, 0, 2) @ weights.T)
    leave_one_out = _leave_one_out(contest, joined)
    estimates = [
        interval_of_choice(
            estimate,
            rechosen=rechosen[place],
            fixed_choice=fixed_choice[place],
            leave_one_out=leave_one_out[place],
            is_share=is_share[place],
            may_be_negative=bool(joined[place, 0].min() < 0.0),
        )
        for place, estimate in enumerate(fixed_estimates)
    ]
    return estimates, (int(best[0, 0]), int(best[1, 0]))


def _leave_one_out(contest: _Contest, joined: Floats) -> list[Floats]:
    """Return each number without each cluster in turn; empty where not needed.

    `joined`, (J, 2, C), has the sums of the numbers. Only clusters with trials count.
    """
    is_needed = [needs_jackknife(effective_clusters(trials)) for trials in joined[:, 1]]
    if not any(is_needed):
        return [_NO_VALUES for _ in is_needed]
    sums, _ = contest.joined(1.0 - np.eye(joined.shape[-1]))
    return [
        ratio_of_sums(sums[place])[joined[place, 1] > 0.0] if needed else _NO_VALUES
        for place, needed in enumerate(is_needed)
    ]


def best_rival(over: Floats, under: Floats, *, least: bool, otherwise: int) -> Ints:
    """Return the rival with the best mean over the levels in each row, (R,).

    `over` and `under`, (K, L, R), are numerators and denominators of K rivals at L
    levels; a level counts where all rivals have trials. `otherwise` stands where no
    level counts.
    """
    is_known = (under > 0.0).all(axis=0)
    ratio = np.divide(over, under, out=np.zeros_like(over), where=is_known)
    # The sum ranks as the mean does: the same levels count for all rivals.
    total = ratio.sum(axis=1)
    place = total.argmin(axis=0) if least else total.argmax(axis=0)
    return np.where(is_known.any(axis=0), place, otherwise)


def needs_jackknife(effective: float) -> bool:
    """Whether the interval is a jackknife's: with few effective clusters, not too few."""
    return LEAST_CLUSTERS <= effective < FEW_CLUSTERS


def interval_of_choice(
    estimate: Estimate,
    *,
    rechosen: Floats,
    fixed_choice: Floats,
    leave_one_out: Floats,
    is_share: bool,
    may_be_negative: bool = False,
) -> Estimate:
    """Return an estimate with an interval that repeats the choice of the best rival.

    A replicate has more noise than the people themselves and chooses worse. All
    replicates are therefore shifted back by the amount by which these choices move
    their mean.

    From `LEAST_CLUSTERS` effective clusters, and below `FEW_CLUSTERS`, the interval is
    the jackknife's. A deletion can change the choice, and the number then jumps, which
    widens the interval. With fewer clusters the interval of `estimate` stays.

    Parameters
    ----------
    estimate : Estimate
        The number and its clusters, with the choices that the people themselves make.
    rechosen : (1 + B,)
        The number and its replicates, each with a choice of its own.
    fixed_choice : (B,)
        The replicates, all with the choices that the people themselves make.
    leave_one_out : (D,)
        The number without each cluster that counts; empty without a jackknife.
    is_share : bool
        Whether the number is a share of trials.
    may_be_negative : bool
        Whether the lower end may be below 0.
    """
    replicates = rechosen[1:] - (_mean(rechosen[1:]) - _mean(fixed_choice))
    ends = estimate.ci_low, estimate.ci_high
    is_extreme = is_share and estimate.value in {0.0, 1.0}
    if needs_jackknife(estimate.effective):
        low, high = jackknife_interval(
            np.append(rechosen[0], leave_one_out),
            effective=estimate.effective,
            is_share=is_share,
        )
        ends = (low if may_be_negative else max(0.0, low)), high
    elif estimate.effective >= FEW_CLUSTERS and is_extreme:
        ends = wilson(hits=estimate.value * estimate.n, n=estimate.n)
    elif estimate.effective >= FEW_CLUSTERS:
        low, high = percentile_interval(replicates)
        ends = (max(0.0, low), min(high, 1.0)) if is_share else (low, high)
    return replace(estimate, ci_low=ends[0], ci_high=ends[1], replicates=replicates)


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
