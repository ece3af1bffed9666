"""The filter of many tracks against filterpy's, and mixtures against plain sums."""

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter

from isac_track.rng import stream
from isac_track.tracking.filters import (
    first_states,
    inverse,
    join_states,
    mix_states,
    predict,
    update,
)

Q, STEPS_S = 0.3, (0.1, 0.25, 0.1, 0.4)


def draw_points(*names, n):
    """Places and covariances of n detections."""
    rng = stream(1, *names)
    root = rng.normal(size=(n, 2, 2))
    return rng.normal(size=(n, 2)), root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(2)


def by_filterpy(places, covs):
    """State (x, y, vx, vy) and covariance of a single track after all detections."""
    kf = KalmanFilter(dim_x=4, dim_z=2)
    kf.x = np.array([*places[0], 0.0, 0.0])
    kf.P = np.diag([0.0, 0.0, 1.5**2, 1.5**2])
    kf.P[:2, :2] = covs[0]
    kf.H = np.eye(2, 4)
    for step_s, place, cov in zip(STEPS_S, places[1:], covs[1:], strict=True):
        kf.F = np.eye(4) + step_s * np.eye(4, k=2)
        # filterpy orders (x, vx, y, vy).
        noise = Q_continuous_white_noise(2, step_s, Q, block_size=2)
        order = [0, 2, 1, 3]
        kf.Q = noise[np.ix_(order, order)]
        kf.predict()
        kf.update(place, R=cov)
    return kf.x, kf.P


def test_many_tracks_are_filtered_as_filterpy_filters_each():
    n_tracks = 3
    scans = [draw_points("scan", k, n=n_tracks) for k in range(len(STEPS_S) + 1)]
    states = first_states(xy=scans[0][0], cov=scans[0][1], speed_std_mps=1.5)
    for step_s, (xy, cov) in zip(STEPS_S, scans[1:], strict=True):
        states = update(predict(states, step_s=step_s, q=Q), xy=xy, cov=cov)
    for track in range(n_tracks):
        x, p = by_filterpy(
            [xy[track] for xy, _ in scans], [cov[track] for _, cov in scans]
        )
        np.testing.assert_allclose(states.position[track], x[:2])
        np.testing.assert_allclose(states.velocity[track], x[2:])
        np.testing.assert_allclose(states.pp[track], p[:2, :2], atol=1e-12)
        np.testing.assert_allclose(states.pv[track], p[:2, 2:], atol=1e-12)
        np.testing.assert_allclose(states.vv[track], p[2:, 2:], atol=1e-12)


def test_predictions_compose_over_steps():
    xy, cov = draw_points("compose", n=2)
    states = first_states(xy=xy, cov=cov, speed_std_mps=1.0)
    twice = predict(predict(states, step_s=0.3, q=Q), step_s=0.2, q=Q)
    whole = predict(states, step_s=0.5, q=Q)
    for name in ("position", "velocity", "pp", "pv", "vv"):
        np.testing.assert_allclose(getattr(twice, name), getattr(whole, name))


def test_the_inverse_is_numpys():
    _, cov = draw_points("inverse", n=5)
    np.testing.assert_allclose(inverse(cov), np.linalg.inv(cov))


def test_a_mixture_has_the_moments_of_its_components():
    parts = []
    for number in range(2):
        xy, cov = draw_points("mixture", number, n=3)
        parts.append(
            predict(first_states(xy=xy, cov=cov, speed_std_mps=1.0), step_s=1.0, q=Q)
        )
    weight = np.array([0.2, 0.5, 1.0, 0.8, 0.5, 0.0])
    mixed = mix_states(
        join_states(*parts), track=np.tile([0, 1, 2], 2), n_tracks=3, weight=weight
    )
    np.testing.assert_allclose(mixed.position[2], parts[0].position[2])
    w = (0.2, 0.8)
    mean = sum(share * part.position[0] for share, part in zip(w, parts, strict=True))
    second = sum(
        share * (part.pp[0] + np.outer(part.position[0], part.position[0]))
        for share, part in zip(w, parts, strict=True)
    )
    np.testing.assert_allclose(mixed.position[0], mean)
    np.testing.assert_allclose(mixed.pp[0], second - np.outer(mean, mean))
    crossed = sum(
        share * (part.pv[0] + np.outer(part.position[0], part.velocity[0]))
        for share, part in zip(w, parts, strict=True)
    )
    speed = sum(share * part.velocity[0] for share, part in zip(w, parts, strict=True))
    np.testing.assert_allclose(mixed.pv[0], crossed - np.outer(mean, speed))
    assert mixed.vv[0].trace() >= 0.2 * parts[0].vv[0].trace()


@pytest.mark.parametrize("gap_m", [0.0, 3.0])
def test_the_spread_of_a_mixture_counts(gap_m):
    xy = np.array([[0.0, 0.0], [gap_m, 0.0]])
    states = first_states(xy=xy, cov=np.tile(np.eye(2), (2, 1, 1)), speed_std_mps=1.0)
    mixed = mix_states(
        states, track=np.zeros(2, dtype=int), n_tracks=1, weight=np.full(2, 0.5)
    )
    assert mixed.pp[0, 0, 0] == pytest.approx(1.0 + gap_m**2 / 4.0)
