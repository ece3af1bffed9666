"""Misses at equal false alarms: curves by hand, and plain loops over a crowd."""

import numpy as np
import pytest
from helpers.patrols import SETTINGS, make_network

from isac_track.patrols import horizon_scans, make_patrol
from isac_track.patrols.answers import disclose
from isac_track.patrols.equal_alarms import (
    DISTANCES_M,
    AlarmCurve,
    alarm_curve,
    count_alarms,
    missed_at_equal_alarms,
)
from isac_track.patrols.intervals import cluster_numbers, sum_clusters
from isac_track.patrols.metrics import robot_task, utility_metrics
from isac_track.patrols.utility import (
    NEVER,
    answer_forecasts,
    false_alarm_queries,
    foresee_from,
    true_conflicts,
)
from isac_track.policies.samples import Everything, Near, RandomPeople
from isac_track.policies.summaries import Flag, State
from isac_track.sharing import Fid
from predictors.least_squares import LeastSquares


@pytest.fixture(scope="module")
def crowd(request):
    tracks = request.getfixturevalue("tracks")
    settings = SETTINGS.changed({"patrol.segment_s": 15.0})
    patrol = make_patrol(tracks, settings=settings, seed=0)
    return make_network(patrol, Fid(1.0), settings=settings)


def make_curve(alarms, missed, trials=10.0):
    """The curve of one robot and one cluster at some alarm distances."""
    return AlarmCurve(
        alarms=np.array(alarms, dtype=float)[:, None],
        missed=np.array(missed, dtype=float)[:, None, None],
        trials=np.array([[trials]]),
    )


@pytest.mark.parametrize(
    ("allowed", "misses"),
    [
        (0.0, 8.0),  # No alarm is allowed: the last distance without one.
        (2.0, 6.0),
        (3.0, 5.0),  # Halfway between two distances.
        (9.0, 3.0),  # Never reached: the longest distance.
    ],
)
def test_the_distance_is_that_at_which_alarms_are_those_allowed(allowed, misses):
    curve = make_curve(alarms=[0, 0, 2, 4, 5], missed=[10, 8, 6, 4, 3])
    estimate = missed_at_equal_alarms(curve, reference=np.array([allowed]), seed=0)
    assert estimate.value == pytest.approx(misses / 10)


def test_the_first_distance_with_too_many_alarms_decides():
    curve = make_curve(alarms=[0, 2, 6, 1], missed=[10, 8, 4, 0])
    estimate = missed_at_equal_alarms(curve, reference=np.array([3.0]), seed=0)
    assert estimate.value == pytest.approx(0.7)


@pytest.mark.parametrize(
    "policy", [Near(3.0), RandomPeople(0.5), State(), Flag(), Everything()]
)
def test_people_nearer_than_the_radius_are_foreseen_within_the_horizon(crowd, policy):
    answers = answer_forecasts(crowd, disclose(crowd, policy), LeastSquares())
    foreseen = foresee_from(
        crowd.patrol, answers, safety_radius_m=0.9, horizons=(11, 36)
    )
    for horizon, gaps_m in foreseen.gaps_m.items():
        np.testing.assert_array_equal(gaps_m < 0.9, foreseen.conflicts <= horizon)


def test_alarms_and_misses_are_those_of_a_loop_over_distances(crowd):
    patrol, horizon = crowd.patrol, 36
    answers = answer_forecasts(crowd, disclose(crowd, Near(3.0)), LeastSquares())
    foreseen = foresee_from(patrol, answers, safety_radius_m=0.9, horizons=[horizon])
    gaps_m = foreseen.gaps_m[horizon]
    actual = true_conflicts(patrol, safety_radius_m=0.9)
    counts = count_alarms(patrol, actual=actual, gaps_m=gaps_m, horizon=horizon)
    cluster = cluster_numbers(patrol.people.group)
    curve = alarm_curve(counts, cluster=cluster)
    is_future = (actual > 0) & (actual <= horizon)
    assert curve.trials.sum() == is_future.sum() > 5
    for number, distance_m in enumerate(DISTANCES_M):
        alarm = np.where(gaps_m < distance_m, 0, NEVER)
        alarms = false_alarm_queries(patrol, actual, alarm, horizon=horizon)
        np.testing.assert_array_equal(curve.alarms[number], alarms)
        is_missed = is_future & (gaps_m >= distance_m)
        missed = sum_clusters(is_missed, cluster[patrol.presences.person])
        np.testing.assert_array_equal(curve.missed[number], missed)


def test_at_the_robots_own_alarms_it_misses_no_more(crowd):
    settings = SETTINGS
    everything = disclose(crowd, Everything())
    task = robot_task(crowd, everything, predictor=LeastSquares(), settings=settings)
    for horizon in horizon_scans(settings):
        counts = count_alarms(
            crowd.patrol,
            actual=task.actual,
            gaps_m=task.from_all.gaps_m[horizon],
            horizon=horizon,
        )
        curve = alarm_curve(counts, cluster=cluster_numbers(crowd.patrol.people.group))
        assert curve.alarms[9].tolist() == task.allowed[horizon].tolist()  # At 0.9 m.
        metrics = utility_metrics(task, everything, horizon=horizon, seed=0)
        missed = curve.missed[9].sum() / curve.trials.sum()
        assert metrics["missed_future_rate"].value == pytest.approx(missed)
        # The largest distance without further alarms is at least 0.9 m.
        assert metrics["missed_future_at_equal_false_alarms"].value <= missed
        assert (np.diff(curve.alarms, axis=0) >= 0).all()
