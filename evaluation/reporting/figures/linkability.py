"""The figure of linkage: rank 1 of the strongest attacks over the level, task by task."""

import math
from collections.abc import Iterator
from itertools import zip_longest

import numpy as np
import pandas as pd

from evaluation.analysis.families import CLEAN, RAW
from evaluation.analysis.keys import Source
from evaluation.analysis.linkability import LinkedTask
from evaluation.analysis.metrics import SUCCESS
from evaluation.reporting import rows as picked
from evaluation.reporting.charts import LOOKS, Axis, Look, curves_chart
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.figures.levels import alone, curve


def figures(run: picked.Results) -> Iterator[Figure]:
    """Yield rank 1 over the level, a row for each task; at most six attacks, alike everywhere."""
    of = {
        task.name: {source: rank1_rows(task, source) for source in task.attacks}
        for task in run.tasks
    }
    ranked = [sorted(each, key=lambda one: -_mean(each[one])) for each in of.values()]
    turns = (source for turn in zip_longest(*ranked) for source in turn if source is not None)
    looks = {
        source: Look(place) for place, source in enumerate(list(dict.fromkeys(turns))[: LOOKS - 1])
    }
    known = picked.schemes(run.summary)
    panels, key = [], dict[str, Look]()
    for task in run.tasks:
        every = of[task.name]
        for scheme in known:
            curves, across = [], []
            for source, look in looks.items():
                rows = every.get(source, next(iter(every.values()))[:0])
                found = curve(rows, scheme, label=source.label, look=look, metric=SUCCESS)
                curves += found
                key |= {source.label: look} if found else {}
                across += [(f"k{look.place}", one) for one in alone(rows, RAW, SUCCESS)]
            if curves:
                best = [one for rows in every.values() for one in alone(rows, CLEAN, SUCCESS)]
                chance = [100.0 * rows["chance"].iloc[0] for rows in every.values() if len(rows)]
                across += [("k6", one) for one in [*sorted(best)[-1:], *chance[:1]]]
                x, y = Axis(scheme.label, scheme.log), Axis("rank 1 (%)")
                heading = f"{task.name}: {scheme.title}, {scheme.rule_text}"
                panels.append((heading, curves_chart(curves, x=x, y=y, across=across)))
    title = "Rank 1 of the strongest attacks over the level, task by task"
    said = "Dashed: raw of each attack; in black chance, and above it no error at all."
    columns, key = max(2, len(known)), dict(sorted(key.items(), key=lambda one: one[1]))
    yield Figure("linkability", "linkability", title, panels, columns, key, said)


def rank1_rows(task: LinkedTask, source: Source) -> pd.DataFrame:
    """Return rank 1 of an attack where it is known, as a summary has metrics, and chance."""
    rows = [
        [mechanism, math.nan if level is None else level]
        + [row[key] for key in ("rank1", "ci_low", "ci_high", "chance")]
        for (mechanism, level), block in task.cells.items()
        if (row := block.get(source)) is not None and math.isfinite(row["rank1"])
    ]
    return pd.DataFrame(rows, columns=["mechanism", "level", *picked.ENDS, "chance"])


def _mean(rows: pd.DataFrame) -> float:
    """Return mean rank 1 over the levels; neither raw nor the ceiling has one."""
    return float(np.nan_to_num(rows.loc[rows["level"].notna(), "value"].mean(), nan=-1.0))
