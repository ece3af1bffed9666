"""The difference of two numbers, and how sure it is."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.estimates import ratio_estimate
from scipy.stats import norm, ttest_rel
from scipy.stats import t as student

from evaluation.estimates.differences import run_difference
from isac_track.intervals import Estimate, cluster_weights, wilson

WEIGHTS = cluster_weights(n_clusters=40, n_replicates=1000, seed=3)


def estimate(values, **options):
    return ratio_estimate(
        numerator=values, denominator=np.ones(values.shape), weights=WEIGHTS, **options
    )


class TestDifference:
    def test_it_is_a_paired_t_test_where_everybody_weighs_the_same(self):
        rng = np.random.default_rng(1)
        person = rng.normal(0, 3, 40)
        a, b = person + rng.normal(0, 1, 40), person + 0.5 + rng.normal(0, 1, 40)
        result = run_difference(estimate(a), estimate(b), paired=True, metric="ael")
        expected = ttest_rel(b, a)
        assert result.difference == pytest.approx((b - a).mean())
        assert result.t == pytest.approx(expected.statistic, rel=0.08)
        interval = expected.confidence_interval()
        assert [result.ci_low, result.ci_high] == pytest.approx(
            list(interval), abs=0.08
        )

    def test_not_paired_the_ends_agree_with_the_p_value(self):
        rng = np.random.default_rng(4)
        a, b = (estimate(rng.normal(mean, 1, 40)) for mean in (0.0, 0.4))
        result = run_difference(a, b, paired=False, metric="ael")
        assert result.difference / (result.difference - result.ci_low) * norm.ppf(
            0.975
        ) == pytest.approx(result.t)
        back = run_difference(b, a, paired=False, metric="ael")
        assert back.t == pytest.approx(-result.t)
        assert [back.ci_low, back.ci_high] == pytest.approx(
            [-result.ci_high, -result.ci_low]
        )

    def test_intervals_without_replicates_are_those_of_independent_numbers(self):
        a = Estimate(0.20, 0.10, 0.35, n=22)
        b = Estimate(0.50, 0.35, 0.65, n=22)
        result = run_difference(a, b, paired=False, metric="rank1")
        # Newcombe's interval, by hand.
        low, high = 0.3 - np.hypot(0.15, 0.15), 0.3 + np.hypot(0.15, 0.10)
        assert [result.ci_low, result.ci_high] == pytest.approx([low, high])
        t = 0.3 / (np.hypot(0.15, 0.15) / norm.ppf(0.975))
        assert result.p_value == pytest.approx(2 * student.sf(t, df=21))

    def test_numbers_without_any_interval_are_not_tested(self):
        a, b = (Estimate(value, n=22) for value in (0.2, 0.5))
        result = run_difference(a, b, paired=False, metric="rank1")
        assert result.difference == pytest.approx(0.3)
        assert np.isnan([result.ci_low, result.ci_high, result.p_value]).all()

    def test_a_share_of_zero_is_not_taken_for_certain(self):
        never = estimate(np.zeros(40), is_share=True)
        seldom = estimate(np.eye(40)[0], is_share=True)
        result = run_difference(
            never, seldom, paired=True, metric="missed_conflict_rate"
        )
        assert result.difference == pytest.approx(1 / 40)
        up = wilson(hits=0, n=40)[1]
        assert result.ci_low == pytest.approx(
            1 / 40 - np.hypot(1 / 40 - seldom.ci_low, up)
        )
        assert result.p_value > 0.3

    def test_score_metrics_have_fewer_replicates(self):
        rng = np.random.default_rng(5)
        a, b = (estimate(rng.normal(size=40)) for _ in range(2))
        short = replace(b, replicates=b.replicates[:200])
        result = run_difference(a, short, paired=True, metric="auc")
        drawn = b.replicates[:200] - a.replicates[:200]
        ends = np.quantile(drawn, [0.025, 0.975])
        assert [result.ci_low, result.ci_high] == pytest.approx(ends)
        mirrored = run_difference(a, short, paired=True, metric="eer")
        assert [mirrored.ci_low, mirrored.ci_high] == pytest.approx(
            2 * result.difference - ends[::-1]
        )

    @pytest.mark.parametrize(("n", "n_replicates"), [(0, 1000), (1, 1000), (40, 0)])
    def test_one_person_or_no_replicate_gives_no_interval(self, n, n_replicates):
        lonely = Estimate(0.5, np.nan, np.nan, n, np.full(n_replicates, 0.5))
        crowd = estimate(np.arange(40) / 40)
        result = run_difference(lonely, crowd, paired=True, metric="plr")
        assert result.difference == pytest.approx(crowd.value - 0.5)
        assert np.isnan([result.ci_low, result.ci_high, result.t, result.p_value]).all()

    def test_the_same_step_for_everybody_is_certain(self):
        values = np.arange(40) / 8
        a, b = (estimate(values + step) for step in (0.0, 0.25))
        result = run_difference(a, b, paired=True, metric="ael")
        assert result.difference == pytest.approx(0.25)
        assert result.p_value < 1e-12
