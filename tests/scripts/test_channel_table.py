"""The channel of 3GPP against the radar equation, and draws against their means."""

from dataclasses import replace

import numpy as np
import pytest
from channel_table import (
    RCS_DBSM,
    SHADOWING_DB,
    main,
    path_loss_db,
    standard_gains_db,
    two_way_db,
)

from isac_track.config import SensingSettings
from isac_track.measurement import SPEED_OF_LIGHT_MPS
from isac_track.sensing import Channel, link_gain

SETTINGS = SensingSettings()


def test_in_free_space_both_budgets_are_the_radar_equation():
    distance_m = np.array([10.0, 40.0])
    wavelength_m = SPEED_OF_LIGHT_MPS / 3.5e9
    loss_db = 20.0 * np.log10(4.0 * np.pi * distance_m / wavelength_m)
    steady = Channel(
        large_scale=np.zeros(2),
        path_power=np.ones((2, 1)),
        path_delay=np.zeros((2, 1)),
        beam=np.zeros(2),
        unit_error=np.zeros((2, 2)),
    )
    ours = link_gain(
        distance_m=distance_m,
        owner=np.arange(2),
        channel=steady,
        settings=replace(SETTINGS, path_loss_exponent=2.0),
    )
    got = two_way_db(loss_db=loss_db, rcs_dbsm=np.zeros(2), carrier_ghz=3.5)
    np.testing.assert_allclose(got, 10.0 * np.log10(ours), atol=1e-9)


def test_the_line_of_sight_of_the_table_is_near_free_space():
    """At 100 m and 3.5 GHz it is 85.3 dB, free space 83.3 dB."""
    way_m = np.sqrt(100.0**2 - 8.5**2)
    loss_db = path_loss_db(distance_m=way_m, carrier_ghz=3.5)
    assert loss_db == pytest.approx(85.28, abs=0.01)


def test_draws_have_the_spread_and_the_mean_of_the_table():
    gain_db = standard_gains_db(30.0, SETTINGS, n_draws=50_000)
    assert gain_db.std() == pytest.approx(np.hypot(2 * SHADOWING_DB, 3.94), rel=0.02)
    steady = two_way_db(
        loss_db=path_loss_db(distance_m=30.0, carrier_ghz=3.5),
        rcs_dbsm=np.array(RCS_DBSM),
        carrier_ghz=3.5,
    )
    # The cross-section has a mean of 1 as a ratio, so a lower mean in dB.
    assert gain_db.mean() - steady == pytest.approx(-np.log(10) / 20 * 3.94**2, abs=0.1)


def test_prints_a_row_for_each_distance_and_channel(capsys):
    assert main(["--draws", "200"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + 10
    assert lines[2].startswith("| 10 | ours |")
