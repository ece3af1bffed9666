"""Walks on a common grid, their motion, and the best lag of two: for all linkers."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from types import ModuleType
from typing import NamedTuple

import numpy as np

from attacks.linkage.learning import can_learn
from attacks.remembered import memoised_by_track, noise_m2
from isac_track.protocols import AttackContext
from isac_track.types import Floats, Ints, Release, read_only

# Step of the grid. 4 Hz resolves every motion that shows behind a network's noise.
STEP_S = 0.25
# Only the first minute of a walk counts, to bound the work; tasks show 12 s at most.
LONGEST_S = 60.0
_CLOCK_S = 1e-6
SLOW_M_S = 0.4  # Below it a walk hardly has a direction; its turning rate is damped.
_WIDTH_S = 3.0  # Of smoothing at errors of 1 m: tuned on the bundled crowd.
WIDTHS_S = read_only(0.5 * 2.0 ** (np.arange(7) / 2.0))
"""0.5 s to 4 s, in steps of a factor of 1.4: few, so that many walks share a width."""
# Factors of the widths that an informed adversary tries, the default first.
_FACTORS = (1.0, 0.5, 2.0)
FULL_CELLS = 48.0  # 12 s: an overlap of this length keeps its cost.
# The cost of an overlap grows by this power of `FULL_CELLS` over its length: a short
# overlap fits any pair.
EXPONENT = 3.0
# Walks of either side that are compared at a time: their costs stay in the cache.
_NEAR = 160
# Cells, 2 s: a shorter overlap is tried only where a walk is no longer.
LEAST_OVERLAP = 8


class Signals(NamedTuple):
    """N walks, or their motion, on a grid of `STEP_S` from each walk's first sample."""

    values: Floats  # (C, N, K) channels.
    sizes: Ints  # (N,) 1 to K: only so many first cells of each walk count.

    def walks(self, rows: Ints) -> "Signals":
        """Return some of the walks."""
        return Signals(self.values[:, rows], self.sizes[rows])


@memoised_by_track(Signals.walks)
def on_grid(release: Release) -> Signals:
    """Return x and y of the walks of a release less their first samples, in m.

    A cell's value is the mean over the cell of the line through the samples. There are
    whole cells only, in the middle of the walk; a walk shorter than one cell is one
    cell.
    """
    t, xy = np.ascontiguousarray(release.t), np.ascontiguousarray(release.xy)
    offsets = np.ascontiguousarray(release.offsets)
    lasts_s = t[offsets[1:] - 1] - t[offsets[:-1]]
    whole_cells = np.floor(np.minimum(lasts_s, LONGEST_S) / STEP_S + _CLOCK_S)
    count = np.maximum(whole_cells.astype(np.int64), 1)
    cells = np.empty((count.size, int(count.max(initial=1)), 2))
    load_loops().cell_means(t, xy, offsets, count, (STEP_S, LONGEST_S, _CLOCK_S), cells)
    return Signals(np.ascontiguousarray(cells.transpose(2, 0, 1)), count)


def load_loops() -> ModuleType:
    """Import the compiled loops at their first use, since importing numba is slow."""
    return import_module("attacks.linkage._lag_loop")


# For all attacks and levels of a process; the 193rd makes the oldest go.
@lru_cache(maxsize=192)
def _local_lines(cells: int, width_s: float) -> tuple[Floats, Floats]:
    """Return the matrices from a walk to its velocity and acceleration, (K, K) each.

    The walk has K = `cells` cells. At each cell a parabola, for two cells a line, is
    fitted to all others with Gaussian weights of standard deviation `width_s`
    (Cleveland, "Robust locally weighted regression", JASA 74, 1979). The cache holds
    the last 192 pairs of matrices.
    """
    times_s = np.arange(cells) * STEP_S
    gap_s = times_s[None, :] - times_s[:, None]
    weight = np.exp(-0.5 * (gap_s / width_s) ** 2)
    degrees = np.arange(min(3, cells))
    moments = np.stack(
        [(weight * gap_s**power).sum(axis=1) for power in range(5)], axis=1
    )
    normal = moments[:, degrees[:, None] + degrees]
    powers = np.stack([weight * gap_s**power for power in range(degrees.size)], axis=1)
    fitted = np.zeros((cells, 3, cells))
    fitted[:, degrees] = np.linalg.solve(normal, powers)
    velocity, acceleration = np.ascontiguousarray(fitted[:, 1:].transpose(1, 2, 0))
    return read_only(velocity), read_only(2.0 * acceleration)


def smooth_motion(walks: Signals, *, width_s: Floats) -> Signals:
    """Return smoothed speed, m/s, and turning rate, rad/s, of each walk.

    `width_s`, (N,), is the width of smoothing for each walk. The turning rate,
    anticlockwise positive, is Im(v* a) / (|v|^2 + `SLOW_M_S`^2) of velocity v and
    acceleration a.
    """
    going = np.zeros(walks.values.shape)
    # Walks of one size and width share the matrices.
    kinds = walks.sizes + 1j * width_s
    for kind in np.unique(kinds):
        rows, cells = np.flatnonzero(kinds == kind), int(kind.real)
        xy = walks.values[:, rows, :cells]
        (vx, vy), (ax, ay) = (xy @ fit for fit in _local_lines(cells, float(kind.imag)))
        square = vx**2 + vy**2
        going[0, rows, :cells] = np.sqrt(square)
        going[1, rows, :cells] = (vx * ay - vy * ax) / (square + SLOW_M_S**2)
    return Signals(going, walks.sizes)


def widths_s(release: Release, factor: float = 1.0) -> Floats:
    """Return the width of smoothing for each walk, (N,) s: the noisier, the wider.

    It is ``factor * 3 s * v^(1/4)``, rounded to `WIDTHS_S`, with v the error variance
    per axis in m^2, estimated from the innovations.
    """
    wanted = factor * (_WIDTH_S * noise_m2(release) ** 0.25)
    return np.asarray(
        WIDTHS_S[np.searchsorted(np.sqrt(WIDTHS_S[1:] * WIDTHS_S[:-1]), wanted)]
    )


def width_factors(context: AttackContext, given: float | None) -> tuple[float, ...]:
    """Return the factors of the widths to try: the given factor, or the default first.

    A factor is left out if it gives all walks of the training set the same widths as an
    earlier factor.
    """
    if given is not None:
        return (given,)
    if not can_learn(context):
        return _FACTORS[:1]
    probe, gallery = context.train.probe, context.train.gallery
    by_widths: dict[bytes, float] = {}
    for factor in _FACTORS:
        widths = np.concatenate([widths_s(probe, factor), widths_s(gallery, factor)])
        by_widths.setdefault(widths.tobytes(), factor)
    return tuple(by_widths.values())


@memoised_by_track(Signals.walks)
def release_motion(release: Release, factor: float, turn_m: float = 1.0) -> Signals:
    """Return speed, and turning rate times `turn_m`, smoothed over `widths_s`."""
    values, count = smooth_motion(on_grid(release), width_s=widths_s(release, factor))
    values[1] *= turn_m
    return Signals(values, count)


def aligned_costs(
    probe: Signals,
    gallery: Signals,
    *,
    floors: float | Sequence[float],
    rank: int,
    reach_s: float,
    rotated: bool = False,
) -> Floats:
    """Return the cost of each pair of signals at its best lag, (E, P, G), per floor.

    With a single number for `floors` it is (P, G). For every lag the overlap, of m
    cells, is projected on its first `rank` polynomials; d is the mean squared
    difference of the projections. The cost is the least over all lags of ``(d + floor)
    * (L / m)^3`` with L the cells of 12 s, and a floor in the signal's unit squared.
    Walks of one length lag by `reach_s` at most; a shorter walk may lie anywhere within
    a longer. If `rotated`, for x and y, the difference ignores the mean and a rotation
    (no reflection) of the overlap; `rank` does not count the mean.
    """
    levels = np.array(floors, dtype=np.float64).ravel()
    out = np.empty((levels.size, probe.sizes.size, gallery.sizes.size))
    most = int(max(probe.sizes.max(initial=1), gallery.sizes.max(initial=1)))
    basis, begin = polynomials(most, rank, int(rotated))
    weight = (FULL_CELLS / np.arange(1, most + 1)) ** EXPONENT
    reach = round(reach_s / STEP_S)
    for block in blocks(probe, gallery):
        costs = np.empty((levels.size, block.rows.size, block.columns.size))
        lags = (reach, LEAST_OVERLAP, int(rotated))
        load_loops().least_costs(
            (block.probe, block.gallery), (basis, levels, weight), begin, lags, costs
        )
        out[:, block.rows[:, None], block.columns[None, :]] = costs
    return out if np.ndim(floors) else out[0]


# For all attacks and levels of a process; the 65th makes the oldest go.
@lru_cache(maxsize=64)
def polynomials(most: int, rank: int, first: int) -> tuple[Floats, Ints]:
    """Return orthonormal polynomials on 1 to `most` cells: values, and their begins.

    Those on m cells are of degree `first` to ``first + rank - 1``, or as many as m
    cells determine. They lie from ``begin[m]`` to ``begin[m + 1]``, cell by cell for
    each degree.
    """
    parts = []
    for m in range(1, most + 1):
        points = np.linspace(-1.0, 1.0, m) if m > 1 else np.zeros(1)
        powers = np.polynomial.legendre.legvander(points, min(first + rank, m) - 1)
        parts.append(np.linalg.qr(powers)[0][:, first:].T.ravel())
    begin = np.cumsum([0, 0, *(part.size for part in parts)])
    return read_only(np.concatenate(parts)), read_only(begin)


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """R x C pairs of probes of the same length and gallery walks of the same length."""

    rows: Ints  # (R,) probes
    columns: Ints  # (C,) gallery walks
    probe: Floats  # (channels, cells, R)
    gallery: Floats  # (channels, cells, C), of another number of cells


def blocks(probe: Signals, gallery: Signals) -> Iterator[Block]:
    """Cut all pairs into blocks of at most `_NEAR` x `_NEAR`."""
    gallery_parts = _parts_by_length(gallery)
    for rows, part in _parts_by_length(probe):
        for columns, other in gallery_parts:
            yield Block(rows, columns, part, other)


def _parts_by_length(signals: Signals) -> list[tuple[Ints, Floats]]:
    """Return parts of at most `_NEAR` walks of one length: rows, (C, cells, rows)."""
    parts = []
    lengths, counts = np.unique(signals.sizes, return_counts=True)
    for cells, count in zip(lengths, counts, strict=True):
        same_length = np.flatnonzero(signals.sizes == cells)
        for rows in np.array_split(same_length, -(-count // _NEAR)):
            by_cell = signals.values[:, rows, :cells].transpose(0, 2, 1)
            parts.append((rows, np.ascontiguousarray(by_cell)))
    return parts
