"""Link budget, information and raw error against closed forms and plain loops."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from isac_track.config import SensingSettings
from isac_track.measurement import NEAREST_M
from isac_track.rng import stream
from isac_track.sensing import (
    KNOTS,
    Channel,
    draw_channel,
    draw_walk_channel,
    fisher_information_density,
    gain_along,
    gain_at,
    information,
    link_gain,
    range_information_per_snr,
    sense,
    sigma_from_information,
    unit_errors,
    walked_within,
)


def draw(numbers=(1,), n_samples=(3, 4), seed=5, **changes):
    """The channel of scenes of two tracks, in which everybody walks 0.1 m a sample."""
    return draw_channel(
        walked_m=np.concatenate(
            [0.1 * np.arange(n) for _ in numbers for n in n_samples]
        ),
        n_samples=np.array([n_samples] * len(numbers)),
        keys=[("scene", number) for number in numbers],
        settings=SensingSettings(**changes),
        seed=seed,
    )


def gain_db(distance_m, *, power=(1.0,), delay=(0.0,), **changes):
    """Gain without randomness; by default a single direct path."""
    none = np.zeros(1)
    channel = Channel(
        none, np.array([power]), np.array([delay]), none, np.zeros((1, 2))
    )
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
    # The first sample of a track takes the interval after it; a lone sample is
    # unbounded.
    assert density.tolist() == pytest.approx([10.0, 20.0, 15.0, np.inf, 14.0, 16.0])


def test_path_loss_is_two_way_with_the_tables_exponent():
    assert gain_db(20.0) - gain_db(40.0) == pytest.approx(2 * 27 * np.log10(2))
    # Radar equation in decibels at 1 m: 20 log wavelength - 30 log 4 pi.
    wavelength_m = 0.299792458 / 3.5
    assert gain_db(1.0) == pytest.approx(
        20 * np.log10(wavelength_m) - 30 * np.log10(4 * np.pi)
    )
    assert gain_db(20.0) - gain_db(20.0, carrier_ghz=7.0) == pytest.approx(
        20 * np.log10(2)
    )
    assert gain_db(20.0, rcs_m2=0.1) == pytest.approx(gain_db(20.0) - 10)


def test_paths_are_averaged_and_a_late_one_has_a_longer_way():
    gain = 10 ** (gain_db(30.0, power=[1.0, 3.0], delay=[0.0, 0.5]) / 10)
    # Half of 2e-7 s at light speed is 29.98 m more there and back, half of it each way.
    late_m = 30.0 + 0.5 * 0.5 * 2e-7 * 299_792_458.0
    gain_at_1m = 10 ** (gain_db(1.0) / 10)
    assert gain == pytest.approx(gain_at_1m * 0.5 * (30.0**-5.4 + 3.0 * late_m**-5.4))


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


def test_sigma_is_the_bound_times_the_gap_up_to_its_cap():
    settings = SensingSettings()
    info = information(gain=np.array([1e-11, 1e-30]), settings=settings)
    strong, weak = sigma_from_information(information=info, settings=settings)
    assert strong < settings.sigma_cap_m
    assert weak == pytest.approx(settings.sigma_cap_m)
    settings = replace(settings, crb_gap_db=20 * np.log10(4.9))
    sigma = sigma_from_information(
        information=np.array([100.0, 24.01]), settings=settings
    )
    assert sigma.tolist() == pytest.approx([0.49, 1.0])


def test_information_per_snr_is_the_curvature_of_the_likelihood():
    """The delay bound from first principles: the energy of the signal's derivative."""
    bandwidth_hz = 100e6
    f = np.linspace(-bandwidth_hz / 2, bandwidth_hz / 2, 20_001)
    mean_square_bandwidth = np.trapezoid(f**2, f) / bandwidth_hz
    # 2 E/N0 (2 pi)^2 <f^2> at SNR 1.
    per_delay = 2 * (2 * np.pi) ** 2 * mean_square_bandwidth
    per_range = per_delay * (2 / 299_792_458.0) ** 2
    assert range_information_per_snr(bandwidth_mhz=100.0) == pytest.approx(
        per_range, rel=1e-6
    )


def test_channel_draws_have_their_laws():
    settings = SensingSettings()
    channel = draw(range(400), (5,) * 4, seed=0)
    assert channel.large_scale.shape == (8000,)
    first = channel.large_scale[::5]
    assert channel.path_power.shape == (1600, settings.n_paths)
    assert channel.unit_error.shape == (8000, 2)
    # 4 standard errors of 1600, 6400 and 8000 draws.
    assert first.std() == pytest.approx(1, abs=4 / np.sqrt(2 * 1600))
    assert channel.path_power.mean() == pytest.approx(1, abs=4 / np.sqrt(6400))
    assert channel.beam.std() == pytest.approx(1, abs=4 / np.sqrt(2 * 8000))
    assert (channel.path_delay[:, 0] == 0).all()
    assert ((channel.path_delay >= 0) & (channel.path_delay < 1)).all()


def test_a_scenes_draws_depend_on_no_other_scene_and_no_number_of_paths():
    joint, alone, two = draw((1, 2)), draw((2,)), draw((2,), n_paths=2)
    assert two.path_power.shape != alone.path_power.shape
    for name, first in (("large_scale", 7), ("beam", 7), ("unit_error", 7)):
        assert np.array_equal(getattr(joint, name)[first:], getattr(alone, name))
        assert np.array_equal(getattr(two, name), getattr(alone, name))
    assert not np.array_equal(joint.unit_error[:7], joint.unit_error[7:])


def covariances(draws, distances_m):
    """Estimated and modelled covariances at K distances, 4 standard errors, (K, K)."""
    expected = np.exp(-np.abs(np.subtract.outer(distances_m, distances_m)) / 10.0)
    four = 4.0 * np.sqrt((1.0 + expected**2) / len(draws))
    return np.cov(draws, rowvar=False, bias=True), expected, four


def test_the_gain_along_a_track_has_the_covariance_of_the_distance_walked():
    # A standing person keeps the gain; after 20 m little of it is left.
    walked_m = np.array([0.0, 0.1, 0.1, 1.0, 3.0, 10.0, 30.0])
    n, size = 4000, walked_m.size
    draws = gain_along(
        walked_m=np.tile(walked_m, n),
        offsets=np.arange(n + 1) * size,
        innovations=stream(0, "test", "gain along").standard_normal(n * size),
        decorrelation_m=10.0,
    ).reshape(n, size)
    covariance, expected, four = covariances(draws, walked_m)
    assert (np.abs(covariance - expected) < four).all()
    assert np.array_equal(draws[:, 1], draws[:, 2])


def test_the_gain_at_any_distances_of_a_walk_has_that_covariance():
    walked_m = np.array([0.0, 0.013, 2.0, 2.04, 11.99, 12.0, 40.0])

    def drawn(number, distances_m):
        rng = stream(0, "test", "gain at", number)
        return gain_at(walked_m=distances_m, decorrelation_m=10.0, rng=rng)

    draws = np.array([drawn(number, walked_m) for number in range(2000)])
    covariance, expected, four = covariances(draws, walked_m)
    assert (np.abs(covariance - expected) < four + 0.5 / KNOTS).all()
    few = walked_m[[4, 1]]
    assert np.array_equal(drawn(7, few), draws[7, [4, 1]])


@pytest.mark.parametrize("decorrelation_m", [0.1, 10.0, 1e4])
def test_interpolation_between_knots_is_off_the_covariance_by_less_than_its_bound(
    decorrelation_m,
):
    """Exact, by the weights of the knots."""
    knots = np.arange(2 * KNOTS + 2)
    at = stream(0, "test", "between knots").uniform(0, 2 * KNOTS, 150)
    at[:3] = 0.0, 0.5, 7.25

    class Unit:
        """Returns a single unit innovation: the gain is linear in the innovations."""

        def __init__(self, place):
            self.place = place

        def standard_normal(self, size):
            return np.eye(1, size, self.place).ravel()

    walked_m = np.append(at, 2.0 * KNOTS) * decorrelation_m / KNOTS
    weights = np.array(
        [
            gain_at(walked_m=walked_m, decorrelation_m=decorrelation_m, rng=Unit(place))
            for place in knots
        ]
    )
    apart = np.abs(np.subtract.outer(walked_m, walked_m)) / decorrelation_m
    covariance = weights.T @ weights
    assert np.diag(covariance) == pytest.approx(np.ones(walked_m.size))
    assert np.abs(covariance - np.exp(-apart)).max() < 0.5 / KNOTS


def test_with_infinite_decorrelation_the_gain_is_constant_and_begins_the_same():
    usual, constant = draw((1, 2)), draw((1, 2), decorrelation_m=np.inf)
    starts = np.array([0, 3, 7, 10])
    assert np.array_equal(constant.large_scale[starts], usual.large_scale[starts])
    assert np.array_equal(
        constant.large_scale, np.repeat(usual.large_scale[starts], [3, 4, 3, 4])
    )
    rngs = [stream(0, "test", "constant") for _ in range(2)]
    gain = gain_at(walked_m=np.linspace(0, 90, 5), decorrelation_m=np.inf, rng=rngs[0])
    assert np.array_equal(gain, np.full(5, rngs[1].standard_normal()))


def sense_windows(*spans, walk="w", **changes):
    """The channel of windows of a walk, given by the distances of their ends."""
    walked_m = [np.arange(first, last, 0.1) for first, last in spans]
    offsets = np.cumsum([0, *map(len, walked_m)])
    channel = draw_walk_channel(
        walked_m=np.concatenate(walked_m),
        offsets=offsets,
        walks=[("recorded", walk)] * len(spans),
        keys=[("window", walk, number) for number in range(len(spans))],
        settings=SensingSettings(**changes),
        seed=3,
    )
    return channel, offsets


def test_windows_of_a_walk_share_its_lasting_parts_and_no_others():
    channel, offsets = sense_windows((0, 3), (1, 4), (9, 12))
    alone, _ = sense_windows((0, 3))
    first, second, _ = (slice(*pair) for pair in pairwise(offsets))
    gain = channel.large_scale
    assert np.allclose(gain[first][10:], gain[second][:20], atol=1e-12)
    assert (channel.path_power == channel.path_power[0]).all()
    assert (channel.path_delay == channel.path_delay[0]).all()
    assert not np.isclose(channel.beam[first], channel.beam[second]).any()
    assert not np.isclose(channel.unit_error[first], channel.unit_error[second]).any()
    # Other windows of the walk change nothing.
    assert np.array_equal(alone.large_scale, gain[first])
    assert not np.isclose(
        sense_windows((0, 3), walk="other")[0].large_scale, gain[first]
    ).any()


def test_errors_of_a_fixed_direction_keep_it_over_a_gap():
    channel, _ = sense_windows((0, 2), (5, 7), law="fixed_direction")
    radial, _ = sense_windows((0, 2), (5, 7))
    x, y = channel.unit_error.T
    assert np.allclose(x * y[0], y * x[0])
    norms = (np.hypot(*drawn.unit_error.T) for drawn in (channel, radial))
    assert np.allclose(*norms)


def test_walked_is_the_length_of_the_way_so_far():
    xy = np.array(
        [[0.0, 0.0], [3.0, 4.0], [3.0, 4.0], [9.0, 12.0], [50.0, 50.0], [50.0, 51.0]]
    )
    walked_m = walked_within(xy, np.array([0, 4, 6]))
    assert walked_m.tolist() == pytest.approx([0.0, 5.0, 5.0, 15.0, 0.0, 1.0])


def test_sensing_adds_the_unit_error_scaled():
    t = np.array([0.0, 0.1, 0.2, 0.0, 0.1])
    xy = stream(0, "test", "sense").standard_normal((5, 2))
    settings = SensingSettings()
    rest = {
        "offsets": np.array([0, 3, 5]),
        "channel": draw((0,), (3, 2)),
        "settings": settings,
    }
    sensed = sense(t=t, xy=xy, **rest)
    assert np.allclose(
        sensed.xy - xy, sensed.sigma_raw[:, None] * rest["channel"].unit_error
    )
    assert (sensed.sigma_raw > 0).all()
    assert (sensed.sigma_raw <= settings.sigma_cap_m + 1e-12).all()
    assert sensed.law == "radial"


@pytest.mark.parametrize("away_m", [0.0, 1e-9, 0.5, 1.0])
def test_nobody_is_sensed_as_nearer_than_the_reference_distance(away_m):
    t, settings = np.array([0.0, 0.1, 0.2, 0.0, 0.1]), SensingSettings()
    rest = {
        "offsets": np.array([0, 3, 5]),
        "channel": draw((0,), (3, 2)),
        "settings": settings,
    }
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
        unit_errors(
            n_samples=100, law=law, rng=np.random.default_rng(5), offsets=offsets
        )
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
        n_samples=4000,
        law="fixed_direction",
        rng=np.random.default_rng(6),
        offsets=offsets,
    )
    angle = np.arctan2(errors[:, 1], errors[:, 0])
    assert stats.kstest(angle, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3
