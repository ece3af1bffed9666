"""Matching, the paper table and the claims, on curves whose answer is known."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.addresses import address_at
from helpers.mechanisms import make_sweeps

from evaluation.estimates import matching, paper
from evaluation.estimates.sweeps import MISSED
from isac_track.intervals import Estimate

N = 200
SHARED, PREDICTOR = "shared", "least_squares"
ETAS = (1.0, 10.0, 100.0, 1000.0)
ERRORS = (0.1, 0.2, 0.5, 1.0)


def matched(estimates, *, dataset, predictors):
    """Return the matched points at equal missed rate, descriptors as shared."""
    table = matching.matched(
        make_sweeps(estimates), predictors=predictors, dataset=dataset
    )
    return table[(table["criterion"] == MISSED) & (table["consumer"] == "shared")]


def claims(estimates, *, dataset="students03", points=366.0, interval_s=0.0834):
    at = matched(estimates, dataset=dataset, predictors=[PREDICTOR])
    history = {"points": points, "interval_s": interval_s}
    return paper.claims(make_sweeps(estimates), at, dataset=dataset, history=history)


def estimate(value, spread=0.0, n=50):
    noise = np.linspace(-1.96, 1.96, N) * spread
    return Estimate(
        value, value - 1.96 * spread, value + 1.96 * spread, n, value + noise
    )


def results(*, advantage=0.0, spread=0.001, suffix="", rate_of_error=None):
    """FID and fixed noise on exponential curves; FID's lies `advantage` (log) lower."""
    result = {}

    def add(mechanism, level, rate, lower):
        result[address_at(mechanism, level, PREDICTOR, "missed_conflict_rate")] = (
            estimate(rate, spread)
        )
        for metric, scale in (("plr", 1.0), ("ael", 2.0), ("mel", 3.0)):
            value = scale * np.exp(-4.0 * rate - lower)
            result[address_at(mechanism, level, SHARED, metric)] = estimate(
                value, spread
            )

    add("raw", None, 0.10, 0.0)
    for level, rate in zip(ETAS, (0.34, 0.30, 0.25, 0.15), strict=True):
        add(f"fid{suffix}", level, rate, advantage)
    for level, rate in zip(
        ERRORS, rate_of_error or (0.11, 0.12, 0.20, 0.40), strict=True
    ):
        add(f"fixed{suffix}", level, rate, 0.0)
    return result


def claim(estimates, text, adding="linear", **history):
    table = claims(estimates, **history)
    rows = table[(table["adding"] == adding) & table["claim"].str.contains(text)]
    return rows.iloc[0]


@pytest.mark.parametrize("size", [{"n": 8}, {"effective": 8.0}])
def test_with_few_people_nothing_is_decided_and_elsewhere_nothing_of_the_history(size):
    few = {
        key: replace(number, **size) for key, number in results(advantage=0.05).items()
    }
    table = claims(few, dataset="plaza", points=350.0)
    assert len(table) > 5
    assert set(table["answer"]) == {"not testable"}
    assert table["evidence"].str.startswith("fewer than 20 people; ").all()
    assert not table["claim"].str.contains("history").any()


@pytest.mark.parametrize(
    ("advantage", "answer"),
    [(0.05, "holds"), (-0.05, "does not hold"), (0.0, "between")],
)
def test_better_at_every_rate_under_either_rule(advantage, answer):
    result = results() | results(suffix=":adding=independent", advantage=advantage)
    assert claim(result, "lower PLR", adding="independent")["answer"] == answer
    assert claim(result, "lower PLR", adding="linear")["answer"] == "between"


@pytest.mark.parametrize(("rate", "answer"), [(0.12, "holds"), (0.19, "does not hold")])
def test_close_to_raw(rate, answer):
    row = claim(results(rate_of_error=(0.11, rate, 0.2, 0.4)), "0.2 m: missed")
    assert (row["answer"], row["effect"]) == (answer, pytest.approx(rate - 0.10))


def test_monotone_holds_fails_and_stays_between():
    result = results()
    assert claim(result, "rate falls")["answer"] == "holds"
    assert claim(result, "MEL rises")["answer"] == "holds"
    bump = {
        address_at("fid", 100.0, SHARED, "plr"): estimate(0.1, 0.001)
    }  # below its neighbours
    row = claim(result | bump, "PLR rises")
    assert row["answer"] == "does not hold"
    assert "1 beyond their interval" in row["evidence"]
    flat = dict(result)
    for level in ETAS:
        values = np.random.default_rng(int(level)).normal(0.3, 0.05, N)
        flat[address_at("fid", level, SHARED, "plr")] = Estimate(
            0.3, 0.2, 0.4, 50, values
        )
    assert claim(flat, "PLR rises")["answer"] == "between"


@pytest.mark.parametrize(
    ("history", "holds"),
    [({}, True), ({"points": 361.0}, False), ({"interval_s": 0.0866}, False)],
)
def test_the_history_claim(history, holds):
    answer = claim(results(), "history", adding="", **history)["answer"]
    assert answer == ("holds" if holds else "does not hold")


@pytest.mark.parametrize("spread", [0.001, 0.01])
def test_the_paper_table_says_within_only_for_the_papers_recording(spread):
    result = results()
    result[address_at("raw", None, PREDICTOR, "missed_conflict_rate")] = estimate(
        0.10, spread
    )
    ours = paper.paper_table(make_sweeps(result), dataset="students03")
    raw = ours[
        (ours["mechanism"] == "raw") & (ours["metric"] == "missed_conflict_rate")
    ].iloc[0]
    assert (raw["paper"], raw["ours"]) == (0.105, 0.10)
    assert raw["within"] == (spread == 0.01)
    assert (
        paper.paper_table(make_sweeps(result), dataset="plaza")["within"].isna().all()
    )


def test_published_numbers_are_those_of_the_reference():
    """Against the hand-copied reference table beside the tests."""
    path = Path(__file__).parents[2] / "reference" / "paper.json"
    reference = json.loads(path.read_text(encoding="utf-8"))
    expected = {
        (row["mechanism"], row["level"], metric): value
        for row in reference["rows"]
        for metric, value in row.items()
        if metric not in ("mechanism", "level")
    }
    assert {tuple(where): value for *where, value in paper.PUBLISHED} == pytest.approx(
        expected
    )


@pytest.mark.parametrize(
    ("mechanism", "metric", "published", "goal"),
    [
        ("raw", "missed_conflict_rate", 0.105, 0.04),
        ("fid", "plr", 0.2, 0.015),
        ("fid", "mel", 0.3, 0.05),
        ("raw", "mel", 5.12, 0.768),
        ("raw", "ael", 2.93, 0.879),
    ],
)
def test_tolerances(mechanism, metric, published, goal):
    assert paper.tolerance(mechanism, metric, published) == pytest.approx(goal)


def test_the_papers_own_error_is_that_of_250_conflicts():
    errors = [
        paper.monte_carlo_error(metric, value)
        for *_, metric, value in paper.PUBLISHED
        if metric == "missed_conflict_rate"
    ]
    # As PAPER-NOTES and the documentation say: 1.9 to 3.1 points.
    assert (round(min(errors), 3), round(max(errors), 3)) == (0.019, 0.031)
    draws = np.random.default_rng(0).binomial(250, 0.305, 20_000) / 250
    assert paper.monte_carlo_error("missed_conflict_rate", 0.305) == pytest.approx(
        draws.std(), rel=0.03
    )
    assert np.isnan(paper.monte_carlo_error("plr", 0.184))


@pytest.mark.parametrize(
    ("metric", "ours", "is_far"),
    # Ours has a standard error of 0.01, the missed rate of the paper one of 0.029.
    [
        ("missed_conflict_rate", 0.305 + 0.059, False),
        ("missed_conflict_rate", 0.305 - 0.062, True),
        ("plr", 0.305 + 0.019, False),
        ("plr", 0.305 + 0.021, True),
    ],
)
def test_a_difference_is_judged_by_the_errors_of_both(metric, ours, is_far):
    ends = {"ci_low": ours - 0.0196, "ci_high": ours + 0.0196}
    assert (
        paper.differs({"metric": metric, "paper": 0.305, "ours": ours} | ends) == is_far
    )


@pytest.mark.parametrize(
    ("shift", "answer"),
    [(0.0, "holds"), (0.15, "does not hold"), (-0.12, "does not hold")],
)
def test_some_eta_gives_the_rate_that_is_said_without_one(shift, answer):
    result = results()
    for level in ETAS:
        key = address_at("fid", level, PREDICTOR, "missed_conflict_rate")
        result[key] = estimate(result[key].value + shift, 0.001)
    row = claim(result, "approximately 27 %")
    assert row["answer"] == answer
    if not shift:
        assert row["effect"] == pytest.approx(-0.02)  # 25 %, at eta = 100
        assert (
            "nearest at eta = 100; 34.0 % at eta = 1, 15.0 % at eta = 1000"
            in row["evidence"]
        )
