"""How far the attacks of a run are from what no attack exceeds, where that is known.

In worlds of walks that follow the fitted motion an attack with one release can be held against the
optimum: `plr_gap` is what it lacks of the exact posterior where errors are Gaussian, and at most
what it lacks where they are not, since only a genie who is told the scale of every error reaches
the ceiling. On recorded walks a gap would mix that with how far people are from the motion.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np
import pandas as pd

from evaluation.analysis.keys import Key, Source, Where, worlds_of
from evaluation.analysis.metrics import EXPOSURE, GAP, OPTIMUM, RANK_GAP, RANK_OPTIMUM, SUCCESS
from evaluation.analysis.strongest import HEADLINE
from evaluation.experiment.constants import BOUND, MODEL
from isac_track.intervals import Estimate, difference

_ENDS = ["value", "ci_low", "ci_high"]


def linked_gaps(found: Mapping[Key, Estimate]) -> dict[Key, Estimate]:
    """Return linkage of a model world with the optimum's name, and what attacks lack of it.

    Differences are paired: the same people, drawn alike.
    """
    named = dict[Key, Estimate]()
    for key, one in found.items():
        task, _, who = key.consumer.partition("/")
        if who == BOUND:
            named |= {key._replace(metric=RANK_OPTIMUM): one} if key.metric == SUCCESS else {}
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
    attack: Source
    attacked: Estimate  # PLR that it reaches there.
    gap: Estimate
    bound: Estimate
    is_exact: bool  # Whether `bound` is the optimum; else it is the ceiling of a genie.


def gaps(summary: pd.DataFrame) -> Sequence[Gap]:
    """Return the closest attack, short of the oracle's, at every level of every model world."""
    world = worlds_of(summary)
    rows = summary.assign(world=world)[world.str.startswith(MODEL)]
    found = []
    places = rows.groupby(["world", "mechanism", "level"], sort=False, dropna=False)
    for place, of in places:
        name, mechanism, level = cast("tuple[str, str, float]", place)
        able = of[(of["metric"] == GAP) & of["knowledge"].isin(HEADLINE) & of["value"].notna()]
        bounds = of[of["consumer"] == BOUND].sort_values("metric", key=lambda one: one != OPTIMUM)
        if able.empty or bounds.empty:
            continue
        best = able.nsmallest(1, "ci_high").iloc[0]  # of few tracks one may seem closer
        source = Source(best["consumer"], best["knowledge"])
        is_own = (of["consumer"] == source.consumer) & (of["knowledge"] == source.knowledge)
        attacked = of.loc[is_own & (of["metric"] == EXPOSURE)].iloc[0]
        where = mechanism, None if np.isnan(level) else level
        plr, gap, bound = (Estimate(*one[_ENDS]) for one in (attacked, best, bounds.iloc[0]))
        is_exact = bool((bounds["metric"] == OPTIMUM).any())
        found.append(Gap(name, where, source, plr, gap, bound, is_exact))
    return found
