"""The smoother of positions: against filterpy, fractions, dense solutions, alone."""

import numpy as np
import pytest
from helpers import kernel_oracles as oracle
from helpers.kalman_cases import PRIOR_STD, VAGUE_STD, Q, batch, close, track_by_track
from helpers.strategies import reproducible
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.smoothers import filterpy
from isac_track import kalman

SIZES = (1, 2, 3, 7, 8, 9, 100)
VAGUE = VAGUE_STD[:2]


def reweighted(*, passes, anneal, **track):
    """The documented iteration on a track's dense posterior; pass 1 is Gaussian."""
    square = 2.0 * track["variance"]
    variance = track["variance"]
    for number in range(1, passes + 1):
        mean, cov, _ = oracle.joint_posterior(**track | {"variance": variance})
        position, spread = mean[:, :, 0], cov[:, 0, 0]
        residual = np.sum((track["xy"] - position) ** 2, axis=1)
        delta = 2.0 * spread + anneal ** (number - 1) * square
        variance = 1.0 / (1.0 / (residual + delta) + 1.0 / square)
    return position, spread


class TestOnePass:
    @pytest.mark.parametrize("prior_std", [PRIOR_STD[:2], VAGUE])
    def test_is_filterpy_s_method(self, prior_std):
        case = batch(sizes=SIZES, prior_std=prior_std)
        position, variance = kalman.smooth_positions(case, q=Q)
        mean, spread = filterpy(case)()
        np.testing.assert_allclose(position, mean, rtol=0, atol=1e-8)
        np.testing.assert_allclose(variance, spread, rtol=1e-8)

    @pytest.mark.parametrize("sigma_m", [1e-3, 0.5, 100.0])
    @pytest.mark.parametrize("step_s", [1e-3, 0.1, 10.0])
    def test_keeps_its_digits_after_a_vague_prior(self, sigma_m, step_s):
        case = batch(
            sizes=(6, 5),
            prior_std=VAGUE,
            step_s=(step_s, 1.5 * step_s),
            variance=(sigma_m**2, 2 * sigma_m**2),
        )
        position, variance = kalman.smooth_positions(case, q=Q)
        for rows, track in track_by_track(case):
            mean, cov = oracle.exact_smoother(**track)
            spread = cov[:, 0, 0]
            close(position[rows], mean[:, :, 0], 1e-7 * np.sqrt(spread.min()))
            np.testing.assert_allclose(variance[rows], spread, rtol=1e-9)


class TestSeveralPasses:
    @pytest.mark.parametrize("passes", [2, 3, 5])
    @pytest.mark.parametrize("anneal", [0.0, 0.15, 0.7])
    def test_are_the_documented_iteration(self, passes, anneal):
        case = batch(sizes=(10, 1, 4, 2))
        position, variance = kalman.smooth_positions(
            case, q=Q, passes=passes, anneal=anneal
        )
        for rows, track in track_by_track(case):
            expected, spread = reweighted(**track, passes=passes, anneal=anneal)
            np.testing.assert_allclose(position[rows], expected, rtol=0, atol=1e-9)
            np.testing.assert_allclose(variance[rows], spread, rtol=1e-9)


@reproducible
@given(
    sizes=st.lists(st.integers(1, 40), min_size=1, max_size=10),
    log_sigma=st.floats(-3.0, 2.0),
    log_step=st.floats(-3.0, 1.0),
    passes=st.integers(1, 7),
    anneal=st.floats(0.0, 0.95),
    seed=st.integers(0, 9),
)
def test_any_noise_and_step_give_a_sound_result(
    sizes, log_sigma, log_step, passes, anneal, seed
):
    square, step_s = 10.0 ** (2 * log_sigma), 10.0**log_step
    case = batch(
        sizes=sizes,
        seed=seed,
        prior_std=VAGUE,
        step_s=(0.1 * step_s, step_s),
        variance=(0.01 * square, square),
    )
    position, variance = kalman.smooth_positions(
        case, q=Q, passes=passes, anneal=anneal
    )
    assert np.isfinite(position).all()
    assert (variance > 0).all()
    # A sample's weight is at least 1 / sigma^2 per axis in every pass, 2 / sigma^2 in
    # the first.
    bound = case.variance * (1.0 if passes == 1 else 2.0)
    assert (variance <= bound * (1 + 1e-9)).all()
