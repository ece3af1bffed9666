"""IMM filter against an independent textbook cycle.

Against filterpy the filter is tested as a predictor, in
`tests/predictors/test_kalman.py`.
"""

from dataclasses import replace

import numpy as np
import pytest
from helpers import kernel_oracles as oracle
from helpers.kalman_cases import batch as walks
from helpers.kalman_cases import close, hard_tracks, prefixes, sound, track_by_track
from helpers.strategies import reproducible
from hypothesis import given
from scipy.linalg import expm

from isac_track import kalman
from isac_track.rng import stream

MOODS = kalman.Moods((0.05, 4.0), (2.5, 1.25))


def batch(*, sizes=(30, 1, 6), seed=0):
    """Walks with irregular steps and noise, that now and then dart off."""
    case = walks(sizes=sizes, seed=seed, variance=(0.01, 0.3))
    rng = stream(seed, "test", "darts")
    darts = (rng.uniform(size=(len(case.t), 1)) < 0.2) * rng.normal(
        0, 1.0, case.xy.shape
    )
    return replace(case, xy=case.xy + darts.cumsum(0))


def tracks(case, moods=MOODS):
    """The samples of each track, and the arguments of the oracles."""
    rates = 1.0 / np.array(moods.stay_s)
    chain = {
        "rates": np.diag(rates) @ [[-1, 1], [1, -1]],
        "probability": moods.probability,
    }
    return track_by_track(case, q=moods.q, **chain)


class TestAgainstTheTextbook:
    def test_a_far_outlier_still_tells_the_modes_apart(self):
        case = batch(sizes=(12,))
        case.xy[6] += 1e3
        result = kalman.imm_last(prefixes(case), MOODS)
        ((_, track),) = tracks(case)
        expected = oracle.imm_track(**track)["probability"]
        assert expected[6, 1] > 0.999999  # only the restless mode can have done that
        # Likelihoods of filterpy would underflow to the same floor.
        close(result.probability, expected)

    @pytest.mark.parametrize("gate", [np.inf, 4.0])
    def test_every_state_of_the_filter(self, gate):
        case, used = batch(), []
        result = kalman.imm_last(prefixes(case), MOODS, gate=gate)
        for rows, track in tracks(case):
            slow = oracle.imm_track(**track, gate=gate)
            close(result.mean[rows].reshape(slow["mean"].shape), slow["mean"])
            close(result.cov[rows], slow["cov"])
            close(result.probability[rows], slow["probability"])
            close(result.log_likelihood[rows][-1], slow["log_likelihood"])
            used.extend(slow["accepted"])
        assert all(used) == (gate == np.inf)

    def test_a_mood_that_never_ends_is_one_model(self):
        case = batch()
        lasting = kalman.Moods((0.5, 4.0), (1e15, 1e-6))
        last, single = kalman.imm_last(case, lasting), kalman.kalman_last(case, q=0.5)
        close(last.mean[:, 0], single.mean)
        close(last.probability, np.tile([1.0, 0.0], (3, 1)))


@pytest.mark.parametrize("stay_s", [(2.5, 1.25), (4.0, 1e-3), (1e9, 1e9)])
@pytest.mark.parametrize("step_s", [1e-3, 0.3, 10.0, 1e4])
def test_transitions_are_the_matrix_exponential(stay_s, step_s):
    leave, come = 1.0 / np.array(stay_s)
    moods = kalman.Moods((1.0, 1.0), stay_s)
    matrix = moods.transitions(np.array([0.0, step_s]))[1]
    jumps = step_s * max(leave, come)
    limit = 1e-16 * max(jumps, 1e5)  # what scipy loses itself
    close(matrix, expm(np.array([[-leave, leave], [come, -come]]) * step_s), limit)
    close(matrix.sum(axis=1), 1.0, 1e-15)
    assert (matrix >= 0).all()
    # The chain's law in the long run.
    close(moods.probability @ matrix, moods.probability, 1e-12)


@reproducible
@given(hard=hard_tracks(n_tracks=2))
def test_sound_over_five_decades_of_noise_and_four_of_steps(hard):
    case, _ = hard
    result = kalman.imm_last(prefixes(case), MOODS)
    assert np.isfinite(result.log_likelihood).all()
    assert (result.probability >= 0).all()
    close(result.probability.sum(axis=1), 1.0, 1e-12)
    sound(result.mean, result.cov, 1e-9)


def test_equal_modes_share_their_probability():
    last = kalman.imm_last(batch(), replace(MOODS, q=(0.3, 0.3)))
    close(last.probability, np.tile(MOODS.probability, (3, 1)), 1e-12)


@pytest.mark.parametrize("gate", [np.inf, 4.0])
def test_states_after_every_sample_are_those_of_tracks_that_end_there(gate):
    case = batch()
    every = kalman.imm_states(case, MOODS, gate=gate)
    last = kalman.imm_last(prefixes(case), MOODS, gate=gate)
    for name in ("mean", "cov", "probability"):
        np.testing.assert_array_equal(getattr(every, name), getattr(last, name))
    ends = case.offsets[1:] - 1
    np.testing.assert_array_equal(every.log_likelihood, last.log_likelihood[ends])
