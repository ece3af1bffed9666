"""What is left at a price: attacked PLR of every family where missed conflicts rise by a target."""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from evaluation.analysis.frontier import VALUE, WHITE, usual_price
from evaluation.analysis.keys import AS_SHARED, Source, rows_of
from evaluation.analysis.metrics import EXPOSURE
from evaluation.analysis.strongest import HEADLINE
from evaluation.reporting.answer_tables import price_text
from evaluation.reporting.charts import LOOKS, PERCENT, Axis, Curve, Look, Mark, curves_chart
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.rows import Results, family_of

_LEAST_POINTS = 2
_MOST = LOOKS - 1  # Families of a panel beside white noise.


def figures(run: Results) -> Iterator[Figure]:
    """Yield attacked PLR over the rise of misses, six families a panel beside white noise."""
    of = run.frontier
    if of.empty:
        return
    of = usual_price(of[of["metric"] == EXPOSURE])
    of = of[(of["consumer"] != AS_SHARED.consumer) & of["value"].notna()]
    panels, key = [], dict[str, Look]()
    counts = of.groupby(["mechanism", "robot"], sort=False)["target"].nunique()
    lines = counts[counts >= _LEAST_POINTS].index.get_level_values("mechanism")
    names = [str(name) for name in dict.fromkeys(lines) if name != WHITE]
    for robot, known in of.groupby("robot", sort=False):
        rows = {str(name): part for name, part in known.groupby("mechanism", sort=False)}
        for start in range(0, max(len(names), 1), _MOST):
            which = f", {start // _MOST + 1}" if len(names) > _MOST else ""
            curves, marked = list[Curve](), list[Mark]()
            # A mechanism looks alike for every robot.
            for place, name in enumerate([WHITE, *names[start : start + _MOST]]):
                if name in rows:
                    family = family_of(run.families, name)
                    rule = " ind." * (family.adding == "independent")
                    title = "white" if name == WHITE else f"{family.name}{rule}{which}"
                    key[title] = Look(place)
                    curve, marks = _drawn(rows[name], title, Look(place))
                    curves.append(curve)
                    marked += marks
            if curves:
                x, y = Axis("rise of missed conflicts (points)"), Axis("PLR, attacked (%)")
                panels.append((f"{robot}{which}", curves_chart(curves, x=x, y=y, marked=marked)))
    title = "PLR after attack where misses have risen"
    said = f"{price_text(of)} Hollow: after repeats, an anchor, companions. Down is better."
    yield Figure("frontier", "plane", title, panels, 2, key, said)


def _drawn(rows: pd.DataFrame, title: str, look: Look) -> tuple[Curve, list[Mark]]:
    """Return the line of a family, and a hollow mark for what an adversary gets beyond it."""
    is_usual, marks = rows["knowledge"].isin(HEADLINE), list[Mark]()
    of = rows[is_usual]
    ends = of[list(VALUE)].to_numpy(dtype=np.float64).T * PERCENT
    x = of["target"].to_numpy(dtype=np.float64) * PERCENT
    told = ", ".join(f"{y:.0f} % at +{at:g}" for at, y in zip(x, ends[0], strict=True))
    for one in rows_of(rows[~is_usual]):
        at, value = PERCENT * one["target"], PERCENT * one["value"]
        who = f"{title}, after {Source(one['consumer'], one['knowledge']).label}"
        marks.append((look._replace(hollow=True), at, value, f"{who}: {value:.0f} %"))
    return Curve(look, f"{title}: {told}", x, ends), marks
