"""Kalman filter and smoother against filterpy, a dense posterior, hand examples and chance."""

from itertools import pairwise

import numpy as np
import pytest
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import rts_smoother as filterpy_module_smoother
from helpers import kernel_oracles as oracle
from helpers.strategies import reproducible
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from isac_track import kalman
from isac_track.rng import stream

MODELS = {"cv": 2, "ca": 3}
Q = 0.3


def batch(*, model, sizes=(40, 1, 7, 2), seed=0):
    """Tracks with irregular steps and noise, each with a correlated prior of its own."""
    rng = stream(seed, "test", "kernels")
    d = MODELS[model]
    t, xy, variance = [], [], []
    for size in sizes:
        t.append(rng.uniform(-50, 50) + rng.uniform(0.02, 0.9, size).cumsum())
        xy.append(rng.uniform(-5, 5, 2) + rng.normal(0, 0.3, (size, 2)).cumsum(axis=0))
        variance.append(rng.uniform(0.01, 0.6, size))
    root = rng.normal(0, 1, (len(sizes), d, d))
    return {
        "model": model,
        "t": np.concatenate(t),
        "xy": np.concatenate(xy),
        "variance": np.concatenate(variance),
        "offsets": np.concatenate([[0], np.cumsum(sizes)]),
        "q": Q,
        "initial_mean": rng.normal(0, 2, (len(sizes), 2, d)),
        "initial_cov": root @ root.swapaxes(1, 2) + 0.5 * np.eye(d),
    }


def one_by_one(case):
    """Yield the samples of each track and its arguments for the oracles."""
    for i, (lo, hi) in enumerate(pairwise(case["offsets"])):
        yield (
            slice(lo, hi),
            {
                "t": case["t"][lo:hi],
                "xy": case["xy"][lo:hi],
                "variance": case["variance"][lo:hi],
                "q": case["q"],
                "mean": case["initial_mean"][i],
                "cov": case["initial_cov"][i],
            },
        )


def smooth(case, filtered):
    rest = {name: case[name] for name in ("model", "t", "offsets", "q")}
    return kalman.rts_smoother(filtered=filtered, **rest)


def same(result, other):
    for name in result.__slots__:
        np.testing.assert_array_equal(getattr(result, name), getattr(other, name), err_msg=name)


def close(value, expected, tolerance=1e-9):
    np.testing.assert_allclose(value, expected, rtol=0, atol=tolerance)


@pytest.fixture(params=MODELS)
def case(request):
    return batch(model=request.param)


class TestAgainstFilterpy:
    def test_filter(self, case):
        result = kalman.kalman_filter(**case)
        d = result.cov.shape[-1]
        for i, (rows, track) in enumerate(one_by_one(case)):
            theirs = oracle.filterpy_track(**track)
            close(result.mean[rows].reshape(-1, 2 * d), theirs["mean"])
            close(np.kron(np.eye(2), result.cov[rows]), theirs["cov"])
            close(result.nis[rows], theirs["nis"])
            close(result.log_likelihood[i], theirs["log_likelihood"])
        assert result.accepted.all()

    def test_smoother_is_their_method_and_not_their_module_function(self, case):
        result = smooth(case, kalman.kalman_filter(**case))
        d = result.cov.shape[-1]
        worst = 0.0
        for rows, track in one_by_one(case):
            theirs = oracle.filterpy_track(**track)
            states = (theirs["mean"], theirs["cov"], theirs["fs"], theirs["qs"])
            mean, cov, _, _ = theirs["kf"].rts_smoother(*states)
            close(result.mean[rows].reshape(-1, 2 * d), mean)
            close(np.kron(np.eye(2), result.cov[rows]), cov)
            wrong, _, _, _ = filterpy_module_smoother(*states)
            worst = max(worst, np.abs(wrong - mean)[:, ::d].max())
        assert worst > 0.01  # m: using it would have been noticed here

    def test_gate(self):
        case = batch(model="cv", sizes=(60, 60), seed=3)
        jumps = stream(0, "test", "jumps").uniform(size=120) < 0.3
        case["xy"] = case["xy"] + 4.0 * jumps[:, None]
        result = kalman.kalman_filter(**case, gate=6.0)
        assert 5 < (~result.accepted).sum() < 100
        for i, (rows, track) in enumerate(one_by_one(case)):
            theirs = oracle.filterpy_track(**track, gate=6.0)
            np.testing.assert_array_equal(result.accepted[rows], theirs["accepted"])
            close(result.mean[rows].reshape(-1, 4), theirs["mean"])
            close(result.nis[rows], theirs["nis"])
            close(result.log_likelihood[i], theirs["log_likelihood"])


class TestAgainstTheDensePosterior:
    def test_smoothed_states_and_likelihood(self):
        for model in MODELS:
            case = batch(model=model, sizes=(12, 1, 5), seed=1)
            filtered = kalman.kalman_filter(**case)
            smoothed = smooth(case, filtered)
            for i, (rows, track) in enumerate(one_by_one(case)):
                mean, cov, density = oracle.joint_posterior(**track)
                close(smoothed.mean[rows], mean)
                close(smoothed.cov[rows], cov)
                close(filtered.mean[rows][-1], mean[-1])
                close(filtered.cov[rows][-1], cov[-1])
                close(filtered.log_likelihood[i], density)

    def test_every_filtered_state_is_the_posterior_of_the_samples_so_far(self, case):
        result = kalman.kalman_filter(**case)
        for rows, track in one_by_one(case):
            for k in range(min(6, len(track["t"]))):
                known = {name: track[name][: k + 1] for name in ("t", "xy", "variance")}
                mean, cov, _ = oracle.joint_posterior(**track | known)
                close(result.mean[rows][k], mean[-1])
                close(result.cov[rows][k], cov[-1])

    def test_gated_samples_are_as_if_never_seen(self, case):
        case["xy"] = case["xy"].copy()
        case["xy"][[10, 11, 25]] += 100.0
        filtered = kalman.kalman_filter(**case, gate=50.0)
        assert np.flatnonzero(~filtered.accepted).tolist() == [10, 11, 25]
        smoothed = smooth(case, filtered)
        rows, track = next(one_by_one(case))
        mean, cov, density = oracle.joint_posterior(**track, used=filtered.accepted[rows])
        close(smoothed.mean[rows], mean)
        close(smoothed.cov[rows], cov)
        close(filtered.log_likelihood[0], density, 1e-7)  # 40 dense samples of ca: 1e6 m^2

    def test_one_call_equals_two(self, case):
        case["xy"] = case["xy"] + 5.0 * (np.arange(50) % 7 == 3)[:, None]
        filtered = kalman.kalman_filter(**case, gate=9.0)
        assert not filtered.accepted.all()
        twice = smooth(case, filtered)
        once = kalman.kalman_smoother(**case, gate=9.0)
        close(once.mean, twice.mean, 1e-11)
        close(once.cov, twice.cov, 1e-11)


class TestGate:
    """A walk along x at 1 m/s, sampled each second; by hand, with q so small that it is fixed."""

    def run(self, x, **changes):
        n = len(x)
        case = {
            "model": "cv",
            "t": np.arange(n, dtype=float),
            "xy": np.stack([x, np.zeros(n)], axis=1),
            "variance": np.ones(n),
            "offsets": np.array([0, n]),
            "q": 1e-12,
            "initial_mean": np.array([[[0.0, 1.0], [0.0, 0.0]]]),
            "initial_cov": np.diag([1.0, 1e-12])[None],
            "gate": 9.0,
        }
        return kalman.kalman_filter(**case | changes)

    def test_by_hand(self):
        # Predicted variance 1, 1/2, 1/2: the sample at 1 s is 10 m off, 100 / 1.5 > 9.
        result = self.run(np.array([0.0, 11.0, 2.0]))
        assert result.accepted.tolist() == [True, False, True]
        close(result.nis, [0.0, 100 / 1.5, 0.0], 1e-6)
        close(result.mean[:, 0, 0], [0.0, 1.0, 2.0], 1e-6)
        close(result.cov[:, 0, 0], [1 / 2, 1 / 2, 1 / 3], 1e-6)
        close(result.log_likelihood, -np.log(2 * np.pi * 2) - np.log(2 * np.pi * 1.5), 1e-6)

    def test_the_threshold_itself_is_accepted(self):
        offset = np.array([np.sqrt(18.0)])  # predicted variance 1 + 1
        exactly = self.run(offset).nis[0]
        assert self.run(offset, gate=exactly).accepted.all()
        assert not self.run(offset, gate=np.nextafter(exactly, 0)).accepted.any()

    def test_a_track_is_never_lost(self):
        # The fourth sample in a row that is far away is believed.
        x = np.array([0.0, 31.0, 32.0, 33.0, 34.0, 35.0])
        result = self.run(x, q=1.0, initial_cov=np.diag([1.0, 1.0])[None], gate=1e-3)
        assert kalman.MAX_REJECTIONS == 3
        assert result.accepted.tolist() == [True, False, False, False, True, False]
        assert result.mean[4, 0, 0] > 25

    def test_rejected_first_samples_leave_the_prior(self):
        result = self.run(np.full(3, 1e6))
        assert not result.accepted.any()
        close(result.mean[:, 0, 0], [0.0, 1.0, 2.0], 1e-6)
        assert result.log_likelihood[0] == 0.0


class TestBatches:
    def test_a_batch_is_its_tracks_one_by_one(self, case):
        whole = kalman.kalman_filter(**case)
        smoothed = smooth(case, whole)
        both = kalman.kalman_smoother(**case)
        for i, (lo, hi) in enumerate(pairwise(case["offsets"])):
            alone = dict(case, offsets=np.array([0, hi - lo]))
            for name in ("t", "xy", "variance"):
                alone[name] = case[name][lo:hi]
            for name in ("initial_mean", "initial_cov"):
                alone[name] = case[name][i : i + 1]
            single = kalman.kalman_filter(**alone)
            np.testing.assert_array_equal(single.mean, whole.mean[lo:hi])
            np.testing.assert_array_equal(single.cov, whole.cov[lo:hi])
            np.testing.assert_array_equal(single.log_likelihood, whole.log_likelihood[i : i + 1])
            np.testing.assert_array_equal(smooth(alone, single).mean, smoothed.mean[lo:hi])
            np.testing.assert_array_equal(kalman.kalman_smoother(**alone).cov, both.cov[lo:hi])

    def test_the_order_of_the_tracks_does_not_matter(self, case):
        last = kalman.kalman_last(**case)
        order = np.array([2, 0, 3, 1])
        rows = np.concatenate([np.arange(*case["offsets"][i : i + 2]) for i in order])
        turned = dict(case)
        for name in ("t", "xy", "variance"):
            turned[name] = case[name][rows]
        for name in ("initial_mean", "initial_cov"):
            turned[name] = case[name][order]
        turned["offsets"] = np.concatenate([[0], np.cumsum(np.diff(case["offsets"])[order])])
        shuffled = kalman.kalman_last(**turned)
        for name in last.__slots__:
            np.testing.assert_array_equal(getattr(shuffled, name), getattr(last, name)[order])

    def test_inputs_stay_as_they_are_and_may_be_read_only(self, case):
        copies = {name: np.copy(value) for name, value in case.items() if name != "model"}
        expected = kalman.kalman_filter(**case)
        for value in case.values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
        filtered = kalman.kalman_filter(**case)
        same(filtered, expected)
        kalman.kalman_last(**case)
        kalman.kalman_smoother(**case)
        kept = filtered.mean.copy()
        smooth(case, filtered)
        np.testing.assert_array_equal(filtered.mean, kept)
        for name, value in copies.items():
            np.testing.assert_array_equal(case[name], value)

    def test_strided_and_narrow_arrays_are_taken(self, case):
        expected = kalman.kalman_last(**case)
        strided = dict(case, xy=np.asfortranarray(case["xy"]))
        strided["t"] = np.repeat(case["t"], 2)[::2]
        strided["offsets"] = case["offsets"].astype(np.int32)
        same(kalman.kalman_last(**strided), expected)

    def test_no_track_at_all(self, case):
        d = MODELS[case["model"]]
        none = {name: case[name][:0] for name in ("t", "xy", "variance")}
        none |= {"initial_mean": np.empty((0, 2, d)), "initial_cov": np.empty((0, d, d))}
        empty = case | none | {"offsets": np.array([0])}
        filtered = kalman.kalman_filter(**empty)
        assert filtered.mean.shape == (0, 2, d)
        assert kalman.kalman_last(**empty).mean.shape == (0, 2, d)
        assert smooth(empty, filtered).cov.shape == (0, d, d)
        assert kalman.kalman_smoother(**empty).cov.shape == (0, d, d)

    def test_the_axes_do_not_mix(self, case):
        before = kalman.kalman_filter(**case)
        after = kalman.kalman_filter(**case | {"xy": case["xy"] + [0.0, 3.0]})
        np.testing.assert_array_equal(after.mean[:, 0], before.mean[:, 0])
        assert (after.mean[:, 1, 0] > before.mean[:, 1, 0]).all()
        np.testing.assert_array_equal(after.cov, before.cov)


class TestLastState:
    def test_is_the_last_of_the_filter(self, case):
        filtered = kalman.kalman_filter(**case, gate=5.0)
        last = kalman.kalman_last(**case, gate=5.0)
        rows = case["offsets"][1:] - 1
        np.testing.assert_array_equal(last.mean, filtered.mean[rows])
        np.testing.assert_array_equal(last.cov, filtered.cov[rows])
        np.testing.assert_array_equal(last.log_likelihood, filtered.log_likelihood)

    def test_sums_by_filterpy(self, case):
        last = kalman.kalman_last(**case, gate=5.0)
        for i, (_, track) in enumerate(one_by_one(case)):
            theirs = oracle.filterpy_track(**track, gate=5.0)
            d = len(track["cov"])
            squares = predicted = 0.0
            count = 0
            for k in range(1, len(track["t"])):
                if theirs["accepted"][k]:
                    f, q = theirs["fs"][k], theirs["qs"][k]
                    ahead = f @ theirs["mean"][k - 1]
                    cov = f @ theirs["cov"][k - 1] @ f.T + q
                    for axis in range(2):
                        count += 1
                        squares += (track["xy"][k, axis] - ahead[axis * d]) ** 2
                        predicted += cov[axis * d, axis * d]
            assert last.innovations[i] == count
            close(last.squares[i], squares)
            close(last.predicted[i], predicted)

    def test_the_sums_tell_the_noise_of_a_track(self):
        truth = np.array([0.01, 0.3, 4.0])
        case, _ = simulated(model="cv", n_tracks=3, n_samples=4000, variance=truth.repeat(4000))
        last = kalman.kalman_last(**case)
        estimate = (last.squares - last.predicted) / last.innovations
        np.testing.assert_allclose(estimate, truth, rtol=0.1)


def simulated(*, model, n_tracks, n_samples, variance):
    """Motion and samples drawn from the very model, priors included; also the true states."""
    d = MODELS[model]
    rng = stream(5, "test", "consistency", model)
    steps = rng.choice([0.05, 0.1, 0.7], (n_tracks, n_samples))
    prior = np.diag([4.0, 1.0, 0.5][:d])
    state = np.empty((n_tracks, n_samples, 2, d))
    root = {s: np.linalg.cholesky(oracle.process_noise(s, Q, d)) for s in (0.05, 0.1, 0.7)}
    move = {s: oracle.transition(s, d) for s in root}
    for i in range(n_tracks):
        now = rng.standard_normal((2, d)) @ np.sqrt(prior)
        for k in range(n_samples):
            if k > 0:
                s = steps[i, k]
                now = now @ move[s].T + rng.standard_normal((2, d)) @ root[s].T
            state[i, k] = now
    noise = rng.standard_normal((n_tracks * n_samples, 2)) * np.sqrt(variance)[:, None]
    case = {
        "model": model,
        "t": steps.cumsum(axis=1).ravel(),
        "xy": state[..., 0].reshape(-1, 2) + noise,
        "variance": variance,
        "offsets": np.arange(n_tracks + 1) * n_samples,
        "q": Q,
        "initial_mean": np.zeros((n_tracks, 2, d)),
        "initial_cov": np.tile(prior, (n_tracks, 1, 1)),
    }
    return case, state.reshape(-1, 2, d)


@pytest.mark.parametrize("model", MODELS)
def test_consistency_where_the_model_is_exact(model):
    n_tracks, n_samples = 300, 25
    variance = stream(6, "test", "variance").uniform(0.01, 1.0, n_tracks * n_samples)
    case, truth = simulated(model=model, n_tracks=n_tracks, n_samples=n_samples, variance=variance)
    d = MODELS[model]
    filtered = kalman.kalman_filter(**case)

    def within(total, freedom):
        low, high = chi2.ppf([0.0005, 0.9995], freedom)
        assert low < total < high

    # Innovations are independent; the errors of one track are not: one sample of each counts.
    within(filtered.nis.sum(), 2 * n_tracks * n_samples)
    share = (filtered.nis > chi2.ppf(0.95, 2)).mean()
    assert share == pytest.approx(0.05, abs=0.01)
    smoothed = smooth(case, filtered)
    for result, k in ((filtered, n_samples - 1), (filtered, 3), (smoothed, 0), (smoothed, 12)):
        error = (result.mean - truth)[k::n_samples]
        whitened = np.linalg.solve(result.cov[k::n_samples], error.swapaxes(1, 2))
        within((error.swapaxes(1, 2) * whitened).sum(), 2 * d * n_tracks)


class TestSteps:
    def test_a_worthless_sample_changes_nothing(self, case):
        """Predictions compose over steps; with filterpy's discrete white noise they do not."""
        lo, hi = case["offsets"][:2]
        track = {name: case[name][lo:hi] for name in ("t", "xy", "variance")}
        rest = {"offsets": np.array([0, hi]), "q": Q, "model": case["model"]}
        rest |= {name: case[name][:1] for name in ("initial_mean", "initial_cov")}
        between = (track["t"][20] + track["t"][21]) / 2
        more = {
            "t": np.insert(track["t"], 21, between),
            "xy": np.insert(track["xy"], 21, [1e3, -1e3], axis=0),
            "variance": np.insert(track["variance"], 21, 1e18),
        }
        plain = kalman.kalman_filter(**track, **rest)
        longer = kalman.kalman_filter(**more, **rest | {"offsets": np.array([0, hi + 1])})
        close(np.delete(longer.mean, 21, axis=0), plain.mean)
        close(np.delete(longer.cov, 21, axis=0), plain.cov)

    def test_discrete_white_noise_would_not_compose(self):
        f = oracle.transition(0.5, 2)
        half, whole = (Q_discrete_white_noise(2, dt=dt, var=Q) for dt in (0.5, 1.0))
        assert np.abs(f @ half @ f.T + half - whole).max() > 0.01
        half, whole = (oracle.process_noise(dt, Q, 2) for dt in (0.5, 1.0))
        close(f @ half @ f.T + half, whole, 1e-12)

    def test_a_single_sample_is_prior_times_measurement(self):
        for model in MODELS:
            case = batch(model=model, sizes=(1,))
            a, r = case["initial_cov"][0, 0, 0], case["variance"][0]
            result = kalman.kalman_filter(**case)
            assert result.cov[0, 0, 0] == pytest.approx(a * r / (a + r), rel=1e-12)
            expected = (case["initial_mean"][0, :, 0] * r + case["xy"][0] * a) / (a + r)
            np.testing.assert_allclose(result.mean[0, :, 0], expected, rtol=1e-12)
            close(smooth(case, result).mean, result.mean, 0)
            last = kalman.kalman_last(**case)
            assert last.innovations[0] == 0
            assert last.squares[0] == last.predicted[0] == 0.0


sigmas_m = st.floats(-3, 2).map(lambda power: 10.0**power)
steps_s = st.floats(-3, 1).map(lambda power: 10.0**power)


@st.composite
def hard_tracks(draw, *, gap=1.0):
    """Three tracks over five decades of noise and four of steps."""
    sizes = draw(st.tuples(*[st.integers(1, 9)] * 3))
    total = sum(sizes)
    steps = gap * np.array(draw(st.lists(steps_s, min_size=total, max_size=total)))
    sigma = np.array(draw(st.lists(sigmas_m, min_size=total, max_size=total)))
    places = st.lists(st.floats(-50, 50), min_size=total, max_size=total)
    return {
        "t": steps.cumsum(),
        "xy": np.stack([draw(places), draw(places)], axis=1),
        "variance": sigma**2,
        "offsets": np.concatenate([[0], np.cumsum(sizes)]),
        "q": 10.0 ** draw(st.floats(-3, 1)),
    }


def sound(mean, cov):
    assert np.isfinite(mean).all()
    assert np.isfinite(cov).all()
    np.testing.assert_array_equal(cov, cov.swapaxes(-1, -2))
    variance = np.diagonal(cov, axis1=-2, axis2=-1)
    assert (variance > 0).all()
    scale = np.sqrt(variance)
    correlation = cov / (scale[..., :, None] * scale[..., None, :])
    # The roots of a singular correlation matrix are known to rounding errors only.
    assert np.linalg.eigvalsh(correlation).min(initial=0.0) > -1e-12


def precise_filter(*, t, xy, variance, q, mean, cov):
    """Joseph's form with 64 bits of mantissa: where double precision would have to give up."""
    d = len(cov)
    wide = np.longdouble
    x, p = mean.astype(wide), cov.astype(wide)
    factorials = np.array([1, 1, 2], dtype=wide)
    power = np.arange(d)
    lag = power[None, :] - power[:, None]
    order = d - 1 - power
    means, covs = [], []
    for k in range(len(t)):
        if k > 0:
            step = wide(t[k]) - wide(t[k - 1])
            f = np.where(lag >= 0, step ** np.abs(lag) / factorials[np.abs(lag)], wide(0))
            both = order[:, None] + order[None, :] + 1
            noise = wide(q) * step**both / (both * np.outer(factorials[order], factorials[order]))
            x = x @ f.T
            p = f @ p @ f.T + noise
        gain = p[:, 0] / (p[0, 0] + wide(variance[k]))
        x = x + np.outer(xy[k] - x[:, 0], gain)
        keep = np.eye(d, dtype=wide)
        keep[:, 0] -= gain
        p = keep @ p @ keep.T + np.outer(gain, gain) * wide(variance[k])
        means.append(x)
        covs.append(p)
    return np.array(means), np.array(covs)


@pytest.mark.parametrize("model", MODELS)
class TestNumerics:
    @reproducible
    @given(track=hard_tracks())
    def test_sound_over_five_decades_of_noise_and_four_of_steps(self, model, track):
        d = MODELS[model]
        case = self.case(model, track)
        filtered = kalman.kalman_filter(**case)
        sound(filtered.mean, filtered.cov)
        assert np.isfinite(filtered.nis).all()
        assert np.isfinite(filtered.log_likelihood).all()
        for result in (smooth(case, filtered), kalman.kalman_smoother(**case)):
            sound(result.mean, result.cov)
            shrunk = np.diagonal(filtered.cov - result.cov, axis1=1, axis2=2)
            variance = np.diagonal(filtered.cov, axis1=1, axis2=2)
            assert (shrunk >= -1e-9 * variance).all()
        for i, (lo, hi) in enumerate(pairwise(case["offsets"])):
            mean, cov = precise_filter(
                t=case["t"][lo:hi],
                xy=case["xy"][lo:hi],
                variance=case["variance"][lo:hi],
                q=case["q"],
                mean=case["initial_mean"][i],
                cov=case["initial_cov"][i],
            )
            scale = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
            assert cov.shape == (hi - lo, d, d)
            # Errors in units of the standard deviation that goes with them
            close((filtered.mean[lo:hi] - mean) / scale[:, None], 0, 1e-6)
            close((filtered.cov[lo:hi] - cov) / (scale[:, :, None] * scale[:, None]), 0, 1e-6)

    @reproducible
    @given(track=hard_tracks(gap=1e4))
    def test_sound_over_gaps_of_a_day(self, model, track):
        case = self.case(model, track)
        filtered = kalman.kalman_filter(**case)
        sound(filtered.mean, filtered.cov)
        for result in (smooth(case, filtered), kalman.kalman_smoother(**case)):
            sound(result.mean, result.cov)

    def case(self, model, track):
        d = MODELS[model]
        prior = np.diag([1e4, 4.0, 1.0][:d])
        return track | {
            "model": model,
            "initial_mean": np.zeros((3, 2, d)),
            "initial_cov": np.tile(prior, (3, 1, 1)),
        }

    def test_a_thousand_samples_at_a_millisecond_after_one_day(self, model):
        t = np.concatenate([[0.0], 86400 + np.arange(1000) * 1e-3])
        track = {"t": t, "xy": np.ones((1001, 2)), "variance": np.full(1001, 1e-6), "q": 0.3}
        case = track | {"model": model, "offsets": np.array([0, 1001])}
        case |= {"initial_mean": np.zeros((1, 2, MODELS[model]))}
        case |= {"initial_cov": np.eye(MODELS[model])[None]}
        filtered = kalman.kalman_filter(**case)
        sound(filtered.mean, filtered.cov)
        close(filtered.mean[-1, :, :2], [[1.0, 0.0]] * 2, 0.02)
        sound(*(getattr(smooth(case, filtered), name) for name in ("mean", "cov")))

    def test_a_long_likelihood_neither_overflows_nor_underflows(self, model):
        n = 400  # products of innovation variances: 1e4^200, then 1e-6^200
        case = {
            "model": model,
            "t": np.arange(n) * 0.1,
            "xy": np.zeros((n, 2)),
            "variance": np.repeat([1e4, 1e-6], n // 2),
            "offsets": np.array([0, n]),
            "q": 1e-3,
            "initial_mean": np.zeros((1, 2, MODELS[model])),
            "initial_cov": np.eye(MODELS[model])[None],
        }
        result = kalman.kalman_filter(**case)
        track = next(one_by_one(case))[1]
        theirs = oracle.filterpy_track(**track)["log_likelihood"]
        assert result.log_likelihood[0] == pytest.approx(theirs, rel=1e-6)


WRONG = {
    "an unknown model": ("model", lambda _: "ct", "model must be one of"),
    "t of a wrong length": ("t", lambda c: c["t"][:-1], "offsets must run from 0 to 49"),
    "t with two dimensions": ("t", lambda c: c["t"][:, None], "t must have shape"),
    "t that stands still": ("t", lambda c: np.repeat(c["t"][::2], 2), "strictly increasing"),
    "t not a number": ("t", lambda c: c["t"] * np.nan, "strictly increasing"),
    "an infinite time": ("t", lambda c: np.append(c["t"][:-1], np.inf), "finite"),
    "xy of a wrong shape": ("xy", lambda c: c["xy"].T, "xy must have shape"),
    "a position not a number": ("xy", lambda c: c["xy"] * np.nan, "xy must be finite"),
    "no variance": ("variance", lambda c: c["variance"] * 0, "variance must be positive"),
    "an infinite variance": ("variance", lambda c: c["variance"] / 0.0, "must be finite"),
    "an empty track": ("offsets", lambda _: np.array([0, 3, 3, 50]), "at least one sample"),
    "no offsets": ("offsets", lambda _: np.array([], dtype=int), "offsets must run"),
    "offsets not from zero": ("offsets", lambda _: np.array([1, 50]), "offsets must run"),
    "offsets that are no integers": ("offsets", lambda c: c["offsets"] * 1.0, "integers"),
    "q of zero": ("q", lambda _: 0.0, "q must be positive"),
    "q infinite": ("q", lambda _: np.inf, "q must be positive"),
    "a gate not a number": ("gate", lambda _: np.nan, "gate must be positive"),
    "a mean too few": ("initial_mean", lambda c: c["initial_mean"][1:], "initial_mean must have"),
    "a prior of the other model": ("initial_cov", lambda _: np.ones((4, 4, 4)), "must have shape"),
    "an asymmetric prior": (
        "initial_cov",
        lambda c: c["initial_cov"] + np.triu(np.ones(c["initial_cov"].shape[1:]), 1),
        "symmetric",
    ),
    "a singular prior": ("initial_cov", lambda c: c["initial_cov"] * 0, "positive definite"),
}


@pytest.mark.parametrize("what", WRONG)
@pytest.mark.parametrize("run", ["kalman_filter", "kalman_last", "kalman_smoother"])
def test_wrong_arguments_are_named(case, run, what):
    name, change, message = WRONG[what]
    with np.errstate(divide="ignore"):
        wrong = case | {name: change(case)}
    with pytest.raises(ValueError, match=message):
        getattr(kalman, run)(**wrong)


def test_the_smoother_checks_that_the_filter_ran_on_these_samples(case):
    filtered = kalman.kalman_filter(**case)
    other = batch(model=case["model"], sizes=(5,))
    with pytest.raises(ValueError, match=r"filtered\.mean must have shape"):
        smooth(other, filtered)
