"""What the base station measures: link budget, Fisher information, CRB, and the raw estimate.

The chain is: link budget -> beta -> Fisher information (eq. swarm_fi) -> Cramer-Rao
bound -> sigma_raw, and Fisher information density (eq. swarm_fid). Two-way (monostatic)
radar.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Final

import numpy as np
from numpy.random import Generator

from isac_track.config import SensingSettings
from isac_track.rng import stream
from isac_track.types import (
    ErrorLaw,
    Floats,
    Ints,
    Scenes,
    Sensed,
    read_only,
    squared_lengths,
)

NEAREST_M = 1.0
"""reading: the reference distance of the path loss, below which it says nothing: the far field of
an antenna of some wavelengths (9 cm each) begins there, and nobody walks through its
mast"""

SPEED_OF_LIGHT_MPS = 299_792_458.0
KNOTS: Final = 200
"""Of a walk's large-scale gain, within the distance over which its correlation falls to 1/e."""


@dataclass(frozen=True, eq=False, slots=True)
class Channel:
    """Random part of the link of N tracks and M samples, without the two fitted spreads."""

    # (M,) standard normal; times `large_scale_db` the sample's gain in dB.
    large_scale: Floats
    # (N, N_p) power of each path, exponential with mean 1 (Rayleigh amplitude).
    path_power: Floats
    # (N, N_p) excess delay, share of `delay_spread_s`; 0 of the first, direct.
    path_delay: Floats
    # (M,) standard normal; times `beam_fluctuation_db` the sample's gain in dB.
    beam: Floats
    unit_error: Floats  # (M, 2) standardised raw error.


def fisher_information_density(
    *, information: Floats, t: Floats, offsets: Ints
) -> Floats:
    """Return the Fisher information density J of every sample (eq. swarm_fid), 1/(m^2 s).

    ``J(t) = I(k) / (t_k - t_(k-1))``, with `intervals_before`; inf for a track of a
    single sample, which a mechanism then protects in full. `information` is (M,) 1/m^2,
    `t` (M,) s.
    """
    interval_s = intervals_before(t=t, offsets=offsets)
    density: Floats = np.full_like(information, np.inf)
    np.divide(information, interval_s, out=density, where=interval_s > 0)
    return density


def intervals_before(*, t: Floats, offsets: Ints) -> Floats:
    """Return the time since the sample before, (M,) s, for times `t`, (M,) s.

    The first sample of a track takes the interval after it; a track of one sample has
    none: 0.
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

    The radar equation at 1 m, lambda^2 rcs / (4 pi)^3, path loss with the table's
    exponent each way, a log-normal gain along the track, N_p Rayleigh paths of each
    track whose excess delay lengthens the way there and back, and the beam's
    fluctuation per sample. `distance_m`, (M,) m, positive, is that from the base
    station; `owner`, (M,), the track of each sample.
    """
    wavelength_m = SPEED_OF_LIGHT_MPS / (settings.carrier_ghz * 1e9)
    at_1m = wavelength_m**2 * settings.rcs_m2 / (4.0 * np.pi) ** 3
    excess_m = 0.5 * SPEED_OF_LIGHT_MPS * settings.delay_spread_s * channel.path_delay
    n_paths = channel.path_power.shape[1]
    paths = np.zeros_like(distance_m)
    for path in range(n_paths):  # a (M, N_p) array would be the largest of a block
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

    Delay: 8 pi^2 B_rms^2 SNR with B_rms^2 = B^2 / 12 for a flat spectrum (Kay,
    Estimation Theory, 1993, ch. 3.11); range is half of it times the speed of light. As
    in the paper for both axes.
    """
    rms_bandwidth_hz2 = (bandwidth_mhz * 1e6) ** 2 / 12.0
    return 8.0 * np.pi**2 * rms_bandwidth_hz2 * (2.0 / SPEED_OF_LIGHT_MPS) ** 2


def information(*, gain: Floats, settings: SensingSettings) -> Floats:
    """Return the Fisher information of every sample from its two-way gain, (M,) 1/m^2.

    ``I = beta * m_s * a^H Q a`` (eq. swarm_fi), with beta in 1/(m^2 W). The beam
    follows the pedestrian: a^H Q a is the table's effective power. Below the SNR at
    which sigma_raw would exceed its cap a target is not detected; the floor ties
    information and sigma_raw there, too.
    """
    noise_w = 10.0 ** ((settings.noise_dbm - 30.0) / 10.0)
    power_w = 10.0 ** ((settings.power_dbm - 30.0) / 10.0)
    processing = 10.0 ** (settings.processing_gain_db / 10.0)
    per_snr = range_information_per_snr(bandwidth_mhz=settings.bandwidth_mhz)
    beta = per_snr * processing * gain / noise_w
    floor = (_gap(settings) / settings.sigma_cap_m) ** 2
    return np.asarray(np.maximum(beta * settings.resource_share * power_w, floor))


def sigma_from_information(*, information: Floats, settings: SensingSettings) -> Floats:
    """Return sigma_raw, (M,) m: sqrt(CRB) = 1 / sqrt(I), times the gap of a real estimator."""
    return np.asarray(_gap(settings) / np.sqrt(information))


def _gap(settings: SensingSettings) -> float:
    return float(10.0 ** (settings.crb_gap_db / 20.0))


def unit_errors(
    *, n_samples: int, law: ErrorLaw, rng: Generator, offsets: Ints | None = None
) -> Floats:
    """Draw standardised errors, (M, 2).

    `radial`: the norm is |N(0, 1)| and the direction uniform (variance 1/2 per axis);
    the reading that fits the paper's PLR. `isotropic`: N(0, 1) per axis.
    `fixed_direction`: as `radial`, all of a track in the direction of its first sample,
    which needs the (N + 1,) `offsets`. All use the same draws, sample by sample: a
    shorter batch is a prefix of a longer one. ValueError for an unknown law, or
    `fixed_direction` without the tracks.
    """
    draws = rng.standard_normal((n_samples, 3))
    if law == "isotropic":
        return draws[:, 1:]
    if law == "radial":
        along = draws[:, 0] / np.sqrt(squared_lengths(draws[:, 1:]))
        errors = np.empty((n_samples, 2))
        for axis in range(2):  # both at once would take longer
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
    """Return a unit vector a track, repeated for its samples, (M, 2): that of its first draw."""
    first = draws[offsets[:-1]]
    direction: Floats = first / np.hypot(first[:, 0], first[:, 1])[:, None]
    return np.repeat(direction, np.diff(offsets), axis=0)


def walked_within(xy: Floats, offsets: Ints) -> Floats:
    """Return how far each track has come at each of its samples, (M, 2) m -> (M,) m."""
    step_m = np.sqrt(squared_lengths(np.diff(xy, axis=0, prepend=xy[:1])))
    step_m[offsets[:-1]] = 0.0
    way_m = np.cumsum(step_m)
    return np.asarray(way_m - np.repeat(way_m[offsets[:-1]], np.diff(offsets)))


def gain_along(
    *, walked_m: Floats, offsets: Ints, innovations: Floats, decorrelation_m: float
) -> Floats:
    """Return the large-scale gain of tracks at their samples, (M,), in standard deviations.

    A Gaussian process over the distance walked with covariance exp(-distance /
    decorrelation_m) (Gudmundson, Electron. Lett. 27, 1991), by its exact transitions:
    `innovations`, (M,), are standard normal, the first of a track its first gain.
    `walked_m`, (M,) m, as `walked_within`.
    """
    from isac_track._gain_loop import (  # noqa: PLC0415 - compiles at first use
        correlated,
    )

    kept = np.exp(-np.diff(walked_m, prepend=0.0) / decorrelation_m)
    kept[offsets[:-1]] = 0.0
    gain = np.empty_like(walked_m)
    correlated(innovations, kept, gain)
    return gain


def gain_at(*, walked_m: Floats, decorrelation_m: float, rng: Generator) -> Floats:
    """Return the large-scale gain of one walk at some distances from its start, (K,).

    Drawn exactly at fixed knots of the whole walk, in their order: the distances asked
    for change no draw. Between two knots the gain is interpolated and scaled to a
    variance of 1. Of any two distances the covariance is off that of `gain_along` by at
    most 1 / (2 KNOTS) (tested).
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
    after, kept = place - before, np.exp(-1.0 / KNOTS)
    mixed = (1.0 - after) * knots[before] + after * knots[before + 1]
    variance = 1.0 - 2.0 * (1.0 - kept) * after * (1.0 - after)
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

    Every batch and quantity has a stream of its own. `n_samples`, (K, A), are those of
    the A tracks of each of K batches (a scene, or one track), `keys` the names of their
    streams; `walked_m`, (M,) m, is `walked_within` them.
    """
    # In hashable form, and remembered: a process works on several pieces of one task in
    # turn.
    innovations, *rest = _drawn(
        tuple(map(tuple, n_samples.tolist())), tuple(keys), settings, seed
    )
    large_scale = gain_along(
        walked_m=walked_m,
        offsets=np.concatenate([[0], np.cumsum(n_samples)]),
        innovations=innovations,
        decorrelation_m=settings.decorrelation_m,
    )
    return Channel(read_only(large_scale), *rest)


@lru_cache(maxsize=2)
def _drawn(
    n_samples: tuple[tuple[int, ...], ...],
    keys: tuple[tuple[str | int, ...], ...],
    settings: SensingSettings,
    seed: int,
) -> tuple[Floats, ...]:
    """Return innovations of the gain, and what a `Channel` holds beside it."""
    draw, batches = partial(stream, seed, "sensing"), []
    for sizes, key in zip(n_samples, keys, strict=True):
        total, offsets = sum(sizes), np.cumsum([0, *sizes])
        large_scale = draw("large scale", *key)
        # First where the tracks begin: of a gain that never changes these are all that
        # counts.
        begins = large_scale.standard_normal(len(sizes))
        innovations = large_scale.standard_normal(total)
        innovations[offsets[:-1]] = begins
        paths, shape = draw("paths", *key), (len(sizes), settings.n_paths)
        power, delay = _paths(paths, shape)
        beam, rng = draw("beam", *key).standard_normal(total), draw("error", *key)
        error = unit_errors(n_samples=total, law=settings.law, rng=rng, offsets=offsets)
        batches.append((innovations, power, delay, beam, error))
    return tuple(read_only(np.concatenate(each)) for each in zip(*batches, strict=True))


def _paths(rng: Generator, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Draw power and excess delay of the paths of some tracks."""
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

    What lasts is of the walk: its gain by the distance `walked_m`, (M,) m, since the
    walk began, its paths, and the line of errors of a fixed direction. What fades from
    sample to sample (beam and error) is of the window. `walks` and `keys`, N each, are
    the names of their streams: windows of one walk in one session share the former,
    whatever lies between them.
    """
    draw, parts = partial(stream, seed, "sensing"), []
    distances_m = np.split(walked_m, offsets[1:-1])
    for way_m, walk, key in zip(distances_m, walks, keys, strict=True):
        rng = draw("large scale", *walk)
        gain = gain_at(
            walked_m=way_m, decorrelation_m=settings.decorrelation_m, rng=rng
        )
        power, delay = _paths(draw("paths", *walk), (1, settings.n_paths))
        beam = draw("beam", *key).standard_normal(way_m.size)
        whole = np.array([0, way_m.size])
        rng = draw("error", *key)
        error = unit_errors(
            n_samples=way_m.size, law=settings.law, rng=rng, offsets=whole
        )
        if settings.law == "fixed_direction":
            error = _turned(error, draw("direction", *walk))
        parts.append((gain, power, delay, beam, error))
    return Channel(
        *(read_only(np.concatenate(each)) for each in zip(*parts, strict=True))
    )


def recorded_walk(source: str) -> tuple[str | int, ...]:
    """Return the names of the streams of a recorded walk as it was sensed when it was walked."""
    return ("recorded walk", source)


def _turned(error: Floats, rng: Generator) -> Floats:
    """Return errors that lie on one line on another one, which is drawn."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    line = error[np.abs(error).max(axis=1).argmax()]
    along = error @ (line / np.hypot(*line))
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
    """Return what the network holds about N walks: raw estimates with their uncertainty.

    At the times `t`, (M,) s, they truly are at `xy`, (M, 2) m in the frame of the base
    station; `offsets` are (N + 1,), `walk` those of `Sensed`. Who is nearer to the
    station than `NEAREST_M` is sensed as from there: the law of the path loss begins at
    this distance.
    """
    away_m: Floats = np.hypot(xy[:, 0] - settings.bs_x_m, xy[:, 1] - settings.bs_y_m)
    distance_m = np.maximum(away_m, NEAREST_M)
    owner = np.repeat(np.arange(offsets.size - 1), np.diff(offsets))
    gain = link_gain(
        distance_m=distance_m, owner=owner, channel=channel, settings=settings
    )
    info = information(gain=gain, settings=settings)
    sigma_raw = sigma_from_information(information=info, settings=settings)
    return Sensed(
        t=t,
        xy=xy + sigma_raw[:, None] * channel.unit_error,
        unit_error=channel.unit_error,
        sigma_raw=sigma_raw,
        information=info,
        fid=fisher_information_density(information=info, t=t, offsets=offsets),
        offsets=offsets,
        law=settings.law,
        walk=np.arange(offsets.size - 1) if walk is None else walk,
    )


def walk_numbers(*names: str | int, n_walks: int, seed: int) -> Ints:
    """Return opaque numbers of the walks of a session that is called by `names`, (n_walks,)."""
    return stream(seed, "walks", *names).integers(2**62, size=n_walks)


def sense_scenes(
    scenes: Scenes,
    *,
    settings: SensingSettings,
    seed: int,
    names: tuple[str | int, ...] = (),
) -> Sensed:
    """Return what the network senses of the histories; with other `names` of the streams anew."""
    n_samples, numbers = (
        np.diff(scenes.offsets).reshape(len(scenes), -1),
        scenes.index.tolist(),
    )
    keys = [("scene", one, *names) for one in numbers]
    channel = draw_channel(
        walked_m=walked_within(scenes.xy, scenes.offsets),
        n_samples=n_samples,
        keys=keys,
        settings=settings,
        seed=seed,
    )
    # A walk is shown in many scenes, each time elsewhere: every showing is a session of
    # its own.
    walks = [
        walk_numbers("scene", one, n_walks=scenes.n_agents, seed=seed)
        for one in numbers
    ]
    return sense(
        t=scenes.t,
        xy=scenes.xy,
        offsets=scenes.offsets,
        channel=channel,
        settings=settings,
        walk=np.concatenate(walks),
    )
