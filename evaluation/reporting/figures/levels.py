"""Figures over the level: missed conflicts, descriptors as shared, attacked PLR."""

import re
from collections.abc import Iterator, Sequence
from itertools import groupby
from operator import attrgetter
from typing import NamedTuple

import numpy as np
import pandas as pd

from evaluation.estimates.families import FID, FIXED, RAW
from evaluation.estimates.keys import is_attack
from evaluation.estimates.metrics import METRICS, MISSED_RATE, PLR
from evaluation.estimates.paper import DATASET, PREDICTOR, PUBLISHED
from evaluation.estimates.strongest import most_knowing
from evaluation.plan.address import AS_SHARED, Address
from evaluation.plan.constants import ORACLE
from evaluation.plan.presets import IDENTITY, SHARED
from evaluation.reporting.amounts import PERCENT, whole_percent
from evaluation.reporting.charts import (
    LOOKS,
    Axis,
    Chart,
    Curve,
    Guide,
    LonePoint,
    Look,
    curves_chart,
    label_room,
)
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.lookups import ENDS
from evaluation.reporting.names import attack_name, robot_name, robot_subject
from evaluation.reporting.result_tables import after_attack, list_readers
from evaluation.reporting.rows import Results, reader_rows
from evaluation.reporting.schemes import Scheme, schemes

_FILES = {FID: "fid_threshold", FIXED: "fixed_error"}
_MOST_CHARACTERS = 80  # Of a file's name.
_SHARED_LOOKS = {
    PLR: Look(5),
    "ael": Look(4, hollow=True),
    "mel": Look(5, hollow=True),
}
_PAPER_LOOK = Look(LOOKS - 1)
_PANELS = {
    "missed conflicts (%)": (MISSED_RATE,),
    "PLR, shared (%)": (PLR,),
    "exposure, shared (s)": ("ael", "mel"),
}


class _Series(NamedTuple):
    """A metric of a consumer."""

    label: str
    look: Look
    rows: pd.DataFrame  # Columns mechanism, level, value and both ends.
    metric: str

    def values_at(self, mechanism: str) -> list[float]:
        """Return the finite values of a mechanism in the units of the axis."""
        values = self.rows.loc[self.rows["mechanism"] == mechanism, "value"]
        scale = METRICS[self.metric].scale
        return [scale * value for value in values if np.isfinite(value)]


def figures(run: Results) -> Iterator[Figure]:
    """Yield the figure of the attacks, and one for each swept mechanism."""
    yield from _attacked(run)
    names: list[str] = []
    for swept, group in groupby(schemes(run.ours), key=attrgetter("name")):
        rules = list(group)
        plain = f"sweep-{re.sub(r'[^A-Za-z0-9=.-]+', '_', swept)[:_MOST_CHARACTERS]}"
        name = _FILES.get(swept, plain)
        names.append(f"{name}-{rules[0].place}" if name in names else name)
        yield _sweep(run, rules, name=names[-1])


def _panel(
    scheme: Scheme,
    series: Sequence[_Series],
    key: dict[str, Look],
    *,
    y: Axis,
    guides: Sequence[Guide] = (),
    marked: Sequence[LonePoint] = (),
) -> Iterator[tuple[str, Chart]]:
    """Yield a panel over the levels of a scheme, its curves named by their ends.

    There is no panel without a curve.
    """
    curves = []
    for label, look, frame, metric in series:
        style = METRICS[metric]
        rows = scheme.select_rows(frame[np.isfinite(frame["value"])])
        values = style.scale * rows[ENDS].to_numpy(dtype=np.float64).T
        points = [
            f"{value:.{style.digits}f} {style.unit} at {scheme.describe_level(level)}"
            for value, level in zip(values[0], rows["level"], strict=True)
        ]
        if points:
            ends = " to ".join(dict.fromkeys([points[0], points[-1]]))
            x = rows["level"].to_numpy(dtype=np.float64)
            curves.append(Curve(look, f"{label}: {ends}", x, values, label))
    if curves:
        if not label_room(curves):
            key |= {curve.label: curve.look for curve in curves}
        x_axis = Axis(scheme.label, scheme.log)
        chart = curves_chart(curves, x=x_axis, y=y, guides=guides, marked=marked)
        yield f"{scheme.title}, {scheme.rule_text}", chart
        if marked:
            key["paper (raw at the edge)"] = _PAPER_LOOK


def _raw_lines(series: Sequence[_Series]) -> list[Guide]:
    """Return a line across for each raw value."""
    return [
        Guide(part.look.colour, value)
        for part in series
        for value in part.values_at(RAW)
    ]


def _sweep(run: Results, rules: Sequence[Scheme], *, name: str) -> Figure:
    """Return the figure of a swept mechanism: a column a rule, a row an axis."""
    ours = run.ours[~is_attack(run.ours)]
    series = _sweep_series(ours)
    panels, key = list[tuple[str, Chart]](), dict[str, Look]()
    for label, metrics in _PANELS.items():
        drawn = [part for part in series if part.metric in metrics]
        published = _published_metrics(drawn) if run.dataset == DATASET else set()
        for scheme in rules:
            marked = [
                mark
                for metric in metrics
                if metric in published
                for mark in _paper_marks(metric, scheme)
            ]
            y, guides = Axis(label, label.endswith("(s)")), _raw_lines(drawn)
            panels += _panel(scheme, drawn, key, y=y, guides=guides, marked=marked)
    return Figure(
        name=name,
        section="figures",
        title=f"Missed conflicts, PLR and exposure over the level: {rules[0].title}",
        panels=panels,
        columns=len(rules),
        key=key,
        caption=_sweep_caption(rules[0], ours),
        note="Dashed: raw positions.",
    )


def _sweep_series(rows: pd.DataFrame) -> list[_Series]:
    """Return missed conflicts of each robot, then the descriptors as shared."""
    by_measure = rows.set_index(["consumer", "metric"], drop=False)
    by_measure = by_measure.sort_index(kind="stable")
    robots = rows.loc[rows["metric"] == MISSED_RATE, "consumer"].unique()
    looks = {
        (robot, MISSED_RATE): Look(place)
        for place, robot in enumerate(robots[: LOOKS - 2])
    }
    looks |= {(SHARED, metric): look for metric, look in _SHARED_LOOKS.items()}
    return [
        _Series(
            label=_sweep_label(consumer, metric),
            look=look,
            rows=by_measure[by_measure.index == (consumer, metric)],
            metric=metric,
        )
        for (consumer, metric), look in looks.items()
    ]


def _published_metrics(series: Sequence[_Series]) -> set[str]:
    """Return the metrics of some series for which the paper has numbers."""
    return {
        part.metric
        for part in series
        if part.metric != MISSED_RATE or part.label == robot_name(PREDICTOR)
    }


def _sweep_label(consumer: str, metric: str) -> str:
    """Return the name of a curve of a sweep."""
    return METRICS[metric].head if consumer == SHARED else robot_name(consumer)


def _sweep_caption(scheme: Scheme, rows: pd.DataFrame) -> str:
    """Tell missed conflicts of the first robot and PLR as shared at a sweep's ends."""
    known = rows[np.isfinite(rows["value"])]
    robot = next(iter(known.loc[known["metric"] == MISSED_RATE, "consumer"]), "")
    shown, parts = scheme.select_rows(known), list[str]()
    missed = shown[(shown["metric"] == MISSED_RATE) & (shown["consumer"] == robot)]
    if len(missed):
        ends = _ends(missed["value"])
        parts.append(f"{robot_subject(robot)} misses {ends} of conflicts")
    exposed = shown[(shown["metric"] == PLR) & (shown["consumer"] == SHARED)]
    if len(exposed):
        parts.append(f"PLR as shared is {_ends(exposed['value'])}")
    if not parts:
        return ""
    low, high = (scheme.describe_level(shown["level"].iloc[place]) for place in (0, -1))
    return f"From {low} to {high}, {'. '.join(parts)}."


def _ends(values: "pd.Series[float]") -> str:
    """Return the first and the last of some fractions, in percent."""
    return f"{whole_percent(values.iloc[0])} to {whole_percent(values.iloc[-1])}"


def _paper_marks(metric: str, scheme: Scheme) -> list[LonePoint]:
    """Return the paper's numbers; raw, without a level, is at the edge next to it."""
    if scheme.name not in _FILES or "linear" not in scheme.rules:
        return []
    edge, style, marks = np.inf if scheme.log else 0.0, METRICS[metric], []
    for mechanism, level, published_metric, share in PUBLISHED:
        if published_metric == metric and mechanism in (RAW, scheme.name):
            x, place = edge, "raw"
            if level is not None:
                x, place = level, scheme.describe_level(level)
            y = share * style.scale
            name = f"paper: {style.head} {y:.4g} {style.unit} at {place}"
            marks.append(LonePoint(_PAPER_LOOK, x, y, name))
    return marks


def _attacked(run: Results) -> Iterator[Figure]:
    """Yield PLR over the level, as shared and after each attack.

    An attack that only the oracle can run is hollow.
    """
    rows = after_attack(run.ours)
    rows = rows[rows["metric"] == PLR]
    chosen = [
        reader
        for reader in most_knowing(list_readers(rows))
        if reader.consumer != IDENTITY
    ]
    oracle = [reader for reader in chosen if reader.adversary == ORACLE]
    others = [reader for reader in chosen if reader.adversary and reader not in oracle]
    looks = {AS_SHARED: Look(LOOKS - 1)} if AS_SHARED in chosen else {}
    looks |= {reader: Look(place) for place, reader in enumerate(others[: LOOKS - 1])}
    looks |= {
        reader: Look(place, hollow=True)
        for place, reader in enumerate(oracle[: LOOKS - 1])
    }
    if not looks.keys() - {AS_SHARED}:
        return
    series = [
        _Series(_label(reader), look, reader_rows(rows, reader), PLR)
        for reader, look in looks.items()
    ]
    series = [part for part in series if len(part.rows)]
    guides = _raw_lines([part for part in series if part.label == "as shared"])
    panels, key = list[tuple[str, Chart]](), dict[str, Look]()
    for scheme in schemes(rows):
        panels += _panel(
            scheme, series, key, y=Axis("PLR, shared or attacked (%)"), guides=guides
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


def _label(reader: Address) -> str:
    """Return the name of positions: as shared, or the attack and the adversary."""
    if reader == AS_SHARED:
        return "as shared"
    return f"{attack_name(reader.consumer)} ({reader.adversary})"


def _rise(series: Sequence[_Series]) -> str:
    """Tell how many points of PLR the best attack adds to the shared positions.

    The oracle does not count.
    """
    shared = [part.rows for part in series if part.label == _label(AS_SHARED)]
    attacked = [
        part.rows
        for part in series
        if not part.look.hollow and part.label != "as shared"
    ]
    if not (shared and attacked):
        return ""
    keys = ["mechanism", "level"]
    best = pd.concat(attacked).groupby(keys, sort=False)["value"].max()
    as_shared = shared[0].groupby(keys, sort=False)["value"].max()
    rises = PERCENT * (best - as_shared).dropna()
    if rises.empty:
        return ""
    low, high = rises.min(), rises.max()
    if low > 0:
        change = f"raises PLR by {low:.0f} to {high:.0f}"
    else:
        change = f"changes PLR by {low:+.0f} to {high:+.0f}"
    return f"The strongest attack {change} points at the levels drawn."
