"""Slow and obviously correct: the metrics as plain loops over plain numbers.

Nothing here is shared with the package: no numpy broadcasting, no flat arrays, no
run-length tricks. To be read by eye.
"""

from __future__ import annotations

from itertools import pairwise
from math import atan2, cos, dist, exp, nan, sin, sqrt


def leaked_samples(*, shared_xy, true_xy, epsilon_m):
    """z(k): closer than epsilon."""
    return [dist(s, m) < epsilon_m for s, m in zip(shared_xy, true_xy, strict=True)]


def mean_interval_s(t):
    """Mean of the differences; a single sample has none."""
    gaps = [t[k] - t[k - 1] for k in range(1, len(t))]
    return sum(gaps) / len(gaps) if gaps else nan


def mean_s(t):
    """Every sample lasts one mean interval."""
    return [mean_interval_s(t)] * len(t)


def own_s(t):
    """Half the interval before a sample and half the next; at an end, the other."""
    result = []
    for k in range(len(t)):
        beside = [
            abs(t[k] - t[other]) for other in (k - 1, k + 1) if 0 <= other < len(t)
        ]
        result.append(sum(beside) / len(beside) if beside else nan)
    return result


def segments_s(leaked, samples_s):
    """Duration of every unbroken run of leaked samples."""
    result = []
    inside = False
    for sample, seconds in zip(leaked, samples_s, strict=True):
        if sample and inside:
            result[-1] += seconds
        elif sample:
            result.append(seconds)
        inside = sample
    return result


def exposure(*, leaked, t, intervals="segment"):
    """PLR, AEL and MEL of one trajectory, and the number of its segments."""
    count = 0
    for sample in leaked:
        if sample:
            count += 1
    if not count:
        return 0.0, 0.0, 0.0, 0
    result = segments_s(leaked, own_s(t) if intervals == "segment" else mean_s(t))
    return count / len(leaked), sum(result) / len(result), max(result), len(result)


def total_exposure(*, leaked, t, offsets, intervals="segment"):
    """Each trajectory cut out and treated alone; four lists."""
    rows = [
        exposure(leaked=list(leaked[lo:hi]), t=list(t[lo:hi]), intervals=intervals)
        for lo, hi in pairwise(offsets)
    ]
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
    """RMS distance after the best shift and then the best turn, by its angle."""
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
    turned = [
        (cos(angle) * x - sin(angle) * y, sin(angle) * x + cos(angle) * y) for x, y in a
    ]
    return sqrt(sum(dist(p, q) ** 2 for p, q in zip(turned, b, strict=True)) / len(a))
