"""Gaps between the attacks of a run and the bound on all attacks, where it is known.

In a model world each walk follows the motion that was fitted to it. There `plr_gap` is
the optimum's PLR less that of an attack with one release. With Gaussian errors the bound is the
exact posterior. Otherwise it is a ceiling that only a genie reaches, which knows the
scale of every error: the gap is then at most so large. Recorded walks follow no model:
there the genie's value is no bound, and a gap would mix errors with motion.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from evaluation.estimates.keys import EstimatesByAddress, row_worlds
from evaluation.estimates.metrics import (
    BOUNDS,
    PLR,
    PLR_GAP,
    RANK1,
    RANK1_GAP,
    RANK1_OPTIMUM,
)
from evaluation.estimates.strongest import HEADLINE
from evaluation.plan.address import Address, MechanismLevel, parse_consumer
from evaluation.plan.constants import BOUND
from evaluation.plan.world import World
from isac_track.intervals import Estimate, difference

_ENDS = ["value", "ci_low", "ci_high"]
_PLACE = ["world", "mechanism", "level", "task"]


def with_linkage_gaps(estimates: EstimatesByAddress) -> dict[Address, Estimate]:
    """Return linkage in a model world with its optimum, and each attack's gap to it."""
    numbers = dict[Address, Estimate]()
    for key, estimate in estimates.items():
        if key.plugin == BOUND:
            if key.metric == RANK1:
                numbers[key.measured(RANK1_OPTIMUM)] = estimate
            continue
        numbers[key] = estimate
        bound = Address(task=key.task, plugin=BOUND, metric=RANK1)
        best = estimates.get(bound.at(*key.mechanism_level))
        if key.metric == RANK1 and key.adversary and best is not None:
            numbers[key.measured(RANK1_GAP)] = difference(best, estimate)
    return numbers


class ClosestAttack(NamedTuple):
    """The attack that comes closest to the optimum at a level of a model world."""

    world: World
    mechanism_level: MechanismLevel
    attack: Address  # With the task, if it links.
    reached: Estimate  # PLR or rank 1 of the attack there.
    gap: Estimate
    bound: Estimate
    is_exact: bool  # Whether `bound` is the optimum; else it is a genie's ceiling.


def gaps(summary: pd.DataFrame) -> Sequence[ClosestAttack]:
    """Return the closest attack, short of the oracle's, at each level of model worlds.

    Reconstructions come first, then linkers. With few tracks an attack may seem closer
    than it is: the closest attack is that with the lowest upper end of its gap.
    """
    world = row_worlds(summary)
    is_model = world.map(lambda row_world: row_world.is_model).astype(bool)
    rows = summary.assign(world=world)[is_model]
    rows = rows.assign(task=[parse_consumer(name).task for name in rows["consumer"]])
    # With very few people there is no interval.
    rows["upper_end"] = rows["ci_high"].fillna(rows["value"])
    closest = []
    for gap_metric, metric, bound_metrics in (
        (PLR_GAP, PLR, BOUNDS),
        (RANK1_GAP, RANK1, (RANK1_OPTIMUM,)),
    ):
        has_gap = (
            (rows["metric"] == gap_metric)
            & rows["knowledge"].isin(HEADLINE)
            & rows["value"].notna()
        )
        is_needed = has_gap | rows["metric"].isin([*bound_metrics, metric])
        for _, level_rows in rows[is_needed].groupby(_PLACE, sort=False, dropna=False):
            is_gap = level_rows["metric"] == gap_metric
            candidates = level_rows[is_gap].nsmallest(1, "upper_end")
            bounds = level_rows[level_rows["metric"].isin(bound_metrics)]
            if candidates.empty or bounds.empty:
                continue
            by_attack = level_rows[level_rows["metric"] == metric]
            closest.append(
                _closest_gap(candidates.iloc[0], by_attack, bounds, bound_metrics[0])
            )
    return closest


def _closest_gap(
    gap: pd.Series, by_attack: pd.DataFrame, bounds: pd.DataFrame, optimum: str
) -> ClosestAttack:
    """Return the gap of a level from a row of the summary.

    `by_attack` has what each attack reaches there. Of the `bounds` the metric `optimum`
    counts; without it the first, a ceiling, does.
    """
    attack = parse_consumer(gap["consumer"], gap["knowledge"])
    is_attack = (by_attack["consumer"] == attack.consumer) & (
        by_attack["knowledge"] == attack.adversary
    )
    is_optimum = bounds["metric"] == optimum
    is_exact = bool(is_optimum.any())
    bound = bounds[is_optimum].iloc[0] if is_exact else bounds.iloc[0]
    level = gap["level"]
    return ClosestAttack(
        world=gap["world"],
        mechanism_level=MechanismLevel(
            gap["mechanism"], None if np.isnan(level) else level
        ),
        attack=attack,
        reached=Estimate(*by_attack[is_attack].iloc[0][_ENDS]),
        gap=Estimate(*gap[_ENDS]),
        bound=Estimate(*bound[_ENDS]),
        is_exact=is_exact,
    )
