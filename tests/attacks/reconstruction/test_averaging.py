"""The identity changes nothing; closed forms of the mean over R + 1 releases."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.walks import context, smooth_walks, walk_release

from attacks.reconstruction.averaging import Averaging, Identity
from isac_track.errors import KnowledgeDenied
from isac_track.types import Knowledge

SCENE, SIGMA, REPEATS = Knowledge.SCENE, Knowledge.SIGMA, Knowledge.REPEATS


def test_the_very_positions_come_back():
    release, _ = smooth_walks(1, 8)
    result = Identity().fit(context())(release)
    np.testing.assert_array_equal(result.xy, release.xy)
    assert result.std is None


def single_walk(xy, sigma=None):
    xy = np.array(xy, dtype=float)
    return walk_release([(np.arange(float(len(xy))), xy)], sigma=sigma)


def averaged(first, *repeats, granted=(SCENE, REPEATS)):
    return Averaging().fit(context(granted=granted, repeats=repeats))(first)


def test_without_sigma_it_is_the_plain_mean():
    walks = ([[0, 3], [1, 1]], [[3, 3], [1, 4]], [[6, 0], [1, 7]])
    assert averaged(*map(single_walk, walks)).xy.tolist() == [[3.0, 2.0], [1.0, 4.0]]


@pytest.mark.parametrize(
    ("first", "again", "expected"),
    [
        # 1 and 1/2 m: weights 1 and 4, fifths. 2 and 1 m: the same the other way round.
        (
            ([[0, 10], [5, 0]], [1.0, 1.0]),
            ([[5, 0], [0, 5]], [0.5, 2.0]),
            [[4.0, 2.0], [4.0, 1.0]],
        ),
        (([[1, 1]], [0.0]), ([[9, 9]], [0.5]), [[1.0, 1.0]]),
    ],
    ids=["weighed by its own variance", "declared exact"],
)
def test_with_sigma_each_sample_has_its_weight(first, again, expected):
    walks = (single_walk(xy, sigma=np.array(sigma)) for xy, sigma in (first, again))
    result = averaged(*walks, granted=(SCENE, REPEATS, SIGMA))
    assert result.xy == pytest.approx(np.array(expected), abs=1e-9)


def test_without_repeats_it_cannot_run():
    with pytest.raises(KnowledgeDenied, match="REPEATS"):
        averaged(single_walk([[0.0, 0.0]]), granted=(SCENE,))


def test_with_covariances_each_axis_has_its_weight():
    """The least squares solution of both positions, and that of variances if round."""
    first, again = (single_walk([[0, 10], [5, 0]], sigma=np.ones(2)),) * 2
    again = replace(again, xy=np.array([[5.0, 0.0], [0.0, 5.0]]))
    shapes = np.array([[[4.0, 1.0], [1.0, 1.0]], [[1.0, 0.0], [0.0, 9.0]]])
    first = replace(first, cov=shapes)
    again = replace(again, cov=shapes[::-1])
    got = averaged(first, again, granted=(SCENE, REPEATS, SIGMA)).xy
    for row in range(2):
        weights = [np.linalg.inv(item.cov[row]) for item in (first, again)]
        total = sum(
            w @ item.xy[row] for w, item in zip(weights, (first, again), strict=True)
        )
        assert got[row] == pytest.approx(np.linalg.solve(sum(weights), total))
    sigma = np.array([0.5, 2.0])
    circular = replace(first, cov=sigma[:, None, None] ** 2 * np.eye(2), sigma=sigma)
    plain = replace(circular, cov=None)
    other = replace(again, cov=np.tile(np.eye(2), (2, 1, 1)))
    got, expected = (
        averaged(*walks, granted=(SCENE, REPEATS, SIGMA)).xy
        for walks in ((circular, other), (plain, replace(other, cov=None)))
    )
    assert got == pytest.approx(expected, abs=1e-10)
