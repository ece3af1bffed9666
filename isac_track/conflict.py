"""The robot's task: its path, the conflict rule, and how often a shared track misleads it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from isac_track.types import Bools, Floats, Ints


def prediction_grid(*, t: Floats, offsets: Ints, window: int, horizon_steps: int) -> Floats:
    """Return the future timestamps of each track (eq. future_time_grid).

    Step h lies h mean intervals after the last sample; the mean is taken over the last
    `window` samples, or over all where a track has fewer.

    Parameters
    ----------
    t : (M,) s
    offsets : (N + 1,) int
    window : int
        q of the paper, at least 2.
    horizon_steps : int
        H of the paper.

    Returns
    -------
    (N, H) s

    Raises
    ------
    ValueError
        If the window is below 2, the horizon below 1, or a track has a single sample.
    """
    if window < 2 or horizon_steps < 1:  # noqa: PLR2004 - an interval needs two samples
        raise ValueError("the window must be at least 2 samples and the horizon 1 step")
    last = offsets[1:] - 1
    used = np.minimum(np.diff(offsets), window)
    if (used < 2).any():  # noqa: PLR2004
        raise ValueError("a track of one sample has no sampling interval to predict on")
    interval_s = (t[last] - t[last - used + 1]) / (used - 1)
    grid: Floats = t[last][:, None] + np.arange(horizon_steps) * interval_s[:, None]
    return grid


def robot_path(
    *, start: Floats, destination: Floats, speed_mps: float, elapsed_s: Floats
) -> Floats:
    """Return the robot's nominal positions (eq. robot_nominal_path).

    It walks straight to its destination at constant speed and waits there.

    Parameters
    ----------
    start, destination : (S, 2) m
    speed_mps : float
    elapsed_s : (S, A, H) s
        Time since now, on the clock of each of A agents: h times its mean interval.

    Returns
    -------
    (S, A, H, 2) m

    Raises
    ------
    ValueError
        If a robot's destination is its start: it has no heading.
    """
    way = destination - start
    length: Floats = np.hypot(way[:, 0], way[:, 1])
    if not (length > 0).all():
        raise ValueError("a robot's destination must differ from its start")
    heading = way / length[:, None]
    travelled: Floats = np.minimum(speed_mps * elapsed_s, length[:, None, None])
    path: Floats = start[:, None, None, :] + travelled[..., None] * heading[:, None, None, :]
    return path


def minimum_separation(*, robot: Floats, agents: Floats) -> Floats:
    """Return the smallest time-aligned distance over all agents and steps of each scene.

    Parameters
    ----------
    robot, agents : (S, A, H, 2) m

    Returns
    -------
    (S,) m

    Raises
    ------
    ValueError
        If the shapes differ.
    """
    if robot.shape != agents.shape:
        raise ValueError(f"robot {robot.shape} and agents {agents.shape} must have one shape")
    gap = robot - agents
    distance: Floats = np.hypot(gap[..., 0], gap[..., 1])
    nearest: Floats = distance.min(axis=(1, 2))
    return nearest


def is_conflict(*, separation_m: Floats, safety_radius_m: float) -> Bools:
    """Return the conflict decision of each scene: strictly inside (eq. conflict_rule)."""
    decision: Bools = separation_m < safety_radius_m
    return decision


def missed_conflict_rate(*, conflict: Bools, predicted: Bools) -> float:
    """Return the share of true conflicts that were not predicted; NaN without a conflict."""
    return _share(~predicted, among=conflict)


def false_alarm_rate(*, conflict: Bools, predicted: Bools) -> float:
    """Return the share of conflict-free scenes with a predicted conflict; NaN without one."""
    return _share(predicted, among=~conflict)


def distance_mae_m(*, true_separation_m: Floats, predicted_separation_m: Floats) -> float:
    """Return the mean absolute error of the minimum separation, m; NaN without a scene."""
    if true_separation_m.shape != predicted_separation_m.shape:
        raise ValueError("true and predicted separations must have one shape")
    if true_separation_m.size == 0:
        return float("nan")
    return float(np.abs(predicted_separation_m - true_separation_m).mean())


def _share(hits: Bools, *, among: Bools) -> float:
    if hits.shape != among.shape:
        raise ValueError("conflict and predicted must have one shape")
    count = int(among.sum())
    return float((hits & among).sum() / count) if count else float("nan")
