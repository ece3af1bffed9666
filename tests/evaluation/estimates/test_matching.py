"""Curves over levels: monotone, interpolated, never extrapolated; matched points."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.addresses import address_at
from helpers.mechanisms import RULE, make_sweeps
from helpers.straight_lines import FID, FIXED, PREDICTORS, run
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import isotonic_regression, lsq_linear

from evaluation.estimates.interpolation import (
    interpolated,
    isotonic_joined,
    isotonic_rows,
    positions_at_change,
)
from evaluation.estimates.matching import COLUMNS, N_ATTACK_POINTS, N_POINTS, matched
from evaluation.estimates.sweeps import AT_EQUAL_ALARMS, EQUAL_PLR, MISSED, at_changes
from evaluation.plan.address import parse_consumer
from evaluation.plan.presets import SHARED


@settings(max_examples=200, deadline=None)
@given(
    arrays(
        np.float64,
        st.tuples(st.integers(1, 4), st.integers(1, 9)),
        elements=st.floats(-9, 9),
    )
)
def test_rising_is_isotonic_regression_of_scipy(values):
    expected = [isotonic_regression(row).x for row in values]
    assert np.allclose(isotonic_rows(values), expected, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_two_curves_that_end_in_one_raw_are_the_nearest_that_are_monotone(
    seed, increasing
):
    """Against a solver of least squares over steps that are not negative."""
    rng = np.random.default_rng(seed)
    a, b = (np.round(rng.normal(size=(1, n)), 1) for n in rng.integers(2, 6, 2))
    b[:, -1] = a[:, -1]
    first, second = isotonic_joined([a, b], increasing=increasing)
    assert first[0, -1] == second[0, -1]
    n = a.size + b.size - 1
    # Every level is raw less the steps between.
    sign = -1.0 if increasing else 1.0
    steps = np.zeros((n, n - 1))
    for start, size in ((1, a.size - 1), (a.size, b.size - 1)):
        for row in range(size):
            steps[start + row, start - 1 : start + row] = sign
    design = np.column_stack([np.ones(n), steps])
    target = np.concatenate([a[0, -1:], a[0, -2::-1], b[0, -2::-1]])
    solution = lsq_linear(
        design, target, bounds=([-np.inf] + [0.0] * (n - 1), np.inf), method="bvls"
    )
    expected = design @ solution.x
    ours = np.concatenate([first[0, ::-1], second[0, -2::-1]])
    assert ours == pytest.approx(expected, abs=1e-12)


def test_a_row_of_unknowns_stays_unknown():
    values = np.array([[1.0, np.nan, 2.0], [3.0, 1.0, 2.0]])
    result = isotonic_rows(values)
    assert np.isnan(result[0]).any()
    assert result[1].tolist() == [2.0, 2.0, 2.0]


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_interpolated_equals_numpy_within_reach_and_is_unknown_beyond(seed, log):
    rng = np.random.default_rng(seed)
    change = -np.sort(-np.round(rng.random((3, 6)), 1), axis=1)  # with ties
    change -= change[:, -1:]
    values = np.sort(rng.random((3, 6)), axis=1) + 0.1
    at = rng.random(7)
    result = interpolated(positions_at_change(at, change), values, log=log)
    for row in range(3):
        y = np.log(values[row]) if log else values[row]
        expected = np.interp(at - 1e-9, change[row, ::-1], y[::-1], right=np.nan)
        assert np.allclose(
            result[row], np.exp(expected) if log else expected, equal_nan=True
        )


def test_rows_may_be_read_at_places_of_their_own():
    change = np.array([[1.0, 0.0], [2.0, 0.0]])
    values = np.array([[0.0, 1.0], [0.0, 1.0]])
    result = interpolated(
        positions_at_change(np.array([[0.5], [0.5]]), change), values, log=False
    )
    assert result[:, 0] == pytest.approx([0.5, 0.75])


def test_levels_run_from_the_noisiest():
    sweeps = make_sweeps(run(stranger=0.1))
    assert sweeps.levels("fid") == list(FID)
    assert sweeps.levels("fixed" + RULE) == list(FIXED)[::-1]
    assert sweeps.levels("mine:Ou") == [2.0 - level for level in FIXED][::-1]
    assert sweeps.levels("unknown") == []
    # A mechanism is judged under its own rule, and without one under both.
    assert sweeps.swept("linear") == ["fid", "fixed", "mine:Ou"]
    assert sweeps.swept("independent") == [f"fid{RULE}", f"fixed{RULE}", "mine:Ou"]


def test_a_curve_ends_at_raw_and_without_it_or_with_one_level_there_is_none():
    estimates = run()
    both = dict.fromkeys(("fid", "raw"), parse_consumer(SHARED).measured("plr"))
    curve = make_sweeps(estimates).together(both)["fid"]
    assert curve.shape == (201, len(FID) + 1)
    assert curve[0, -1] == pytest.approx(
        estimates[address_at("raw", None, SHARED, "plr")].value
    )
    no_raw = {
        key: estimate for key, estimate in estimates.items() if key.mechanism != "raw"
    }
    assert make_sweeps(no_raw).together(both) == {}
    single_level = {
        key: estimate for key, estimate in estimates.items() if key.level in (None, 1.0)
    }
    assert make_sweeps(single_level).together(both) == {}


def frame(estimates):
    return matched(make_sweeps(estimates), predictors=PREDICTORS, dataset="students03")


def test_few_effective_clusters_have_no_interval():
    few = {key: replace(item, effective=8.0) for key, item in run().items()}
    rows = frame(few)
    assert rows["difference"].notna().any()
    ends = ["fid_low", "fid_high", "fixed_low", "fixed_high", "ci_low", "ci_high"]
    assert rows[ends].isna().all(axis=None)


@pytest.fixture(scope="module")
def table():
    return frame(run())


@pytest.fixture(scope="module")
def better():
    """FID shows exp(-0.1) times what fixed noise of the same missed rate shows."""
    return frame(run(advantage=0.1))


def test_equal_mechanisms_do_not_differ_under_any_criterion(table):
    assert set(table["criterion"]) == {MISSED, AT_EQUAL_ALARMS, EQUAL_PLR}
    assert np.allclose(table["difference"], 0.0, atol=2e-4)
    assert list(table.columns) == COLUMNS


def test_an_advantage_is_read_at_equal_rate(better):
    part = better[(better["consumer"] == SHARED) & (better["criterion"] != EQUAL_PLR)]
    # Towards raw both end in the same point.
    inner = part[(part["at"] > 0.03) & (part["defined"] >= 0.975)]
    assert np.allclose(np.log(inner["fid"] / inner["fixed"]), -0.1, atol=0.002)
    assert (inner["ci_high"] < 0).all()


def test_at_equal_plr_the_linkers_are_compared(better):
    """FID reaches a PLR with 0.1 less noise, and so 0.03 more people are linked."""
    part = better[(better["criterion"] == EQUAL_PLR) & (better["metric"] == "rank1")]
    low = part[part["at"] < np.exp(-0.5 - 0.2)]
    assert len(low) > 10
    assert np.allclose(low["difference"], 0.03, atol=2e-4)
    assert part["at"].is_monotonic_increasing or part["adding"].nunique() == 2
    assert np.isnan(part["missed_conflict_rate"]).all()


def test_what_is_compared_for_whom(table):
    """Every predictor as shared, the first for attacks; no control; own data sets."""
    rates = table[table["criterion"] == MISSED]
    shared = rates["consumer"] == SHARED
    assert set(rates[shared]["predictor"]) == set(PREDICTORS)
    assert set(rates[~shared]["predictor"]) == {PREDICTORS[0]}
    assert set(table[table["criterion"] == EQUAL_PLR]["predictor"]) == {""}
    assert not table["consumer"].str.contains("control-").any()
    simulated = table["consumer"].str.startswith("new_traversal/")
    assert set(table[simulated]["dataset"]) == {"plaza-two-sessions"}
    assert set(table[~simulated]["dataset"]) == {"students03"}
    sizes = table.groupby(
        ["criterion", "adding", "predictor", "consumer", "metric"]
    ).size()
    shared = sizes.index.get_level_values("consumer") == SHARED
    assert set(sizes[shared]) == {N_POINTS}
    assert set(sizes[~shared]) == {N_ATTACK_POINTS}


def test_nothing_is_extrapolated(table):
    """FID reaches a noise of 0.8, fixed of 1: rises end at 0.8 times 0.2."""
    rates = table[
        (table["criterion"] == MISSED) & (table["predictor"] == PREDICTORS[0])
    ]
    assert rates["at"].max() == pytest.approx(0.16)
    alarms = table[
        (table["criterion"] == AT_EQUAL_ALARMS) & (table["consumer"] == SHARED)
    ]
    assert alarms["at"].max() == pytest.approx(0.24)
    plr = table[table["criterion"] == EQUAL_PLR]
    assert plr["at"].min() == pytest.approx(np.exp(-1.3), rel=1e-6)
    assert plr["at"].max() < np.exp(-0.5)


def test_a_point_that_few_replicates_reach_has_no_interval():
    estimates = run()
    missed = estimates[address_at("fid", 1.0, PREDICTORS[0], "missed_conflict_rate")]
    missed.replicates[::2] = 0.1  # half of the replicates end early
    table = frame(estimates)
    last = table[(table["criterion"] == MISSED) & (table["predictor"] == PREDICTORS[0])]
    last = last[(last["adding"] == "linear") & (last["at"] == last["at"].max())]
    assert (last["defined"] < 0.6).all()
    assert np.isnan(last[["ci_low", "fid_low"]]).all(axis=None)
    assert np.isfinite(last["difference"]).all()
    # Where all of them reach one of the two, that one has its own.
    assert np.isfinite(last[["fixed_low", "fixed_high"]]).all(axis=None)


LINKED = parse_consumer("rerelease/shape", "blind").measured("rank1")


def test_unequal_numbers_of_replicates_are_paired_with_the_first():
    by, rank1 = parse_consumer(PREDICTORS[0]).measured("missed_conflict_rate"), LINKED
    curves = make_sweeps(run(advantage=0.1)).curves("fid", "fixed", [by, rank1])
    (pair,) = at_changes(curves, by, [rank1], at=np.array([0.05]))
    ours, theirs = pair.first, pair.second
    # Replicates of rank 1 are 100 of 200: paired with the others there would be a
    # spread.
    assert ours.shape == theirs.shape == (101, 1)
    assert (ours - theirs)[1:].std() < 1e-3


def test_each_replicate_is_read_at_its_own_raw_rate():
    """Rates that move together over replicates do not change the difference."""
    estimates = run(advantage=0.1)
    shift = np.linspace(-0.03, 0.03, 200)
    moved = {
        key: (
            replace(item, replicates=item.value + shift)
            if key.metric == "missed_conflict_rate"
            else replace(item, replicates=np.full(200, item.value))
        )
        for key, item in estimates.items()
    }
    table, still = (
        item[(item["criterion"] == MISSED) & (item["consumer"] == SHARED)]
        for item in (frame(moved), frame(estimates))
    )
    assert np.allclose(table["difference"], still["difference"])
    assert np.allclose(table["ci_low"], table["difference"], atol=1e-9)
    assert np.allclose(table["ci_high"], table["difference"], atol=1e-9)


def test_without_fid_raw_or_the_predictor_nothing_is_matched():
    estimates = run()
    for left_out in ("raw", "fid"):
        some = {
            key: estimate
            for key, estimate in estimates.items()
            if not key.mechanism.startswith(left_out)
        }
        assert frame(some).empty
    assert matched(make_sweeps({}), predictors=["another"], dataset="students03").empty


def test_a_mechanism_of_somebody_elses_is_matched_with_fixed_noise_under_both_rules(
    better,
):
    """It shows exp(-0.2) times what fixed noise of the same missed rate shows."""
    table = frame(run(advantage=0.1, stranger=0.2))
    assert set(
        zip(table["mechanism"], table["family"], table["adding"], strict=True)
    ) == {
        ("fid", "fid", "linear"),
        ("fid:adding=independent", "fid", "independent"),
        ("mine:Ou", "mine:Ou", "linear"),
        ("mine:Ou", "mine:Ou", "independent"),
    }
    own = table[(table["family"] == "mine:Ou") & (table["consumer"] == SHARED)]
    inner = own[
        (own["criterion"] == MISSED) & (own["at"] > 0.03) & (own["defined"] >= 0.975)
    ]
    assert np.allclose(np.log(inner["fid"] / inner["fixed"]), -0.2, atol=0.002)
    assert table[table["family"] == "fid"].reset_index(drop=True).equals(better)
