"""Covariances on the way from a mechanism to a robot or an adversary."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers.cells import STAGES, World, parsed

from evaluation.compute.frames import Frame, adversary_view
from evaluation.compute.sharing import share
from evaluation.compute.walk_bounds import benchmark
from evaluation.plan.scene_axes import SceneAxes
from isac_track import plugins
from isac_track.measurement import share_within
from isac_track.sharing import perturb
from isac_track.types import Knowledge, Release, Sensed, derived

RNG = np.random.default_rng(11)
COV = np.array([[0.5, 0.3], [0.3, 0.4]])


@dataclass(frozen=True)
class Undeclared:
    """A mechanism that declares a standard deviation and no shape."""

    def share(self, sensed, rng):
        release = perturb(sensed, 0.5, rng, adding="independent")
        return derived(release, cov=None)


@pytest.fixture(scope="module")
def sensed():
    n_samples = 6
    sigma = np.sqrt(np.trace(COV) / 2.0)
    factor = np.linalg.cholesky(COV) / sigma
    unit_error = RNG.standard_normal((n_samples, 2)) @ factor.T
    return Sensed(
        t=np.array([0.0, 0.1, 0.2, 0.0, 0.1, 0.2]),
        xy=sigma * unit_error,
        unit_error=unit_error,
        sigma_raw=np.full(n_samples, sigma),
        information=np.full(n_samples, 4.0),
        fid=np.full(n_samples, 40.0),
        offsets=np.array([0, 3, 6]),
        law="isotropic",
        cov=np.tile(COV, (n_samples, 1, 1)),
    )


def test_what_a_mechanism_adds_is_round_unless_it_says_otherwise(sensed):
    (plugin,) = plugins.parse_all("mechanisms", [Undeclared()])
    release = share(plugin, sensed, "here", seed=0)
    np.testing.assert_allclose(release.cov, sensed.cov + 0.25 * np.eye(2))


def test_a_shape_shows_with_sigma_alone(sensed):
    release = perturb(sensed, 0.5, np.random.default_rng(0))
    for granted in (frozenset(), frozenset({Knowledge.SCENE})):
        seen, _ = adversary_view(release, granted=granted, rng=RNG)
        assert seen.sigma is seen.cov is None
    seen, _ = adversary_view(
        release, granted=frozenset({Knowledge.SIGMA, Knowledge.SCENE}), rng=RNG
    )
    assert seen.cov is release.cov


@pytest.mark.parametrize("per_sample", [False, True])
def test_an_ellipse_turns_with_its_frame(sensed, per_sample):
    release = perturb(sensed, 0.5, np.random.default_rng(0))
    frame = Frame(turn=np.exp(1.1j), shift_m=3.0 - 4.0j, clock_s=7.0)
    if per_sample:
        turns = np.exp(1j * np.array([0.3, 2.0]))
        frame = Frame(turns, np.zeros(2), np.zeros(2)).per_sample(release.offsets)
    seen = frame.release(release)

    def squared_distances(batch: Release):
        gap = np.diff(batch.xy[:3], axis=0)
        return np.einsum("ma,mab,mb->m", gap, np.linalg.inv(batch.cov[:2]), gap)

    np.testing.assert_allclose(squared_distances(seen), squared_distances(release))
    assert not np.allclose(seen.cov, release.cov)


def test_the_benchmark_knows_the_shape(sensed):
    """A line through three samples on either axis: nobody turns within 0.2 s.

    Its mean squared error is two thirds of that of a sample.
    """
    small = replace(sensed, sigma_raw=0.1 * sensed.sigma_raw, cov=0.01 * sensed.cov)
    (plugin,) = plugins.parse_all("mechanisms", ["fixed:0.05,adding=independent"])
    release = plugin.instance.share(small, np.random.default_rng(0))
    expected = benchmark(release, sensed=small, mechanism=plugin, epsilon_m=0.03)
    error = 0.01 * COV + 0.05**2 * np.eye(2)
    np.testing.assert_allclose(
        expected["benchmark_mse_m2"], 2.0 / 3.0 * np.trace(error), rtol=0.01
    )
    # In the middle it is a third of the covariance, at the ends five sixths.
    errors = error * np.array([5 / 6, 1 / 3, 5 / 6])[:, None, None]
    known = share_within(errors, epsilon_m=0.03).mean()
    np.testing.assert_allclose(expected["benchmark_plr"], known, rtol=0.01)


@pytest.mark.parametrize("mechanism", ["raw", "window:3", "fixed:0.3"])
def test_cells_of_a_run_know_the_shape(tracks, mechanism):
    """Who sees the shape is as good as the benchmark, and better than who does not."""
    stages = STAGES.changed(
        {
            "sensing.measurement": "range_bearing",
            "sensing.n_antennas": 4,
            "sensing.law": "isotropic",
        }
    )
    world = World(tracks, n_scenes=4, stages=stages)
    attack = parsed("attacks", "kalman_rts")
    consumers = SceneAxes(attacks=(attack,)).consumers
    by_knowledge = {
        consumer.adversary: rows
        for _, consumer, rows in world.cells((mechanism,), consumers)
        if consumer.kind == "attack"
    }
    blind, oracle = (by_knowledge[name] for name in ("blind", "oracle"))
    assert np.isfinite(oracle["benchmark_plr"]).all()
    assert oracle["mse_m2"].mean() < blind["mse_m2"].mean()
    ratio = np.sqrt(oracle["mse_m2"].mean() / oracle["benchmark_mse_m2"].mean())
    assert 0.8 < ratio < 1.3
