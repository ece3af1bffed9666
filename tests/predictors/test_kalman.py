"""The trackers: kernels against filterpy, noise, window, prior, gate, covariance."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.kalman_cases import prefixes
from helpers.walks import cv_walks, flat_release
from scipy.stats import chi2

from isac_track import plugins
from isac_track.mechanisms.controls import Correlated, Offset
from isac_track.mechanisms.error_paths import correlated_errors
from isac_track.rng import stream
from isac_track.types import Knowledge
from predictors import filterpy_engine
from predictors.kalman import GATE, KalmanCA, KalmanCV, KalmanIMM

TRACKERS = [KalmanCV(), KalmanCA(), KalmanIMM()]
AWARE = KalmanCV(aware=True).knowing(Correlated(0.8, 3.0, "independent"))
by_name = pytest.mark.parametrize(
    "tracker", TRACKERS, ids=lambda tracker: type(tracker).__name__
)


def walks(*sizes, noise_m=0.4, q=0.05, from_s=0.0):
    """A release of constant-velocity walks, and 12 instants from each last sample."""
    t, path, offsets = cv_walks(*(size + 11 for size in sizes), q=q, from_s=from_s)
    ahead = offsets[1:, None] - 12 + np.arange(12)
    shared = np.delete(np.arange(t.size), ahead[:, 1:])
    xy = path[shared]
    xy = xy + noise_m * stream(0, "test", "walks", *sizes).standard_normal(xy.shape)
    sigma = np.full(shared.size, noise_m * np.sqrt(2.0))
    release = flat_release(t[shared], xy, np.cumsum([0, *sizes]), sigma=sigma)
    return release, t[ahead], path[ahead]


@pytest.mark.parametrize(
    "tracker", [*TRACKERS, AWARE], ids=lambda tracker: type(tracker).__name__
)
@pytest.mark.parametrize("noise", ["estimated", "declared"])
def test_the_kernels_are_filterpy(tracker, noise):
    release, t_future, _ = walks(60, 1, 2, 3, 200, 17)
    xy = release.xy.copy()
    # Single outliers, and more in a row than the filter rejects.
    xy[[20, 41, 42, 43, 44, 45, 150]] += 9.0
    release = replace(release, xy=xy)
    ours = replace(tracker, noise=noise).predict(release, t_future)
    theirs = replace(tracker, noise=noise, engine="filterpy").predict(release, t_future)
    assert np.allclose(ours.mean, theirs.mean, atol=1e-9, rtol=1e-9)
    assert np.allclose(ours.cov, theirs.cov, atol=1e-9, rtol=1e-9)


def in_ellipses(release, *, ratio=8.0):
    """The release with declared ellipses of the same trace that turn along the way."""
    angle = 0.05 * np.arange(release.t.size)
    axis = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    along = 2.0 / (1.0 + ratio**2)
    shape = along * np.eye(2) + along * (ratio**2 - 1.0) * (
        axis[:, :, None] * axis[:, None, :]
    )
    return replace(release, cov=0.5 * release.sigma[:, None, None] ** 2 * shape)


@pytest.mark.parametrize(
    "tracker", [KalmanCV(), KalmanCA(), KalmanIMM(), AWARE], ids=str
)
def test_declared_shapes_are_those_of_filterpy(tracker):
    """A network declares round slow errors, if any, beside white ones in ellipses."""
    release, t_future, _ = walks(60, 1, 2, 30)
    tracker, slow_m2 = replace(tracker, noise="declared"), tracker.added_std_m**2
    declared = replace(release, sigma=np.sqrt(release.sigma**2 + slow_m2))
    shaped, circular = (
        replace(
            declared, cov=in_ellipses(release, ratio=ratio).cov + slow_m2 * np.eye(2)
        )
        for ratio in (8.0, 1.0)
    )
    ours = tracker.predict(shaped, t_future)
    theirs = replace(tracker, engine="filterpy").predict(shaped, t_future)
    assert np.allclose(ours.mean, theirs.mean, atol=1e-9, rtol=1e-9)
    assert np.allclose(ours.cov, theirs.cov, atol=1e-9, rtol=1e-9)
    assert np.abs(ours.cov[0, 0, 0, 1]) > 1e-3
    assert np.isfinite(tracker.log_likelihood(shaped)).all()
    # A round ellipse is the declared standard deviation under a radial law.
    expected = tracker.predict(declared, t_future)
    got = tracker.predict(circular, t_future)
    assert np.allclose(got.mean, expected.mean, atol=1e-10)
    assert np.allclose(got.cov, expected.cov, atol=1e-10)
    if tracker.track:  # After the last sample it is the forecast for that instant.
        last = shaped.offsets[1:] - 1
        now = replace(tracker, window=10**6).predict(shaped, shaped.t[last, None])
        assert np.allclose(tracker.track(shaped)[last], now.mean[:, 0], atol=1e-9)


def test_who_estimates_the_noise_takes_no_shape():
    release, t_future, _ = walks(60, 2)
    ours, expected = (
        KalmanCV().predict(each, t_future) for each in (in_ellipses(release), release)
    )
    assert np.array_equal(ours.mean, expected.mean)
    assert np.array_equal(ours.cov, expected.cov)


@pytest.mark.parametrize("tracker", [KalmanCV(), AWARE], ids=["plain", "aware"])
@pytest.mark.parametrize("noise", ["estimated", "declared"])
def test_what_it_tracks_is_filterpy_after_each_sample(tracker, noise):
    """Run filterpy anew for every sample, without later ones."""
    release, _, _ = walks(30, 1, 2, 3)
    xy = release.xy.copy()
    xy[[12, 20, 21, 22, 23]] += 9.0
    release, tracker = replace(release, xy=xy), replace(tracker, noise=noise)
    batch = tracker.batch(release, is_causal=True)
    options = {"q": tracker.q, "gate": tracker.gate, "error": tracker._slow_error}
    mean, _ = filterpy_engine.last_states(prefixes(batch), **options)
    assert np.allclose(tracker.track(release), mean[:, :, 0], atol=1e-9, rtol=1e-9)
    for k in range(30):  # the noise is estimated from these samples as well
        prefix = flat_release(
            release.t[: k + 1],
            xy[: k + 1],
            np.array([0, k + 1]),
            sigma=release.sigma[: k + 1],
        )
        assert batch.variance[k] == pytest.approx(
            tracker.batch(prefix).variance[-1], rel=1e-9
        )


@by_name
def test_a_late_clock_loses_nothing(tracker):
    early, t_early, _ = walks(60)
    late, t_late, _ = walks(60, from_s=1e6)
    a, b = tracker.predict(early, t_early), tracker.predict(late, t_late)
    assert np.allclose(a.mean, b.mean, atol=1e-6)


@by_name
def test_the_start_up_needs_no_prior(tracker, monkeypatch):
    release, t_future, _ = walks(*[40] * 20)
    before = tracker.predict(release, t_future)
    monkeypatch.setattr("predictors.kalman._PRIOR_STD", (1000.0, 100.0, 100.0))
    after = tracker.predict(release, t_future)
    gap = np.abs(after.mean - before.mean) / np.sqrt(before.cov[..., 0, 0])[..., None]
    assert gap.max() < 0.02  # standard deviations, for a prior ten times as vague


@by_name
def test_an_outlier_is_gated(tracker):
    release, t_future, _ = walks(80, noise_m=0.2)
    xy = release.xy.copy()
    xy[-5] += 8.0
    spoilt = replace(release, xy=xy)
    declared = replace(tracker, noise="declared")
    clean = declared.predict(release, t_future).mean
    gated = declared.predict(spoilt, t_future).mean
    open_gate = replace(declared, gate=float("inf")).predict(spoilt, t_future).mean
    assert np.abs(gated - clean).max() < 0.2 * np.abs(open_gate - clean).max()


def test_the_gate_is_the_documented_quantile():
    assert pytest.approx(chi2.ppf(0.9999, 2), abs=0.05) == GATE


def nees(*, sigma_off):
    """NEES of forecasts under the exact model, (400, 12); sigma is off by a factor."""
    release, t_future, future = walks(*[80] * 400, noise_m=0.4, q=0.05)
    declared = replace(release, sigma=release.sigma * sigma_off)
    forecast = KalmanCV(q=0.05, noise="declared", gate=float("inf")).predict(
        declared, t_future
    )
    gap = forecast.mean - future
    return np.einsum("nha,nhab,nhb->nh", gap, np.linalg.inv(forecast.cov), gap)


def test_the_forecast_covariance_is_consistent():
    low, high = chi2.ppf([0.001, 0.999], 2 * 400) / 400
    # Twelve steps that share their error: a 99.8 % interval each.
    steps = nees(sigma_off=1.0).mean(axis=0)
    assert (steps > low).all()
    assert (steps < high).all()
    assert nees(sigma_off=2.0)[:, 0].mean() < low  # a wrong noise would be seen


def test_the_filters_get_the_last_samples():
    release, _, _ = walks(5, 2, 9)
    batch = KalmanCV(window=4, noise="declared").batch(release)
    assert np.diff(batch.offsets).tolist() == [4, 2, 4]
    assert np.allclose(batch.xy[:4], release.xy[1:5])
    assert np.allclose(batch.t[[3, 5, 9]], 0.0)
    assert np.allclose(batch.variance, release.sigma[:10] ** 2 / 2)


def test_only_declared_noise_asks_for_sigma():
    (plain,) = plugins.parse("predictors", "kalman_cv")
    (declared,) = plugins.parse("predictors", "kalman_imm:noise=declared")
    assert plain.instance.requires == frozenset()
    assert declared.instance.requires == {Knowledge.SIGMA}
    assert declared.name == "kalman_imm:noise=declared"


@pytest.mark.parametrize(
    ("law", "noise_m"),
    [
        ("radial", 0.4),
        ("fixed_direction", 0.4),
        ("isotropic", 0.4 * np.sqrt(2.0)),
    ],
)
def test_the_declared_std_is_read_by_the_law(law, noise_m):
    release, t_future, _ = walks(60, noise_m=0.4)
    # sigma is 0.4 sqrt(2): all of it per axis if isotropic, else 0.4.
    variance = (
        KalmanCV(noise="declared", law=law).predict(release, t_future).cov[0, 0, 0, 0]
    )
    same = replace(release, sigma=np.full(60, noise_m))
    expected = KalmanCV(noise="declared", law="isotropic").predict(same, t_future)
    assert variance == pytest.approx(expected.cov[0, 0, 0, 0])


@pytest.mark.parametrize(
    "spec",
    ["kalman_cv:0", "kalman_ca:-1", "kalman_imm:gate=0", "kalman_cv:window=1",
     "kalman_imm:turn_s=0"],
)  # fmt: skip
def test_impossible_parameters_are_refused(spec):
    with pytest.raises(plugins.SettingsError, match="must be"):
        plugins.parse("predictors", spec)


def test_knowing_a_slow_error_improves_forecasts_and_their_covariance():
    release, t_future, future = walks(*[150] * 200, noise_m=0.1, q=0.05)
    slow = correlated_errors(
        t=release.t,
        offsets=release.offsets,
        law="isotropic",
        tau_s=3.0,
        rng=stream(0, "test", "slow"),
    )
    release = replace(release, xy=release.xy + 0.8 * slow)
    informed = KalmanCV(q=0.05, added_std_m=0.8, tau_s=3.0, gate=float("inf"))
    gap = informed.predict(release, t_future).mean - future
    inverse = np.linalg.inv(informed.predict(release, t_future).cov)
    square = np.einsum("nha,nhab,nhb->nh", gap, inverse, gap)
    low, high = chi2.ppf([0.001, 0.999], 2 * 200) / 200
    assert low < square[:, -1].mean() < high
    plain = KalmanCV(q=0.05).predict(release, t_future).mean - future
    assert (gap**2).mean() < 0.85 * (plain**2).mean()


def test_only_an_aware_robot_adapts_to_a_mechanism():
    assert KalmanCV().knowing(Offset(1.0)) == KalmanCV()
    knows = KalmanCV(aware=True).knowing(Offset(1.0))
    assert (knows.tau_s, knows.added_std_m) == pytest.approx((np.inf, np.sqrt(0.5)))
    release, t_future, _ = walks(60)
    # The added white error is a lower bound of the noise; a small one changes nothing.
    robots = [KalmanCV(added_std_m=robot) for robot in (0.0, 0.01, 2.0)]
    predicted = [robot.predict(release, t_future).mean for robot in robots]
    np.testing.assert_array_equal(predicted[0], predicted[1])
    assert not np.allclose(predicted[0], predicted[2])
