"""Two walks laid against each other: blocks of one length, and the least misfit over all lags."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from attacks.linkage.signals import STEP_S, lengths, loops
from isac_track.types import read_only

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from attacks.linkage.signals import Signals
    from isac_track.types import Floats, Ints

FULL_CELLS = 48.0
"""12 s: the overlap by which others are measured."""
EXPONENT = 3.0
"""Of the ratio to an overlap, by which its cost grows: a short overlap fits anybody."""
LEAST_OVERLAP = 8
"""Cells, 2 s: a shorter overlap is tried only where a walk is no longer."""


def aligned_costs(
    probe: Signals,
    gallery: Signals,
    *,
    floors: Sequence[float],
    rank: int,
    reach_s: float,
    rotated: bool = False,
) -> Floats:
    """Return how badly P signals fit G signals where they fit best, (E, P, G), one per floor.

    For every lag the overlap, of m cells, is projected on its first `rank` polynomials; d is the
    mean squared difference of what is left. The cost is the least over all lags of
    ``(d + floor) * (L / m)^3`` with L the cells of 12 s.

    Parameters
    ----------
    probe, gallery : Signals
        Of two channels, x and y, if `rotated`.
    floors : E floats
        Positive, in the signal's unit squared.
    rank : int
    reach_s : float
        s, greatest lag of two walks of one length; a shorter walk may also lie anywhere within a
        longer one.
    rotated : bool
        Leave the mean and a rotation (no reflection) of the overlap out of the difference; `rank`
        does not count the mean.
    """
    levels = np.array(floors, dtype=np.float64)
    out = np.empty((levels.size, probe[1].size, gallery[1].size))
    most = int(max(probe[1].max(initial=1), gallery[1].max(initial=1)))
    basis, begin = polynomials(most, rank, 1 if rotated else 0)
    weight = (FULL_CELLS / np.arange(1, most + 1)) ** EXPONENT
    reach = round(reach_s / STEP_S)
    for rows, columns, part, other in blocks(probe, gallery):
        block = np.empty((levels.size, rows.size, columns.size))
        loops().least_costs(
            part, other, basis, begin, levels, weight, reach, LEAST_OVERLAP, rotated, block
        )
        out[:, rows[:, None], columns[None, :]] = block
    return out


@lru_cache(maxsize=64)
def polynomials(most: int, rank: int, first: int) -> tuple[Floats, Ints]:
    """Return orthonormal polynomials on 1 to `most` cells: values, and where each begins.

    Those on m cells are of degree `first` to ``first + rank - 1``, as far as m cells bear them;
    they lie from ``begin[m]`` to ``begin[m + 1]``, cell by cell for each degree.
    """
    parts = []
    for m in range(1, most + 1):
        at = np.linspace(-1.0, 1.0, m) if m > 1 else np.zeros(1)
        powers = np.polynomial.legendre.legvander(at, min(first + rank, m) - 1)
        parts.append(np.linalg.qr(powers)[0][:, first:].T.ravel())
    begin = np.cumsum([0, 0, *(part.size for part in parts)])
    return read_only(np.concatenate(parts)), read_only(begin)


def blocks(probe: Signals, gallery: Signals) -> Iterator[tuple[Ints, Ints, Floats, Floats]]:
    """Yield probes and gallery walks of one length each: rows, columns and signals of either.

    Signals come as (C, P, K) and (C, G, K), and go as (C, cells, rows) and (C, cells, columns).
    """

    def by_cell(signals: Signals) -> list[tuple[Ints, Floats]]:
        return [
            (rows, np.ascontiguousarray(signals[0][:, rows, :cells].transpose(0, 2, 1)))
            for cells, rows in lengths(signals[1])
        ]

    parts = by_cell(gallery)
    for rows, part in by_cell(probe):
        for columns, other in parts:
            yield rows, columns, part, other
