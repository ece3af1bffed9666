"""Counts in blocks against plain loops, and misses at equal false alarms."""

import numpy as np
import pytest
from helpers.patrols import ROUND

from isac_track.patrols import horizon_scans, make_patrol, scans_per_query, sense_people
from isac_track.patrols.equal_alarms import DISTANCES_M
from isac_track.patrols.utility import first_entries, missed_futures, true_conflicts
from isac_track.tracking import (
    GNN,
    DetectionSettings,
    Likelihood,
    detect_people,
    track_patrol,
)
from isac_track.tracking.blocks import block_missed_at_equal_alarms
from isac_track.tracking.counts import (
    GOSPA_CUTOFF_M,
    Blocks,
    robot_counts,
    track_counts,
)
from isac_track.tracking.metrics import gospa_scans, ospa, pure_samples
from isac_track.tracking.sharing import share_tracks
from isac_track.tracking.utility import foresee_from_tracks
from predictors.kalman import KalmanCV

SETTINGS = ROUND.changed({"patrol.fleets": 3, "patrol.segment_s": 25.0})
HORIZON = horizon_scans(SETTINGS)[-1]
RADIUS_M = SETTINGS.conflict.safety_radius_m


@pytest.fixture(scope="module")
def patrol(request):
    tracks = request.getfixturevalue("tracks")
    return make_patrol(tracks, settings=SETTINGS, seed=0)


@pytest.fixture(scope="module")
def detected(patrol):
    return detect_people(
        patrol,
        sense_people(patrol, settings=SETTINGS, seed=0),
        settings=DetectionSettings(clutter_per_scan=6.0),
        sensing=SETTINGS.sensing,
        seed=0,
    )


@pytest.fixture(scope="module")
def tracked(detected):
    return track_patrol(GNN(), detected, likelihood=Likelihood())


@pytest.fixture(scope="module")
def foresight(patrol, detected, tracked):
    return foresee_from_tracks(
        patrol,
        share_tracks(detected, tracked, seed=0),
        predictor=KalmanCV(),
        safety_radius_m=RADIUS_M,
        horizons=(HORIZON,),
    )


@pytest.fixture(scope="module")
def counts(patrol, foresight):
    return robot_counts(
        Blocks(patrol, 5.0),
        foresight,
        actual=true_conflicts(patrol, safety_radius_m=RADIUS_M),
        entries=first_entries(patrol, safety_radius_m=RADIUS_M),
        horizon=HORIZON,
        scans_per_query=scans_per_query(SETTINGS.patrol),
    )


def test_counts_of_blocks_add_up_to_those_of_the_recording(patrol, detected, tracked):
    shared = share_tracks(detected, tracked, seed=0)
    scans = gospa_scans(patrol, tracked, cutoff_m=GOSPA_CUTOFF_M)
    made = track_counts(Blocks(patrol, 5.0), shared, scans)
    assert made["purity"].numerator.sum() == pure_samples(shared).sum()
    assert made["purity"].denominator.sum() == shared.scan.size
    assert made["gospa"].numerator.sum() == pytest.approx(scans.distance.sum())
    minutes = patrol.people.t.size * 0.1 / 60.0
    assert made["id_switches"].denominator.sum() == pytest.approx(minutes)
    scan = int(scans.false.argmax())
    reported = tracked.xy[(tracked.scan == scan) & tracked.is_reported]
    alone = ospa(patrol.people.xy[patrol.scan == scan], reported, cutoff_m=1.0)
    assert scans.ospa(cutoff_m=1.0)[scan] == pytest.approx(alone)


def test_misses_and_false_alarms_are_those_of_plain_loops(patrol, foresight, counts):
    actual = true_conflicts(patrol, safety_radius_m=RADIUS_M)
    alarm = foresight.alarms(patrol, horizon=HORIZON)
    conflict = np.zeros_like(alarm)
    np.logical_or.at(conflict, patrol.presences.query, actual <= HORIZON)
    false_runs = 0
    for robot in range(patrol.n_robots):
        run = []
        for is_alarm, is_conflict in [
            *zip(alarm[:, robot], conflict[:, robot], strict=True),
            (False, False),
        ]:
            if is_alarm:
                run.append(is_conflict)
            elif run:
                false_runs += not any(run)
                run = []
    assert counts.false_alarms.numerator.sum() == false_runs > 0
    minutes = patrol.n_robots * patrol.duration_s / 60.0
    assert counts.false_alarms.denominator.sum() == pytest.approx(minutes)
    misses = missed_futures(actual, foresight.foreseen, horizon=HORIZON)
    share = counts.shares["missed_future_rate"]
    assert share.numerator.sum() / share.denominator.sum() == misses.rate
    assert (share.numerator <= share.denominator).all()


def test_the_alarm_distance_of_the_safety_radius_is_the_robot_itself(counts):
    step = int(np.abs(DISTANCES_M - RADIUS_M).argmin())
    alarms = counts.by_distance.alarms[step]
    np.testing.assert_array_equal(alarms, counts.false_queries.numerator)
    warned = counts.by_distance.warned
    share = counts.shares["missed_future_rate"]
    np.testing.assert_array_equal(warned[step + 1 :].sum(axis=0), share.numerator)
    np.testing.assert_array_equal(warned.sum(axis=0), share.denominator)
    assert (np.diff(counts.by_distance.alarms, axis=0) >= 0).all()


def test_at_its_own_false_alarms_a_robot_misses_as_much(counts):
    by_distance, share = counts.by_distance, counts.shares["missed_future_rate"]
    estimate = block_missed_at_equal_alarms(
        alarms=by_distance.alarms[:, :, None],
        warned=by_distance.warned[:, :, None],
        allowed=counts.false_queries.numerator[:, None],
        seed=0,
    )
    rate = share.numerator.sum() / share.denominator.sum()
    assert estimate.value == pytest.approx(rate)


def test_equal_false_alarms_by_hand_over_blocks_and_seeds():
    rng = np.random.default_rng(0)
    alarms = np.cumsum(rng.integers(0, 3, (4, 20, 2)), axis=0).astype(float)
    warned = rng.integers(0, 5, (5, 20, 2)).astype(float)
    allowed = alarms[1] + 0.5 * (alarms[2] - alarms[1])
    estimate = block_missed_at_equal_alarms(
        alarms=alarms, warned=warned, allowed=allowed, seed=0
    )
    trials = warned.sum()
    missed = [1.0 - warned[: step + 1].sum() / trials for step in (1, 2)]
    assert estimate.value == pytest.approx(sum(missed) / 2.0)
    assert estimate.ci_low < estimate.value < estimate.ci_high
    again = block_missed_at_equal_alarms(
        alarms=alarms[:, ::-1], warned=warned[:, ::-1], allowed=allowed[::-1], seed=0
    )
    assert again.value == pytest.approx(estimate.value)
