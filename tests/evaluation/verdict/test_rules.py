"""The tests of the verdict, against scipy, and their adjustment, by hand."""

import numpy as np
import pytest
from scipy.stats import t

from evaluation.verdict import rules
from evaluation.verdict.rules import decide
from isac_track.intervals import Estimate


def of(value, error, n=30):
    return Estimate(value, value - 2 * error, value + 2 * error, n, closed_error=error)


def test_one_sided_p_values_are_those_of_t():
    one = of(0.3, 0.1)
    assert rules.p_above(one, 0.1) == pytest.approx(t.sf(2.0, 29))
    assert rules.p_below(one, 0.1) == pytest.approx(t.cdf(2.0, 29))


@pytest.mark.parametrize(("value", "expected"), [(0.02, -3.0), (-0.02, -3.0), (0.06, 1.0)])
def test_equivalence_takes_the_worse_of_two_sides(value, expected):
    assert rules.p_within(of(value, 0.01), 0.05) == pytest.approx(t.cdf(expected, 29))


def test_beyond_no_margin_is_the_two_sided_test():
    assert rules.p_beyond(of(-0.25, 0.1), 0.0) == pytest.approx(2 * t.sf(2.5, 29))


def test_beyond_a_margin_keeps_its_size_at_the_margin():
    # A true difference of the margin itself, 4,000 studies.
    rng = np.random.default_rng(0)
    drawn = 0.05 + 0.02 * rng.standard_normal(4_000)
    scale = 0.02 * np.sqrt(rng.chisquare(29, 4_000) / 29)
    p = [rules.p_beyond(of(v, s), 0.05) for v, s in zip(drawn, scale, strict=True)]
    assert np.mean(np.array(p) <= 0.05) == pytest.approx(0.05, abs=0.012)


@pytest.mark.parametrize("one", [of(0.3, 0.01, n=7), of(0.3, np.nan), of(np.nan, 0.1)])
def test_too_few_people_or_no_spread_decide_nothing(one):
    assert {rules.p_above(one, 0), rules.p_below(one, 0)} == {1.0}
    assert {rules.p_beyond(one, 0), rules.p_within(one, 1)} == {1.0}


def test_holm_by_hand():
    p = [0.001, 0.02, 0.004]  # doubled: .002, .04, .008; Holm: .006, .04, .016
    found = decide([{"holds": one} for one in p], alpha=0.0125)
    assert [one[2] for one in found] == pytest.approx([0.006, 0.04, 0.016])
    assert [one[0] for one in found] == ["holds", "undecided", "undecided"]


def test_the_first_option_that_passes_is_the_decision():
    options = {"does not": 0.3, "tracks": 0.01, "weakly": 1e-6}
    assert decide([options], alpha=0.05)[0][0] == "tracks"
    assert decide([options], alpha=0.015)[0][0] == "weakly"


def test_without_items_nothing_is_decided():
    assert decide([]) == []
