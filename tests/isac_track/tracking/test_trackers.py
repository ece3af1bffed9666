"""Trackers on cases made by hand: crossing, occlusion, birth, death, an empty scan."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.detections import make_detected, no_detections, walking

from isac_track.errors import SettingsError
from isac_track.rng import stream
from isac_track.tracking import (
    METHODS,
    Detections,
    Likelihood,
    TrackerSettings,
    run_tracker,
)
from isac_track.tracking.trackers import assign_by_truth, track_detections

BLIND = ("gnn", "jpda")
REFERENCES = ("oracle", "genie")


def people_of_tracks(detected, tracked):
    """The people behind the detections of each track, in time; -1 is clutter."""
    rows = np.split(tracked.detection, tracked.offsets[1:-1])
    return [detected.person[row[row >= 0]].tolist() for row in rows]


def track(scans, method="gnn", **changes):
    detected = make_detected(scans)
    settings = TrackerSettings(method=method, **changes)
    return detected, run_tracker(detected, settings=settings)


@pytest.mark.parametrize("method", METHODS)
class TestEveryTracker:
    def test_a_single_person_is_a_single_track(self, method):
        detected, tracked = track(walking(((0, 0), (1, 0.5), 0, 40)), method)
        assert people_of_tracks(detected, tracked) == [[0] * 40]
        assert tracked.confirmed.tolist() == [0 if method in REFERENCES else 2]
        np.testing.assert_allclose(tracked.xy[-1], (3.9, 1.95), atol=0.01)

    def test_two_people_who_cross_keep_their_tracks(self, method):
        scans = walking(((0, 0), (1.5, 0.5), 0, 40), ((0, 2.05), (1.5, -0.5), 0, 40))
        detected, tracked = track(scans, method)
        assert sorted(people_of_tracks(detected, tracked)) == [[0] * 40, [1] * 40]

    def test_a_person_who_is_hidden_for_a_moment_keeps_the_track(self, method):
        scans = walking(((0, 0), (1, 0), 0, 40, range(20, 24)))
        detected, tracked = track(scans, method)
        assert people_of_tracks(detected, tracked) == [[0] * 36]
        # Without a detection the track goes on by its velocity.
        hidden = np.flatnonzero(tracked.detection < 0)
        assert tracked.scan[hidden].tolist() == [20, 21, 22, 23]
        np.testing.assert_allclose(
            tracked.xy[hidden, 0], [2.0, 2.1, 2.2, 2.3], atol=0.02
        )

    def test_an_empty_recording_has_no_track(self, method):
        detected = replace(make_detected([[]] * 5), detections=no_detections(n_scans=5))
        tracked = run_tracker(detected, settings=TrackerSettings(method=method))
        assert len(tracked) == 0
        assert tracked.track.size == 0
        assert tracked.is_reported.size == 0


@pytest.mark.parametrize("method", BLIND)
class TestLifeCycle:
    def test_a_person_who_is_hidden_for_long_comes_back_as_another(self, method):
        scans = walking(((0, 0), (1, 0), 0, 40, range(15, 25)))
        detected, tracked = track(scans, method, most_misses=5)
        assert people_of_tracks(detected, tracked) == [[0] * 15, [0] * 15]
        # It ends after five scans of prediction.
        assert tracked.scan[tracked.offsets[1] - 1] == 19

    def test_birth_and_death(self, method):
        scans = walking(((0, 0), (1, 0), 0, 25), ((0, 5), (1, 0), 10, 40))
        detected, tracked = track(scans, method, most_misses=5)
        assert people_of_tracks(detected, tracked) == [[0] * 25, [1] * 30]
        assert tracked.confirmed.tolist() == [2, 12]
        first, last = tracked.offsets[:-1], tracked.offsets[1:] - 1
        assert tracked.scan[first].tolist() == [0, 10]
        assert tracked.scan[last].tolist() == [29, 39]

    def test_clutter_is_never_confirmed(self, method):
        scans = walking(((0, 0), (1, 0), 0, 40))
        for scan, points in enumerate(scans):
            points.append((-1, 10.0 * (scan % 7), 20.0))
        detected, tracked = track(scans, method)
        assert people_of_tracks(detected, tracked) == [[0] * 40]

    def test_confirmation_needs_hits_within_its_scans(self, method):
        # Detected at scans 0, 2, 4: three of five. At 0, 3, 6: never three of five.
        for every, n_tracks in ((2, 1), (3, 0)):
            scans = walking(((0, 0), (0, 0), 0, 12))
            scans = [points if k % every == 0 else [] for k, points in enumerate(scans)]
            _, tracked = track(scans, method, most_misses=3)
            assert len(tracked) == n_tracks

    def test_an_empty_scan_is_a_missed_scan(self, method):
        scans = walking(((0, 0), (1, 0), 0, 20), ((0, 3), (1, 0), 0, 20), n_scans=20)
        scans[10] = []
        detected, tracked = track(scans, method)
        assert sorted(people_of_tracks(detected, tracked)) == [[0] * 19, [1] * 19]

    def test_a_tracker_is_causal(self, method):
        rng = stream(0, "causal")
        scans = [
            [(0, *rng.normal(0, 0.5, 2)), (1, *rng.normal(0.5, 0.5, 2))]
            for _ in range(30)
        ]
        detected, whole = track(scans, method, most_misses=2)
        early_detected, early = track(scans[:20], method, most_misses=2)
        assert len(early) > 1
        n_early = len(early_detected.detections)
        np.testing.assert_array_equal(
            detected.detections.xy[:n_early], early_detected.detections.xy
        )
        for row in range(len(early)):
            part = slice(*early.offsets[row : row + 2])
            start = whole.offsets[row]
            same = slice(start, start + part.stop - part.start)
            np.testing.assert_array_equal(whole.detection[same], early.detection[part])
            np.testing.assert_array_equal(whole.xy[same], early.xy[part])


def test_people_closer_than_the_error_swap_or_merge_under_every_blind_tracker():
    rng = stream(0, "close")
    scans = walking(((0, 0), (1, 0), 0, 40), ((0, 0.1), (1, 0), 0, 40))
    scans = [
        [
            (who, x + dx, y + dy)
            for (who, x, y), (dx, dy) in zip(points, noise, strict=True)
        ]
        for points, noise in zip(scans, rng.normal(0, 0.3, (40, 2, 2)), strict=True)
    ]
    detected = make_detected(scans, std_m=0.3)
    for method in ("oracle", *BLIND):
        tracked = run_tracker(detected, settings=TrackerSettings(method=method))
        mixed = [len(set(row)) > 1 for row in people_of_tracks(detected, tracked)]
        assert any(mixed) == (method in BLIND), method


def test_the_genie_assigns_by_true_places_the_most_probable_way():
    # Person 0 truly is at 0, person 1 at 1; the errors exchange both at scan 1.
    detected = make_detected([[(0, 0.0, 0.0), (1, 1.0, 0.0)]] * 3, std_m=0.5)
    sensed, detections = detected.sensed, detected.detections
    is_second = detections.scan == 1
    shift = np.where(detected.person == 0, 1.0, -1.0) * is_second
    wrong = np.column_stack([shift, 0.0 * shift])
    moved = replace(
        detected,
        detections=replace(detections, xy=detections.xy + wrong),
        sensed=replace(sensed, xy=sensed.xy + wrong, unit_error=wrong / 0.5),
    )
    person = assign_by_truth(moved, likelihood=Likelihood())
    is_right = person == detected.person
    np.testing.assert_array_equal(is_right, ~is_second)
    # Clutter farther away than a person's own detection stays clutter.
    scans = [[(0, 0.0, 0.0), (-1, 3.0, 0.0)]] * 3
    cluttered = make_detected(scans, std_m=0.1)
    person = assign_by_truth(cluttered, likelihood=Likelihood())
    np.testing.assert_array_equal(person, cluttered.person)


def test_no_blind_tracker_is_purer_than_the_genie():
    rng = stream(0, "bound")
    starts = rng.uniform(0, 3, (8, 2))
    scans = walking(*((start, (0.5, 0), 0, 40) for start in starts))
    detected = make_detected(scans, std_m=0.4)
    wrong = 0.4 * rng.normal(size=(len(detected.detections), 2))
    sensed = replace(
        detected.sensed, xy=detected.sensed.xy + wrong, unit_error=wrong / 0.4
    )
    xy = detected.detections.xy + wrong
    noisy = replace(
        detected, detections=replace(detected.detections, xy=xy), sensed=sensed
    )
    purity = {}
    for method in METHODS:
        tracked = run_tracker(noisy, settings=TrackerSettings(method=method))
        rows = people_of_tracks(noisy, tracked)
        pure = sum(max(map(row.count, set(row))) for row in rows)
        purity[method] = pure / sum(map(len, rows))
    assert purity["oracle"] == 1.0
    assert 0.5 < purity["genie"] < 1.0
    assert max(purity["gnn"], purity["jpda"]) < purity["genie"]


def test_a_swap_is_no_swap_to_the_oracle():
    # Both turn back where they meet; a straight-on tracker swaps them.
    scans = walking(((0, 0), (1, 0), 0, 20), ((4, 0.01), (-1, 0), 0, 20), n_scans=40)
    for scan in range(20, 40):
        gap = 0.1 * (40 - scan)
        scans[scan] = [(0, gap, 0.0), (1, 4.0 - gap, 0.01)]
    detected, tracked = track(scans)
    assert all(len(set(row)) == 2 for row in people_of_tracks(detected, tracked))
    _, truth = track(scans, "oracle")
    assert len(truth) == 2


def test_jpda_weighs_two_points_that_gnn_chooses_between():
    scans = [[(0, 0.1 * k, 0.0)] for k in range(10)]
    scans.append([(0, 1.0, 0.06), (1, 1.0, -0.06)])
    _, chosen = track(scans)
    _, weighed = track(scans, "jpda")
    assert abs(chosen.xy[-1, 1]) > 0.01
    np.testing.assert_allclose(weighed.xy[-1], (1.0, 0.0), atol=1e-3)


class TestBadInput:
    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"method": "gnm"}, "unknown tracker 'gnm'.*gnn"),
            ({"confirm_hits": 6}, "confirm_hits 6"),
            ({"q": 0.0}, "q must be positive"),
            ({"speed_std_mps": float("nan")}, "speed_std_mps must be positive"),
            ({"most_misses": -1}, "most_misses must not be negative"),
        ],
    )
    def test_settings(self, changes, message):
        with pytest.raises(SettingsError, match=message):
            TrackerSettings(**changes)

    def test_detections_that_disagree(self):
        good = make_detected([[(0, 0.0, 0.0)]] * 3).detections
        for wrong in (
            {"xy": np.zeros((3, 3))},
            {"offsets": np.array([0, 1, 3])},
            {"offsets": np.array([0, 2, 1, 3])},
            {"xy": np.full((3, 2), np.nan)},
        ):
            fields = {
                name: getattr(good, name) for name in ("scan_s", "offsets", "xy", "cov")
            }
            with pytest.raises(ValueError, match="must"):
                Detections(**{**fields, **wrong})

    @pytest.mark.parametrize("method", REFERENCES)
    def test_references_need_the_truth(self, method):
        detections = make_detected([[(0, 0.0, 0.0)]] * 3).detections
        with pytest.raises(SettingsError, match=f"{method} needs the truth"):
            track_detections(detections, settings=TrackerSettings(method=method))
