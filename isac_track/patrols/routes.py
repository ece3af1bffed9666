"""Routes of robots: random waypoints in the walked area, joined by straight legs."""

from typing import Final

import numpy as np
from numpy.random import Generator

from isac_track.types import Floats, lengths, squared_lengths

CELL_M: Final = 1.0  # Side of the cells of which the walked area is made.


def walked_cells(xy: Floats, *, cell_m: float = CELL_M) -> Floats:
    """Return the lower left corners of the cells in which anybody stood, (C, 2) m.

    `xy`, (M, 2) m, are positions of people. The cells come in a fixed order.
    """
    return np.unique(np.floor(xy / cell_m), axis=0) * cell_m


def draw_waypoints(
    cells: Floats, *, length_m: float, rng: Generator, cell_m: float = CELL_M
) -> Floats:
    """Draw the waypoints of a route that is at least `length_m` long, (W, 2) m.

    Each is uniform in the walked area. They are drawn in turn, so that a longer route
    begins with the waypoints of a shorter route. A leg may leave the area.
    """
    waypoints, walked_m = [_draw_place(cells, rng, cell_m)], 0.0
    while walked_m <= length_m:
        waypoints.append(_draw_place(cells, rng, cell_m))
        walked_m += float(lengths(waypoints[-1] - waypoints[-2]))
    return np.array(waypoints)


def _draw_place(cells: Floats, rng: Generator, cell_m: float) -> Floats:
    corner = cells[rng.integers(len(cells))]
    return np.asarray(corner + cell_m * rng.random(2))


def places_along(waypoints: Floats, distance_m: Floats) -> Floats:
    """Return places along a route, (K,) m -> (K, 2) m; its end for longer distances."""
    legs_m = np.sqrt(squared_lengths(np.diff(waypoints, axis=0)))
    milestones_m = np.concatenate([[0.0], np.cumsum(legs_m)])
    axes = [
        np.interp(distance_m, milestones_m, waypoints[:, axis]) for axis in range(2)
    ]
    return np.stack(axes, axis=1)
