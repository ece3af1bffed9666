"""Slow and obviously correct: the metrics as plain loops over plain numbers.

Nothing here is shared with the package: no numpy broadcasting, no flat arrays, no run-length
tricks. To be read by eye.
"""

from __future__ import annotations

from itertools import pairwise
from math import atan2, cos, dist, exp, nan, sin, sqrt


def leaked_samples(*, shared_xy, true_xy, epsilon_m):
    """z(k): closer than epsilon."""
    return [dist(s, m) < epsilon_m for s, m in zip(shared_xy, true_xy, strict=True)]


def runs(leaked):
    """Length of every unbroken run of leaked samples."""
    found = []
    length = 0
    for sample in leaked:
        if sample:
            length += 1
        elif length > 0:
            found.append(length)
            length = 0
    if length > 0:
        found.append(length)
    return found


def mean_interval_s(t):
    """Mean of the differences; a single sample has none."""
    gaps = [t[k] - t[k - 1] for k in range(1, len(t))]
    return sum(gaps) / len(gaps) if gaps else nan


def exposure(*, leaked, t):
    """PLR, AEL and MEL of one trajectory, and the number of its segments."""
    found = runs(leaked)
    count = 0
    for sample in leaked:
        if sample:
            count += 1
    if not found:
        return 0.0, 0.0, 0.0, 0
    interval_s = mean_interval_s(t)
    ael_s = sum(length * interval_s for length in found) / len(found)
    return count / len(leaked), ael_s, max(found) * interval_s, len(found)


def exposure_of_all(*, leaked, t, offsets):
    """Each trajectory cut out and treated alone; four lists."""
    rows = [exposure(leaked=list(leaked[lo:hi]), t=list(t[lo:hi])) for lo, hi in pairwise(offsets)]
    return tuple(map(list, zip(*rows, strict=True)))


def prediction_grid(*, t, window, horizon_steps):
    """Eq. future_time_grid for one track."""
    recent = list(t)[-window:]
    interval_s = mean_interval_s(recent)
    return [t[-1] + h * interval_s for h in range(horizon_steps)]


def fid_d_sigma(*, fid, eta, alpha_m, beta):
    """Eqs. fid_ratio and fid_error_control for one sample."""
    rho = fid / eta
    if rho <= 1:
        return 0.0
    return alpha_m * (beta - exp(-(rho - 1)))


def aligned(xy, truth):
    """RMS distance that is left after the best shift, then the best turn, by its angle."""
    a, b = (
        [
            (
                x - sum(p[0] for p in points) / len(points),
                y - sum(p[1] for p in points) / len(points),
            )
            for x, y in points
        ]
        for points in (xy, truth)
    )
    across = sum(p[0] * q[1] - p[1] * q[0] for p, q in zip(a, b, strict=True))
    along = sum(p[0] * q[0] + p[1] * q[1] for p, q in zip(a, b, strict=True))
    angle = atan2(across, along)
    turned = [(cos(angle) * x - sin(angle) * y, sin(angle) * x + cos(angle) * y) for x, y in a]
    return sqrt(sum(dist(p, q) ** 2 for p, q in zip(turned, b, strict=True)) / len(a))
