"""What privacy costs a robot: each descriptor as shared against missed conflicts."""

from collections.abc import Iterator
from itertools import product

import numpy as np
import pandas as pd

from evaluation.estimates.families import ADDING_RULES, RAW
from evaluation.estimates.keys import is_attack
from evaluation.estimates.metrics import DESCRIPTORS, EXPOSURE, METRICS, MISSED_RATE
from evaluation.plan.presets import SHARED
from evaluation.reporting import rows as picked
from evaluation.reporting.charts import (
    LOOKS,
    Axis,
    Curve,
    Look,
    curves_chart,
    label_room,
)
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.lookups import ENDS
from evaluation.reporting.names import robot_name, robot_subject


def figures(run: picked.Results) -> Iterator[Figure]:
    """Yield the privacy-utility planes of the first predictor: each rule, each descriptor."""
    ours = run.ours[~is_attack(run.ours) & np.isfinite(run.ours["value"])]
    predictor = next(iter(ours["consumer"][ours["metric"] == MISSED_RATE]), "")
    known = picked.schemes(ours, as_points=True)
    panels, key = [], dict[str, Look]()
    for metric, rule in product(DESCRIPTORS, ADDING_RULES):
        plane, shown = _plane(ours, predictor, metric), METRICS[metric]
        curves, marked = [], []
        for scheme in known:
            points = scheme.of(plane).sort_values("x", kind="stable")
            if rule in scheme.rules and len(points):
                x, values = points["x"].to_numpy(), points[ENDS].to_numpy().T
                name = (
                    f"{scheme.title}, noisiest at"
                    f" {scheme.at(points['level'].iloc[-1])}: "
                )
                name += (
                    f"{x[-1]:.1f} % missed, {shown.head}"
                    f" {values[0, -1]:.{shown.digits}f}"
                )
                look = Look(scheme.place % (LOOKS - 1))
                curves.append(Curve(look, name, x, values, scheme.title))
        raw = plane[plane["mechanism"] == RAW]
        for at, value in zip(raw["x"], raw["value"], strict=True):
            marked.append((Look(LOOKS - 1), at, value, f"raw: {at:.1f} % missed"))
        if curves:
            y = Axis(f"{shown.head}, shared ({shown.unit})", metric != EXPOSURE)
            chart = curves_chart(
                curves, x=Axis("missed conflicts (%)"), y=y, marked=marked
            )
            panels.append((f"{shown.head}, {rule} adding", chart))
            key |= {} if label_room(curves) else {one.label: one.look for one in curves}
            key |= {"raw positions": Look(LOOKS - 1)} if marked else {}
    yield Figure(
        name="operating_points",
        section="plane",
        title=f"Each descriptor as shared, over what {robot_name(predictor)} misses",
        panels=panels,
        columns=2,
        key=key,
        caption=_caption(_plane(ours, predictor, EXPOSURE), predictor),
        note="Down and to the left is better.",
    )


def _caption(plane: pd.DataFrame, predictor: str) -> str:
    """Return missed conflicts and PLR as shared of the level with the lowest PLR, and of raw."""
    if plane.empty:
        return ""
    lowest = plane.sort_values("value", kind="stable").iloc[0]
    text = (
        f"At the lowest PLR as shared, {lowest['value']:.0f} %, "
        f"{robot_subject(predictor)} misses {lowest['x']:.0f} % of conflicts"
    )
    raw = plane.loc[plane["mechanism"] == RAW, "x"]
    return f"{text}{f', {raw.iloc[0]:.0f} % with raw positions' if len(raw) else ''}."


def _plane(summary: pd.DataFrame, predictor: str, metric: str) -> pd.DataFrame:
    """Return missed-conflict rate x and descriptor of every level, in the units of the axes."""
    x = summary[(summary["consumer"] == predictor) & (summary["metric"] == MISSED_RATE)]
    y = summary[(summary["consumer"] == SHARED) & (summary["metric"] == metric)]
    keys = ["mechanism", "level"]
    x = x[keys].assign(x=x["value"] * METRICS[MISSED_RATE].scale)
    y = y[[*keys, *ENDS]]
    y = y.assign(**{end: y[end] * METRICS[metric].scale for end in ENDS})
    return x.merge(y, on=keys)
