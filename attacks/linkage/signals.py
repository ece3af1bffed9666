"""What the linkage attacks share: walks on a common grid, their motion, and learning from mates.

A walk of a release comes in a frame and on a clock of its own. Everything here starts from its
first sample, in space and in time, and is complex-valued in the plane (x + iy), where turning the
frame is multiplying by a number of modulus one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from isac_track.noise import innovation_variance_m2
from isac_track.protocols import LinkageTrainingSet
from isac_track.types import Knowledge, Release, read_only

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import ModuleType

    from isac_track.protocols import AttackContext
    from isac_track.types import Floats, Ints

Complexes: TypeAlias = NDArray[np.complex128]

STEP_S = 0.25
"""Of the grid: 4 Hz, above what is left of a walk behind the noise of any network."""
LONGEST_S = 60.0
"""What comes later in a walk is left out: it bounds the work, and no task shows more than 12 s."""
LEAST_MATES = 8
"""Fewer mated pairs teach nothing that could be trusted: defaults are kept."""
MARGIN = 0.02
"""Of the mean log rank: with 90 pairs a smaller gain is as likely chance."""
_ALONE = 2**18
"""Multiplications: OpenBLAS's SMP_THRESHOLD_MIN times its GEMM_MULTITHREAD_THRESHOLD."""
_CLOCK_S = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class Walks:
    """N walks as the means over the cells of a grid of `STEP_S`, from each one's first sample."""

    z: Complexes
    """(N, K) m, x + iy less the first sample; only the first `count` cells of a row count."""
    count: Ints
    """(N,) cells, 1 to K."""

    def __len__(self) -> int:
        return self.count.size


def on_grid(release: Release) -> Walks:
    """Return the walks of a release on the common grid.

    A cell's value is the mean over the cell of the line through the samples, so that no sample
    in it is wasted and a step longer than a cell is bridged. Whole cells only, in the middle of
    what there is; a walk shorter than one cell is one cell.
    """
    t = np.ascontiguousarray(release.t)
    offsets = release.offsets.astype(np.int64, copy=False)
    lasts_s = t[offsets[1:] - 1] - t[offsets[:-1]]
    count = np.floor(np.minimum(lasts_s, LONGEST_S) / STEP_S + _CLOCK_S).astype(np.int64)
    count = np.maximum(count, 1)
    cells = np.empty((count.size, int(count.max(initial=1)), 2))
    loops().cell_means(
        t, np.ascontiguousarray(release.xy), offsets, count, STEP_S, LONGEST_S, _CLOCK_S, cells
    )
    return Walks(cells.view(np.complex128)[..., 0], count)


def loops() -> ModuleType:
    """Return the compiled loops, imported at first use: numba takes its time."""
    return import_module("attacks.linkage._lag_loop")


def lengths(count: Ints) -> list[tuple[int, Ints]]:
    """Return ``(cells, rows)`` for every length that occurs: rows of one length go together."""
    return [(int(size), np.flatnonzero(count == size)) for size in np.unique(count)]


@lru_cache(maxsize=192)
def _local_lines(cells: int, width_s: float) -> tuple[Floats, Floats]:
    """Return what takes a walk of that many cells to its velocity and acceleration, (K, K) each.

    At each cell a parabola is fitted to all others with Gaussian weights of standard deviation
    `width_s` (Cleveland, "Robust locally weighted regression", JASA 74, 1979): at either end of a
    walk it looks to one side only, and nothing need be padded. With two cells the parabola is a
    line.
    """
    at_s = np.arange(cells) * STEP_S
    gap_s = at_s[None, :] - at_s[:, None]
    weight = np.exp(-0.5 * (gap_s / width_s) ** 2)
    moments = [(weight * gap_s**power).sum(axis=1) for power in range(5)]
    degree = min(2, cells - 1)
    normal = np.empty((cells, degree + 1, degree + 1))
    for row in range(degree + 1):
        for column in range(degree + 1):
            normal[:, row, column] = moments[row + column]
    powers = np.stack([weight * gap_s**power for power in range(degree + 1)], axis=1)
    fitted = np.zeros((cells, 3, cells))
    fitted[:, : degree + 1] = np.linalg.solve(normal, powers)
    return (
        read_only(np.ascontiguousarray(fitted[:, 1].T)),
        read_only(np.ascontiguousarray(2.0 * fitted[:, 2].T)),
    )


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """How N walks go, on the grid; nothing of it depends on the frame."""

    speed: Floats
    """(N, K) m/s"""
    turn: Floats
    """(N, K) rad/s, anticlockwise positive, damped where the speed is small."""
    count: Ints
    """(N,)"""


SLOW_M_S = 0.4
"""Below it a walk hardly has a direction; its turning rate is damped."""


def motion(walks: Walks, *, width_s: Floats) -> Motion:
    """Return speed and turning rate of walks, each smoothed over its `width_s`, (N,) s.

    The turning rate is Im(v* a) / (|v|^2 + `SLOW_M_S`^2) of velocity v and acceleration a.
    """
    speed = np.zeros(walks.z.shape)
    turn = np.zeros(walks.z.shape)
    for cells, rows_of_length in lengths(walks.count):
        for width in np.unique(width_s[rows_of_length]):
            rows = rows_of_length[width_s[rows_of_length] == width]
            to_velocity, to_acceleration = _local_lines(cells, float(width))
            z = walks.z[rows, :cells]
            parts = np.concatenate([z.real, z.imag])
            velocity = product(parts, to_velocity)
            acceleration = product(parts, to_acceleration)
            vx, vy = velocity[: rows.size], velocity[rows.size :]
            ax, ay = acceleration[: rows.size], acceleration[rows.size :]
            square = vx**2 + vy**2
            speed[rows, :cells] = np.sqrt(square)
            turn[rows, :cells] = (vx * ay - vy * ax) / (square + SLOW_M_S**2)
    return Motion(speed, turn, walks.count)


def widths_s(release: Release, *, factors: Sequence[float] = (1.0,)) -> Floats:
    """Return over how long to smooth each walk, (F, N) s for F factors: the noisier, the longer.

    ``factor * 3 s * v^(1/4)`` of the error variance per axis v in m^2, as the innovations have it,
    rounded to `WIDTHS_S`. Behind a smoother there is nothing left to smooth and v is next to 0.
    """
    variance_m2 = innovation_variance_m2(t=release.t, xy=release.xy, offsets=release.offsets)
    wanted = np.multiply.outer(np.array(factors), _WIDTH_S * variance_m2**0.25)
    rounded: Floats = WIDTHS_S[np.searchsorted(np.sqrt(WIDTHS_S[1:] * WIDTHS_S[:-1]), wanted)]
    return rounded


def motions(release: Release, *, factors: Sequence[float] = (1.0,)) -> list[Motion]:
    """Return how the walks of a release go, smoothed over `widths_s`, for each factor.

    Grid and noise are those of the release, and found once for all factors.
    """
    walks = on_grid(release)
    return [motion(walks, width_s=width_s) for width_s in widths_s(release, factors=factors)]


_WIDTH_S = 3.0
"""At errors of 1 m: tuned on the bundled crowd."""
WIDTHS_S = read_only(0.5 * 2.0 ** (np.arange(7) / 2.0))
"""0.5 s to 4 s, in steps of a factor of 1.4: few, so that walks are smoothed together."""
FACTORS = (1.0, 0.5, 2.0)
"""Of the widths that an informed adversary tries, the default first."""


@lru_cache(maxsize=64)
def polynomials(most: int, rank: int, first: int) -> tuple[Floats, Ints, Ints]:
    """Return orthonormal polynomials on 1 to `most` cells: values, where each begins, how many.

    Those on m cells are of degree `first` to ``first + rank - 1``, as far as m cells bear them;
    they lie in `values` from ``begin[m]`` on, cell by cell for each degree.
    """
    parts = []
    begin = np.zeros(most + 2, dtype=np.int64)
    ranks = np.zeros(most + 1, dtype=np.int64)
    for m in range(1, most + 1):
        at = np.linspace(-1.0, 1.0, m) if m > 1 else np.zeros(1)
        powers = np.polynomial.legendre.legvander(at, min(first + rank, m) - 1)
        kept = np.linalg.qr(powers)[0][:, first:]
        ranks[m] = kept.shape[1]
        begin[m + 1] = begin[m] + kept.size
        parts.append(kept.T.ravel())
    return read_only(np.concatenate(parts)), read_only(begin), read_only(ranks)


def aligned_costs(
    *,
    probe: Floats,
    probe_count: Ints,
    gallery: Floats,
    gallery_count: Ints,
    floors: Sequence[float],
    rank: int,
    exponent: float,
    reach_s: float,
    rotated: bool,
) -> Floats:
    """Return how badly P signals fit G signals where they fit best, (E, P, G), one per floor.

    For every lag the overlap, of m cells, is projected on its polynomials up to degree `rank`; d
    is the mean squared difference of what is left. The cost is the least over all lags of
    ``(d + floor) * (L / m)^exponent`` with L the cells of 12 s: a short overlap fits anybody.

    Parameters
    ----------
    probe : (C, P, K) float
        Channels of the signals on the grid: two, x and y, if `rotated`.
    probe_count : (P,) int
        Cells of each that count.
    gallery, gallery_count
        As for the probe.
    floors : E floats
        Positive, in the signal's unit squared.
    rank : int
        Polynomials kept.
    exponent : float
    reach_s : float
        s, greatest lag of two walks of one length; a shorter walk may also lie anywhere within a
        longer one.
    rotated : bool
        Leave the mean and a rotation (no reflection) of the overlap out of the difference.
    """
    levels = np.array(floors, dtype=np.float64)
    out = np.empty((levels.size, probe_count.size, gallery_count.size))
    if out.size == 0:
        return out
    most = int(max(probe_count.max(), gallery_count.max()))
    basis, begin, ranks = polynomials(most, rank, 1 if rotated else 0)
    loop = loops().least_costs
    reach = round(reach_s / STEP_S)
    gallery_parts = [
        (rows, _by_cell(gallery, rows, cells)) for cells, rows in lengths(gallery_count)
    ]
    for cells, rows in lengths(probe_count):
        part = _by_cell(probe, rows, cells)
        for columns, other in gallery_parts:
            block = np.empty((levels.size, rows.size, columns.size))
            loop(
                part,
                other,
                basis,
                begin,
                ranks,
                levels,
                float(exponent),
                reach,
                LEAST_OVERLAP,
                FULL_CELLS,
                rotated,
                block,
            )
            out[:, rows[:, None], columns[None, :]] = block
    return out


def _by_cell(signals: Floats, rows: Ints, cells: int) -> Floats:
    """Return some rows of (C, N, K) signals of one length, as (C, cells, rows)."""
    return np.ascontiguousarray(signals[:, rows, :cells].transpose(0, 2, 1))


FULL_CELLS = 48.0
"""12 s: the overlap by which others are measured."""
LEAST_OVERLAP = 8
"""Cells, 2 s: a shorter overlap is tried only where a walk is no longer."""


def mated(train: LinkageTrainingSet) -> Ints:
    """Return the probes of a training set that have a mate."""
    return np.flatnonzero(train.mate >= 0)


def teaches(context: AttackContext) -> bool:
    """Return whether there is a training set with `LEAST_MATES` mated pairs or more."""
    return Knowledge.TRAIN in context.granted and mated(context.train).size >= LEAST_MATES


def few_mates(train: LinkageTrainingSet, *, most: int) -> LinkageTrainingSet:
    """Return the first `most` mated pairs of a training set, and nobody else."""
    rows = mated(train)[:most]
    return LinkageTrainingSet(
        probe=tracks_of(train.probe, rows),
        gallery=tracks_of(train.gallery, train.mate[rows]),
        mate=np.arange(rows.size),
    )


def tracks_of(release: Release, rows: Ints) -> Release:
    """Return some tracks of a release, in the order of `rows`."""
    sizes = np.diff(release.offsets)[rows]
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    samples = np.repeat(release.offsets[rows] - offsets[:-1], sizes) + np.arange(offsets[-1])
    return Release(
        t=release.t[samples],
        xy=release.xy[samples],
        sigma=None if release.sigma is None else release.sigma[samples],
        offsets=offsets,
        pseudonym=tuple(release.pseudonym[row] for row in rows),
    )


def learn(
    options: Sequence[Sequence[float]], *, loss: Callable[[tuple[float, ...]], float]
) -> tuple[float, ...]:
    """Return a value for each of some parameters, chosen one after the other; see `chosen`.

    Of each parameter the first option is the default, which those after it are tried with. All
    combinations would cost their product in place of their sum, and be more likely to find one
    that is best by chance.

    Parameters
    ----------
    options : one sequence for each parameter
    loss : callable
        The `log_rank` under one value for each parameter.
    """
    best = tuple(values[0] for values in options)
    least = None
    for which, values in enumerate(options):
        if len(values) == 1:
            continue
        least = loss(best) if least is None else least
        tried = [(*best[:which], value, *best[which + 1 :]) for value in values[1:]]
        losses = [least, *(loss(choice) for choice in tried)]
        winner = chosen(losses)
        best, least = [best, *tried][winner], losses[winner]
    return best


def chosen(losses: Sequence[float]) -> int:
    """Return which of some `log_rank` is least, but 0, the default, unless the gain is `MARGIN`."""
    best = int(np.argmin(losses))
    return best if losses[best] < losses[0] - MARGIN else 0


def log_rank(scores: Floats, *, mate: Ints) -> float:
    """Return the mean log of the rank of each mate among all candidates, 0 if all come first.

    Unlike the share of first ranks it sees how near a miss was, and unlike the mean rank it does
    not go by the hopeless. Ties count half.
    """
    rows = np.flatnonzero(mate >= 0)
    own = scores[rows, mate[rows]][:, None]
    above = (scores[rows] > own).sum(axis=1) + ((scores[rows] == own).sum(axis=1) - 1) / 2.0
    return float(np.log1p(above).mean())


def product(a: Floats, b: Floats) -> Floats:
    """Return ``a @ b`` in pieces of a size for which OpenBLAS starts no threads.

    A linker's products take a tenth of a millisecond. Threads, waiting for each other on cores
    that other processes use, have made that sixteen.
    """
    rows = max(_ALONE // max(b.size, 1), 1)
    out = np.empty((a.shape[0], b.shape[1]))
    for first in range(0, a.shape[0], rows):
        np.matmul(a[first : first + rows], b, out=out[first : first + rows])
    return out


def positive(**values: float | None) -> None:
    """Raise ValueError for a parameter that is neither None nor a positive number."""
    for name, value in values.items():
        if value is not None and not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive, got {value}")
