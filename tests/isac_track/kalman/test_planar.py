"""Filters and smoothers of errors with a shape: filterpy, dense solutions, round ones."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import kernel_oracles as oracle
from helpers.kalman_cases import PRIOR_STD, Q, batch, track_by_track
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from isac_track import kalman
from isac_track.kalman.slow_errors import (
    Motions,
    SlowError,
    filter_tracks,
    motion_log_likelihoods,
    smooth_each,
    smooth_mixture,
    smooth_tracks,
)
from isac_track.measurement import error_ellipses
from predictors.filterpy_engine import last_modes, planar_states

WALKING = Motions.with_speeds((0.2, 2.0), (1.0, 16.0))
WHITE = SlowError(0.0, 0.0)
MOODS = kalman.Moods((0.1, 1.0), (4.0, 1.5))


def elliptic(case, *, seed=1):
    """The batch with ellipses in all directions, their axes up to 10 to 1."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0.0, np.pi, case.t.size)
    axes = np.stack([np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)])
    factor = axes.T.reshape(-1, 2, 2) * rng.uniform(0.1, 1.0, (case.t.size, 1, 2))
    ellipse = error_ellipses(factor @ np.swapaxes(factor, 1, 2))
    return replace(case, ellipse=ellipse)


def round_ellipses(case):
    return replace(case, ellipse=np.tile(np.eye(2), (case.t.size, 1, 1)))


def prior_of_positions(t, cov):
    """Covariance of the positions of a walk on an axis, (n, n), by lifting."""
    d, n = len(cov), len(t)
    lift, noises = np.eye(n * d), [cov]
    for k, step in enumerate(np.diff(t), start=1):
        now, before = slice(k * d, (k + 1) * d), slice((k - 1) * d, k * d)
        lift[now, : k * d] = oracle.transition(step, d) @ lift[before, : k * d]
        noises.append(oracle.process_noise(step, Q, d))
    return (lift @ block_diag(*noises) @ lift.T)[::d, ::d]


def dense(t, xy, cov, variance, ellipse):
    """Positions given all samples, (n, 2), their covariance, and the log density."""
    n = len(t)
    prior = np.kron(prior_of_positions(t, cov), np.eye(2))
    noise = block_diag(*(variance[:, None, None] * ellipse))
    start = np.tile(xy[0], n)
    gain = np.linalg.solve(prior + noise, prior).T
    position = (start + gain @ (xy.ravel() - start)).reshape(n, 2)
    spread = prior - gain @ prior
    density = multivariate_normal(start, prior + noise).logpdf(xy.ravel())
    blocks = [spread[k : k + 2, k : k + 2] for k in range(0, 2 * n, 2)]
    return position, np.array(blocks), density


@pytest.mark.parametrize("prior_std", [PRIOR_STD[:2], PRIOR_STD])
@pytest.mark.parametrize("gate", [np.inf, 3.0])
def test_last_states_are_filterpy_s(prior_std, gate):
    case = elliptic(batch(prior_std=prior_std))
    ours = kalman.planar_last(case, q=Q, gate=gate)
    theirs = planar_states(case, q=Q, gate=gate)
    np.testing.assert_allclose(ours.mean, theirs.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.cov, theirs.cov, rtol=0, atol=1e-9)


@pytest.mark.parametrize("prior_std", [PRIOR_STD[:2], PRIOR_STD])
def test_last_positions_and_density_are_those_of_the_joint_normal_law(prior_std):
    case = elliptic(batch(prior_std=prior_std))
    state = kalman.planar_last(case, q=Q)
    for row, (rows, track) in enumerate(track_by_track(case)):
        position, spread, density = dense(
            track["t"], track["xy"], track["cov"], track["variance"], case.ellipse[rows]
        )
        np.testing.assert_allclose(state.mean[row, :, 0], position[-1], atol=1e-9)
        np.testing.assert_allclose(state.cov[row, :, 0, :, 0], spread[-1], atol=1e-9)
        assert state.log_likelihood[row] == pytest.approx(density, abs=1e-8)


@pytest.mark.parametrize(("passes", "anneal"), [(1, 0.0), (4, 0.15)])
def test_smoothed_positions_are_those_of_the_joint_normal_law(passes, anneal):
    """Further passes weigh a sample by its distance in units of the ellipse."""
    case = elliptic(batch(sizes=(30, 1, 5, 2)))
    xy, variance = kalman.smooth_positions(case, q=Q, passes=passes, anneal=anneal)
    for rows, track in track_by_track(case):
        ellipse, square = case.ellipse[rows], 2.0 * track["variance"]
        noise, inverse = track["variance"], np.linalg.inv(ellipse)
        for number in range(1, passes + 1):
            position, spread, _ = dense(
                track["t"], track["xy"], track["cov"], noise, ellipse
            )
            gap = track["xy"] - position
            near = np.einsum("ka,kab,kb->k", gap, inverse, gap)
            near += np.einsum("kab,kba->k", inverse, spread)
            near += anneal ** (number - 1) * square
            noise = 1.0 / (1.0 / near + 1.0 / square)
        np.testing.assert_allclose(xy[rows], position, rtol=0, atol=1e-8)
        mean = np.trace(spread, axis1=1, axis2=2) / 2.0
        np.testing.assert_allclose(variance[rows], mean, rtol=1e-8)


def test_round_ellipses_change_nothing():
    for prior_std in (PRIOR_STD[:2], PRIOR_STD):
        case = batch(prior_std=prior_std)
        expected = kalman.kalman_last(case, q=Q, gate=5.0)
        state = kalman.planar_last(round_ellipses(case), q=Q, gate=5.0)
        np.testing.assert_allclose(state.mean, expected.mean, atol=1e-10)
        for axis in range(2):
            np.testing.assert_allclose(
                state.cov[:, axis, :, axis], expected.cov, atol=1e-10
            )
        assert not state.cov[:, 0, :, 1].any()
        np.testing.assert_allclose(state.log_likelihood, expected.log_likelihood)
    case = batch(sizes=(9, 1, 20, 4))
    weight = np.array([[0.3, 0.7], [1.0, 0.0], [0.0, 0.2], [0.5, 0.5]])
    for passes in (1, 5):
        options = {"passes": passes, "anneal": 0.15}
        for got, expected in zip(
            smooth_mixture(round_ellipses(case), WHITE, WALKING, weight, **options),
            smooth_mixture(case, WHITE, WALKING, weight, **options),
            strict=True,
        ):
            np.testing.assert_allclose(got, expected, atol=1e-10)


def test_along_fixed_principal_axes_both_are_smoothed_alone():
    case = batch(sizes=(25, 3))
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    shares = np.array([1.8, 0.2])
    ellipse = np.tile(turn * shares @ turn.T, (case.t.size, 1, 1))
    weight = np.tile([0.0, 1.0], (2, 1))
    xy, variance = smooth_mixture(
        replace(case, ellipse=ellipse), WHITE, WALKING, weight
    )
    along, spreads = np.empty_like(xy), []
    for axis in range(2):
        alone = replace(case, xy=case.xy @ turn, variance=case.variance * shares[axis])
        position, spread = smooth_mixture(alone, WHITE, WALKING, weight)
        along[:, axis] = position[:, axis]
        spreads.append(spread)
    np.testing.assert_allclose(xy, along @ turn.T, atol=1e-10)
    np.testing.assert_allclose(variance, np.mean(spreads, axis=0), rtol=1e-9)


def test_a_vague_prior_and_a_long_ellipse_give_a_sound_result():
    case = batch(sizes=(40, 2), prior_std=(1e3, 1e2), variance=(1e-4, 1e-3))
    flat = np.tile(np.diag([2.0 - 1e-4, 1e-4]), (case.t.size, 1, 1))
    state = kalman.planar_last(replace(case, ellipse=flat), q=Q)
    values = np.linalg.eigvalsh(state.cov.reshape(2, 4, 4))
    assert (values > 0.0).all()
    _, variance = kalman.smooth_positions(
        replace(case, ellipse=flat), q=Q, passes=5, anneal=0.15
    )
    assert (variance > 0.0).all()


@pytest.mark.parametrize("gate", [np.inf, 3.0])
def test_last_modes_are_filterpy_s(gate):
    case = elliptic(batch())
    ours = kalman.imm_last(case, MOODS, gate=gate)
    theirs = last_modes(case, MOODS, gate=gate)
    np.testing.assert_allclose(ours.mean, theirs.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.cov, theirs.cov, rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.probability, theirs.probability, rtol=0, atol=1e-9)


def test_modes_with_round_ellipses_are_those_without():
    case = batch()
    expected = kalman.imm_states(case, MOODS, gate=5.0)
    states = kalman.imm_states(round_ellipses(case), MOODS, gate=5.0)
    for name in ("mean", "cov", "probability", "log_likelihood"):
        np.testing.assert_allclose(
            getattr(states, name), getattr(expected, name), atol=1e-10
        )


@pytest.mark.parametrize("stay_s", [(1e15, 1e-6)])
def test_the_density_of_modes_is_that_of_their_only_mode(stay_s):
    case = elliptic(batch())
    modes = kalman.imm_last(case, kalman.Moods((Q, 4.0), stay_s))
    single = kalman.planar_last(case, q=Q)
    np.testing.assert_allclose(modes.log_likelihood, single.log_likelihood, atol=1e-8)
    np.testing.assert_allclose(modes.mean[:, 0], single.mean, atol=1e-9)


SLOW_ERRORS = [
    SlowError(0.7, 2.0),
    SlowError(1.5, np.inf),
    SlowError(0.5, 0.0),
    SlowError(0.0, 0.0),
]


def behind_slow_error(t, error):
    """Prior covariance of positions and of positions with error, (n, n) an axis."""
    walk = prior_of_positions(t, np.diag(PRIOR_STD[:2]) ** 2)
    gap_s = np.abs(np.subtract.outer(t, t))
    memory = np.exp(-gap_s / error.tau_s) if error.tau_s else np.eye(len(t))
    return walk, walk + error.std_m**2 * memory


def dense_behind(case, rows, error, *, noise):
    """Positions, their covariances, and the law of all samples of a track."""
    t, xy, ellipse = case.t[rows], case.xy[rows], case.ellipse[rows]
    walk, seen = (np.kron(part, np.eye(2)) for part in behind_slow_error(t, error))
    total = seen + block_diag(*(noise[:, None, None] * ellipse))
    start = np.tile(xy[0], len(t))
    gain = np.linalg.solve(total, walk).T
    position = (start + gain @ (xy.ravel() - start)).reshape(-1, 2)
    spread = walk - gain @ walk
    blocks = [spread[k : k + 2, k : k + 2] for k in range(0, 2 * len(t), 2)]
    return position, np.array(blocks), multivariate_normal(start, total)


@pytest.mark.parametrize("error", SLOW_ERRORS, ids=str)
def test_behind_a_slow_error_all_are_those_of_the_joint_normal_law(error):
    case = elliptic(batch(sizes=(25, 1, 6)))
    smoothed, variance = smooth_tracks(case, error, q=Q)
    last, causal = filter_tracks(case, error, q=Q)
    for row, (rows, track) in enumerate(track_by_track(case)):
        position, spread, law = dense_behind(case, rows, error, noise=track["variance"])
        np.testing.assert_allclose(smoothed[rows], position, rtol=0, atol=1e-8)
        mean = np.trace(spread, axis1=1, axis2=2) / 2.0
        np.testing.assert_allclose(variance[rows], mean, rtol=0, atol=1e-8)
        np.testing.assert_allclose(last.mean[row, :, 0], position[-1], atol=1e-8)
        np.testing.assert_allclose(last.cov[row, :, 0, :, 0], spread[-1], atol=1e-8)
        np.testing.assert_allclose(causal[rows][-1], position[-1], atol=1e-8)
        density = law.logpdf(track["xy"].ravel())
        assert last.log_likelihood[row] == pytest.approx(density, abs=1e-7)


@pytest.mark.parametrize("error", SLOW_ERRORS, ids=str)
def test_behind_a_slow_error_round_ellipses_change_nothing(error):
    case = batch(sizes=(9, 1, 20, 4))
    whole, weight = round_ellipses(case), np.tile([0.3, 0.7], (4, 1))
    for passes in (1, 5):
        options = {"passes": passes, "anneal": 0.15}
        for got, expected in zip(
            smooth_mixture(whole, error, WALKING, weight, **options),
            smooth_mixture(case, error, WALKING, weight, **options),
            strict=True,
        ):
            np.testing.assert_allclose(got, expected, atol=1e-10)
    np.testing.assert_allclose(
        motion_log_likelihoods(whole, error, WALKING),
        motion_log_likelihoods(case, error, WALKING),
        atol=1e-10,
    )
    (got, got_xy), (expected, expected_xy) = (
        filter_tracks(each, error, q=Q, gate=5.0) for each in (whole, case)
    )
    np.testing.assert_allclose(got_xy, expected_xy, atol=1e-10)
    np.testing.assert_allclose(got.mean, expected.mean, atol=1e-10)
    np.testing.assert_allclose(got.cov[:, 1, :, 1], expected.cov, atol=1e-10)


def test_behind_a_slow_error_the_last_states_are_filterpy_s():
    case, error = elliptic(batch()), SlowError(0.4, 3.0)
    ours, _ = filter_tracks(case, error, q=Q, gate=3.0)
    theirs = planar_states(case, q=Q, gate=3.0, error=error)
    np.testing.assert_allclose(ours.mean, theirs.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.cov, theirs.cov, rtol=0, atol=1e-9)


def test_behind_a_slow_error_further_passes_weigh_residuals_in_ellipses():
    """The second pass is that of the weights that the first leaves."""
    case, error = elliptic(batch(sizes=(12,))), SlowError(0.4, 3.0)
    xy, _ = smooth_tracks(case, error, q=Q, passes=2, anneal=0.15)
    ((rows, track),) = track_by_track(case)
    n = len(track["t"])
    _, seen = behind_slow_error(track["t"], error)
    seen, square = np.kron(seen, np.eye(2)), 2.0 * track["variance"]
    total = seen + block_diag(*(track["variance"][:, None, None] * case.ellipse))
    start = np.tile(case.xy[0], n)
    gain = np.linalg.solve(total, seen).T
    gap = track["xy"] - (start + gain @ (case.xy.ravel() - start)).reshape(n, 2)
    spread = seen - gain @ seen
    inverse = np.linalg.inv(case.ellipse)
    near = np.einsum("ka,kab,kb->k", gap, inverse, gap) + square
    for k in range(n):
        near[k] += np.trace(inverse[k] @ spread[2 * k : 2 * k + 2, 2 * k : 2 * k + 2])
    noise = 1.0 / (1.0 / near + 1.0 / square)
    position, _, _ = dense_behind(case, rows, error, noise=noise)
    np.testing.assert_allclose(xy, position, rtol=0, atol=1e-8)


def test_what_needs_round_errors_refuses_an_ellipse():
    case = elliptic(batch())
    ones = np.ones(len(case))
    for call in (
        lambda: kalman.kalman_last(case, q=Q),
        lambda: smooth_each(case, WHITE, q=ones, speed_mps=ones),
    ):
        with pytest.raises(ValueError, match="same variance on both axes"):
            call()
    with pytest.raises(ValueError, match=r"ellipse must have shape \(50, 2, 2\)"):
        replace(case, ellipse=np.eye(2))
    flat = np.tile(np.diag([2.0, 0.0]), (case.t.size, 1, 1))
    with pytest.raises(ValueError, match="two axes of positive, finite variance"):
        kalman.planar_last(replace(case, ellipse=flat), q=Q)
