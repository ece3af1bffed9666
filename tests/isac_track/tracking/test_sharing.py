"""Noise before and after tracking."""

import numpy as np
import pytest
from helpers.detections import make_detected, walking

from isac_track.errors import SettingsError
from isac_track.mechanisms.protections import Ou
from isac_track.mechanisms.withholding import Window
from isac_track.sharing import Clean, Fid, Fixed, Raw
from isac_track.tracking import TrackerSettings, run_tracker
from isac_track.tracking.sharing import perturb_detections, share_tracks

PEOPLE = walking(((0, 0), (1, 0), 0, 60), ((0, 8), (1, 0), 0, 60), n_scans=60)


@pytest.fixture(scope="module")
def detected():
    return make_detected(PEOPLE, std_m=0.2)


@pytest.fixture(scope="module")
def tracked(detected):
    return run_tracker(detected, settings=TrackerSettings())


def test_without_noise_a_release_has_the_detections_of_each_track(detected, tracked):
    shared = share_tracks(detected, tracked, seed=0)
    assert np.diff(shared.release.offsets).tolist() == [60, 60]
    np.testing.assert_array_equal(
        shared.release.xy, detected.detections.xy[tracked.detection]
    )
    np.testing.assert_allclose(shared.variance, 0.04)
    raw = share_tracks(detected, tracked, seed=0, mechanism=Raw())
    np.testing.assert_allclose(shared.release.sigma, raw.release.sigma)
    assert len(set(shared.release.pseudonym)) == 2
    assert shared.person.tolist() == [0] * 60 + [1] * 60
    assert (shared.confirmed.tolist(), shared.last.tolist()) == ([2, 2], [59, 59])


@pytest.mark.parametrize(
    ("mechanism", "added_m2"),
    [
        (Raw(), 0.0),
        (Fixed(0.5, adding="independent"), 0.25),
        (Fixed(0.5, adding="independent", law="radial"), 0.125),
        (Ou(0.5), 0.25),
        # The threshold is so low that every sample gets alpha * beta.
        (Fid(1e-9, alpha=0.4, beta=1.25, adding="independent"), 0.25),
    ],
)
def test_noise_declares_its_variance_before_and_after(
    detected, tracked, mechanism, added_m2
):
    noisy = perturb_detections(detected, mechanism=mechanism, seed=0)
    np.testing.assert_allclose(
        noisy.detections.cov, np.tile((0.04 + added_m2) * np.eye(2), (120, 1, 1))
    )
    after = share_tracks(detected, tracked, mechanism=mechanism, seed=0)
    np.testing.assert_allclose(after.variance, 0.04 + added_m2)
    assert after.release.sigma is not None


@pytest.mark.parametrize(
    "mechanism", [Ou(0.5, tau_s=0.01), Fixed(0.5, adding="independent")]
)
def test_noise_has_its_size_before_and_after(detected, tracked, mechanism):
    truth, squares = detected.sensed.xy, {"before": [], "after": []}
    for seed in range(8):
        noisy = perturb_detections(detected, mechanism=mechanism, seed=seed)
        squares["before"].append((noisy.detections.xy - noisy.sensed.xy) ** 2)
        after = share_tracks(detected, tracked, mechanism=mechanism, seed=seed)
        squares["after"].append((after.release.xy - truth[tracked.detection]) ** 2)
    for parts in squares.values():
        # 1920 independent squares with a relative deviation of sqrt(2) each.
        mean = np.concatenate(parts).mean()
        assert abs(mean / 0.25 - 1.0) < 4.0 * np.sqrt(2.0 / 1920.0)


def test_a_slow_error_is_slow_only_along_a_track(detected, tracked):
    after, before = [], []
    for seed in range(10):
        shared = share_tracks(detected, tracked, mechanism=Ou(0.5), seed=seed)
        after.append(shared.release.xy - detected.sensed.xy[tracked.detection])
        noisy = perturb_detections(detected, mechanism=Ou(0.5), seed=seed)
        order = np.lexsort((noisy.detections.scan, noisy.person))
        before.append((noisy.detections.xy - noisy.sensed.xy)[order])

    def correlation(errors):
        """Of errors a scan apart, within both people."""
        steps = np.concatenate([part.reshape(2, 60, 2) for part in errors])
        return (steps[:, 1:] * steps[:, :-1]).sum() / (steps**2).sum()

    assert correlation(after) > 0.9
    assert abs(correlation(before)) < 0.1


def test_linear_noise_scales_the_error(detected):
    noisy = perturb_detections(detected, mechanism=Fixed(0.2), seed=0)
    np.testing.assert_allclose(noisy.detections.cov[:, 0, 0], 0.16)
    # These detections have no error, and none is made of it.
    np.testing.assert_array_equal(noisy.detections.xy, noisy.sensed.xy)


def test_noisy_detections_are_in_the_order_of_their_new_places(detected):
    mechanism = Fixed(3.0, adding="independent")
    noisy = perturb_detections(detected, mechanism=mechanism, seed=0)
    same_scan = np.diff(noisy.detections.scan) == 0
    assert (np.diff(noisy.detections.xy[:, 0])[same_scan] >= 0.0).all()
    by_person = [np.flatnonzero(noisy.person == person) for person in (0, 1)]
    assert [row.size for row in by_person] == [60, 60]
    gap = noisy.sensed.xy[by_person[0], 1]
    np.testing.assert_array_equal(gap, 0.0)  # Person 0 still walks along y = 0.


def test_clean_is_the_truth(detected):
    noisy = perturb_detections(detected, mechanism=Clean(), seed=0)
    assert 0.0 < np.abs(noisy.detections.cov).max() < 1e-6


def test_a_mechanism_that_drops_samples_is_refused(detected, tracked):
    with pytest.raises(SettingsError, match="Window does not share every sample"):
        share_tracks(detected, tracked, mechanism=Window(0.5), seed=0)
