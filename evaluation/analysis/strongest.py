"""The strongest attack: one definition, for the verdict, the tables, the page and a site's level.

It is the attack with the highest mean success over some levels: PLR after a reconstruction, rank 1
of a linker. Of all rows (attack and adversary) those count that ran at all of these levels, short
of the oracle, who is a reference, and of the control, which takes positions as they are. Of equals
the first of the run counts.

The strongest of a run is chosen over all levels of raw, fixed noise and FID, so that the choice
favours none of them; of a run with neither of the two over all levels but the ceiling.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from evaluation.analysis.families import CLEAN, FID, FIXED, SWEPT, Family
from evaluation.analysis.keys import AS_SHARED, ORACLE, Key, Source, Where
from evaluation.analysis.metrics import EXPOSURE, SUCCESS
from evaluation.experiment.presets import IDENTITY
from isac_track.protocols import ADVERSARIES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from isac_track.intervals import Estimate

    Levels = dict[Where, dict[Source, float]]


def strongest_of(levels: Iterable[Mapping[Source, float]]) -> Source | None:
    """Return the strongest attack over some levels, or None if none counts.

    `levels` is of each level the success of every attack; what names no adversary is none.
    """
    values: dict[Source, list[float]] = {}
    for level in levels:
        for source, value in level.items():
            if source.knowledge not in ("", ORACLE) and source.consumer != IDENTITY:
                values.setdefault(source, []).append(value)
    most = max(map(len, values.values()), default=0)
    means = {source: float(np.mean(one)) for source, one in values.items() if len(one) == most}
    finite = {source: mean for source, mean in means.items() if np.isfinite(mean)}
    return max(finite, key=finite.__getitem__, default=None)


def strongest(found: Mapping[Key, Estimate], known: Mapping[str, Family]) -> dict[str, Source]:
    """Return the strongest linker of a run by task; under "" the strongest reconstruction.

    `found` is every estimate of the run, `known` its mechanisms.
    """
    best = {}
    for metric in (EXPOSURE, SUCCESS):
        levels = by_task(found, metric=metric)
        families = {known[name].family for blocks in levels.values() for name, _ in blocks}
        wanted = SWEPT if families & {FIXED, FID} else families - {CLEAN}
        for task, blocks in levels.items():
            one = strongest_of(
                block for (name, _), block in blocks.items() if known[name].family in wanted
            )
            if one is not None:
                best[task] = one
    return best


def by_task(found: Mapping[Key, Estimate], *, metric: str) -> dict[str, Levels]:
    """Return the success of every attack by task, level, and attack."""
    values: dict[str, Levels] = {}
    for key, one in found.items():
        if key.metric == metric:
            source = key.measure.source
            values.setdefault(source.task, {}).setdefault(key.where, {})[source] = one.value
    return values


def most_knowing(of: Iterable[Source]) -> list[Source]:
    """Return for each attack the adversary that knows most, short of the oracle if there is one.

    What was shared stays.
    """
    # The oracle is a reference: it stands for an attack that nobody else can run.
    rank = {name: place for place, name in enumerate(("", *ADVERSARIES))} | {ORACLE: 0}
    best: dict[str, Source] = {}
    for source in of:
        name = "" if source == AS_SHARED else source.consumer
        pair = best.get(name, source), source
        best[name] = max(pair, key=lambda one: rank[one.knowledge])
    return list(best.values())
