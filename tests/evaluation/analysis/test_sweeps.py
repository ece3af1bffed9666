"""Curves over the levels of a mechanism: made monotone, interpolated, and never extrapolated."""

import numpy as np
import pytest
from helpers.mechanisms import RULE, sweeps_of
from helpers.straight_lines import FID, FIXED, run
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import isotonic_regression

from evaluation.analysis.keys import Key, Measure
from evaluation.analysis.sweeps import interpolated, monotone, places
from evaluation.experiment.presets import SHARED


@settings(max_examples=200, deadline=None)
@given(
    arrays(np.float64, st.tuples(st.integers(1, 4), st.integers(1, 9)), elements=st.floats(-9, 9)),
    st.booleans(),
)
def test_monotone_is_isotonic_regression_of_scipy(values, increasing):
    expected = [isotonic_regression(row, increasing=increasing).x for row in values]
    assert np.allclose(monotone(values, increasing=increasing), expected, atol=1e-12)


def test_a_row_of_unknowns_stays_unknown():
    values = np.array([[1.0, np.nan, 2.0], [3.0, 1.0, 2.0]])
    found = monotone(values, increasing=True)
    assert np.isnan(found[0]).any()
    assert found[1].tolist() == [2.0, 2.0, 2.0]


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_interpolated_equals_numpy_within_reach_and_is_unknown_beyond(seed, log):
    rng = np.random.default_rng(seed)
    change = -np.sort(-np.round(rng.random((3, 6)), 1), axis=1)  # with ties
    change -= change[:, -1:]
    values = np.sort(rng.random((3, 6)), axis=1) + 0.1
    at = rng.random(7)
    found = interpolated(places(at, change), values, log=log)
    for row in range(3):
        y = np.log(values[row]) if log else values[row]
        expected = np.interp(at - 1e-9, change[row, ::-1], y[::-1], right=np.nan)
        assert np.allclose(found[row], np.exp(expected) if log else expected, equal_nan=True)


def test_rows_may_be_read_at_places_of_their_own():
    change = np.array([[1.0, 0.0], [2.0, 0.0]])
    values = np.array([[0.0, 1.0], [0.0, 1.0]])
    found = interpolated(places(np.array([[0.5], [0.5]]), change), values, log=False)
    assert found[:, 0] == pytest.approx([0.5, 0.75])


def test_levels_run_from_the_noisiest():
    sweeps = sweeps_of(run(stranger=0.1))
    assert sweeps.levels("fid") == list(FID)
    assert sweeps.levels("fixed" + RULE) == list(FIXED)[::-1]
    assert sweeps.levels("mine:Ou") == [2.0 - level for level in FIXED][::-1]
    assert sweeps.levels("unknown") == []


def test_a_mechanism_is_judged_under_its_own_rule_and_without_one_under_both():
    sweeps = sweeps_of(run(stranger=0.1))
    assert sweeps.swept("linear") == ["fid", "fixed", "mine:Ou"]
    assert sweeps.swept("independent") == [f"fid{RULE}", f"fixed{RULE}", "mine:Ou"]


def test_a_curve_ends_at_raw():
    found = run()
    curve = sweeps_of(found).curve("fid", Measure(SHARED, "plr"))
    assert curve.shape == (201, len(FID) + 1)
    assert curve[0, -1] == pytest.approx(found[Key("raw", None, SHARED, "plr")].value)


def test_without_raw_or_with_one_level_there_is_none():
    found = run()
    no_raw = {key: one for key, one in found.items() if key.mechanism != "raw"}
    assert sweeps_of(no_raw).curve("fid", Measure(SHARED, "plr")) is None
    one_level = {key: one for key, one in found.items() if key.level in (None, 1.0)}
    assert sweeps_of(one_level).curve("fid", Measure(SHARED, "plr")) is None
