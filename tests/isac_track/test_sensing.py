"""The link budget, the information and the raw error, against closed forms and plain loops."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from isac_track.config import SensingSettings
from isac_track.rng import stream
from isac_track.sensing import (
    NEAREST_M,
    Channel,
    draw_channel,
    fisher_information_density,
    information,
    link_gain,
    range_information_per_snr,
    sense,
    sigma_from_information,
    unit_errors,
)


def draw(numbers=(1,), n_samples=(3, 4), seed=5, **changes):
    """The channel of scenes of two tracks."""
    return draw_channel(
        n_samples=np.array([n_samples] * len(numbers)),
        keys=[("scene", number) for number in numbers],
        settings=SensingSettings(**changes),
        seed=seed,
    )


def gain_db(distance_m, *, power=(1.0,), delay=(0.0,), **changes):
    """Without randomness: paths of this power and delay, by themselves one direct path."""
    none = np.zeros(1)
    channel = Channel(none, np.array([power]), np.array([delay]), none, np.zeros((1, 2)))
    gain = link_gain(
        distance_m=np.array([distance_m]),
        owner=np.array([0]),
        channel=channel,
        settings=replace(SensingSettings(), **changes),
    )
    return 10 * np.log10(gain[0])


def test_density_by_hand():
    density = fisher_information_density(
        information=np.array([1.0, 2.0, 3.0, 5.0, 7.0, 8.0]),
        t=np.array([0.0, 0.1, 0.3, 4.0, 2.0, 2.5]),
        offsets=np.array([0, 3, 4, 6]),
    )
    # The first sample of a track takes the interval after it; a lone sample is unbounded.
    assert density.tolist() == pytest.approx([10.0, 20.0, 15.0, np.inf, 14.0, 16.0])


def test_path_loss_is_two_way_with_the_tables_exponent():
    assert gain_db(20.0) - gain_db(40.0) == pytest.approx(2 * 27 * np.log10(2))
    # Radar equation in decibels at 1 m: 20 log wavelength - 30 log 4 pi.
    wavelength_m = 0.299792458 / 3.5
    assert gain_db(1.0) == pytest.approx(20 * np.log10(wavelength_m) - 30 * np.log10(4 * np.pi))
    assert gain_db(20.0) - gain_db(20.0, carrier_ghz=7.0) == pytest.approx(20 * np.log10(2))
    assert gain_db(20.0, rcs_m2=0.1) == pytest.approx(gain_db(20.0) - 10)


def test_paths_are_averaged_and_a_late_one_has_a_longer_way():
    found = 10 ** (gain_db(30.0, power=[1.0, 3.0], delay=[0.0, 0.5]) / 10)
    # Half of 2e-7 s at light speed is 29.98 m more there and back, half of it each way.
    late_m = 30.0 + 0.5 * 0.5 * 2e-7 * 299_792_458.0
    one = 10 ** (gain_db(1.0) / 10)
    assert found == pytest.approx(one * 0.5 * (30.0**-5.4 + 3.0 * late_m**-5.4))


def test_information_follows_the_budget():
    gain = np.array([1e-11])

    def info(**changes):
        return information(gain=gain, settings=replace(SensingSettings(), **changes))[0]

    more_db = SensingSettings().processing_gain_db + 3
    assert info(power_dbm=45.0) / info() == pytest.approx(10**1.5)  # the +15 dB case
    assert info(noise_dbm=-81.0) / info() == pytest.approx(0.1)
    assert info(bandwidth_mhz=200.0) / info() == pytest.approx(4.0)
    assert info(resource_share=0.25) / info() == pytest.approx(0.25)
    assert info(processing_gain_db=more_db) / info() == pytest.approx(10**0.3)


def test_sigma_is_the_bound_times_the_gap_up_to_the_cap_at_which_information_has_its_floor():
    settings = SensingSettings()
    found = information(gain=np.array([1e-11, 1e-30]), settings=settings)
    strong, weak = sigma_from_information(information=found, settings=settings)
    assert strong < settings.sigma_cap_m
    assert weak == pytest.approx(settings.sigma_cap_m)
    settings = replace(settings, crb_gap_db=20 * np.log10(4.9))
    sigma = sigma_from_information(information=np.array([100.0, 24.01]), settings=settings)
    assert sigma.tolist() == pytest.approx([0.49, 1.0])


def test_information_per_snr_is_the_curvature_of_the_likelihood():
    """The delay bound from first principles: the energy of the signal's derivative."""
    bandwidth_hz = 100e6
    f = np.linspace(-bandwidth_hz / 2, bandwidth_hz / 2, 20_001)
    mean_square_bandwidth = np.trapezoid(f**2, f) / bandwidth_hz
    per_delay = 2 * (2 * np.pi) ** 2 * mean_square_bandwidth  # 2 E/N0 (2 pi)^2 <f^2> at SNR 1
    per_range = per_delay * (2 / 299_792_458.0) ** 2
    assert range_information_per_snr(bandwidth_mhz=100.0) == pytest.approx(per_range, rel=1e-6)


def test_channel_draws_have_their_laws():
    settings = SensingSettings()
    channel = draw(range(400), (5,) * 4, seed=0)
    assert channel.large_scale.shape == (1600,)
    assert channel.path_power.shape == (1600, settings.n_paths)
    assert channel.unit_error.shape == (8000, 2)
    # 4 standard errors of 1600, 6400 and 8000 draws.
    assert channel.large_scale.std() == pytest.approx(1, abs=4 / np.sqrt(2 * 1600))
    assert channel.path_power.mean() == pytest.approx(1, abs=4 / np.sqrt(6400))
    assert channel.beam.std() == pytest.approx(1, abs=4 / np.sqrt(2 * 8000))
    assert (channel.path_delay[:, 0] == 0).all()
    assert ((channel.path_delay >= 0) & (channel.path_delay < 1)).all()


def test_a_scene_draws_alike_whichever_others_there_are_and_however_many_paths():
    both, alone, two = draw((1, 2)), draw((2,)), draw((2,), n_paths=2)
    assert two.path_power.shape != alone.path_power.shape
    for name, first in (("large_scale", 2), ("beam", 7), ("unit_error", 7)):
        assert np.array_equal(getattr(both, name)[first:], getattr(alone, name))
        assert np.array_equal(getattr(two, name), getattr(alone, name))
    assert not np.array_equal(both.unit_error[:7], both.unit_error[7:])


def test_sensing_adds_the_unit_error_scaled():
    t = np.array([0.0, 0.1, 0.2, 0.0, 0.1])
    xy = stream(0, "test", "sense").standard_normal((5, 2))
    settings = SensingSettings()
    rest = {"offsets": np.array([0, 3, 5]), "channel": draw((0,), (3, 2)), "settings": settings}
    sensed = sense(t=t, xy=xy, **rest)
    assert np.allclose(sensed.xy - xy, sensed.sigma_raw[:, None] * rest["channel"].unit_error)
    assert (sensed.sigma_raw > 0).all()
    assert (sensed.sigma_raw <= settings.sigma_cap_m + 1e-12).all()
    assert sensed.law == "radial"


@pytest.mark.parametrize("away_m", [0.0, 1e-9, 0.5, 1.0])
def test_nobody_is_sensed_as_nearer_than_the_reference_distance(away_m):
    t, settings = np.array([0.0, 0.1, 0.2, 0.0, 0.1]), SensingSettings()
    rest = {"offsets": np.array([0, 3, 5]), "channel": draw((0,), (3, 2)), "settings": settings}
    station = np.array([settings.bs_x_m, settings.bs_y_m])
    near, at_reference = (
        sense(t=t, xy=np.tile(station + np.array([0.0, distance_m]), (5, 1)), **rest)
        for distance_m in (away_m, NEAREST_M)
    )
    assert np.isfinite(near.xy).all()
    assert np.array_equal(near.sigma_raw, at_reference.sigma_raw)


def test_errors_of_a_fixed_direction_lie_on_one_line_for_each_track():
    offsets = np.array([0, 40, 41, 100])
    drawn = [
        unit_errors(n_samples=100, law=law, rng=np.random.default_rng(5), offsets=offsets)
        for law in ("fixed_direction", "radial")
    ]
    assert np.allclose(*(np.hypot(*errors.T) for errors in drawn))
    for start, end in pairwise(offsets):
        x, y = drawn[0][start:end].T
        assert np.allclose(x * y[0], y * x[0])
    with pytest.raises(ValueError, match="needs the offsets"):
        unit_errors(n_samples=3, law="fixed_direction", rng=np.random.default_rng(0))


def test_fixed_directions_are_uniform_over_tracks():
    offsets = np.arange(4001)
    errors = unit_errors(
        n_samples=4000, law="fixed_direction", rng=np.random.default_rng(6), offsets=offsets
    )
    angle = np.arctan2(errors[:, 1], errors[:, 0])
    assert stats.kstest(angle, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3
