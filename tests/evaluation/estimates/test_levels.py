"""Costs and privacy of a level: its rows, and linkage as a paired share of raw's."""

import numpy as np
import pytest
from helpers.addresses import address_at
from helpers.finished_runs import make_linkability
from helpers.mechanisms import make_families
from scipy.special import expit

from evaluation.estimates.best_robot import BEST, BestRobots
from evaluation.estimates.cross_fit import cross_fit
from evaluation.estimates.families import Family
from evaluation.estimates.levels import COLUMNS, levels, linkage_share
from evaluation.estimates.metrics import EQUAL_ALARMS, FUTURE_EQUAL_ALARMS
from evaluation.estimates.strongest_table import SINGLE_RELEASE, strongest_attacks
from evaluation.plan.world import World
from isac_track.intervals import (
    LEAST_CLUSTERS,
    Estimate,
    cluster_weights,
    percentile_interval,
)
from isac_track.rng import stream

LINKER = "handover-1s/kinematic"


def drawn(values, *, n=55, effective=np.nan):
    return Estimate(values[0], 0.0, 1.0, n, np.array(values[1:]), effective=effective)


def test_the_share_is_paired_with_raw_and_above_chance():
    rng = np.random.default_rng(2)
    raw = np.append(0.8, rng.normal(0.8, 0.1, 400))
    # Of what raw has above its chance of 0.04 half is left, in each replicate, above
    # 0.02.
    half = 0.02 + 0.5 * (raw - 0.04)
    share = linkage_share(drawn(half), 0.02, drawn(raw), 0.04)
    assert (share.value, share.ci_low, share.ci_high) == pytest.approx((0.5, 0.5, 0.5))
    noisy = half + np.append(0.0, rng.normal(0.0, 0.05, 400))
    share = linkage_share(drawn(noisy), 0.02, drawn(raw), 0.04)
    by_hand = (noisy[1:] - 0.02) / (raw[1:] - 0.04)
    assert (share.ci_low, share.ci_high) == pytest.approx(percentile_interval(by_hand))
    # The upper end is at most a limit where the difference from so much of raw's is
    # surely below 0.
    limit = share.ci_high
    difference = (noisy[1:] - 0.02) - limit * (raw[1:] - 0.04)
    assert np.mean(difference <= 0.0) == pytest.approx(0.975, abs=0.005)


@pytest.mark.parametrize(
    ("raw", "effective"),
    [
        ([0.03, 0.03, 0.03], np.nan),
        ([0.8, 0.8, 0.02], np.nan),
        ([0.8] * 3, LEAST_CLUSTERS - 1),
    ],
)
def test_where_raw_does_not_link_or_people_are_few_there_is_no_interval(raw, effective):
    share = linkage_share(
        drawn([0.4, 0.4, 0.4]), 0.03, drawn(raw, effective=effective), 0.03
    )
    assert np.isnan(share.ci_high)


@pytest.mark.parametrize("n_people", [20, 50])
def test_the_share_s_interval_covers_where_linkers_are_chosen(n_people):
    """Planted people, three linkers, two nearly equal; rank 1 of two walks each."""
    chance, skills = 0.025, (0.0, -0.1, -0.8)
    spread = 0.8 * stream(0, "people").standard_normal(200_000)
    raw_rate, mechanism_rate = (expit(shift + spread).mean() for shift in (1.2, -1.0))
    truth = (mechanism_rate - chance) / (raw_rate - chance)
    weights = cluster_weights(n_clusters=n_people, n_replicates=200, seed=0)
    covered, above = [], []
    for number in range(120):
        rng = stream(number, "share", n_people)
        person, is_first = (
            0.8 * rng.standard_normal(n_people),
            rng.random(n_people) < 0.5,
        )
        estimates = []
        for shift in (1.2, -1.0):
            hits = [rng.binomial(2, expit(shift + skill + person)) for skill in skills]
            sums = np.array(
                [[[hit, np.full(n_people, 2)]] for hit in hits], dtype=float
            )
            (estimate,), _ = cross_fit(
                choosing=sums,
                scored=sums,
                is_first=is_first,
                weights=weights,
                is_share=[True],
            )
            estimates.append(estimate)
        raw, linked = estimates
        share = linkage_share(linked, chance, raw, chance)
        covered.append(share.ci_low <= truth <= share.ci_high)
        above.append(truth > share.ci_high)
    assert np.mean(covered) > 0.92
    # A limit is met if the upper end is: that end counts.
    assert np.mean(above) < 0.06


def run():
    """Estimates of three mechanisms, and what is linked."""
    estimates, horizon = {}, {}
    for name, level, plr in (
        ("raw", None, 0.9),
        ("ou", 0.4, 0.3),
        ("offset", 0.3, 0.4),
    ):
        for consumer, knowledge, factor in (
            ("shared", "", 0.5),
            ("radial_rts", "blind", 0.8),
            ("ou_rts", "informed", 1.0),
            ("ou_rts", "oracle", 1.05),
            ("ou_rts", "anchor", 1.1),
        ):
            for metric, value in (
                ("plr", plr),
                ("plr_wide", 1.01 * plr),
                ("median_error", 0.2),
            ):
                # Beyond epsilon another attack is the stronger.
                lift = 1.5 if (metric, consumer) == ("plr_wide", "radial_rts") else 1.0
                key = address_at(name, level, consumer, metric, knowledge)
                estimates[key] = Estimate(lift * factor * value, 0.0, 1.0, 55)
        for metric, value in (("rank1", plr), ("chance", 0.02)):
            estimates[address_at(name, level, LINKER, metric, "informed")] = drawn(
                [value] * 5
            )
        estimates[address_at(name, level, "kalman_cv", EQUAL_ALARMS)] = Estimate(
            0.1, 0.0, 0.2, 55
        )
        horizon[address_at(name, level, "kalman_cv", FUTURE_EQUAL_ALARMS)] = Estimate(
            0.2, 0.1, 0.3, 55
        )
    known = make_families(estimates) | {
        "offset": Family("offset", "offset", "", protects=False)
    }
    at = [("clean", np.nan), ("raw", np.nan), ("ou", 0.4), ("offset", 0.3)]
    linked = make_linkability(
        at, tasks={"handover-1s": {"kinematic": 0.4}}, dataset="walks"
    )
    linked.loc[linked["mechanism"] == "ou", "invalid"] = "noise_level"
    best = BestRobots(
        {
            address_at(
                "ou", 0.4, BEST[FUTURE_EQUAL_ALARMS], FUTURE_EQUAL_ALARMS
            ): Estimate(0.21, 0.1, 0.3)
        },
        {BEST[FUTURE_EQUAL_ALARMS]: ("kalman_cv", "least_squares")},
    )
    attacks = strongest_attacks(estimates, {}, known)
    about = {
        "attacks": attacks,
        "horizons": {World(horizon_s=3.0): horizon},
        "linked": linked,
        "best": {World(horizon_s=3.0): best},
        "families": known,
    }
    return levels(estimates, **about, dataset="walks")


def test_raw_and_what_claims_to_protect_are_there():
    table = run()
    assert list(table.columns) == COLUMNS
    assert dict(zip(table["mechanism"], table["protects"], strict=True)).keys() == {
        "raw",
        "ou",
    }
    assert not table.duplicated(
        ["dataset", "mechanism", "level", "adversary", *COLUMNS[7:10]]
    ).any()


def test_each_group_of_adversaries_has_its_strongest_by_what_is_told():
    table = run().query("mechanism == 'ou'").set_index(["adversary", "metric"])
    plr, wide = (table.loc[(SINGLE_RELEASE, metric)] for metric in ("plr", "plr_wide"))
    assert (plr["consumer"], plr["knowledge"], plr["value"]) == (
        "ou_rts",
        "informed",
        0.3,
    )
    assert (wide["consumer"], wide["value"]) == (
        "radial_rts",
        pytest.approx(0.3 * 1.01 * 1.2),
    )
    assert table.loc[("anchor", "plr")]["value"] == pytest.approx(0.33)
    assert "oracle" not in set(table["knowledge"])


def test_linkage_is_told_with_what_may_spoil_it_and_horizons_by_their_name():
    table = run().query("mechanism == 'ou'").set_index("metric")
    share = table.loc["linkage_share"]
    assert share["value"] == pytest.approx((0.3 - 0.02) / (0.9 - 0.02))
    assert (share["consumer"], share["invalid"]) == (LINKER, "noise_level")
    own, best = table.loc[FUTURE_EQUAL_ALARMS].to_dict("records")
    assert (own["dataset"], own["consumer"]) == ("walks:horizon=3s", "kalman_cv")
    assert (best["dataset"], best["consumer"]) == (
        "walks:horizon=3s",
        "best(missed_future)",
    )
    assert (best["value"], best["first_choice"]) == (0.21, "kalman_cv")
    assert (best["second_choice"], own["first_choice"]) == ("least_squares", "")
    assert table.loc[EQUAL_ALARMS]["dataset"] == "walks"
