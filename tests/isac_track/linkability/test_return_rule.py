"""The rule for people who come back, at each of its edges."""

import math

import numpy as np
import pytest
from scipy.stats import nct, t

from isac_track.intervals import Estimate
from isac_track.linkability.return_rule import (
    LEAST_GAIN,
    ReturnEvidence,
    decide_return,
    return_power,
)


def evidence(low, high, *, p=0.001, n=30):
    return ReturnEvidence(Estimate((low + high) / 2, low, high, n), p)


CONFIRMING = evidence(-0.1, 0.4, p=0.04)


@pytest.mark.parametrize(
    ("cell", "confirming", "decision"),
    [
        (evidence(0.05, 0.3), CONFIRMING, "yes"),
        (evidence(0.049, 0.3), CONFIRMING, "not decided"),
        (evidence(0.05, 0.3, p=0.01), CONFIRMING, "not decided"),
        (evidence(0.05, 0.3), None, "not decided"),
        (evidence(0.05, 0.3), evidence(-0.1, 0.4, p=0.05), "not decided"),
        (evidence(0.05, 0.3), evidence(-0.4, 0.1, p=0.04), "not decided"),
        (evidence(-0.1, 0.049), None, "no"),
        (evidence(-0.1, 0.049, p=0.001), CONFIRMING, "no"),
        (evidence(-0.1, 0.05), None, "not decided"),
        (evidence(-0.1, 0.04, n=19), None, "not decided"),
        (evidence(0.05, 0.3, n=19), CONFIRMING, "not decided"),
        (evidence(math.nan, math.nan), CONFIRMING, "not decided"),
    ],
)
def test_the_rule_decides_at_its_edges(cell, confirming, decision):
    answer = decide_return(cell, confirming=confirming)
    assert answer.decision == decision
    assert answer.n == cell.gain.n


def test_what_is_not_decided_states_the_people_needed():
    answer = decide_return(evidence(-0.2, 0.3))
    assert f"{answer.n_needed} people" in answer.why
    assert answer.n_needed > 30


def test_the_people_needed_have_the_power_that_is_promised():
    # Normal differences of a known spread: the interval's half width is t s / sqrt(n).
    n, std = 400, 0.6
    half = t.ppf(0.975, n - 1) * std / math.sqrt(n)
    _, needed = return_power(Estimate(0.1, 0.1 - half, 0.1 + half, n))
    # Exact power: the t statistic of the gain less 5 points is noncentral.
    shift = (0.15 - LEAST_GAIN) / std * math.sqrt(needed)
    exact = nct.sf(t.ppf(0.975, needed - 1), needed - 1, shift)
    assert exact == pytest.approx(0.8, abs=0.01)


def test_power_at_this_number_of_people_is_that_of_simulated_gains():
    rng = np.random.default_rng(0)
    n, std = 60, 0.5
    drawn = rng.normal(0.15, std, (20_000, n))
    error = drawn.std(axis=1, ddof=1) / math.sqrt(n)
    low = drawn.mean(axis=1) - t.ppf(0.975, n - 1) * error
    half = t.ppf(0.975, n - 1) * std / math.sqrt(n)
    power, _ = return_power(Estimate(0.1, 0.1 - half, 0.1 + half, n))
    assert power == pytest.approx((low >= LEAST_GAIN).mean(), abs=0.01)


def test_a_p_value_out_of_range_is_refused():
    with pytest.raises(ValueError, match=r"0\.\.1"):
        evidence(0.0, 0.1, p=1.5)
