"""Association against enumeration of every possibility, and a likelihood by scipy."""

import numpy as np
import pytest
from helpers.detections import associations, exact_marginals, product_of_ratios
from scipy.stats import multivariate_normal

from isac_track.errors import SettingsError
from isac_track.rng import stream
from isac_track.tracking import Likelihood
from isac_track.tracking.association import (
    UNASSIGNED,
    likelihood_ratios,
    marginal_probabilities,
    nearest_assignment,
    unused_detections,
)
from isac_track.tracking.filters import first_states


def draw_ratios(number, *, n_tracks, n_detections, share=0.6):
    """Ratios of very different size; some pairs lie beyond the gate."""
    rng = stream(3, "ratios", number)
    ratios = np.exp(rng.normal(0.5, 1.5, (n_tracks, n_detections)))
    return np.where(rng.random(ratios.shape) < share, ratios, 0.0)


class TestRatios:
    def test_a_pair_has_the_density_of_its_innovation(self):
        rng = stream(0, "pair")
        root, other = rng.normal(size=(2, 2, 2))
        pp, cov = root @ root.T + np.eye(2), other @ other.T + np.eye(2)
        place, point = np.array([1.0, 2.0]), np.array([1.5, 1.2])
        states = first_states(xy=place[None], cov=pp[None], speed_std_mps=1.0)
        likelihood = Likelihood(detection_probability=0.8, density_per_m2=0.05)
        ratio = likelihood_ratios(
            states, xy=point[None], cov=cov[None], likelihood=likelihood
        )
        density = multivariate_normal(place, pp + cov).pdf(point)
        assert ratio == pytest.approx(0.8 * density / (0.05 * 0.2))

    def test_the_gate_is_a_squared_distance_in_standard_deviations(self):
        states = first_states(
            xy=np.zeros((1, 2)), cov=0.5 * np.eye(2)[None], speed_std_mps=1.0
        )
        xy, cov = (
            np.array([[2.9, 0.0], [3.1, 0.0]]),
            np.tile(0.5 * np.eye(2), (2, 1, 1)),
        )
        likelihood = Likelihood(gate=9.0)
        ratio = likelihood_ratios(states, xy=xy, cov=cov, likelihood=likelihood)
        assert (ratio > 0).tolist() == [[True, False]]

    @pytest.mark.parametrize(
        "wrong",
        [
            {"detection_probability": 1.0},
            {"density_per_m2": 0.0},
            {"gate": float("inf")},
        ],
    )
    def test_refuses_what_has_no_ratio(self, wrong):
        with pytest.raises(SettingsError, match=next(iter(wrong)).split("_")[0]):
            Likelihood(**wrong)


class TestNearest:
    @pytest.mark.parametrize("number", range(12))
    def test_is_the_most_probable_of_all_associations(self, number):
        ratios = draw_ratios(number, n_tracks=4, n_detections=3)
        best = max(
            associations(*ratios.shape), key=lambda way: product_of_ratios(ratios, way)
        )
        answer = nearest_assignment(ratios)
        assert product_of_ratios(ratios, answer) == pytest.approx(
            product_of_ratios(ratios, best)
        )

    def test_is_global_where_each_on_its_own_would_take_the_same(self):
        ratios = np.array([[10.0, 9.0], [8.0, 0.0]])
        assert nearest_assignment(ratios).tolist() == [1, 0]

    def test_leaves_an_unlikely_pair_alone(self):
        assert nearest_assignment(np.array([[0.5]])).tolist() == [UNASSIGNED]

    @pytest.mark.parametrize("shape", [(0, 3), (3, 0), (0, 0)])
    def test_nothing_to_assign(self, shape):
        ratios = np.zeros(shape)
        assert (nearest_assignment(ratios) == UNASSIGNED).all()
        assert marginal_probabilities(ratios).shape == (shape[0], shape[1] + 1)
        assert unused_detections(shape[1], nearest_assignment(ratios)).all()


class TestMarginals:
    @pytest.mark.parametrize("number", range(6))
    def test_are_exact_without_a_loop(self, number):
        # A chain: track k gates the detections k and k + 1.
        ratios = draw_ratios(number, n_tracks=4, n_detections=5, share=1.0)
        ratios = np.triu(np.tril(ratios, 1))
        np.testing.assert_allclose(
            marginal_probabilities(ratios), exact_marginals(ratios), atol=1e-5
        )

    @pytest.mark.parametrize("number", range(8))
    def test_are_close_with_loops(self, number):
        ratios = draw_ratios(number, n_tracks=4, n_detections=4)
        answer, exact = marginal_probabilities(ratios), exact_marginals(ratios)
        np.testing.assert_allclose(answer.sum(axis=1), 1.0)
        assert np.abs(answer - exact).max() < 0.1
        # Weighing each track alone is further off.
        alone = np.column_stack([np.ones(4), ratios])
        alone /= alone.sum(axis=1, keepdims=True)
        assert np.abs(answer - exact).mean() < 0.5 * np.abs(alone - exact).mean()
