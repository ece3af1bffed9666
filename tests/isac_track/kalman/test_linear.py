"""The Kalman filter's last state against filterpy, a dense posterior, hand examples and chance."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import kernel_oracles as oracle
from helpers.kalman_cases import (
    PRIOR_STD,
    VAGUE_STD,
    Q,
    batch,
    close,
    hard_tracks,
    one_by_one,
    prefixes,
    sound,
)
from helpers.strategies import reproducible
from hypothesis import given

from isac_track import kalman
from isac_track.rng import stream

each_model = pytest.mark.parametrize("d", [2, 3], ids=["cv", "ca"])


def after_every_sample(case, *, q=Q, gate=np.inf):
    """The last states of all prefixes: row k is the state after sample k."""
    return kalman.kalman_last(prefixes(case), q=q, gate=gate)


def accepted(result):
    """Of one track's prefixes: a rejected sample adds nothing to the likelihood."""
    return np.diff(result.log_likelihood, prepend=0.0) != 0


@each_model
@pytest.mark.parametrize("gate", [np.inf, 6.0])
def test_every_state_is_filterpy_s(d, gate):
    case = batch(prior_std=PRIOR_STD[:d])
    case.xy[stream(0, "test", "jumps").uniform(size=50) < 0.3] += 4.0
    result = after_every_sample(case, gate=gate)
    used = []
    for rows, track in one_by_one(case):
        theirs = oracle.filterpy_track(**track, gate=gate)
        close(result.mean[rows].reshape(theirs["mean"].shape), theirs["mean"])
        close(np.kron(np.eye(2), result.cov[rows]), theirs["cov"])
        close(result.log_likelihood[rows][-1], theirs["log_likelihood"])
        used.extend(theirs["accepted"])
    assert all(used) == (gate == np.inf)
    assert any(used)


@each_model
def test_gated_samples_are_as_if_never_seen_by_the_dense_posterior(d):
    case = batch(prior_std=PRIOR_STD[:d])
    case.xy[[10, 11, 25]] += 100.0
    last = kalman.kalman_last(case, q=Q, gate=50.0)
    _, track = next(one_by_one(case))
    used = ~np.isin(np.arange(40), [10, 11, 25])
    mean, cov, density = oracle.joint_posterior(**track, used=used)
    close(last.mean[0], mean[-1])
    close(last.cov[0], cov[-1])
    close(last.log_likelihood[0], density, 1e-7)  # 40 dense samples of ca: 1e6 m^2


class TestGate:
    """Somebody who stands, sampled each second; by hand, with q so small that nothing moves."""

    def run(self, x, *, gate=9.0, q=1e-20, speed_std=1e-9, variance=1.0):
        case = kalman.Batch(
            t=np.arange(float(len(x))),
            xy=np.stack([x, np.zeros(len(x))], axis=1),
            variance=np.broadcast_to(variance, len(x)),
            offsets=np.array([0, len(x)]),
            prior_std=(1.0, speed_std),
        )
        return after_every_sample(case, q=q, gate=gate)

    def test_by_hand(self):
        # Predicted variance 1, 1/2, 1/2: the sample at 1 s is 10 m off, 100 / 1.5 > 9.
        result = self.run([3.0, 13.0, 3.0])
        assert accepted(result).tolist() == [True, False, True]
        close(result.mean[:, 0, 0], 3.0, 1e-6)
        close(result.cov[:, 0, 0], [1 / 2, 1 / 2, 1 / 3], 1e-6)
        close(result.log_likelihood[-1], -np.log(2 * np.pi * 2) - np.log(2 * np.pi * 1.5), 1e-6)

    def test_the_threshold_itself_is_accepted(self):
        x = np.array([0.0, np.sqrt(18.0)])
        exactly = x[1] ** 2 / 2  # predicted variance 1/2 + 3/2
        told = {"variance": np.array([1.0, 1.5])}
        assert accepted(self.run(x, gate=exactly, **told)).all()
        below = self.run(x, gate=np.nextafter(exactly, 0), **told)
        assert accepted(below).tolist() == [True, False]

    def test_a_track_is_never_lost(self):
        # The fourth sample in a row that is far away is believed.
        result = self.run([0.0, 31.0, 32.0, 33.0, 34.0, 35.0], q=1.0, speed_std=1.0, gate=1e-3)
        assert kalman.MAX_REJECTIONS == 3
        assert accepted(result).tolist() == [True, False, False, False, True, False]
        assert result.mean[4, 0, 0] > 25


def precise_filter(*, t, xy, variance, q, mean, cov):
    """Joseph's form with 64 bits of mantissa: where double precision would have to give up."""
    d = len(cov)
    wide = np.longdouble
    x, p = mean.astype(wide), cov.astype(wide)
    factorials = np.array([1, 1, 2], dtype=wide)
    power = np.arange(d)
    lag = power[None, :] - power[:, None]
    order = d - 1 - power
    means, covs = [], []
    for k in range(len(t)):
        if k > 0:
            step = wide(t[k]) - wide(t[k - 1])
            f = np.where(lag >= 0, step ** np.abs(lag) / factorials[np.abs(lag)], wide(0))
            both = order[:, None] + order[None, :] + 1
            noise = wide(q) * step**both / (both * np.outer(factorials[order], factorials[order]))
            x = x @ f.T
            p = f @ p @ f.T + noise
        gain = p[:, 0] / (p[0, 0] + wide(variance[k]))
        x = x + np.outer(xy[k] - x[:, 0], gain)
        keep = np.eye(d, dtype=wide)
        keep[:, 0] -= gain
        p = keep @ p @ keep.T + np.outer(gain, gain) * wide(variance[k])
        means.append(x)
        covs.append(p)
    return np.array(means), np.array(covs)


@each_model
class TestNumerics:
    @reproducible
    @given(hard=hard_tracks(n_tracks=3))
    def test_sound_over_five_decades_of_noise_and_four_of_steps(self, d, hard):
        case, q = replace(hard[0], prior_std=(100.0, 2.0, 1.0)[:d]), hard[1]
        result = after_every_sample(case, q=q)
        sound(result.mean, result.cov)
        assert np.isfinite(result.log_likelihood).all()
        for rows, alone in one_by_one(case, q=q):
            mean, cov = precise_filter(**alone)
            scale = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
            # Errors in units of the standard deviation that goes with them
            close((result.mean[rows] - mean) / scale[:, None], 0, 1e-6)
            close((result.cov[rows] - cov) / (scale[:, :, None] * scale[:, None]), 0, 1e-6)

    @reproducible
    @given(hard=hard_tracks(n_tracks=3, gap=1e4))
    def test_sound_over_gaps_of_a_day(self, d, hard):
        result = after_every_sample(replace(hard[0], prior_std=VAGUE_STD[:d]), q=hard[1])
        sound(result.mean, result.cov)

    def test_a_long_likelihood_neither_overflows_nor_underflows(self, d):
        n = 400  # products of innovation variances: 1e4^200, then 1e-6^200
        case = kalman.Batch(
            t=np.arange(n) * 0.1,
            xy=np.zeros((n, 2)),
            variance=np.repeat([1e4, 1e-6], n // 2),
            offsets=np.array([0, n]),
            prior_std=(1.0, 1.0, 1.0)[:d],
        )
        result = kalman.kalman_last(case, q=1e-3)
        ((_, track),) = one_by_one(case, q=1e-3)
        theirs = oracle.filterpy_track(**track)["log_likelihood"]
        assert result.log_likelihood[0] == pytest.approx(theirs, rel=1e-6)
