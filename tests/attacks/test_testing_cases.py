"""What the attack kit makes up to try attacks on, and how it measures."""

import numpy as np
import pytest
from helpers.broken_linkers import BASE

from attacks.testing import _linkage_checks as linkage
from attacks.testing import _reconstruction_checks as reconstruction
from attacks.testing._releases import IRREGULAR_S, RAW_SIGMA_M, STEADY_S, draws, instants
from isac_track.linkability import rank1

HIDDEN, SHOWN = (linkage.noisy(RAW_SIGMA_M, "radial", scene=scene) for scene in (False, True))


@pytest.mark.parametrize("steps_s", [STEADY_S, IRREGULAR_S])
def test_steps_cover_their_range(steps_s):
    step_s = np.diff(instants(draws("test"), 1000, steps_s))
    np.testing.assert_allclose([step_s.min(), step_s.max()], steps_s, rtol=0.05)


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

    def test_other_people_and_repeats_are_what_they_should_be(self):
        case = reconstruction.noisy(0.3, "radial")
        errors = np.stack([one.xy - case.truth for one in (case.release, *case.repeats)])
        assert np.abs(np.corrcoef(errors.reshape(3, -1)) - np.eye(3)).max() < 0.06
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
        lasting_s = [np.ptp(track.t) for track in HIDDEN.probe]
        assert lasting_s == pytest.approx([11.5] * 24, abs=1.0)
        speeds = np.sort(BASE.traits(HIDDEN.probe))
        assert speeds[[0, -1]] == pytest.approx([0.6, 2.0], abs=0.2)
        assert np.diff(speeds).max() < 0.2

    def test_hidden_walks_are_recorded_twice_each_in_a_frame_of_its_own(self):
        for track, mate in zip(HIDDEN.probe, HIDDEN.mate, strict=True):
            other = HIDDEN.gallery[mate]
            # The same walk: turned and shifted upon each other they differ by the noise alone.
            at = np.linspace(track.t[0] + 1.0, track.t[-1], 100)
            one = complexes(track.t, track.xy, at)
            two = complexes(other.t + track.t[-1] - other.t[-1], other.xy, at)
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
        assert sorted(train.mate) == list(range(20))
        assert not np.isin(train.probe.xy, HIDDEN.probe.xy).any()
        scores = BASE.link(train.probe, train.gallery)
        assert rank1(scores=scores, mate=train.mate).sum() > 6

    def test_mates_are_not_where_the_probes_are(self):
        assert sorted(HIDDEN.mate) == list(range(24))
        assert np.count_nonzero(HIDDEN.mate == np.arange(24)) < 5
        assert linkage.sized(9, 7, scene=False).mate.tolist().count(-1) == 2


def complexes(t, xy, at):
    """Positions at other instants about their mean, as complex numbers."""
    found = np.interp(at, t, xy[:, 0]) + 1j * np.interp(at, t, xy[:, 1])
    return found - found.mean()
