"""Matching, the paper table and the claims, on curves whose answer is known."""

import json
from pathlib import Path

import numpy as np
import pytest

from evaluation.analysis import matching, paper
from evaluation.analysis.keys import Key
from isac_track.intervals import Estimate

N = 200
SHARED, PREDICTOR = "shared", "least_squares"
ETAS = (1.0, 10.0, 100.0, 1000.0)
ERRORS = (0.1, 0.2, 0.5, 1.0)


def matched(found, *, dataset, predictors):
    """Return the matched points at equal missed rate, descriptors as shared."""
    table = matching.matched(
        tuple(matching.comparisons(found, predictors=predictors)), dataset=dataset
    )
    return table[(table["criterion"] == matching.MISSED) & (table["consumer"] == "shared")]


def estimate(value, spread=0.0, n=50):
    noise = np.linspace(-1.96, 1.96, N) * spread
    return Estimate(value, value - 1.96 * spread, value + 1.96 * spread, n, value + noise)


def results(*, advantage=0.0, spread=0.001, suffix="", rate_of_error=None):
    """FID and fixed noise on one exponential trade-off; FID's lies `advantage` (log) lower."""
    found = {}

    def add(mechanism, level, rate, lower):
        found[Key(mechanism, level, PREDICTOR, "missed_conflict_rate")] = estimate(rate, spread)
        for metric, scale in (("plr", 1.0), ("ael", 2.0), ("mel", 3.0)):
            value = scale * np.exp(-4.0 * rate - lower)
            found[Key(mechanism, level, SHARED, metric)] = estimate(value, spread)

    add("raw", None, 0.10, 0.0)
    for level, rate in zip(ETAS, (0.34, 0.30, 0.25, 0.15), strict=True):
        add(f"fid{suffix}", level, rate, advantage)
    for level, rate in zip(ERRORS, rate_of_error or (0.11, 0.12, 0.20, 0.40), strict=True):
        add(f"fixed{suffix}", level, rate, 0.0)
    return found


def claim(found, text, adding="linear", **history):
    at = matched(found, dataset="students03", predictors=[PREDICTOR])
    history = {"history_points": 366.0, "history_interval_s": 0.0834} | history
    table = paper.claims(found, at, dataset="students03", **history)
    rows = table[(table["adding"] == adding) & table["claim"].str.contains(text)]
    return rows.iloc[0]


def test_matched_points_lie_between_the_ends_of_both_curves():
    table = matched(results(), dataset="d", predictors=[PREDICTOR])
    rates = table["missed_conflict_rate"]
    assert rates.max() == pytest.approx(0.34)  # FID's noisiest level; fixed goes to 0.40
    assert rates.min() > 0.10  # raw is the common end and is not compared
    assert set(table["metric"]) == {"plr", "ael", "mel"}
    assert set(table["adding"]) == {"linear"}


def test_equal_curves_differ_by_nothing_and_a_lower_one_by_its_advantage():
    equal = matched(results(), dataset="d", predictors=[PREDICTOR])
    assert np.allclose(equal["difference"], 0.0, atol=1e-9)
    lower = matched(results(advantage=0.05), dataset="d", predictors=[PREDICTOR])
    inside = lower[lower["missed_conflict_rate"] > 0.15]  # beyond eta = 1000 it bends to raw
    assert np.allclose(inside["fid"] / inside["fixed"], np.exp(-0.05))
    plr = inside[inside["metric"] == "plr"]
    assert np.allclose(plr["fixed"], np.exp(-4.0 * plr["missed_conflict_rate"]))
    assert np.allclose(plr["at"], plr["missed_conflict_rate"] - 0.10)


def test_each_replicate_is_read_at_its_own_raw_rate():
    """Rates that move together from replicate to replicate leave the difference as it is."""
    found = results(advantage=0.05, spread=0.0)
    shift = np.linspace(-0.03, 0.03, N)
    moved = {
        key: Estimate(one.value, one.ci_low, one.ci_high, one.n, one.replicates + shift)
        if key.metric == "missed_conflict_rate"
        else one
        for key, one in found.items()
    }
    still = matched(found, dataset="d", predictors=[PREDICTOR])
    table = matched(moved, dataset="d", predictors=[PREDICTOR])
    assert np.allclose(table["difference"], still["difference"])
    assert np.allclose(table["ci_low"], table["difference"], atol=1e-9)
    assert np.allclose(table["ci_high"], table["difference"], atol=1e-9)


def test_a_rate_that_many_replicates_do_not_reach_has_no_interval():
    found = results(advantage=0.05, spread=0.0)
    key = Key("fid", 1.0, PREDICTOR, "missed_conflict_rate")
    short = np.where(np.arange(N) % 2 == 0, 0.34, 0.31)  # half of them end early
    found[key] = Estimate(0.34, 0.31, 0.34, 50, short)
    table = matched(found, dataset="d", predictors=[PREDICTOR])
    out_of_reach = table["missed_conflict_rate"] > 0.311
    assert out_of_reach.any()
    assert (table["defined"] < 0.975).tolist() == out_of_reach.tolist()
    assert table.loc[out_of_reach, ["ci_low", "ci_high", "fid_low"]].isna().all(axis=None)
    assert table.loc[~out_of_reach, ["ci_low", "ci_high"]].notna().all(axis=None)


def test_with_few_people_nothing_is_decided():
    few = {
        key: Estimate(one.value, one.ci_low, one.ci_high, 8, one.replicates)
        for key, one in results(advantage=0.05).items()
    }
    at = matched(few, dataset="plaza", predictors=[PREDICTOR])
    table = paper.claims(few, at, dataset="plaza", history_points=366.0, history_interval_s=0.083)
    assert len(table) > 5
    assert set(table["answer"]) == {"undecided"}


def test_without_two_levels_or_raw_nothing_is_matched():
    found = results()
    no_raw = {key: value for key, value in found.items() if key.mechanism != "raw"}
    assert matched(no_raw, dataset="d", predictors=[PREDICTOR]).empty
    no_fid = {key: value for key, value in found.items() if key.mechanism != "fid"}
    assert matched(no_fid, dataset="d", predictors=[PREDICTOR]).empty
    assert matched(found, dataset="d", predictors=["another"]).empty


@pytest.mark.parametrize(
    ("advantage", "answer"), [(0.05, "holds"), (-0.05, "does not hold"), (0.0, "undecided")]
)
def test_better_at_every_rate(advantage, answer):
    assert claim(results(advantage=advantage), "lower PLR")["answer"] == answer


@pytest.mark.parametrize(
    ("rates", "spread", "answer"),
    [
        ((0.11, 0.12, 0.2, 0.4), 0.001, "holds"),
        ((0.11, 0.19, 0.2, 0.4), 0.001, "does not hold"),
    ],
)
def test_close_to_raw(rates, spread, answer):
    row = claim(results(rate_of_error=rates, spread=spread), "0.2 m: missed")
    assert row["answer"] == answer
    assert row["effect"] == pytest.approx(rates[1] - 0.10)


def test_monotone_holds_fails_and_stays_undecided():
    found = results()
    assert claim(found, "rate falls")["answer"] == "holds"
    assert claim(found, "MEL rises")["answer"] == "holds"
    bump = dict(found)
    bump[Key("fid", 100.0, SHARED, "plr")] = estimate(0.1, 0.001)  # below its neighbours
    row = claim(bump, "PLR rises")
    assert row["answer"] == "does not hold"
    assert "1 beyond their interval" in row["evidence"]
    flat = dict(found)
    for level in ETAS:
        values = np.random.default_rng(int(level)).normal(0.3, 0.05, N)
        flat[Key("fid", level, SHARED, "plr")] = Estimate(0.3, 0.2, 0.4, 50, values)
    assert claim(flat, "PLR rises")["answer"] == "undecided"


def test_the_history_claim():
    found = results()
    assert claim(found, "history", adding="")["answer"] == "holds"
    assert claim(found, "history", adding="", history_points=361.0)["answer"] == "does not hold"
    assert claim(found, "history", adding="", history_interval_s=0.0866)["answer"] == (
        "does not hold"
    )


def test_the_history_is_judged_on_the_papers_recording_only():
    at = matched(results(), dataset="plaza", predictors=[PREDICTOR])
    table = paper.claims(
        results(), at, dataset="plaza", history_points=350.0, history_interval_s=0.0834
    )
    assert not table["claim"].str.contains("history").any()
    assert len(table) > 5


def test_both_adding_rules_are_judged():
    both = results() | results(suffix=":adding=independent", advantage=-0.05)
    assert claim(both, "lower PLR", adding="independent")["answer"] == "does not hold"
    assert claim(both, "lower PLR", adding="linear")["answer"] == "undecided"


def test_the_paper_table_says_within_only_for_the_papers_recording():
    found = results()
    ours = paper.paper_table(found, dataset="students03")
    raw = ours[(ours["mechanism"] == "raw") & (ours["metric"] == "missed_conflict_rate")].iloc[0]
    assert raw["paper"] == 0.105
    assert raw["ours"] == 0.10
    assert raw["within"] is False or not raw["within"]
    wide = dict(found)
    wide[Key("raw", None, PREDICTOR, "missed_conflict_rate")] = estimate(0.10, 0.01)
    table = paper.paper_table(wide, dataset="students03")
    assert bool(table.iloc[0]["within"])
    assert paper.paper_table(found, dataset="plaza")["within"].isna().all()


def test_published_numbers_are_those_of_the_reference():
    """Against the hand-copied reference table beside the tests."""
    path = Path(__file__).parent.parent / "reference" / "paper.json"
    reference = json.loads(path.read_text(encoding="utf-8"))
    expected = {
        (row["mechanism"], row["level"], metric): value
        for row in reference["rows"]
        for metric, value in row.items()
        if metric not in ("mechanism", "level")
    }
    found = {
        (mechanism, level, metric): value for mechanism, level, metric, value in paper.PUBLISHED
    }
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        assert found[key] == pytest.approx(value)


def test_tolerances():
    assert paper.tolerance("raw", "missed_conflict_rate", 0.105) == 0.04
    assert paper.tolerance("fid", "plr", 0.2) == 0.015
    assert paper.tolerance("fid", "mel", 0.3) == 0.05
    assert paper.tolerance("raw", "mel", 5.12) == pytest.approx(0.768)
    assert paper.tolerance("raw", "ael", 2.93) == pytest.approx(0.879)


def test_what_attacks_get_changes_no_match_and_no_claim():
    found = results()
    attacked = dict(found)
    for key in list(found):
        if key.consumer == SHARED:
            for name in (SHARED, PREDICTOR, "kalman_rts"):
                other = Key(key.mechanism, key.level, name, key.metric, "blind")
                attacked[other] = estimate(0.5, n=3)
        elif key.level is not None:
            other = Key(key.mechanism, key.level + 0.5, PREDICTOR, key.metric, "oracle")
            attacked[other] = estimate(0.5, n=0)
    attacked[Key("fid", 5.0, SHARED, "plr", "blind")] = estimate(0.5)
    at, expected = (
        matched(one, dataset="students03", predictors=[PREDICTOR]) for one in (attacked, found)
    )
    assert at.equals(expected)
    history = {"history_points": 366.0, "history_interval_s": 0.0834}
    assert paper.claims(attacked, at, dataset="students03", **history).equals(
        paper.claims(found, at, dataset="students03", **history)
    )
    assert paper.paper_table(attacked, dataset="students03").equals(
        paper.paper_table(found, dataset="students03")
    )


def test_a_match_says_whose_positions_its_descriptors_are_of():
    table = matched(results(), dataset="d", predictors=[PREDICTOR])
    assert list(table.columns[3:6]) == ["predictor", "consumer", "knowledge"]
    assert set(table["consumer"]) == {SHARED}
    assert set(table["knowledge"]) == {""}
