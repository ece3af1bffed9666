"""The adversary without a log, who guesses from a map of where other people stand.

The map shows where people are most often, without identities. The best single guess
from it is the place around which others spend most time.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from isac_track.patrols.intervals import cluster_numbers
from isac_track.types import Floats, Ints

_CELLS_PER_RADIUS: Final = 4  # Cells of the map within epsilon.
_MOST_CELLS: Final = 5e7  # Of a map that is held whole: 400 MB.


def map_guesses(
    xy: Floats, offsets: Ints, *, group: Sequence[str], epsilon_m: float
) -> Floats:
    """Return the guess from the map of all other people for each of N people, (N, 2) m.

    It is the centre of the cell within `epsilon_m` of which others spend the largest
    share of their time; all people weigh the same. `xy`, (M, 2) m, are positions at
    instants, `offsets` (N + 1,). People of the same group do not count as others of
    each other. Without others the guess is the middle of the map.
    """
    side_m = epsilon_m / _CELLS_PER_RADIUS
    low = xy.min(axis=0)
    cell = np.floor((xy - low) / side_m).astype(np.int64)
    shape = tuple((cell.max(axis=0) + 1).tolist())
    sizes, cluster = np.diff(offsets), cluster_numbers(tuple(group))
    weight, owner = np.repeat(1.0 / sizes, sizes), np.repeat(cluster, sizes)
    if np.prod(shape, dtype=np.float64) > _MOST_CELLS:
        sparse = _guesses_on_large_map(cell, weight, owner, n_columns=shape[1])
        return np.asarray(low + side_m * (sparse[cluster] + 0.5))
    everybody = _time_around(cell, weight, shape)
    guesses = np.empty((int(cluster.max()) + 1, 2))
    for number in range(len(guesses)):
        is_own = owner == number
        if is_own.all():
            guesses[number] = 0.5 * (np.array(shape) - 1)
            continue
        others = everybody - _time_around(cell[is_own], weight[is_own], shape)
        guesses[number] = np.unravel_index(others.argmax(), shape)
    return np.asarray(low + side_m * (guesses[cluster] + 0.5))


def _guesses_on_large_map(
    cell: Ints, weight: Floats, owner: Ints, *, n_columns: int
) -> Floats:
    """Return the cell of each cluster's guess, (C, 2), from walked cells alone.

    The time around each cell that anybody came near is summed; a map of all cells of a
    town would not fit into memory.
    """
    reach = np.arange(-_CELLS_PER_RADIUS, _CELLS_PER_RADIUS + 1)
    near = np.argwhere(reach[:, None] ** 2 + reach**2 <= _CELLS_PER_RADIUS**2)
    width = n_columns + 2 * _CELLS_PER_RADIUS  # So that no row runs into the next.
    key = (cell[:, 0] + _CELLS_PER_RADIUS) * width + cell[:, 1] + _CELLS_PER_RADIUS
    pairs, place = np.unique(np.stack([owner, key]), axis=1, return_inverse=True)
    time = np.bincount(place.ravel(), weights=weight)
    shift = (near - _CELLS_PER_RADIUS) @ np.array([width, 1])
    around = pairs[1][:, None] + shift
    keys, place = np.unique(around, return_inverse=True)
    place = place.reshape(around.shape)
    everybody = np.bincount(place.ravel(), weights=np.repeat(time, shift.size))
    n_clusters = int(owner.max()) + 1
    if n_clusters == 1:
        return np.asarray(0.5 * cell.max(axis=0)[None])
    guesses = np.empty((n_clusters, 2))
    for number in range(n_clusters):
        is_own = pairs[0] == number
        others = everybody - np.bincount(
            place[is_own].ravel(),
            weights=np.repeat(time[is_own], shift.size),
            minlength=keys.size,
        )
        best = keys[others.argmax()]
        guesses[number] = best // width, best % width
    return guesses - _CELLS_PER_RADIUS


def _time_around(cell: Ints, weight: Floats, shape: tuple[int, ...]) -> Floats:
    """Return the weight of the instants in a disc around each cell of the map."""
    from scipy.ndimage import convolve  # noqa: PLC0415 - heavy to import

    time = np.zeros(shape)
    np.add.at(time, (cell[:, 0], cell[:, 1]), weight)
    reach = np.arange(-_CELLS_PER_RADIUS, _CELLS_PER_RADIUS + 1)
    disc = reach[:, None] ** 2 + reach**2 <= _CELLS_PER_RADIUS**2
    return np.asarray(convolve(time, disc.astype(np.float64), mode="constant"))
