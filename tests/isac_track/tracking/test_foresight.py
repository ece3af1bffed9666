"""What adversaries know and robots foresee from tracks: as without tracking, by hand."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.patrols import ROUND, patrol_past, straight_walks

from isac_track.patrols import sense_people
from isac_track.patrols.answers import disclose
from isac_track.patrols.estimators import ESTIMATORS
from isac_track.patrols.knowledge import guesses_from_map, known_places
from isac_track.patrols.network import share_patrol
from isac_track.patrols.utility import NEVER, foreseen_conflicts
from isac_track.policies.samples import Everything
from isac_track.sharing import Raw
from isac_track.tracking import (
    DetectionSettings,
    TrackerSettings,
    detect_people,
    run_tracker,
)
from isac_track.tracking.blocks import block_numbers, block_ratio, block_statistic
from isac_track.tracking.knowledge import known_instants
from isac_track.tracking.sharing import SharedTracks, share_tracks
from isac_track.tracking.utility import foresee_from_tracks
from isac_track.types import Release
from predictors.kalman import KalmanCV

EPSILON_M, RADIUS_M = 0.3, 0.9
TRACKS = straight_walks(
    (0, 20, (-10, 0.3), (1, 0)), (0, 20, (0, -10), (0, 1)), (0, 20, (5, 5), (0, 0))
)


@pytest.fixture(scope="module")
def patrol():
    return patrol_past(TRACKS, (0, 0), (5, 4))


def release_of_tracks(patrol, tracks, *, alive=None):
    """Tracks of the true samples with these numbers; a person each may be named."""
    sample = np.concatenate([np.array(row) for row in tracks])
    offsets = np.cumsum([0, *map(len, tracks)])
    people, scan = patrol.people, patrol.scan[sample]
    release = Release(
        t=people.t[sample],
        xy=people.xy[sample],
        sigma=None,
        offsets=offsets,
        pseudonym=tuple(map(str, range(len(tracks)))),
    )
    first, last = scan[offsets[:-1]], scan[offsets[1:] - 1]
    return SharedTracks(
        release=release,
        variance=np.full(sample.size, 1e-4),
        scan=scan,
        confirmed=first,
        last=last if alive is None else np.array(alive),
        person=np.searchsorted(people.offsets, sample, side="right") - 1,
    )


def samples_by_person(patrol, person, first, end):
    start = patrol.people.offsets[person]
    return list(range(start + first, start + end))


def test_with_certain_detection_the_oracle_gives_the_answers_of_everything(patrol):
    network = share_patrol(
        patrol, mechanism=Raw(), forecaster=KalmanCV(), settings=ROUND, seed=0
    )
    everything = disclose(network, Everything())
    detected = detect_people(
        patrol,
        sense_people(patrol, settings=ROUND, seed=0),
        settings=DetectionSettings(probability=1.0, clutter_per_scan=0.0),
        sensing=ROUND.sensing,
        seed=0,
    )
    tracked = run_tracker(detected, settings=TrackerSettings(method="oracle"))
    shared = share_tracks(detected, tracked, seed=0)
    np.testing.assert_array_equal(shared.release.xy, network.release.xy)
    guesses = guesses_from_map(patrol, epsilon_m=EPSILON_M)
    expected = known_places(network, everything, guesses=guesses, epsilon_m=EPSILON_M)
    known = known_instants(patrol, shared, guesses=guesses, epsilon_m=EPSILON_M)
    counts = np.add.reduceat(known, patrol.grid.offsets[:-1], axis=1, dtype=np.int64)
    np.testing.assert_array_equal(counts, expected.known[:, :, 0])
    foresight = foresee_from_tracks(
        patrol, shared, predictor=KalmanCV(), safety_radius_m=RADIUS_M
    )
    foreseen = foreseen_conflicts(
        network, everything, predictor=KalmanCV(), safety_radius_m=RADIUS_M
    )
    np.testing.assert_array_equal(foresight.foreseen, foreseen)
    assert (foreseen < NEVER).any()
    assert (foresight.ghost == NEVER).all()


class TestKnowledge:
    def know(self, patrol, shared):
        return known_instants(
            patrol,
            shared,
            guesses=np.full((3, 2), 1e3),
            epsilon_m=0.25,  # Between the places of two scans.
            estimators=("interpolate", "hold"),
        )

    def counts(self, patrol, known):
        return [
            np.add.reduceat(row.astype(int), patrol.grid.offsets[:-1]).tolist()
            for row in known
        ]

    def test_a_swap_is_wrong_where_the_track_holds_another(self, patrol):
        shared = release_of_tracks(
            patrol,
            [
                samples_by_person(patrol, 0, 0, 120)
                + samples_by_person(patrol, 2, 120, 201),
                samples_by_person(patrol, 2, 0, 120)
                + samples_by_person(patrol, 0, 120, 201),
            ],
        )
        known = self.know(patrol, shared)
        assert self.counts(patrol, known) == [[120, 0, 120]] * 2

    def test_the_nearest_of_two_tracks_states_an_instant(self, patrol):
        first = samples_by_person(patrol, 0, 0, 50)
        second = samples_by_person(patrol, 0, 150, 201)
        known = self.know(patrol, release_of_tracks(patrol, [first, second]))
        # Held: 0.2 m on, from 50 and 51 of the first, from 149 and 148 of the second.
        assert self.counts(patrol, known) == [[50 + 51 + 4, 0, 0]] * 2

    def test_clutter_tells_of_nobody(self, patrol):
        shared = release_of_tracks(patrol, [samples_by_person(patrol, 2, 0, 201)])
        nobody = replace(shared, person=np.full(201, -1))
        assert not self.know(patrol, nobody).any()

    def test_all_estimators_are_tried_by_default(self, patrol):
        shared = release_of_tracks(patrol, [samples_by_person(patrol, 2, 0, 201)])
        known = known_instants(
            patrol, shared, guesses=np.full((3, 2), 1e3), epsilon_m=EPSILON_M
        )
        assert len(known) == len(ESTIMATORS)


class TestForesight:
    def foresee(self, patrol, shared):
        return foresee_from_tracks(
            patrol, shared, predictor=KalmanCV(), safety_radius_m=RADIUS_M
        )

    def warned(self, patrol, foresight, person, robot=0):
        """Seconds (queries) at which a robot foresees the person within 3 s."""
        rows = np.flatnonzero(patrol.presences.person == person)
        is_near = foresight.foreseen[rows, robot] <= 30
        return patrol.presences.query[rows][is_near].tolist()

    def test_a_warning_comes_from_a_live_track_alone(self, patrol):
        whole = release_of_tracks(patrol, [samples_by_person(patrol, 0, 0, 201)])
        assert self.warned(patrol, self.foresee(patrol, whole), 0) == [7, 8, 9, 10]
        ended = replace(whole, last=np.array([80]))
        assert self.warned(patrol, self.foresee(patrol, ended), 0) == [7, 8]
        late = replace(whole, confirmed=np.array([85]))
        assert self.warned(patrol, self.foresee(patrol, late), 0) == [9, 10]

    def test_samples_before_confirmation_help_from_then_on(self, patrol):
        row = samples_by_person(patrol, 0, 0, 201)
        shared = release_of_tracks(patrol, [row])
        late = replace(shared, confirmed=np.array([81]))
        at_nine = patrol.presences.query == 9
        np.testing.assert_array_equal(
            self.foresee(patrol, late).foreseen[at_nine],
            self.foresee(patrol, shared).foreseen[at_nine],
        )

    def test_a_track_about_another_person_does_not_warn_of_the_first(self, patrol):
        # From 8 s on the track that held person 0 holds the person who stands still.
        row = samples_by_person(patrol, 0, 0, 80) + samples_by_person(
            patrol, 2, 80, 201
        )
        foresight = self.foresee(patrol, release_of_tracks(patrol, [row]))
        assert self.warned(patrol, foresight, 0) == [7]

    def test_an_alarm_about_nobody_is_an_alarm(self, patrol):
        shared = release_of_tracks(patrol, [samples_by_person(patrol, 0, 0, 201)])
        nobody = replace(shared, person=np.full(201, -1))
        foresight = self.foresee(patrol, nobody)
        assert (foresight.foreseen == NEVER).all()
        alarms = foresight.alarms(patrol, horizon=30)
        assert np.flatnonzero(alarms[:, 0]).tolist() == [7, 8, 9, 10]
        of_person = self.foresee(patrol, shared).alarms(patrol, horizon=30)
        np.testing.assert_array_equal(alarms, of_person)

    def test_without_a_track_nothing_is_foreseen(self, patrol):
        shared = release_of_tracks(patrol, [samples_by_person(patrol, 0, 0, 5)])
        never = replace(shared, confirmed=np.array([1]), last=np.array([5]))
        foresight = self.foresee(patrol, never)
        assert (foresight.foreseen == NEVER).all()
        assert not foresight.alarms(patrol, horizon=30).any()


class TestBlocks:
    def test_numbers(self):
        t = np.array([5.0, 14.9, 15.0, 26.0])
        assert block_numbers(t, start_s=5.0, block_s=10.0).tolist() == [0, 0, 1, 2]

    def test_a_ratio_of_sums_with_an_interval_that_holds_it(self):
        rng = np.random.default_rng(0)
        bottom = rng.integers(50, 100, (30, 5)).astype(float)
        top = rng.binomial(bottom.astype(int), 0.3).astype(float)
        estimate = block_ratio(numerator=top, denominator=bottom, seed=0)
        assert estimate.value == top.sum() / bottom.sum()
        assert estimate.ci_low < 0.3 < estimate.ci_high
        assert (estimate.ci_high - estimate.ci_low) < 0.1

    def test_a_seed_that_differs_widens_the_interval(self):
        bottom = np.full((30, 5), 100.0)
        top = np.tile([20.0, 30.0, 40.0, 50.0, 60.0], (30, 1))
        estimate = block_ratio(numerator=top, denominator=bottom, seed=0)
        assert estimate.ci_high - estimate.ci_low > 0.2

    @pytest.mark.parametrize(("n_blocks", "share"), [(8, 0.5), (30, 1.0)])
    def test_few_blocks_or_a_share_of_all_have_no_interval(self, n_blocks, share):
        bottom = np.full((n_blocks, 5), 10.0)
        estimate = block_ratio(numerator=share * bottom, denominator=bottom, seed=0)
        assert estimate.value == share
        assert np.isnan(estimate.ci_low)
        assert estimate.n == n_blocks

    def test_a_statistic_of_rows_is_that_of_their_blocks_and_seeds(self):
        rng = np.random.default_rng(0)
        block, number = np.repeat(np.arange(20), 15), np.tile(np.arange(3), 100)
        values = rng.normal(5.0, 1.0, block.size)
        counted = np.zeros((20, 3))
        np.add.at(counted, (block, number), 1.0)
        sums = np.zeros((20, 3))
        np.add.at(sums, (block, number), values)
        expected = block_ratio(
            numerator=sums, denominator=counted, seed=0, is_share=False
        )
        estimate = block_statistic(
            lambda weights: weights @ values / weights.sum(axis=1),
            block=block,
            seed_number=number,
            counted=counted,
            seed=0,
        )
        assert estimate.value == pytest.approx(expected.value)
        np.testing.assert_allclose(estimate.replicates, expected.replicates)
        assert estimate.ci_low == pytest.approx(expected.ci_low)
