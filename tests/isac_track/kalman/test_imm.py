"""IMM filter and smoother against an independent textbook cycle and every mode path.

Against filterpy the filter is tested as a predictor, in `tests/predictors/test_kalman.py`.
"""

import numpy as np
import pytest
from helpers import kernel_oracles as oracle
from helpers.kalman_cases import close, hard_tracks, one_by_one, prefixes, sound
from helpers.strategies import reproducible
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from isac_track import kalman
from isac_track.kalman import imm
from isac_track.rng import stream

TWO = {"q": np.array([0.05, 4.0]), "rates": np.array([[0.0, 0.4], [0.8, 0.0]])}
THREE = {
    "q": np.array([0.02, 0.5, 6.0]),
    "rates": np.array([[0.0, 0.3, 0.1], [0.7, 0.0, 0.01], [2.0, 9.0, 0.0]]),
}


def batch(*, chain=TWO, sizes=(30, 1, 6), seed=0):
    """Tracks with irregular steps and noise, that now and then dart off."""
    rng = stream(seed, "test", "imm")
    total = sum(sizes)
    root = rng.normal(0, 1, (len(sizes), 2, 2))
    darts = rng.uniform(size=(total, 1)) < 0.2
    odds = np.arange(1.0, len(chain["q"]) + 1)
    return chain | {
        "t": rng.uniform(0.05, 0.9, total).cumsum(),
        "xy": (rng.normal(0, 0.2, (total, 2)) + darts * rng.normal(0, 1.0, (total, 2))).cumsum(0),
        "variance": rng.uniform(0.01, 0.3, total),
        "offsets": np.concatenate([[0], np.cumsum(sizes)]),
        "initial_mean": rng.normal(0, 1, (len(sizes), 2, 2)),
        "initial_cov": root @ root.swapaxes(1, 2) + 0.5 * np.eye(2),
        "initial_probability": odds / odds.sum(),
    }


def smooth(case, filtered):
    chosen = {name: case[name] for name in ("t", "offsets", "q", "rates")}
    return kalman.imm_smoother(filtered=filtered, **chosen)


def one_model(case, q):
    """The states of a single model: filtered by our kernel, smoothed by filterpy."""
    modes = ("q", "rates", "initial_probability")
    case = {name: value for name, value in case.items() if name not in modes} | {"q": q}
    filtered = kalman.kalman_last(model="cv", **prefixes(case))
    smoothed = [oracle.filterpy_smooth(**track) for _, track in one_by_one(case)]
    return filtered, *(np.concatenate(values) for values in zip(*smoothed, strict=True))


@pytest.fixture(params=["two modes", "three modes"])
def case(request):
    return batch(chain=TWO if request.param == "two modes" else THREE)


class TestAgainstTheTextbook:
    def test_a_far_outlier_still_tells_the_modes_apart(self):
        case = batch(sizes=(12,))
        case["xy"] = case["xy"].copy()
        case["xy"][6] += 1e3
        result = kalman.imm_filter(**case)
        _, track = next(one_by_one(case))
        expected = oracle.imm_track(**track)["probability"]
        assert expected[6, 1] > 0.999999  # only the restless mode can have done that
        close(result.probability, expected)  # filterpy's likelihoods underflow to one floor

    @pytest.mark.parametrize("gate", [np.inf, 8.0])
    def test_filter(self, case, gate):
        result = kalman.imm_filter(**case, gate=gate)
        used = []
        for i, (rows, track) in enumerate(one_by_one(case)):
            slow = oracle.imm_track(**track, gate=gate)
            close(result.mean[rows].reshape(slow["mean"].shape), slow["mean"])
            close(result.cov[rows], slow["cov"])
            close(result.probability[rows], slow["probability"])
            close(result.log_likelihood[i], slow["log_likelihood"])
            used.extend(slow["accepted"])
            for k, row in enumerate(range(*rows.indices(len(case["t"])))):
                states = (slow["probability"][k], slow["mean"][k], slow["cov"][k])
                mean, cov = oracle.collapse(*states)
                close(result.mixed_mean[row].ravel(), mean)
                close(result.mixed_cov[row], cov)
        assert all(used) == (gate == np.inf)

    @pytest.mark.parametrize("gate", [np.inf, 8.0])
    def test_last_is_the_last_of_the_filter(self, case, gate):
        filtered, last = (run(**case, gate=gate) for run in (kalman.imm_filter, kalman.imm_last))
        for name in ("mean", "cov", "probability", "mixed_mean", "mixed_cov"):
            expected = getattr(filtered, name)[case["offsets"][1:] - 1]
            np.testing.assert_array_equal(getattr(last, name), expected)
        np.testing.assert_array_equal(last.log_likelihood, filtered.log_likelihood)

    @pytest.mark.parametrize("gate", [np.inf, 8.0])
    def test_smoother(self, case, gate):
        filtered = kalman.imm_filter(**case, gate=gate)
        result = smooth(case, filtered)
        for rows, track in one_by_one(case):
            slow = oracle.imm_smooth(
                t=track["t"],
                q=track["q"],
                rates=track["rates"],
                mean=filtered.mean[rows].reshape(-1, len(track["q"]), 4),
                cov=filtered.cov[rows],
                probability=filtered.probability[rows],
            )
            close(result.mean[rows].reshape(slow["mean"].shape), slow["mean"])
            close(result.cov[rows], slow["cov"])
            close(result.probability[rows], slow["probability"])
            for k, row in enumerate(range(*rows.indices(len(case["t"])))):
                states = (slow["probability"][k], slow["mean"][k], slow["cov"][k])
                mean, cov = oracle.collapse(*states)
                close(result.mixed_mean[row].ravel(), mean)
                close(result.mixed_cov[row], cov)

    def test_smoother_is_near_the_sum_over_every_path_of_modes(self):
        """The only exact answer: 2^8 Kalman smoothers. The filter is far from it."""
        away = {"filter": [], "smoother": []}
        odds = {"filter": [], "smoother": []}
        for seed in range(6):
            case = batch(sizes=(8,), seed=seed)
            track = next(one_by_one(case))[1]
            mean, modes = oracle.imm_exact(**track)
            filtered = kalman.imm_filter(**case)
            results = {"filter": filtered, "smoother": smooth(case, filtered)}
            for name, result in results.items():
                scale = np.sqrt(np.diagonal(results["smoother"].mixed_cov, axis1=1, axis2=2))
                error = (result.mixed_mean - mean).reshape(-1, 4)
                away[name].append(np.abs(error) / scale)
                odds[name].append(np.abs(result.probability - modes))
        assert np.mean(away["smoother"]) < 0.15
        assert np.mean(away["smoother"]) < np.mean(away["filter"]) / 4
        assert np.mean(odds["smoother"]) < 0.06
        assert np.mean(odds["smoother"]) < np.mean(odds["filter"]) / 2

    def test_modes_that_never_change(self):
        """Zero rates: independent filters, weighted by their likelihood; impossible modes stay."""
        case = batch() | {"rates": np.zeros((2, 2)), "initial_probability": np.array([1.0, 0.0])}
        filtered = kalman.imm_filter(**case)
        smoothed = smooth(case, filtered)
        for mode, q in enumerate(case["q"]):
            one, mean, _ = one_model(case, q)
            close(filtered.mean[:, mode], one.mean)
            close(smoothed.mean[:, mode], mean)
        for result in (filtered, smoothed):
            close(result.probability, np.tile([1.0, 0.0], (len(case["t"]), 1)))


class TestChances:
    @pytest.mark.parametrize("rates", [TWO["rates"], THREE["rates"], np.zeros((3, 3))])
    @pytest.mark.parametrize("step_s", [1e-3, 0.3, 10.0, 1e4])
    def test_transitions_are_the_matrix_exponential(self, rates, step_s):
        generator = rates - np.diag(rates.sum(axis=1))
        (matrix,) = imm.chances(generator, np.array([step_s]))
        close(matrix, expm(generator * step_s), 1e-11)  # scipy's own error over 1e5 jumps
        close(matrix.sum(axis=1), 1.0, 1e-11)
        assert (matrix >= 0).all()

    def test_the_diagonal_is_not_read(self):
        case = batch()
        other = case | {"rates": case["rates"] + np.diag([7.0, np.nan])}
        np.testing.assert_array_equal(
            kalman.imm_filter(**other).mean, kalman.imm_filter(**case).mean
        )


@reproducible
@given(track=hard_tracks(n_tracks=2), chain=st.sampled_from([TWO, THREE]))
def test_sound_over_five_decades_of_noise_and_four_of_steps(track, chain):
    """Two or three modes, equally likely at first."""
    modes = len(chain["q"])
    prior = {
        "initial_mean": np.zeros((2, 2, 2)),
        "initial_cov": np.tile(np.diag([1e4, 4.0]), (2, 1, 1)),
        "initial_probability": np.full(modes, 1 / modes),
    }
    case = track | chain | prior
    filtered = kalman.imm_filter(**case)
    assert np.isfinite(filtered.log_likelihood).all()
    for result in (filtered, smooth(case, filtered)):
        assert (result.probability >= 0).all()
        close(result.probability.sum(axis=1), 1.0, 1e-12)
        sound(result.mean, result.cov, 1e-9)
        sound(result.mixed_mean, result.mixed_cov, 1e-9)
