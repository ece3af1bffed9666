"""Closed forms of the steady state against a Riccati equation and simulation."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from isac_track.kalman import Batch, smooth_positions, steady
from isac_track.mechanisms.error_paths import correlated_errors
from isac_track.rng import stream

Q, DT_S, EPSILON_M = 0.057, 0.0836, 0.3


@pytest.mark.parametrize("q", [0.01, Q, 0.3])
@pytest.mark.parametrize("std_m", [0.2, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("dt_s", [DT_S, 1e-3])
def test_variances_are_those_of_the_riccati_equation(std_m, q, dt_s):
    r = std_m**2
    f = np.array([[1.0, dt_s], [0.0, 1.0]])
    noise = q * np.array([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]])
    h = np.array([[1.0, 0.0]])
    ahead = solve_discrete_are(f.T, h.T, noise, np.array([[r]]))
    now = ahead - ahead @ h.T @ h @ ahead / (ahead[0, 0] + r)
    gain = now @ f.T @ np.linalg.inv(ahead)  # Rauch-Tung-Striebel, in the long run
    later = solve_discrete_lyapunov(gain, now - gain @ ahead @ gain.T)
    options = {"variance_m2": r, "dt_s": dt_s, "q": q}
    assert steady.smoothed_variance_m2(**options) == pytest.approx(
        later[0, 0], rel=1e-5
    )
    # The limit of frequent samples lacks the newest sample: dt over the filter's time
    # constant.
    lag = dt_s * (q / (r * dt_s)) ** 0.25 / np.sqrt(2.0)
    over = steady.filtered_variance_m2(**options) / now[0, 0] - 1.0
    assert over == pytest.approx(lag, rel=0.1)


@pytest.mark.parametrize("std_m", [0.3, 1.0, 3.0])
def test_the_smoother_is_that_of_a_long_track(std_m):
    n = 4001
    t, offsets = np.arange(n) * DT_S, np.array([0, n])
    batch = Batch(t, np.zeros((n, 2)), np.full(n, std_m**2), offsets, (100.0, 10.0))
    middle = smooth_positions(batch, q=Q)[1][n // 2]
    expected = steady.smoothed_variance_m2(variance_m2=std_m**2, dt_s=DT_S, q=Q)
    assert expected == pytest.approx(middle, rel=1e-3)


@pytest.mark.parametrize("plr", [0.1, 0.5, 0.9])
def test_the_variance_that_leaves_a_plr_leaves_it(plr):
    rest = {"dt_s": DT_S, "q": Q, "epsilon_m": EPSILON_M}
    needed = steady.variance_for(plr=plr, **rest)
    assert steady.attacked_plr(variance_m2=needed, **rest) == pytest.approx(
        plr, abs=1e-12
    )


@pytest.mark.parametrize("plr", [0.0, 1.0, -0.1, float("nan")])
def test_a_plr_that_cannot_be_asked_for_is_refused(plr):
    with pytest.raises(ValueError, match="between 0 and 1"):
        steady.variance_for(plr=plr, dt_s=DT_S, q=Q, epsilon_m=EPSILON_M)


def draw_walks(motion, *, n_walks, t, rng):
    """True walks, (N, M, 2), that start anywhere: the start gives no information."""
    start = rng.uniform(-1e3, 1e3, (n_walks, 1, 2))
    if motion == "stands":
        return start + np.zeros((1, t.size, 1))
    velocity = rng.standard_normal((n_walks, 1, 2))
    if motion == "straight":
        return start + velocity * t[:, None]
    turn = rng.uniform(0.2, 2.0, (n_walks, 1)) * t
    return start + np.stack([np.cos(turn), np.sin(turn)], axis=2)


def estimates(attack, *, shared, truth, t, tau_s):
    if attack == "as shared":
        return shared
    # These attacks know every walk but for its place: no attack could know more.
    shape = truth - truth[:, :1]
    error = shared - shape
    if attack == "mean":
        return shape + error.mean(axis=1, keepdims=True)
    cov = (
        np.exp(-np.abs(t[:, None] - t) / tau_s)
        if np.isfinite(tau_s)
        else np.ones((t.size,) * 2)
    )
    weight = np.linalg.solve(cov + 1e-9 * np.eye(t.size), np.ones(t.size))
    weight /= weight.sum()
    return shape + np.einsum("m,nmd->nd", weight, error)[:, None]


@pytest.mark.parametrize("motion", ["stands", "straight", "circles"])
@pytest.mark.parametrize("tau_s", [1.0, 5.0, np.inf])
def test_no_attack_beats_the_bound_without_motion_on_average(motion, tau_s):
    rng = stream(0, "test", "bound", motion, str(tau_s))
    n_walks, t, std_m = 4000, np.arange(60) * 0.25, 0.6
    offsets = np.arange(n_walks + 1) * t.size
    truth = draw_walks(motion, n_walks=n_walks, t=t, rng=rng)
    every, slow_s = np.tile(t, n_walks), min(tau_s, 1e12)
    drawn = {"t": every, "offsets": offsets, "law": "isotropic", "rng": rng}
    errors = correlated_errors(tau_s=slow_s, **drawn).reshape(truth.shape)
    bound = steady.attacked_plr_bound(
        std_m=std_m, tau_s=tau_s, duration_s=t[-1], epsilon_m=EPSILON_M
    )
    best = 0.0
    for attack in ("as shared", "mean", "best"):
        estimate = estimates(
            attack, shared=truth + std_m * errors, truth=truth, t=t, tau_s=tau_s
        )
        known = (np.hypot(*np.moveaxis(estimate - truth, 2, 0)) <= EPSILON_M).mean(
            axis=1
        )
        assert known.mean() <= bound + 4.0 * known.std() / np.sqrt(n_walks)
        best = max(best, known.mean())
    # An attack that knows the shape of every walk comes close: the bound is tight.
    assert best >= bound - 0.03
