"""What the linkage attacks share: walks on a common grid, their motion, and the best lag of two."""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from importlib import import_module
from types import ModuleType
from typing import NamedTuple

import numpy as np

from attacks.linkage.learning import teaches
from attacks.remembered import by_track, noise_m2
from isac_track.protocols import AttackContext
from isac_track.types import Floats, Ints, Release, read_only

# Of the grid: 4 Hz, above what is left of a walk behind the noise of any network.
STEP_S = 0.25
# What comes later is left out: it bounds the work; no task shows more than 12 s.
LONGEST_S = 60.0
_CLOCK_S = 1e-6
SLOW_M_S = 0.4  # Below it a walk hardly has a direction; its turning rate is damped.
_WIDTH_S = 3.0  # Of smoothing at errors of 1 m: tuned on the bundled crowd.
WIDTHS_S = read_only(0.5 * 2.0 ** (np.arange(7) / 2.0))
"""0.5 s to 4 s, in steps of a factor of 1.4: few, so that walks are smoothed together."""
_FACTORS = (
    1.0,
    0.5,
    2.0,
)  # Of the widths that an informed adversary tries, the default first.
FULL_CELLS = 48.0  # 12 s: the overlap by which others are measured.
# Of the ratio to an overlap, by which its cost grows: a short overlap fits anybody.
EXPONENT = 3.0
# Walks of either side that are compared at a time: their costs stay in the cache.
_NEAR = 160
# Cells, 2 s: a shorter overlap is tried only where a walk is no longer.
LEAST_OVERLAP = 8


class Signals(NamedTuple):
    """N walks, or how they go, on a grid of `STEP_S` from each one's first sample."""

    values: Floats  # (C, N, K) channels.
    sizes: Ints  # (N,) 1 to K, how many cells of each walk count, the first ones.

    def walks(self, rows: Ints) -> "Signals":
        """Return some of the walks."""
        return Signals(self.values[:, rows], self.sizes[rows])


@by_track(Signals.walks)
def on_grid(release: Release) -> Signals:
    """Return x and y of the walks of a release less their first samples, in m.

    A cell's value is the mean over the cell of the line through the samples. Whole
    cells only, in the middle of what there is; a walk shorter than one cell is one
    cell.
    """
    t, xy, offsets = (
        np.ascontiguousarray(x) for x in (release.t, release.xy, release.offsets)
    )
    lasts_s = t[offsets[1:] - 1] - t[offsets[:-1]]
    count = np.floor(np.minimum(lasts_s, LONGEST_S) / STEP_S + _CLOCK_S).astype(
        np.int64
    )
    count = np.maximum(count, 1)
    cells = np.empty((count.size, int(count.max(initial=1)), 2))
    loops().cell_means(t, xy, offsets, count, (STEP_S, LONGEST_S, _CLOCK_S), cells)
    return Signals(np.ascontiguousarray(cells.transpose(2, 0, 1)), count)


def loops() -> ModuleType:
    """Return the compiled loops; to import numba takes its time."""
    return import_module("attacks.linkage._lag_loop")


@lru_cache(maxsize=192)
def _local_lines(cells: int, width_s: float) -> tuple[Floats, Floats]:
    """Return what takes a walk of that many cells to its velocity and acceleration, (K, K) each.

    At each cell a parabola, of two cells a line, is fitted to all others with Gaussian
    weights of standard deviation `width_s` (Cleveland, "Robust locally weighted
    regression", JASA 74, 1979).
    """
    at_s = np.arange(cells) * STEP_S
    gap_s = at_s[None, :] - at_s[:, None]
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


def motion(walks: Signals, *, width_s: Floats) -> Signals:
    """Return speed, m/s, and turning rate, rad/s, each smoothed over its walk's `width_s`, (N,).

    The turning rate, anticlockwise positive, is Im(v* a) / (|v|^2 + `SLOW_M_S`^2) of
    velocity v and acceleration a.
    """
    going = np.zeros(walks.values.shape)
    kinds = walks.sizes + 1j * width_s
    for kind in np.unique(kinds):
        rows, cells = np.flatnonzero(kinds == kind), int(kind.real)
        xy = walks.values[:, rows, :cells]
        (vx, vy), (ax, ay) = (
            xy @ each for each in _local_lines(cells, float(kind.imag))
        )
        square = vx**2 + vy**2
        going[0, rows, :cells] = np.sqrt(square)
        going[1, rows, :cells] = (vx * ay - vy * ax) / (square + SLOW_M_S**2)
    return Signals(going, walks.sizes)


def widths_s(release: Release, factor: float = 1.0) -> Floats:
    """Return over how long to smooth each walk, (N,) s: the noisier, the longer.

    ``factor * 3 s * v^(1/4)`` of the error variance per axis v in m^2, as the
    innovations have it, rounded to `WIDTHS_S`.
    """
    wanted = factor * (_WIDTH_S * noise_m2(release) ** 0.25)
    return np.asarray(
        WIDTHS_S[np.searchsorted(np.sqrt(WIDTHS_S[1:] * WIDTHS_S[:-1]), wanted)]
    )


def factors(context: AttackContext, given: float | None) -> tuple[float, ...]:
    """Return the factors of the widths that are tried: what was given, or the default first.

    Left out are those by which all walks learnt from are smoothed over the same widths.
    """
    if given is not None or not teaches(context):
        return (_FACTORS[0] if given is None else given,)
    sides, found = (context.train.probe, context.train.gallery), dict[bytes, float]()
    for factor in _FACTORS:
        found.setdefault(
            b"".join(widths_s(one, factor).tobytes() for one in sides), factor
        )
    return tuple(found.values())


@by_track(Signals.walks)
def motion_of(release: Release, factor: float, turn_m: float = 1.0) -> Signals:
    """Return how the walks of a release go, smoothed over `widths_s`; turning times `turn_m`."""
    values, count = motion(on_grid(release), width_s=widths_s(release, factor))
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
    """Return how badly P signals fit G signals where they fit best, (E, P, G), one per floor.

    With a single number for `floors` it is (P, G). For every lag the overlap, of m
    cells, is projected on its first `rank` polynomials; d is the mean squared
    difference of what is left. The cost is the least over all lags of ``(d + floor) *
    (L / m)^3`` with L the cells of 12 s, and a floor in the signal's unit squared.
    Walks of one length lag by `reach_s` at most; a shorter one may lie anywhere within
    a longer. If `rotated`, of x and y, the mean and a rotation (no reflection) of the
    overlap are left out of the difference; `rank` does not count the mean.
    """
    levels = np.array(floors, dtype=np.float64).ravel()
    out = np.empty((levels.size, probe.sizes.size, gallery.sizes.size))
    most = int(max(probe.sizes.max(initial=1), gallery.sizes.max(initial=1)))
    basis, begin = polynomials(most, rank, int(rotated))
    weight = (FULL_CELLS / np.arange(1, most + 1)) ** EXPONENT
    reach = round(reach_s / STEP_S)
    for rows, columns, part, other in blocks(probe, gallery):
        block = np.empty((levels.size, rows.size, columns.size))
        lags = (reach, LEAST_OVERLAP, int(rotated))
        loops().least_costs((part, other), (basis, levels, weight), begin, lags, block)
        out[:, rows[:, None], columns[None, :]] = block
    return out if np.ndim(floors) else out[0]


@lru_cache(maxsize=64)
def polynomials(most: int, rank: int, first: int) -> tuple[Floats, Ints]:
    """Return orthonormal polynomials on 1 to `most` cells: values, and where each begins.

    Those on m cells are of degree `first` to ``first + rank - 1``, as far as m cells
    bear them; they lie from ``begin[m]`` to ``begin[m + 1]``, cell by cell for each
    degree.
    """
    parts = []
    for m in range(1, most + 1):
        at = np.linspace(-1.0, 1.0, m) if m > 1 else np.zeros(1)
        powers = np.polynomial.legendre.legvander(at, min(first + rank, m) - 1)
        parts.append(np.linalg.qr(powers)[0][:, first:].T.ravel())
    begin = np.cumsum([0, 0, *(part.size for part in parts)])
    return read_only(np.concatenate(parts)), read_only(begin)


def blocks(
    probe: Signals, gallery: Signals
) -> Iterator[tuple[Ints, Ints, Floats, Floats]]:
    """Yield at most `_NEAR` probes and gallery walks of one length each, with rows and columns.

    Signals come as (C, P, K) and (C, G, K), and go as (C, cells, rows) and (C, cells,
    columns).
    """

    def by_cell(signals: Signals) -> list[tuple[Ints, Floats]]:
        return [
            (
                rows,
                np.ascontiguousarray(
                    signals.values[:, rows, :cells].transpose(0, 2, 1)
                ),
            )
            for cells, count in zip(
                *np.unique(signals.sizes, return_counts=True), strict=True
            )
            for rows in np.array_split(
                np.flatnonzero(signals.sizes == cells), -(-count // _NEAR)
            )
        ]

    parts = by_cell(gallery)
    for rows, part in by_cell(probe):
        for columns, other in parts:
            yield rows, columns, part, other
