"""One metric over another as a picture of matplotlib, for a notebook."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib import pyplot as plt

from evaluation.estimates.families import RAW
from evaluation.reporting.charts import INKS, MARKERS, Look, mechanism_looks
from evaluation.reporting.lookups import ENDS
from isac_track.types import Floats

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from evaluation.estimates.families import Family

LEVEL_KEYS: Final = ["family", "level", "adding"]
"""Columns that say which level a row of a frame is about."""


def draw_metrics(
    x_rows: pd.DataFrame,
    y_rows: pd.DataFrame,
    *,
    families: Collection[Family],
    over_level: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """Draw one metric over another, with 95 % intervals, and return the axes.

    `x_rows` and `y_rows` are as of `Results.frame`, in the unit of the axis. With
    `over_level` the horizontal axis is logarithmic, and raw positions, which have no
    level, are a line. `ax` are the axes to draw on, else new axes.
    """
    points = x_rows.merge(y_rows, on=LEVEL_KEYS, suffixes=("_x", "_y"))
    if ax is None:
        ax = plt.subplots(figsize=(8.0, 4.5), layout="constrained")[1]
    if over_level:
        ax.set_xscale("log")
    mechanisms = {(family.name, family.adding): family.mechanism for family in families}
    looks = mechanism_looks(families)
    for (name, adding), rows in points.groupby(["family", "adding"], sort=False):
        ordered = rows.sort_values("level")
        mechanism = mechanisms[str(name), str(adding)]
        # Without a look of its own: clean.
        look = looks.get(mechanism, looks[RAW]._replace(hollow=True))
        ink = {"color": INKS[look.colour], "label": f"{name} {adding}".rstrip()}
        has_level = ordered["value_x"].to_numpy().any()
        if over_level and not has_level:
            _draw_line(ax, ordered, look, ink)
        else:
            _draw_points(ax, ordered, look, ink)
    ax.set(xlabel=x_rows.attrs["title"], ylabel=y_rows.attrs["title"])
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    return ax


def _draw_line(
    ax: Axes, rows: pd.DataFrame, look: Look, ink: Mapping[str, Any]
) -> None:
    """Draw a single value as a line across the axes, in the band of its interval."""
    values, ((below,), (above,)) = _error_bars(rows, "y")
    ax.axhline(values[0], linestyle="--" if look.hollow else ":", **ink)
    ax.axhspan(values[0] - below, values[0] + above, color=ink["color"], alpha=0.1)


def _draw_points(
    ax: Axes, rows: pd.DataFrame, look: Look, ink: Mapping[str, Any]
) -> None:
    """Draw the levels of a mechanism as a line of marks with their intervals."""
    (x, x_error), (y, y_error) = _error_bars(rows, "x"), _error_bars(rows, "y")
    shape: dict[str, Any] = {
        "marker": MARKERS[look.shape],
        "capsize": 2,
        "linewidth": 0.8,
        "markerfacecolor": "none" if look.hollow else ink["color"],
    }
    ax.errorbar(x, y, y_error, x_error, **shape, **ink)


def _error_bars(rows: pd.DataFrame, side: str) -> tuple[Floats, Floats]:
    """Return values, (R,), and lengths of the bars below and above them, (2, R)."""
    values, low, high = (rows[f"{name}_{side}"].to_numpy() for name in ENDS)
    return values, np.maximum([values - low, high - values], 0.0)
