"""Passages as an adversary gets them: with errors, and without frame or clock.

Every passage is turned, shifted and put on another clock. What is left is the way that
a person walks.
"""

import numpy as np
from scipy.interpolate import CubicSpline

from attacks.tasks.passages import Passages
from isac_track.config import StageSettings
from isac_track.errors import SettingsError
from isac_track.resample import sampling_times
from isac_track.rng import stream
from isac_track.sensing import (
    draw_walk_channel,
    recorded_walk,
    sense,
    walked_within,
)
from isac_track.types import Floats, Ints, Release, Sensed

_STAGES = StageSettings()


def share_passages(
    passages: Passages,
    *,
    error: str,
    seed: int = 0,
    stages: StageSettings = _STAGES,
) -> Release:
    """Return the passages as an adversary gets them, without frame or clock.

    `error` is the standard deviation of white errors per axis in m, a number of at
    least 0; or ``raw`` for the suite's own sensing, with its sampling instants.
    SettingsError for anything else.
    """
    t, xy, offsets = passages.t, passages.xy, passages.offsets
    if error == "raw":
        robots_m = [stages.scenes.robot_x_m, stages.scenes.robot_y_m]
        shift_m = robots_m - np.median(xy, axis=0)
        sensed = sense_passages(passages, shift_m=shift_m, stages=stages, seed=seed)
        t, xy, offsets = sensed.t, sensed.xy, sensed.offsets
    else:
        xy = xy + _white_errors(error, passages, seed)
    return hide_frames(t=t, xy=xy, offsets=offsets, seed=seed)


def _white_errors(error: str, passages: Passages, seed: int) -> Floats:
    """Return white errors, (M, 2) m; each passage has a stream of its own."""
    try:
        std_m = float(error)
    except ValueError:
        std_m = -1.0
    if not 0.0 <= std_m < np.inf:
        raise SettingsError(f"an error is a number of metres or raw, got {error!r}")
    sizes = np.diff(passages.offsets).tolist()
    draws = [
        stream(seed, "returns", "white", source).standard_normal((size, 2))
        for source, size in zip(passages.source, sizes, strict=True)
    ]
    return std_m * np.concatenate(draws)


def sense_passages(
    passages: Passages,
    *,
    shift_m: Floats | None = None,
    stages: StageSettings = _STAGES,
    seed: int = 0,
) -> Sensed:
    """Return what the network senses of whole passages, at its own instants.

    `shift_m`, (2,), moves all of them first; None: they stay where they are.
    """
    times, places = list[Floats](), list[Floats]()
    for row, source in enumerate(passages.source):
        part = slice(passages.offsets[row], passages.offsets[row + 1])
        instants = sampling_times(
            start_s=float(passages.t[part][0]),
            end_s=float(passages.t[part][-1]),
            settings=stages.resample,
            rng=stream(seed, "returns", "sampling", source),
        )
        times.append(instants)
        places.append(CubicSpline(passages.t[part], passages.xy[part])(instants))
    t, xy = np.concatenate(times), np.concatenate(places)
    if shift_m is not None:
        xy = xy + shift_m
    offsets = np.append(0, np.cumsum([instants.size for instants in times]))
    walks = [recorded_walk(source) for source in passages.source]
    channel = draw_walk_channel(
        walked_m=walked_within(xy, offsets),
        offsets=offsets,
        walks=walks,
        keys=walks,
        settings=stages.sensing,
        seed=seed,
    )
    return sense(t=t, xy=xy, offsets=offsets, channel=channel, settings=stages.sensing)


def hide_frames(*, t: Floats, xy: Floats, offsets: Ints, seed: int) -> Release:
    """Return the release of N walks without frame or clock.

    Every walk is turned, begins within 10 m of the origin, and on a clock of its own.
    """
    rng = stream(seed, "returns", "frames")
    n = offsets.size - 1
    owner = np.repeat(np.arange(n), np.diff(offsets))
    turn = np.exp(1j * rng.uniform(0.0, 2.0 * np.pi, n))[owner]
    z = (xy[:, 0] + 1j * xy[:, 1] - (xy[offsets[:-1]] @ [1.0, 1j])[owner]) * turn
    origin = rng.uniform(-10.0, 10.0, (n, 2))[owner]
    clock_s = (rng.uniform(0.0, 1000.0, n) - t[offsets[:-1]])[owner]
    return Release(
        t=t + clock_s,
        xy=np.column_stack([z.real, z.imag]) + origin,
        sigma=None,
        offsets=offsets,
        pseudonym=tuple(f"passage {row}" for row in rng.permutation(n).tolist()),
    )
