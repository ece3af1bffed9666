"""What privacy costs a robot: each descriptor as shared against missed conflicts."""

from collections.abc import Iterator
from itertools import product

import numpy as np
import pandas as pd

from evaluation.analysis.families import ADDING_RULES, RAW
from evaluation.analysis.keys import is_attack
from evaluation.analysis.metrics import DESCRIPTORS, EXPOSURE, METRICS, MISSED_RATE
from evaluation.experiment.presets import SHARED
from evaluation.reporting import rows as picked
from evaluation.reporting.charts import LOOKS, Axis, Curve, Look, curves_chart
from evaluation.reporting.figures.figure import Figure


def figures(run: picked.Results) -> Iterator[Figure]:
    """Yield the privacy-utility planes of the first predictor: each rule, each descriptor."""
    ours = run.ours[~is_attack(run.ours) & np.isfinite(run.ours["value"])]
    predictor = next(iter(ours["consumer"][ours["metric"] == MISSED_RATE]), "")
    known = picked.schemes(ours, as_points=True)
    panels, key = [], dict[str, Look]()
    for rule, metric in product(ADDING_RULES, DESCRIPTORS):
        plane, shown = _plane(ours, predictor, metric), METRICS[metric]
        curves, marked = [], []
        for scheme in known:
            points = scheme.of(plane).sort_values("x", kind="stable")
            if rule in scheme.rules and len(points):
                x, values = points["x"].to_numpy(), points[picked.ENDS].to_numpy().T
                name = f"{scheme.title}, noisiest at {scheme.at(points['level'].iloc[-1])}: "
                name += f"{x[-1]:.1f} % missed, {shown.head} {values[0, -1]:.{shown.digits}f}"
                key[scheme.title] = Look(scheme.place % (LOOKS - 1))
                curves.append(Curve(key[scheme.title], name, x, values))
        raw = plane[plane["mechanism"] == RAW]
        for at, value in zip(raw["x"], raw["value"], strict=True):
            marked.append((Look(LOOKS - 1), at, value, f"raw: {at:.1f} % missed"))
        if curves:
            y = Axis(f"{shown.head}, shared ({shown.unit})", metric != EXPOSURE)
            chart = curves_chart(curves, x=Axis("missed conflicts (%)"), y=y, marked=marked)
            panels.append((f"{rule} adding", chart))
            key |= {"raw": Look(LOOKS - 1)} if marked else {}
    title = f"Each descriptor as shared against missed conflicts, predictor {predictor}"
    said = "Down and to the left is better."
    yield Figure("operating_points", "plane", title, panels, len(DESCRIPTORS), key, said)


def _plane(summary: pd.DataFrame, predictor: str, metric: str) -> pd.DataFrame:
    """Return missed-conflict rate x and descriptor of every level, in the units of the axes."""
    x = summary[(summary["consumer"] == predictor) & (summary["metric"] == MISSED_RATE)]
    y = summary[(summary["consumer"] == SHARED) & (summary["metric"] == metric)]
    keys = ["mechanism", "level"]
    x = x[keys].assign(x=x["value"] * METRICS[MISSED_RATE].scale)
    y = y[[*keys, *picked.ENDS]]
    y = y.assign(**{end: y[end] * METRICS[metric].scale for end in picked.ENDS})
    return x.merge(y, on=keys)
