"""The Kalman filter's last state against filterpy, a dense posterior and by hand."""

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
    prefixes,
    sound,
    track_by_track,
)
from helpers.strategies import reproducible
from hypothesis import given

from isac_track import kalman
from isac_track.rng import stream
from predictors.filterpy_engine import last_states

each_model = pytest.mark.parametrize("d", [2, 3], ids=["cv", "ca"])


def after_every_sample(case, *, q=Q, gate=np.inf):
    """The last states of all prefixes: row k is the state after sample k."""
    return kalman.kalman_last(prefixes(case), q=q, gate=gate)


def accepted(log_likelihood):
    """Whether samples of a track were used: others add nothing to the likelihood."""
    return np.diff(log_likelihood, prepend=0.0) != 0


@each_model
@pytest.mark.parametrize("gate", [np.inf, 6.0])
def test_every_state_is_filterpy_s_and_the_likelihood_that_of_the_samples_used(d, gate):
    case = batch(prior_std=PRIOR_STD[:d])
    case.xy[stream(0, "test", "jumps").uniform(size=50) < 0.3] += 4.0
    result = after_every_sample(case, gate=gate)
    mean, cov = last_states(prefixes(case), q=Q, gate=gate)
    close(result.mean, mean)
    close(result.cov, cov)
    rejected = 0
    for rows, track in track_by_track(case):
        used = accepted(result.log_likelihood[rows])
        close(
            result.log_likelihood[rows][-1],
            oracle.precise_states(**track, used=used)[2],
        )
        rejected += (~used).sum()
    assert (rejected > 0) == (gate < np.inf)


@each_model
def test_gated_samples_are_as_if_never_seen_by_the_dense_posterior(d):
    case = batch(prior_std=PRIOR_STD[:d])
    case.xy[[10, 11, 25]] += 100.0
    last = kalman.kalman_last(case, q=Q, gate=50.0)
    _, track = next(track_by_track(case))
    used = ~np.isin(np.arange(40), [10, 11, 25])
    mean, cov, density = oracle.joint_posterior(**track, used=used)
    close(last.mean[0], mean[-1])
    close(last.cov[0], cov[-1])
    close(last.log_likelihood[0], density, 1e-7)  # 40 dense samples of ca: 1e6 m^2


class TestGate:
    """A person who stands, sampled each second; q is so small that nothing moves."""

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
        assert accepted(result.log_likelihood).tolist() == [True, False, True]
        close(result.mean[:, 0, 0], 3.0, 1e-6)
        close(result.cov[:, 0, 0], [1 / 2, 1 / 2, 1 / 3], 1e-6)
        close(
            result.log_likelihood[-1],
            -np.log(2 * np.pi * 2) - np.log(2 * np.pi * 1.5),
            1e-6,
        )

    def test_the_threshold_itself_is_accepted(self):
        x = np.array([0.0, np.sqrt(18.0)])
        exactly = x[1] ** 2 / 2  # predicted variance 1/2 + 3/2
        options = {"variance": np.array([1.0, 1.5])}
        assert accepted(self.run(x, gate=exactly, **options).log_likelihood).all()
        below = self.run(x, gate=np.nextafter(exactly, 0), **options)
        assert accepted(below.log_likelihood).tolist() == [True, False]

    def test_a_track_is_never_lost(self):
        # The fourth sample in a row that is far away is believed.
        result = self.run(
            [0.0, 31.0, 32.0, 33.0, 34.0, 35.0], q=1.0, speed_std=1.0, gate=1e-3
        )
        assert kalman.MAX_REJECTIONS == 3
        assert accepted(result.log_likelihood).tolist() == [
            True,
            False,
            False,
            False,
            True,
            False,
        ]
        assert result.mean[4, 0, 0] > 25


@each_model
class TestNumerics:
    @reproducible
    @given(hard=hard_tracks(n_tracks=3))
    def test_sound_over_five_decades_of_noise_and_four_of_steps(self, d, hard):
        case, q = replace(hard[0], prior_std=(100.0, 2.0, 1.0)[:d]), hard[1]
        result = after_every_sample(case, q=q)
        sound(result.mean, result.cov)
        assert np.isfinite(result.log_likelihood).all()
        for rows, alone in track_by_track(case, q=q):
            mean, cov, _ = oracle.precise_states(**alone)
            scale = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
            # Errors in units of the standard deviation that goes with them
            close((result.mean[rows] - mean) / scale[:, None], 0, 1e-6)
            close(
                (result.cov[rows] - cov) / (scale[:, :, None] * scale[:, None]), 0, 1e-6
            )

    @reproducible
    @given(hard=hard_tracks(n_tracks=3, gap=1e4))
    def test_sound_over_gaps_of_a_day(self, d, hard):
        result = after_every_sample(
            replace(hard[0], prior_std=VAGUE_STD[:d]), q=hard[1]
        )
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
        ((_, track),) = track_by_track(case, q=1e-3)
        _, _, density = oracle.precise_states(**track)
        assert result.log_likelihood[0] == pytest.approx(density, rel=1e-6)


def test_whole_numbers_are_a_prior_as_any_others():
    case = batch(prior_std=(2.0, 1.0))
    whole = replace(case, prior_std=(2, 1))
    expected = kalman.kalman_last(case, q=1.0)
    np.testing.assert_array_equal(kalman.kalman_last(whole, q=1.0).mean, expected.mean)
