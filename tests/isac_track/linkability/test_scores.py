"""Score metrics against brute force, closed forms and what must not matter."""

from itertools import product

import numpy as np
import pytest
from helpers import linkability_oracles as oracles
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from isac_track.linkability import (
    Calibration,
    auc,
    cllr,
    cllr_min,
    d_sys,
    d_sys_published,
    eer,
    fit_calibration,
    tpr_at_fpr,
)
from isac_track.rng import stream


@pytest.mark.parametrize("decimals", [0, 1, 8])
def test_score_metrics_are_brute_force(decimals):
    rng = stream(decimals, "test", "scores")
    for n_mated, n_non_mated in ((1, 1), (3, 20), (25, 60), (80, 300)):
        mated = np.round(rng.standard_normal(n_mated) + 0.7, decimals)
        non_mated = np.round(rng.standard_normal(n_non_mated), decimals)
        classes = {"mated": mated, "non_mated": non_mated}
        assert auc(**classes) == pytest.approx(oracles.auc(mated, non_mated), abs=1e-12)
        assert eer(**classes) == pytest.approx(oracles.eer(mated, non_mated), abs=1e-12)
        assert cllr_min(**classes) == pytest.approx(
            oracles.cllr_min(mated, non_mated), abs=1e-9
        )
        edges = oracles.histogram_edges(mated, non_mated)
        assert d_sys(**classes) == (
            pytest.approx(oracles.d_sys(mated, non_mated, edges), abs=1e-12),
            edges.size - 1,
        )
        published = oracles.d_sys_published(mated, non_mated, edges)
        assert d_sys_published(**classes) == pytest.approx(published, abs=1e-12)
        direct = cllr(llr_mated=mated, llr_non_mated=non_mated)
        assert direct == pytest.approx(oracles.cllr(mated, non_mated), abs=1e-12)


@pytest.mark.parametrize("alpha", [0.01, 0.05])
@pytest.mark.parametrize("decimals", [0, 1, 8])
def test_tpr_at_fpr_is_brute_force(decimals, alpha):
    rng = stream(decimals, "test", "tpr")
    mated, non_mated = rng.standard_normal(30) + 2, rng.standard_normal(3_000)
    mated, non_mated = np.round(mated, decimals), np.round(non_mated, decimals)
    expected = oracles.tpr(mated, non_mated, alpha)
    actual = tpr_at_fpr(mated=mated, non_mated=non_mated, alpha=alpha)
    assert actual == pytest.approx(expected, abs=1e-12)


def test_tpr_needs_thirty_expected_false_links_and_allows_a_share_at_the_level():
    mated, non_mated = np.ones(3), np.zeros(3_000)
    assert tpr_at_fpr(mated=mated, non_mated=non_mated, alpha=0.01) == (1.0, 0.0)
    refused = tpr_at_fpr(mated=mated, non_mated=non_mated[1:], alpha=0.01)
    assert np.isnan(refused).all()
    # Thirty of 3,000 are at least as high as 2970, 31 as 2969.
    classes = {"mated": np.array([2969.0, 2970.0]), "non_mated": np.arange(3_000.0)}
    assert tpr_at_fpr(**classes, alpha=0.01) == (0.5, pytest.approx(0.01))


def test_the_published_program_loses_half_of_either_outer_bin():
    """Forty mated scores at the top, all others at the bottom: a perfect link."""
    classes = {"mated": np.full(40, 3.0), "non_mated": np.zeros(80)}
    assert d_sys(**classes) == (1.0, 4)
    assert d_sys_published(**classes) == 0.5
    # A single bin has no trapezium.
    few = {"mated": np.full(19, 3.0), "non_mated": np.zeros(80)}
    assert d_sys_published(**few) == 0.0


SCORES = arrays(np.int64, st.integers(1, 12), elements=st.integers(-4, 4))


@given(mated=SCORES, non_mated=SCORES)
@settings(deadline=None, max_examples=60)
def test_rising_maps_leave_auc_eer_and_cllr_min_alone(mated, non_mated):
    def risen(x):
        return np.exp(x / 3) + x**3

    before = {"mated": mated.astype(float), "non_mated": non_mated.astype(float)}
    after = {"mated": risen(mated), "non_mated": risen(non_mated)}
    for metric in (auc, eer, cllr_min):
        assert metric(**after) == pytest.approx(metric(**before), abs=1e-12)
    assert -1e-12 <= cllr_min(**before) <= 1 + 1e-12
    assert 0 <= eer(**before) <= 0.5 + 1e-12
    assert 0 <= d_sys(**before)[0] <= 1
    swapped = auc(mated=before["non_mated"], non_mated=before["mated"])
    assert swapped == pytest.approx(1 - auc(**before))


def test_calibration_minimises_the_cost_that_it_should():
    rng = stream(5, "test", "calibration")
    mated, non_mated = rng.standard_normal(50) * 1.5 + 11, rng.standard_normal(300) + 10
    fitted = fit_calibration(mated=mated, non_mated=non_mated)

    def cost(slope, intercept):
        llrs = {"llr_mated": mated, "llr_non_mated": non_mated}
        return cllr(**{name: slope * x + intercept for name, x in llrs.items()})

    least = cost(fitted.slope, fitted.intercept)
    for slope, intercept in product((-1e-2, 0, 1e-2), repeat=2):
        assert cost(fitted.slope + slope, fitted.intercept + intercept) >= least
    # Each class weighs 1, however many there are of it.
    threefold = fit_calibration(mated=mated, non_mated=np.tile(non_mated, 3))
    assert threefold.slope == pytest.approx(fitted.slope, rel=1e-5)
    shifted = fit_calibration(mated=1e3 * mated, non_mated=1e3 * non_mated)
    assert shifted.slope == pytest.approx(fitted.slope / 1e3, rel=1e-5)
    assert shifted.intercept == pytest.approx(fitted.intercept, rel=1e-4)


def test_calibration_of_scores_that_say_nothing_or_everything():
    zero = Calibration(0.0, 0.0)
    low, high = np.arange(5.0), np.arange(10.0, 15.0)
    assert fit_calibration(mated=low, non_mated=high) == zero
    assert fit_calibration(mated=np.ones(3), non_mated=np.ones(9)) == zero
    separated = fit_calibration(mated=high, non_mated=low)
    assert 1 < separated.slope < 100
    assert separated.slope * 4 + separated.intercept < -3
    assert separated.slope * 10 + separated.intercept > 3


@pytest.mark.parametrize(
    "function", [auc, eer, cllr_min, d_sys, d_sys_published, fit_calibration]
)
def test_metrics_refuse_an_empty_class_and_infinity(function):
    for mated, non_mated in (([], [1.0]), ([1.0], []), ([[1.0]], [1.0])):
        with pytest.raises(ValueError, match="must have shape"):
            function(mated=np.array(mated), non_mated=np.array(non_mated))
    with pytest.raises(ValueError, match="finite"):
        function(mated=np.array([np.inf]), non_mated=np.ones(1))
    with pytest.raises(ValueError, match="alpha"):
        tpr_at_fpr(mated=np.ones(3), non_mated=np.ones(3), alpha=0)
