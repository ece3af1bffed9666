"""A gallery of tracks: where four people walked, what was shared of it, and what was rebuilt."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.reporting.figures import style as figure_style
from evaluation.reporting.figures.drawing import Drawing

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from evaluation.reporting.run_results import Results

_PERCENT = 100.0
_SHARED_COLOUR, _REBUILT_COLOUR = "#D55E00", "#0072B2"
_BAR_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


def drawings(run: Results) -> list[Drawing]:
    """Return the gallery, if the run has one."""
    if run.gallery is None:
        return []
    return [
        Drawing(
            name="track_gallery",
            section="gallery",
            title="Tracks: true, shared and rebuilt",
            caption="The people of the run's first scene, not chosen by how they look.",
            draw=partial(gallery_figure, run.gallery),
            words=partial(_words, run.gallery),
        )
    ]


def gallery_figure(rows: pd.DataFrame) -> Figure | None:
    """Return a panel for each person and mechanism; None without rows.

    Shared samples that leak are dots, stretches of the reconstruction that leak are thick.
    """
    if rows.empty:
        return None
    people = list(rows["track"].unique())
    mechanisms = list(rows["mechanism"].unique())
    figure = figure_style.placed_figure(
        width_in=figure_style.DOUBLE_COLUMN_IN, height_in=1.75 * len(people) + 0.85
    )
    panels = figure_style.placed(
        figure, rows=len(people), columns=len(mechanisms), left_in=0.3, right_in=0.1, top_in=0.6,
        bottom_in=0.4, gap_in=0.12, between_in=0.2,
    )  # fmt: skip
    width, height = panels[0, 0].get_position().size * figure.get_size_inches()
    for person, in_row in zip(people, panels, strict=True):
        of = rows[rows["track"] == person]
        corners = _window(of, shape=width / height)
        in_row[0].set_ylabel(f"person {person + 1}")
        for mechanism, ax in zip(mechanisms, in_row, strict=True):
            part = of[of["mechanism"] == mechanism]
            _draw(ax, part)
            ax.set_xlim(*corners[0])
            ax.set_ylim(*corners[1])
            _scale_bar(ax, span_m=corners[0][1] - corners[0][0])
    for mechanism, ax in zip(mechanisms, panels[0], strict=True):
        ax.set_title(mechanism, fontweight="bold", pad=14)
    figure_style.legend_in_rows(figure, _handles(), columns=5)
    first = rows.iloc[0]
    figure_style.title(
        figure,
        dataset="tracks",
        what=f"true, shared, rebuilt by {first['attack']} (blind); a leak is closer than "
        f"{first['epsilon_m']:g} m",
        one_line=True,
    )
    return figure


def _words(rows: pd.DataFrame) -> str:
    shares = rows.groupby("mechanism", sort=False)[["leaked_shared", "leaked_rec"]].mean()
    said = [
        f"{mechanism}: {_PERCENT * share['leaked_shared']:.0f} % of the shared samples leak, "
        f"{_PERCENT * share['leaked_rec']:.0f} % of the rebuilt ones"
        for mechanism, share in shares.iterrows()
    ]
    return (
        f"Walks of {rows['track'].nunique()} people, seen from above, under each mechanism; the "
        f"rebuilt line follows the true one. {'; '.join(said)}."
    )


def _window(of: pd.DataFrame, *, shape: float) -> list[tuple[float, float]]:
    """Return the limits in m that hold a walk and most of what was shared, equal in scale."""
    shared = of[["x_shared", "y_shared"]].to_numpy()
    # A few far samples would make the walk tiny.
    low, high = np.percentile(shared, [5.0, 95.0], axis=0)
    for what in ("true", "rec"):
        walk = of[[f"x_{what}", f"y_{what}"]].to_numpy()
        low, high = np.minimum(low, walk.min(axis=0)), np.maximum(high, walk.max(axis=0))
    middle, half = 0.5 * (low + high), 0.5 * (high - low) + 0.2
    half_x = max(half[0], half[1] * shape, 0.5)
    half_y = half_x / shape
    return [
        (float(middle[0] - half_x), float(middle[0] + half_x)),
        (float(middle[1] - half_y), float(middle[1] + half_y)),
    ]


def _draw(ax: Axes, part: pd.DataFrame) -> None:
    x, y = part["x_shared"].to_numpy(), part["y_shared"].to_numpy()
    leaked = part["leaked_shared"].to_numpy()
    look: dict[str, Any] = {"color": _SHARED_COLOUR, "linestyle": "", "markeredgewidth": 0}
    ax.plot(x[~leaked], y[~leaked], "o", markersize=1.1, alpha=0.45, zorder=1, **look)
    ax.plot(x[leaked], y[leaked], "o", markersize=1.9, zorder=3, **look)
    x, y = part["x_rec"].to_numpy(), part["y_rec"].to_numpy()
    leaked = part["leaked_rec"].to_numpy()
    ax.plot(x, y, color=_REBUILT_COLOUR, linewidth=0.7, zorder=2)
    ax.plot(
        *(np.where(leaked, values, np.nan) for values in (x, y)),
        color=_REBUILT_COLOUR,
        linewidth=3.2,
        alpha=0.35,
        solid_capstyle="round",
        zorder=1.5,
    )
    ax.plot(part["x_true"], part["y_true"], color="black", linewidth=0.8, zorder=4)
    shares = [_PERCENT * part[name].mean() for name in ("leaked_shared", "leaked_rec")]
    ax.text(
        0.0,
        1.02,
        f"leaks: shared {shares[0]:.0f} %, rebuilt {shares[1]:.0f} %",
        transform=ax.transAxes,
        verticalalignment="bottom",
    )
    ax.grid(visible=False)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.spines[:].set(visible=True, color="#dddddd")


def _scale_bar(ax: Axes, *, span_m: float) -> None:
    length = max((one for one in _BAR_M if one < 0.3 * span_m), default=_BAR_M[0])
    left, bottom = ax.get_xlim()[0], ax.get_ylim()[0]
    x, y = left + 0.03 * span_m, bottom + 0.06 * (ax.get_ylim()[1] - bottom)
    ax.plot([x, x + length], [y, y], color="#777777", linewidth=1.2, zorder=6)
    ax.text(x + length, y, f" {length:g} m", verticalalignment="center", color="#777777", zorder=6)


def _handles() -> list[Any]:
    from matplotlib.lines import Line2D  # noqa: PLC0415 - computing rows needs no figure

    blue = _REBUILT_COLOUR
    dots: dict[str, Any] = {"color": _SHARED_COLOUR, "marker": "o", "linestyle": ""}
    return [
        Line2D([], [], color="black", linewidth=0.8, label="true"),
        Line2D([], [], markersize=1.1, alpha=0.6, label="shared", **dots),
        Line2D([], [], markersize=2.4, label="shared, leaks", **dots),
        Line2D([], [], color=blue, linewidth=0.7, label="rebuilt"),
        Line2D([], [], color=blue, linewidth=3.2, alpha=0.35, label="rebuilt, leaks"),
    ]
