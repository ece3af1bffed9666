"""Matched operating points: monotone curves, interpolation without extrapolation, pairing."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import isotonic_regression

from evaluation.analysis.keys import Key, Measure
from evaluation.analysis.matching import (
    AT_EQUAL_ALARMS,
    COLUMNS,
    MISSED,
    N_ATTACK_POINTS,
    N_POINTS,
    PLR,
    comparisons,
    matched,
)
from evaluation.analysis.metrics import EQUAL_ALARMS
from evaluation.analysis.sweeps import Sweeps, interpolated, monotone
from evaluation.experiment.presets import SHARED
from isac_track.intervals import Estimate

RULE = ":adding=independent"
FIXED = dict(zip(np.linspace(0.05, 1.0, 20), np.linspace(0.05, 1.0, 20), strict=True))
FID = dict(zip(10.0 ** np.arange(16), np.linspace(0.8, 0.05, 16), strict=True))
"""Noise of every level."""
PREDICTORS = ("least_squares", "kalman_cv")


def estimate(value, spread, *, n=30):
    """Replicates are the estimate times one common draw, so that everything is paired."""
    return Estimate(value, value, value, n, value * (1.0 + spread))


def run(*, advantage=0.0, n_replicates=200, linked=True):
    """A run in which the missed rate, PLR and rank 1 are straight lines in the noise."""
    spread = 0.02 * np.random.default_rng(0).standard_normal(n_replicates)
    found = {}

    def level(mechanism, at, noise, gain):
        for predictor, more in zip(PREDICTORS, (0.0, 0.05), strict=True):
            found[Key(mechanism, at, predictor, "missed_conflict_rate")] = estimate(
                0.1 + more + 0.2 * noise, spread
            )
            found[Key(mechanism, at, predictor, EQUAL_ALARMS)] = estimate(
                0.1 + more + 0.3 * noise, spread
            )
        for metric, scale in (("plr", 1.0), ("ael", 2.0), ("mel", 5.0)):
            value = scale * np.exp(-0.5 - noise - gain)
            found[Key(mechanism, at, SHARED, metric)] = estimate(value, spread)
            found[Key(mechanism, at, "kalman_rts", metric, "blind")] = estimate(2 * value, spread)
        if linked:
            link = estimate(0.7 - 0.3 * noise, spread[:100])
            found[Key(mechanism, at, "rerelease/shape", "rank1", "blind")] = link
            found[Key(mechanism, at, "rerelease/control-random", "rank1", "")] = link
            found[Key(mechanism, at, "new_traversal/shape", "auc", "blind")] = link

    level("raw", None, 0.0, 0.0)
    for rule in ("", RULE):
        for at, noise in FIXED.items():
            level("fixed" + rule, at, noise, 0.0)
        for at, noise in FID.items():
            level("fid" + rule, at, noise, advantage)
    return found


def frame(found):
    return matched(tuple(comparisons(found, predictors=PREDICTORS)), dataset="students03")


class TestMonotone:
    @settings(max_examples=200, deadline=None)
    @given(
        arrays(
            np.float64, st.tuples(st.integers(1, 4), st.integers(1, 9)), elements=st.floats(-9, 9)
        ),
        st.booleans(),
    )
    def test_equals_isotonic_regression_of_scipy(self, values, increasing):
        expected = [isotonic_regression(row, increasing=increasing).x for row in values]
        assert np.allclose(monotone(values, increasing=increasing), expected, atol=1e-12)

    def test_a_row_of_unknowns_stays_unknown(self):
        values = np.array([[1.0, np.nan, 2.0], [3.0, 1.0, 2.0]])
        found = monotone(values, increasing=True)
        assert np.isnan(found[0]).any()
        assert found[1].tolist() == [2.0, 2.0, 2.0]


class TestInterpolated:
    @settings(max_examples=200, deadline=None)
    @given(st.integers(0, 2**32 - 1), st.booleans())
    def test_equals_numpy_within_reach_and_is_unknown_beyond(self, seed, log):
        rng = np.random.default_rng(seed)
        change = -np.sort(-np.round(rng.random((3, 6)), 1), axis=1)  # with ties
        change -= change[:, -1:]
        values = np.sort(rng.random((3, 6)), axis=1) + 0.1
        at = rng.random(7)
        found = interpolated(at, change, values, log=log)
        for row in range(3):
            y = np.log(values[row]) if log else values[row]
            expected = np.interp(at - 1e-9, change[row, ::-1], y[::-1], right=np.nan)
            assert np.allclose(found[row], np.exp(expected) if log else expected, equal_nan=True)

    def test_rows_may_be_read_at_places_of_their_own(self):
        change = np.array([[1.0, 0.0], [2.0, 0.0]])
        values = np.array([[0.0, 1.0], [0.0, 1.0]])
        found = interpolated(np.array([[0.5], [0.5]]), change, values, log=False)
        assert found[:, 0] == pytest.approx([0.5, 0.75])


class TestComparisons:
    def test_equal_mechanisms_do_not_differ_under_any_criterion(self):
        table = frame(run())
        assert set(table["criterion"]) == {MISSED, AT_EQUAL_ALARMS, PLR}
        assert np.allclose(table["difference"], 0.0, atol=2e-4)
        assert list(table.columns) == COLUMNS

    def test_an_advantage_is_read_at_equal_rate(self):
        """FID shows exp(-0.1) times what fixed noise of the same missed rate shows."""
        table = frame(run(advantage=0.1))
        part = table[(table["consumer"] == SHARED) & (table["criterion"] != PLR)]
        # Towards raw both end in the same point.
        inner = part[(part["at"] > 0.03) & (part["defined"] >= 0.975)]
        assert np.allclose(np.log(inner["fid"] / inner["fixed"]), -0.1, atol=0.002)
        assert (inner["ci_high"] < 0).all()

    def test_at_equal_plr_the_linkers_are_compared(self):
        """FID reaches a PLR with 0.1 less noise, and so 0.03 more people are linked."""
        table = frame(run(advantage=0.1))
        part = table[(table["criterion"] == PLR) & (table["metric"] == "rank1")]
        low = part[part["at"] < np.exp(-0.5 - 0.2)]
        assert len(low) > 10
        assert np.allclose(low["difference"], 0.03, atol=2e-4)
        assert part["at"].is_monotonic_increasing or part["adding"].nunique() == 2
        assert np.isnan(part["missed_conflict_rate"]).all()

    def test_every_predictor_as_shared_and_the_first_for_attacks(self):
        table = frame(run())
        rates = table[table["criterion"] == MISSED]
        shared = rates["consumer"] == SHARED
        assert set(rates[shared]["predictor"]) == set(PREDICTORS)
        assert set(rates[~shared]["predictor"]) == {PREDICTORS[0]}
        assert set(table[table["criterion"] == PLR]["predictor"]) == {""}

    def test_controls_are_not_compared_and_simulated_tasks_keep_their_data_set(self):
        table = frame(run())
        assert not table["consumer"].str.contains("control-").any()
        simulated = table["consumer"].str.startswith("new_traversal/")
        assert set(table[simulated]["dataset"]) == {"plaza-two-sessions"}
        assert set(table[~simulated]["dataset"]) == {"students03"}

    def test_nothing_is_extrapolated(self):
        """FID reaches a noise of 0.8, fixed of 1: rises end at 0.8 times 0.2."""
        table = frame(run())
        rates = table[(table["criterion"] == MISSED) & (table["predictor"] == PREDICTORS[0])]
        assert rates["at"].max() == pytest.approx(0.16)
        alarms = table[(table["criterion"] == AT_EQUAL_ALARMS) & (table["consumer"] == SHARED)]
        assert alarms["at"].max() == pytest.approx(0.24)
        plr = table[table["criterion"] == PLR]
        assert plr["at"].min() == pytest.approx(np.exp(-1.3), rel=1e-6)
        assert plr["at"].max() < np.exp(-0.5)

    def test_a_point_that_few_replicates_reach_has_no_interval(self):
        found = run()
        one = found[Key("fid", 1.0, PREDICTORS[0], "missed_conflict_rate")]
        one.replicates[::2] = 0.1  # half of the replicates end early
        table = frame(found)
        last = table[(table["criterion"] == MISSED) & (table["predictor"] == PREDICTORS[0])]
        last = last[(last["adding"] == "linear") & (last["at"] == last["at"].max())]
        assert (last["defined"] < 0.6).all()
        assert np.isnan(last["ci_low"]).all()
        assert np.isfinite(last["difference"]).all()

    def test_points_of_a_curve(self):
        table = frame(run())
        sizes = table.groupby(["criterion", "adding", "predictor", "consumer", "metric"]).size()
        shared = sizes.index.get_level_values("consumer") == SHARED
        assert set(sizes[shared]) == {N_POINTS}
        assert set(sizes[~shared]) == {N_ATTACK_POINTS}

    def test_the_mean_difference_is_over_points_with_an_interval(self):
        for one in comparisons(run(advantage=0.1), predictors=PREDICTORS):
            known = np.isfinite(one.difference[1])
            assert one.mean_difference[0] == pytest.approx(one.difference[0][known].mean())

    def test_score_metrics_with_fewer_replicates_are_paired_with_the_first(self):
        """The replicates of rank 1 are 100 of 200: an unpaired comparison would have a spread."""
        for one in comparisons(run(), predictors=PREDICTORS):
            if one.measure.metric == "rank1":
                assert one.mean_difference.size == 101
                assert one.mean_difference[1:].std() < 1e-3


class TestSweeps:
    def test_levels_run_from_the_noisiest(self):
        sweeps = Sweeps(run())
        assert sweeps.levels("fid") == list(FID)
        assert sweeps.levels("fixed" + RULE) == list(FIXED)[::-1]
        assert sweeps.levels("unknown") == []

    def test_a_curve_ends_at_raw(self):
        found = run()
        curve = Sweeps(found).curve("fid", Measure(SHARED, "plr"))
        assert curve.shape == (201, len(FID) + 1)
        assert curve[0, -1] == pytest.approx(found[Key("raw", None, SHARED, "plr")].value)

    def test_without_raw_or_with_one_level_there_is_none(self):
        found = run()
        no_raw = {key: one for key, one in found.items() if key.mechanism != "raw"}
        assert Sweeps(no_raw).curve("fid", Measure(SHARED, "plr")) is None
        one_level = {key: one for key, one in found.items() if key.level in (None, 1.0)}
        assert Sweeps(one_level).curve("fid", Measure(SHARED, "plr")) is None
