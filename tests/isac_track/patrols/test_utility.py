"""Forecasts of robots on patrol: crossings by hand, and plain loops over a crowd."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.patrols import (
    ROUND,
    SETTINGS,
    clean_network,
    make_network,
    patrol_past,
    sent_answers,
    straight_walks,
)

from isac_track.patrols import horizon_scans, make_patrol, scans_per_query
from isac_track.patrols.answers import disclose
from isac_track.patrols.metrics import is_by_construction, robot_task, utility_metrics
from isac_track.patrols.utility import (
    NEVER,
    false_alarms,
    first_entries,
    foreseen_conflicts,
    missed_conflicts,
    missed_encounters,
    missed_futures,
    true_conflicts,
    withheld_conflicts,
)
from isac_track.policies.samples import Ahead, Everything, Near, RandomPeople, Window
from isac_track.policies.summaries import Flag, State
from isac_track.sharing import Fid
from isac_track.types import Release
from predictors.kalman import KalmanCV
from predictors.least_squares import LeastSquares

RADIUS_M = 0.9
CROSSING = straight_walks((0, 20, (-10.05, 0), (1, 0)))
"""A person passes the robot at (0, 0): inside from the scan at 9.2 s to 10.9 s."""
LEAVING = straight_walks((0, 9.0, (-10.05, 0), (1, 0)))
"""A person leaves 0.2 s before coming inside."""


def foreseen(network, policy, predictor=None):
    disclosure = disclose(network, policy)
    return foreseen_conflicts(
        network,
        disclosure,
        predictor=predictor or LeastSquares(),
        safety_radius_m=RADIUS_M,
    )


class TestOneCrossing:
    def test_is_labelled_by_the_scans_until_the_person_is_inside(self):
        patrol = patrol_past(CROSSING, (0, 0))
        actual = true_conflicts(patrol, safety_radius_m=RADIUS_M)[:, 0]
        # At 5 s it is 42 scans ahead, beyond the reach of 40.
        expected = {6: 32, 7: 22, 8: 12, 9: 2, 10: 0}
        assert actual.tolist() == [expected.get(query, NEVER) for query in range(21)]
        assert first_entries(patrol, safety_radius_m=RADIUS_M).tolist() == [[92]]

    def test_is_foreseen_exactly_if_the_truth_is_shared(self):
        network = clean_network(patrol_past(CROSSING, (0, 0)))
        actual = true_conflicts(network.patrol, safety_radius_m=RADIUS_M)
        np.testing.assert_array_equal(foreseen(network, Everything()), actual)

    def test_does_not_count_after_leaving_in_truth_or_forecast(self):
        network = clean_network(patrol_past(LEAVING, (0, 0)))
        assert (true_conflicts(network.patrol, safety_radius_m=RADIUS_M) == NEVER).all()
        assert (foreseen(network, Everything()) == NEVER).all()
        assert (first_entries(network.patrol, safety_radius_m=RADIUS_M) == NEVER).all()

    def test_counts_are_those_in_closed_form(self):
        network = clean_network(patrol_past(CROSSING, (0, 0)))
        actual = true_conflicts(network.patrol, safety_radius_m=RADIUS_M)
        nobody = np.full_like(actual, NEVER)
        for horizon, n_conflicts in ((9, 2), (30, 4)):
            assert (
                missed_conflicts(actual, nobody, horizon=horizon).trials.sum()
                == n_conflicts
            )
            futures = missed_futures(actual, nobody, horizon=horizon)
            assert futures.trials.sum() == n_conflicts - 1
            assert futures.rate == 1.0
            assert missed_futures(actual, actual, horizon=horizon).rate == 0.0

    def test_near_withholds_people_that_are_still_far_away(self):
        network = clean_network(patrol_past(CROSSING, (0, 0)))
        actual = true_conflicts(network.patrol, safety_radius_m=RADIUS_M)
        # The person is within 2 m at 9, 10, 11 and 12 s; conflicts within 3 s begin at
        # 7 s.
        near = foreseen(network, Near(2.0))
        withheld = withheld_conflicts(actual, near, actual, horizon=30)
        assert (
            int(withheld.hits[withheld.trials].sum()),
            int(withheld.trials.sum()),
        ) == (2, 3)

    @pytest.mark.parametrize(
        ("radius_m", "lead", "missed"),
        [(3.0, 9, False), (2.0, 9, True), (6.0, 30, False), (4.0, 30, True)],
    )
    def test_a_warning_comes_with_the_last_query_before_the_lead(
        self, radius_m, lead, missed
    ):
        # Entry at 9.2 s: the last query 0.9 s before is that of 8 s, 3 s before that of
        # 6 s. The person is then 2.05 m and 4.05 m away.
        network = clean_network(patrol_past(CROSSING, (0, 0)))
        entries = first_entries(network.patrol, safety_radius_m=RADIUS_M)
        counts = missed_encounters(
            network.patrol,
            entries,
            foreseen(network, Near(radius_m)),
            lead=lead,
            scans_per_query=scans_per_query(ROUND.patrol),
        )
        assert counts.trials.tolist() == [[True]]
        assert counts.hits.tolist() == [[missed]]

    def test_a_person_without_history_before_the_lead_is_no_encounter(self):
        # Inside after 0.95 s: no query had two samples of the person before the lead.
        tracks = straight_walks((0, 5, (-1.95, 0), (1, 0)))
        network = clean_network(patrol_past(tracks, (0, 0)))
        entries = first_entries(network.patrol, safety_radius_m=RADIUS_M)
        assert entries.tolist() == [[11]]
        counts = missed_encounters(
            network.patrol,
            entries,
            foreseen(network, Everything()),
            lead=9,
            scans_per_query=10,
        )
        assert not counts.trials.any()
        assert np.isnan(counts.rate)

    def test_a_robot_that_meets_nobody_has_no_rate_and_says_so(self):
        network = clean_network(patrol_past(CROSSING, (0, 50)))
        everything = disclose(network, Everything())
        task = robot_task(network, everything, predictor=LeastSquares(), settings=ROUND)
        metrics = utility_metrics(task, everything, horizon=30, seed=0)
        for name, estimate in metrics.items():
            if name == "false_alarms_per_min":
                assert estimate.value == 0.0
            else:
                assert np.isnan(estimate.value)
                assert estimate.n == 0


class TestFalseAlarms:
    def test_are_runs_of_queries_without_any_conflict(self):
        patrol = patrol_past(CROSSING, (0, 0), (0, 0))
        actual = np.full((21, 2), NEVER)
        alarm = np.full((21, 2), NEVER)
        alarm[[1, 2, 5, 6, 7, 20], 0] = 3
        actual[6, 0] = 3  # justifies the run from 5 to 7
        alarm[[0, 4], 1] = 3
        assert false_alarms(patrol, actual, alarm, horizon=9).tolist() == [2, 2]
        assert false_alarms(patrol, actual, alarm, horizon=2).tolist() == [0, 0]

    def test_of_one_person_may_be_justified_by_another(self):
        tracks = straight_walks((0, 3, (0, 0), (1, 0)), (0, 3, (0, 1), (1, 0)))
        patrol = patrol_past(tracks, (0, 0))
        actual, alarm = np.full((8, 1), NEVER), np.full((8, 1), NEVER)
        actual[patrol.presences.person == 0] = 0
        alarm[patrol.presences.person == 1] = 0
        assert false_alarms(patrol, actual, alarm, horizon=9).tolist() == [0]

    def test_come_by_the_minute(self):
        network = clean_network(patrol_past(LEAVING, (-1, 0.0), (0, 50)))
        everything = disclose(network, Everything())
        task = robot_task(network, everything, predictor=LeastSquares(), settings=ROUND)
        alarm = replace(task, actual=np.full_like(task.actual, NEVER))
        metrics = utility_metrics(alarm, everything, horizon=30, seed=0)
        # One alarm of one of two robots in ten queries.
        assert metrics["false_alarms_per_min"].value == pytest.approx(60.0 / 10.0 / 2.0)


@pytest.fixture(scope="module")
def crowd(request):
    """A small crowd with three robots, and the network that senses it."""
    tracks = request.getfixturevalue("tracks")
    settings = SETTINGS.changed({"patrol.segment_s": 12.0})
    return make_network(
        make_patrol(tracks, settings=settings, seed=0), settings=settings
    )


def slow_wait(patrol, robot, presence, places):
    """Scans until a person at these places is inside, before leaving: a plain loop."""
    pairs = patrol.presences
    sample, now = pairs.sample[presence], patrol.query_scan[pairs.query[presence]]
    end = patrol.people.offsets[pairs.person[presence] + 1]
    for step in range(min(patrol.ahead_s.size, end - sample)):
        gap = places[step] - patrol.robot_xy[robot, now + step]
        if np.hypot(*gap) < RADIUS_M:
            return step
    return NEVER


class TestAgainstPlainLoops:
    def test_true_conflicts_and_entries(self, crowd):
        patrol = crowd.patrol
        actual = true_conflicts(patrol, safety_radius_m=RADIUS_M)
        for presence in range(len(patrol.presences)):
            places = patrol.people.xy[patrol.presences.sample[presence] :]
            for robot in range(patrol.n_robots):
                assert actual[presence, robot] == slow_wait(
                    patrol, robot, presence, places
                )
        entries = first_entries(patrol, safety_radius_m=RADIUS_M)
        for person, (first, end) in enumerate(
            zip(patrol.people.offsets[:-1], patrol.people.offsets[1:], strict=True)
        ):
            for robot in range(patrol.n_robots):
                inside = [
                    patrol.scan[k]
                    for k in range(first, end)
                    if np.hypot(
                        *(patrol.people.xy[k] - patrol.robot_xy[robot, patrol.scan[k]])
                    )
                    < RADIUS_M
                ]
                assert entries[person, robot] == min(inside, default=NEVER)

    @pytest.mark.parametrize(
        "policy", [Everything(), Window(1.3), Near(3.0), Ahead(1.5), RandomPeople(0.4)]
    )
    @pytest.mark.parametrize("predictor", [LeastSquares(), KalmanCV()])
    def test_forecasts_from_the_samples_that_were_sent(self, crowd, policy, predictor):
        patrol, release = crowd.patrol, crowd.release
        expected = np.full((len(patrol.presences), patrol.n_robots), NEVER)
        for (robot, presence), samples in sent_answers(crowd, policy).items():
            walk = Release(
                release.t[samples],
                release.xy[samples],
                None,
                np.array([0, len(samples)]),
                ("x",),
            )
            now_s = patrol.people.t[patrol.presences.sample[presence]]
            mean = predictor.predict(walk, now_s + patrol.ahead_s[None]).mean[0]
            expected[presence, robot] = slow_wait(patrol, robot, presence, mean)
        np.testing.assert_array_equal(foreseen(crowd, policy, predictor), expected)
        assert (expected < NEVER).any()

    def test_samples_with_gaps_are_one_track(self, crowd):
        class EveryOther:
            form = "samples"

            def select(self, query):
                return np.arange(query.t.size) % 2 == 0

        patrol, release = crowd.patrol, crowd.release
        sent = sent_answers(crowd, EveryOther())
        waits = foreseen(crowd, EveryOther())
        assert (waits < NEVER).any()
        for (robot, presence), samples in sent.items():
            walk = Release(
                release.t[samples],
                release.xy[samples],
                None,
                np.array([0, len(samples)]),
                ("x",),
            )
            now_s = patrol.people.t[patrol.presences.sample[presence]]
            mean = LeastSquares().predict(walk, now_s + patrol.ahead_s[None]).mean[0]
            assert waits[presence, robot] == slow_wait(patrol, robot, presence, mean)


class TestPolicies:
    @pytest.mark.parametrize("predictor", [LeastSquares(), KalmanCV()])
    def test_ahead_withholds_nothing_from_its_own_forecaster(self, tracks, predictor):
        settings = SETTINGS.changed({"patrol.segment_s": 12.0})
        patrol = make_patrol(tracks, settings=settings, seed=0)
        network = make_network(patrol, forecaster=predictor)
        reach_s = patrol.ahead_s[-1]
        everything = foreseen(network, Everything(), predictor)
        ahead = Ahead(RADIUS_M, window_s=None, horizon_s=reach_s)
        np.testing.assert_array_equal(foreseen(network, ahead, predictor), everything)
        assert (everything < NEVER).any()
        narrow = Ahead(0.3, window_s=None, horizon_s=reach_s)
        assert not np.array_equal(foreseen(network, narrow, predictor), everything)

    @pytest.mark.parametrize("policy", [Flag(), State()])
    def test_state_and_flag_tell_what_the_network_foresees(self, crowd, policy):
        everything = foreseen(crowd, Everything(), KalmanCV())
        np.testing.assert_array_equal(
            foreseen(crowd, policy, LeastSquares()), everything
        )

    def test_a_flag_on_raw_is_free_of_the_added_error_and_a_state_is_not(self, crowd):
        noisy = make_network(crowd.patrol, Fid(1.0))
        np.testing.assert_array_equal(foreseen(noisy, Flag()), foreseen(crowd, Flag()))
        shared = foreseen(noisy, Everything(), KalmanCV())
        np.testing.assert_array_equal(foreseen(noisy, Flag(select_on="shared")), shared)
        np.testing.assert_array_equal(foreseen(noisy, State()), shared)
        assert not np.array_equal(shared, foreseen(crowd, Flag()))

    def test_a_state_of_some_people_leaves_the_others_out(self, crowd):
        disclosure = disclose(crowd, State(1.5))
        waits = foreseen(crowd, State(1.5))
        sent = np.zeros(waits.shape, dtype=bool)
        sent[disclosure.presence, disclosure.robot] = True
        assert 0 < sent.sum() < sent.size
        np.testing.assert_array_equal(waits[sent], foreseen(crowd, State())[sent])
        assert (waits[~sent] == NEVER).all()

    def test_by_construction_needs_the_same_forecaster_and_the_same_positions(
        self, crowd
    ):
        noisy = make_network(crowd.patrol, Fid(1.0))
        ahead, on_shared = Ahead(1.0, None), Ahead(1.0, None, select_on="shared")
        assert is_by_construction(crowd, ahead, KalmanCV())
        assert not is_by_construction(crowd, ahead, KalmanCV(q=0.1))
        # The robot reads 1.3 s only.
        assert not is_by_construction(crowd, Ahead(1.0), KalmanCV())
        assert not is_by_construction(crowd, Near(1.0), KalmanCV())
        assert not is_by_construction(noisy, ahead, KalmanCV())
        assert is_by_construction(noisy, on_shared, KalmanCV())
        assert is_by_construction(noisy, State(), KalmanCV())
        assert is_by_construction(crowd, State(2.0), KalmanCV())
        # The policy selects on raw.
        assert not is_by_construction(noisy, State(2.0), KalmanCV())
        assert is_by_construction(noisy, Everything(), LeastSquares())

    def test_everything_withholds_nothing(self, crowd):
        everything = disclose(crowd, Everything())
        task = robot_task(crowd, everything, predictor=KalmanCV(), settings=SETTINGS)
        for horizon in horizon_scans(SETTINGS):
            metrics = utility_metrics(task, everything, horizon=horizon, seed=0)
            assert metrics["withheld_share"].value == 0.0
            assert metrics["withheld_share"].n > 0


def test_a_robot_that_meets_nobody_foresees_nothing():
    patrol = patrol_past(straight_walks((0.0, 5.0, (0.0, 0.0), (1.0, 0.0))), (900.0, 0))
    network = clean_network(patrol)
    foreseen = foreseen_conflicts(
        network,
        disclose(network, Near(1.0)),
        predictor=LeastSquares(),
        safety_radius_m=0.9,
    )
    assert (foreseen == NEVER).all()
