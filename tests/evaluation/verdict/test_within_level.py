"""A track's own descriptor: its correlation with linkage within levels."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.special import ndtri

from evaluation.estimates.sweeps import Sweeps
from evaluation.verdict.bands import interval_around
from evaluation.verdict.within_level import (
    LinkedTracks,
    clustered_mean,
    draft_within,
    partial_correlation,
)


def draw(rng, n=400, *, own=0.0, noise=0.0):
    covariate = rng.normal(size=(n, 2))
    descriptor = noise * covariate[:, :1] + rng.normal(size=(n, 1)) + np.zeros((n, 2))
    logit = own * descriptor[:, 0] + noise * covariate[:, 0]
    hit = (rng.random(n) < 1 / (1 + np.exp(-logit))).astype(float)
    return LinkedTracks(descriptor, hit, covariate, np.arange(n) // 2)


def test_what_the_covariates_explain_is_not_counted():
    rng = np.random.default_rng(2)
    tracks = draw(rng, 4000, noise=1.5)
    assert np.corrcoef(tracks.descriptor[:, 0], tracks.hit)[0, 1] > 0.3
    result = partial_correlation([tracks])
    assert result.ci_low < 0 < result.ci_high
    assert result.value == pytest.approx(0, abs=0.04)


def test_equals_the_residual_correlation_of_a_plain_regression():
    rng = np.random.default_rng(3)
    tracks = draw(rng, own=1.0)

    def ranks(values):
        order = np.array(
            [(values < value).mean() + (values == value).mean() / 2 for value in values]
        )
        return (order - 0.5) * 2

    x = np.column_stack([ranks(column) for column in tracks.covariates.T])
    design = np.column_stack([np.ones(len(x)), x, x**2])
    both = [ranks(tracks.descriptor[:, 0]), ranks(tracks.hit)]
    rest = [y - design @ np.linalg.pinv(design) @ y for y in both]
    expected = np.corrcoef(*rest)[0, 1]
    result = partial_correlation([tracks])
    assert result.value == pytest.approx(expected, abs=1e-6)


def test_a_person_at_every_level_counts_once():
    result = draw(np.random.default_rng(4), own=0.7)
    single, many = partial_correlation([result]), partial_correlation([result] * 10)
    assert many.value == pytest.approx(single.value)
    assert many.standard_error == pytest.approx(single.standard_error)


def test_its_interval_covers_zero_as_often_as_it_says():
    rng = np.random.default_rng(5)
    result = [partial_correlation([draw(rng, 200, noise=0.5)]) for _ in range(400)]
    covered = np.mean([item.ci_low <= 0 <= item.ci_high for item in result])
    assert 0.92 <= covered <= 0.98


def test_its_interval_is_that_of_the_item():
    """Unequal clusters: t has the degrees of freedom of the effective clusters."""
    tracks = draw(np.random.default_rng(4), own=1.0)
    cluster = np.minimum(np.arange(400) // 2, 60)
    result = partial_correlation([replace(tracks, cluster=cluster)])
    assert result.n_effective < 5 < result.n
    normal = float(ndtri(0.975))
    expected = interval_around(result, result.standard_error, normal)
    assert (result.ci_low, result.ci_high) == pytest.approx(expected)


def test_nothing_varies_nothing_is_known():
    rng = np.random.default_rng(6)
    tracks = draw(rng)
    constant = replace(tracks, descriptor=tracks.descriptor * 0)
    names = [field.name for field in fields(tracks)]
    few = LinkedTracks(*(getattr(tracks, name)[:3] for name in names))
    for item in (constant, few):
        assert np.isnan(partial_correlation([item]).value)


def test_a_clustered_mean_is_a_plain_one_where_everybody_is_alone():
    values = np.random.default_rng(7).normal(size=50)
    result = clustered_mean(values, np.arange(50))
    assert result.standard_error == pytest.approx(values.std(ddof=1) / np.sqrt(50))


def test_a_task_whose_windows_failed_has_no_item():
    assert not [
        *draft_within({"split": []}, Sweeps({}, {}), success={"split": None}, seed=0)
    ]
