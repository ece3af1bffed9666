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
"""Of an interval: where its distance from the chord and its speed are looked at."""
_ROUNDING = 1e-6  # Relative, of speeds.


@dataclass(frozen=True, eq=False, slots=True)
class Walk:
    """A continuous walk through the samples of a recorded track."""

    curve: "PPoly"
    n_monotone: int  # Intervals where a monotone cubic (PCHIP) stands for the spline,
    n_linear: int  # and where a straight line does.

    def __call__(self, t: Floats) -> Floats:
        """Return the positions (K, 2) m at times (K,) s."""
        positions: Floats = self.curve(t)
        return positions


def walk(track: Tracks, *, max_overshoot_m: float = _USUAL.max_overshoot_m) -> Walk:
    """Return the continuous walk of a recorded track, exact at its samples.

    A cubic spline (not-a-knot). An interval in which it leaves the chord of both
    samples by more than `max_overshoot_m`, or is faster than both `SPEED_LIMIT_MPS` and
    the chord, is a monotone cubic instead (Fritsch and Butland, SIAM J. Sci. Comput. 5,
    300, 1984), or a line where that does no better. ValueError for several tracks or
    one sample.
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
    curve.c[2, straight], curve.c[3, straight] = (
        slope[straight],
        track.xy[:-1][straight],
    )
    return Walk(curve, int((bad & ~straight).sum()), int(straight.sum()))


def _overshoots(
    coefficients: Floats, track: Tracks, *, max_overshoot_m: float
) -> Bools:
    """Return (K - 1,) which intervals of cubics (4, K - 1, 2) leave the chord or are too fast."""
    step_s, chord = np.diff(track.t), np.diff(track.xy, axis=0)
    after_s = _FRACTIONS[:, None, None] * step_s[:, None]  # (15, K - 1, 1)
    cubic, square, slope, _ = coefficients
    offset = (
        (cubic * after_s + square) * after_s + slope
    ) * after_s  # from the first sample
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
    """Draw the sensing update times of one walk: (K,) s from `start_s`, none after `end_s`.

    The update rate is uniform in ``rate_min_hz..rate_max_hz`` and drawn anew every
    ``rate_hold_s`` of track: this reading gives the paper's 366 points at 0.083 s.
    """
    n_holds = int(np.ceil((end_s - start_s) / settings.rate_hold_s)) + 1
    # Python's own numbers: numpy's take five times as long one by one.
    rates = rng.uniform(settings.rate_min_hz, settings.rate_max_hz, n_holds).tolist()
    now, start_s, end_s, hold_s = (
        float(start_s),
        float(start_s),
        float(end_s),
        settings.rate_hold_s,
    )
    times: list[float] = []
    while now <= end_s or not times:
        times.append(now)
        now += 1.0 / rates[min(int((now - start_s) / hold_s), n_holds - 1)]
    return np.array(times)


def resample(tracks: Tracks, *, settings: ResampleSettings, seed: int) -> Tracks:
    """Return the tracks of at least `min_duration_s`, interpolated and adaptively sampled.

    Every track draws from a stream of its own. ValueError if none is long enough.
    """
    parts: list[tuple[Floats, Floats, str, str]] = []
    for track in tracks:
        start_s, end_s = float(track.t[0]), float(track.t[-1])
        # A recorded duration carries rounding of the clock: 21.6 s at 25 Hz is 540
        # frames, and seconds since 1970 have seven decimals.
        if track.t.size < 2 or end_s - start_s < settings.min_duration_s - 1e-6:  # noqa: PLR2004 - a line needs two
            continue
        rng = stream(seed, "resample", track.source[0])
        t = sampling_times(start_s=start_s, end_s=end_s, settings=settings, rng=rng)
        parts.append(
            (
                t,
                walk(track, max_overshoot_m=settings.max_overshoot_m)(t),
                track.source[0],
                track.group[0],
            )
        )
    if not parts:
        raise ValueError(f"no track lasts {settings.min_duration_s:g} s")
    t_parts, xy_parts, source, group = zip(*parts, strict=True)
    offsets = np.cumsum([0, *map(len, t_parts)])
    return Tracks(
        np.concatenate(t_parts), np.concatenate(xy_parts), offsets, source, group
    )
