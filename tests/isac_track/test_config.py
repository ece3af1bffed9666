"""Settings: every parameter of the paper's table exists and is checked."""

import re
from dataclasses import fields
from itertools import product

import numpy as np
import pytest

from isac_track.config import (
    PrivacySettings,
    SceneSettings,
    SensingSettings,
    StageSettings,
)
from isac_track.errors import SettingsError

PAPER = """
conflict: robot_speed_mps 1.4, horizon_steps 12, window 16, safety_radius_m 0.9
scenes: agents 4, history_ratio 0.7
sensing: bs_x_m 5, bs_y_m 30, carrier_ghz 3.5, bandwidth_mhz 100
sensing: n_paths 4, delay_spread_s 2e-7
sensing: power_dbm 30, noise_dbm -91, path_loss_exponent 2.7, beam_fluctuation_db 2
resample: rate_min_hz 8, rate_max_hz 16
privacy: epsilon_m 0.3
"""


def test_the_papers_table_is_the_default():
    settings = StageSettings().flat()
    for line in PAPER.strip().splitlines():
        stage, values = line.split(": ")
        for name, value in map(str.split, values.split(", ")):
            assert settings[f"{stage}.{name}"] == float(value), name


RANGES = {
    f"{stage.name}.{item.name}": item.metadata["range"]
    for stage in fields(StageSettings())
    for item in fields(getattr(StageSettings(), stage.name))
    if item.metadata
}


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
    result = StageSettings().changed({name: value}).flat()[name]
    assert result == expected
    assert type(result) is type(expected)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"privacy.epsilon": 1}, "'privacy.epsilon'; did you mean privacy.epsilon_m?"),
        ({"zzz": 1}, "unknown setting 'zzz'; `--list` names all settings"),
        (
            {"privacy.epsilon_m": "wide"},
            "privacy.epsilon_m must be a number, got 'wide'",
        ),
        ({"privacy.epsilon_m": True}, "privacy.epsilon_m must be a number, got True"),
        (
            {"conflict.horizon_steps": 1.5},
            "conflict.horizon_steps must be a whole number",
        ),
        ({"conflict.window": 1}, "conflict.window must lie within 2 to 100000, got 1"),
        ({"sensing.law": "laplace"}, "sensing.law must be one of radial, isotropic"),
        (
            {"scenes.history_ratio": 1},
            "scenes.history_ratio must lie between 0 and 1, got 1",
        ),
        (
            {"scenes.ring_max_m": 1},
            "scenes.ring_max_m (1) is below scenes.ring_min_m (2)",
        ),
        (
            {"resample.rate_max_hz": 4},
            "resample.rate_max_hz (4) is below resample.rate_min_hz (8)",
        ),
        ({"linkage.handover_window_s": 0.5}, "is below linkage.handover_least_s (1)"),
        ({"scenes.near_miss_max_m": 0.9}, "a near miss would be a conflict"),
        (
            {"scenes.agents": "1e9"},
            "scenes.agents must lie within 1 to 100, got 1000000000",
        ),
        ({"scenes.agents": []}, "scenes.agents must be a whole number, got []"),
        ({"privacy.epsilon_m": "9" * 99}, "must lie within 1e-06 to 10000, got 1e+99"),
        ({"privacy.epsilon_m": "x" * 199}, f"must be a number, got '{'x' * 99}..."),
    ],
)
def test_a_wrong_setting_says_what_is_wrong(changes, message):
    with pytest.raises(SettingsError, match=re.escape(message)):
        StageSettings().changed(changes)


INFINITE = ("sensing.decorrelation_m", "patrol.segment_s")
ABSURD = [1e9, -1e300, 10**400, -(10**9999), "1e400", "inf", "nan"]


def test_every_number_has_a_range_and_absurd_values_are_errors_in_one_line():
    settings = StageSettings()
    numbers = {
        name for name, value in settings.flat().items() if type(value) is not str
    }
    numbers |= {"conflict.horizons_s"}  # several, given as text
    assert RANGES.keys() == numbers
    for name, value in product(RANGES, ABSURD):
        if name in INFINITE and value in ("inf", "1e400"):
            continue
        with pytest.raises(SettingsError) as caught:
            settings.changed({name: value})
        message = str(caught.value)
        assert message.startswith(f"{name} must ")
        assert len(message) < 200
        assert "\n" not in message


def test_infinity_is_allowed_where_it_has_a_meaning_also_as_text():
    for name, value in product(INFINITE, (np.inf, "inf")):
        assert StageSettings().changed({name: value}).flat()[name] == np.inf
        with pytest.raises(SettingsError, match="1e\\+06, or be inf, got -inf"):
            StageSettings().changed({name: "-inf"})


def test_both_ends_of_a_range_are_allowed():
    for name in (
        "scenes.agents",
        "privacy.epsilon_m",
        "sensing.noise_dbm",
        "linkage.split_gap_s",
    ):
        for value in RANGES[name]:
            assert StageSettings().changed({name: value}).flat()[name] == value


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        (
            PrivacySettings,
            {"epsilon_m": "0.3"},
            "privacy.epsilon_m must be a number, got '",
        ),
        (
            SceneSettings,
            {"agents": 4.0},
            "scenes.agents must be a whole number, got 4.0",
        ),
        (
            SensingSettings,
            {"law": ["radial"]},
            "sensing.law must be one of radial, iso",
        ),
    ],
)
def test_a_wrong_type_given_in_python_is_an_error_that_names_the_setting(
    kind, values, message
):
    with pytest.raises(SettingsError, match=re.escape(message)):
        kind(**values)


def test_numbers_of_numpy_are_numbers():
    assert SceneSettings(agents=np.int64(3)).agents == 3
    assert PrivacySettings(epsilon_m=np.float64(0.5)).epsilon_m == 0.5


@pytest.mark.parametrize("place_m", ["691000.5", "5334000.25", "9999999", "-2e7"])
def test_places_may_be_those_of_a_map(place_m):
    for name in (
        "sensing.bs_x_m",
        "sensing.bs_y_m",
        "scenes.robot_x_m",
        "scenes.robot_y_m",
    ):
        assert StageSettings().changed({name: place_m}).flat()[name] == float(place_m)
