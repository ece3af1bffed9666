from __future__ import annotations

import re
from dataclasses import FrozenInstanceError
from math import inf, sqrt

import numpy as np
import pytest
from helpers import oracles
from helpers.sensed import ADDING, LAWS, rng, sensed, truth
from scipy import stats

from isac_track.protocols import Mechanism
from isac_track.sensing import unit_errors
from isac_track.sharing import Clean, Fid, Fixed, Raw, fid_d_sigma, perturb

LARGE = 40_000


def raises(message):
    return pytest.raises(ValueError, match=f"^{re.escape(message)}$")


def norms(vectors):
    return np.hypot(vectors[:, 0], vectors[:, 1])


def test_far_below_the_threshold_nothing_overflows():
    for fid, eta in ((0.0, 1e-3), (-1e9, 1.0)):
        assert fid_d_sigma(fid=np.full(1, fid), eta=eta, alpha_m=0.5, beta=1.5).tolist() == [0.0]


class TestLinearAdding:
    @pytest.mark.parametrize("law", LAWS)
    def test_scales_the_true_error(self, law):
        batch = sensed(law=law)
        d_sigma = np.linspace(0.0, 1.2, 13)
        release = perturb(batch, d_sigma, rng())
        expected = truth(13) + (batch.sigma_raw + d_sigma)[:, None] * batch.unit_error
        np.testing.assert_allclose(release.xy, expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(release.sigma, batch.sigma_raw + d_sigma, rtol=1e-15)

    def test_is_the_default_and_draws_no_error(self):
        batch = sensed()
        one, other = perturb(batch, 0.4, rng("a")), perturb(batch, 0.4, rng("b"), adding="linear")
        np.testing.assert_array_equal(one.xy, other.xy)

    @pytest.mark.parametrize("law", LAWS)
    def test_may_name_the_law_of_the_raw_error_but_no_other(self, law):
        other = LAWS[1 - LAWS.index(law)]
        perturb(sensed(law=law), 0.1, rng(), law=law)
        with raises("linear adding scales the raw error and so keeps its law"):
            perturb(sensed(law=law), 0.1, rng(), law=other)


class TestIndependentAdding:
    @pytest.mark.parametrize("law", LAWS)
    @pytest.mark.parametrize("raw_law", LAWS)
    def test_variances_add(self, raw_law, law):
        batch = sensed(sizes=(LARGE,), sigma_raw=0.6, law=raw_law)
        release = perturb(batch, 0.8, rng("variances", law), adding="independent", law=law)
        error = release.xy - truth(LARGE)
        # Both axes: the radial law has variance sigma^2 in all, the isotropic one on each axis.
        axes = {"radial": 1, "isotropic": 2}
        expected = axes[raw_law] * 0.6**2 + axes[law] * 0.8**2
        square = (error**2).sum(axis=1)
        assert abs(square.mean() - expected) < 5 * square.std() / sqrt(LARGE)
        for axis in range(2):  # half of it each, and none of it in common
            axis_square = error[:, axis] ** 2
            assert abs(axis_square.mean() - expected / 2) < 5 * axis_square.std() / sqrt(LARGE)
        product = error[:, 0] * error[:, 1]
        assert abs(product.mean()) < 5 * product.std() / sqrt(LARGE)

    @pytest.mark.parametrize("law", LAWS)
    def test_takes_the_law_of_the_raw_error_unless_told(self, law):
        other = LAWS[1 - LAWS.index(law)]
        batch = sensed(law=law)
        default = perturb(batch, 0.8, rng(), adding="independent")
        named = perturb(batch, 0.8, rng(), adding="independent", law=law)
        changed = perturb(batch, 0.8, rng(), adding="independent", law=other)
        np.testing.assert_array_equal(default.xy, named.xy)
        assert not np.allclose(default.xy, changed.xy)
        perturb(batch, 0.8, rng(), adding="independent", law="fixed_direction")  # of each track

    def test_levels_share_their_draws(self):
        batch = sensed()
        errors = [
            perturb(batch, level, rng(), adding="independent").xy - batch.xy for level in (0.2, 1.0)
        ]
        np.testing.assert_allclose(5 * errors[0], errors[1], rtol=0, atol=1e-12)


class TestPerturb:
    def test_times_and_offsets_pass_through(self):
        batch = sensed()
        release = perturb(batch, 0.1, rng())
        assert np.shares_memory(release.t, batch.t)
        assert release.offsets.tolist() == [0, 5, 6, 13]

    @pytest.mark.parametrize("wrong", [-0.1, np.nan, inf, np.r_[np.zeros(12), -0.1]])
    def test_d_sigma_is_finite_and_not_negative(self, wrong):
        with raises("d_sigma must be finite and not negative"):
            perturb(sensed(), wrong, rng())

    def test_d_sigma_has_one_value_per_sample(self):
        with pytest.raises(ValueError, match="broadcast"):
            perturb(sensed(), np.zeros(12), rng())

    @pytest.mark.parametrize("kind", [int, np.float32, object])
    def test_numbers_of_any_kind_are_fine(self, kind):
        levels = np.arange(13)
        release = perturb(sensed(), levels.astype(kind), rng())
        np.testing.assert_array_equal(release.xy, perturb(sensed(), levels * 1.0, rng()).xy)

    def test_unknown_names(self):
        with raises("unknown adding rule 'square'; known: linear, independent"):
            perturb(sensed(), 0.1, rng(), adding="square")
        with pytest.raises(ValueError, match="unknown error law 'square'"):
            perturb(sensed(), 0.1, rng(), adding="independent", law="square")

    def test_an_error_that_is_given_is_added_as_it_is(self):
        batch = sensed(sigma_raw=0.3)
        unit = np.tile([0.6, -0.8], (13, 1))
        d_sigma = np.where(np.arange(13) == 4, 0.4, 0.0)
        release = perturb(batch, d_sigma, rng(), adding="independent", unit_error=unit)
        expected = d_sigma[:, None] * unit
        np.testing.assert_allclose(release.xy - batch.xy, expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(release.sigma, np.where(d_sigma, 0.5, 0.3), rtol=1e-15)
        with raises("linear adding scales the raw error and takes no other"):
            perturb(batch, 0.4, rng(), unit_error=batch.unit_error)


class TestPseudonyms:
    def test_are_unique_opaque_and_cover_all_bytes(self):
        names = Raw().share(sensed(sizes=(1,) * 2000), rng()).pseudonym
        assert len(set(names)) == 2000
        assert all(re.fullmatch("[0-9a-f]{16}", name) for name in names)
        assert {name[k : k + 2] for name in names for k in range(0, 16, 2)} == {
            f"{byte:02x}" for byte in range(256)
        }

    def test_differ_between_releases(self):
        batch = sensed()
        one, other = (Raw().share(batch, rng(name)).pseudonym for name in ("first", "second"))
        assert not set(one) & set(other)

    def test_leave_the_stream_of_the_errors_alone(self):
        batch = sensed()
        release = perturb(batch, 1.0, rng(), adding="independent")
        unit = unit_errors(n_samples=13, law="radial", rng=rng())
        np.testing.assert_allclose(release.xy, batch.xy + unit, rtol=0, atol=1e-12)


class TestMechanisms:
    @pytest.mark.parametrize("mechanism", [Raw(), Fixed(0.2), Fid(10.0), Clean()])
    def test_are_frozen_plug_ins(self, mechanism):
        assert isinstance(mechanism, Mechanism)
        assert len(mechanism.share(sensed(), rng())) == 3
        with pytest.raises((FrozenInstanceError, TypeError)):
            mechanism.eta = 3.0

    def test_defaults_are_those_of_the_paper(self):
        fid = Fid(1.0)
        assert (fid.alpha, fid.beta, fid.adding, fid.law) == (0.5, 1.5, "linear", None)
        assert (Fixed(0.1).adding, Fixed(0.1).law) == ("linear", None)
        assert (Fixed.sweep, Fid.sweep) == ("linear", "log")

    def test_raw_shares_the_estimates(self):
        batch = sensed()
        release = Raw().share(batch, rng())
        np.testing.assert_array_equal(release.xy, batch.xy)
        np.testing.assert_array_equal(release.sigma, batch.sigma_raw)

    def test_clean_shares_the_truth(self):
        batch = sensed()
        release = Clean().share(batch, rng())
        np.testing.assert_allclose(release.xy, truth(13), rtol=0, atol=1e-12)
        assert release.sigma.tolist() == [0.0] * 13
        assert np.shares_memory(release.t, batch.t)
        assert release.offsets.tolist() == [0, 5, 6, 13]

    @pytest.mark.parametrize(
        "rule", [{}, *({"adding": "independent", "law": law} for law in [None, *LAWS])], ids=str
    )
    @pytest.mark.parametrize("law", LAWS)
    def test_fid_far_above_its_threshold_is_fixed_075(self, rule, law):
        batch = sensed(law=law)  # fid of at least 72; exp(-71) is below the last digit of 1.5
        fid = Fid(1.0, **rule).share(batch, rng())
        fixed = Fixed(0.75, **rule).share(batch, rng())
        np.testing.assert_array_equal(fid.xy, fixed.xy)
        np.testing.assert_array_equal(fid.sigma, fixed.sigma)
        assert fid.pseudonym == fixed.pseudonym

    @pytest.mark.parametrize("adding", ADDING)
    def test_fid_below_its_threshold_is_raw(self, adding):
        batch = sensed()
        release = Fid(1e9, adding=adding).share(batch, rng())
        np.testing.assert_array_equal(release.xy, Raw().share(batch, rng()).xy)

    def test_fid_uses_its_parameters_sample_by_sample(self):
        batch = sensed()
        mechanism = Fid(700.0, alpha=0.3, beta=2.0)
        d_sigma = [
            oracles.fid_d_sigma(fid=one, eta=700.0, alpha_m=0.3, beta=2.0) for one in batch.fid
        ]
        assert 0 < np.count_nonzero(d_sigma) < len(d_sigma)
        release = mechanism.share(batch, rng())
        np.testing.assert_allclose(release.sigma - batch.sigma_raw, d_sigma, atol=1e-12)

    def test_fixed_passes_its_law_on(self):
        batch = sensed(sizes=(LARGE,), sigma_raw=0.2)
        added = Fixed(0.5, "independent", "isotropic").share(batch, rng("law")).xy - batch.xy
        assert stats.kstest(norms(added), stats.rayleigh(scale=0.5).cdf).pvalue > 1e-3

    @pytest.mark.parametrize(
        ("kind", "values", "message"),
        [
            (Fixed, {"d_sigma": -0.1}, "d_sigma must be 0 m or more, got -0.1"),
            (Fixed, {"d_sigma": inf}, "d_sigma must be 0 m or more, got inf"),
            (Fid, {"eta": 0.0}, "eta must be positive, got 0.0"),
            (Fid, {"eta": inf}, "eta must be positive, got inf"),
            (Fid, {"eta": 1.0, "alpha": -0.5}, "alpha must be 0 m or more, got -0.5"),
            (Fid, {"eta": 1.0, "alpha": inf}, "alpha must be 0 m or more, got inf"),
            (Fid, {"eta": 1.0, "beta": 0.99}, "beta must be 1 or more, got 0.99"),
            (Fid, {"eta": 1.0, "beta": inf}, "beta must be 1 or more, got inf"),
        ],
    )
    def test_parameters_out_of_range(self, kind, values, message):
        with raises(message):
            kind(**values)

    def test_parameters_at_the_edge(self):
        assert Fixed(0.0).d_sigma == 0.0
        assert Fid(0.5, alpha=0.0, beta=1.0).beta == 1.0


class TestErrorLaws:
    """Seeded draws, so a p-value above 0.001 is a fact about them and does not flicker."""

    def test_norm_of_the_radial_law_is_half_normal(self):
        unit = unit_errors(n_samples=LARGE, law="radial", rng=rng("ks"))
        assert stats.kstest(norms(unit), stats.halfnorm.cdf).pvalue > 1e-3

    def test_norm_of_the_isotropic_law_is_rayleigh(self):
        unit = unit_errors(n_samples=LARGE, law="isotropic", rng=rng("ks"))
        assert stats.kstest(norms(unit), stats.rayleigh.cdf).pvalue > 1e-3
        assert stats.kstest(unit[:, 0], stats.norm.cdf).pvalue > 1e-3
        assert stats.kstest(unit[:, 1], stats.norm.cdf).pvalue > 1e-3

    @pytest.mark.parametrize("law", LAWS)
    def test_direction_is_uniform_and_does_not_depend_on_the_norm(self, law):
        unit = unit_errors(n_samples=LARGE, law=law, rng=rng("ks"))
        angle = np.arctan2(unit[:, 1], unit[:, 0])
        assert stats.kstest(angle, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3
        long = norms(unit) > np.median(norms(unit))
        assert stats.ks_2samp(angle[long], angle[~long]).pvalue > 1e-3

    @pytest.mark.parametrize("law", LAWS)
    def test_a_shorter_batch_is_a_prefix_of_a_longer_one(self, law):
        long = unit_errors(n_samples=100, law=law, rng=rng("prefix"))
        short = unit_errors(n_samples=37, law=law, rng=rng("prefix"))
        np.testing.assert_array_equal(short, long[:37])
