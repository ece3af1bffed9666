"""Repeating a release: closed forms of the mean over R + 1 of them."""

import numpy as np
import pytest
from helpers.walks import context, release_of

from attacks.reconstruction.averaging import Averaging
from isac_track.errors import KnowledgeDenied
from isac_track.types import Knowledge

SCENE, SIGMA, REPEATS = Knowledge.SCENE, Knowledge.SIGMA, Knowledge.REPEATS


def one_walk(xy, sigma=None):
    xy = np.array(xy, dtype=float)
    return release_of([(np.arange(float(len(xy))), xy)], sigma=sigma)


def averaged(first, *repeats, granted=(SCENE, REPEATS)):
    return Averaging().fit(context(granted=granted, repeats=repeats))(first)


def test_without_sigma_it_is_the_plain_mean():
    found = averaged(
        one_walk([[0.0, 3.0], [1.0, 1.0]]),
        one_walk([[3.0, 3.0], [1.0, 4.0]]),
        one_walk([[6.0, 0.0], [1.0, 7.0]]),
    )
    assert found.xy.tolist() == [[3.0, 2.0], [1.0, 4.0]]


def test_with_sigma_each_sample_is_weighed_by_its_own_variance():
    # 1 and 1/2 m: weights 1 and 4, fifths. 2 and 1 m: the same the other way round.
    found = averaged(
        one_walk([[0.0, 10.0], [5.0, 0.0]], sigma=np.array([1.0, 1.0])),
        one_walk([[5.0, 0.0], [0.0, 5.0]], sigma=np.array([0.5, 2.0])),
        granted=(SCENE, REPEATS, SIGMA),
    )
    assert found.xy == pytest.approx(np.array([[4.0, 2.0], [4.0, 1.0]]))


def test_a_sample_declared_exact_decides():
    found = averaged(
        one_walk([[1.0, 1.0]], sigma=np.array([0.0])),
        one_walk([[9.0, 9.0]], sigma=np.array([0.5])),
        granted=(SCENE, REPEATS, SIGMA),
    )
    assert found.xy == pytest.approx(np.ones((1, 2)), abs=1e-9)


def test_without_repeats_it_cannot_run():
    with pytest.raises(KnowledgeDenied, match="REPEATS"):
        averaged(one_walk([[0.0, 0.0]]), granted=(SCENE,))
