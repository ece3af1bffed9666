"""The simulated plaza beside real crowds: ``python -m benchmarks.crowd_table``.

Prints the table of ``docs/explanation/plaza.md``. Real recordings take part where they
are found in ``ISAC_TRACK_DATA`` or the cache; nothing is downloaded.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isac_track.config import ResampleSettings
from isac_track.datasets import load, registry
from isac_track.resample import resample, walk

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints, Tracks

COLUMNS = ("plaza", "plaza-session2", "students03", "zara01")
MOVING_MPS = 0.2
"""A step or a turn counts as moving from this speed on."""
TURN_SPAN_S = 0.8
"""Heading is the direction of the displacement over this span.

Over a single 0.4 s step of a slow walker it is mostly the jitter of the annotation.
"""
_WINDOW = 16
_STEPS_AHEAD = 11
_HISTORY_RATIO = 0.7
_TIME_DIGITS = 6


def step_speeds_mps(tracks: Tracks) -> Floats:
    """Return the speed of every recorded step of every track, in m/s: (M - N,)."""
    inside = _within_track(tracks, lag=1)
    length = np.hypot(*(tracks.xy[1:] - tracks.xy[:-1]).T)
    return np.asarray(length[inside] / _durations(tracks, lag=1)[inside])


def turn_rates_dps(tracks: Tracks) -> Floats:
    """Return the absolute turn rates of people who move, in degrees/s: (K,).

    The angle between two successive displacements of `TURN_SPAN_S` over that span,
    wherever both are at least `MOVING_MPS` fast.
    """
    frame_s = float(np.median(_durations(tracks, lag=1)[_within_track(tracks, lag=1)]))
    lag = max(1, round(TURN_SPAN_S / frame_s))
    move = tracks.xy[lag:] - tracks.xy[:-lag]
    moving = np.hypot(*move.T) >= MOVING_MPS * _durations(tracks, lag=lag)
    now, then = move[:-lag], move[lag:]
    cross = now[:, 0] * then[:, 1] - now[:, 1] * then[:, 0]
    angle = np.abs(np.arctan2(cross, (now * then).sum(axis=1)))
    use = _within_track(tracks, lag=2 * lag) & moving[:-lag] & moving[lag:]
    return np.asarray(np.degrees(angle[use]) / (lag * frame_s))


def moving_speeds_mps(tracks: Tracks) -> Floats:
    """Return each track's mean speed over its moving steps, in m/s: (N,).

    NaN for a track that never moves.
    """
    means = np.full(len(tracks), np.nan)
    for row, track in enumerate(tracks):
        speeds = np.hypot(*np.diff(track.xy, axis=0).T) / np.diff(track.t)
        if (speeds >= MOVING_MPS).any():
            means[row] = speeds[speeds >= MOVING_MPS].mean()
    return means


def neighbour_distances_m(tracks: Tracks) -> tuple[Floats, Ints]:
    """Return nearest-neighbour distances in m, (K,), and people per frame, (F,)."""
    frames, frame_rows = np.unique(
        np.round(tracks.t, _TIME_DIGITS), return_inverse=True
    )
    order = np.argsort(frame_rows, kind="stable")
    present = np.bincount(frame_rows, minlength=frames.size)
    nearest = []
    for xy in np.split(tracks.xy[order], np.cumsum(present)[:-1]):
        if len(xy) > 1:
            distance = np.hypot(*np.moveaxis(xy[:, None] - xy[None], 2, 0))
            np.fill_diagonal(distance, np.inf)
            nearest.append(distance.min(axis=1))
    return (np.concatenate(nearest) if nearest else np.empty(0)), present


def line_errors_m(tracks: Tracks, *, seed: int = 0, everywhere: bool = False) -> Floats:
    """Return errors of the paper's least-squares line over the long tracks, in m: (K,).

    A track is sampled at 8-16 Hz and cut at 70 % of its duration; straight lines x(t)
    and y(t) through the last 16 history samples are extended by 11 mean intervals
    (about 0.92 s) and compared with the interpolated walk. Tracks below
    `ResampleSettings.min_duration_s` are out.

    Parameters
    ----------
    tracks : Tracks
        As recorded.
    seed : int
        Base seed of the sampling times.
    everywhere : bool
        Cut every track after every 16 samples instead of once: a steadier mean of the
        same.
    """
    settings = ResampleSettings()
    errors = [np.empty(0)]
    for track in tracks:
        if track.t[-1] - track.t[0] < settings.min_duration_s - 10.0**-_TIME_DIGITS:
            continue
        dense = resample(track, settings=settings, seed=seed)
        cut_s = dense.t[0] + _HISTORY_RATIO * (dense.t[-1] - dense.t[0])
        ends = np.array([np.searchsorted(dense.t, cut_s, side="right")])
        if everywhere:
            ends = np.arange(_WINDOW, dense.t.size - _WINDOW, _WINDOW)
        samples = ends[:, None] + np.arange(-_WINDOW, 0)
        t, xy = dense.t[samples], dense.xy[samples]
        ahead_s = t[:, -1] + _STEPS_AHEAD * np.diff(t, axis=1).mean(axis=1)
        centred = t - t.mean(axis=1, keepdims=True)
        squares = (centred**2).sum(axis=1)
        slope = (xy * centred[:, :, None]).sum(axis=1) / squares[:, None]
        predicted = xy.mean(axis=1) + slope * (ahead_s - t.mean(axis=1))[:, None]
        errors.append(np.hypot(*(predicted - walk(track)(ahead_s)).T))
    return np.concatenate(errors)


def statistics(tracks: Tracks) -> dict[str, float]:
    """Return the summary statistics of a crowd by name; the unit is in the name."""
    speed, turn = step_speeds_mps(tracks), turn_rates_dps(tracks)
    nearest, present = neighbour_distances_m(tracks)
    line, lines = line_errors_m(tracks), line_errors_m(tracks, everywhere=True)
    moving = moving_speeds_mps(tracks)
    duration = tracks.t[tracks.offsets[1:] - 1] - tracks.t[tracks.offsets[:-1]]
    _, label, size = np.unique(
        np.array(tracks.group), return_inverse=True, return_counts=True
    )
    return {
        "tracks": float(len(tracks)),
        "step speed, mean [m/s]": float(speed.mean()),
        "step speed, sd [m/s]": float(speed.std()),
        "steps below 0.2 m/s [share]": float((speed < MOVING_MPS).mean()),
        "moving speed between tracks, mean [m/s]": float(np.nanmean(moving)),
        "moving speed between tracks, sd [m/s]": float(np.nanstd(moving)),
        "turn rate, median [deg/s]": float(np.median(turn)),
        "turn rate, 95 % [deg/s]": float(np.quantile(turn, 0.95)),
        "nearest neighbour, 5 % [m]": float(np.quantile(nearest, 0.05)),
        "nearest neighbour, median [m]": float(np.median(nearest)),
        "people present, mean": float(present.mean()),
        "duration, median [s]": float(np.median(duration)),
        "duration, mean [s]": float(duration.mean()),
        "tracks of at least 21.6 s [share]": line.size / len(tracks),
        "line prediction error, mean [m]": float(line.mean()) if line.size else np.nan,
        "line prediction error, everywhere, mean [m]": (
            float(lines.mean()) if line.size else np.nan
        ),
        "line prediction error, median [m]": (
            float(np.median(line)) if line.size else np.nan
        ),
        "tracks in walking groups [share]": float((size[label] > 1).mean()),
    }


def _within_track(
    tracks: Tracks, *, lag: int
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    row = np.repeat(np.arange(len(tracks)), np.diff(tracks.offsets))
    same: np.ndarray[tuple[int], np.dtype[np.bool_]] = row[lag:] == row[:-lag]
    return same


def _durations(tracks: Tracks, *, lag: int) -> Floats:
    """Return the time over `lag` samples, (M - lag,) s; void across two tracks."""
    return np.asarray(tracks.t[lag:] - tracks.t[:-lag])


def main() -> None:
    """Print one row a statistic and one column a crowd that is here."""
    columns = {}
    for name in COLUMNS:
        known = registry.known(name)
        if not registry.locate(known)[1]:
            columns[name] = statistics(load(name).tracks)
        else:
            print(f"{name}: not found, left out")
    print("| statistic |", " | ".join(columns), "|")
    print("|---|" + "---:|" * len(columns))
    for key in columns["plaza"]:
        values = (cells[key] for cells in columns.values())
        print(f"| {key} |", " | ".join(f"{value:.4g}" for value in values), "|")


if __name__ == "__main__":
    main()
