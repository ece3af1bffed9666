"""What the attack kit makes up to try attacks on, and how it measures."""

import numpy as np
import pytest
from helpers.broken_linkers import BASE

from attacks.testing import _linkage_checks as linkage
from attacks.testing import _reconstruction_checks as reconstruction
from attacks.testing._linkage_checks import hits, log_ranks
from attacks.testing._releases import RAW_SIGMA_M

HIDDEN = linkage.noisy(RAW_SIGMA_M, "radial", scene=False)
SHOWN = linkage.noisy(RAW_SIGMA_M, "radial", scene=True)


@pytest.mark.parametrize(
    "release",
    [reconstruction.irregular().release, linkage.irregular(scene=False).gallery],
)
def test_irregular_steps_cover_the_range(release):
    step_s = np.concatenate([np.diff(track.t) for track in release])
    assert step_s.min() < 0.01
    assert 10.0 < step_s.max() <= 30.0 + 1e-9


@pytest.mark.parametrize("release", [reconstruction.noisy(0.05, "radial").release, HIDDEN.probe])
def test_other_steps_are_those_of_a_recording(release):
    rate_hz = 1 / np.concatenate([np.diff(track.t) for track in release])
    assert rate_hz.min() == pytest.approx(8.05, abs=0.0501)
    assert rate_hz.max() == pytest.approx(15.95, abs=0.0501)


class TestReconstruction:
    @pytest.mark.parametrize(("sigma_m", "law", "n"), [(0.3, "radial", 1), (1.0, "isotropic", 2)])
    def test_noise_is_as_announced(self, sigma_m, law, n):
        case = reconstruction.noisy(sigma_m, law)
        gap = case.release.xy - case.truth
        assert np.sqrt((gap**2).sum(axis=1).mean() / n) == pytest.approx(sigma_m, rel=0.05)
        np.testing.assert_allclose(case.release.sigma, sigma_m)
        assert case.mechanism.d_sigma == pytest.approx(sigma_m - RAW_SIGMA_M)

    def test_levels_differ_in_the_size_of_the_errors_alone(self):
        low, high = (reconstruction.noisy(sigma_m, "isotropic") for sigma_m in (0.3, 3.0))
        np.testing.assert_array_equal(low.truth, high.truth)
        errors = [case.release.xy - case.truth for case in (low, high)]
        np.testing.assert_allclose(10.0 * errors[0], errors[1], atol=1e-9)

    def test_walks_are_those_of_people(self):
        case = reconstruction.noisy(0.05, "radial")
        sizes = np.diff(case.release.offsets)
        assert (sizes.min(), sizes.max(), len(sizes)) == (60, 198, 24)
        within = np.diff(np.repeat(np.arange(24), sizes)) == 0
        way_m = np.hypot(*np.diff(case.truth, axis=0)[within].T)
        assert 0.8 < np.mean(way_m / np.diff(case.release.t)[within]) < 1.4

    def test_acceleration_is_as_announced(self):
        # Velocity gains q dt of variance per axis: look at long steps, where it dominates.
        case = reconstruction.made_up("test", about="", sizes=(4000,), sampling="irregular")
        step_s = np.diff(case.release.t)
        velocity = np.diff(case.truth, axis=0) / step_s[:, None]
        # Mean velocities of two neighbouring steps differ by q (dt1 + dt2) / 3 of variance.
        scaled = np.diff(velocity, axis=0) ** 2 / ((step_s[1:] + step_s[:-1]) / 3)[:, None]
        assert scaled.mean() == pytest.approx(reconstruction.ACCELERATION, rel=0.05)

    def test_other_people_and_repeats_are_what_they_should_be(self):
        case = reconstruction.noisy(0.3, "radial")
        assert len(case.repeats) == 2
        errors = [one.xy - case.truth for one in (case.release, *case.repeats)]
        for one, other in ((0, 1), (0, 2), (1, 2)):
            product = (errors[one] * errors[other]).sum(axis=1)
            assert abs(product.mean()) < 5 * product.std() / np.sqrt(product.size)
            assert np.any(errors[one] != errors[other])
        assert not np.isin(case.train.truth, case.truth).any()


class TestLinkage:
    @pytest.mark.parametrize("sigma_m", [0.3, 10.0])
    @pytest.mark.parametrize("scene", [False, True])
    def test_noise_is_as_announced(self, scene, sigma_m):
        sizes_m = sigma_m, 2 * sigma_m
        less, more = (linkage.noisy(one, "isotropic", scene=scene) for one in sizes_m)
        for gap in (more.probe.xy - less.probe.xy, more.gallery.xy - less.gallery.xy):
            assert np.sqrt(np.mean(gap**2)) == pytest.approx(sigma_m, rel=0.05)
        np.testing.assert_allclose(less.train.gallery.sigma, sigma_m)
        assert less.mechanism.d_sigma == pytest.approx(sigma_m - 0.05)

    def test_walks_are_those_of_people(self):
        lasting_s = [track.t[-1] - track.t[0] for track in HIDDEN.probe]
        assert lasting_s == pytest.approx([12.0] * 24, abs=1.0)
        speeds = np.sort(BASE.traits(HIDDEN.probe))
        assert speeds[0] == pytest.approx(0.6, abs=0.1)
        assert speeds[-1] == pytest.approx(2.0, abs=0.2)
        assert np.diff(speeds).max() < 0.2

    def test_hidden_walks_are_recorded_twice_each_in_a_frame_of_its_own(self):
        for track, mate in zip(HIDDEN.probe, HIDDEN.mate, strict=True):
            other = HIDDEN.gallery[mate]
            # The same walk: turned and shifted upon each other they differ by the noise alone.
            at = track.t[-1] - other.t[-1]
            shared_t = np.linspace(track.t[0] + 1.0, track.t[-1], 100)
            one = complexes(track.t, track.xy, shared_t)
            two = complexes(other.t + at, other.xy, shared_t)
            turn = np.vdot(two, one) / abs(np.vdot(two, one))
            assert np.sqrt(np.mean(abs(one - turn * two) ** 2)) < 0.1
            assert abs(turn - 1) > 1e-3
            assert np.hypot(*(track.xy[-1] - other.xy[-1])) > 0.1

    def test_a_shown_walk_goes_on_after_the_gap(self):
        assert np.ptp([track.t[-1] for track in SHOWN.probe]) < 1e-6
        for track, mate in zip(SHOWN.probe, SHOWN.mate, strict=True):
            other = SHOWN.gallery[mate]
            silence_s = other.t[0] - track.t[-1]
            assert 1.0 < silence_s <= 1.125 + 1e-9
            assert np.hypot(*(other.xy[0] - track.xy[-1])) / silence_s < 3.0

    def test_the_training_set_is_other_people_made_alike(self):
        train = HIDDEN.train
        assert len(train.gallery) == 20
        assert sorted(train.mate) == list(range(20))
        assert not np.isin(train.probe.xy, HIDDEN.probe.xy).any()
        assert hits(BASE.link(train.probe, train.gallery), train.mate) > 6

    def test_mates_are_not_where_the_probes_are(self):
        assert sorted(HIDDEN.mate) == list(range(24))
        assert np.count_nonzero(HIDDEN.mate == np.arange(24)) < 5
        assert linkage.sized(9, 7, scene=False).mate.tolist().count(-1) == 2


def complexes(t, xy, at):
    """Positions at other instants about their mean, as complex numbers."""
    found = np.interp(at, t, xy[:, 0]) + 1j * np.interp(at, t, xy[:, 1])
    return found - found.mean()


class TestMeasures:
    SCORES = np.array([[3.0, 2.0, 1.0], [1.0, 1.0, 1.0], [0.0, 5.0, 5.0]])

    def test_hits_are_shared_among_equals(self):
        assert hits(self.SCORES, np.array([0, 2, 1])) == pytest.approx(1 + 1 / 3 + 1 / 2)
        assert hits(self.SCORES, np.array([1, 0, 0])) == pytest.approx(1 / 3)

    def test_a_mate_is_in_the_middle_of_its_equals(self):
        ranks = np.exp(log_ranks(self.SCORES, np.array([2, 0, 2])))
        np.testing.assert_allclose(ranks, [3.0, 2.0, 1.5])
