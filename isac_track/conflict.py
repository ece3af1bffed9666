"""The robot's task: its path, the conflict rule, and the rates of wrong decisions."""

import numpy as np
from scipy.special import ndtr

from isac_track.types import Bools, Floats, Ints, squared_lengths

__all__ = ["conflict_probability", "count_steps", "disc_probability", "distance_mae_m"]
__all__ += ["false_alarm_rate", "is_conflict", "minimum_separation"]
__all__ += ["missed_conflict_rate", "missed_future_rate", "prediction_grid"]
__all__ += ["robot_path", "seconds_grid", "time_to_conflict_s"]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_SMALLEST_STD_M = 1e-3
_REACH_STD = 6.0


def prediction_grid(
    *, t: Floats, offsets: Ints, window: int, horizon_steps: int
) -> Floats:
    """Return the future timestamps of each track (eq. future_time_grid).

    Step h lies h mean intervals after the last sample; the mean is over the last
    `window` samples (q of the paper, at least 2), or all of a shorter track. `t` is
    (M,) s, `offsets` (N + 1,), and the grid (N, H) s, `horizon_steps` at least 1.
    ValueError otherwise, or for a single sample.

    Examples
    --------
    Samples 0.5 s apart; step 0 is the last of them:

    >>> import numpy as np
    >>> from isac_track.conflict import prediction_grid
    >>> times = np.array([0.0, 0.5, 1.0])
    >>> prediction_grid(t=times, offsets=np.array([0, 3]), window=3, horizon_steps=4)
    array([[1. , 1.5, 2. , 2.5]])
    """
    if window < 2 or horizon_steps < 1:  # noqa: PLR2004 - an interval needs two samples
        raise ValueError("the window must be at least 2 samples and the horizon 1 step")
    last = offsets[1:] - 1
    used = np.minimum(np.diff(offsets), window)
    if (used < 2).any():  # noqa: PLR2004 - a line needs two
        raise ValueError("a track of one sample has no sampling interval to predict on")
    interval_s = (t[last] - t[last - used + 1]) / (used - 1)
    return np.asarray(t[last][:, None] + np.arange(horizon_steps) * interval_s[:, None])


def seconds_grid(
    *, t: Floats, offsets: Ints, window: int, horizon_s: float
) -> tuple[Floats, Ints]:
    """Return the future timestamps of each track up to a horizon, and their number.

    The grid is that of `prediction_grid` with 1 + round(`horizon_s` / mean interval)
    steps, at least 2. Tracks differ in their interval: a shorter grid repeats its last
    instant, which changes neither the smallest separation nor the label. Returns the
    grid, (N, H) s, and the number of distinct steps of each track, (N,). Raises as
    `prediction_grid`.
    """
    first = prediction_grid(t=t, offsets=offsets, window=window, horizon_steps=2)
    interval_s = first[:, 1] - first[:, 0]
    n_steps = 1 + np.maximum(np.rint(horizon_s / interval_s).astype(np.int64), 1)
    grid = prediction_grid(
        t=t, offsets=offsets, window=window, horizon_steps=int(n_steps.max())
    )
    last = np.minimum(np.arange(grid.shape[1]), n_steps[:, None] - 1)
    return np.take_along_axis(grid, last, axis=1), n_steps


def count_steps(grid: Floats) -> Ints:
    """Count the distinct steps of each row of a grid of future times, (N, H) s."""
    return np.asarray(1 + (np.diff(grid, axis=1) > 0).sum(axis=1))


def robot_path(
    *, start: Floats, destination: Floats, speed_mps: float, elapsed_s: Floats
) -> Floats:
    """Return the robot's nominal positions (eq. robot_nominal_path).

    It walks straight to its destination at constant speed and waits there. `start` and
    `destination`, (S, 2) m, must differ (ValueError); `elapsed_s`, (S, A, H) s, is the
    time since now on the clock of each of A agents. The positions are (S, A, H, 2) m.
    """
    way = destination - start
    length: Floats = np.hypot(way[:, 0], way[:, 1])
    if not (length > 0).all():
        raise ValueError("a robot's destination must differ from its start")
    heading = way / length[:, None]
    travelled: Floats = np.minimum(speed_mps * elapsed_s, length[:, None, None])
    return np.asarray(
        start[:, None, None, :] + travelled[..., None] * heading[:, None, None, :]
    )


def minimum_separation(*, robot: Floats, agents: Floats) -> Floats:
    """Return the smallest time-aligned distance of each scene, (S,) m.

    The minimum is over all agents and steps (eq. conflict_rule). `robot` and `agents`
    are (S, A, H, 2) m; other shapes are a ValueError.

    Examples
    --------
    A scene with one agent and two steps, at distances of 5 m and of 1 m:

    >>> import numpy as np
    >>> from isac_track.conflict import is_conflict, minimum_separation
    >>> robot = np.array([[[[0.0, 0.0], [1.0, 0.0]]]])
    >>> agents = np.array([[[[3.0, 4.0], [1.0, 1.0]]]])
    >>> separation_m = minimum_separation(robot=robot, agents=agents)
    >>> separation_m
    array([1.])
    >>> is_conflict(separation_m=separation_m, safety_radius_m=0.9)
    array([False])
    """
    if robot.shape != agents.shape:
        raise ValueError(
            f"robot {robot.shape} and agents {agents.shape} must have one shape"
        )
    return np.asarray(np.sqrt(squared_lengths(robot - agents).min(axis=(1, 2))))


def is_conflict(*, separation_m: Floats, safety_radius_m: float) -> Bools:
    """Return which scenes are in conflict, (S,): strictly inside (eq. conflict_rule).

    `separation_m` is (S,) m, from `minimum_separation`.
    """
    decision: Bools = separation_m < safety_radius_m
    return decision


def time_to_conflict_s(
    *, robot: Floats, agents: Floats, elapsed_s: Floats, safety_radius_m: float
) -> Floats:
    """Return after how long any agent of a scene is inside the safety radius, (S,) s.

    `robot` and `agents` are (S, A, H, 2) m, `elapsed_s`, (S, A, H) s, rises from 0,
    which is now. The result is 0 if an agent is inside already, and NaN if no agent
    comes inside within the horizon. ValueError if shapes differ.
    """
    if robot.shape != agents.shape or robot.shape[:3] != elapsed_s.shape:
        raise ValueError(
            f"robot {robot.shape}, agents {agents.shape} and times {elapsed_s.shape}"
            " must have one shape"
        )
    # The distance is computed as in `minimum_separation`, so that both agree.
    distance_m = np.sqrt(squared_lengths(robot - agents))
    inside = is_conflict(separation_m=distance_m, safety_radius_m=safety_radius_m)
    first_s = np.where(inside, elapsed_s, np.inf).min(axis=(1, 2))
    return np.asarray(np.where(np.isinf(first_s), np.nan, first_s))


def disc_probability(*, mean: Floats, cov: Floats, radius_m: float) -> Floats:
    """Return the probability of a planar Gaussian in a disc around the origin, (...,).

    `mean` is (..., 2) m, `cov` (..., 2, 2) m^2. One axis is integrated by quadrature
    (Gauss-Legendre in the angle, 16 nodes), the other in closed form. Standard
    deviations below 1 mm count as 1 mm.

    Examples
    --------
    With a standard deviation of 1 m on each axis, around the centre of a disc of 1 m,
    it is 1 - exp(-1/2):

    >>> import numpy as np
    >>> from isac_track.conflict import disc_probability
    >>> round(float(disc_probability(mean=np.zeros(2), cov=np.eye(2), radius_m=1.0)), 4)
    0.3935
    """
    # Quadrature along the wide axis; the closed form is exact across, where the
    # density is sharp.
    half_trace = 0.5 * (cov[..., 0, 0] + cov[..., 1, 1])
    half_gap = 0.5 * (cov[..., 0, 0] - cov[..., 1, 1])
    reach = np.hypot(half_gap, cov[..., 0, 1])
    angle = 0.5 * np.arctan2(cov[..., 0, 1], half_gap)
    cos, sin = np.cos(angle), np.sin(angle)
    wide_m = np.sqrt(np.maximum(half_trace + reach, _SMALLEST_STD_M**2))
    narrow_m = np.sqrt(np.maximum(half_trace - reach, _SMALLEST_STD_M**2))
    along = cos * mean[..., 0] + sin * mean[..., 1]
    across = cos * mean[..., 1] - sin * mean[..., 0]
    # Only where the wide axis has mass: a narrow Gaussian would fall between fixed
    # nodes.
    low = np.clip((along - 5.0 * wide_m) / radius_m, -1.0, 1.0)
    high = np.clip((along + 5.0 * wide_m) / radius_m, -1.0, 1.0)
    first, last = np.arcsin(low), np.arcsin(high)
    total = np.zeros_like(along)
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        theta = first + 0.5 * (node + 1.0) * (last - first)
        x = radius_m * np.sin(theta)
        half_chord = radius_m * np.cos(theta)
        density = np.exp(-0.5 * ((x - along) / wide_m) ** 2) / (
            np.sqrt(2.0 * np.pi) * wide_m
        )
        inside = ndtr((half_chord - across) / narrow_m) - ndtr(
            (-half_chord - across) / narrow_m
        )
        total += weight * density * inside * half_chord
    probability: Floats = np.clip(0.5 * (last - first) * total, 0.0, 1.0)
    return probability


def conflict_probability(
    *, robot: Floats, mean: Floats, cov: Floats, radius_m: float
) -> Floats:
    """Return the probability of a conflict in each scene, (S,).

    `robot` and `mean` are (S, A, H, 2) m, `cov` is (S, A, H, 2, 2) m^2. The probability
    of an agent is that of the step where it is likeliest to lie within the safety
    radius. The steps share one velocity error and are nearly one event: the maximum is
    a close lower bound for the whole horizon, while a product over the steps would
    count one encounter twelve times. Agents are independent; a distance beyond 6 std
    counts as 0.
    """
    gap = mean - robot
    distance_m = np.sqrt(squared_lengths(gap))
    widest_m = np.sqrt(
        np.maximum(np.trace(cov, axis1=-2, axis2=-1), _SMALLEST_STD_M**2)
    )
    near = distance_m < radius_m + _REACH_STD * widest_m
    # The disc lies on one side of its tangent, whose half-plane has a probability in
    # closed form: an upper bound. Only steps that might be the likeliest by this bound
    # are integrated: first the box with the highest bound, which few others beat.
    x, y = np.moveaxis(gap, -1, 0) / np.maximum(distance_m, _SMALLEST_STD_M)
    variance = (
        x * x * cov[..., 0, 0] + 2.0 * x * y * cov[..., 0, 1] + y * y * cov[..., 1, 1]
    )
    std_m = np.sqrt(np.maximum(variance, 0.0) + _SMALLEST_STD_M**2)
    bound = np.where(near, ndtr((radius_m - distance_m) / std_m), 0.0)
    step = np.zeros(near.shape)
    best = near & (bound == bound.max(axis=2, keepdims=True))
    step[best] = disc_probability(mean=gap[best], cov=cov[best], radius_m=radius_m)
    # The quadrature errs by less than a tenth.
    rest = near & ~best & (bound > 0.9 * step.max(axis=2, keepdims=True))
    step[rest] = disc_probability(mean=gap[rest], cov=cov[rest], radius_m=radius_m)
    return np.asarray(1.0 - np.prod(1.0 - step.max(axis=2), axis=1))


def missed_conflict_rate(*, conflict: Bools, predicted: Bools) -> float:
    """Return the share of true conflicts that were not predicted; NaN without any.

    `conflict` and `predicted` are (S,) decisions; ValueError if their shapes differ.

    Examples
    --------
    Of three conflicts one is missed:

    >>> import numpy as np
    >>> from isac_track.conflict import missed_conflict_rate
    >>> missed_conflict_rate(
    ...     conflict=np.array([True, True, True, False]),
    ...     predicted=np.array([True, False, True, True]),
    ... )
    0.333...
    """
    return _share(~predicted, among=conflict)


def missed_future_rate(
    *, conflict: Bools, inside_now: Bools, predicted: Bools
) -> float:
    """Return the missed share of conflicts that are still to come; NaN without any.

    Scenes where an agent is `inside_now`, within the safety radius at step 0, are left
    out. All arguments are (S,); ValueError if their shapes differ.
    """
    if inside_now.shape != conflict.shape:
        raise ValueError("conflict and inside_now must have one shape")
    return _share(~predicted, among=conflict & ~inside_now)


def false_alarm_rate(*, conflict: Bools, predicted: Bools) -> float:
    """Return the share of conflict-free scenes with a predicted conflict.

    NaN without such scenes. `conflict` and `predicted` are (S,); ValueError if their
    shapes differ.
    """
    return _share(predicted, among=~conflict)


def distance_mae_m(
    *, true_separation_m: Floats, predicted_separation_m: Floats
) -> float:
    """Return the mean absolute error of separations, (N,) m each; NaN if N is 0.

    ValueError if the shapes differ.
    """
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
