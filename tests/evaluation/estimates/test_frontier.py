"""Privacy at a price: values in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.mechanisms import RULE, make_sweeps
from helpers.straight_lines import PREDICTORS, run

from evaluation.estimates.frontier import COLUMNS, TARGETS, WHITE_NOISE, frontier
from evaluation.estimates.metrics import MISSED_RATE, RANK1_AMONG_100
from evaluation.estimates.strongest import first_half
from evaluation.plan.address import parse_consumer
from evaluation.store.linkage_outcomes import ClusterSums
from isac_track.intervals import Estimate, cluster_weights


def table(estimates, **sums):
    return frontier(
        make_sweeps(estimates), predictors=PREDICTORS, dataset="students03", **sums
    )


def rows(frame, **where):
    for name, value in where.items():
        frame = frame[frame[name] == value]
    return frame


@pytest.mark.parametrize("robot", PREDICTORS)
@pytest.mark.parametrize(
    ("criterion", "slope"), [("missed", 0.2), ("missed_at_equal_false_alarms", 0.3)]
)
def test_straight_lines_are_read_where_the_rate_has_risen(robot, criterion, slope):
    at = rows(table(run()), robot=robot, criterion=criterion)
    noise = np.array(TARGETS) / slope
    for consumer, metric, expected in (
        ("shared", "plr", np.exp(-0.5 - noise)),
        ("kalman_rts", "plr", 2 * np.exp(-0.5 - noise)),
        ("kalman_rts", "mel", 10 * np.exp(-0.5 - noise)),
        ("rerelease/shape", "rank1", 0.7 - 0.3 * noise),
    ):
        consumer_rows = rows(at, consumer=consumer)
        for mechanism in ("fid", "fixed", f"fid{RULE}", f"fixed{RULE}"):
            mechanism_rows = rows(consumer_rows, mechanism=mechanism, metric=metric)
            assert mechanism_rows["target"].tolist() == list(TARGETS)
            assert mechanism_rows["value"].to_numpy() == pytest.approx(
                expected, rel=2e-3
            )
        sigma, eta = (
            rows(consumer_rows, mechanism=name, metric=metric)["level"]
            for name in ("fixed", "fid")
        )
        assert sigma.to_numpy() == pytest.approx(noise, rel=1e-6)
        # Noise falls from 0.8 at eta = 1 by 0.05 a decade.
        assert np.log10(eta.to_numpy()) == pytest.approx((0.8 - noise) / 0.05, abs=1e-6)


def test_intervals_white_noise_and_who_is_beaten():
    estimates = run(advantage=0.1)
    estimates |= {
        key.at(WHITE_NOISE, key.level): estimate
        for key, estimate in estimates.items()
        if key.mechanism == f"fixed{RULE}"
    }
    frame = rows(
        table(estimates),
        robot=PREDICTORS[0],
        criterion="missed",
        consumer="kalman_rts",
        metric="plr",
    )
    assert list(frame.columns) == COLUMNS
    fid, white, fixed = (
        rows(frame, mechanism=name) for name in ("fid", WHITE_NOISE, "fixed")
    )
    assert (fid["ci_low"] < fid["value"]).all()
    assert (fid["value"] < fid["ci_high"]).all()
    assert (fid["level_low"] < fid["level_high"]).all()
    assert np.allclose(white["vs_white"], 0.0)
    assert np.allclose(
        fid["vs_white"], fid["value"].to_numpy() - white["value"].to_numpy()
    )
    assert (fid["vs_white_high"] < 0).all()
    assert fixed["dominated"].all()
    assert not fid["dominated"].any()


def test_raw_is_one_for_all_and_between_few_levels_there_is_no_interval():
    sparse = {
        key: estimate
        for key, estimate in run(advantage=0.1).items()
        if key.mechanism != f"fixed{RULE}" or key.level > 0.2
    }
    # A level that misses less than raw is noise, of raw as of the level: raw moves for
    # all.
    low = next(
        key for key in sparse if key.metric == MISSED_RATE and key.mechanism == "fixed"
    )
    sparse[low] = replace(sparse[low], value=0.04)
    frame = rows(
        table(sparse), robot=PREDICTORS[0], criterion="missed", consumer="kalman_rts"
    )
    frame = rows(frame, metric="plr")
    few, many = (rows(frame, mechanism=name) for name in (f"fixed{RULE}", "fid"))
    ends = ["ci_low", "ci_high", "level_low", "level_high"]
    has = few["target"] > 0.09
    assert few["value"].notna().all()
    assert few[ends].notna().all(axis=1).tolist() == has.tolist()
    assert few["dominated"].notna().tolist() == has.tolist()
    assert many[ends[:2]].notna().all(axis=None)
    # (0.1 + 0.04) / 2 instead of 0.1: the same rise is reached with less noise.
    eta = np.log10(many["level"].to_numpy()[1:])
    assert eta == pytest.approx(
        (0.8 - (np.array(TARGETS[1:]) - 0.03) / 0.2) / 0.05, abs=0.05
    )


ENDS = ["level_low", "level_high", "ci_low", "ci_high"]


def first_price(estimates):
    frame = rows(table(estimates), robot=PREDICTORS[0], criterion="missed")
    return rows(frame, consumer="kalman_rts", metric="plr")


def test_few_people_have_no_interval_and_no_comparison():
    few = {key: replace(item, n=10) for key, item in run(advantage=0.1).items()}
    frame = first_price(few)
    assert frame["value"].notna().all()
    assert frame[ENDS].isna().all(axis=None)
    assert frame["dominated"].isna().all()


def test_what_too_few_replicates_reach_is_not_compared():
    """Fixed noise ends at the second target: about half of its replicates fall short."""
    short = {
        key: item
        for key, item in run(advantage=0.1).items()
        if key.mechanism != "fixed" or key.level < 0.3
    }
    frame = first_price(short)
    ended, other = (rows(frame, mechanism=name) for name in ("fixed", f"fixed{RULE}"))
    assert ended["value"].notna().tolist() == [True, True, False, False]
    assert ended["ci_low"].notna().tolist() == [True, False, False, False]
    assert ended["dominated"].notna().tolist() == [True, False, False, False]
    assert other["dominated"].all()


def test_the_strongest_on_each_mechanism_is_cross_fitted():
    """Two attacks, each better against one mechanism; the choice is scored by hand."""
    n, first, second = (
        60,
        parse_consumer("kalman_rts", "blind"),
        parse_consumer("ou_rts", "informed"),
    )
    weights = cluster_weights(n_clusters=n, n_replicates=200, seed=0)
    rng, estimates, sums = np.random.default_rng(0), run(), {}
    people = rng.random((2, n))
    for key in [key for key in estimates if key.consumer == "kalman_rts"]:
        # The second is the better one against FID, and about as good, by chance,
        # against fixed.
        gain, left = 0.2 * (key.mechanism == "fid"), estimates[key].value
        for reader, own in ((first, people[0]), (second, people[1] + gain)):
            at = reader.measured(key.metric).at(*key.mechanism_level)
            over = np.stack([(0.5 + own) * left, np.ones(n)])
            sums[at] = ClusterSums(over, weights)
            value, drawn = over[0].mean(), weights @ over[0] / n
            estimates[at] = Estimate(value, value, value, n, drawn)
    frame = rows(table(estimates, sums=sums), robot=PREDICTORS[0], metric="plr")
    at = rows(frame, criterion="missed", target=0.05).set_index("mechanism")
    assert at.loc["fid"]["consumer"].tolist() == ["shared", "ou_rts"]
    is_first = first_half(tuple(map(str, range(n))))
    shares = [people[0], people[1]]
    choice = [
        int(shares[1][half].mean() > shares[0][half].mean())
        for half in (is_first, ~is_first)
    ]
    scored = np.where(is_first, shares[choice[1]], shares[choice[0]]).mean()
    shared = at.loc["fixed"]["value"].iloc[0]
    assert at.loc["fixed"]["value"].iloc[1] == pytest.approx(
        2 * shared * (0.5 + scored)
    )


def test_a_target_out_of_reach_keeps_its_row_and_gallery_100_comes_first_if_known():
    estimates = run()
    estimates |= {
        key.measured(RANK1_AMONG_100): item
        for key, item in estimates.items()
        if key.metric == "rank1"
    }
    few = {
        key: item
        for key, item in estimates.items()
        if key.mechanism in ("raw", "fixed") and (key.level or 0.0) < 0.3
    }
    frame = rows(table(few), robot=PREDICTORS[0], criterion="missed")
    assert set(rows(frame, consumer="rerelease/shape")["metric"]) == {RANK1_AMONG_100}
    for _, item in frame.groupby(["consumer", "metric"]):
        assert item["target"].tolist() == list(TARGETS)
        assert item["level"].notna().tolist() == [True, True, False, False]
        # Few replicates reach the second target: no interval, and no comparison.
        assert item["ci_low"].isna().tolist() == [False, True, True, True]
        assert item["dominated"].isna().tolist() == [False, True, True, True]
        assert item["vs_white"].isna().all()
    assert table(
        {key: item for key, item in estimates.items() if key.mechanism == "raw"}
    ).empty
