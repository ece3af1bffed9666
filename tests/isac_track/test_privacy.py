from __future__ import annotations

import re
from math import pi

import numpy as np
import pytest
from helpers import oracles
from helpers.strategies import batches, points, reproducible
from hypothesis import given
from hypothesis import strategies as st

from isac_track.privacy import exposure, leakage_indicator, mean_interval_s


def flags(text):
    return np.array([sample == "1" for sample in text])


def one_track(pattern, *, t=None):
    t = 0.25 * np.arange(len(pattern)) if t is None else np.array(t)
    return exposure(leaked=flags(pattern), t=t, offsets=np.array([0, len(pattern)]))


class TestLeakageIndicator:
    def test_is_strict_at_epsilon(self):
        truth = np.zeros((3, 2))
        shared = np.array([[0.75, 1.0], [np.nextafter(1.25, 0), 0.0], [np.nextafter(1.25, 2), 0]])
        leaked = leakage_indicator(shared_xy=shared, true_xy=truth, epsilon_m=1.25)
        assert leaked.tolist() == [False, True, False]

    @pytest.mark.parametrize(
        ("shared", "truth"),
        [((3, 2), (2, 2)), ((3, 2), (1, 2)), ((3, 3), (3, 3)), ((3,), (3,)), ((3, 2, 1),) * 2],
    )
    def test_shapes(self, shared, truth):
        message = f"shared_xy and true_xy must have one shape (M, 2), got {shared} and {truth}"
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            leakage_indicator(shared_xy=np.zeros(shared), true_xy=np.zeros(truth), epsilon_m=0.3)

    @pytest.mark.parametrize("epsilon_m", [0.0, -0.3, np.nan])
    def test_epsilon_is_positive(self, epsilon_m):
        with pytest.raises(ValueError, match=f"^epsilon_m must be positive, got {epsilon_m}$"):
            leakage_indicator(
                shared_xy=np.zeros((1, 2)), true_xy=np.zeros((1, 2)), epsilon_m=epsilon_m
            )


class TestExposure:
    @pytest.mark.parametrize(
        ("pattern", "plr", "ael_s", "mel_s", "segments"),
        [
            ("0000", 0.0, 0.0, 0.0, 0),
            ("1111", 1.0, 1.0, 1.0, 1),
            ("0110", 0.5, 0.5, 0.5, 1),
            ("101110", 4 / 6, 0.5, 0.75, 2),
            ("10011", 0.6, 0.375, 0.5, 2),
            ("01", 0.5, 0.25, 0.25, 1),
        ],
    )
    def test_by_hand(self, pattern, plr, ael_s, mel_s, segments):
        found = one_track(pattern)
        assert found.plr.tolist() == pytest.approx([plr])
        assert found.ael_s.tolist() == pytest.approx([ael_s])
        assert found.mel_s.tolist() == pytest.approx([mel_s])
        assert found.segments.tolist() == [segments]

    def test_irregular_sampling_counts_mean_intervals(self):
        # mean interval 10 / 3 s; elapsed time would give 1 s, the median interval 2 s
        found = one_track("1100", t=[0.0, 1.0, 2.0, 10.0])
        assert found.mel_s.tolist() == pytest.approx([20 / 3])

    def test_a_single_leaked_sample_lasts_for_an_unknown_time(self):
        found = one_track("1")
        assert (found.plr.tolist(), found.segments.tolist()) == ([1.0], [1])
        assert np.isnan([found.ael_s[0], found.mel_s[0]]).all()

    def test_a_single_safe_sample_lasts_for_no_time(self):
        found = one_track("0")
        assert (found.plr[0], found.ael_s[0], found.mel_s[0], found.segments[0]) == (0, 0, 0, 0)

    def test_segments_end_with_their_track(self):
        found = exposure(
            leaked=flags("00111100111"),
            t=np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 11], dtype=float),
            offsets=np.array([0, 4, 8, 9, 11]),
        )
        assert found.mel_s.tolist() == pytest.approx([2.0, 2.0, np.nan, 4.0], nan_ok=True)
        assert found.segments.tolist() == [1, 1, 1, 1]

    @pytest.mark.parametrize("p", [0.2, 0.5, 0.8])
    def test_expected_durations_of_independent_samples(self, p):
        # The flat batch of all 2^8 patterns, each weighted by its probability, against the loop
        n = 8
        leaked = (np.arange(2**n)[:, None] >> np.arange(n) & 1).astype(bool)
        found = exposure(
            leaked=leaked.ravel(),
            t=np.tile(np.arange(float(n)), 2**n),
            offsets=n * np.arange(2**n + 1),
        )
        weight = p ** leaked.sum(axis=1) * (1 - p) ** (n - leaked.sum(axis=1))
        longest = oracles.expected_over_patterns(
            lambda pattern: max(oracles.runs(pattern), default=0), n=n, p=p
        )
        mean = oracles.expected_over_patterns(
            lambda pattern: oracles.exposure(leaked=pattern, t=range(n))[1], n=n, p=p
        )
        assert weight @ found.mel_s == pytest.approx(longest)
        assert weight @ found.ael_s == pytest.approx(mean)

    @pytest.mark.parametrize(
        ("leaked", "t"), [((3,), (4,)), ((4,), (3,)), ((3, 1), (3, 1)), ((3, 1), (3,)), ((), ())]
    )
    def test_shapes(self, leaked, t):
        message = f"leaked and t must have one shape (M,), got {leaked}, {t}"
        with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
            exposure(leaked=np.zeros(leaked, bool), t=np.zeros(t), offsets=np.array([0, 3]))

    @pytest.mark.parametrize("offsets", [[1, 3], [0, 2], [0, 4], [0, 1, 1, 3], [0, 2, 1, 3]])
    def test_offsets(self, offsets):
        message = "^offsets must run from 0 to M without an empty trajectory$"
        with pytest.raises(ValueError, match=message):
            exposure(leaked=np.zeros(3, bool), t=np.arange(3.0), offsets=np.array(offsets))


def test_mean_interval():
    t = np.array([0.0, 1.0, 2.0, 10.0, 7.0, 5.0, 5.5])
    interval_s = mean_interval_s(t=t, offsets=np.array([0, 4, 5, 7]))
    np.testing.assert_allclose(interval_s, [10 / 3, np.nan, 0.5])


def test_mean_interval_of_a_short_step_is_not_rounded():
    interval_s = mean_interval_s(t=np.array([0.0, pi]), offsets=np.array([0, 2]))
    assert interval_s.tolist() == [pi]


@given(shared=points((6, 2)), truth=points((6, 2)), epsilon_m=st.floats(1e-3, 300.0))
@reproducible
def test_leakage_indicator_equals_the_loop(shared, truth, epsilon_m):
    leaked = leakage_indicator(shared_xy=shared, true_xy=truth, epsilon_m=epsilon_m)
    assert leaked.tolist() == oracles.leaked_samples(
        shared_xy=shared.tolist(), true_xy=truth.tolist(), epsilon_m=epsilon_m
    )


@given(batch=batches())
@reproducible
def test_exposure_equals_the_loop(batch):
    leaked, t, offsets = batch
    found = exposure(leaked=leaked, t=t, offsets=offsets)
    plr, ael_s, mel_s, segments = oracles.exposure_of_all(leaked=leaked, t=t, offsets=offsets)
    np.testing.assert_allclose(found.plr, plr, rtol=1e-12)
    np.testing.assert_allclose(found.ael_s, ael_s, rtol=1e-9)
    np.testing.assert_allclose(found.mel_s, mel_s, rtol=1e-9)
    assert found.segments.tolist() == segments


@given(batch=batches(min_samples=2))
@reproducible
def test_descriptors_bound_each_other(batch):
    leaked, t, offsets = batch
    found = exposure(leaked=leaked, t=t, offsets=offsets)
    span_s = np.diff(offsets) * mean_interval_s(t=t, offsets=offsets)
    assert (found.mel_s >= found.ael_s * (1 - 1e-12)).all()
    assert (found.mel_s <= found.plr * span_s * (1 + 1e-12)).all()
    assert ((found.plr == 0) == (found.mel_s == 0)).all()
    assert (found.ael_s * found.segments == pytest.approx(found.plr * span_s)) is True
