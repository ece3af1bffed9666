"""Figures over the level: what is shared and missed, what attacks leave, and who is found again."""

import math
import re
from collections.abc import Iterator, Sequence
from itertools import groupby, zip_longest
from operator import attrgetter
from typing import NamedTuple

import numpy as np
import pandas as pd

from evaluation.analysis.families import CLEAN, FID, FIXED, RAW
from evaluation.analysis.keys import AS_SHARED, ORACLE, Source, is_attack
from evaluation.analysis.linkability import LinkedTask
from evaluation.analysis.metrics import EXPOSURE, METRICS, MISSED_RATE, SUCCESS
from evaluation.analysis.paper import DATASET, PREDICTOR, PUBLISHED
from evaluation.analysis.strongest import most_knowing
from evaluation.experiment.presets import IDENTITY, SHARED
from evaluation.reporting import rows as picked
from evaluation.reporting.charts import LOOKS, Axis, Chart, Curve, Look, Mark, curves_chart
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.result_tables import after_attack, sources_of

_FILES = {FID: "fid_threshold", FIXED: "fixed_error"}
_MOST_CHARACTERS = 80  # Of a file's name.
_SHARED_LOOKS = {EXPOSURE: Look(5), "ael": Look(4, hollow=True), "mel": Look(5, hollow=True)}
_PAPER_LOOK = Look(LOOKS - 1)
_PANELS = {
    "missed conflicts (%)": (MISSED_RATE,),
    "PLR, shared (%)": (EXPOSURE,),
    "exposure, shared (s)": ("ael", "mel"),
}


class _Series(NamedTuple):
    """A metric of somebody: rows have mechanism, level, value and both ends."""

    label: str
    look: Look
    rows: pd.DataFrame
    metric: str

    def of(self, mechanism: str) -> list[float]:
        """Return what it is where a mechanism has no level, as it is shown."""
        found = self.rows.loc[self.rows["mechanism"] == mechanism, "value"]
        return [METRICS[self.metric].scale * one for one in found if np.isfinite(one)]


def figures(run: picked.Results) -> Iterator[Figure]:
    """Yield that after attack, one of each swept mechanism, and that of linkage."""
    yield from _attacked(run)
    names: list[str] = []
    for swept, of in groupby(picked.schemes(run.ours), key=attrgetter("name")):
        known = list(of)
        plain = f"sweep-{re.sub(r'[^A-Za-z0-9=.-]+', '_', swept)[:_MOST_CHARACTERS]}"
        name = _FILES.get(swept, plain)
        names.append(f"{name}-{known[0].place}" if name in names else name)
        yield _sweep(run, known, name=names[-1])
    yield _linked(run)


def _panel(
    scheme: picked.Scheme,
    series: Sequence[_Series],
    key: dict[str, Look],
    *,
    y: Axis,
    task: str = "",
    across: Sequence[tuple[str, float]] = (),
    marked: Sequence[Mark] = (),
) -> Iterator[tuple[str, Chart]]:
    """Yield a panel over the levels of a scheme, its curves named by their ends; none without."""
    curves = []
    for label, look, every, metric in series:
        shown, rows = METRICS[metric], scheme.of(every[np.isfinite(every["value"])])
        values = shown.scale * rows[picked.ENDS].to_numpy(dtype=np.float64).T
        pairs = zip(values[0], rows["level"], strict=True)
        ends = [f"{one:.{shown.digits}f} {shown.unit} at {scheme.at(at)}" for one, at in pairs]
        if ends:
            told = " to ".join(dict.fromkeys([ends[0], ends[-1]]))
            x = rows["level"].to_numpy(dtype=np.float64)
            curves.append(Curve(look, f"{label}: {told}", x, values))
            key[label] = look
    if curves:
        x_axis = Axis(scheme.label, scheme.log)
        chart = curves_chart(curves, x=x_axis, y=y, across=across, marked=marked)
        yield f"{task}{scheme.title}, {scheme.rule_text}", chart
        if marked:
            key["paper (raw at the edge)"] = _PAPER_LOOK


def _raw(series: Sequence[_Series]) -> list[tuple[str, float]]:
    return [(f"k{one.look.place}", value) for one in series for value in one.of(RAW)]


def _sweep(run: picked.Results, known: Sequence[picked.Scheme], *, name: str) -> Figure:
    """Return the figure of a swept mechanism: a column for each adding rule, a row an axis."""
    ours = run.ours[~is_attack(run.ours)]
    of = ours.set_index(["consumer", "metric"], drop=False).sort_index(kind="stable")
    predictors = ours.loc[ours["metric"] == MISSED_RATE, "consumer"].unique()[: LOOKS - 2]
    looks = {(one, MISSED_RATE): Look(place) for place, one in enumerate(predictors)}
    looks |= {(SHARED, metric): look for metric, look in _SHARED_LOOKS.items()}
    series = [
        _Series(METRICS[at[1]].head if at[0] == SHARED else at[0], look, of[of.index == at], at[1])
        for at, look in looks.items()
    ]
    panels, key = list[tuple[str, Chart]](), dict[str, Look]()
    for label, metrics in _PANELS.items():
        some = [one for one in series if one.metric in metrics]
        papers = {one.metric for one in some if one.metric != MISSED_RATE or one.label == PREDICTOR}
        of_paper = [one for one in metrics if one in papers and run.dataset == DATASET]
        for scheme in known:
            marked = [mark for one in of_paper for mark in _papers(one, scheme)]
            y = Axis(label, label.endswith("(s)"))
            panels += _panel(scheme, some, key, y=y, across=_raw(some), marked=marked)
    title = f"Missed conflicts, PLR and exposure over the level: {known[0].title}"
    return Figure(name, "figures", title, panels, len(known), key, "Dashed: raw.")


def _papers(metric: str, scheme: picked.Scheme) -> list[Mark]:
    """Return the paper's numbers; raw, which has no level, goes to the edge next to it."""
    if scheme.name not in _FILES or "linear" not in scheme.rules:
        return []
    edge, shown, marks = np.inf if scheme.log else 0.0, METRICS[metric], []
    for mechanism, at, of, share in PUBLISHED:
        if of == metric and mechanism in (RAW, scheme.name):
            x, where = (edge, "raw") if at is None else (at, scheme.at(at))
            y = share * shown.scale
            name = f"paper: {shown.head} {y:.4g} {shown.unit} at {where}"
            marks.append((_PAPER_LOOK, x, y, name))
    return marks


def _attacked(run: picked.Results) -> Iterator[Figure]:
    """Yield PLR over the level, as shared and after each attack; hollow if the oracle's alone."""
    rows = after_attack(run.ours)
    rows = rows[rows["metric"] == EXPOSURE]
    chosen = [source for source in most_knowing(sources_of(rows)) if source.consumer != IDENTITY]
    oracle = [source for source in chosen if source.knowledge == ORACLE]
    others = [source for source in chosen if source.knowledge and source not in oracle]
    looks = {AS_SHARED: Look(LOOKS - 1)} if AS_SHARED in chosen else {}
    looks |= {of: Look(place) for place, of in enumerate(others[: LOOKS - 1])}
    looks |= {of: Look(place, hollow=True) for place, of in enumerate(oracle[: LOOKS - 1])}
    if not looks.keys() - {AS_SHARED}:
        return
    series = [
        _Series("as shared" if of == AS_SHARED else of.label, look, found, EXPOSURE)
        for of, look in looks.items()
        if len(found := picked.of_source(rows, of))
    ]
    across = _raw([one for one in series if one.label == "as shared"])
    panels, key = list[tuple[str, Chart]](), dict[str, Look]()
    for scheme in picked.schemes(rows):
        panels += _panel(scheme, series, key, y=Axis("PLR, shared or attacked (%)"), across=across)
    title = "PLR as shared and after each attack, over the level"
    said = "Dashed: raw as shared. Hollow: the oracle, a reference."
    yield Figure("after_attack", "after", title, panels, 2, key, said)


def _linked(run: picked.Results) -> Figure:
    """Return rank 1 over the level, a row for each task; at most six attacks, alike everywhere."""
    of = {task: {one: _rank1_rows(task, one) for one in task.attacks} for task in run.tasks}
    ranked = [sorted(each, key=lambda one: _mean(each[one]), reverse=True) for each in of.values()]
    turns = (source for turn in zip_longest(*ranked) for source in turn if source is not None)
    sources = list(dict.fromkeys(turns))[: LOOKS - 1]
    known, y = picked.schemes(run.summary), Axis("rank 1 (%)")
    panels, key = list[tuple[str, Chart]](), dict[str, Look]()
    for task, rows in of.items():
        every = [_Series(one.label, Look(LOOKS - 1), found, SUCCESS) for one, found in rows.items()]
        best = [value for one in every for value in one.of(CLEAN)]
        chance = [100.0 * one.rows["chance"].iloc[0] for one in every if len(one.rows)]
        black = [("k6", one) for one in [*sorted(best)[-1:], *chance[:1]]]
        ran = [(Look(place), one) for place, one in enumerate(sources) if one in rows]
        series = [_Series(one.label, look, rows[one], SUCCESS) for look, one in ran]
        across = [*_raw(series), *black]
        for scheme in known:
            panels += _panel(scheme, series, key, y=y, task=f"{task.name}: ", across=across)
    title = "Rank 1 of the strongest attacks over the level, task by task"
    said = "Dashed: raw of each attack; in black chance, and above it no error at all."
    columns, key = max(2, len(known)), dict(sorted(key.items(), key=lambda one: one[1]))
    return Figure("linkability", "linkability", title, panels, columns, key, said)


def _rank1_rows(task: LinkedTask, source: Source) -> pd.DataFrame:
    """Return rank 1 of an attack where it is known, as a summary has metrics, and chance."""
    keys = "mechanism", "level", "rank1", "ci_low", "ci_high", "chance"
    known = (block[source] for block in task.cells.values() if source in block)
    rows = [[row[key] for key in keys] for row in known if math.isfinite(row["rank1"])]
    return pd.DataFrame(rows, columns=["mechanism", "level", *picked.ENDS, "chance"])


def _mean(rows: pd.DataFrame) -> float:
    """Return mean rank 1 over the levels; neither raw nor the ceiling has one."""
    return float(np.nan_to_num(rows.loc[rows["level"].notna(), "value"].mean(), nan=-1.0))
