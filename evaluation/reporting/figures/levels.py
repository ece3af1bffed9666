"""Figures over the level: missed conflicts and descriptors as shared, and PLR after each attack."""

import re
from collections.abc import Iterator, Sequence
from itertools import groupby
from operator import attrgetter
from typing import NamedTuple

import numpy as np
import pandas as pd

from evaluation.estimates.families import FID, FIXED, RAW
from evaluation.estimates.keys import AS_SHARED, Source, is_attack
from evaluation.estimates.metrics import EXPOSURE, METRICS, MISSED_RATE
from evaluation.estimates.paper import DATASET, PREDICTOR, PUBLISHED
from evaluation.estimates.strongest import most_knowing
from evaluation.plan.constants import ORACLE
from evaluation.plan.presets import IDENTITY, SHARED
from evaluation.reporting import rows as picked
from evaluation.reporting.charts import (
    LOOKS,
    PERCENT,
    Axis,
    Chart,
    Curve,
    Look,
    Mark,
    curves_chart,
    label_room,
)
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.lookups import ENDS
from evaluation.reporting.names import attack_name, robot_name, robot_subject
from evaluation.reporting.result_tables import after_attack, sources_of

_FILES = {FID: "fid_threshold", FIXED: "fixed_error"}
_MOST_CHARACTERS = 80  # Of a file's name.
_SHARED_LOOKS = {
    EXPOSURE: Look(5),
    "ael": Look(4, hollow=True),
    "mel": Look(5, hollow=True),
}
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
    """Yield the figure of the attacks, and one for each swept mechanism."""
    yield from _attacked(run)
    names: list[str] = []
    for swept, of in groupby(picked.schemes(run.ours), key=attrgetter("name")):
        known = list(of)
        plain = f"sweep-{re.sub(r'[^A-Za-z0-9=.-]+', '_', swept)[:_MOST_CHARACTERS]}"
        name = _FILES.get(swept, plain)
        names.append(f"{name}-{known[0].place}" if name in names else name)
        yield _sweep(run, known, name=names[-1])


def _panel(
    scheme: picked.Scheme,
    series: Sequence[_Series],
    key: dict[str, Look],
    *,
    y: Axis,
    across: Sequence[tuple[str, float]] = (),
    marked: Sequence[Mark] = (),
) -> Iterator[tuple[str, Chart]]:
    """Yield a panel over the levels of a scheme, its curves named by their ends; none without."""
    curves = []
    for label, look, every, metric in series:
        shown, rows = METRICS[metric], scheme.of(every[np.isfinite(every["value"])])
        values = shown.scale * rows[ENDS].to_numpy(dtype=np.float64).T
        pairs = zip(values[0], rows["level"], strict=True)
        ends = [
            f"{one:.{shown.digits}f} {shown.unit} at {scheme.at(at)}"
            for one, at in pairs
        ]
        if ends:
            told = " to ".join(dict.fromkeys([ends[0], ends[-1]]))
            x = rows["level"].to_numpy(dtype=np.float64)
            curves.append(Curve(look, f"{label}: {told}", x, values, label))
    if curves:
        if not label_room(curves):
            key |= {curve.label: curve.look for curve in curves}
        x_axis = Axis(scheme.label, scheme.log)
        chart = curves_chart(curves, x=x_axis, y=y, across=across, marked=marked)
        yield f"{scheme.title}, {scheme.rule_text}", chart
        if marked:
            key["paper (raw at the edge)"] = _PAPER_LOOK


def _raw(series: Sequence[_Series]) -> list[tuple[str, float]]:
    return [(f"k{one.look.place}", value) for one in series for value in one.of(RAW)]


def _sweep(run: picked.Results, known: Sequence[picked.Scheme], *, name: str) -> Figure:
    """Return the figure of a swept mechanism: a column for each adding rule, a row an axis."""
    ours = run.ours[~is_attack(run.ours)]
    of = ours.set_index(["consumer", "metric"], drop=False).sort_index(kind="stable")
    predictors = ours.loc[ours["metric"] == MISSED_RATE, "consumer"].unique()[
        : LOOKS - 2
    ]
    looks = {(one, MISSED_RATE): Look(place) for place, one in enumerate(predictors)}
    looks |= {(SHARED, metric): look for metric, look in _SHARED_LOOKS.items()}
    series = [
        _Series(_sweep_label(*at), look, of[of.index == at], at[1])
        for at, look in looks.items()
    ]
    panels, key = list[tuple[str, Chart]](), dict[str, Look]()
    for label, metrics in _PANELS.items():
        some = [one for one in series if one.metric in metrics]
        papers = {
            one.metric
            for one in some
            if one.metric != MISSED_RATE or one.label == robot_name(PREDICTOR)
        }
        of_paper = [one for one in metrics if one in papers and run.dataset == DATASET]
        for scheme in known:
            marked = [mark for one in of_paper for mark in _papers(one, scheme)]
            y = Axis(label, label.endswith("(s)"))
            panels += _panel(scheme, some, key, y=y, across=_raw(some), marked=marked)
    return Figure(
        name=name,
        section="figures",
        title=f"Missed conflicts, PLR and exposure over the level: {known[0].title}",
        panels=panels,
        columns=len(known),
        key=key,
        caption=_sweep_caption(known[0], ours),
        note="Dashed: raw positions.",
    )


def _sweep_label(consumer: str, metric: str) -> str:
    """Return what a curve of a sweep is called."""
    return METRICS[metric].head if consumer == SHARED else robot_name(consumer)


def _sweep_caption(scheme: picked.Scheme, rows: pd.DataFrame) -> str:
    """Return missed conflicts of the first robot and PLR as shared at both ends of a sweep."""
    known = rows[np.isfinite(rows["value"])]
    robot = next(iter(known.loc[known["metric"] == MISSED_RATE, "consumer"]), "")
    shown, parts = scheme.of(known), list[str]()
    missed = shown[(shown["metric"] == MISSED_RATE) & (shown["consumer"] == robot)]
    if len(missed):
        ends = _ends(missed["value"])
        parts.append(f"{robot_subject(robot)} misses {ends} of conflicts")
    exposed = shown[(shown["metric"] == EXPOSURE) & (shown["consumer"] == SHARED)]
    if len(exposed):
        parts.append(f"PLR as shared is {_ends(exposed['value'])}")
    if not parts:
        return ""
    low, high = (scheme.at(shown["level"].iloc[place]) for place in (0, -1))
    return f"From {low} to {high}, {'. '.join(parts)}."


def _ends(values: "pd.Series[float]") -> str:
    """Return the first and the last of some fractions, in percent."""
    return f"{PERCENT * values.iloc[0]:.0f} % to {PERCENT * values.iloc[-1]:.0f} %"


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
    chosen = [
        source
        for source in most_knowing(sources_of(rows))
        if source.consumer != IDENTITY
    ]
    oracle = [source for source in chosen if source.knowledge == ORACLE]
    others = [source for source in chosen if source.knowledge and source not in oracle]
    looks = {AS_SHARED: Look(LOOKS - 1)} if AS_SHARED in chosen else {}
    looks |= {of: Look(place) for place, of in enumerate(others[: LOOKS - 1])}
    looks |= {
        of: Look(place, hollow=True) for place, of in enumerate(oracle[: LOOKS - 1])
    }
    if not looks.keys() - {AS_SHARED}:
        return
    series = [
        _Series(_label(of), look, found, EXPOSURE)
        for of, look in looks.items()
        if len(found := picked.of_source(rows, of))
    ]
    across = _raw([one for one in series if one.label == "as shared"])
    panels, key = list[tuple[str, Chart]](), dict[str, Look]()
    for scheme in picked.schemes(rows):
        panels += _panel(
            scheme, series, key, y=Axis("PLR, shared or attacked (%)"), across=across
        )
    yield Figure(
        name="after_attack",
        section="after",
        title="PLR as shared and after each attack, over the level",
        panels=panels,
        columns=2,
        key=key,
        caption=_rise(series),
        note="Dashed: raw positions as shared. Hollow: the oracle, a reference.",
    )


def _label(source: Source) -> str:
    """Return what positions are called: as shared, or the attack and the adversary."""
    if source == AS_SHARED:
        return "as shared"
    return f"{attack_name(source.consumer)} ({source.knowledge})"


def _rise(series: Sequence[_Series]) -> str:
    """Return by how many points of PLR the best attack of each level exceeds what was shared.

    The oracle does not count.
    """
    shared = [one.rows for one in series if one.label == _label(AS_SHARED)]
    attacked = [
        one.rows for one in series if not one.look.hollow and one.label != "as shared"
    ]
    if not (shared and attacked):
        return ""
    at = ["mechanism", "level"]
    best = pd.concat(attacked).groupby(at, sort=False)["value"].max()
    rises = PERCENT * (best - shared[0].groupby(at, sort=False)["value"].max()).dropna()
    if rises.empty:
        return ""
    low, high = rises.min(), rises.max()
    change = (
        f"raises PLR by {low:.0f} to" if low > 0 else f"changes PLR by {low:+.0f} to"
    )
    end = f"{high:.0f}" if low > 0 else f"{high:+.0f}"
    return f"The strongest attack {change} {end} points at the levels drawn."
