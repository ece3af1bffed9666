"""The level of noise of a track against a plain loop over its triples of samples."""

from itertools import pairwise

import numpy as np
import pytest

from isac_track.kalman import _linear_loops
from isac_track.noise import (
    MIN_VARIANCE_M2,
    UNKNOWN_VARIANCE_M2,
    innovation_variance_m2,
)
from isac_track.rng import stream


def ragged(*sizes, noise_m=0.4, seed=0):
    """Straight walks on irregular clocks with errors."""
    rng = stream(seed, "test", "noise", *sizes)
    t, xy = [], []
    for size in sizes:
        clock = rng.uniform(-50, 50) + rng.uniform(0.02, 0.9, size).cumsum()
        t.append(clock)
        line = rng.normal(0, 5, 2) + clock[:, None] * rng.normal(0, 1, 2)
        xy.append(line + noise_m * rng.standard_normal((size, 2)))
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    return {"t": np.concatenate(t), "xy": np.concatenate(xy), "offsets": offsets}


def scaled_squares(t, p):
    """Scaled squared errors of the line through two samples at the third, per axis."""
    scaled = []
    for k in range(2, len(t)):
        # The forecast is w1 p1 + w0 p0. With independent errors of variance r its error
        # has the variance r (1 + w1^2 + w0^2).
        w0 = -(t[k] - t[k - 1]) / (t[k - 1] - t[k - 2])
        w1 = 1.0 - w0
        errors = p[k] - (w1 * p[k - 1] + w0 * p[k - 2])
        scaled.append([error**2 / (1.0 + w1**2 + w0**2) for error in errors])
    return scaled


def by_loop(t, p):
    """Mean over triples and axes."""
    scaled = scaled_squares(t, p)
    return (
        max(float(np.mean(scaled)), MIN_VARIANCE_M2) if scaled else UNKNOWN_VARIANCE_M2
    )


def test_it_is_the_plain_loop():
    case = ragged(40, 1, 3, 2, 150, 4, 1)
    level = innovation_variance_m2(**case)
    expected = [
        by_loop(case["t"][lo:hi], case["xy"][lo:hi])
        for lo, hi in pairwise(case["offsets"])
    ]
    assert level == pytest.approx(expected, rel=1e-10)
    assert level[[1, 3, 6]].tolist() == [UNKNOWN_VARIANCE_M2] * 3


def test_by_interval_they_are_those_of_the_middle_samples():
    case = ragged(40, 1, 3, 2, 150, 4, 1)
    interval_s = np.diff(case["t"])
    # An interval equal to an edge belongs to the cell at its right.
    edges = np.sort([interval_s[10], interval_s[100], interval_s[20]])
    expected = np.zeros((2, 7, 4))
    for row, (lo, hi) in enumerate(pairwise(case["offsets"])):
        t = case["t"][lo:hi]
        for k, errors in enumerate(scaled_squares(t, case["xy"][lo:hi]), start=2):
            cell = sum(edge <= t[k - 1] - t[k - 2] for edge in edges)
            expected[:, row, cell] += 1.0, sum(errors)
    count, total = np.zeros((2, 7, 4))
    _linear_loops.innovations_by_interval(*case.values(), edges, count, total)
    assert (expected[0].sum(axis=0) > 0).all()
    np.testing.assert_array_equal(count, expected[0])
    np.testing.assert_allclose(total, expected[1], rtol=1e-10)


def test_irregular_steps_leave_it_unbiased():
    # 200 tracks of 100 samples: standard error below 1 %.
    case = ragged(*[100] * 200, noise_m=0.7)
    assert innovation_variance_m2(**case).mean() == pytest.approx(0.49, rel=0.03)


def test_a_straight_walk_without_error_has_the_least_level():
    assert innovation_variance_m2(**ragged(20, noise_m=0.0)).tolist() == [
        MIN_VARIANCE_M2
    ]


def test_neighbours_frame_and_clock_change_nothing():
    case = ragged(30, 3, 60)
    expected_level = innovation_variance_m2(**case)
    for row, (lo, hi) in enumerate(pairwise(case["offsets"])):
        single_level = innovation_variance_m2(
            t=case["t"][lo:hi], xy=case["xy"][lo:hi], offsets=np.array([0, hi - lo])
        )
        assert single_level.tolist() == [expected_level[row]]
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    moved = innovation_variance_m2(
        t=case["t"] + 3600.0,
        xy=case["xy"] @ turn.T + [500.0, -9.0],
        offsets=case["offsets"],
    )
    assert moved == pytest.approx(expected_level, rel=1e-6)


def test_the_running_level_is_that_of_the_samples_so_far():
    case = ragged(30, 1, 2, 3, 60)
    level = innovation_variance_m2(**case, running=True)
    for lo, hi in pairwise(case["offsets"]):
        for end in range(lo + 1, hi + 1):
            start = {name: case[name][lo:end] for name in ("t", "xy")}
            single_level = innovation_variance_m2(
                **start, offsets=np.array([0, end - lo])
            )
            assert level[end - 1] == pytest.approx(single_level[0], rel=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"xy": np.zeros((6, 2))}, r"xy must have shape \(7, 2\)"),
        ({"xy": np.full((7, 2), np.nan)}, "xy must be finite"),
        ({"t": np.zeros(7)}, "strictly increasing"),
        ({"t": np.r_[np.arange(6.0), np.inf]}, "must be finite"),
        ({"offsets": np.array([0, 4, 4, 7])}, "at least one sample"),
        ({"offsets": np.array([0, 5])}, "from 0 to 7"),
        ({"offsets": np.array([0.0, 7.0])}, "integers"),
    ],
)
def test_wrong_arrays_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        innovation_variance_m2(**ragged(4, 3) | change)
