"""Compiled loop of the descriptors: see `isac_track.privacy.described`."""

from math import nan, sqrt

import numpy as np

from isac_track.compiling import FLOAT, compiled, read, together, written
from isac_track.types import Floats, Ints


@compiled(
    together(*[read(2)] * 4),
    read(1),
    read(1, "int64"),
    together(*[FLOAT] * 5),
    written(2),
)
def described(
    places: tuple[Floats, ...],
    t: Floats,
    offsets: Ints,
    rule: tuple[float, ...],
    out: Floats,
) -> None:
    """Fill `out` (7, N) with the descriptors of `isac_track.privacy.described`.

    `places` are the shared and the true positions, and those to and from which samples
    were moved. `rule` holds the cosine and sine of the turn, epsilon and the wider
    distance in m, and a flag: 1 if the duration of a sample follows from the intervals
    beside it, 0 if from the mean interval.
    """
    xy, truth, moved_to, moved_from = places
    cos, sin, epsilon_m, wide_m, by_segment = rule
    for i in range(offsets.size - 1):
        own = slice(offsets[i], offsets[i + 1])
        shared, true, clock = xy[own], truth[own], t[own]
        to, since = moved_to[own], moved_from[own]
        n = clock.size
        total_m2 = run_s = leaked_s = longest_s = 0.0
        leaked = leaked_wide = segments = leaks = 0
        away_m = np.empty(n)
        mean_s = (clock[n - 1] - clock[0]) / (n - 1) if n > 1 else 0.0
        before_s = clock[1] - clock[0] if n > 1 else 0.0
        for k in range(n):
            step_x, step_y = to[k, 0] - since[k, 0], to[k, 1] - since[k, 1]
            x = shared[k, 0] + (cos * step_x + sin * step_y) - true[k, 0]
            y = shared[k, 1] + (cos * step_y - sin * step_x) - true[k, 1]
            square_m2 = x * x + y * y
            total_m2 += square_m2
            # No branch: the processor cannot predict which samples leak.
            away_m[k] = sqrt(square_m2)
            leaked_before, leaks = leaks, int(away_m[k] < epsilon_m)
            leaked_wide += int(away_m[k] < wide_m)
            leaked += leaks
            segments += leaks * (1 - leaked_before)
            after_s = clock[k + 1] - clock[k] if k + 1 < n else before_s
            lasting_s = 0.5 * (before_s + after_s) if by_segment > 0.0 else mean_s
            before_s = after_s
            leaked_s += leaks * lasting_s
            run_s = leaks * (run_s + lasting_s)
            longest_s = max(longest_s, run_s)
        unknown = n == 1 and leaked == 1
        out[0, i] = leaked / n
        out[1, i] = nan if unknown else leaked_s / max(segments, 1)
        out[2, i] = nan if unknown else longest_s
        out[3, i] = segments
        out[4, i] = total_m2 / n
        out[5, i] = leaked_wide / n
        out[6, i] = np.median(away_m)
