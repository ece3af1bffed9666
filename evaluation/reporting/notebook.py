"""A finished run in a notebook: read from its files at once, as tidy frames, as a plot, as HTML."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from evaluation.analysis.families import LEVEL_UNITS
from evaluation.analysis.keys import Key, Source, rows_of
from evaluation.analysis.metrics import EXPOSURE, METRICS, MISSED_RATE, SUCCESS
from evaluation.analysis.strongest import strongest
from evaluation.experiment.constants import SHARED
from evaluation.reporting.rows import ENDS, Results
from evaluation.runs.files import FRAMES, content_of, from_csv
from evaluation.runs.manifest import read_manifest
from isac_track.errors import DataError, SettingsError, did_you_mean
from isac_track.intervals import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from isac_track.types import Floats

STRONGEST: Final = "strongest"
AFTER: Final = "_after"
"""Ends the name of a descriptor after the strongest attack."""
LEVEL: Final = "level"
SHORT: Final = {"missed": MISSED_RATE, "false_alarm": "false_alarm_rate"}
"""Names of metrics that are long to type."""
_AT: Final = ["family", LEVEL, "adding"]


def load(out: Path | str) -> Results:
    """Return the results of a finished run as its tables hold them; nothing is made anew.

    The gallery of tracks, which only pictures need, is not read. `evaluation.report` makes the
    tables anew from the cells.

    Raises DataError if the folder holds no run, or a table is missing or broken, with the way out.
    """
    out = Path(out)
    manifest = read_manifest(out)
    found: dict[str, Any] = {}
    for of, name in {**FRAMES, "flags": "flags.json", "verdict": "verdict.json"}.items():
        again = f"python -m evaluation.report {out} writes it anew"
        try:
            content = content_of(out / name)
            found[of] = from_csv(content) if of in FRAMES else json.loads(content)
        except FileNotFoundError:
            raise DataError(f"{out / name} is missing; {again} if the run has finished") from None
        except (OSError, ValueError) as error:
            raise DataError(f"{out / name} cannot be read ({error}); {again}") from None
    found["flags"] = pd.DataFrame(found["flags"]["flags"], columns=found["flags"].get("columns"))
    results = Results(out=out, manifest=manifest, **found)
    rows = _own(results)
    ranked = rows_of(rows[rows["metric"].isin([EXPOSURE, SUCCESS]) & (rows["knowledge"] != "")])
    known = {}
    for row in ranked:
        level = None if math.isnan(row["level"]) else row["level"]
        key = Key(row["mechanism"], level, row["consumer"], row["metric"], row["knowledge"])
        known[key] = Estimate(row["value"])
    best = strongest(known, results.families)
    return replace(results, strongest={task: source.attack for task, source in best.items()})


def _own(run: Results) -> pd.DataFrame:
    """Return the summary without the rows of other assumptions, such as another error law."""
    return run.summary[~run.summary["dataset"].str.startswith(f"{run.dataset}:")]


def frame(
    run: Results, metric: str, *, after: str = "", task: str = "", robot: str = ""
) -> pd.DataFrame:
    """Return a metric at every level of every mechanism; see `Results.frame`."""
    name = SHORT.get(metric, metric)
    if name not in METRICS:
        listed = f"; known: {', '.join(METRICS)}"
        hint = did_you_mean(metric, [*METRICS, *SHORT], quote="'") or listed
        raise SettingsError(f"unknown metric {metric!r}{hint}")
    rows = _own(run)
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
        raise SettingsError(f"{run.out} has no {name} of {who or after!r}; it has that of {there}")
    known = found["mechanism"].map(run.families)
    level = found[LEVEL].where([one.is_added for one in known], 0.0)
    adding = [one.adding for one in known]
    columns = {"family": [one.name for one in known], LEVEL: level, "adding": adding}
    is_attack = found["knowledge"] != ""
    columns["attack"] = found["consumer"].where(is_attack, "").str.removeprefix(f"{task}/")
    table = pd.DataFrame(columns | {one: found[one] for one in ("knowledge", *ENDS)})
    knowledge = found["knowledge"].unique()
    label = Source(who, knowledge[0] if len(knowledge) == 1 else "").label
    if who == SHARED:
        label = "as shared"
    elif place in ("descriptor", "reconstruction"):
        label = f"after {label}"
    table.attrs["title"] = f"{METRICS[name].title}, {label}"
    return table.reset_index(drop=True)


def plot(
    run: Results, *, x: str, y: str, task: str = "", robot: str = "", ax: Axes | None = None
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
    at, low, high = (rows[f"{name}_{side}"].to_numpy() for name in ENDS)
    return at, np.maximum([at - low, high - at], 0.0)


def _scaled(run: Results, name: str, *, task: str, robot: str) -> pd.DataFrame:
    """Return a metric as it is shown; a name that ends in `AFTER` is after the strongest attack."""
    metric = name.removesuffix(AFTER)
    after = STRONGEST if metric != name else ""
    found = frame(run, metric, after=after, task=task, robot=robot)
    scale = METRICS[SHORT.get(metric, metric)].scale
    found[ENDS] *= scale
    return found


def html(run: Results) -> str:
    """Return what a notebook shows of a run: the first screen."""
    from evaluation.reporting import answers, first_screen, headline  # noqa: PLC0415 - seldom needed

    of = answers.headline_of(run)
    levels, _ = headline.levels_of(of)
    first = headline.headline_table(of, levels)
    heads = [" ".join(filter(None, [one.above, one.head])) for one in first.columns]
    rows = pd.DataFrame([[cell.full for cell in row] for row in first.rows], columns=heads)
    told = (
        f"<li>{escape(f'{one.topic}: {one.sentence}')}</li>" for one in answers.answers(run, of)
    )
    data = escape(first_screen.data_line(run.manifest))
    return f"<p>{data}</p>{rows.to_html(index=False, border=0)}<ol>{''.join(told)}</ol>"
