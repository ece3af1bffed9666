"""Times of conflicts: the share of conflicts with somebody inside by a time."""

from collections.abc import Iterator

import numpy as np

from evaluation.plan.address import parse_dataset
from evaluation.reporting.amounts import PERCENT
from evaluation.reporting.charts import (
    GUIDE_COLOUR,
    Axis,
    Chart,
    Curve,
    Guide,
    Look,
    curves_chart,
)
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.lookups import ENDS
from evaluation.reporting.rows import Results

_LOOK = Look(0)


def figures(run: Results) -> Iterator[Figure]:
    """Yield a panel for each horizon; a line across is the share inside already."""
    if run.conflict_times.empty:
        return
    panels, shares_now = list[tuple[str, Chart]](), list[float]()
    for dataset, rows in run.conflict_times.groupby("dataset", sort=False):
        shares = PERCENT * rows[ENDS].to_numpy(dtype=np.float64).T
        by_s = rows["by_s"].to_numpy(dtype=np.float64)
        now = float(shares[0, 0])
        curve = Curve(_LOOK, f"{now:.0f} % are inside at step 0", by_s, shares)
        x, y = Axis("time from now (s)"), Axis("conflicts that have begun (%)")
        chart = curves_chart([curve], x=x, y=y, guides=[Guide(GUIDE_COLOUR, now)])
        horizon_s = parse_dataset(str(dataset)).world.horizon_s
        heading = (
            "the run's own horizon" if horizon_s is None else f"{horizon_s:g} s ahead"
        )
        panels.append((f"{heading}: {now:.0f} % now", chart))
        shares_now.append(now)
    yield Figure(
        name="time_to_conflict",
        section="plane",
        title="How soon a conflict comes",
        panels=panels,
        columns=2,
        key={},
        caption=(
            f"Of the conflicts at the run's own horizon, {shares_now[0]:.0f} % have"
            " begun now."
        ),
        note=(
            "Dashed: somebody is inside the safety radius already, so no robot can"
            " foresee it."
        ),
    )
