"""What the linkage attacks share: walks on a common grid, and their motion.

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
from isac_track.types import Floats, Ints, read_only

if TYPE_CHECKING:
    from types import ModuleType

    from isac_track.types import Release

Complexes: TypeAlias = NDArray[np.complex128]
Signals: TypeAlias = tuple[Floats, Ints]
"""(C, N, K) channels of N walks on the grid, and how many cells of each count, (N,)."""

STEP_S = 0.25
"""Of the grid: 4 Hz, above what is left of a walk behind the noise of any network."""
LONGEST_S = 60.0
"""What comes later in a walk is left out: it bounds the work, and no task shows more than 12 s."""
_ALONE = 2**18
"""Multiplications: OpenBLAS's SMP_THRESHOLD_MIN times its GEMM_MULTITHREAD_THRESHOLD."""
_CLOCK_S = 1e-6
SLOW_M_S = 0.4
"""Below it a walk hardly has a direction; its turning rate is damped."""
_WIDTH_S = 3.0
"""Of smoothing at errors of 1 m: tuned on the bundled crowd."""
WIDTHS_S = read_only(0.5 * 2.0 ** (np.arange(7) / 2.0))
"""0.5 s to 4 s, in steps of a factor of 1.4: few, so that walks are smoothed together."""
FACTORS = (1.0, 0.5, 2.0)
"""Of the widths that an informed adversary tries, the default first."""


@dataclass(frozen=True, eq=False, slots=True)
class Walks:
    """N walks as the means over the cells of a grid of `STEP_S`, from each one's first sample."""

    z: Complexes
    """(N, K) m, x + iy less the first sample; only the first `count` cells of a row count."""
    count: Ints
    """(N,) cells, 1 to K."""

    def path(self) -> Signals:
        """Return the two signals of a path: x and y."""
        return np.stack([self.z.real, self.z.imag]), self.count


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
    degrees = np.arange(min(3, cells))
    moments = np.stack([(weight * gap_s**power).sum(axis=1) for power in range(5)], axis=1)
    normal = moments[:, degrees[:, None] + degrees]
    powers = np.stack([weight * gap_s**power for power in degrees], axis=1)
    fitted = np.zeros((cells, 3, cells))
    fitted[:, degrees] = np.linalg.solve(normal, powers)
    velocity, acceleration = fitted[:, 1].T, 2.0 * fitted[:, 2].T
    return tuple(read_only(np.ascontiguousarray(each)) for each in (velocity, acceleration))


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """How N walks go, on the grid; nothing of it depends on the frame."""

    speed: Floats
    """(N, K) m/s"""
    turn: Floats
    """(N, K) rad/s, anticlockwise positive, damped where the speed is small."""
    count: Ints
    """(N,)"""

    def profile(self, turn_m: float) -> Signals:
        """Return the two signals of a profile: speed, and turning times `turn_m`."""
        return np.stack([self.speed, turn_m * self.turn]), self.count


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


def widths_s(release: Release, factor: float = 1.0) -> Floats:
    """Return over how long to smooth each walk, (N,) s: the noisier, the longer.

    ``factor * 3 s * v^(1/4)`` of the error variance per axis v in m^2, as the innovations have it,
    rounded to `WIDTHS_S`. Behind a smoother there is nothing left to smooth and v is next to 0.
    """
    variance_m2 = innovation_variance_m2(t=release.t, xy=release.xy, offsets=release.offsets)
    wanted = factor * (_WIDTH_S * variance_m2**0.25)
    rounded: Floats = WIDTHS_S[np.searchsorted(np.sqrt(WIDTHS_S[1:] * WIDTHS_S[:-1]), wanted)]
    return rounded


def motion_of(release: Release, factor: float) -> Motion:
    """Return how the walks of a release go, smoothed over `widths_s`."""
    return motion(on_grid(release), width_s=widths_s(release, factor))


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
