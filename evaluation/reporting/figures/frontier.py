"""PLR after attack at a price: families at equal rises of missed conflicts."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import pandas as pd

from evaluation.estimates.frontier import VALUE, WHITE_NOISE, usual_price
from evaluation.estimates.keys import row_dicts
from evaluation.estimates.metrics import PLR
from evaluation.estimates.strongest import HEADLINE
from evaluation.plan.address import AS_SHARED, parse_consumer
from evaluation.plan.presets import BASELINE
from evaluation.reporting.amounts import PERCENT, whole_percent
from evaluation.reporting.answer_tables import price_text
from evaluation.reporting.charts import (
    LOOKS,
    Axis,
    Chart,
    Curve,
    LonePoint,
    Look,
    curves_chart,
    label_room,
)
from evaluation.reporting.figures.figure import Figure
from evaluation.reporting.lookups import find_family
from evaluation.reporting.names import (
    INDEPENDENT_NOTE,
    family_name,
    robot_name,
    robot_subject,
    short_family_name,
)
from evaluation.reporting.rows import Results

_LEAST_POINTS: Final = 2
_CAPTION_RISE: Final = 0.05  # Rise of missed conflicts in the caption.
_MOST: Final = LOOKS - 1  # Families of a panel beside white noise.


def figures(run: Results) -> Iterator[Figure]:
    """Yield attacked PLR over the rise of misses: a panel a robot and six families."""
    if run.frontier.empty:
        return
    rows = usual_price(run.frontier[run.frontier["metric"] == PLR])
    rows = rows[(rows["consumer"] != AS_SHARED.consumer) & rows["value"].notna()]
    robots = [robot for robot in dict.fromkeys(rows["robot"]) if robot != BASELINE]
    rows = rows[rows["robot"].isin(robots or [BASELINE])]
    names = _mechanisms(rows)
    panels, key = list[tuple[str, Chart]](), dict[str, Look]()
    for robot, known in rows.groupby("robot", sort=False):
        for start in range(0, max(len(names), 1), _MOST):
            part = f", {start // _MOST + 1}" if len(names) > _MOST else ""
            # A mechanism looks the same for every robot.
            shown = [WHITE_NOISE, *names[start : start + _MOST]]
            chart = _panel(run, known, shown, key)
            if chart:
                panels.append((f"robot: {robot_name(str(robot))}{part}", chart))
    yield Figure(
        name="frontier",
        section="plane",
        title="PLR after attack at equal cost for the robot",
        panels=panels,
        columns=2,
        key=key,
        caption=_caption(run, rows),
        note=(
            f"{price_text(rows)} Lower is better. Hollow: an adversary that knows more."
            f" {INDEPENDENT_NOTE}"
        ),
    )


def _mechanisms(rows: pd.DataFrame) -> list[str]:
    """Return the mechanisms with enough points for a line, without white noise."""
    counts = rows.groupby(["mechanism", "robot"], sort=False)["target"].nunique()
    lines = counts[counts >= _LEAST_POINTS].index.get_level_values("mechanism")
    return [str(name) for name in dict.fromkeys(lines) if name != WHITE_NOISE]


def _panel(
    run: Results, rows: pd.DataFrame, names: Sequence[str], key: dict[str, Look]
) -> Chart | None:
    """Return the chart of some mechanisms; None without any.

    `key` gets the curves for which there is no room to label them.
    """
    parts = {str(name): part for name, part in rows.groupby("mechanism", sort=False)}
    curves, marked = list[Curve](), list[LonePoint]()
    for place, name in enumerate(names):
        if name in parts:
            title = "white"
            if name != WHITE_NOISE:
                title = short_family_name(find_family(run.families, name))
            curve, marks = _drawn(parts[name], title, Look(place))
            curves.append(curve)
            marked += marks
    if not curves:
        return None
    if not label_room(curves):
        key |= {curve.label: curve.look for curve in curves}
    x, y = Axis("rise of missed conflicts (points)"), Axis("PLR after attack (%)")
    return curves_chart(curves, x=x, y=y, marked=marked)


def _caption(run: Results, rows: pd.DataFrame) -> str:
    """Return the mechanism with the lowest PLR where a robot misses 5 points more."""
    usual = rows[
        rows["knowledge"].isin(HEADLINE) & np.isclose(rows["target"], _CAPTION_RISE)
    ]
    usual = usual[usual["robot"] == usual["robot"].iloc[0]] if len(usual) else usual
    if usual.empty:
        return ""
    best = usual.sort_values("value", kind="stable").iloc[0]
    name = family_name(find_family(run.families, str(best["mechanism"])))
    text = (
        f"If {robot_subject(str(best['robot']))} may miss {PERCENT * _CAPTION_RISE:g}"
        f" points more, {name} has the lowest PLR after attack:"
        f" {whole_percent(best['value'])}"
    )
    white = usual.loc[usual["mechanism"] == WHITE_NOISE, "value"]
    beside = f"; white noise {whole_percent(white.iloc[0])}" if len(white) else ""
    return f"{text}{beside}."


def _drawn(rows: pd.DataFrame, title: str, look: Look) -> tuple[Curve, list[LonePoint]]:
    """Return the line of a family, and a hollow mark for each adversary beyond it."""
    is_usual, marks = rows["knowledge"].isin(HEADLINE), list[LonePoint]()
    usual = rows[is_usual]
    values = usual[list(VALUE)].to_numpy(dtype=np.float64).T * PERCENT
    x = usual["target"].to_numpy(dtype=np.float64) * PERCENT
    points = ", ".join(
        f"{value:.0f} % at +{rise:g}" for rise, value in zip(x, values[0], strict=True)
    )
    for row in row_dicts(rows[~is_usual]):
        rise, value = PERCENT * row["target"], PERCENT * row["value"]
        attack = parse_consumer(row["consumer"], row["knowledge"]).label
        name = f"{title}, after {attack}: {value:.0f} %"
        marks.append(LonePoint(look._replace(hollow=True), rise, value, name))
    return Curve(look, f"{title}: {points}", x, values, title), marks
