"""The link budget beside a channel of 3GPP: `python scripts/channel_table.py`.

A pedestrian in a street canyon with line of sight (UMi), sensed by a single station, by
3GPP TR 38.901: path loss and shadowing of table 7.4.1-1, cross-section of human model 1
of section 7.9.2.1. The numbers are those of usnistgov/5GNRad, a simulator of NIST
(commit 88892355: `computePathLoss.m`, `getSigmaRCS.m`, `run5GNRad.m`; commit e621bb3b:
`computeShadowFading.m`). Path loss and heights agree with ns-3 (nsnam/ns-3-dev-git,
`three-gpp-propagation-loss-model.cc`). Power, noise, bandwidth, integration gain and
detector are those of this suite on both sides.
"""

import argparse
import sys
from collections.abc import Sequence
from typing import Final

import numpy as np

from isac_track.command_line import DONE, Parser, exit_code
from isac_track.config import SensingSettings
from isac_track.measurement import SPEED_OF_LIGHT_MPS
from isac_track.rng import stream
from isac_track.sensing import (
    Channel,
    information,
    link_gain,
    sigma_from_information,
)
from isac_track.tracking.detections import detection_probability
from isac_track.types import Floats

STATION_M: Final = 10.0  # Heights, of the station in a street canyon and of a person.
PERSON_M: Final = 1.5
SHADOWING_DB: Final = 4.0  # Line of sight; the same on the way there and back.
RCS_DBSM: Final = -1.37  # Of the mean cross-section.
RCS_SPREAD_DB: Final = 3.94  # Log-normal, with a mean of 1 as a plain ratio.
_DISTANCES_M: Final = (10.0, 20.0, 30.0, 40.0, 60.0)
_FALSE_ALARM: Final = 1e-4


def path_loss_db(*, distance_m: Floats | float, carrier_ghz: float) -> Floats:
    """Return the one-way loss with line of sight, dB, below the break point.

    The break point, 4 (h_station - 1) (h_person - 1) f / c, is at 210 m at 3.5 GHz.
    """
    way_m = np.hypot(distance_m, STATION_M - PERSON_M)
    return np.asarray(32.4 + 21.0 * np.log10(way_m) + 20.0 * np.log10(carrier_ghz))


def two_way_db(*, loss_db: Floats, rcs_dbsm: Floats, carrier_ghz: float) -> Floats:
    """Return the two-way power gain of a target, dB, from its one-way loss."""
    wavelength_m = SPEED_OF_LIGHT_MPS / (carrier_ghz * 1e9)
    aperture_db = 10.0 * np.log10(wavelength_m**2 / (4.0 * np.pi))
    return np.asarray(rcs_dbsm - 2.0 * loss_db - aperture_db)


def standard_gains_db(
    distance_m: float, settings: SensingSettings, *, n_draws: int
) -> Floats:
    """Draw two-way gains of the 3GPP channel at a distance, dB."""
    rng = stream(0, "channel table", "standard", f"{distance_m:g}")
    shadowing_db, rcs_db = rng.standard_normal((2, n_draws))
    mean_db = RCS_DBSM - np.log(10.0) / 20.0 * RCS_SPREAD_DB**2
    loss_db = path_loss_db(distance_m=distance_m, carrier_ghz=settings.carrier_ghz)
    return two_way_db(
        loss_db=loss_db + SHADOWING_DB * shadowing_db,
        rcs_dbsm=mean_db + RCS_SPREAD_DB * rcs_db,
        carrier_ghz=settings.carrier_ghz,
    )


def our_gains_db(
    distance_m: float, settings: SensingSettings, *, n_draws: int
) -> Floats:
    """Draw two-way gains of the suite's link budget at a distance, dB."""
    rng = stream(0, "channel table", "ours", f"{distance_m:g}")
    delay = rng.random((n_draws, settings.n_paths))
    delay[:, 0] = 0.0
    channel = Channel(
        large_scale=rng.standard_normal(n_draws),
        path_power=rng.standard_exponential((n_draws, settings.n_paths)),
        path_delay=delay,
        beam=rng.standard_normal(n_draws),
        unit_error=np.zeros((n_draws, 2)),
    )
    gain = link_gain(
        distance_m=np.full(n_draws, distance_m),
        owner=np.arange(n_draws),
        channel=channel,
        settings=settings,
    )
    return np.asarray(10.0 * np.log10(gain))


def row(name: str, gain_db: Floats, settings: SensingSettings) -> str:
    """Return the cells of a channel: gain, spread, error and detection."""
    known = information(gain=10.0 ** (gain_db / 10.0), settings=settings)
    sigma_m = sigma_from_information(information=known, settings=settings)
    detected = detection_probability(
        information=known, false_alarm_probability=_FALSE_ALARM, settings=settings
    )
    middle, below, above = np.quantile(sigma_m, (0.5, 0.1, 0.9))
    return (
        f"{name} | {np.median(gain_db):.1f} | {gain_db.std():.1f} | {middle:.2f}"
        f" ({below:.2f} to {above:.2f}) | {100.0 * detected.mean():.0f}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python scripts/channel_table.py",
        description="The link budget beside a channel of 3GPP TR 38.901.",
    )
    command.add_argument("--draws", metavar="N", type=int, default=20_000)
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    settings = SensingSettings()
    print("| distance, m | channel | gain, dB | spread, dB | sigma, m | detected, % |")
    print("|--:|:--|--:|--:|--:|--:|")
    for distance_m in _DISTANCES_M:
        for name, draw in (("ours", our_gains_db), ("3GPP UMi", standard_gains_db)):
            gain_db = draw(distance_m, settings, n_draws=options.draws)
            cells = row(name, gain_db, settings)
            print(f"| {distance_m:g} | {cells} |")
    return DONE


if __name__ == "__main__":
    sys.exit(main())
