"""A gallery of tracks: where four people walked, what was shared of it, and what was rebuilt."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.reporting.figures import drawing
from evaluation.reporting.figures.drawing import PERCENT, Drawing, Look

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evaluation.reporting.rows import Results
    from isac_track.types import Floats

_SHARED_COLOUR, _REBUILT_COLOUR = "#D55E00", "#0072B2"
_BAR_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


def drawings(run: Results) -> list[Drawing]:
    """Return the gallery, if the run has one."""
    if run.gallery is None:
        return []
    title = "Tracks: true, shared and rebuilt"
    caption = "The people of the run's first scene, not chosen by how they look."
    draw, words = partial(_gallery_figure, rows=run.gallery), partial(_words, rows=run.gallery)
    return [Drawing("track_gallery", "gallery", title, draw, words, caption)]


def _gallery_figure(_: Results, *, rows: pd.DataFrame) -> Figure | None:
    """Return a panel for each person and mechanism: dots and thick stretches leak."""
    if rows.empty:
        return None
    people, mechanisms = (list(rows[name].unique()) for name in ("track", "mechanism"))
    figure, panels = drawing.panels(
        *(len(people), len(mechanisms)),
        height_in=1.75 * len(people) + 0.85,
        margins_in=(0.3, 0.1, 0.6, 0.4, 0.12, 0.2),
    )
    width, height = panels[0, 0].get_position().size * figure.get_size_inches()
    for person, in_row in zip(people, panels, strict=True):
        of = rows[rows["track"] == person]
        corners = _window(of, shape=width / height)
        in_row[0].set_ylabel(f"person {person + 1}")
        for mechanism, ax in zip(mechanisms, in_row, strict=True):
            _draw(ax, of[of["mechanism"] == mechanism], corners)
    for mechanism, ax in zip(mechanisms, panels[0], strict=True):
        ax.set_title(mechanism, fontweight="bold", pad=14)
    black, blue = Look("black", "", "-"), Look(_REBUILT_COLOUR, "", "-")
    dot = Look(_SHARED_COLOUR, "o", "")
    handles = [
        drawing.handle("true", black, linewidth=0.8),
        drawing.handle("shared", dot, markersize=1.1, alpha=0.6),
        drawing.handle("shared, leaks", dot, markersize=2.4),
        drawing.handle("rebuilt", blue, linewidth=0.7),
        drawing.handle("rebuilt, leaks", blue, linewidth=3.2, alpha=0.35),
    ]
    first = rows.iloc[0]
    leak = f"a leak is closer than {first['epsilon_m']:g} m"
    what = f"true, shared, rebuilt by {first['attack']} (blind); {leak}"
    return drawing.finish(figure, handles, dataset="tracks", what=what, columns=5)


def _words(_: Results, *, rows: pd.DataFrame) -> str:
    shares = rows.groupby("mechanism", sort=False)[["leaked_shared", "leaked_rec"]].mean()
    said = [
        f"{mechanism}: {PERCENT * share['leaked_shared']:.0f} % of the shared samples leak, "
        f"{PERCENT * share['leaked_rec']:.0f} % of the rebuilt ones"
        for mechanism, share in shares.iterrows()
    ]
    return (
        f"Walks of {rows['track'].nunique()} people, seen from above, under each mechanism; the "
        f"rebuilt line follows the true one. {'; '.join(said)}."
    )


def _window(of: pd.DataFrame, *, shape: float) -> Floats:
    """Return limits, (2, 2) m: they hold a walk and most of what was shared, equal in scale."""
    # A few far samples would make the walk tiny.
    ends = [np.percentile(of[["x_shared", "y_shared"]].to_numpy(), [5.0, 95.0], axis=0)]
    for what in ("true", "rec"):
        walk = of[[f"x_{what}", f"y_{what}"]].to_numpy()
        ends.append(np.stack([walk.min(axis=0), walk.max(axis=0)]))
    low, high = np.min(ends, axis=0)[0], np.max(ends, axis=0)[1]
    middle, half = 0.5 * (low + high), 0.5 * (high - low) + 0.2
    half_x = max(half[0], half[1] * shape, 0.5)
    half = np.array([half_x, half_x / shape])
    limits: Floats = np.stack([middle - half, middle + half], axis=1)
    return limits


def _draw(ax: Axes, part: pd.DataFrame, corners: Floats) -> None:
    """Draw a walk, and how long a metre is."""
    x, y, leaked = (part[f"{name}_shared"].to_numpy() for name in ("x", "y", "leaked"))
    look: dict[str, Any] = {"color": _SHARED_COLOUR, "linestyle": "", "markeredgewidth": 0}
    ax.plot(x[~leaked], y[~leaked], "o", markersize=1.1, alpha=0.45, zorder=1, **look)
    ax.plot(x[leaked], y[leaked], "o", markersize=1.9, zorder=3, **look)
    x, y, leaked = (part[f"{name}_rec"].to_numpy() for name in ("x", "y", "leaked"))
    ax.plot(x, y, color=_REBUILT_COLOUR, linewidth=0.7, zorder=2)
    look = {"color": _REBUILT_COLOUR, "linewidth": 3.2, "alpha": 0.35, "solid_capstyle": "round"}
    ax.plot(*(np.where(leaked, values, np.nan) for values in (x, y)), **look, zorder=1.5)
    ax.plot(part["x_true"], part["y_true"], color="black", linewidth=0.8, zorder=4)
    shares = [PERCENT * part[name].mean() for name in ("leaked_shared", "leaked_rec")]
    said = f"leaks: shared {shares[0]:.0f} %, rebuilt {shares[1]:.0f} %"
    ax.text(0.0, 1.02, said, transform=ax.transAxes, verticalalignment="bottom")
    ax.grid(visible=False)
    ax.spines[:].set(visible=True, color="#dddddd")
    ax.set(xticks=[], yticks=[], xlim=corners[0], ylim=corners[1])
    (left, bottom), (span_m, height_m) = corners[:, 0], np.ptp(corners, axis=1)
    length = max((one for one in _BAR_M if one < 0.3 * span_m), default=_BAR_M[0])
    x, y = left + 0.03 * span_m, bottom + 0.06 * height_m
    ax.plot([x, x + length], [y, y], color="#777777", linewidth=1.2, zorder=6)
    ax.text(x + length, y, f" {length:g} m", verticalalignment="center", color="#777777", zorder=6)
