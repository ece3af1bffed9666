"""Controls, which change descriptors and linkability independently."""

from itertools import pairwise
from math import exp, sqrt

import numpy as np
import pytest
from helpers.sensed import ADDING, LAWS, rng, sensed, truth
from scipy import stats

from isac_track.mechanisms.controls import Correlated, Offset, Thin
from isac_track.mechanisms.error_paths import correlated_errors
from isac_track.sensing import unit_errors
from isac_track.sharing import Fixed

TAU_S = 2.0
INSTANTS_S = np.array([10.0, 10.1, 10.9, 11.0, 13.5, 16.0])
"""Instants of every track: irregular, and some far apart."""
N_TRACKS = 20_000
SQUARE = {"radial": 1.0, "isotropic": 2.0}
"""E[|c|^2] of a standardised error."""


def many_tracks(law, *, tau_s=TAU_S):
    """Errors at the same instants of many tracks, (N, K, 2)."""
    errors = correlated_errors(
        t=np.tile(INSTANTS_S, N_TRACKS),
        offsets=np.arange(N_TRACKS + 1) * INSTANTS_S.size,
        law=law,
        tau_s=tau_s,
        rng=rng("errors", law),
    )
    return errors.reshape(N_TRACKS, INSTANTS_S.size, 2)


@pytest.mark.parametrize("law", LAWS)
class TestSlowErrors:
    def test_fall_off_exponentially_at_any_instants_and_end_with_the_track(self, law):
        errors = many_tracks(law)
        for k in range(INSTANTS_S.size):
            for later in range(k, INSTANTS_S.size):
                product = (errors[:, k] * errors[:, later]).sum(axis=1) / SQUARE[law]
                expected = exp(-(INSTANTS_S[later] - INSTANTS_S[k]) / TAU_S)
                assert abs(product.mean() - expected) < 5 * product.std() / sqrt(
                    N_TRACKS
                )
        # Of a track with the next one.
        product = (errors[:-1, -1] * errors[1:, 0]).sum(axis=1)
        assert abs(product.mean()) < 5 * product.std() / sqrt(N_TRACKS)

    def test_have_the_law_of_the_sensing_error_from_the_first_sample_to_the_last(
        self, law
    ):
        errors = many_tracks(law)
        white = unit_errors(n_samples=N_TRACKS, law=law, rng=rng("white"))
        for k in (0, 2, -1):
            norms = [np.hypot(*unit.T) for unit in (errors[:, k], white)]
            assert stats.ks_2samp(*norms).pvalue > 1e-3
            angle = np.arctan2(errors[:, k, 1], errors[:, k, 0])
            assert (
                stats.kstest(angle, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3
            )
            assert abs(np.corrcoef(norms[0], np.cos(angle))[0, 1]) < 5 / sqrt(N_TRACKS)

    def test_are_a_step_by_step_recursion_on_tracks_of_any_length(self, law):
        sizes = [1, 700, 2, 1, 33, 64, 65]
        t = np.concatenate(
            [np.cumsum(rng("t", n).uniform(0.05, 3.0, n)) for n in sizes]
        )
        offsets = np.concatenate([[0], np.cumsum(sizes)])
        errors = correlated_errors(
            t=t, offsets=offsets, law=law, tau_s=TAU_S, rng=rng("one")
        )
        draws = rng("one").standard_normal((t.size, 3))
        tau_s = TAU_S if law == "isotropic" else 2 * TAU_S
        for lo, hi in pairwise(offsets):
            level, angle = draws[lo], np.arctan2(draws[lo, 2], draws[lo, 1])
            for k in range(lo, hi):
                if k > lo:
                    dt_s = t[k] - t[k - 1]
                    decay = exp(-dt_s / tau_s)
                    level = decay * level + sqrt(1 - decay**2) * draws[k]
                    angle += sqrt(dt_s / TAU_S) * draws[k, 1]
                if law == "isotropic":
                    expected = level[1:]
                else:
                    expected = level[0] * np.array([np.cos(angle), np.sin(angle)])
                np.testing.assert_allclose(errors[k], expected, rtol=0, atol=1e-9)


def slow_errors(batch, law="radial", tau_s=TAU_S):
    """The errors that a mechanism draws for a batch."""
    return correlated_errors(
        t=batch.t, offsets=batch.offsets, law=law, tau_s=tau_s, rng=rng()
    )


def test_an_unknown_law_is_refused():
    with pytest.raises(
        ValueError, match="unknown error law 'square'; known: radial, isotropic"
    ):
        slow_errors(sensed(), law="square")


class TestCorrelated:
    @pytest.mark.parametrize("adding", ADDING)
    def test_declares_the_same_as_fixed(self, adding):
        batch = sensed()
        slow = Correlated(0.75, adding=adding).share(batch, rng())
        np.testing.assert_array_equal(
            slow.sigma, Fixed(0.75, adding).share(batch, rng()).sigma
        )
        np.testing.assert_array_equal(slow.t, batch.t)
        np.testing.assert_array_equal(slow.offsets, batch.offsets)

    def test_linear_redraws_the_whole_error(self):
        batch = sensed(sigma_raw=0.4)
        unit = (Correlated(0.75).share(batch, rng()).xy - truth(13)) / 1.15
        np.testing.assert_allclose(unit, slow_errors(batch), rtol=0, atol=1e-12)

    @pytest.mark.parametrize(("level", "tau_s"), [(0.2, 2.0), (1.0, 50.0)])
    def test_independent_leaves_the_raw_error_and_adds_to_it(self, level, tau_s):
        batch = sensed()
        added = (
            Correlated(level, tau_s, "independent").share(batch, rng()).xy - batch.xy
        )
        expected = level * slow_errors(batch, tau_s=tau_s)
        np.testing.assert_allclose(added, expected, rtol=0, atol=1e-12)


class TestOffset:
    def test_moves_each_track_as_a_whole_in_a_uniform_direction(self):
        batch = sensed(sizes=(7, 1, 30) * 1000)
        moved = Offset(0.4).share(batch, rng()).xy - batch.xy
        shift = moved[batch.offsets[:-1]]
        repeated = np.repeat(shift, np.diff(batch.offsets), axis=0)
        np.testing.assert_allclose(moved, repeated, rtol=0, atol=1e-12)
        np.testing.assert_allclose(np.hypot(*moved.T), 0.4, rtol=0, atol=1e-12)
        angle = np.arctan2(shift[:, 1], shift[:, 0])
        assert stats.kstest(angle, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3

    def test_levels_share_their_directions_and_declare_the_raw_uncertainty(self):
        batch = sensed()
        near, far = (Offset(level).share(batch, rng()) for level in (0.1, 1.0))
        np.testing.assert_allclose(
            10 * (near.xy - batch.xy), far.xy - batch.xy, rtol=0, atol=1e-12
        )
        np.testing.assert_array_equal(far.sigma, batch.sigma_raw)


class TestThin:
    @pytest.mark.parametrize("adding", ADDING)
    @pytest.mark.parametrize(
        ("every", "shared"),
        [(1, range(16)), (3, [1, 4, 5, 6, 9, 12, 15]), (1000, [4, 5, 12, 15])],
    )
    def test_shares_samples_of_fixed_counted_back_from_the_last(
        self, adding, every, shared
    ):
        batch = sensed(sizes=(5, 1, 7, 3))
        thin = Thin(every, adding, 0.75).share(batch, rng())
        fixed = Fixed(0.75, adding).share(batch, rng())
        assert thin.offsets.tolist() == np.searchsorted(shared, batch.offsets).tolist()
        assert thin.pseudonym == fixed.pseudonym
        for name in ("t", "xy", "sigma"):
            np.testing.assert_array_equal(
                getattr(thin, name), getattr(fixed, name)[list(shared)]
            )
