"""Several recordings as one: seeds, signs, and what is pooled."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm, t

from evaluation.estimates.pooled import (
    COLUMNS,
    FURTHER,
    POOLED,
    _less,
    answered,
    pool,
    settings_text,
    to_frame,
)
from isac_track.config import StageSettings
from isac_track.intervals import Estimate

VALUES, ERRORS = [0.10, 0.30, 0.35, 0.65, 0.45], [0.05, 0.06, 0.04, 0.07, 0.05]


def row(recording, value, *, seed="0", half=0.02):
    ends = {"value": value, "ci_low": value - half, "ci_high": value + half}
    about = {
        "question": "robot_loses",
        "adding": "linear",
        "law": "radial",
        "tau2": np.nan,
    }
    about |= {"settings": "", "distance_m": 29.8}
    return {**about, "recording": recording, "seed": seed, **ends, "n": 100}


def test_pooled_as_paule_and_mandel_and_hartung_and_knapp_wrote_it():
    y, v = np.array(VALUES), np.array(ERRORS) ** 2

    def excess(tau2):
        w = 1 / (v + tau2)
        return float(w @ (y - w @ y / w.sum()) ** 2) - (y.size - 1)

    tau2 = brentq(excess, 0, 1)
    w = 1 / (v + tau2)
    mean = w @ y / w.sum()
    error = np.sqrt(w @ (y - mean) ** 2 / ((y.size - 1) * w.sum()))
    result = pool(VALUES, ERRORS)
    assert result.tau2 == pytest.approx(tau2, rel=1e-3)
    assert result.value == pytest.approx(mean, rel=1e-4)
    assert result.ci_high - result.value == pytest.approx(
        t.ppf(0.975, 4) * error, rel=1e-3
    )
    assert result.predicted_low < result.ci_low
    assert result.predicted_high > result.ci_high


def test_never_narrower_than_a_fixed_effect():
    result = pool([0.2, 0.2001, 0.1999], [0.1, 0.1, 0.1])
    assert result.tau2 == pytest.approx(0.0, abs=1e-9)
    assert result.ci_high - result.value == pytest.approx(
        norm.ppf(0.975) * 0.1 / np.sqrt(3)
    )


@pytest.mark.parametrize("errors", [[0.1, 0.1], [0.1, 0.1, 0.0]])
def test_too_few_or_without_an_error_are_not_pooled(errors):
    with pytest.raises(ValueError, match="pooling takes three"):
        pool([0.1] * len(errors), errors)


def test_seeds_are_averaged_and_their_intervals_do_not_shrink():
    rows = [row("a", 0.1, seed="0"), row("a", 0.2, seed="1"), row("plaza", -0.9)]
    (answer,) = answered(rows, simulated=frozenset({"plaza"}))
    assert [r["recording"] for r in answer.rows] == ["a", "plaza"]
    mean = answer.rows[0]
    assert (mean["value"], mean["seed"]) == (pytest.approx(0.15), "mean")
    # People 0.02 / 1.96 and, of two seeds, a variance of 0.005 over 2: Student's t of
    # few degrees.
    people, between = (0.02 / norm.ppf(0.975)) ** 2, 0.005 / 2
    freedom = ((people + between) / between) ** 2
    half = t.ppf(0.975, freedom) * np.sqrt(people + between)
    assert mean["ci_high"] - mean["value"] == pytest.approx(half)
    assert mean["value"] - mean["ci_low"] == pytest.approx(half)
    assert answer.sentence.startswith("One real recording, a: +15.0 points")
    assert answer.pooled is None


def test_seeds_that_agree_have_the_interval_of_any_of_them():
    rows = [row("a", 0.1, seed=seed) for seed in "012"]
    (answer,) = answered(rows, simulated=frozenset())
    ends = answer.rows[0]["ci_low"], answer.rows[0]["ci_high"]
    assert ends == pytest.approx((0.08, 0.12))
    assert answer.sentence == "One real recording, a: +10.0 points; significant at 5 %."


def test_seeds_that_differ_weigh_less_in_the_pool():
    """A recording with unlike seeds has a larger error; the pool leans to others."""
    steady = [
        row(name, value)
        for name, value in zip("abcd", (0.1, 0.1, 0.11, 0.09), strict=True)
    ]
    equal = [*steady, *(row("e", 0.5, seed=seed, half=0.3) for seed in "01")]
    apart = [
        *steady,
        row("e", 0.2, seed="0", half=0.3),
        row("e", 0.8, seed="1", half=0.3),
    ]
    (first,), (second,) = (
        answered(rows, simulated=frozenset()) for rows in (equal, apart)
    )
    assert first.pooled.value > second.pooled.value > 0.09


def test_settings_are_told_as_they_are_typed_without_the_law():
    stages = (
        StageSettings()
        .changed({"sensing.bs_y_m": 53.0, "sensing.law": "isotropic"})
        .flat()
    )
    assert settings_text(stages) == "sensing.bs_y_m=53.0"
    assert settings_text(StageSettings().flat()) == ""


def test_a_recording_without_an_interval_is_named_and_has_no_weight():
    rows = [row(name, value) for name, value in zip("abcde", VALUES, strict=True)]
    few = row("f", 0.9) | {"ci_low": np.nan, "ci_high": np.nan}
    (five,) = answered(rows, simulated=frozenset())
    (six,) = answered([*rows, few], simulated=frozenset())
    assert six.pooled == five.pooled
    frame = to_frame([*rows, few], [six])
    assert frame[frame["recording"] == POOLED].iloc[0]["n"] == 5
    assert "Same sign in 6 of 6" in six.sentence
    assert "; pooled without 1 that have no interval +" in six.sentence
    (four,) = answered([*rows[:4], few], simulated=frozenset())
    assert four.pooled is None


def test_five_real_recordings_are_pooled_and_a_crowd_is_none():
    rows = [row(name, value) for name, value in zip("abcde", VALUES, strict=True)]
    crowd = row("plaza", -5.0)
    (four,) = answered([*rows[:4], crowd], simulated=frozenset({"plaza"}))
    assert four.pooled is None
    (five,) = answered([*rows, crowd], simulated=frozenset({"plaza"}))
    frame = to_frame([*rows, crowd], [five])
    assert list(frame.columns) == COLUMNS
    pooled = frame[frame["recording"] == POOLED].iloc[0]
    assert 0.1 < pooled["value"] < 0.65
    assert pooled["n"] == 5
    assert pooled["tau2"] > 0
    further = frame[frame["recording"] == FURTHER].iloc[0]
    assert further["value"] == pooled["value"]
    assert further["ci_low"] < pooled["ci_low"] < pooled["ci_high"] < further["ci_high"]
    assert f", of a further recording [{100 * further['ci_low']:.1f}, " in five.sentence
    assert "Same sign in 5 of 5" in five.sentence
    assert "least +10.0 points (a), largest +65.0 (d); pooled +3" in five.sentence


def test_signs_that_differ_are_counted():
    rows = [row("a", 0.1), row("b", -0.1), row("c", 0.01)]
    (answer,) = answered(rows, simulated=frozenset())
    assert answer.sentence.startswith(
        "Same sign in 2 of 3 real recordings; least -10.0 points (b)"
    )


def test_an_estimate_less_chance_has_the_clusters_of_the_estimate():
    """A row with too few effective clusters has no interval: the number must stay."""
    linked = Estimate(0.8, 0.7, 0.9, n=40, effective=12.0)
    above_chance = _less(linked, 0.01)
    assert above_chance.value == pytest.approx(0.79)
    assert (above_chance.ci_low, above_chance.ci_high) == pytest.approx((0.69, 0.89))
    assert (above_chance.n, above_chance.n_effective) == (40, 12.0)
