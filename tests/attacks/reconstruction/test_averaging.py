"""Repeating a release: closed forms of the mean over R + 1 of them."""

from dataclasses import replace

import numpy as np
import pytest

from attacks.reconstruction.averaging import Averaging
from isac_track.errors import KnowledgeDenied
from isac_track.protocols import AttackContext
from isac_track.rng import stream
from isac_track.types import Knowledge, Release

SCENE, SIGMA, REPEATS = Knowledge.SCENE, Knowledge.SIGMA, Knowledge.REPEATS


def release_of(xy, sigma=None):
    xy = np.array(xy, dtype=float)
    return Release(
        t=np.arange(float(len(xy))),
        xy=xy,
        sigma=sigma,
        offsets=np.array([0, len(xy)]),
        pseudonym=("p",),
    )


def averaged(first, *repeats, granted=(SCENE, REPEATS)):
    context = AttackContext(
        rng=stream(0, "test"), epsilon_m=0.3, granted=frozenset(granted), repeats=repeats
    )
    return Averaging().fit(context)(first)


def test_without_sigma_it_is_the_plain_mean():
    found = averaged(
        release_of([[0.0, 3.0], [1.0, 1.0]]),
        release_of([[3.0, 3.0], [1.0, 4.0]]),
        release_of([[6.0, 0.0], [1.0, 7.0]]),
    )
    assert found.xy.tolist() == [[3.0, 2.0], [1.0, 4.0]]


def test_with_sigma_each_sample_is_weighed_by_its_own_variance():
    # 1 and 1/2 m: weights 1 and 4, fifths. 2 and 1 m: the same the other way round.
    found = averaged(
        release_of([[0.0, 10.0], [5.0, 0.0]], sigma=np.array([1.0, 1.0])),
        release_of([[5.0, 0.0], [0.0, 5.0]], sigma=np.array([0.5, 2.0])),
        granted=(SCENE, REPEATS, SIGMA),
    )
    assert found.xy == pytest.approx(np.array([[4.0, 2.0], [4.0, 1.0]]))


def test_a_sample_declared_exact_decides():
    found = averaged(
        release_of([[1.0, 1.0]], sigma=np.array([0.0])),
        release_of([[9.0, 9.0]], sigma=np.array([0.5])),
        granted=(SCENE, REPEATS, SIGMA),
    )
    assert found.xy == pytest.approx(np.ones((1, 2)), abs=1e-9)


@pytest.mark.parametrize("n_repeats", [0, 1, 2, 7])
def test_equal_variances_leave_one_part_in_as_many_as_there_are_releases(n_repeats):
    rng = stream(0, "test", "averaging", n_repeats)
    truth = rng.normal(0, 5, (20_000, 2))
    releases = [release_of(truth + 0.8 * rng.standard_normal(truth.shape)) for _ in range(9)]
    found = averaged(*releases[: n_repeats + 1])
    # 40,000 squares: their mean is known to 0.7 %.
    left = np.mean((found.xy - truth) ** 2)
    assert left == pytest.approx(0.64 / (n_repeats + 1), rel=0.03)


def test_inverse_variances_leave_the_harmonic_sum():
    rng = stream(0, "test", "averaging", "unequal")
    truth = rng.normal(0, 5, (20_000, 2))
    stds = [rng.uniform(0.2, 2.0, 20_000) for _ in range(3)]
    releases = [
        release_of(truth + std[:, None] * rng.standard_normal(truth.shape), sigma=std)
        for std in stds
    ]
    found = averaged(*releases, granted=(SCENE, REPEATS, SIGMA))
    best = 1.0 / sum(1.0 / std**2 for std in stds)
    assert np.mean((found.xy - truth) ** 2) == pytest.approx(best.mean(), rel=0.03)
    plain = averaged(*(replace(one, sigma=None) for one in releases))
    assert np.mean((plain.xy - truth) ** 2) > 1.5 * best.mean()


def test_without_repeats_it_cannot_run():
    with pytest.raises(KnowledgeDenied, match="REPEATS"):
        averaged(release_of([[0.0, 0.0]]), granted=(SCENE,))
