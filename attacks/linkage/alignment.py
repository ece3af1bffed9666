"""Two walks laid against each other at every lag: the least misfit of their signals."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from attacks.linkage.signals import STEP_S, lengths, loops
from isac_track.types import read_only

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from isac_track.types import Floats, Ints


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
    for rows, columns, part, other in blocks(probe, probe_count, gallery, gallery_count):
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


def blocks(
    probe: Floats, probe_count: Ints, gallery: Floats, gallery_count: Ints
) -> Iterator[tuple[Ints, Ints, Floats, Floats]]:
    """Yield probes and gallery walks of one length each: rows, columns and signals of either.

    Signals come as (C, P, K) and (C, G, K), and go as (C, cells, rows) and (C, cells, columns).
    """
    parts = [(rows, _by_cell(gallery, rows, cells)) for cells, rows in lengths(gallery_count)]
    for cells, rows in lengths(probe_count):
        part = _by_cell(probe, rows, cells)
        for columns, other in parts:
            yield rows, columns, part, other


def _by_cell(signals: Floats, rows: Ints, cells: int) -> Floats:
    return np.ascontiguousarray(signals[:, rows, :cells].transpose(0, 2, 1))


FULL_CELLS = 48.0
"""12 s: the overlap by which others are measured."""
LEAST_OVERLAP = 8
"""Cells, 2 s: a shorter overlap is tried only where a walk is no longer."""
