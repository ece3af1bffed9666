"""Distances of people from the base station, and the sensing error that follows."""

from dataclasses import dataclass

import numpy as np

from isac_track.config import SensingSettings
from isac_track.measurement import shaped_sigma
from isac_track.sensing import (
    draw_walk_channel,
    information,
    link_gain,
    recorded_walk,
    sigma_from_information,
    walked_within,
)
from isac_track.types import Bools, Floats, Ints, Tracks, lengths

_LEAST_M = 1e-3  # Least distance from the station.
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Geometry:
    """Medians over the tracks of a recording, each represented by its own median."""

    distance_m: float  # From the base station.
    sigma_raw_m: float  # Standard deviation of the raw error.
    at_cap: float  # Share of the tracks whose median is `sigma_cap_m`, 0 to 1.
    tracks: int


def geometry(tracks: Tracks, *, settings: SensingSettings, seed: int) -> Geometry:
    """Return the geometry of all tracks of a placed recording (`place.placed`).

    The standard deviations are those of the model along every recorded walk.
    """
    station_m = np.array([settings.bs_x_m, settings.bs_y_m])
    distance_m = np.maximum(lengths(tracks.xy - station_m), _LEAST_M)
    sizes = np.diff(tracks.offsets)
    walks = [recorded_walk(source) for source in tracks.source]
    channel = draw_walk_channel(
        walked_m=walked_within(tracks.xy, tracks.offsets),
        offsets=tracks.offsets,
        walks=walks,
        keys=walks,
        settings=settings,
        seed=seed,
    )
    owner = np.repeat(np.arange(sizes.size), sizes)
    gain = link_gain(
        distance_m=distance_m, owner=owner, channel=channel, settings=settings
    )
    info = information(gain=gain, settings=settings)
    scalar_m = sigma_from_information(information=info, settings=settings)
    sigma_m = medians(
        shaped_sigma(xy=tracks.xy, sigma_m=scalar_m, settings=settings), tracks.offsets
    )
    is_capped: Bools = medians(scalar_m, tracks.offsets) >= settings.sigma_cap_m * (
        1.0 - _ROUNDING
    )
    return Geometry(
        distance_m=float(np.median(medians(distance_m, tracks.offsets))),
        sigma_raw_m=float(np.median(sigma_m)),
        at_cap=float(is_capped.mean()),
        tracks=sizes.size,
    )


def medians(values: Floats, offsets: Ints) -> Floats:
    """Return the median of the samples of each track, (M,) -> (N,)."""
    return np.array([np.median(part) for part in np.split(values, offsets[1:-1])])
