"""Own functions of the project, one trajectory or one scene at a time, as the suite asks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from isac_track import conflict, privacy, sharing
from isac_track.testing._metrics import Metrics

if TYPE_CHECKING:
    from collections.abc import Callable

    from isac_track.testing._metrics import Duration
    from isac_track.types import Floats, Ints


def _exposure(
    shared_xy: Floats, true_xy: Floats, t: Floats, offsets: Ints, epsilon_m: float
) -> tuple[Floats, Floats, Floats]:
    leaked = privacy.leakage_indicator(shared_xy=shared_xy, true_xy=true_xy, epsilon_m=epsilon_m)
    found = privacy.exposure(leaked=leaked, t=t, offsets=offsets)
    return found.plr, found.ael_s, found.mel_s


def _alone(place: int) -> Duration:
    def of_one(shared_xy: Floats, true_xy: Floats, t: Floats, epsilon_m: float) -> float:
        whole = np.array([0, len(t)])
        return float(_exposure(shared_xy, true_xy, t, whole, epsilon_m)[place][0])

    return of_one


def _plr(shared_xy: Floats, true_xy: Floats, epsilon_m: float) -> float:
    t = np.arange(len(true_xy), dtype=float)  # any clock: PLR counts samples
    return _alone(0)(shared_xy, true_xy, t, epsilon_m)


def _prediction_grid(t: Floats, window: int, horizon_steps: int) -> Floats:
    grid: Floats = conflict.prediction_grid(
        t=t, offsets=np.array([0, len(t)]), window=window, horizon_steps=horizon_steps
    )[0]
    return grid


def _robot_path(start: Floats, destination: Floats, speed_mps: float, elapsed_s: Floats) -> Floats:
    path: Floats = conflict.robot_path(
        start=start[None],
        destination=destination[None],
        speed_mps=speed_mps,
        elapsed_s=elapsed_s[None, None],
    )[0, 0]
    return path


def _minimum_separation(robot: Floats, agents: Floats) -> float:
    return float(conflict.minimum_separation(robot=robot[None], agents=agents[None])[0])


def _is_conflict(separation_m: float, safety_radius_m: float) -> bool:
    separation = np.array([separation_m])
    return bool(conflict.is_conflict(separation_m=separation, safety_radius_m=safety_radius_m)[0])


def _positional(function: Callable[..., Any], *names: str) -> Callable[..., Any]:
    return lambda *values: function(**dict(zip(names, values, strict=True)))


OWN = Metrics(
    plr=_plr,
    ael_s=_alone(1),
    mel_s=_alone(2),
    exposure=_exposure,
    prediction_grid=_prediction_grid,
    robot_path=_robot_path,
    minimum_separation=_minimum_separation,
    is_conflict=_is_conflict,
    missed_conflict_rate=_positional(conflict.missed_conflict_rate, "conflict", "predicted"),
    false_alarm_rate=_positional(conflict.false_alarm_rate, "conflict", "predicted"),
    distance_mae_m=_positional(
        conflict.distance_mae_m, "true_separation_m", "predicted_separation_m"
    ),
    fid_d_sigma=_positional(sharing.fid_d_sigma, "fid", "eta", "alpha_m", "beta"),
)
"""Passes every check."""
