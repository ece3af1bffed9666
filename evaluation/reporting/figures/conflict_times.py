"""How soon the conflicts of the scenes come: the share with somebody inside by a time."""

from collections.abc import Iterator

import numpy as np

from evaluation.experiment.constants import horizon_of
from evaluation.reporting.charts import PERCENT, Axis, Curve, Look, curves_chart
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.rows import ENDS, Results

_LOOK, _NOW = Look(0), "k6"


def figures(run: Results) -> Iterator[Figure]:
    """Yield a panel for each horizon; a line across tells who is inside already."""
    if run.conflict_times.empty:
        return
    panels, label = [], "conflicts with somebody inside"
    for dataset, rows in run.conflict_times.groupby("dataset", sort=False):
        shares = PERCENT * rows[ENDS].to_numpy(dtype=np.float64).T
        by_s = rows["by_s"].to_numpy(dtype=np.float64)
        now = float(shares[0, 0])
        curve = Curve(_LOOK, f"{now:.0f} % are inside at step 0", by_s, shares)
        x, y = Axis("time from now (s)"), Axis("conflicts with somebody inside (%)")
        chart = curves_chart([curve], x=x, y=y, across=[(_NOW, now)])
        horizon_s = horizon_of(str(dataset).rpartition(":")[2])
        heading = "the run's own horizon" if horizon_s is None else f"{horizon_s:g} s ahead"
        panels.append((f"{heading}: {now:.0f} % now", chart))
    title = "How soon a conflict comes"
    said = "Dashed: inside the safety radius at step 0 already, so that nothing is foreseen."
    yield Figure("time_to_conflict", "plane", title, panels, 2, {label: _LOOK}, said)
