"""Checks of the robot's task (eqs. future_time_grid to conflict_rule) and FID rule."""

from itertools import pairwise
from math import dist, exp, inf, nan

import numpy as np
from numpy.random import Generator

from isac_track.testing._metrics import (
    Function,
    check,
    expect,
    expect_call,
    expect_that,
    show,
)
from isac_track.types import Floats


@check
def grid_starts_now(prediction_grid: Function) -> None:
    """Step 0 is the last sample, step h lies h mean intervals of the window later."""
    t = np.array([0.0, 7.0, 8.0, 10.0])
    for window, grid in (
        (2, [10, 12, 14]),
        (3, [10, 11.5, 13]),
        (4, [10, 40 / 3, 50 / 3]),
    ):
        expect_call(prediction_grid, t, window, 3, gives=grid)


@check
def grid_of_a_short_track(prediction_grid: Function) -> None:
    """A track shorter than the window uses all of its samples."""
    t = np.array([1.0, 2.0, 4.0])
    expect_call(prediction_grid, t, 16, 4, gives=[4.0, 5.5, 7.0, 8.5])


@check
def grid_matches_brute_force(prediction_grid: Function, rng: Generator) -> None:
    """The grid equals its equation on random, irregular times."""
    t = rng.uniform(-9, 9) + np.cumsum(rng.uniform(0.02, 0.5, int(rng.integers(2, 30))))
    window, steps = int(rng.integers(2, 20)), int(rng.integers(1, 13))
    gaps = [later - earlier for earlier, later in pairwise(t[-window:])]
    grid = [t[-1] + h * sum(gaps) / len(gaps) for h in range(steps)]
    expect_call(prediction_grid, t, window, steps, gives=grid)


@check
def path_walks_then_waits(robot_path: Function) -> None:
    """The robot walks straight at its speed, and waits at its destination."""
    start, destination = np.array([1.0, 1.0]), np.array([4.0, 5.0])  # 5 m apart
    elapsed_s = np.array([0.0, 1.0, 2.5, 4.0, 100.0])
    path = [[1, 1], [2.2, 2.6], [4, 5], [4, 5], [4, 5]]
    expect_call(robot_path, start, destination, 2.0, elapsed_s, gives=path)


@check
def path_matches_brute_force(robot_path: Function, rng: Generator) -> None:
    """The path equals its equation for random starts, destinations and clocks."""
    start, destination = rng.uniform(-5, 5, 2), rng.uniform(-5, 5, 2)
    speed_mps, step_s = float(rng.uniform(0.2, 3)), float(rng.uniform(0.05, 1))
    way_m = dist(start, destination)
    shares = (min(speed_mps * h * step_s, way_m) / way_m for h in range(12))
    path = [start + share * (destination - start) for share in shares]
    elapsed_s = step_s * np.arange(12.0)
    expect_call(robot_path, start, destination, speed_mps, elapsed_s, gives=path)


@check
def separation_hand_examples(minimum_separation: Function) -> None:
    """The separation is the smallest distance at equal steps, not between curves."""
    robot = np.array([[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]])
    # It stands where the robot was a step before: on its curve, never closer than 1 m.
    follower = np.array([[[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0]]])
    expect_call(minimum_separation, robot, follower, gives=1.0)
    # A second agent passes at 0.5 m at step 1.
    agents = np.concatenate([follower, [[[9.0, 9.0], [1.3, 0.4], [9.0, 9.0]]]])
    expect_call(minimum_separation, np.concatenate([robot, robot]), agents, gives=0.5)


@check
def separation_matches_brute_force(
    minimum_separation: Function, rng: Generator
) -> None:
    """The separation equals the minimum over all agents and steps."""
    robot, agents = _scene(rng)
    pairs = zip(robot.reshape(-1, 2), agents.reshape(-1, 2), strict=True)
    expect_call(
        minimum_separation, robot, agents, gives=min(dist(a, b) for a, b in pairs)
    )


@check
def separation_symmetries(minimum_separation: Function, rng: Generator) -> None:
    """The separation ignores rigid motion, the order of agents, and exchanged roles."""
    turn = np.array([[0.6, 0.8], [0.8, -0.6]])
    robot, agents = _scene(rng)
    value = minimum_separation(robot, agents)
    case = f"robot {show(robot)}, {show(agents)} m"
    for change, arguments in (
        ("after a rigid motion", (robot @ turn + 7.0, agents @ turn + 7.0)),
        ("with the agents in reverse", (robot[::-1], agents[::-1])),
        ("with the roles exchanged", (agents, robot)),
    ):
        expect(
            minimum_separation(*arguments),
            value,
            label=f"the separation {change}",
            case=case,
        )


@check
def conflict_boundary_is_strict(is_conflict: Function) -> None:
    """At exactly the safety radius there is no conflict."""
    below, above = float(np.nextafter(0.9, 0.0)), float(np.nextafter(0.9, 1.0))
    for separation_m in (0.0, 0.5, below, 0.9, above, 5.0):
        expect_call(is_conflict, separation_m, 0.9, gives=separation_m <= below)


@check
def missed_rate_hand_examples(missed_conflict_rate: Function) -> None:
    """The missed rate is the share of true conflicts that were not predicted."""
    examples = {
        "1110 1000": 2 / 3,
        "1100 1111": 0.0,
        "1111 0000": 1.0,
        "0000 1010": nan,
    }
    _expect_rates(missed_conflict_rate, examples | {"10000000 00000000": 1.0})


@check
def false_alarm_rate_hand_examples(false_alarm_rate: Function) -> None:
    """The false-alarm rate is the share of conflict-free scenes with an alarm."""
    examples = {
        "1000 1011": 2 / 3,
        "1100 1100": 0.0,
        "0000 1111": 1.0,
        "1111 0101": nan,
    }
    _expect_rates(false_alarm_rate, examples | {"01111111 10000000": 1.0})


@check
def missed_rate_matches_brute_force(
    missed_conflict_rate: Function, rng: Generator
) -> None:
    """The missed rate equals the count on random scenes, over true conflicts only."""
    _expect_wrong_share(missed_conflict_rate, rng, truth=True)


@check
def false_alarm_rate_matches_brute_force(
    false_alarm_rate: Function, rng: Generator
) -> None:
    """The false-alarm rate equals the count on random conflict-free scenes."""
    _expect_wrong_share(false_alarm_rate, rng, truth=False)


@check
def distance_mae_hand_examples(distance_mae_m: Function) -> None:
    """The distance MAE is the mean absolute error; opposite signs do not cancel."""
    true_m = np.array([1.0, 2.0, 3.0, 0.0])
    expect_call(distance_mae_m, true_m, np.array([1.5, 1.0, 3.0, 0.5]), gives=0.5)
    expect_call(distance_mae_m, np.array([]), np.array([]), gives=nan)


@check
def distance_mae_matches_brute_force(distance_mae_m: Function, rng: Generator) -> None:
    """The distance MAE equals the sum over scenes, and is symmetric."""
    true_m, predicted_m = rng.exponential(1.0, (2, int(rng.integers(1, 12))))
    mean = sum(abs(a - b) for a, b in zip(true_m, predicted_m, strict=True)) / len(
        true_m
    )
    expect_call(distance_mae_m, true_m, predicted_m, gives=mean)
    expect_call(distance_mae_m, predicted_m, true_m, gives=mean)


@check
def fid_rule_hand_examples(fid_d_sigma: Function) -> None:
    """0 to rho 1, alpha (beta - 1) above, alpha (beta - 1/e) at 2, then alpha beta."""
    fid = np.array([0.0, 4.0, 8.0, float(np.nextafter(8.0, 9.0)), 16.0, 1e300, inf])
    expected = [0.0, 0.0, 0.0, 0.25, 0.5 * (1.5 - exp(-1.0)), 0.75, 0.75]
    expect_call(fid_d_sigma, fid, 8.0, 0.5, 1.5, gives=expected)


@check
def fid_rule_matches_brute_force(fid_d_sigma: Function, rng: Generator) -> None:
    """The rule equals its equation sample by sample, whatever the parameters."""
    eta = float(10.0 ** rng.uniform(-2, 6))
    alpha_m, beta = float(rng.uniform(0, 2)), float(rng.uniform(1, 3))
    fid = eta * 10.0 ** rng.uniform(-2, 2, int(rng.integers(1, 20)))
    rho = (fid / eta).tolist()
    expected = [
        0.0 if ratio <= 1 else alpha_m * (beta - exp(-(ratio - 1))) for ratio in rho
    ]
    expect_call(fid_d_sigma, fid, eta, alpha_m, beta, gives=expected)


@check
def fid_rule_monotone(fid_d_sigma: Function) -> None:
    """More information never gets less error, a higher threshold never more."""
    fid, etas = np.geomspace(0.1, 1e5, 200), (0.5, 5.0, 50.0, 500.0)
    d_sigma = np.stack([fid_d_sigma(fid, eta, 0.5, 1.5) for eta in etas])
    case = f"fid from 0.1 to 1e5, eta {etas}, alpha 0.5 m, beta 1.5"
    expect_that(
        (np.diff(d_sigma, axis=1) >= 0).all(),
        failure="d_sigma falls with fid",
        case=case,
    )
    expect_that(
        (np.diff(d_sigma, axis=0) <= 0).all(),
        failure="d_sigma grows with eta",
        case=case,
    )


def _expect_rates(rate_function: Function, examples: dict[str, float]) -> None:
    """Compare rates; each example marks scenes in conflict, then those predicted."""
    for text, rate in examples.items():
        conflict, predicted = (
            np.array([scene == "1" for scene in flags]) for flags in text.split()
        )
        expect_call(rate_function, conflict, predicted, gives=rate)


def _expect_wrong_share(
    rate_function: Function, rng: Generator, *, truth: bool
) -> None:
    size = int(rng.integers(1, 15))
    conflict = rng.random(size) < rng.random()
    predicted = rng.random(size) < rng.random()
    decided = predicted[conflict == truth].tolist()
    rate = decided.count(not truth) / len(decided) if decided else nan
    expect_call(rate_function, conflict, predicted, gives=rate)


def _scene(rng: Generator) -> tuple[Floats, Floats]:
    shape = (int(rng.integers(1, 5)), int(rng.integers(1, 13)), 2)
    return rng.uniform(-4, 4, shape), rng.uniform(-4, 4, shape)
