"""Cubic interpolation of recorded tracks and sampling at an adaptive 8-16 Hz rate."""

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from isac_track.config import ResampleSettings
from isac_track.rng import stream
from isac_track.types import Floats, Tracks


def walk(track: Tracks) -> Callable[[Floats], Floats]:
    """Return the continuous walk of one recorded track: times (K,) s -> positions (K, 2) m.

    A cubic spline (not-a-knot), exact at the samples. ValueError for several tracks or one sample.
    """
    if len(track) != 1 or track.t.size < 2:  # noqa: PLR2004 - a walk needs two points
        raise ValueError("a walk needs one track of at least two samples")
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - heavy, and workers get walks sampled

    return CubicSpline(track.t, track.xy)  # scipy lowers the degree below four points


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
    now, start_s, end_s, hold_s = float(start_s), float(start_s), float(end_s), settings.rate_hold_s
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
        # A recorded duration carries rounding of the clock: 21.6 s at 25 Hz is 540 frames, and
        # seconds since 1970 have seven decimals.
        if track.t.size < 2 or end_s - start_s < settings.min_duration_s - 1e-6:  # noqa: PLR2004 - a line needs two
            continue
        rng = stream(seed, "resample", track.source[0])
        t = sampling_times(start_s=start_s, end_s=end_s, settings=settings, rng=rng)
        parts.append((t, walk(track)(t), track.source[0], track.group[0]))
    if not parts:
        raise ValueError(f"no track lasts {settings.min_duration_s:g} s")
    t_parts, xy_parts, source, group = zip(*parts, strict=True)
    offsets = np.cumsum([0, *map(len, t_parts)])
    return Tracks(np.concatenate(t_parts), np.concatenate(xy_parts), offsets, source, group)
