"""The picture of the README: a simulated walk as it was, as shared, and as rebuilt."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from evaluation.estimates.families import RAW
from evaluation.reporting.amounts import whole_percent
from evaluation.reporting.markup import HTML
from evaluation.reporting.names import attack_name
from isac_track.types import Bools, Floats, lengths

PANEL: Final = (400.0, 300.0)  # Width and height of a panel, in px of a README.
_MARGIN: Final = 24.0
_BAR_M: Final = (1.0, 2.0, 5.0, 10.0)
_WIDEST_BAR: Final = 0.3  # Share of the width of a panel.


@dataclass(frozen=True, eq=False, slots=True)
class Walk:
    """A walk of L samples under a mechanism, turned to run from left to right."""

    mechanism: str  # SPEC with the level.
    attack: str
    epsilon_m: float
    true: Floats  # (L, 2) m
    shared: Floats  # (L, 2) m
    rebuilt: Floats  # (L, 2) m
    leaks_shared: Bools  # (L,) whether a shared position is within epsilon of the truth
    leaks_rebuilt: Bools  # (L,) the same of a rebuilt position


def longest_walk(gallery: pd.DataFrame) -> Walk | None:
    """Return the walk that gets furthest, under the first mechanism that adds noise.

    `gallery` is that of `gallery.parquet`; None if it has raw positions alone.
    """
    noisy = gallery[gallery["mechanism"] != RAW]
    if noisy.empty:
        return None
    rows = noisy[noisy["mechanism"] == noisy["mechanism"].iloc[0]]
    walks = [part for _, part in rows.groupby("track", sort=False)]
    return _walk(max(walks, key=_walk_distance))


def _walk_distance(rows: pd.DataFrame) -> float:
    """Return the distance between the first and the last true position, m."""
    true = rows[["x_true", "y_true"]].to_numpy(dtype=np.float64)
    return float(lengths(true[-1] - true[0]))


def _walk(rows: pd.DataFrame) -> Walk:
    """Return the walk of some rows, turned so that it ends on the positive x axis."""
    places = {
        name: rows[[f"x_{name}", f"y_{name}"]].to_numpy(dtype=np.float64)
        for name in ("true", "shared", "rec")
    }
    start = places["true"][0]
    x, y = (places["true"][-1] - start) / max(_walk_distance(rows), 1e-9)
    turn = np.array([[x, -y], [y, x]])
    return Walk(
        mechanism=str(rows["mechanism"].iloc[0]),
        attack=str(rows["attack"].iloc[0]),
        epsilon_m=float(rows["epsilon_m"].iloc[0]),
        true=(places["true"] - start) @ turn,
        shared=(places["shared"] - start) @ turn,
        rebuilt=(places["rec"] - start) @ turn,
        leaks_shared=rows["leaked_shared"].to_numpy(dtype=np.bool_),
        leaks_rebuilt=rows["leaked_rec"].to_numpy(dtype=np.bool_),
    )


def caption(walk: Walk, *, level_name: str) -> str:
    """Return the shares of the walk that are known as shared and as rebuilt."""
    sent = float(walk.leaks_shared.mean())
    rebuilt = float(walk.leaks_rebuilt.mean())
    return (
        f"{level_name}: {whole_percent(sent)} of the shared positions are within"
        f" {walk.epsilon_m:g} m of the walk; after a {attack_name(walk.attack)},"
        f" {whole_percent(rebuilt)} are."
    )


def draw_walk(walk: Walk, *, level_name: str) -> str:
    """Return the picture as SVG, readable at 830 px and in print."""
    corner, unit = _window(walk)

    def placed(points: Floats) -> Floats:
        places: Floats = (points - corner) * unit * [1.0, -1.0] + [0.0, PANEL[1]]
        return places

    bar_m = max(
        (m for m in _BAR_M if m * unit < _WIDEST_BAR * PANEL[0]), default=_BAR_M[0]
    )
    shared = placed(walk.shared)
    return HTML.get_template("one_walk.svg.j2").render(
        caption=caption(walk, level_name=level_name),
        attack=attack_name(walk.attack),
        width=PANEL[0],
        height=PANEL[1],
        walked=[placed(walk.true)],
        rebuilt=[placed(walk.rebuilt)],
        far=[*shared[~walk.leaks_shared, None]],
        near=[*shared[walk.leaks_shared, None]],
        epsilon_m=f"{walk.epsilon_m:g}",
        bar=bar_m * unit,
        bar_text=f"{bar_m:g} m",
    )


def _window(walk: Walk) -> tuple[Floats, float]:
    """Return the lower left corner in m, and px per metre; far samples stick out."""
    inner = np.percentile(walk.shared, [2.0, 98.0], axis=0)
    places = np.concatenate([walk.true, walk.rebuilt, inner])
    low, high = places.min(axis=0), places.max(axis=0)
    room = np.array(PANEL) - 2.0 * _MARGIN
    unit = float(np.min(room / np.maximum(high - low, 1.0)))
    corner: Floats = 0.5 * (low + high) - 0.5 * np.array(PANEL) / unit
    return corner, unit
