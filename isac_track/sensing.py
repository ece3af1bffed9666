"""What the base station measures: raw estimates of positions and their uncertainty.

The chain is: link budget -> beta -> Fisher information (eq. swarm_fi) -> Cramer-Rao
bound (CRB) -> sigma_raw, and Fisher information density (eq. swarm_fid). The radar is
two-way (monostatic).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Final, NamedTuple

import numpy as np
from numpy.random import Generator

from isac_track.config import SensingSettings
from isac_track.measurement import (
    NEAREST_M,
    SPEED_OF_LIGHT_MPS,
    axis_share,
    mean_information,
    mean_variance,
    sensed_covariance,
    shaped_errors,
)
from isac_track.rng import stream
from isac_track.types import (
    ErrorLaw,
    Floats,
    Ints,
    Scenes,
    Sensed,
    lengths,
    read_only,
    squared_lengths,
)

KNOTS: Final = 200
"""Knots of a walk's large-scale gain within its decorrelation distance."""


@dataclass(frozen=True, eq=False, slots=True)
class Channel:
    """Random part of the link of N tracks and M samples, before scaling by spreads."""

    # (M,) standard normal; times `large_scale_db` the sample's gain in dB.
    large_scale: Floats
    # (N, N_p) power of each path, exponential with mean 1 (Rayleigh amplitude).
    path_power: Floats
    # (N, N_p) excess delay, share of `delay_spread_s`; 0 for the first, direct path.
    path_delay: Floats
    # (M,) standard normal; times `beam_fluctuation_db` the sample's gain in dB.
    beam: Floats
    unit_error: Floats  # (M, 2) standardised raw error.


def fisher_information_density(
    *, information: Floats, t: Floats, offsets: Ints
) -> Floats:
    """Return the Fisher information density J of every sample, (M,) 1/(m^2 s).

    Eq. swarm_fid: ``J(t) = I(k) / (t_k - t_(k-1))``, with `intervals_before`. It is inf
    for a track of a single sample, which a mechanism then protects in full.
    `information` is (M,) 1/m^2, `t` (M,) s.
    """
    interval_s = intervals_before(t=t, offsets=offsets)
    density: Floats = np.full_like(information, np.inf)
    np.divide(information, interval_s, out=density, where=interval_s > 0)
    return density


def intervals_before(*, t: Floats, offsets: Ints) -> Floats:
    """Return the time since the previous sample, (M,) s, for times `t`, (M,) s.

    The first sample of a track takes the interval after it. A track of one sample has
    no interval: 0.
    """
    interval_s = np.diff(t, prepend=0.0)
    first = offsets[:-1]
    single = np.diff(offsets) == 1
    interval_s[first[~single]] = interval_s[first[~single] + 1]
    interval_s[first[single]] = 0.0
    return interval_s


def link_gain(
    *, distance_m: Floats, owner: Ints, channel: Channel, settings: SensingSettings
) -> Floats:
    """Return the two-way power gain of every sample, (M,), as a plain ratio.

    It is the product of the radar equation at 1 m, lambda^2 rcs / (4 pi)^3; the path
    loss with the table's exponent each way; a log-normal gain along the track; N_p
    Rayleigh paths of each track, whose excess delay lengthens the way there and back;
    and the fluctuation of the beam at each sample. `distance_m`, (M,) m, is the
    positive distance from the base station; `owner`, (M,), the track of each sample.
    """
    wavelength_m = SPEED_OF_LIGHT_MPS / (settings.carrier_ghz * 1e9)
    at_1m = wavelength_m**2 * settings.rcs_m2 / (4.0 * np.pi) ** 3
    excess_m = 0.5 * SPEED_OF_LIGHT_MPS * settings.delay_spread_s * channel.path_delay
    n_paths = channel.path_power.shape[1]
    paths = np.zeros_like(distance_m)
    for path in range(n_paths):  # saves memory against an (M, N_p) array
        way_m = distance_m + excess_m[:, path].take(owner)
        power = channel.path_power[:, path].take(owner)
        paths += power * way_m ** -(2.0 * settings.path_loss_exponent)
    fluctuation_db = (
        settings.large_scale_db * channel.large_scale
        + settings.beam_fluctuation_db * channel.beam
    )
    return np.asarray(at_1m * (paths / n_paths) * 10.0 ** (fluctuation_db / 10.0))


def range_information_per_snr(*, bandwidth_mhz: float) -> float:
    """Return the Fisher information on a two-way range at SNR 1, 1/m^2.

    The information on the delay is 8 pi^2 B_rms^2 SNR with B_rms^2 = B^2 / 12 for a
    flat spectrum (Kay, Estimation Theory, 1993, ch. 3.11); range is half the delay
    times the speed of light. As in the paper it holds for both axes.
    """
    rms_bandwidth_hz2 = (bandwidth_mhz * 1e6) ** 2 / 12.0
    return 8.0 * np.pi**2 * rms_bandwidth_hz2 * (2.0 / SPEED_OF_LIGHT_MPS) ** 2


def information(*, gain: Floats, settings: SensingSettings) -> Floats:
    """Return the Fisher information of every sample from its two-way gain, (M,) 1/m^2.

    ``I = beta * m_s * a^H Q a`` (eq. swarm_fi), with beta in 1/(m^2 W). The beam
    follows the pedestrian: a^H Q a is the table's effective power. Where the SNR is so
    low that sigma_raw would exceed its cap, a target is not detected; a floor of the
    information keeps it consistent with sigma_raw there.
    """
    noise_w = 10.0 ** ((settings.noise_dbm - 30.0) / 10.0)
    power_w = 10.0 ** ((settings.power_dbm - 30.0) / 10.0)
    processing = 10.0 ** (settings.processing_gain_db / 10.0)
    per_snr = range_information_per_snr(bandwidth_mhz=settings.bandwidth_mhz)
    beta = per_snr * processing * gain / noise_w
    floor = (_estimator_gap(settings) / settings.sigma_cap_m) ** 2
    return np.asarray(np.maximum(beta * settings.resource_share * power_w, floor))


def sigma_from_information(*, information: Floats, settings: SensingSettings) -> Floats:
    """Return sigma_raw, (M,) m: sqrt(CRB) times the gap of a real estimator.

    The CRB is 1 / I.
    """
    return np.asarray(_estimator_gap(settings) / np.sqrt(information))


def _estimator_gap(settings: SensingSettings) -> float:
    """Return the ratio of a real estimator's error to sqrt(CRB)."""
    return float(10.0 ** (settings.crb_gap_db / 20.0))


def unit_errors(
    *, n_samples: int, law: ErrorLaw, rng: Generator, offsets: Ints | None = None
) -> Floats:
    """Draw standardised errors, (M, 2).

    - `radial`: the norm is |N(0, 1)| and the direction uniform (variance 1/2 per axis).
      This reading fits the paper's PLR.
    - `isotropic`: N(0, 1) per axis.
    - `fixed_direction`: as `radial`, with one direction for all errors of a track; it
      needs the `offsets`, (N + 1,).

    All laws use the same draws, sample by sample: a shorter batch is a prefix of a
    longer batch. ValueError for an unknown law, or `fixed_direction` without `offsets`.
    """
    draws = rng.standard_normal((n_samples, 3))
    if law == "isotropic":
        return draws[:, 1:]
    if law == "radial":
        along = draws[:, 0] / np.sqrt(squared_lengths(draws[:, 1:]))
        errors = np.empty((n_samples, 2))
        for axis in range(2):  # faster than both axes at once
            np.multiply(draws[:, 1 + axis], along, out=errors[:, axis])
        return errors
    if law == "fixed_direction":
        if offsets is None:
            raise ValueError("the law fixed_direction needs the offsets of the tracks")
        return draws[:, :1] * track_directions(draws[:, 1:], offsets=offsets)
    raise ValueError(
        f"unknown error law {law!r}; known: radial, isotropic, fixed_direction"
    )


def track_directions(draws: Floats, *, offsets: Ints) -> Floats:
    """Return the direction of each track's first draw at all its samples, (M, 2)."""
    first = draws[offsets[:-1]]
    direction: Floats = first / np.hypot(first[:, 0], first[:, 1])[:, None]
    return np.repeat(direction, np.diff(offsets), axis=0)


def walked_within(xy: Floats, offsets: Ints) -> Floats:
    """Return the distance walked within a track by each sample, (M, 2) m -> (M,) m."""
    step_m = np.sqrt(squared_lengths(np.diff(xy, axis=0, prepend=xy[:1])))
    step_m[offsets[:-1]] = 0.0
    way_m = np.cumsum(step_m)
    return np.asarray(way_m - np.repeat(way_m[offsets[:-1]], np.diff(offsets)))


def gain_along(
    *, walked_m: Floats, offsets: Ints, innovations: Floats, decorrelation_m: float
) -> Floats:
    """Return the large-scale gain at each sample, (M,), in standard deviations.

    It is a Gaussian process over the distance walked, with covariance exp(-distance /
    decorrelation_m) (Gudmundson, Electron. Lett. 27, 1991), by its exact transitions.
    `innovations`, (M,), are standard normal; the first of a track is its first gain.
    `walked_m`, (M,) m, is that of `walked_within`.
    """
    from isac_track._gain_loop import (  # noqa: PLC0415 - compiles at first use
        correlated,
    )

    correlation = np.exp(-np.diff(walked_m, prepend=0.0) / decorrelation_m)
    correlation[offsets[:-1]] = 0.0
    gain = np.empty_like(walked_m)
    correlated(innovations, correlation, gain)
    return gain


def gain_at(*, walked_m: Floats, decorrelation_m: float, rng: Generator) -> Floats:
    """Return the large-scale gain of a walk at distances from its start, (K,).

    The gain is drawn exactly at fixed knots of the whole walk, in their order, so that
    the given distances change no draw. Between two knots it is interpolated and scaled
    to a variance of 1. The covariance at two distances differs from that of
    `gain_along` by at most 1 / (2 KNOTS) (tested).
    """
    if np.isinf(decorrelation_m):
        return np.full(walked_m.size, rng.standard_normal())
    place = walked_m * (KNOTS / decorrelation_m)
    before = place.astype(np.int64)
    n_knots = int(before.max(initial=0)) + 2
    knots = gain_along(
        walked_m=np.arange(float(n_knots)) * (decorrelation_m / KNOTS),
        offsets=np.array([0, n_knots]),
        innovations=rng.standard_normal(n_knots),
        decorrelation_m=decorrelation_m,
    )
    weight, correlation = place - before, np.exp(-1.0 / KNOTS)
    mixed = (1.0 - weight) * knots[before] + weight * knots[before + 1]
    variance = 1.0 - 2.0 * (1.0 - correlation) * weight * (1.0 - weight)
    return np.asarray(mixed / np.sqrt(variance))


def draw_channel(
    *,
    walked_m: Floats,
    n_samples: Ints,
    keys: Sequence[tuple[str | int, ...]],
    settings: SensingSettings,
    seed: int,
) -> Channel:
    """Draw the random part of the link for batches of tracks.

    Every batch and quantity has a random stream of its own. A batch is a scene, or one
    track. `n_samples`, (K, A), counts the samples of the A tracks of each of K batches,
    and `keys` names the streams of the batches. `walked_m`, (M,) m, is that of
    `walked_within`.
    """
    # The arguments are hashable, so that the draws can be cached.
    innovations, *rest = _draw_batches(
        tuple(map(tuple, n_samples.tolist())), tuple(keys), settings, seed
    )
    large_scale = gain_along(
        walked_m=walked_m,
        offsets=np.concatenate([[0], np.cumsum(n_samples)]),
        innovations=innovations,
        decorrelation_m=settings.decorrelation_m,
    )
    return Channel(read_only(large_scale), *rest)


# The last two tasks' draws stay for the life of the process, which works on several
# pieces of a task in turn.
@lru_cache(maxsize=2)
def _draw_batches(
    n_samples: tuple[tuple[int, ...], ...],
    keys: tuple[tuple[str | int, ...], ...],
    settings: SensingSettings,
    seed: int,
) -> tuple[Floats, ...]:
    """Return innovations of the gain, then the other fields of a `Channel`."""
    draw, batches = partial(stream, seed, "sensing"), []
    for sizes, key in zip(n_samples, keys, strict=True):
        total, offsets = sum(sizes), np.cumsum([0, *sizes])
        large_scale = draw("large scale", *key)
        # Draw all first gains before the innovations: with infinite decorrelation only
        # they matter, and they do not shift with the number of samples.
        first_gains = large_scale.standard_normal(len(sizes))
        innovations = large_scale.standard_normal(total)
        innovations[offsets[:-1]] = first_gains
        shape = len(sizes), settings.n_paths
        power, delay = _draw_paths(draw("paths", *key), shape)
        beam = draw("beam", *key).standard_normal(total)
        rng = draw("error", *key)
        error = unit_errors(n_samples=total, law=settings.law, rng=rng, offsets=offsets)
        batches.append((innovations, power, delay, beam, error))
    return tuple(
        read_only(np.concatenate(parts)) for parts in zip(*batches, strict=True)
    )


def _draw_paths(rng: Generator, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Draw power and excess delay of the paths of N tracks, (N, N_p) each."""
    power, delay = rng.standard_exponential(shape), rng.random(shape)
    delay[:, 0] = 0.0  # the direct path
    return power, delay


def draw_walk_channel(
    *,
    walked_m: Floats,
    offsets: Ints,
    walks: Sequence[tuple[str | int, ...]],
    keys: Sequence[tuple[str | int, ...]],
    settings: SensingSettings,
    seed: int,
) -> Channel:
    """Draw the random part of the link for N windows of recorded walks.

    A walk has lasting parts: its gain along the distance `walked_m`, (M,) m, since the
    walk began, its paths, and the line of errors of a fixed direction. A window has the
    parts that change from sample to sample: beam and error. `walks` and `keys`, N each,
    name the streams of both: windows of one walk in one session share a name in
    `walks`, whatever the gap between them.
    """
    draw, windows = partial(stream, seed, "sensing"), []
    distances_m = np.split(walked_m, offsets[1:-1])
    for way_m, walk, key in zip(distances_m, walks, keys, strict=True):
        rng = draw("large scale", *walk)
        gain = gain_at(
            walked_m=way_m, decorrelation_m=settings.decorrelation_m, rng=rng
        )
        power, delay = _draw_paths(draw("paths", *walk), (1, settings.n_paths))
        beam = draw("beam", *key).standard_normal(way_m.size)
        error = unit_errors(
            n_samples=way_m.size,
            law=settings.law,
            rng=draw("error", *key),
            offsets=np.array([0, way_m.size]),
        )
        if settings.law == "fixed_direction":
            error = _turn_line(error, draw("direction", *walk))
        windows.append((gain, power, delay, beam, error))
    gains, powers, delays, beams, errors = (
        read_only(np.concatenate(parts)) for parts in zip(*windows, strict=True)
    )
    return Channel(
        large_scale=gains,
        path_power=powers,
        path_delay=delays,
        beam=beams,
        unit_error=errors,
    )


def recorded_walk(source: str) -> tuple[str | int, ...]:
    """Return the stream names of a walk that is sensed as it was recorded."""
    return ("recorded walk", source)


def _turn_line(error: Floats, rng: Generator) -> Floats:
    """Turn errors on one line onto another line with a drawn direction, (M, 2)."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    line = error[np.abs(error).max(axis=1).argmax()]
    along = error @ (line / lengths(line))
    return np.asarray(along[:, None] * np.array([np.cos(angle), np.sin(angle)]))


def sense(
    *,
    t: Floats,
    xy: Floats,
    offsets: Ints,
    channel: Channel,
    settings: SensingSettings,
    walk: Ints | None = None,
) -> Sensed:
    """Sense N walks: return raw estimates with their uncertainty.

    At the times `t`, (M,) s, the people truly are at `xy`, (M, 2) m in the frame of the
    base station; `offsets` are (N + 1,), `walk` is as in `Sensed`. A person nearer to
    the station than `NEAREST_M` is sensed as from that distance, where the path loss
    begins.
    """
    away_m: Floats = np.hypot(xy[:, 0] - settings.bs_x_m, xy[:, 1] - settings.bs_y_m)
    distance_m = np.maximum(away_m, NEAREST_M)
    owner = np.repeat(np.arange(offsets.size - 1), np.diff(offsets))
    gain = link_gain(
        distance_m=distance_m, owner=owner, channel=channel, settings=settings
    )
    info = information(gain=gain, settings=settings)
    sigma_raw = sigma_from_information(information=info, settings=settings)
    walk = np.arange(offsets.size - 1) if walk is None else walk
    unit_error, cov = channel.unit_error, None
    if settings.measurement == "range_bearing":
        shaped = _shape_error(xy, sigma_raw, unit_error, settings)
        # The scalar information times sigma_raw^2 is the square of the estimator's gap.
        # It turns the inverse variance of the shaped errors into their information.
        info = info * np.square(sigma_raw) * shaped.information_per_m2
        sigma_raw, unit_error, cov = shaped.sigma_m, shaped.unit_error, shaped.cov
    return Sensed(
        t=t,
        xy=xy + sigma_raw[:, None] * unit_error,
        unit_error=unit_error,
        sigma_raw=sigma_raw,
        information=info,
        fid=fisher_information_density(information=info, t=t, offsets=offsets),
        offsets=offsets,
        law=settings.law,
        walk=walk,
        cov=cov,
    )


class _Shaped(NamedTuple):
    """Raw errors with a shape."""

    cov: Floats  # (M, 2, 2) m^2
    sigma_m: Floats  # (M,) of a round error with the same mean square.
    unit_error: Floats  # (M, 2), in units of `sigma_m`.
    information_per_m2: Floats  # (M,) mean of both axes, of an efficient estimator.


def _shape_error(
    xy: Floats, sigma_m: Floats, unit_error: Floats, settings: SensingSettings
) -> _Shaped:
    """Shape scalar errors of standard deviation `sigma_m`, (M,) m, by `settings`."""
    share = axis_share(settings.law)
    cov = sensed_covariance(xy=xy, sigma_m=sigma_m, settings=settings)
    error = shaped_errors(cov=cov, unit_error=unit_error, law=settings.law)
    shaped_m = np.sqrt(mean_variance(cov) / share)
    return _Shaped(
        cov=cov,
        sigma_m=shaped_m,
        unit_error=error / shaped_m[:, None],
        information_per_m2=share * mean_information(cov),
    )


def walk_numbers(*names: str | int, n_walks: int, seed: int) -> Ints:
    """Draw opaque numbers for the walks of the session called `names`, (n_walks,)."""
    return stream(seed, "walks", *names).integers(2**62, size=n_walks)


def sense_scenes(
    scenes: Scenes,
    *,
    settings: SensingSettings,
    seed: int,
    names: tuple[str | int, ...] = (),
) -> Sensed:
    """Sense the histories of scenes; other stream `names` give independent draws."""
    numbers = scenes.index.tolist()
    channel = draw_channel(
        walked_m=walked_within(scenes.xy, scenes.offsets),
        n_samples=np.diff(scenes.offsets).reshape(len(scenes), -1),
        keys=[("scene", number, *names) for number in numbers],
        settings=settings,
        seed=seed,
    )
    # A walk appears in many scenes, each time elsewhere: every scene is a session.
    walks = [
        walk_numbers("scene", number, n_walks=scenes.n_agents, seed=seed)
        for number in numbers
    ]
    return sense(
        t=scenes.t,
        xy=scenes.xy,
        offsets=scenes.offsets,
        channel=channel,
        settings=settings,
        walk=np.concatenate(walks),
    )
