"""GOSPA against Stone Soup and closed forms; purity, switches and fragments by hand."""

from itertools import permutations

import numpy as np
import pytest
from helpers.detections import make_detected
from helpers.patrols import ROUND, patrol_past, straight_walks

from isac_track.patrols import sense_people
from isac_track.tracking import (
    DetectionSettings,
    TrackerSettings,
    detect_people,
    run_tracker,
)
from isac_track.tracking.metrics import (
    fragment_starts,
    gospa,
    gospa_scans,
    identity_switches,
    ospa,
    pure_samples,
    track_owners,
)
from isac_track.tracking.sharing import share_tracks
from isac_track.tracking.trackers import Tracked

STONE_SOUP_1_9_1 = [
    (
        [[2.42, 2.42], [1.55, 0.86], [0.16, 1.15], [1.23, 0.14]],
        [
            *([0.15, 3.0], [1.96, 0.7], [1.3, 2.92], [2.69, 2.53]),
            *([1.18, 1.48], [2.03, 0.18]),
        ],
        1.0,
        (1.7088885276693735, 0.9202999999999996, 0.5, 1.5),
    ),
    (
        [
            *([1.67, 0.81], [2.64, 0.19], [2.04, 2.61], [0.68, 2.69]),
            *([2.62, 0.06], [2.12, 0.0], [1.51, 1.31]),
        ],
        [[0.61, 0.97], [2.42, 0.95], [0.45, 2.1]],
        1.0,
        (1.9770432468714487, 1.9087, 2.0, 0.0),
    ),
    (
        [[1.35, 2.4], [0.71, 0.96], [2.4, 1.52], [1.52, 0.71], [0.04, 2.8]],
        [[0.26, 2.53], [1.1, 2.85], [1.2, 2.81], [1.67, 0.72], [2.22, 2.02]],
        2.5,
        (2.0710142442774266, 4.2891, 0.0, 0.0),
    ),
    (
        [
            *([1.17, 2.39], [1.14, 2.14], [1.84, 2.82], [2.98, 2.17]),
            *([2.43, 0.46], [2.14, 2.54], [1.2, 1.66], [1.44, 2.88]),
        ],
        [
            *([0.95, 1.21], [0.0, 1.26], [1.89, 2.8], [2.77, 0.98]),
            *([2.97, 0.56], [2.47, 0.47], [1.22, 0.22], [2.57, 2.49]),
        ],
        0.4,
        (0.9821405194777375, 0.004599999999999985, 0.48, 0.48),
    ),
    ([[2.05, 1.39], [0.67, 1.92], [0.32, 2.08]], [], 1.0, (1.5**0.5, 0.0, 1.5, 0.0)),
    ([], [[1.91, 1.13], [2.4, 0.58]], 1.0, (1.0, 0.0, 0.0, 1.0)),
]
"""Truth, tracks, cut-off; distance, localisation, missed and false in m^2.

Of `GOSPAMetric(c=c, p=2).compute_gospa_metric` of stonesoup 1.9.1.
"""


def places(rows):
    return np.array(rows, dtype=float).reshape(-1, 2)


class TestGospa:
    @pytest.mark.parametrize(("truth", "tracks", "cutoff_m", "parts"), STONE_SOUP_1_9_1)
    def test_is_that_of_stone_soup(self, truth, tracks, cutoff_m, parts):
        answer = gospa(places(truth), places(tracks), cutoff_m=cutoff_m)
        half = cutoff_m**2 / 2.0
        assert (
            answer.distance,
            answer.localisation,
            half * answer.missed,
            half * answer.false,
        ) == pytest.approx(parts)

    @pytest.mark.parametrize("p", [1.0, 2.0, 3.0])
    def test_by_hand(self, p):
        truth = places([(0, 0), (10, 0), (20, 0)])
        tracks = places([(0.3, 0.4), (50, 0)])
        answer = gospa(truth, tracks, cutoff_m=2.0, p=p)
        assert (answer.matched, answer.missed, answer.false) == (1, 2, 1)
        assert answer.distance**p == pytest.approx(0.5**p + 2.0**p / 2.0 * 3)

    def test_a_pair_at_the_cut_off_is_no_pair(self):
        answer = gospa(places([(0, 0)]), places([(1, 0)]), cutoff_m=1.0)
        assert (answer.missed, answer.false, answer.distance) == (1, 1, 1.0)

    @pytest.mark.parametrize("wrong", [{"cutoff_m": 0.0}, {"cutoff_m": 1.0, "p": 0.5}])
    def test_refuses_bad_parameters(self, wrong):
        with pytest.raises(ValueError, match="must be"):
            gospa(places([(0, 0)]), places([(0, 0)]), **wrong)


def ospa_by_definition(truth, tracks, *, cutoff_m, p):
    """Schuhmacher et al. (2008), eq. 3, over all permutations, as Stone Soup has it."""
    few, many = sorted((truth, tracks), key=len)
    if not len(many):
        return 0.0
    gaps = np.minimum(np.linalg.norm(few[:, None] - many[None], axis=2), cutoff_m)
    rows = np.arange(len(few))
    best = min(
        (gaps[rows, list(columns)] ** p).sum()
        for columns in permutations(range(len(many)), len(few))
    )
    alone = cutoff_m**p * (len(many) - len(few))
    return ((best + alone) / len(many)) ** (1.0 / p)


class TestOspa:
    @pytest.mark.parametrize(
        ("truth", "tracks", "cutoff_m", "_parts"), STONE_SOUP_1_9_1
    )
    @pytest.mark.parametrize("p", [1.0, 2.0])
    def test_is_its_definition_over_all_assignments(
        self, truth, tracks, cutoff_m, _parts, p
    ):
        truth, tracks = places(truth[:6]), places(tracks[:6])
        expected = ospa_by_definition(truth, tracks, cutoff_m=cutoff_m, p=p)
        assert ospa(truth, tracks, cutoff_m=cutoff_m, p=p) == pytest.approx(expected)

    def test_of_nothing_is_0_and_of_one_set_the_cut_off(self):
        assert ospa(places([]), places([]), cutoff_m=1.0) == 0.0
        assert ospa(places([]), places([(0, 0)]), cutoff_m=1.5) == 1.5


def test_gospa_of_scans_counts_people_before_confirmation_as_missed():
    tracks = straight_walks((0, 4, (0, 0), (1, 0)), (1, 3, (0, 5), (1, 0)))
    patrol = patrol_past(tracks, (0, 0))
    exact = ROUND.changed({"sensing.sigma_cap_m": 1e-6})
    detected = detect_people(
        patrol,
        sense_people(patrol, settings=exact, seed=0),
        settings=DetectionSettings(probability=1.0, clutter_per_scan=0.0),
        sensing=exact.sensing,
        seed=0,
    )
    tracked = run_tracker(detected, settings=TrackerSettings(most_misses=4))
    scans = gospa_scans(patrol, tracked, cutoff_m=1.0)
    n = scans.distance.size
    # Both are missed for two scans; the second is false for four scans after leaving.
    assert np.flatnonzero(scans.missed).tolist() == [0, 1, 10, 11]
    assert np.flatnonzero(scans.false).tolist() == [31, 32, 33, 34]
    assert (scans.matched + scans.missed == np.bincount(patrol.scan)).all()
    np.testing.assert_allclose(
        scans.distance**2,
        scans.localisation + 0.5 * (scans.missed + scans.false),
        atol=1e-12,
    )
    assert n == 41


@pytest.fixture(scope="module")
def shared():
    """Two people swap tracks at scan 6; track 2 follows person 1 on; track 3 is mixed."""
    scans = [[(0, 0, 0), (1, 5, 0), (-1, 9, 9)] for _ in range(10)]
    detected = make_detected(scans)
    by_person = {
        person: np.flatnonzero(detected.person == person) for person in (0, 1, -1)
    }
    tracks = [
        [*by_person[0][:6], *by_person[1][6:8]],
        [*by_person[1][:6], *by_person[0][6:10]],
        [*by_person[1][8:10]],
        [*by_person[-1][:2], *by_person[-1][3:5]],
    ]
    detection = np.concatenate([np.array(row) for row in tracks])
    tracked = Tracked(
        scan=detected.detections.scan[detection],
        xy=detected.detections.xy[detection],
        detection=detection,
        offsets=np.cumsum([0, *map(len, tracks)]),
        confirmed=np.array([2, 2, 8, 1]),
    )
    return share_tracks(detected, tracked, seed=0)


def test_a_track_belongs_to_the_person_with_most_samples(shared):
    assert track_owners(shared).tolist() == [0, 1, 1, -1]


def test_purity(shared):
    pure = pure_samples(shared)
    assert pure.sum() == 6 + 6 + 2
    assert pure.size == 8 + 10 + 2 + 4


def test_switches_are_counted_when_a_person_is_in_another_track(shared):
    # Person 0 and person 1 at scan 6, person 1 again at scan 8.
    assert sorted(identity_switches(shared)) == [6, 6, 8]


def shared_detections(n_scans, scans_of_tracks):
    """Share tracks of the detections of a person, by the scans of each track."""
    detected = make_detected([[(0, 0.0, 0.0)] for _ in range(n_scans)])
    detection = np.concatenate([np.array(scans) for scans in scans_of_tracks])
    tracked = Tracked(
        scan=detected.detections.scan[detection],
        xy=detected.detections.xy[detection],
        detection=detection,
        offsets=np.cumsum([0, *map(len, scans_of_tracks)]),
        confirmed=np.array([scans[0] for scans in scans_of_tracks]),
    )
    return share_tracks(detected, tracked, seed=0)


def test_two_tracks_with_the_same_detections_are_no_switch():
    both = shared_detections(10, [range(10), range(2, 10)])
    assert identity_switches(both).size == 0


def test_a_person_switches_when_the_track_that_was_followed_has_no_sample():
    # Track 0 ends; track 1 is left at scan 8, when only track 2 has a sample.
    shared = shared_detections(10, [range(4), range(2, 8), [6, 7, 8, 9], [9]])
    assert identity_switches(shared).tolist() == [4, 8]


def test_a_further_track_of_a_person_is_a_fragment(shared):
    assert fragment_starts(shared).tolist() == [8]


def test_without_tracks_there_is_nothing_to_count():
    detected = make_detected([[], [(0, 0.0, 0.0)], []])
    tracked = run_tracker(detected, settings=TrackerSettings())
    empty = share_tracks(detected, tracked, seed=0)
    for values in (track_owners, pure_samples, identity_switches, fragment_starts):
        assert values(empty).size == 0
