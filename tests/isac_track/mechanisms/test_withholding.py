"""Mechanisms that withhold samples: they share a part of the samples of `fixed`."""

import numpy as np
import pytest
from helpers.sensed import ADDING, rng, sensed

from isac_track.errors import SettingsError
from isac_track.mechanisms.withholding import Window
from isac_track.plugins import parse
from isac_track.sharing import Fixed
from isac_track.types import derived


def samples_of_the_last_seconds(tracks, seconds):
    """Indices by a plain loop over tracks and samples."""
    shared = []
    for first, end in zip(tracks.offsets[:-1], tracks.offsets[1:], strict=True):
        last_s = tracks.t[end - 1]
        shared += [k for k in range(first, end) if last_s - tracks.t[k] <= seconds]
    return shared


class TestWindow:
    @pytest.mark.parametrize("adding", ADDING)
    @pytest.mark.parametrize("seconds", [0.01, 0.3, 0.52, 100.0])
    def test_shares_of_fixed_the_last_seconds_of_every_track(self, adding, seconds):
        batch = sensed(sizes=(5, 1, 7, 3))
        shared = samples_of_the_last_seconds(batch, seconds)
        window = Window(seconds, adding, 0.75).share(batch, rng())
        fixed = Fixed(0.75, adding).share(batch, rng())
        assert (
            window.offsets.tolist() == np.searchsorted(shared, batch.offsets).tolist()
        )
        assert window.pseudonym == fixed.pseudonym
        for name in ("t", "xy", "sigma"):
            np.testing.assert_array_equal(
                getattr(window, name), getattr(fixed, name)[shared]
            )

    def test_always_shares_the_last_sample(self):
        batch = sensed(sizes=(4, 1))
        release = Window(1e-6).share(batch, rng())
        np.testing.assert_array_equal(release.t, batch.t[[3, 4]])

    def test_a_sample_at_the_edge_is_shared_whatever_the_rounding_of_times(self):
        batch = derived(sensed(sizes=(2,)), t=np.array([3.1, 4.4]))
        assert batch.t[1] - batch.t[0] > 1.3
        release = Window(1.3).share(batch, rng())
        assert release.t.tolist() == [3.1, 4.4]

    def test_claims_to_protect_and_adds_an_error_only_if_asked(self):
        assert Window.protects
        assert not Window(1.0).adds_error
        assert Window(1.0, d_sigma=0.1).adds_error

    @pytest.mark.parametrize("seconds", [0.0, -1.0, np.nan, np.inf])
    def test_refuses_a_window_that_is_not_a_positive_time(self, seconds):
        with pytest.raises(ValueError, match="seconds"):
            Window(seconds)

    @pytest.mark.parametrize(
        "spec", ["window:0", "window:-1", "window:1,d_sigma=-1", "window"]
    )
    def test_a_wrong_spec_is_a_settings_error(self, spec):
        with pytest.raises(SettingsError, match="window"):
            parse("mechanisms", spec)
