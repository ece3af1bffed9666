"""What is left at a price: the front against brute force, levels and values in closed form."""

import numpy as np
import pytest
from helpers.mechanisms import RULE, sweeps_of
from helpers.straight_lines import PREDICTORS, run
from hypothesis import given
from hypothesis import strategies as st

from evaluation.analysis.frontier import COLUMNS, TARGETS, WHITE, front, frontier
from evaluation.analysis.keys import Source
from evaluation.analysis.metrics import SUCCESS_OF_100

STRONGEST = {"": Source("kalman_rts", "blind"), "rerelease": Source("rerelease/shape", "blind")}
SHARE = st.integers(0, 6).map(float) | st.just(np.nan)


@given(st.lists(st.tuples(SHARE, SHARE), max_size=12))
def test_the_front_is_what_no_other_point_beats(points):
    beaten = [
        any(x <= a and y <= b and (x < a or y < b) for x, y in points) or np.isnan(a + b)
        for a, b in points
    ]
    x, y = np.array(points, dtype=float).reshape(-1, 2).T
    assert front(x, y).tolist() == [not one for one in beaten]


def table(found, strongest=STRONGEST):
    return frontier(
        sweeps_of(found), predictors=PREDICTORS, strongest=strongest, dataset="students03"
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
    for consumer, expected in (
        ("shared", np.exp(-0.5 - noise)),
        ("kalman_rts", 2 * np.exp(-0.5 - noise)),
        ("rerelease/shape", 0.7 - 0.3 * noise),
    ):
        of = rows(at, consumer=consumer)
        for mechanism in ("fid", "fixed", f"fid{RULE}", f"fixed{RULE}"):
            one = rows(of, mechanism=mechanism)
            assert one["target"].tolist() == list(TARGETS)
            assert one["value"].to_numpy() == pytest.approx(expected, rel=2e-3)
        d_sigma, eta = (rows(of, mechanism=name)["level"] for name in ("fixed", "fid"))
        assert d_sigma.to_numpy() == pytest.approx(noise, rel=1e-6)
        # Noise falls from 0.8 at eta = 1 by 0.05 a decade.
        assert np.log10(eta.to_numpy()) == pytest.approx((0.8 - noise) / 0.05, abs=1e-6)


def test_intervals_white_noise_and_who_is_beaten():
    found = run(advantage=0.1)
    found |= {
        key._replace(mechanism=WHITE): one
        for key, one in found.items()
        if key.mechanism == f"fixed{RULE}"
    }
    frame = rows(table(found), robot=PREDICTORS[0], criterion="missed", consumer="kalman_rts")
    assert list(frame.columns) == COLUMNS
    fid, white, fixed = (rows(frame, mechanism=name) for name in ("fid", WHITE, "fixed"))
    assert (fid["ci_low"] < fid["value"]).all()
    assert (fid["value"] < fid["ci_high"]).all()
    assert (fid["level_low"] < fid["level_high"]).all()
    assert np.allclose(white["vs_white"], 0.0)
    assert np.allclose(fid["vs_white"], fid["value"].to_numpy() - white["value"].to_numpy())
    assert (fid["vs_white_high"] < 0).all()
    assert fixed["dominated"].all()
    assert not fid["dominated"].any()


def test_a_target_out_of_reach_keeps_its_row_and_gallery_100_comes_first_where_it_is_known():
    found = run()
    found |= {
        key._replace(metric=SUCCESS_OF_100): one
        for key, one in found.items()
        if key.metric == "rank1"
    }
    few = {
        key: one
        for key, one in found.items()
        if key.mechanism in ("raw", "fixed") and (key.level or 0.0) < 0.3
    }
    frame = rows(table(few), robot=PREDICTORS[0], criterion="missed")
    assert set(rows(frame, consumer="rerelease/shape")["metric"]) == {SUCCESS_OF_100}
    for _, one in frame.groupby("consumer"):
        assert one["target"].tolist() == list(TARGETS)
        assert one["level"].notna().tolist() == [True, True, False, False]
        assert one["dominated"].isna().tolist() == [False, False, True, True]
        assert one["vs_white"].isna().all()
    assert table({key: one for key, one in found.items() if key.mechanism == "raw"}).empty
