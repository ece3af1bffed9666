"""The example of an attack for the board: the best linear estimate, and it pays."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from helpers.walks import context, flat_release

from attacks.reconstruction.kalman_rts import RadialRTS
from attacks.testing import run_checks
from isac_track.protocols import TrainingSet
from isac_track.rng import stream

EXAMPLE = Path(__file__).parent.parent / "examples" / "matched_smoother.py"
N, STD_M, TAU_S = 40, 0.5, 5.0


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("matched_smoother", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def walkers(*names):
    """A release of straight walks behind a slow and a small white error, and the truth."""
    rng = stream(0, "test", "matched", *names)
    t = np.arange(360) / 12.0
    lag = np.abs(np.subtract.outer(t, t))
    root = np.linalg.cholesky(np.exp(-lag / TAU_S) + 1e-9 * np.eye(t.size))
    velocity = rng.normal(0.0, 1.0, (N, 1, 2))
    truth = rng.uniform(-5.0, 5.0, (N, 1, 2)) + velocity * t[:, None]
    slow = STD_M * np.einsum("ij,njk->nik", root, rng.standard_normal(truth.shape))
    xy = truth + slow + 0.05 * rng.standard_normal(truth.shape)
    offsets = np.arange(N + 1) * t.size
    release = flat_release(np.tile(t, N), xy.reshape(-1, 2), offsets)
    return release, truth.reshape(-1, 2)


def test_it_gains_where_errors_are_slow(example):
    release, truth = walkers("victims")
    granted = context(TrainingSet(*walkers("others")))
    matched = example.MatchedSmoother().fit(granted)(release).xy
    smoothed = RadialRTS().fit(context())(release).xy
    gaps = [np.hypot(*(xy - truth).T) for xy in (matched, smoothed)]
    by_walk = [(gap**2).reshape(N, -1).mean(axis=1) for gap in gaps]
    assert by_walk[0].mean() < 0.7 * by_walk[1].mean()
    assert (by_walk[0] < by_walk[1]).sum() > 0.75 * N


def test_the_covariance_is_that_of_the_errors(example):
    release, truth = walkers("victims")
    measured = example.error_covariance(release, release.xy - truth)
    lag_s = example.LAG_S * np.arange(1, 10)
    expected = STD_M**2 * np.exp(-lag_s / TAU_S) * (1.0 - lag_s / example.LONGEST_S)
    assert measured[1:10] == pytest.approx(expected, abs=0.06)


def test_the_estimate_is_the_mode_of_walk_and_noise(example, monkeypatch):
    """Weighed least squares by both inverses: the same optimum by another way."""
    monkeypatch.setattr(example, "MOTIONS", ((0.04, 1.5),))
    t = np.sort(stream(0, "test", "matched", "t").uniform(0.0, 20.0, 30))
    xy = stream(0, "test", "matched", "xy").normal(0.0, 2.0, (30, 2))
    xy -= xy.mean(axis=0)
    covariance = 0.25 * np.exp(-example.LAG_S * np.arange(81) / TAU_S)
    since = t - t[0]
    early, late = np.minimum.outer(since, since), np.maximum.outer(since, since)
    walk = 0.04 * early**2 * (3.0 * late - early) / 6.0
    walk += 30.0**2 + 1.5**2 * np.outer(since, since) + 1e-10 * np.eye(30)
    lag = np.abs(np.subtract.outer(t, t))
    noise = np.interp(lag, example.LAG_S * np.arange(81), covariance, right=0.0)
    value, vector = np.linalg.eigh(noise)
    noise = (vector * np.maximum(value, 1e-4)) @ vector.T
    weigh = np.linalg.inv(walk) + np.linalg.inv(noise)
    expected = np.linalg.solve(weigh, np.linalg.solve(noise, xy))
    assert example.matched(t, xy, covariance) == pytest.approx(expected, abs=1e-3)


def test_it_passes_the_kit(example):
    failed = [
        result
        for result in run_checks(example.MatchedSmoother())
        if result.status == "failed"
    ]
    assert failed == []
