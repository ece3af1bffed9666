from __future__ import annotations

import re
from dataclasses import FrozenInstanceError, replace
from math import inf, sqrt

import numpy as np
import pytest
from helpers import oracles
from helpers.sensed import ADDING, LAWS, rng, sensed, truth
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

from isac_track.mechanisms.protections import OuFid
from isac_track.protocols import Mechanism
from isac_track.sensing import unit_errors
from isac_track.sharing import Clean, Fid, Fixed, Raw, fid_d_sigma, perturb

LARGE = 40_000
INDEPENDENT = {"adding": "independent"}


def raises(message):
    return pytest.raises(ValueError, match=f"^{re.escape(message)}$")


def test_far_below_the_threshold_nothing_overflows():
    for fid, eta in ((0.0, 1e-3), (-1e9, 1.0)):
        assert fid_d_sigma(
            fid=np.full(1, fid), eta=eta, alpha_m=0.5, beta=1.5
        ).tolist() == [0.0]


def test_an_unknown_density_is_refused_and_not_shared_without_noise():
    batch = sensed()
    fid = batch.fid.copy()
    fid[3] = np.nan
    added = fid_d_sigma(fid=fid, eta=10.0, alpha_m=0.5, beta=1.5)
    assert np.flatnonzero(np.isnan(added)).tolist() == [3]
    for mechanism in (Fid(10.0), OuFid(10.0)):
        with raises("d_sigma must be finite and not negative"):
            mechanism.share(replace(batch, fid=fid), rng("nan"))


@pytest.mark.parametrize("law", LAWS)
def test_linear_adding_scales_the_true_error_and_draws_none(law):
    batch = sensed(law=law)
    d_sigma = np.linspace(0.0, 1.2, 13)
    release = perturb(batch, d_sigma, rng("a"), law=law)
    expected = truth(13) + (batch.sigma_raw + d_sigma)[:, None] * batch.unit_error
    assert_allclose(release.xy, expected, rtol=0, atol=1e-12)
    assert_allclose(release.sigma, batch.sigma_raw + d_sigma, rtol=1e-15)
    assert_array_equal(
        release.xy, perturb(batch, d_sigma, rng("b"), adding="linear").xy
    )
    with raises("linear adding scales the raw error and so keeps its law"):
        perturb(batch, 0.1, rng(), law=LAWS[1 - LAWS.index(law)])
    with raises("linear adding scales the raw error and takes no other"):
        perturb(batch, 0.4, rng(), unit_error=batch.unit_error)


@pytest.mark.parametrize("law", LAWS)
class TestIndependentAdding:
    @pytest.mark.parametrize("raw_law", LAWS)
    def test_variances_add(self, raw_law, law):
        batch = sensed(sizes=(LARGE,), sigma_raw=0.6, law=raw_law)
        release = perturb(batch, 0.8, rng("variances", law), **INDEPENDENT, law=law)
        error = release.xy - truth(LARGE)
        # Over both axes: the radial law has the variance sigma^2, the isotropic one
        # twice as much.
        axes = {"radial": 1, "isotropic": 2}
        expected = axes[raw_law] * 0.6**2 + axes[law] * 0.8**2
        square = (error**2).sum(axis=1)
        assert abs(square.mean() - expected) < 5 * square.std() / sqrt(LARGE)
        for axis in range(2):  # each has half of it, uncorrelated
            axis_square = error[:, axis] ** 2
            assert abs(
                axis_square.mean() - expected / 2
            ) < 5 * axis_square.std() / sqrt(LARGE)
        product = error[:, 0] * error[:, 1]
        assert abs(product.mean()) < 5 * product.std() / sqrt(LARGE)

    def test_takes_the_law_of_the_raw_error_by_default(self, law):
        batch = sensed(law=law)
        default = perturb(batch, 0.8, rng(), **INDEPENDENT)
        named = perturb(batch, 0.8, rng(), **INDEPENDENT, law=law)
        changed = perturb(
            batch, 0.8, rng(), **INDEPENDENT, law=LAWS[1 - LAWS.index(law)]
        )
        assert_array_equal(default.xy, named.xy)
        assert not np.allclose(default.xy, changed.xy)
        # One direction for each track.
        perturb(batch, 0.8, rng(), **INDEPENDENT, law="fixed_direction")

    def test_levels_share_their_draws_and_pseudonyms_take_none(self, law):
        batch = sensed(law=law)
        unit = unit_errors(n_samples=13, law=law, rng=rng())
        for level in (0.2, 1.0):
            release = perturb(batch, level, rng(), **INDEPENDENT)
            assert_allclose(release.xy, batch.xy + level * unit, rtol=0, atol=1e-12)

    @pytest.mark.parametrize("bits", [np.random.PCG64, np.random.MT19937])
    def test_a_second_release_draws_on_from_where_the_first_ended(self, law, bits):
        batch, plain = sensed(law=law), np.random.Generator(bits(3))
        for _ in range(2):  # the second time from memory
            drawn = np.random.Generator(bits(3))
            for level in (0.2, 1.0):
                unit = unit_errors(n_samples=13, law=law, rng=plain)
                release = perturb(batch, level, drawn, **INDEPENDENT)
                assert_allclose(release.xy, batch.xy + level * unit, rtol=0, atol=1e-12)
            assert drawn.random() == plain.random()
            plain = np.random.Generator(bits(3))


def test_an_error_that_is_given_is_added_as_it_is():
    batch = sensed(sigma_raw=0.3)
    unit = np.tile([0.6, -0.8], (13, 1))
    d_sigma = np.where(np.arange(13) == 4, 0.4, 0.0)
    release = perturb(batch, d_sigma, rng(), **INDEPENDENT, unit_error=unit)
    assert_allclose(release.xy - batch.xy, d_sigma[:, None] * unit, rtol=0, atol=1e-12)
    assert_allclose(release.sigma, np.where(d_sigma, 0.5, 0.3), rtol=1e-15)


@pytest.mark.parametrize(
    ("d_sigma", "names", "message"),
    [
        *(
            (d_sigma, {}, "d_sigma must be finite and not negative")
            for d_sigma in (-0.1, np.nan, inf)
        ),
        (np.r_[np.zeros(12), -0.1], {}, "d_sigma must be finite and not negative"),
        (np.zeros(12), {}, ".*broadcast"),
        (
            0.1,
            {"adding": "square"},
            "unknown adding rule 'square'; known: linear, independent",
        ),
        (0.1, INDEPENDENT | {"law": "square"}, "unknown error law 'square'"),
    ],
)
def test_what_perturb_refuses(d_sigma, names, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        perturb(sensed(), d_sigma, rng(), **names)


def test_pseudonyms_are_opaque_cover_all_bytes_and_differ_between_releases():
    batch = sensed(sizes=(1,) * 2000)
    names, others = (
        Raw().share(batch, rng(name)).pseudonym for name in ("first", "second")
    )
    assert len({*names, *others}) == 4000
    assert all(re.fullmatch("[0-9a-f]{16}", name) for name in names)
    assert {name[k : k + 2] for name in names for k in range(0, 16, 2)} == {
        f"{byte:02x}" for byte in range(256)
    }


class TestMechanisms:
    # With parameters at the edge of their range.
    @pytest.mark.parametrize(
        "mechanism", [Raw(), Fixed(0.0), Fid(0.5, 0.0, beta=1.0), Clean()]
    )
    def test_are_frozen_plug_ins_that_leave_times_and_tracks(self, mechanism):
        assert isinstance(mechanism, Mechanism)
        batch = sensed()
        release = mechanism.share(batch, rng())
        assert np.shares_memory(release.t, batch.t)
        assert release.offsets.tolist() == [0, 5, 6, 13]
        with pytest.raises((FrozenInstanceError, TypeError)):
            mechanism.eta = 3.0

    def test_raw_shares_the_estimates_and_clean_the_truth(self):
        batch = sensed()
        raw, clean = Raw().share(batch, rng()), Clean().share(batch, rng())
        assert_array_equal(raw.xy, batch.xy)
        assert_array_equal(raw.sigma, batch.sigma_raw)
        assert_allclose(clean.xy, truth(13), rtol=0, atol=1e-12)
        assert clean.sigma.tolist() == [0.0] * 13

    @pytest.mark.parametrize(
        "rule", [{}, *(INDEPENDENT | {"law": law} for law in [None, *LAWS])], ids=str
    )
    @pytest.mark.parametrize("law", LAWS)
    def test_fid_far_above_its_threshold_is_fixed_075(self, rule, law):
        # The fid is at least 72; exp(-71) is below the last digit of 1.5.
        batch = sensed(law=law)
        fid = Fid(1.0, **rule).share(batch, rng())
        fixed = Fixed(0.75, **rule).share(batch, rng())
        assert_array_equal(fid.xy, fixed.xy)
        assert_array_equal(fid.sigma, fixed.sigma)
        assert fid.pseudonym == fixed.pseudonym

    @pytest.mark.parametrize("adding", ADDING)
    def test_fid_below_its_threshold_is_raw(self, adding):
        batch = sensed()
        assert_array_equal(Fid(1e9, adding=adding).share(batch, rng()).xy, batch.xy)

    def test_fid_uses_its_parameters_sample_by_sample(self):
        batch = sensed()
        d_sigma = [
            oracles.fid_d_sigma(fid=fid, eta=700.0, alpha_m=0.3, beta=2.0)
            for fid in batch.fid
        ]
        assert 0 < np.count_nonzero(d_sigma) < len(d_sigma)
        release = Fid(700.0, alpha=0.3, beta=2.0).share(batch, rng())
        assert_allclose(release.sigma - batch.sigma_raw, d_sigma, atol=1e-12)

    def test_fixed_passes_its_law_on(self):
        batch = sensed(sizes=(LARGE,), sigma_raw=0.2)
        added = (
            Fixed(0.5, "independent", "isotropic").share(batch, rng("law")).xy
            - batch.xy
        )
        assert (
            stats.kstest(np.hypot(*added.T), stats.rayleigh(scale=0.5).cdf).pvalue
            > 1e-3
        )

    @pytest.mark.parametrize(
        ("kind", "values", "message"),
        [
            (Fixed, {"d_sigma": -0.1}, "d_sigma must be 0 m or more, got -0.1"),
            (Fixed, {"d_sigma": inf}, "d_sigma must be 0 m or more, got inf"),
            (Fid, {"eta": 0.0}, "eta must be positive, got 0.0"),
            (Fid, {"eta": inf}, "eta must be positive, got inf"),
            (Fid, {"eta": 1.0, "alpha": -0.5}, "alpha must be 0 m or more, got -0.5"),
            (Fid, {"eta": 1.0, "beta": 0.99}, "beta must be 1 or more, got 0.99"),
        ],
    )
    def test_parameters_out_of_range(self, kind, values, message):
        with raises(message):
            kind(**values)


@pytest.mark.parametrize(
    ("law", "norm"), [("radial", stats.halfnorm), ("isotropic", stats.rayleigh)]
)
class TestErrorLaws:
    """Draws are seeded, so that p-values do not change from run to run."""

    def test_norm_and_direction_have_their_laws_and_do_not_depend_on_each_other(
        self, law, norm
    ):
        unit = unit_errors(n_samples=LARGE, law=law, rng=rng("ks"))
        length, angle = np.hypot(*unit.T), np.arctan2(unit[:, 1], unit[:, 0])
        assert stats.kstest(length, norm.cdf).pvalue > 1e-3
        assert stats.kstest(angle, stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-3
        long = length > np.median(length)
        assert stats.ks_2samp(angle[long], angle[~long]).pvalue > 1e-3
        assert_array_equal(unit_errors(n_samples=37, law=law, rng=rng("ks")), unit[:37])
