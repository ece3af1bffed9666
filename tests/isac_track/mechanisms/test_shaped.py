"""Shaped noise: its law, and one path a walk and session."""

import numpy as np
import pytest
from helpers.sensed import rng as draws
from helpers.sensed import sensed as sensed_walks

from isac_track.mechanisms.shaped import OPTIMA, Shaped


def test_shaped_noise_has_the_size_and_the_correlation_of_its_level():
    sensed = sensed_walks(sizes=(60,) * 400, law="isotropic")
    mechanism = Shaped(OPTIMA[2][0])
    assert mechanism.std_m == pytest.approx(OPTIMA[2][1])
    added = mechanism.share(sensed, draws()).xy - sensed.xy
    added = added.reshape(400, 60, 2).transpose(0, 2, 1).reshape(800, 60)
    lag_s = sensed.t[59] - sensed.t[0]
    room = 5.0 * np.sqrt(2.0 / 800)
    expected = np.exp(-np.square(lag_s / mechanism.tau_s))
    assert np.mean(added[:, 0] ** 2) / mechanism.std_m**2 == pytest.approx(1, abs=room)
    across = np.mean(added[:, 0] * added[:, 59]) / mechanism.std_m**2
    assert across == pytest.approx(expected, abs=room)


def test_a_session_has_one_path_of_shaped_errors():
    sensed = sensed_walks(law="isotropic")
    first, second = (
        Shaped(0.2, reuse="session").share(sensed, np.random.default_rng(seed)).xy
        for seed in (0, 1)
    )
    assert np.array_equal(first, second)
    assert np.array_equal(Shaped(0.0).share(sensed, draws()).xy, sensed.xy)
