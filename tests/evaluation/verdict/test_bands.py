"""Simultaneous bands: how wide, how often they hold, and what they decide."""

import numpy as np
import pytest
from scipy.stats import norm, t

from evaluation.verdict import rules
from evaluation.verdict.bands import Draft, band_quantile, decide_section
from evaluation.verdict.items import Topic
from evaluation.verdict.verdict_json import item_json
from isac_track.intervals import Estimate


def make_effect(value, drawn, *, n=200, effective=np.nan):
    return Estimate(value, n=n, replicates=value + drawn, effective=effective)


def draft(effect, *, section=rules.CLAIM, parted_at=0.0, unit="fraction", **more):
    words = {
        "above": rules.REVERSED,
        "below": rules.HOLDS,
        "unit": unit,
        "sentences": {"": "{}."},
    }
    topic = Topic(section, "linear")
    return Draft(topic, effect, parted_at, **words, **more)


@pytest.mark.parametrize("n_items", [1, 3, 50])
def test_the_quantile_is_that_of_the_largest_of_independent_normal_numbers(n_items):
    drawn = np.random.default_rng(n_items).standard_normal((n_items, 40_000))
    quantile = band_quantile([make_effect(0.0, drawn_row) for drawn_row in drawn], 0.95)
    assert quantile == pytest.approx(
        norm.ppf((1 + 0.95 ** (1 / n_items)) / 2), abs=0.05
    )
    # Ten times the same item is one item.
    assert band_quantile([make_effect(0.0, drawn[0])] * 10) == pytest.approx(
        band_quantile([make_effect(7.0, drawn[0])])
    )


def test_an_item_with_wild_replicates_does_not_widen_the_others():
    rng = np.random.default_rng(0)
    calm = [make_effect(0.0, drawn_row) for drawn_row in rng.standard_normal((9, 4000))]
    wild = rng.standard_normal(4000) * np.where(rng.random(4000) < 0.03, 4.0, 1.0)
    assert band_quantile([*calm, make_effect(0.0, wild)]) < 1.15 * band_quantile(calm)
    wild[:40] = np.nan  # where an effect has no replicate it is not counted
    assert np.isfinite(band_quantile([*calm, make_effect(0.0, wild)]))


@pytest.mark.slow
def test_bands_hold_all_truths_at_once_as_often_as_they_say():
    """Of 20 means over 40 people that go together; 99.2 %, in 400 studies."""
    rng = np.random.default_rng(1)
    missed = 0
    for _ in range(400):
        people = rng.standard_normal((40, 20)) + rng.standard_normal((40, 1))
        weights = rng.multinomial(40, np.full(40, 1 / 40), 500) / 40
        mean = people.mean(axis=0)
        drawn = weights @ people - mean
        items = [
            draft(make_effect(v, d, n=40)) for v, d in zip(mean, drawn.T, strict=True)
        ]
        missed += any(rules.SIGN[item.decision] for item in decide_section(items))
    assert missed <= 9  # 3.2 are expected; 10 or more in 1 of 500 such tests


@pytest.mark.parametrize(
    ("value", "decision"),
    [(0.05, "reversed"), (-0.05, "holds"), (0.02, "between"), (-0.02, "between")],
)
def test_an_item_is_decided_by_its_band(value, decision):
    drawn = 0.01 * np.random.default_rng(2).standard_normal(2000)
    (item,) = decide_section([draft(make_effect(value, drawn, n=31))])
    assert item.decision == decision
    half, wide = item.effect.ci_high - value, item.band_high - value
    assert half == pytest.approx(t.ppf(0.975, 30) * 0.01, rel=0.05)
    assert wide == pytest.approx(t.ppf(0.996, 30) * 0.01, rel=0.1)
    assert bool(item.why) == (decision == "between")


def test_a_ratio_is_tested_as_logarithm_and_told_as_it_is():
    drawn = 0.1 * np.random.default_rng(3).standard_normal(2000)
    (item,) = decide_section(
        [draft(make_effect(np.log(1.5), drawn), section=rules.INFLATION, unit="ratio")]
    )
    effect = item.effect
    assert effect.value == pytest.approx(1.5)
    assert effect.value / effect.ci_low == pytest.approx(effect.ci_high / effect.value)
    assert item.sentence.startswith("1.50 times [1.2")


NOISE = np.random.default_rng(4).standard_normal(1000)
GAPS = np.where(np.arange(1000) < 30, np.nan, NOISE)


@pytest.mark.parametrize(
    ("effect", "more", "why", "has_interval"),
    [
        (make_effect(9.0, NOISE, effective=19.9), {}, "20 effective clusters", True),
        (make_effect(9.0, NOISE, n=14), {}, "14 effective clusters", False),
        (make_effect(9.0, NOISE * 0), {}, "no spread", True),
        (make_effect(9.0, GAPS), {}, "too few draws", True),
        (make_effect(np.nan, NOISE), {}, "no number", False),
        (
            make_effect(9.0, NOISE),
            {"untestable": "nobody is linked"},
            "nobody is linked",
            True,
        ),
    ],
)
def test_what_cannot_be_tested_says_why_and_is_in_no_band(
    effect, more, why, has_interval
):
    sure = draft(make_effect(9.0, NOISE))
    untested, tested = decide_section([draft(effect, **more), sure])
    assert untested.decision == "not testable"
    assert why in untested.why
    assert np.isnan(untested.band_low)
    assert np.isfinite(untested.effect.ci_low) == has_interval
    (alone,) = decide_section([sure])
    assert item_json(tested) == item_json(alone)
    assert decide_section([]) == []
