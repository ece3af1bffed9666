"""How far the attacks of a run are from what no attack exceeds, where that is known.

In worlds where each walk follows the motion that was fitted to it, `plr_gap` is what an
attack with one release lacks of the exact posterior where errors are Gaussian, and at
most what it lacks where they are not, since only a genie who is told the scale of every
error reaches the ceiling. Recorded walks follow no model: there the genie's value is no
bound, and a gap would mix errors with motion.
"""

from collections.abc import Sequence
from typing import NamedTuple, cast

import numpy as np
import pandas as pd

from evaluation.estimates.keys import Found, Key, Source, Where, worlds_of
from evaluation.estimates.metrics import (
    BOUNDS,
    EXPOSURE,
    GAP,
    RANK_GAP,
    RANK_OPTIMUM,
    SUCCESS,
)
from evaluation.estimates.strongest import HEADLINE
from evaluation.plan.constants import BOUND, MODEL
from isac_track.intervals import Estimate, difference

_ENDS = ["value", "ci_low", "ci_high"]
_PLACE = ["world", "mechanism", "level", "task"]


def linked_gaps(found: Found) -> dict[Key, Estimate]:
    """Return linkage of a model world with the optimum's name, and what attacks lack of it."""
    named = dict[Key, Estimate]()
    for key, one in found.items():
        task, _, who = key.consumer.partition("/")
        if who == BOUND:
            named |= (
                {key._replace(metric=RANK_OPTIMUM): one}
                if key.metric == SUCCESS
                else {}
            )
            continue
        named[key] = one
        best = found.get(Key(*key.where, f"{task}/{BOUND}", SUCCESS))
        if key.metric == SUCCESS and key.knowledge and best is not None:
            named[key._replace(metric=RANK_GAP)] = difference(best, one)
    return named


class Gap(NamedTuple):
    """The attack that comes closest to the optimum at a level of a model world."""

    world: str
    where: Where
    attack: Source  # With the task, if it links.
    reached: Estimate  # PLR or rank 1 that it comes to there.
    gap: Estimate
    bound: Estimate
    is_exact: bool  # Whether `bound` is the optimum; else it is the ceiling of a genie.


def gaps(summary: pd.DataFrame) -> Sequence[Gap]:
    """Return the closest attack, short of the oracle's, at every level of every model world.

    First those that rebuild, then those that link. Of few tracks an attack may seem
    closer than it is: the closest is who is surely so.
    """
    world = worlds_of(summary)
    rows = summary.assign(world=world)[world.str.startswith(MODEL)]
    rows = rows.assign(task=[Source(one).task for one in rows["consumer"]])
    rows["most"] = rows["ci_high"].fillna(
        rows["value"]
    )  # very few people have no interval
    found = []
    for gap, metric, known in (
        (GAP, EXPOSURE, BOUNDS),
        (RANK_GAP, SUCCESS, (RANK_OPTIMUM,)),
    ):
        able = (
            (rows["metric"] == gap)
            & rows["knowledge"].isin(HEADLINE)
            & rows["value"].notna()
        )
        some = rows[able | rows["metric"].isin([*known, metric])]
        for place, of in some.groupby(_PLACE, sort=False, dropna=False):
            name, mechanism, level, _ = cast("tuple[str, str, float, str]", place)
            lacking = of[of["metric"] == gap].nsmallest(1, "most")
            bounds = of[of["metric"].isin(known)]
            if lacking.empty or bounds.empty:
                continue
            best = lacking.iloc[0]
            source = Source(best["consumer"], best["knowledge"])
            is_own = (of["consumer"] == source.consumer) & (
                of["knowledge"] == source.knowledge
            )
            reached = of.loc[is_own & (of["metric"] == metric)].iloc[0]
            is_exact = known[0] in bounds["metric"].to_numpy()
            bound = bounds[(bounds["metric"] == known[0]) | (not is_exact)].iloc[0]
            plr, lacks, most = (Estimate(*one[_ENDS]) for one in (reached, best, bound))
            where = mechanism, None if np.isnan(level) else level
            found.append(Gap(name, where, source, plr, lacks, most, is_exact))
    return found
