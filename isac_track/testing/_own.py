"""Own functions of the project, one trajectory or one scene at a time, as the suite asks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isac_track import conflict, privacy, sharing
from isac_track.testing._kit import Metrics

if TYPE_CHECKING:
    from isac_track.types import Floats, Ints


def _leakage(
    shared_xy: Floats, true_xy: Floats, t: Floats, offsets: Ints, epsilon_m: float
) -> privacy.Exposure:
    leaked = privacy.leakage_indicator(shared_xy=shared_xy, true_xy=true_xy, epsilon_m=epsilon_m)
    return privacy.exposure(leaked=leaked, t=t, offsets=offsets)


def _alone(shared_xy: Floats, true_xy: Floats, t: Floats, epsilon_m: float) -> privacy.Exposure:
    return _leakage(shared_xy, true_xy, t, np.array([0, len(t)]), epsilon_m)


def _plr(shared_xy: Floats, true_xy: Floats, epsilon_m: float) -> float:
    t = np.arange(len(true_xy), dtype=float)  # any clock: PLR counts samples
    return float(_alone(shared_xy, true_xy, t, epsilon_m).plr[0])


def _ael_s(shared_xy: Floats, true_xy: Floats, t: Floats, epsilon_m: float) -> float:
    return float(_alone(shared_xy, true_xy, t, epsilon_m).ael_s[0])


def _mel_s(shared_xy: Floats, true_xy: Floats, t: Floats, epsilon_m: float) -> float:
    return float(_alone(shared_xy, true_xy, t, epsilon_m).mel_s[0])


def _exposure(
    shared_xy: Floats, true_xy: Floats, t: Floats, offsets: Ints, epsilon_m: float
) -> tuple[Floats, Floats, Floats]:
    found = _leakage(shared_xy, true_xy, t, offsets, epsilon_m)
    return found.plr, found.ael_s, found.mel_s


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


OWN = Metrics(
    plr=_plr,
    ael_s=_ael_s,
    mel_s=_mel_s,
    exposure=_exposure,
    prediction_grid=_prediction_grid,
    robot_path=_robot_path,
    minimum_separation=_minimum_separation,
    is_conflict=lambda separation_m, safety_radius_m: bool(
        conflict.is_conflict(
            separation_m=np.array([separation_m]), safety_radius_m=safety_radius_m
        )[0]
    ),
    missed_conflict_rate=lambda true, predicted: conflict.missed_conflict_rate(
        conflict=true, predicted=predicted
    ),
    false_alarm_rate=lambda true, predicted: conflict.false_alarm_rate(
        conflict=true, predicted=predicted
    ),
    distance_mae_m=lambda true_m, predicted_m: conflict.distance_mae_m(
        true_separation_m=true_m, predicted_separation_m=predicted_m
    ),
    fid_d_sigma=lambda fid, eta, alpha_m, beta: sharing.fid_d_sigma(
        fid=fid, eta=eta, alpha_m=alpha_m, beta=beta
    ),
)
"""Passes every check."""
