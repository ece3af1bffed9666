"""Compiled loop of the descriptors: see `isac_track.privacy.described`."""

from __future__ import annotations

from math import nan, sqrt
from typing import TYPE_CHECKING

from isac_track.compiling import FLOAT, compiled, read, together, written

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints


@compiled(
    *(together(read(2), read(2), read(2), read(2)), together(FLOAT, FLOAT)),
    *(read(1), read(1, "int64"), FLOAT, written(2)),
)
def described(
    places: tuple[Floats, Floats, Floats, Floats],
    turn: tuple[float, float],
    t: Floats,
    offsets: Ints,
    epsilon_m: float,
    out: Floats,
) -> None:
    """Fill `out` (5, N) with PLR, AEL, MEL, segments and mean squared error of every track."""
    (xy, truth, moved_to, moved_from), (cos, sin) = places, turn
    for i in range(offsets.size - 1):
        first, end = offsets[i], offsets[i + 1]
        n = end - first
        total_m2 = 0.0
        leaked = run = longest = segments = 0
        for k in range(first, end):
            step_x = moved_to[k, 0] - moved_from[k, 0]
            step_y = moved_to[k, 1] - moved_from[k, 1]
            x = xy[k, 0] + (cos * step_x + sin * step_y) - truth[k, 0]
            y = xy[k, 1] + (cos * step_y - sin * step_x) - truth[k, 1]
            square_m2 = x * x + y * y
            total_m2 += square_m2
            # Without a branch: which samples leak is as hard to foretell as a coin.
            leaks = int(sqrt(square_m2) < epsilon_m)
            leaked += leaks
            segments += leaks * int(run == 0)
            run = leaks * (run + 1)
            longest = max(longest, run)
        interval_s = (t[end - 1] - t[first]) / (n - 1) if n > 1 else nan
        out[0, i] = leaked / n
        out[1, i] = leaked / segments * interval_s if segments > 0 else 0.0
        out[2, i] = longest * interval_s if segments > 0 else 0.0
        out[3, i] = segments
        out[4, i] = total_m2 / n
