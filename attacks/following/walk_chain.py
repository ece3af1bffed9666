"""A Markov chain of how people walk, on a grid of cells and velocity classes.

The chain is the motion prior of the posterior adversary, fitted on other people. Moves
between cells and changes of class are counted. The map, where people stand, is the
chain's stationary law: a person about whom nothing is known stays distributed as the
map. Among all chains with that law it is the closest to the counted moves (Sinkhorn's
scaling).

References
----------
Sinkhorn, Knopp, Pacific J. Mathematics 21, 1967. Rabiner, "A tutorial on hidden Markov
models", Proc. IEEE 77, 1989.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.sparse import coo_array, csr_array

from isac_track.types import Bools, Floats, Ints, Tracks, positive

_SCALINGS: Final = 1000  # Most iterations of Sinkhorn's scaling.
_CLOSE: Final = 1e-6  # Total probability out of place at which the scaling ends.
_STAYS: Final = 0.01  # Share of moves that stay, so that every map can be stationary.
_BORDER_M: Final = 1.0  # Around the area in which people walk.


@dataclass(frozen=True, slots=True)
class ChainOptions:
    """Resolution of a chain, and how it smooths what it counts."""

    cell_m: float = 0.5
    step_s: float = 0.5
    directions: int = 8  # Classes of direction of each moving speed.
    speed_edges_mps: tuple[float, ...] = (0.3, 1.0)  # Below the first people stand.
    blur_m: float = 0.75  # Standard deviation of the smoothing of the map.
    floor: float = 0.05  # Share of the map that is uniform over all cells.

    def __post_init__(self) -> None:
        positive("cell_m", self.cell_m)
        positive("step_s", self.step_s)
        positive("blur_m", self.blur_m)

    @property
    def n_classes(self) -> int:
        """Number of velocity classes: rest, then direction by direction per speed."""
        return 1 + self.directions * len(self.speed_edges_mps)


@dataclass(frozen=True, eq=False, slots=True)
class Chain:
    """A chain over S states: state ``c * n_cells + i`` is class c in cell i."""

    low_m: Floats  # (2,) lower left corner of the grid.
    shape: tuple[int, int]  # Cells along either axis.
    cell_m: float
    step_s: float
    velocity_mps: Floats  # (C, 2) mean velocity of each class.
    spread_mps: Floats  # (C,) standard deviation around it, per axis.
    move: csr_array  # (S, S) counted moves within a class; rows sum to 1.
    arrive: csr_array  # (S, S) its transpose.
    switch: Floats  # (C, C) counted changes of class within a step.
    scale: Floats  # (S,) factor of arrivals that makes `stationary` stationary.
    reach: Floats  # (S,) sum of scaled moves from each state, to divide by.
    stationary: Floats  # (S,) the map, by class and cell.

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return self.shape[0] * self.shape[1]

    @property
    def map(self) -> Floats:
        """Probability of each cell, (n_cells,)."""
        return np.asarray(self.by_class(self.stationary).sum(axis=0))

    def by_class(self, values: Floats) -> Floats:
        """Return values of states by class and cell, (S,) -> (C, n_cells)."""
        return values.reshape(len(self.switch), self.n_cells)

    def cells_at(self, xy: Floats) -> Ints:
        """Return the cell of each place, (..., 2) m -> (...); the nearest outside."""
        number = np.floor((xy - self.low_m) / self.cell_m).astype(np.int64)
        number = np.clip(number, 0, np.array(self.shape) - 1)
        return np.asarray(number[..., 0] * self.shape[1] + number[..., 1])

    def centres(self) -> Floats:
        """Return the centre of each cell, (n_cells, 2) m."""
        number = np.stack(np.divmod(np.arange(self.n_cells), self.shape[1]), axis=1)
        return np.asarray(self.low_m + self.cell_m * (number + 0.5))

    def forward(self, probability: Floats) -> Floats:
        """Return the distribution a step later, (S,) -> (S,)."""
        moved = self.arrive @ (probability / self.reach)
        return _switched(moved, self.switch.T) * self.scale

    def backward(self, likelihood: Floats) -> Floats:
        """Return the mean of a later likelihood from each state, (S,) -> (S,)."""
        later = self.move @ _switched(self.scale * likelihood, self.switch)
        return np.asarray(later / self.reach)


def _switched(values: Floats, switch: Floats) -> Floats:
    """Return sums of values over classes, (S,), with weights (C, C)."""
    return np.asarray((switch @ values.reshape(len(switch), -1)).ravel())


@dataclass(frozen=True, eq=False, slots=True)
class WalkStates:
    """Place and velocity class of people at K instants, and a step later."""

    xy: Floats  # (K, 2) m
    velocity_mps: Floats  # (K, 2)
    xy_later: Floats  # (K, 2) m
    velocity_later_mps: Floats  # (K, 2)


def fit_chain(
    walks: Tracks, *, people: Bools, options: ChainOptions, grid_s: float
) -> Chain:
    """Return the chain of some people, (N,), who walk on a grid of instants.

    The grid of cells covers the area of all walks. ValueError if these people have no
    walk that lasts a step.
    """
    states = walk_states(walks, people=people, step_s=options.step_s, grid_s=grid_s)
    if not len(states.xy):
        raise ValueError(f"no other person walks for {options.step_s:g} s")
    low = walks.xy.min(axis=0) - _BORDER_M
    n_x, n_y = np.ceil((walks.xy.max(axis=0) + _BORDER_M - low) / options.cell_m)
    shape = int(n_x), int(n_y)
    kind = velocity_classes(states.velocity_mps, options)
    later = velocity_classes(states.velocity_later_mps, options)
    before_cell = np.floor((states.xy - low) / options.cell_m).astype(np.int64)
    after_cell = np.floor((states.xy_later - low) / options.cell_m).astype(np.int64)
    move = _count_moves(after_cell - before_cell, kind, shape, options)
    switch = _count_switches(kind, later, options.n_classes)
    stationary = _count_map(before_cell, kind, shape, options)
    velocity, spread = _class_velocities(states.velocity_mps, kind, options)
    return make_chain(
        low_m=low,
        shape=shape,
        options=options,
        velocity_mps=velocity,
        spread_mps=spread,
        move=move,
        switch=switch,
        stationary=stationary,
    )


def make_chain(
    *,
    low_m: Floats,
    shape: tuple[int, int],
    options: ChainOptions,
    velocity_mps: Floats,
    spread_mps: Floats,
    move: csr_array,
    switch: Floats,
    stationary: Floats,
) -> Chain:
    """Return the chain of counted moves with a given stationary law."""
    arrive = move.T.tocsr()
    scale = _stationary_scale(move, arrive, switch, stationary)
    return Chain(
        low_m=low_m,
        shape=shape,
        cell_m=options.cell_m,
        step_s=options.step_s,
        velocity_mps=velocity_mps,
        spread_mps=spread_mps,
        move=move,
        arrive=arrive,
        switch=switch,
        scale=scale,
        reach=move @ _switched(scale, switch),
        stationary=stationary,
    )


def walk_states(
    walks: Tracks, *, people: Bools, step_s: float, grid_s: float
) -> WalkStates:
    """Return the states of some people, (N,), at all instants with a step after them.

    A velocity is the mean over the step around its instant.
    """
    n_step = max(1, round(step_s / grid_s))
    half = max(1, n_step // 2)
    parts = []
    for row in np.flatnonzero(people).tolist():
        xy = walks.xy[walks.offsets[row] : walks.offsets[row + 1]]
        if len(xy) > n_step + 2 * half:
            velocity = (xy[2 * half :] - xy[: -2 * half]) / (2 * half * grid_s)
            place = xy[half:-half]
            now, later = slice(None, -n_step), slice(n_step, None)
            parts.append((place[now], velocity[now], place[later], velocity[later]))
    if not parts:
        return WalkStates(*(np.zeros((0, 2)) for _ in range(4)))
    return WalkStates(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def velocity_classes(velocity_mps: Floats, options: ChainOptions) -> Ints:
    """Return the class of each velocity, (K, 2) m/s -> (K,)."""
    speed = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1])
    level = np.searchsorted(options.speed_edges_mps, speed, side="right")
    turn = np.arctan2(velocity_mps[:, 1], velocity_mps[:, 0]) / (2.0 * np.pi)
    sector = np.rint(turn * options.directions).astype(np.int64) % options.directions
    return np.where(level == 0, 0, 1 + (level - 1) * options.directions + sector)


def nominal_velocities(options: ChainOptions) -> Floats:
    """Return a velocity in the middle of each class, (C, 2) m/s."""
    edges = np.array(options.speed_edges_mps)
    speed = np.append((edges[:-1] + edges[1:]) / 2.0, 1.3 * edges[-1])
    angle = 2.0 * np.pi * np.arange(options.directions) / options.directions
    moving = np.outer(speed, np.exp(1j * angle)).ravel()
    return np.concatenate([[[0.0, 0.0]], np.stack([moving.real, moving.imag], axis=1)])


def _class_velocities(
    velocity_mps: Floats, kind: Ints, options: ChainOptions
) -> tuple[Floats, Floats]:
    """Return mean and spread of each class; of an empty class its nominal values."""
    mean, spread = nominal_velocities(options), np.full(options.n_classes, 0.2)
    for number in np.unique(kind).tolist():
        own = velocity_mps[kind == number]
        mean[number] = own.mean(axis=0)
        spread[number] = max(float(own.std(axis=0).mean()), 0.05)
    return mean, spread


def _count_moves(
    shift: Ints, kind: Ints, shape: tuple[int, int], options: ChainOptions
) -> csr_array:
    """Return the share of moves by each displacement in cells, within each class.

    A class without a move, and a small share of each, stays where it is. A move out of
    the grid ends at its border.
    """
    n_x, n_y = shape
    cell = np.arange(n_x * n_y)
    cell_x, cell_y = np.divmod(cell, n_y)
    rows, columns, shares = [], [], []
    for number in range(options.n_classes):
        own = shift[kind == number]
        if not len(own):
            own = np.zeros((1, 2), dtype=np.int64)
        moves, count = np.unique(own, axis=0, return_counts=True)
        for (dx, dy), share in zip(moves.tolist(), count / len(own), strict=True):
            x, y = np.clip(cell_x + dx, 0, n_x - 1), np.clip(cell_y + dy, 0, n_y - 1)
            rows.append(number * n_x * n_y + cell)
            columns.append(number * n_x * n_y + x * n_y + y)
            shares.append(np.full(cell.size, (1.0 - _STAYS) * share))
    size = options.n_classes * n_x * n_y
    every = np.arange(size)
    places = np.concatenate([*rows, every]), np.concatenate([*columns, every])
    share = np.concatenate([*shares, np.full(size, _STAYS)])
    return coo_array((share, places), shape=(size, size)).tocsr()


def _count_switches(before: Ints, after: Ints, n_classes: int) -> Floats:
    """Return the share of changes from class to class, each counted once more."""
    count = np.zeros((n_classes, n_classes))
    np.add.at(count, (before, after), 1.0)
    count += (1.0 + count.sum(axis=0)) / (1.0 + count.sum()) / n_classes
    return np.asarray(count / count.sum(axis=1, keepdims=True))


def _count_map(
    cell: Ints, kind: Ints, shape: tuple[int, int], options: ChainOptions
) -> Floats:
    """Return the smoothed share of time in each class and cell, (S,)."""
    count = np.zeros((options.n_classes, *shape))
    np.add.at(count, (kind, cell[:, 0], cell[:, 1]), 1.0)
    blur = options.blur_m / options.cell_m
    smooth = gaussian_filter(count, (0.0, blur, blur), mode="constant")
    smooth /= smooth.sum()
    in_class = (count.sum(axis=(1, 2)) + 1.0) / (count.sum() + options.n_classes)
    uniform = in_class[:, None, None] / (shape[0] * shape[1])
    return np.asarray(
        ((1.0 - options.floor) * smooth + options.floor * uniform).ravel()
    )


def _stationary_scale(
    move: csr_array, arrive: csr_array, switch: Floats, stationary: Floats
) -> Floats:
    """Return the factors of arrivals, (S,), by which the map becomes stationary."""
    scale = np.ones_like(stationary)
    for _ in range(_SCALINGS):
        reach = move @ _switched(scale, switch)
        arrival = _switched(arrive @ (stationary / reach), switch.T)
        if np.abs(scale * arrival - stationary).sum() < _CLOSE:
            break
        scale = stationary / arrival
    return scale
