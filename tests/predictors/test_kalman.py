"""The trackers: kernels against filterpy itself, noise, window, prior, gate and covariance."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.tune import TUNED, releases, tune
from isac_track import datasets
from isac_track import plugins as registry
from isac_track.noise import UNKNOWN_VARIANCE_M2, innovation_variance_m2
from isac_track.rng import stream
from isac_track.types import Knowledge, Release
from predictors.kalman import GATE, KalmanCA, KalmanCV, KalmanIMM
from predictors.recent import recent

TRACKERS = [KalmanCV(), KalmanCA(), KalmanIMM()]
by_name = pytest.mark.parametrize("tracker", TRACKERS, ids=lambda one: type(one).__name__)


def walks(*sizes, noise_m=0.4, q=0.05, seed=0, t0=0.0):
    """Releases of exact constant-velocity walks at irregular steps, and their futures."""
    rng = stream(seed, "test", "walks", *sizes)
    t, xy, future, t_future = [], [], [], []
    for size in sizes:
        dt = rng.uniform(0.06, 0.13, size + 11)
        state = np.concatenate([rng.normal(0, 3, 2), rng.normal(0, 1, 2)])
        path = []
        for step in dt:
            jump = rng.multivariate_normal(
                np.zeros(2), q * np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]]), 2
            )
            state = np.concatenate(
                [state[:2] + step * state[2:] + jump[:, 0], state[2:] + jump[:, 1]]
            )
            path.append(state[:2])
        clock, path = t0 + np.cumsum(dt), np.array(path)
        t.append(clock[:size])
        xy.append(path[:size] + noise_m * rng.standard_normal((size, 2)))
        t_future.append(clock[size - 1 :])
        future.append(path[size - 1 :])
    release = Release(
        t=np.concatenate(t),
        xy=np.concatenate(xy),
        sigma=np.full(sum(sizes), noise_m * np.sqrt(2.0)),
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        pseudonym=tuple(f"p{row}" for row in range(len(sizes))),
    )
    return release, np.stack(t_future), np.stack(future)


@by_name
@pytest.mark.parametrize("noise", ["estimated", "declared"])
def test_the_kernels_are_filterpy(tracker, noise):
    release, t_future, _ = walks(60, 1, 2, 3, 200, 17)
    xy = release.xy.copy()
    xy[[20, 41, 42, 43, 44, 45, 150]] += 9.0  # alone, and more in a row than are rejected
    release = replace(release, xy=xy)
    ours = replace(tracker, noise=noise).predict(release, t_future)
    theirs = replace(tracker, noise=noise, engine="filterpy").predict(release, t_future)
    assert np.allclose(ours.mean, theirs.mean, atol=1e-9, rtol=1e-9)
    assert np.allclose(ours.cov, theirs.cov, atol=1e-9, rtol=1e-9)


@by_name
def test_one_track_at_a_time_is_the_same(tracker):
    release, t_future, _ = walks(60, 40, 5)
    whole = tracker.predict(release, t_future)
    for row, track in enumerate(release):
        alone = tracker.predict(track, t_future[row : row + 1])
        assert np.allclose(alone.mean[0], whole.mean[row])
        assert np.allclose(alone.cov[0], whole.cov[row])


@by_name
def test_a_late_clock_loses_nothing(tracker):
    early, t_early, _ = walks(60)
    late, t_late, _ = walks(60, t0=1e6)
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
def test_the_window_is_the_whole_history(tracker):
    """On the crowd that ships with the package, with the noise given: only the filter forgets."""
    plaza = datasets.load("plaza").tracks
    long = [track for track in plaza if track.t.size > 100][:60]
    rng = stream(0, "test", "window")
    t = [np.arange(track.t[0], track.t[-1], 0.0833) for track in long]
    xy = [
        np.stack([np.interp(clock, track.t, track.xy[:, axis]) for axis in range(2)], axis=1)
        for clock, track in zip(t, long, strict=True)
    ]
    noise_m = 1.0
    release = Release(
        t=np.concatenate(t),
        xy=np.concatenate(xy) + noise_m * rng.standard_normal((sum(map(len, t)), 2)),
        sigma=np.full(sum(map(len, t)), noise_m * np.sqrt(2)),
        offsets=np.concatenate([[0], np.cumsum([len(part) for part in t])]),
        pseudonym=tuple(f"p{row}" for row in range(len(t))),
    )
    t_future = release.t[release.offsets[1:] - 1][:, None] + 0.0833 * np.arange(12)
    short = replace(tracker, noise="declared")
    a = short.predict(release, t_future)
    b = replace(short, window=10**9).predict(release, t_future)
    gap = np.abs(a.mean - b.mean)[:, -1] / np.sqrt(b.cov[:, -1, 0, 0])[:, None]
    assert gap.max() < 0.15  # of the forecast's own standard deviation, at 0.92 s
    assert np.quantile(gap, 0.9) < 0.06


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


def test_the_forecast_covariance_is_consistent():
    """NEES of the forecast: the model is exact, so that 2-dof chi-square holds at every step."""
    release, t_future, future = walks(*[80] * 400, noise_m=0.4, q=0.05)
    exact = KalmanCV(q=0.05, noise="declared", gate=float("inf"))
    forecast = exact.predict(release, t_future)
    gap = forecast.mean - future
    nees = np.einsum("nha,nhab,nhb->nh", gap, np.linalg.inv(forecast.cov), gap)
    low, high = chi2.ppf([0.001, 0.999], 2 * 400) / 400
    # Twelve steps that share their error: a 99.8 % interval each.
    assert (nees.mean(axis=0) > low).all()
    assert (nees.mean(axis=0) < high).all()


def test_a_wrong_noise_would_be_seen_in_the_nees():
    release, t_future, future = walks(*[80] * 400, noise_m=0.4, q=0.05)
    wrong = replace(release, sigma=release.sigma * 2)
    forecast = KalmanCV(q=0.05, noise="declared", gate=float("inf")).predict(wrong, t_future)
    gap = forecast.mean - future
    nees = np.einsum("nha,nhab,nhb->nh", gap, np.linalg.inv(forecast.cov), gap)
    assert nees[:, 0].mean() < chi2.ppf(0.001, 800) / 400


@pytest.mark.parametrize("noise_m", [0.05, 0.4, 2.0])
def test_the_noise_is_found_from_the_innovations(noise_m):
    release, _, _ = walks(*[300] * 60, noise_m=noise_m)
    found = innovation_variance_m2(t=release.t, xy=release.xy, offsets=release.offsets)
    assert found.mean() == pytest.approx(noise_m**2, rel=0.05)


def test_the_noise_estimate_by_hand_and_at_its_edges():
    # One innovation: from 0 and 1 to 5 at even steps, 3 m off; variance 6 r over two axes.
    one = innovation_variance_m2(
        t=np.array([0.0, 1.0, 2.0]),
        xy=np.array([[0.0, 0.0], [1.0, 0.0], [5.0, 0.0]]),
        offsets=np.array([0, 3]),
    )
    assert one.tolist() == pytest.approx([9.0 / 12.0])
    short = innovation_variance_m2(
        t=np.array([0.0, 1.0, 0.0, 5.0, 5.1, 5.2]),
        xy=np.zeros((6, 2)),
        offsets=np.array([0, 2, 3, 6]),
    )
    assert short.tolist() == pytest.approx([UNKNOWN_VARIANCE_M2, UNKNOWN_VARIANCE_M2, 1e-6])
    lone = innovation_variance_m2(t=np.zeros(1), xy=np.zeros((1, 2)), offsets=np.array([0, 1]))
    assert lone.tolist() == [UNKNOWN_VARIANCE_M2]


def test_recent_keeps_the_last_samples():
    release, _, _ = walks(5, 2, 9)
    seen = recent(release, window=4)
    assert np.diff(seen.offsets).tolist() == [4, 2, 4]
    assert np.allclose(seen.xy[:4], release.xy[1:5])
    assert np.allclose(seen.t[[3, 5, 9]], 0.0)
    assert np.allclose(seen.sigma, release.sigma[:10])


def test_only_declared_noise_asks_for_sigma():
    (plain,) = registry.parse("predictors", "kalman_cv")
    (declared,) = registry.parse("predictors", "kalman_imm:noise=declared")
    assert plain.instance.requires == frozenset()
    assert declared.instance.requires == {Knowledge.SIGMA}
    assert declared.name == "kalman_imm:noise=declared"


@pytest.mark.parametrize(("law", "noise_m"), [("radial", 0.4), ("isotropic", 0.4 * np.sqrt(2.0))])
def test_the_declared_std_means_what_the_law_says(law, noise_m):
    release, t_future, _ = walks(60, noise_m=0.4)
    # sigma is 0.4 sqrt(2): 0.4 per axis if radial, all of it if isotropic.
    found = KalmanCV(noise="declared", law=law).predict(release, t_future).cov[0, 0, 0, 0]
    same = replace(release, sigma=np.full(60, noise_m))
    expected = KalmanCV(noise="declared", law="isotropic").predict(same, t_future)
    assert found == pytest.approx(expected.cov[0, 0, 0, 0])


@pytest.mark.parametrize(
    "spec",
    ["kalman_cv:0", "kalman_ca:-1", "kalman_imm:gate=0", "kalman_cv:window=1",
     "kalman_imm:turn_s=0"],
)  # fmt: skip
def test_impossible_parameters_are_refused(spec):
    with pytest.raises(registry.SettingsError, match="must be"):
        registry.parse("predictors", spec)


@pytest.mark.slow
def test_the_defaults_are_the_output_of_the_tuning():
    shared = releases("plaza", n_scenes=60, seed=0)
    for tracker, names in TUNED.values():
        found = tune(tracker, names, shared=shared)
        for name in names:
            assert getattr(found, name) == pytest.approx(getattr(tracker, name), rel=0.1)
