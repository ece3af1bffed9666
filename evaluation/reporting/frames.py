"""What a notebook makes of a run: tidy frames, plots, and how it is shown."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Final

import numpy as np
import pandas as pd

from evaluation.analysis.families import LEVEL_UNITS
from evaluation.analysis.keys import Source
from evaluation.analysis.metrics import EXPOSURE, METRICS, MISSED_RATE, SUCCESS
from evaluation.experiment.constants import SHARED
from isac_track.errors import SettingsError, did_you_mean
from isac_track.types import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from evaluation.analysis.families import Family

STRONGEST: Final = "strongest"
AFTER: Final = "_after"  # Ends the name of a descriptor after the strongest attack.
LEVEL: Final = "level"
SHORT: Final = {"missed": MISSED_RATE, "false_alarm": "false_alarm_rate"}
"""Names of metrics that are long to type."""
_AT: Final = ["family", LEVEL, "adding"]
_ENDS: Final = ["value", "ci_low", "ci_high"]
_MOST_SHOWN = 14


@dataclass(frozen=True, eq=False, slots=True)
class Measured:
    """What a run measured."""

    summary: pd.DataFrame  # Without the rows of other assumptions.
    families: Mapping[str, Family]
    strongest: Mapping[str, Source]


def frame(
    run: Measured, metric: str, *, after: str = "", task: str = "", robot: str = ""
) -> pd.DataFrame:
    """Return a metric at every level of every mechanism; see `Results.frame`."""
    name = SHORT.get(metric, metric)
    if name not in METRICS:
        listed = f"; known: {', '.join(METRICS)}"
        hint = did_you_mean(metric, [*METRICS, *SHORT], quote="'") or listed
        raise SettingsError(f"unknown metric {metric!r}{hint}")
    rows = run.summary
    rows = rows[rows["metric"] == name]
    place = METRICS[name].measured
    tasks = rows["consumer"].map(lambda one: Source(one).task)
    task = task or next(iter(tasks), "")
    rows = rows[tasks == task]
    if place == "predictor":
        who = robot or next(iter(rows["consumer"]), "")
    elif place == "descriptor" and not after:
        who = SHARED
    elif after in ("", STRONGEST):
        best = run.strongest.get(task, Source(""))
        who = f"{task}/{best.consumer}" if task else best.consumer
        rows = rows[rows["knowledge"] == best.knowledge]
    else:
        who = f"{task}/{after}" if task else after
    found = rows[rows["consumer"] == who]
    if found.empty:
        there = ", ".join(dict.fromkeys(rows["consumer"])) or "nobody in this task"
        raise SettingsError(f"the run has no {name} of {who or after!r}; it has that of {there}")
    known = found["mechanism"].map(run.families)
    level = found[LEVEL].where(known.map(lambda one: one.is_added), 0.0)
    adding = [one.adding for one in known]
    columns = {"family": [one.name for one in known], LEVEL: level, "adding": adding}
    is_attack = found["knowledge"] != ""
    columns["attack"] = found["consumer"].where(is_attack, "").str.removeprefix(f"{task}/")
    table = pd.DataFrame(columns | {one: found[one] for one in ("knowledge", *_ENDS)})
    knowledge = found["knowledge"].unique()
    label = Source(who, knowledge[0] if len(knowledge) == 1 else "").label
    if who == SHARED:
        label = "as shared"
    elif place in ("descriptor", "reconstruction"):
        label = f"after {label}"
    table.attrs["title"] = f"{METRICS[name].title}, {label}"
    return table.reset_index(drop=True)


def plot(
    run: Measured, *, x: str, y: str, task: str = "", robot: str = "", ax: Axes | None = None
) -> Axes:
    """Draw one metric over another, or over the level; see `Results.plot`."""
    from matplotlib import pyplot as plt  # noqa: PLC0415 - slow to import, and seldom needed

    of_y = _scaled(run, y, task=task, robot=robot)
    of_x = of_y.assign(value=of_y[LEVEL], ci_low=math.nan, ci_high=math.nan)
    of_x.attrs["title"] = "; ".join(
        [LEVEL, *(f"{name} {unit}" for name, unit in LEVEL_UNITS.items())]
    )
    if x != LEVEL:
        of_x = _scaled(run, x, task=task, robot=robot)
    both = of_x.merge(of_y, on=_AT, suffixes=("_x", "_y"))
    ax = plt.subplots()[1] if ax is None else ax
    for (family, adding), rows in both.groupby(["family", "adding"], sort=False):
        ordered = rows.sort_values(LEVEL)
        (x_at, x_error), (y_at, y_error) = (_bars(ordered, one) for one in "xy")
        name = f"{family} {adding}".rstrip()
        ax.errorbar(x_at, y_at, y_error, x_error, marker="o", capsize=2, label=name)
    ax.set(xlabel=of_x.attrs["title"], ylabel=of_y.attrs["title"])
    ax.legend()
    return ax


def _bars(rows: pd.DataFrame, side: str) -> tuple[Floats, Floats]:
    """Return values, (R,), and what the ends of their intervals lie below and above, (2, R)."""
    at, low, high = (rows[f"{name}_{side}"].to_numpy() for name in _ENDS)
    return at, np.maximum([at - low, high - at], 0.0)


def _scaled(run: Measured, name: str, *, task: str, robot: str) -> pd.DataFrame:
    """Return a metric as it is shown; a name that ends in `AFTER` is after the strongest attack."""
    metric = name.removesuffix(AFTER)
    after = STRONGEST if metric != name else ""
    found = frame(run, metric, after=after, task=task, robot=robot)
    scale = METRICS[SHORT.get(metric, metric)].scale
    found[_ENDS] *= scale
    return found


def html(run: Measured) -> str:
    """Return a table of what tells most: missed conflicts, PLR as shared and attacked, rank 1."""
    shown = []
    for name in ("missed", EXPOSURE, f"{EXPOSURE}{AFTER}", SUCCESS):
        try:
            one = _scaled(run, name, task="", robot="")
        except SettingsError:  # the run has none
            continue
        shown.append(one[[*_AT, "value"]].rename(columns={"value": one.attrs["title"]}))
    both = reduce(lambda left, right: left.merge(right, on=_AT, how="left"), shown)
    return both.head(_MOST_SHOWN).to_html(
        index=False, border=0, float_format="{:.4g}".format, na_rep=""
    )
