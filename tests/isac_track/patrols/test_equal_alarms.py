"""Misses at equal false alarms: curves by hand, and plain loops over a crowd."""

import numpy as np
import pytest
from helpers.patrols import SETTINGS, make_network

from isac_track.patrols import horizon_scans, make_patrol
from isac_track.patrols.answers import disclose
from isac_track.patrols.equal_alarms import (
    AlarmCurve,
    alarm_curve,
    missed_at_equal_alarms,
)
from isac_track.patrols.intervals import cluster_numbers
from isac_track.patrols.metrics import robot_task, utility_metrics
from isac_track.patrols.utility import answer_forecasts, conflicts_in, least_gaps
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
    foreseen = conflicts_in(crowd.patrol, answers, safety_radius_m=0.9)
    for horizon in (11, 36):
        gaps_m = least_gaps(crowd.patrol, answers, horizon=horizon)
        np.testing.assert_array_equal(gaps_m < 0.9, foreseen <= horizon)


def test_at_the_robots_own_alarms_it_misses_no_more(crowd):
    settings = SETTINGS
    everything = disclose(crowd, Everything())
    task = robot_task(crowd, everything, predictor=LeastSquares(), settings=settings)
    person = crowd.patrol.presences.person
    for horizon in horizon_scans(settings):
        answers = answer_forecasts(crowd, everything, LeastSquares())
        curve = alarm_curve(
            crowd.patrol,
            actual=task.actual,
            gaps_m=least_gaps(crowd.patrol, answers, horizon=horizon),
            horizon=horizon,
            cluster=cluster_numbers(crowd.patrol.people.group)[person],
        )
        assert curve.alarms[9].tolist() == task.allowed[horizon].tolist()  # At 0.9 m.
        metrics = utility_metrics(task, everything, horizon=horizon, seed=0)
        missed = curve.missed[9].sum() / curve.trials.sum()
        assert metrics["missed_future_rate"].value == pytest.approx(missed)
        # The largest distance without further alarms is at least 0.9 m.
        assert metrics["missed_future_at_equal_alarms"].value <= missed
        assert (np.diff(curve.alarms, axis=0) >= 0).all()
