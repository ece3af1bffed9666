"""The likelihood ratio behind error ellipses: dense Gaussian densities, round ones."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.walks import context, hits, two_releases, walk_release
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from attacks.linkage.likelihood_ratio import LikelihoodRatio, prior_m2
from attacks.reconstruction.kalman_rts import information
from isac_track.measurement import error_ellipses, scalar_covariance, shaped_errors
from isac_track.rng import stream
from isac_track.types import Knowledge

RANK, N_SAMPLES = 3, 10
UNKNOWN_M = 100.0  # Where a walk lies.
FLOOR_M2 = 1e-3
SEEN = context(granted={Knowledge.SIGMA})


def ellipses(name, n, *, long_m, ratio):
    """Covariances of a long axis in directions that change along the walk."""
    angle = stream(5, name).uniform(0.0, np.pi) + np.linspace(0.0, 1.0, n)
    axis = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    short_m2 = (long_m / ratio) ** 2
    return short_m2 * np.eye(2) + (long_m**2 - short_m2) * (
        axis[:, :, None] * axis[:, None, :]
    )


def walk(name, *, curved, cov):
    n = len(cov)
    rng = stream(3, name)
    t = np.sort(rng.uniform(0.05, 11.9, n))
    t[0] = 0.0
    path = np.stack([1.2 * t, curved * (t - 6.0) ** 2], axis=1)
    noise = shaped_errors(
        cov=cov, unit_error=rng.standard_normal((n, 2)), law="isotropic"
    )
    release = walk_release([(t, path + noise)])
    return replace(release, sigma=np.sqrt(np.trace(cov, axis1=1, axis2=2)), cov=cov)


def log_density(walks, owner):
    """Return the log density of walks with shared or own coefficients, at any place."""
    prior = np.diag(prior_m2(duration_s=np.array([12.0]), q=0.04, rank=RANK)[0])
    t = np.concatenate([release.t for release in walks])
    basis = np.polynomial.legendre.legvander((t - 6.0) / 6.0, RANK)[:, 1:]
    same_walk = np.equal.outer(owner, owner)
    own = same_walk * (basis @ basis.T) * FLOOR_M2
    signal = basis @ prior @ basis.T + UNKNOWN_M**2 * same_walk + own
    noise = block_diag(*np.concatenate([release.cov for release in walks]))
    xy = np.concatenate([release.xy - release.xy[0] for release in walks])
    spread = np.kron(signal, np.eye(2)) + noise
    return multivariate_normal(np.zeros(2 * t.size), spread).logpdf(xy.ravel())


def weighted(release):
    """Return a release with the covariances by which the linker weighs samples.

    If errors look radial, a sample that lies close to the walk counts for more.
    """
    weight = information(release, 5)[:, None, None]
    return replace(release, cov=error_ellipses(release.cov) / weight)


def turned(release, angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return replace(release, xy=release.xy @ turn.T, cov=turn @ release.cov @ turn.T)


@pytest.mark.parametrize(
    ("curved", "long_m"), [(0.05, 0.3), (0.02, 4.0)], ids=["narrow peak", "wide peak"]
)
def test_the_ratio_is_that_of_dense_gaussians_averaged_over_rotations(curved, long_m):
    first, second = (
        walk(name, curved=bend, cov=ellipses(name, N_SAMPLES, long_m=long_m, ratio=6.0))
        for name, bend in (("a", 0.02), ("b", curved))
    )
    owner = np.repeat([0, 1], N_SAMPLES)
    angles = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
    attack = LikelihoodRatio(
        rank=RANK, reach_s=0.1, floor_m2=FLOOR_M2, lag_s=1.0, shape=True
    )
    score = attack.fit(SEEN)(first, second)
    first, second = weighted(first), weighted(second)
    values = np.array(
        [log_density((first, turned(second, angle)), owner) for angle in angles]
    )
    together = values.max() + np.log(np.exp(values - values.max()).mean())
    alone = sum(log_density((each,), np.zeros(N_SAMPLES)) for each in (first, second))
    assert score[0, 0] == pytest.approx(together - alone, abs=0.02)


def test_behind_round_errors_it_is_the_usual_ratio():
    probe, gallery, _ = two_releases(6, shift_s=4.0, length_s=12.0)
    attack = LikelihoodRatio()
    usual = attack.fit(context())(probe, gallery)
    seen = []
    for release in (probe, gallery):
        # As the usual linker estimates them.
        cov = scalar_covariance(1.0 / information(release, 5))
        seen.append(replace(release, sigma=np.ones(release.t.size), cov=cov))
    score = replace(attack, shape=True).fit(SEEN)(*seen)
    np.testing.assert_allclose(score, usual, atol=0.02)


def test_who_sees_no_shape_scores_as_ever():
    probe, gallery, _ = two_releases(6, shift_s=4.0, length_s=12.0)
    usual = LikelihoodRatio().fit(context())(probe, gallery)
    attack = LikelihoodRatio(shape=True)
    assert np.array_equal(attack.fit(SEEN)(probe, gallery), usual)
    assert Knowledge.SIGMA in attack.uses
    assert Knowledge.SIGMA not in LikelihoodRatio().uses


def test_shapes_help_to_link_walks():
    """Walks behind long ellipses: more people are linked with their shapes."""
    probe, gallery, mate = two_releases(24, shift_s=2.0, length_s=12.0)
    seen = []
    for name, release in (("probe", probe), ("gallery", gallery)):
        cov = ellipses(name, release.t.size, long_m=1.5, ratio=10.0)
        rng = stream(7, name)
        unit = rng.standard_normal((release.t.size, 2))
        error = shaped_errors(cov=cov, unit_error=unit, law="isotropic")
        sigma = np.sqrt(np.trace(cov, axis1=1, axis2=2))
        seen.append(replace(release, xy=release.xy + error, sigma=sigma, cov=cov))
    with_shape, without = (
        hits(LikelihoodRatio(shape=shape).fit(SEEN)(*seen), mate)
        for shape in (True, False)
    )
    assert with_shape > without
