"""Protections: their errors have the stated laws, fresh or per session."""

import numpy as np
import pytest
from helpers.sensed import LAWS
from helpers.sensed import rng as draws
from helpers.sensed import sensed as sensed_walks
from scipy import stats

from isac_track.kalman import Batch, kalman_last
from isac_track.mechanisms.error_paths import session_errors
from isac_track.mechanisms.protections import Forecast, Laplace, Ou, OuFid
from isac_track.sharing import fid_d_sigma

N_WALKS, TAU_S = 1500, 2.0
INSTANTS = np.array([-3.7, 0.0, 0.083, 0.2, 1.999, 2.001, 2.5, 9.0])


def paths(instants, *, walk):
    t = np.tile(instants, walk.size)
    offsets = np.arange(walk.size + 1) * instants.size
    errors = session_errors(t=t, offsets=offsets, walk=walk, tau_s=TAU_S)
    return errors.reshape(walk.size, instants.size, 2)


def test_errors_of_a_session_are_an_ornstein_uhlenbeck_process():
    walk = np.arange(N_WALKS)
    drawn = paths(INSTANTS, walk=walk)
    together = np.concatenate([drawn[:, :, 0], drawn[:, :, 1]])
    expected = np.exp(-np.abs(INSTANTS[:, None] - INSTANTS) / TAU_S)
    got = together.T @ together / len(together)
    # The variance of a product of unit Gaussians that correlate by f is 1 + f^2.
    room = 4.5 * np.sqrt((1.0 + expected**2) / len(together))
    assert (np.abs(got - expected) < room).all()
    steps = np.diff(together[:, 1:4], axis=1)  # 83 and 117 ms apart, over one bridge
    wanted = -2.0 * np.expm1(-np.diff(INSTANTS[1:4]) / TAU_S)
    assert np.mean(steps**2, axis=0) == pytest.approx(
        wanted, rel=4.5 * np.sqrt(2 / len(steps))
    )
    assert stats.kstest(together[:, 0], "norm").pvalue > 1e-4
    assert abs(np.mean(drawn[:, 1, 0] * drawn[:, 1, 1])) < 4.5 / np.sqrt(N_WALKS)


def test_two_releases_of_a_session_bear_one_path():
    walk = np.array([11, 12])
    early, late = paths(INSTANTS[:6], walk=walk), paths(INSTANTS[2:], walk=walk[::-1])
    assert np.array_equal(early[:, 2:], late[::-1, :4])
    assert not np.allclose(early[0], early[1])


@pytest.mark.parametrize(
    "make", [Ou, lambda std, **options: OuFid(1e-9, std / 0.5, 1.0, **options)]
)
def test_reuse_decides_whether_a_second_release_has_the_same_error(make):
    sensed = sensed_walks(law="isotropic")
    fresh = [
        make(2.0).share(sensed, np.random.default_rng(seed)).xy for seed in range(2)
    ]
    again = [
        make(2.0, reuse="session").share(sensed, np.random.default_rng(seed)).xy
        for seed in range(2)
    ]
    assert np.array_equal(*again)
    assert not np.allclose(*fresh)


def test_ou_fid_adds_as_much_as_the_fid_rule():
    sensed = sensed_walks()
    eta = float(np.median(sensed.fid))
    extra = fid_d_sigma(fid=sensed.fid, eta=eta, alpha_m=0.5, beta=1.5)
    release = OuFid(eta).share(sensed, draws())
    assert release.sigma == pytest.approx(np.hypot(sensed.sigma_raw, extra))
    assert np.array_equal(release.xy[extra == 0], sensed.xy[extra == 0])


def test_laplace_has_its_density_and_its_epsilon():
    sensed = sensed_walks(sizes=(20_000,))
    mechanism = Laplace(1.5)
    added = mechanism.share(sensed, draws()).xy - sensed.xy
    distance = np.hypot(*added.T)
    law = stats.gamma(2.0, scale=1.0 / mechanism.epsilon_per_m)
    assert stats.kstest(distance, law.cdf).pvalue > 1e-4
    assert added.std(axis=0) == pytest.approx(1.5, rel=0.05)
    assert mechanism.epsilon_over(366) == pytest.approx(366 * np.sqrt(3.0) / 1.5)
    assert Laplace(0.0).epsilon_per_m == np.inf


def test_a_forecast_is_the_filtered_position_once_a_second():
    sensed = sensed_walks(sizes=(40, 1, 70), law="isotropic")
    release = Forecast(0.0).share(sensed, draws())
    for shared, walk in zip(release, sensed, strict=True):
        assert shared.t[-1] == walk.t[-1]
        apart_s = walk.t[-1] - shared.t
        assert np.array_equal(np.floor(apart_s), np.arange(len(shared.t))[::-1])
        end = np.searchsorted(walk.t, shared.t[-1]) + 1
        known = Batch(
            walk.t[:end],
            walk.xy[:end],
            walk.sigma_raw[:end] ** 2,
            np.array([0, end]),
            (100.0, 10.0),
        )
        assert shared.xy[-1] == pytest.approx(kalman_last(known, q=0.057).mean[0, :, 0])


@pytest.mark.parametrize("law", LAWS)
def test_a_forecast_declares_the_error_of_its_filter(law):
    # At the first sample of a track the filter knows what the sensor measured.
    sensed = sensed_walks(sizes=(1, 1, 1), law=law)
    assert Forecast(0.0).share(sensed, draws()).sigma == pytest.approx(
        sensed.sigma_raw, rel=1e-3
    )
    noisy = Forecast(0.3).share(sensed, draws())
    assert noisy.sigma == pytest.approx(np.hypot(sensed.sigma_raw, 0.3), rel=1e-3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Ou(-1.0), "std_m"),
        (lambda: Ou(float("nan")), "std_m"),
        (lambda: Ou(1.0, tau_s=0.0), "tau_s must be positive"),
        (lambda: Ou(1.0, tau_s=float("inf")), "tau_s"),
        (lambda: Ou(1.0, reuse="never"), "reuse"),
        (lambda: OuFid(0.0), "eta"),
        (lambda: OuFid(1.0, tau_s=-2.0), "tau_s"),
        (lambda: Laplace(-0.1), "std_m"),
        (lambda: Forecast(1.0, every_s=0.0), "every_s"),
    ],
)
def test_wrong_parameters_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_tracks_shorter_than_the_correlation_time_or_of_one_sample_are_shared():
    sensed = sensed_walks(sizes=(1, 2))
    for mechanism in (
        Ou(1.0, 1e6),
        Ou(1.0, 1e6, "session"),
        OuFid(1.0),
        Laplace(1),
        Forecast(1),
    ):
        assert np.isfinite(mechanism.share(sensed, draws()).xy).all()
