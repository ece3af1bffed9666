"""Detections of a patrol: closed forms, streams by name, and what they give away."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.patrols import ROUND, patrol_past, straight_walks
from scipy.integrate import quad

from isac_track.errors import SettingsError
from isac_track.patrols import sense_people
from isac_track.plugins import parse
from isac_track.rng import stream
from isac_track.sensing import range_information_per_snr
from isac_track.tracking import (
    DetectionSettings,
    TrackerSettings,
    clutter_density,
    detect_people,
    run_tracker,
)
from isac_track.tracking.detections import CLUTTER, detection_probability
from isac_track.tracking.sharing import perturb_detections, share_tracks

CERTAIN = DetectionSettings(probability=1.0, clutter_per_scan=0.0)
FIELDS = ("sample", "person")


@pytest.fixture(scope="module")
def patrol():
    tracks = straight_walks(
        (0, 30, (-15, 0), (1, 0)), (5, 30, (0, -10), (0, 1)), (0, 20, (3, 3), (0, 0))
    )
    return patrol_past(tracks, (0, 0))


@pytest.fixture(scope="module")
def sensed(patrol):
    return sense_people(patrol, settings=ROUND, seed=0)


def detect(patrol, sensed, settings, seed=0):
    return detect_people(
        patrol, sensed, settings=settings, sensing=ROUND.sensing, seed=seed
    )


def test_certain_detection_gives_every_sample_as_sensed(patrol, sensed):
    detected = detect(patrol, sensed, CERTAIN)
    assert sorted(detected.sample) == list(range(patrol.people.t.size))
    order = detected.sample
    np.testing.assert_array_equal(detected.detections.xy, sensed.xy[order])
    np.testing.assert_array_equal(detected.detections.scan, patrol.scan[order])
    np.testing.assert_allclose(
        detected.detections.cov,
        0.5 * sensed.sigma_raw[order, None, None] ** 2 * np.eye(2),
    )
    owner = np.searchsorted(patrol.people.offsets, order, side="right") - 1
    np.testing.assert_array_equal(detected.person, owner)


def test_clutter_of_a_scan_errs_in_directions_of_its_own(patrol):
    fixed = ROUND.changed({"sensing.law": "fixed_direction"})
    detected = detect(
        patrol,
        sense_people(patrol, settings=fixed, seed=0),
        DetectionSettings(probability=0.0, clutter_per_scan=4.0),
    )
    error = detected.sensed.unit_error
    direction = np.mod(np.arctan2(error[:, 1], error[:, 0]), np.pi).round(9)
    scans = np.split(direction, detected.detections.offsets[1:-1])
    assert max(map(len, scans)) > 3
    assert all(len(set(scan.tolist())) == len(scan) for scan in scans)


@pytest.mark.parametrize("probability", [0.0, 0.3, 0.9])
def test_the_share_of_missed_detections(patrol, sensed, probability):
    settings = replace(CERTAIN, probability=probability)
    n = patrol.people.t.size
    std = np.sqrt(n * probability * (1.0 - probability))
    detected = detect(patrol, sensed, settings)
    assert abs(len(detected.detections) - n * probability) <= 4.0 * std


def test_a_higher_probability_only_adds_detections(patrol, sensed):
    fewer, more = (
        set(detect(patrol, sensed, replace(CERTAIN, probability=p)).sample)
        for p in (0.5, 0.8)
    )
    assert fewer < more


def test_clutter_is_poisson_in_the_walked_area_and_changes_no_other_draw(
    patrol, sensed
):
    settings = DetectionSettings(clutter_per_scan=4.0)
    detected = detect(patrol, sensed, settings)
    is_clutter = detected.sample == CLUTTER
    n_scans = int(patrol.scan.max()) + 1
    counts = np.bincount(detected.detections.scan[is_clutter], minlength=n_scans)
    assert abs(counts.mean() - 4.0) < 4.0 * np.sqrt(4.0 / n_scans)
    assert abs(counts.var() / counts.mean() - 1.0) < 4.0 * np.sqrt(2.0 / n_scans)
    truth = detected.sensed.xy - (
        detected.sensed.sigma_raw[:, None] * detected.sensed.unit_error
    )
    cells = set(map(tuple, np.floor(patrol.people.xy).tolist()))
    assert set(map(tuple, np.floor(truth[is_clutter]).tolist())) <= cells
    assert clutter_density(patrol, settings=settings) == 4.0 / len(cells)
    without = detect(patrol, sensed, replace(settings, clutter_per_scan=0.0))
    np.testing.assert_array_equal(
        without.detections.xy, detected.detections.xy[~is_clutter]
    )


def test_the_order_of_a_scan_says_nothing_about_who_is_who(patrol, sensed):
    detections = detect(patrol, sensed, DetectionSettings()).detections
    same_scan = np.diff(detections.scan) == 0
    assert (np.diff(detections.xy[:, 0])[same_scan] >= 0.0).all()


@pytest.mark.parametrize("scaling", ["information", "trace"])
def test_an_elliptic_error_has_its_declared_covariance(patrol, scaling):
    settings = replace(CERTAIN, measurement="range_bearing", scaling=scaling)
    errors = []
    for seed in range(12):
        own = sense_people(patrol, settings=ROUND, seed=seed)
        detected = detect(patrol, own, settings, seed=seed)
        error = detected.detections.xy - patrol.people.xy[detected.sample]
        factor = np.linalg.cholesky(detected.detections.cov)
        errors.append(np.linalg.solve(factor, error[:, :, None])[:, :, 0])
    errors = np.concatenate(errors)
    np.testing.assert_allclose(errors.T @ errors / len(errors), np.eye(2), atol=0.06)
    # The input of a mechanism agrees with the truth.
    np.testing.assert_allclose(
        detected.sensed.xy
        - detected.sensed.sigma_raw[:, None] * detected.sensed.unit_error,
        patrol.people.xy[detected.sample],
    )


class TestLinkBudget:
    def test_without_a_target_it_is_the_false_alarm_probability(self):
        p = detection_probability(
            information=np.array([1e-12]),
            false_alarm_probability=1e-3,
            settings=ROUND.sensing,
        )
        assert p == pytest.approx(1e-3, rel=1e-6)

    @pytest.mark.parametrize("mean_snr", [1.0, 10.0, 100.0])
    def test_over_rayleigh_fading_it_is_swerling_1(self, mean_snr):
        per_snr = range_information_per_snr(bandwidth_mhz=100.0)

        def weighted(snr):
            p = detection_probability(
                information=np.array([snr * per_snr]),
                false_alarm_probability=1e-4,
                settings=ROUND.sensing,
            )
            return float(p[0]) * np.exp(-snr / mean_snr) / mean_snr

        faded, _ = quad(weighted, 0.0, 40.0 * mean_snr, limit=200)
        assert faded == pytest.approx(1e-4 ** (1.0 / (1.0 + mean_snr)), rel=1e-3)

    def test_people_with_a_weak_link_are_missed_more(self, patrol, sensed):
        settings = replace(CERTAIN, probability=None)
        sample = detect(patrol, sensed, settings).sample
        seen = np.isin(np.arange(patrol.people.t.size), sample)
        assert sensed.sigma_raw[seen].mean() < 0.8 * sensed.sigma_raw[~seen].mean()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"probability": 1.2}, "detection probability must be in 0..1, got 1.2"),
        ({"probability": float("nan")}, "detection probability"),
        ({"false_alarm_probability": 0.0}, "false-alarm probability"),
        ({"clutter_per_scan": -1.0}, "clutter_per_scan must not be negative"),
        ({"clutter_per_scan": float("inf")}, "clutter_per_scan"),
        ({"measurement": "polar"}, "unknown measurement 'polar'"),
        ({"scaling": "mean"}, "unknown scaling 'mean'"),
        ({"n_antennas": 1}, "2 antennas or more, got 1"),
    ],
)
def test_bad_settings_are_refused(wrong, message):
    with pytest.raises(SettingsError, match=message):
        DetectionSettings(**wrong)


def test_without_a_detection_there_are_empty_scans(patrol, sensed):
    nothing = DetectionSettings(probability=0.0, clutter_per_scan=0.0)
    detected = detect(patrol, sensed, nothing)
    assert len(detected.detections) == 0
    assert all(getattr(detected, name).size == 0 for name in FIELDS)


class TestSensedShape:
    """Errors that were sensed by range and bearing."""

    SHAPED = ROUND.changed({"sensing.measurement": "range_bearing"})

    def detected(self, patrol, settings, **changes):
        return detect_people(
            patrol,
            sense_people(patrol, settings=settings, seed=0),
            settings=DetectionSettings(**changes),
            sensing=settings.sensing,
            seed=0,
        )

    def test_people_keep_it_and_clutter_has_it(self, patrol):
        shaped = self.detected(patrol, self.SHAPED, clutter_per_scan=20.0)
        detections, sensed = shaped.detections, shaped.sensed
        people = sense_people(patrol, settings=self.SHAPED, seed=0)
        is_person = shaped.person != CLUTTER
        sample = shaped.sample[is_person]
        np.testing.assert_array_equal(detections.cov[is_person], people.cov[sample])
        np.testing.assert_array_equal(detections.xy[is_person], people.xy[sample])
        np.testing.assert_array_equal(sensed.cov, detections.cov)
        clutter = ~is_person
        true = sensed.xy - sensed.sigma_raw[:, None] * sensed.unit_error
        station = np.array([self.SHAPED.sensing.bs_x_m, self.SHAPED.sensing.bs_y_m])
        away = (true - station)[clutter]
        along = away / np.linalg.norm(away, axis=1, keepdims=True)
        least = np.linalg.eigh(detections.cov[clutter])[1][:, :, 0]
        np.testing.assert_allclose(np.abs((least * along).sum(axis=1)), 1.0, rtol=1e-9)
        error = (sensed.xy - true)[clutter]
        squares = np.linalg.solve(detections.cov[clutter], error[:, :, None])
        mahalanobis = (error[:, :, None] * squares).sum(axis=(1, 2))
        assert mahalanobis.mean() == pytest.approx(2.0, rel=0.2)

    def test_the_link_budget_does_not_depend_on_it(self, patrol):
        scalar = self.detected(patrol, ROUND, probability=None)
        for scaling in ("trace", "information"):
            settings = self.SHAPED.changed({"sensing.scaling": scaling})
            shaped = self.detected(patrol, settings, probability=None)
            assert set(shaped.sample) == set(scalar.sample)

    def test_it_is_not_shaped_twice(self, patrol):
        with pytest.raises(SettingsError, match="have their shape already"):
            self.detected(patrol, self.SHAPED, measurement="range_bearing")

    @pytest.mark.parametrize("spec", ["fid:1", "fixed:0.5,adding=independent", "clean"])
    def test_a_mechanism_declares_it_before_and_after_tracking(self, patrol, spec):
        shaped = self.detected(patrol, self.SHAPED)
        (mechanism,) = parse("mechanisms", spec)
        noisy = perturb_detections(shaped, mechanism=mechanism.instance, seed=0)
        tracked = run_tracker(shaped, settings=TrackerSettings(method="oracle"))
        after = share_tracks(shaped, tracked, seed=0, mechanism=mechanism.instance)
        release = mechanism.instance.share(shaped.sensed, stream(0, "test"))
        expected = np.trace(release.cov, axis1=1, axis2=2) / 2.0
        ours = np.trace(noisy.detections.cov, axis1=1, axis2=2) / 2.0
        least = 1e-6 * np.trace(shaped.detections.cov, axis1=1, axis2=2).max()
        np.testing.assert_allclose(np.sort(ours), np.sort(expected), atol=least)
        assert after.variance.size == after.scan.size
        assert (np.linalg.eigvalsh(noisy.detections.cov) > 0.0).all()
