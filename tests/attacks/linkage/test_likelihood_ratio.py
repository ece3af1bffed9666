"""The likelihood ratio against dense Gaussian densities, and its use of knowledge."""

import numpy as np
import pytest
from helpers.walks import context, hits, two_releases, walk_release
from scipy.special import ive
from scipy.stats import multivariate_normal

from attacks.linkage import _ratio_loop, likelihood_ratio
from attacks.linkage.likelihood_ratio import LikelihoodRatio, prior_m2
from attacks.reconstruction.kalman_rts import information
from isac_track.linkability.ranks import soft_matches
from isac_track.mechanisms.protections import Ou
from isac_track.rng import stream
from isac_track.types import Knowledge

RANK = 4
UNKNOWN_M = 300.0  # Where a walk lies.


def walk(name, *, curved, noise_m=0.2, n=24):
    rng = stream(3, name)
    t = np.sort(rng.uniform(0.05, 11.9, n))
    t[0] = 0.0
    path = np.stack([1.2 * t, curved * (t - 6.0) ** 2], axis=1)
    return t, path + noise_m * rng.standard_normal((n, 2))


def legendre(t):
    return np.polynomial.legendre.legvander((t - 6.0) / 6.0, RANK)[:, 1:]


def log_density(t, xy, owner, *, error):
    """Return the log density of walks with shared or own coefficients, at any place."""
    prior = np.diag(prior_m2(duration_s=np.array([12.0]), q=0.04, rank=RANK)[0])
    basis = legendre(t)
    same_walk = np.equal.outer(owner, owner)
    spread = basis @ prior @ basis.T + UNKNOWN_M**2 * same_walk + error
    return sum(
        multivariate_normal(np.zeros(t.size), spread).logpdf(xy[:, axis])
        for axis in (0, 1)
    )


@pytest.mark.parametrize("tau_s", [0.0, 5.0])
@pytest.mark.parametrize("curved", [0.0, 0.03])
def test_the_ratio_is_that_of_dense_gaussians_averaged_over_rotations(curved, tau_s):
    first, second = walk("a", curved=0.02), walk("b", curved=curved)
    probe, gallery = walk_release([first]), walk_release([second])
    t = np.concatenate([first[0], second[0]])
    owner = np.repeat([0, 1], [first[0].size, second[0].size])
    error = np.diag(
        1.0 / np.concatenate([information(release, 5) for release in (probe, gallery)])
    )
    floor_m2, std_m = 1e-3, 0.3
    # The floor and a slow error act on the coefficients, for each walk by itself.
    added = floor_m2 * np.eye(RANK)
    if tau_s:
        added += std_m**2 * likelihood_ratio._slow_share(12.0, tau_s, RANK)
    for row in (0, 1):
        basis = legendre(t) * (owner == row)[:, None]
        error = error + basis @ added @ basis.T

    def joint(angle):
        turn = np.array(
            [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        )
        return log_density(
            t, np.concatenate([first[1], second[1] @ turn]), owner, error=error
        )

    angles = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    values = np.array([joint(angle) for angle in angles])
    together = values.max() + np.log(np.exp(values - values.max()).mean())
    alone = sum(
        log_density(t, xy, np.zeros(t.size), error=error[np.ix_(own, own)])
        for (t, xy), own in ((first, owner == 0), (second, owner == 1))
    )
    attack = LikelihoodRatio(rank=RANK, reach_s=0.1, floor_m2=floor_m2, lag_s=1.0)
    known = context(
        granted={Knowledge.MECHANISM}, mechanism=Ou(std_m, tau_s=tau_s or 1e-9)
    )
    score = attack.fit(known if tau_s else context())(probe, gallery)
    assert score[0, 0] == pytest.approx(together - alone, abs=2e-3)


def test_the_prior_is_the_spread_of_walks_that_white_acceleration_drives():
    rng, dt, n = stream(0, "walks"), 0.02, 600
    push = rng.standard_normal((4000, n)) * np.sqrt(0.04 / dt)
    path = np.cumsum(np.cumsum(push, axis=1) * dt, axis=1) * dt
    positions = np.linspace(-1.0, 1.0, n)
    coefficients = (
        path @ np.linalg.pinv(np.polynomial.legendre.legvander(positions, 5)).T
    )
    expected = prior_m2(duration_s=np.array([12.0]), q=0.04, rank=5)[0]
    np.testing.assert_allclose(coefficients[:, 2:].var(axis=0), expected[1:], rtol=0.1)


def test_the_bessel_function_is_that_of_scipy():
    x = np.array([0.0, 0.3, 3.7, 3.8, 40.0, 1e5])
    factor, exponent = np.full(x.size, 2.0), np.ones(x.size)
    _ratio_loop._average_over_turns(x, factor, exponent, x.size)
    expected = np.log(2.0 * ive(0, x)) + x + 1.0
    assert np.log(factor) + exponent == pytest.approx(expected, abs=1e-6)


def test_lags_are_searched_up_to_the_reach():
    probe, gallery, mate = two_releases(12, shift_s=4.0, length_s=12.0)
    assert hits(LikelihoodRatio().fit(context())(probe, gallery), mate) >= 0.9
    assert (
        hits(LikelihoodRatio(reach_s=0.5).fit(context())(probe, gallery), mate) <= 0.7
    )


def test_if_everybody_has_a_mate_it_scores_matchings():
    probe, gallery, _ = two_releases(12, shift_s=4.0, length_s=12.0)
    separate = LikelihoodRatio(one_to_one=False).fit(context())
    matched = LikelihoodRatio(one_to_one=True).fit(context())
    assert np.array_equal(
        matched(probe, gallery), soft_matches(separate(probe, gallery))
    )
    fewer = probe.tracks(np.arange(5))
    assert np.array_equal(matched(fewer, gallery), separate(fewer, gallery))


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("rank", 0, "1 to 12"),
        ("reach_s", 11.0, "leave 2 s"),
        ("q", 0.0, "q must be positive"),
    ],
)
def test_what_cannot_be_is_refused(field, value, says):
    with pytest.raises(ValueError, match=says):
        LikelihoodRatio(**{field: value})
