"""A user's plug-in beside built-in ones: differences computed by hand."""

import numpy as np
import pytest

from evaluation.estimates.families import Family
from evaluation.estimates.own_plugins import RunNumbers, plugin_records
from evaluation.estimates.strongest_table import strongest_attacks
from evaluation.plan.address import AS_SHARED, parse_consumer
from evaluation.store.linkage_outcomes import ClusterSums
from isac_track.intervals import Estimate, cluster_weights, ratio_estimates

N_PEOPLE = 60
WEIGHTS = cluster_weights(n_clusters=N_PEOPLE, n_replicates=200, seed=1)
LEVELS = [("raw", None), ("fixed", 0.7), ("fixed", 1.0)]
KNOWN = {name: Family(name, name, "linear" * (name == "fixed")) for name, _ in LEVELS}
PLR = {
    "mine": (0.6, 0.5, 0.4),
    "savgol": (0.7, 0.6, 0.5),
    "radial_rts": (0.9, 0.8, 0.7),
}
EASY = np.linspace(
    -0.1, 0.1, N_PEOPLE
)  # How much better than others a person is rebuilt.


def summed(rate):
    """Sums of one trial a person."""
    return ClusterSums(np.stack([rate + EASY, np.ones(N_PEOPLE)]), WEIGHTS)


def estimated(sums, *, is_share=True):
    over, under = sums.whole()[:, None]
    (estimate,) = ratio_estimates(
        numerator=over, denominator=under, weights=WEIGHTS, is_share=[is_share]
    )
    return estimate


def make_run(rates, *, knowledge="blind", task="", metric="plr", more=(), later=()):
    sums = {}
    for attack, by_level in rates.items():
        consumer = f"{task}/{attack}" if task else attack
        for where, rate in zip(LEVELS, by_level, strict=True):
            sums[parse_consumer(consumer, knowledge).measured(metric).at(*where)] = (
                summed(rate)
            )
    own = {key: estimated(summed_rates) for key, summed_rates in sums.items()} | dict(
        more
    )
    return RunNumbers(
        own, dict(later), sums, KNOWN, strongest_attacks(own, sums, KNOWN), task
    )


def missed(rates, *, metric="missed_future_rate"):
    return {
        parse_consumer(robot).measured(metric).at(*where): estimated(summed(rate))
        for robot, by_level in rates.items()
        for where, rate in zip(LEVELS, by_level, strict=True)
    }


def test_an_attack_is_compared_with_the_strongest_built_in_over_all_levels():
    (record,) = plugin_records({"attacks": ["mine"]}, make_run(PLR))
    assert (record["kind"], record["plugin"], record["rival"]) == (
        "attack",
        "mine",
        "radial_rts",
    )
    assert (record["levels"], record["n"]) == (3, N_PEOPLE)
    assert record["own"]["value"] == pytest.approx(0.5)
    assert record["other"]["value"] == pytest.approx(0.8)
    assert record["difference"]["value"] == pytest.approx(-0.3)


def test_the_difference_is_paired_by_person():
    # Who is easily rebuilt by either attack tells them not apart: the interval has no
    # width.
    (record,) = plugin_records({"attacks": ["mine"]}, make_run(PLR))
    own, gap = record["own"], record["difference"]
    assert own["ci_high"] - own["ci_low"] > 0.01
    assert gap["ci_high"] - gap["ci_low"] < 1e-9


def test_the_strongest_of_the_users_own_is_no_built_in():
    strong = PLR | {"mine_too": (0.95, 0.95, 0.95)}
    records = plugin_records({"attacks": ["mine", "mine_too"]}, make_run(strong))
    assert [record["rival"] for record in records] == ["radial_rts"] * 2
    assert records[1]["difference"]["value"] == pytest.approx(0.15)


def test_what_takes_positions_as_they_are_is_no_rival():
    run = make_run({"mine": PLR["mine"], "identity": (0.9, 0.9, 0.9)})
    (record,) = plugin_records({"attacks": ["mine"]}, run)
    assert record["rival"] == ""
    assert (
        record["other"]
        == record["difference"]
        == dict.fromkeys(("value", "ci_low", "ci_high"))
    )
    assert record["own"]["value"] == pytest.approx(0.5)


def test_a_linker_is_compared_in_its_leading_task():
    run = make_run(PLR, task="handover-1s", metric="rank1")
    (record,) = plugin_records({"attacks": ["mine"]}, run)
    assert (record["kind"], record["task"]) == ("linker", "handover-1s")
    assert record["difference"]["value"] == pytest.approx(-0.3)


def test_an_attack_that_only_the_oracle_can_run_is_still_compared():
    usual, oracle = (
        make_run({"radial_rts": PLR["radial_rts"]}),
        make_run({"mine": PLR["mine"]}, knowledge="oracle"),
    )
    run = RunNumbers(
        {**usual.own, **oracle.own},
        {},
        {**usual.sums, **oracle.sums},
        KNOWN,
        usual.attacks,
        "",
    )
    (record,) = plugin_records({"attacks": ["mine"]}, run)
    assert (record["knowledge"], record["rival"]) == ("oracle", "radial_rts")
    assert record["difference"]["value"] == pytest.approx(-0.3)


def test_a_predictor_is_compared_at_the_further_horizon_with_who_misses_least():
    rates = {
        "mine": (0.3, 0.4, 0.5),
        "kalman_cv": (0.2, 0.3, 0.4),
        "line": (0.5, 0.5, 0.5),
    }
    alarms = missed(dict.fromkeys(rates, (0.1, 0.1, 0.1)), metric="false_alarm_rate")
    later = {
        3.0: missed(rates) | alarms,
        5.0: missed(dict.fromkeys(rates, (0.9, 0.9, 0.9))),
    }
    own = missed(dict.fromkeys(rates, (0.8, 0.8, 0.8)))
    (record,) = plugin_records(
        {"predictors": ["mine"]}, make_run({}, more=own, later=later)
    )
    assert (record["horizon_s"], record["rival"]) == (3.0, "kalman_cv")
    assert record["difference"]["value"] == pytest.approx(0.1)
    assert record["alarms"]["value"] == pytest.approx(0.1)
    assert record["rival_alarms"]["value"] == pytest.approx(0.1)


def test_a_predictor_alone_has_no_rival():
    run = make_run({}, more=missed({"mine": (0.3, 0.4, 0.5)}))
    (record,) = plugin_records({"predictors": ["mine"]}, run)
    assert (record["horizon_s"], record["rival"]) == (None, "")
    assert record["rival_alarms"]["value"] is None


def test_a_mechanism_has_its_numbers_at_every_level():
    shared = {AS_SHARED.measured("plr").at(*where): Estimate(0.2) for where in LEVELS}
    robots = missed({"kalman_cv": (0.1, 0.2, 0.3), "line": (0.4, 0.4, 0.4)})
    run = make_run(PLR, more=shared | robots)
    records = plugin_records({"mechanisms": ["fixed"]}, run)
    assert [record["level"] for record in records] == [0.7, 1.0]
    for record, missed_share, plr in zip(records, (0.2, 0.3), (0.8, 0.7), strict=True):
        assert record["robot"] == "kalman_cv"
        assert record["missed"]["value"] == pytest.approx(missed_share)
        assert record["attacked"]["value"] == pytest.approx(plr)
        assert (record["as_sent"]["value"], record["linked"]["value"]) == (0.2, None)


def test_fewer_than_fifteen_people_have_no_interval():
    few = np.zeros(N_PEOPLE)
    few[:10] = 1.0
    run = make_run({})
    sums = {
        parse_consumer(name, "blind").measured("plr").at(*where): ClusterSums(
            np.stack([rate * few, few]), WEIGHTS
        )
        for name, rate in (("mine", 0.5), ("radial_rts", 0.7))
        for where in LEVELS
    }
    own = {key: estimated(summed_rates) for key, summed_rates in sums.items()}
    run = RunNumbers(own, {}, sums, KNOWN, (), "")
    (record,) = plugin_records({"attacks": ["mine"]}, run)
    assert record["difference"]["value"] == pytest.approx(-0.2)
    assert record["difference"]["ci_low"] is None


def test_what_the_run_has_no_number_of_is_left_out():
    assert (
        plugin_records({"attacks": ["gone"], "predictors": ["gone"]}, make_run(PLR))
        == []
    )
