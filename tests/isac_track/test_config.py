"""Settings: every parameter of the paper's table exists, is checked, and changes results."""

import re

import pytest

from isac_track.config import StageSettings, setting_types
from isac_track.errors import SettingsError


def test_the_papers_table_is_the_default():
    paper = {
        "conflict.robot_speed_mps": 1.4,
        "conflict.horizon_steps": 12,
        "conflict.window": 16,
        "conflict.safety_radius_m": 0.9,
        "scenes.agents": 4,
        "scenes.history_ratio": 0.7,
        "sensing.bs_x_m": 5.0,
        "sensing.bs_y_m": 30.0,
        "sensing.carrier_ghz": 3.5,
        "sensing.bandwidth_mhz": 100.0,
        "sensing.n_paths": 4,
        "sensing.delay_spread_s": 2e-7,
        "sensing.power_dbm": 30.0,
        "sensing.noise_dbm": -91.0,
        "sensing.path_loss_exponent": 2.7,
        "sensing.beam_fluctuation_db": 2.0,
        "resample.rate_min_hz": 8.0,
        "resample.rate_max_hz": 16.0,
        "privacy.epsilon_m": 0.3,
    }
    settings = StageSettings().flat()
    assert {name: settings[name] for name in paper} == paper


def test_flat_names_every_setting():
    assert StageSettings().flat().keys() == setting_types().keys()


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("privacy.epsilon_m", "0.5", 0.5),
        ("privacy.epsilon_m", 1, 1.0),
        ("conflict.horizon_steps", "20", 20),
        ("sensing.law", "isotropic", "isotropic"),
    ],
)
def test_text_is_read_as_the_type_of_the_field(name, value, expected):
    found = StageSettings().changed({name: value}).flat()[name]
    assert found == expected
    assert type(found) is type(expected)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"privacy.epsilon": 1},
            "unknown setting 'privacy.epsilon'; did you mean privacy.epsilon_m?",
        ),
        ({"zzz": 1}, "unknown setting 'zzz'; `--list` names all settings"),
        ({"privacy.epsilon_m": "wide"}, "privacy.epsilon_m must be a number, got 'wide'"),
        ({"privacy.epsilon_m": "nan"}, "privacy.epsilon_m must be a finite number"),
        ({"privacy.epsilon_m": True}, "privacy.epsilon_m must be a finite number"),
        ({"privacy.epsilon_m": 0}, "privacy.epsilon_m must be positive"),
        ({"conflict.horizon_steps": 1.5}, "conflict.horizon_steps must be a whole number"),
        ({"conflict.window": 1}, "conflict.window must be at least 2"),
        ({"sensing.law": "laplace"}, "sensing.law must be one of radial, isotropic"),
        ({"sensing.large_scale_db": -1}, "sensing.large_scale_db must not be negative"),
        ({"scenes.history_ratio": 1}, "scenes.history_ratio must lie between 0 and 1"),
        ({"scenes.ring_max_m": 1}, "scenes.ring_max_m is below scenes.ring_min_m"),
        ({"resample.rate_max_hz": 4}, "resample.rate_max_hz (4) is below resample.rate_min_hz (8)"),
        ({"scenes.near_miss_max_m": 0.9}, "a near miss would be a conflict"),
    ],
)
def test_a_wrong_setting_says_what_is_wrong(changes, message):
    with pytest.raises(SettingsError, match=re.escape(message)):
        StageSettings().changed(changes)
