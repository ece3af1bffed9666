"""The price of privacy: each descriptor as shared against missed conflicts."""

from collections.abc import Iterator
from itertools import product

import numpy as np
import pandas as pd

from evaluation.estimates.families import ADDING_RULES, RAW
from evaluation.estimates.keys import is_attack
from evaluation.estimates.metrics import DESCRIPTORS, METRICS, MISSED_RATE, PLR
from evaluation.plan.presets import SHARED
from evaluation.reporting.charts import (
    LOOKS,
    Axis,
    Curve,
    LonePoint,
    Look,
    curves_chart,
    label_room,
)
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.lookups import ENDS
from evaluation.reporting.names import robot_name, robot_subject
from evaluation.reporting.rows import Results
from evaluation.reporting.schemes import Scheme, schemes


def figures(run: Results) -> Iterator[Figure]:
    """Yield the planes of the first predictor: a panel a descriptor and adding rule."""
    ours = run.ours[~is_attack(run.ours) & np.isfinite(run.ours["value"])]
    predictor = next(iter(ours["consumer"][ours["metric"] == MISSED_RATE]), "")
    known = schemes(ours, as_points=True)
    panels, key = [], dict[str, Look]()
    for metric, rule in product(DESCRIPTORS, ADDING_RULES):
        plane, style = _plane(ours, predictor, metric), METRICS[metric]
        curves = [
            _curve(scheme, points, metric)
            for scheme in known
            if rule in scheme.rules and len(points := scheme.select_rows(plane))
        ]
        raw = plane[plane["mechanism"] == RAW]
        marked = [
            LonePoint(Look(LOOKS - 1), x, value, f"raw: {x:.1f} % missed")
            for x, value in zip(raw["x"], raw["value"], strict=True)
        ]
        if curves:
            y = Axis(f"{style.head}, shared ({style.unit})", metric != PLR)
            chart = curves_chart(
                curves, x=Axis("missed conflicts (%)"), y=y, marked=marked
            )
            panels.append((f"{style.head}, {rule} adding", chart))
            if not label_room(curves):
                key |= {curve.label: curve.look for curve in curves}
            if marked:
                key["raw positions"] = Look(LOOKS - 1)
    yield Figure(
        name="operating_points",
        section="plane",
        title=f"Each descriptor as shared, over what {robot_name(predictor)} misses",
        panels=panels,
        columns=2,
        key=key,
        caption=_caption(_plane(ours, predictor, PLR), predictor),
        note="Down and to the left is better.",
    )


def _curve(scheme: Scheme, points: pd.DataFrame, metric: str) -> Curve:
    """Return the curve of a mechanism; its name tells the noisiest level."""
    style = METRICS[metric]
    points = points.sort_values("x", kind="stable")
    x, values = points["x"].to_numpy(), points[ENDS].to_numpy().T
    level = scheme.describe_level(points["level"].iloc[-1])
    name = (
        f"{scheme.title}, noisiest at {level}: {x[-1]:.1f} % missed,"
        f" {style.head} {values[0, -1]:.{style.digits}f}"
    )
    look = Look(scheme.place % (LOOKS - 1))
    return Curve(look, name, x, values, scheme.title)


def _caption(plane: pd.DataFrame, predictor: str) -> str:
    """Tell missed conflicts and PLR of the level with the lowest PLR as shared."""
    if plane.empty:
        return ""
    lowest = plane.sort_values("value", kind="stable").iloc[0]
    text = (
        f"At the lowest PLR as shared, {lowest['value']:.0f} %, "
        f"{robot_subject(predictor)} misses {lowest['x']:.0f} % of conflicts"
    )
    raw = plane.loc[plane["mechanism"] == RAW, "x"]
    beside = f", {raw.iloc[0]:.0f} % with raw positions" if len(raw) else ""
    return f"{text}{beside}."


def _plane(summary: pd.DataFrame, predictor: str, metric: str) -> pd.DataFrame:
    """Return missed conflicts x and descriptor of every level, in units of the axes."""
    x = summary[(summary["consumer"] == predictor) & (summary["metric"] == MISSED_RATE)]
    y = summary[(summary["consumer"] == SHARED) & (summary["metric"] == metric)]
    keys = ["mechanism", "level"]
    x = x[keys].assign(x=x["value"] * METRICS[MISSED_RATE].scale)
    y = y[[*keys, *ENDS]]
    y = y.assign(**{end: y[end] * METRICS[metric].scale for end in ENDS})
    return x.merge(y, on=keys)
