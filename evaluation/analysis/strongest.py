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

from evaluation.analysis.families import CLEAN, FID, FIXED, SWEPT
from evaluation.analysis.keys import AS_SHARED, ORACLE, Key, Source
from evaluation.experiment.presets import IDENTITY
from isac_track.protocols import ADVERSARIES

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    import pandas as pd

    from evaluation.analysis.families import Family


def strongest_of(levels: Iterable[Mapping[Source, float]]) -> Source | None:
    """Return the strongest attack over some levels; None if none counts.

    Parameters
    ----------
    levels : iterable of mapping
        Of each level the success of every attack; what names no adversary is none.
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


def strongest(
    values: Mapping[Key, float], known: Mapping[str, Family], *, metric: str
) -> dict[str, Source]:
    """Return the strongest attack of a run by task; reconstructions are under "".

    Parameters
    ----------
    values : mapping
        Every estimate of the run, or those of its summary (`values_in`).
    known : mapping
        The mechanisms of the run, from `families`.
    metric : str
        What success is: `EXPOSURE` or `SUCCESS`.
    """
    levels = by_task(values, metric=metric)
    chosen = set(swept({name for blocks in levels.values() for name, _ in blocks}, known))
    best = {
        task: strongest_of(block for (name, _), block in blocks.items() if name in chosen)
        for task, blocks in levels.items()
    }
    return {task: source for task, source in best.items() if source is not None}


def by_task(
    values: Mapping[Key, float], *, metric: str
) -> dict[str, dict[tuple[str, float | None], dict[Source, float]]]:
    """Return the success of every attack by task, level, and attack."""
    found: dict[str, dict[tuple[str, float | None], dict[Source, float]]] = {}
    for key, value in values.items():
        if key.metric == metric:
            source = key.measure.source
            found.setdefault(source.task, {}).setdefault(key.where, {})[source] = value
    return found


def swept(mechanisms: Collection[str], known: Mapping[str, Family]) -> list[str]:
    """Return over which mechanisms the strongest attack of a run is chosen."""
    families = {known[name].family for name in mechanisms}
    wanted = SWEPT if families & {FIXED, FID} else families - {CLEAN}
    return [name for name in mechanisms if known[name].family in wanted]


def values_in(summary: pd.DataFrame) -> dict[Key, float]:
    """Return the estimates of a summary by what they are about; the file's columns are enough."""
    columns = ["mechanism", "level", "consumer", "metric", "knowledge", "value"]
    rows = summary[columns].fillna({"knowledge": ""}).itertuples(index=False, name=None)
    return {
        Key(mechanism, None if np.isnan(level) else level, consumer, metric, knowledge): value
        for mechanism, level, consumer, metric, knowledge, value in rows
    }


def most_knowing(of: Iterable[Source]) -> list[Source]:
    """Return for each attack the adversary that knows most, short of the oracle if there is one.

    What was shared stays.
    """
    # The oracle is a reference: it stands for an attack that nobody else can run.
    rank = {"": 0, ORACLE: 0} | {
        name: 1 + place for place, name in enumerate(name for name in ADVERSARIES if name != ORACLE)
    }
    best: dict[str, Source] = {}
    for source in of:
        name = "" if source == AS_SHARED else source.consumer
        if name not in best or rank[source.knowledge] > rank[best[name].knowledge]:
            best[name] = source
    return list(best.values())
