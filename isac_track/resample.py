"""Cubic interpolation of recorded tracks and sampling at an adaptive 8-16 Hz rate."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import Generator

from isac_track.config import ResampleSettings
from isac_track.rng import stream
from isac_track.types import Bools, Floats, Tracks

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

# Nobody walks faster: a faster spline between slower samples overshoots.
SPEED_LIMIT_MPS = 4.0
_USUAL = ResampleSettings()
_FRACTIONS = np.arange(1, 16) / 16.0
"""Places within an interval where distance from the chord and speed are checked."""
_ROUNDING = 1e-6  # Relative tolerance of speeds.


@dataclass(frozen=True, eq=False, slots=True)
class Walk:
    """A continuous walk through the samples of a recorded track."""

    curve: "PPoly"
    n_monotone: int  # Intervals with a monotone cubic (PCHIP) instead of the spline.
    n_linear: int  # Intervals with a straight line.

    def __call__(self, t: Floats) -> Floats:
        """Return the positions (K, 2) m at times (K,) s."""
        positions: Floats = self.curve(t)
        return positions


def walk(track: Tracks, *, max_overshoot_m: float = _USUAL.max_overshoot_m) -> Walk:
    """Return the continuous walk of a recorded track, exact at its samples.

    It is a cubic spline (not-a-knot). In some intervals the spline overshoots: it
    leaves the chord of both samples by more than `max_overshoot_m`, or is faster than
    both `SPEED_LIMIT_MPS` and the chord. There it is replaced by a monotone cubic
    (Fritsch and Butland, SIAM J. Sci. Comput. 5, 300, 1984), or by a line where that
    overshoots, too. ValueError for several tracks or one sample.
    """
    if len(track) != 1 or track.t.size < 2:  # noqa: PLR2004 - a walk needs two points
        raise ValueError("a walk needs one track of at least two samples")
    from scipy.interpolate import (  # noqa: PLC0415 - heavy to import
        CubicSpline,
        PchipInterpolator,
    )

    curve = CubicSpline(track.t, track.xy)  # scipy lowers the degree below four points
    bad = _overshoots(curve.c, track, max_overshoot_m=max_overshoot_m)
    if not bad.any():
        return Walk(curve, 0, 0)
    monotone = PchipInterpolator(track.t, track.xy).c
    straight = bad & _overshoots(monotone, track, max_overshoot_m=max_overshoot_m)
    curve.c[:, bad] = monotone[:, bad]
    curve.c[:2, straight] = 0.0
    slope = np.diff(track.xy, axis=0) / np.diff(track.t)[:, None]
    curve.c[2, straight] = slope[straight]
    curve.c[3, straight] = track.xy[:-1][straight]
    return Walk(curve, int((bad & ~straight).sum()), int(straight.sum()))


def _overshoots(
    coefficients: Floats, track: Tracks, *, max_overshoot_m: float
) -> Bools:
    """Return which intervals of cubics (4, K - 1, 2) overshoot, (K - 1,)."""
    step_s, chord = np.diff(track.t), np.diff(track.xy, axis=0)
    after_s = _FRACTIONS[:, None, None] * step_s[:, None]  # (15, K - 1, 1)
    cubic, square, slope, _ = coefficients
    # From the first sample of the interval.
    offset = ((cubic * after_s + square) * after_s + slope) * after_s
    length = np.hypot(chord[:, 0], chord[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip((offset * chord).sum(axis=2) / length**2, 0.0, 1.0)
    share = np.where(length > 0, share, 0.0)
    away = offset - share[:, :, None] * chord
    leaves = np.hypot(away[..., 0], away[..., 1]).max(axis=0) > max_overshoot_m
    ends_s = np.stack([np.zeros_like(step_s), step_s])[:, :, None]
    at_s = np.concatenate([ends_s, after_s])
    velocity = (3.0 * cubic * at_s + 2.0 * square) * at_s + slope
    fastest = np.hypot(velocity[..., 0], velocity[..., 1]).max(axis=0)
    limit = np.maximum(SPEED_LIMIT_MPS, length / step_s)
    return np.asarray(leaves | (fastest > limit * (1.0 + _ROUNDING)))


def sampling_times(
    *, start_s: float, end_s: float, settings: ResampleSettings, rng: Generator
) -> Floats:
    """Draw the sensing update times of a walk between `start_s` and `end_s`, (K,) s.

    The update rate is uniform in ``rate_min_hz..rate_max_hz`` and drawn anew every
    ``rate_hold_s`` of track: this reading gives the paper's 366 points at 0.083 s.
    """
    n_holds = int(np.ceil((end_s - start_s) / settings.rate_hold_s)) + 1
    # Python's own numbers: numpy scalars take five times as long in the loop.
    rates = rng.uniform(settings.rate_min_hz, settings.rate_max_hz, n_holds).tolist()
    start_s, end_s, hold_s = float(start_s), float(end_s), settings.rate_hold_s
    now = start_s
    times: list[float] = []
    while now <= end_s or not times:
        times.append(now)
        now += 1.0 / rates[min(int((now - start_s) / hold_s), n_holds - 1)]
    return np.array(times)


def resample(tracks: Tracks, *, settings: ResampleSettings, seed: int) -> Tracks:
    """Interpolate and adaptively sample the tracks of at least `min_duration_s`.

    Every track draws from a stream of its own. ValueError if none is long enough.
    """
    times: list[Floats] = []
    positions: list[Floats] = []
    source: list[str] = []
    group: list[str] = []
    for track in tracks:
        start_s, end_s = float(track.t[0]), float(track.t[-1])
        # A recorded duration carries rounding of the clock: 21.6 s at 25 Hz is 540
        # frames, and seconds since 1970 have seven decimals.
        if track.t.size < 2 or end_s - start_s < settings.min_duration_s - 1e-6:  # noqa: PLR2004 - a line needs two
            continue
        rng = stream(seed, "resample", track.source[0])
        t = sampling_times(start_s=start_s, end_s=end_s, settings=settings, rng=rng)
        continuous = walk(track, max_overshoot_m=settings.max_overshoot_m)
        times.append(t)
        positions.append(continuous(t))
        source.append(track.source[0])
        group.append(track.group[0])
    if not times:
        raise ValueError(f"no track lasts {settings.min_duration_s:g} s")
    return Tracks(
        t=np.concatenate(times),
        xy=np.concatenate(positions),
        offsets=np.cumsum([0, *map(len, times)]),
        source=tuple(source),
        group=tuple(group),
    )
