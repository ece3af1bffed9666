"""A gallery of tracks: where four people walked, what was shared of it, and what was rebuilt."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from isac_track.types import Bools, Floats

SIZE: Final = (180.0, 135.0)  # Of a panel, in its own units.
_BAR_M: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


class Panel(NamedTuple):
    """One person under one mechanism."""

    person: int
    mechanism: str
    shared: float
    rebuilt: float  # Shares of samples that leak.
    paths: list[tuple[str, Sequence[Floats]]]  # Class and lines, (L, 2) each, of each layer.
    bar: tuple[float, str]  # How long a metre or a few are.


def panels(rows: pd.DataFrame) -> list[Panel]:
    """Return a panel for each person and mechanism of `gallery.parquet`, person by person."""
    found = []
    for person, of in rows.groupby("track", sort=False):
        low, unit = _window(of)
        length = max((one for one in _BAR_M if one * unit < 0.3 * SIZE[0]), default=_BAR_M[0])
        for mechanism, part in of.groupby("mechanism", sort=False):
            places = {
                what: (part[[f"x_{what}", f"y_{what}"]].to_numpy() - low) * unit * [1.0, -1.0]
                + [0.0, SIZE[1]]
                for what in ("true", "shared", "rec")
            }
            leaked, kept = (part[f"leaked_{what}"].to_numpy() for what in ("shared", "rec"))
            found.append(
                Panel(
                    int(str(person)) + 1,
                    str(mechanism),
                    float(leaked.mean()),
                    float(kept.mean()),
                    [
                        ("shared", [*places["shared"][~leaked, None]]),
                        ("rebuilt leak", _runs(places["rec"], kept)),
                        ("rebuilt", [places["rec"]]),
                        ("shared leak", [*places["shared"][leaked, None]]),
                        ("true", [places["true"]]),
                    ],
                    (length * unit, f"{length:g} m"),
                )
            )
    return found


def _window(of: pd.DataFrame) -> tuple[Floats, float]:
    """Return the lower left corner in m, and units of a panel in a metre.

    The panel holds the walk and most of what was shared: a few far samples would make it tiny.
    """
    ends = [np.percentile(of[["x_shared", "y_shared"]].to_numpy(), [5.0, 95.0], axis=0)]
    for what in ("true", "rec"):
        walk = of[[f"x_{what}", f"y_{what}"]].to_numpy()
        ends.append(np.stack([walk.min(axis=0), walk.max(axis=0)]))
    low, high = np.min(ends, axis=0)[0] - 0.2, np.max(ends, axis=0)[1] + 0.2
    unit = float(np.min(np.array(SIZE) / np.maximum(high - low, 1.0)))
    corner: Floats = 0.5 * (low + high) - 0.5 * np.array(SIZE) / unit
    return corner, unit


def _runs(places: Floats, drawn: Bools) -> list[Floats]:
    """Return the lines through some of the points, with gaps where others are."""
    edges = np.flatnonzero(np.diff(drawn)) + 1
    runs = zip(np.split(places, edges), np.split(drawn, edges), strict=True)
    return [run for run, on in runs if on[0]]
