"""The smoother of positions: against kalman_smoother, fractions, dense solutions, alone."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from helpers import kernel_oracles as oracle
from helpers.strategies import reproducible
from hypothesis import given
from hypothesis import strategies as st

from isac_track import kalman
from isac_track.rng import stream

SIZES = (1, 2, 3, 7, 8, 9, 100)
VAGUE = np.diag([100.0, 10.0]) ** 2
Q = 0.3


def batch(*sizes, seed=0, cov=None, step_s=(0.02, 0.9), variance=(0.01, 0.6)):
    """Walks with irregular steps and variances, each with a prior of its own or a vague one."""
    rng = stream(seed, "test", "lanes", *sizes)
    t = [rng.uniform(-50, 50) + rng.uniform(*step_s, size).cumsum() for size in sizes]
    xy = [rng.uniform(-5, 5, 2) + rng.normal(0, 0.3, (size, 2)).cumsum(axis=0) for size in sizes]
    if cov is None:
        root = rng.normal(0, 1, (len(sizes), 2, 2))
        cov = root @ root.swapaxes(1, 2) + 0.5 * np.eye(2)
    return {
        "t": np.concatenate(t),
        "xy": np.concatenate(xy),
        "variance": rng.uniform(*variance, sum(sizes)),
        "offsets": np.concatenate([[0], np.cumsum(sizes)]),
        "q": Q,
        "initial_mean": rng.normal(0, 2, (len(sizes), 2, 2)),
        "initial_cov": np.broadcast_to(cov, (len(sizes), 2, 2)),
    }


def taken(case, order):
    """The tracks of a batch in that order."""
    rows = np.concatenate([np.arange(*case["offsets"][i : i + 2]) for i in order])
    chosen = {name: case[name][rows] for name in ("t", "xy", "variance")}
    chosen |= {name: case[name][list(order)] for name in ("initial_mean", "initial_cov")}
    sizes = np.diff(case["offsets"])[list(order)]
    return chosen | {"offsets": np.concatenate([[0], np.cumsum(sizes)]), "q": case["q"]}


def one_by_one(case):
    """Yield the samples of each track and its arguments for the dense posterior."""
    for i, (lo, hi) in enumerate(pairwise(case["offsets"])):
        track = {name: case[name][lo:hi] for name in ("t", "xy", "variance")}
        track |= {"q": case["q"], "mean": case["initial_mean"][i], "cov": case["initial_cov"][i]}
        yield slice(lo, hi), track


def exact(*, t, xy, variance, q, mean, cov):
    """Textbook filter and smoother of one axis in fractions: positions (n,) and variances (n,)."""
    t, xy, variance = ([Fraction(float(value)) for value in values] for values in (t, xy, variance))
    q = Fraction(q)
    x = [Fraction(float(value)) for value in mean]
    p = [[Fraction(float(value)) for value in row] for row in cov]
    filtered = []
    for k in range(len(t)):
        step = t[k] - t[k - 1] if k else Fraction(0)
        ahead = [x[0] + step * x[1], x[1]]
        cross = p[0][1] + step * p[1][1] + q * step**2 / 2
        grown = p[0][0] + step * (2 * p[0][1] + step * p[1][1]) + q * step**3 / 3
        ahead_p = [[grown, cross], [cross, p[1][1] + q * step]]
        spread = ahead_p[0][0] + variance[k]
        gain = [ahead_p[0][0] / spread, ahead_p[1][0] / spread]
        x = [ahead[i] + gain[i] * (xy[k] - ahead[0]) for i in range(2)]
        p = [[ahead_p[i][j] - gain[i] * ahead_p[0][j] for j in range(2)] for i in range(2)]
        filtered.append((step, ahead, ahead_p, x, p))
    positions, variances = [x[0]], [p[0][0]]
    for (*_, now, now_p), (step, ahead, ahead_p, *_) in zip(
        filtered[-2::-1], filtered[:0:-1], strict=True
    ):
        moved = [[now_p[i][0] + step * now_p[i][1], now_p[i][1]] for i in range(2)]  # P F'
        (a, b), (_, d) = ahead_p
        inverse = [[d, -b], [-b, a]]
        gain = [
            [sum(moved[i][m] * inverse[m][j] for m in range(2)) / (a * d - b * b) for j in range(2)]
            for i in range(2)
        ]
        gap = [x[j] - ahead[j] for j in range(2)]
        x = [now[i] + sum(gain[i][j] * gap[j] for j in range(2)) for i in range(2)]
        change = [[p[i][j] - ahead_p[i][j] for j in range(2)] for i in range(2)]
        p = [
            [
                now_p[i][j]
                + sum(gain[i][m] * change[m][n] * gain[j][n] for m in range(2) for n in range(2))
                for j in range(2)
            ]
            for i in range(2)
        ]
        positions.append(x[0])
        variances.append(p[0][0])
    return np.array(positions[::-1], dtype=float), np.array(variances[::-1], dtype=float)


def reweighted(*, passes, anneal, **track):
    """The documented iteration of one track on its dense posterior; pass 1 is the Gaussian one."""
    square = 2.0 * track["variance"]
    variance = track["variance"]
    for number in range(1, passes + 1):
        mean, cov, _ = oracle.joint_posterior(**track | {"variance": variance})
        position, spread = mean[:, :, 0], cov[:, 0, 0]
        residual = np.sum((track["xy"] - position) ** 2, axis=1)
        delta = 2.0 * spread + anneal ** (number - 1) * square
        variance = 1.0 / (1.0 / (residual + delta) + 1.0 / square)
    return position, spread


class TestOnePass:
    def test_is_the_smoother_with_velocities(self):
        for cov in (None, VAGUE):
            case = batch(*SIZES, cov=cov)
            position, variance = kalman.smooth_positions(**case)
            expected = kalman.kalman_smoother(model="cv", **case)
            np.testing.assert_allclose(position, expected.mean[:, :, 0], rtol=1e-9)
            np.testing.assert_allclose(variance, expected.cov[:, 0, 0], rtol=1e-9)

    def test_is_the_dense_posterior(self):
        case = batch(12, 1, 5, 2, 9)
        position, variance = kalman.smooth_positions(**case)
        for rows, track in one_by_one(case):
            mean, cov, _ = oracle.joint_posterior(**track)
            np.testing.assert_allclose(position[rows], mean[:, :, 0], rtol=0, atol=1e-9)
            np.testing.assert_allclose(variance[rows], cov[:, 0, 0], rtol=1e-9)

    def test_by_hand(self):
        # A walk that stands still (q so small, prior velocity 0): the mean of three samples.
        position, variance = kalman.smooth_positions(
            t=np.array([0.0, 1.0, 2.0]),
            xy=np.array([[1.0, 0.0], [2.0, 0.0], [6.0, 3.0]]),
            variance=np.full(3, 0.3),
            offsets=np.array([0, 3]),
            q=1e-14,
            initial_mean=np.zeros((1, 2, 2)),
            initial_cov=np.diag([1e6, 1e-14])[None],
        )
        np.testing.assert_allclose(position, [[3.0, 1.0]] * 3, atol=1e-5)
        np.testing.assert_allclose(variance, 0.1, rtol=1e-5)

    @pytest.mark.parametrize("sigma_m", [1e-3, 0.5, 100.0])
    @pytest.mark.parametrize("step_s", [1e-3, 0.1, 10.0])
    def test_keeps_its_digits_after_a_vague_prior(self, sigma_m, step_s):
        case = batch(
            6, 5, cov=VAGUE, step_s=(step_s, 1.5 * step_s), variance=(sigma_m**2, 2 * sigma_m**2)
        )
        position, variance = kalman.smooth_positions(**case)
        for rows, track in one_by_one(case):
            for axis in range(2):
                alone = track | {"xy": track["xy"][:, axis], "mean": track["mean"][axis]}
                expected, spread = exact(**alone)
                np.testing.assert_allclose(
                    position[rows, axis], expected, rtol=0, atol=1e-7 * np.sqrt(spread.min())
                )
                np.testing.assert_allclose(variance[rows], spread, rtol=1e-9)


class TestSeveralPasses:
    @pytest.mark.parametrize("passes", [2, 3, 5])
    @pytest.mark.parametrize("anneal", [0.0, 0.15, 0.7])
    def test_are_the_documented_iteration(self, passes, anneal):
        case = batch(10, 1, 4, 2)
        position, variance = kalman.smooth_positions(**case, passes=passes, anneal=anneal)
        for rows, track in one_by_one(case):
            expected, spread = reweighted(**track, passes=passes, anneal=anneal)
            np.testing.assert_allclose(position[rows], expected, rtol=0, atol=1e-9)
            np.testing.assert_allclose(variance[rows], spread, rtol=1e-9)

    def test_the_annealing_begins_with_the_third(self):
        case = batch(10, 4)
        second = [kalman.smooth_positions(**case, passes=2, anneal=a)[0] for a in (0.0, 0.7)]
        third = [kalman.smooth_positions(**case, passes=3, anneal=a)[0] for a in (0.0, 0.7)]
        np.testing.assert_array_equal(*second)
        assert np.abs(third[0] - third[1]).max() > 1e-3

    def test_a_sample_on_the_walk_gains_weight_and_one_off_it_loses(self):
        # On a straight line all samples but one, 3 m off: the walk lets go of it.
        n = 21
        xy = np.zeros((n, 2))
        xy[10, 1] = 3.0
        case = {
            "t": 0.1 * np.arange(n),
            "xy": xy,
            "variance": np.full(n, 0.5),
            "offsets": np.array([0, n]),
            "q": 0.04,
            "initial_mean": np.zeros((1, 2, 2)),
            "initial_cov": VAGUE[None],
        }
        gaussian, before = kalman.smooth_positions(**case)
        radial, after = kalman.smooth_positions(**case, passes=6)
        assert gaussian[10, 1] > 0.1
        assert radial[10, 1] < 0.3 * gaussian[10, 1]
        assert after[3] < 0.5 * before[3]


class TestNeighbours:
    """A track is smoothed beside others; it must not matter beside which."""

    @pytest.mark.parametrize("passes", [1, 5])
    def test_alone_a_track_is_bit_for_bit_what_it_is_among_others(self, passes):
        for seed in range(8):
            case = batch(*SIZES, 40, 5, 6, seed=seed, cov=VAGUE)
            position, variance = kalman.smooth_positions(**case, passes=passes, anneal=0.15)
            for i, (lo, hi) in enumerate(pairwise(case["offsets"])):
                alone = kalman.smooth_positions(**taken(case, [i]), passes=passes, anneal=0.15)
                np.testing.assert_array_equal(alone[0], position[lo:hi])
                np.testing.assert_array_equal(alone[1], variance[lo:hi])

    @pytest.mark.parametrize("passes", [1, 5])
    def test_the_order_of_the_tracks_changes_no_bit(self, passes):
        case = batch(1, 2, 3, 7, 7, 7, 7, 7, 7, 7, 30, cov=VAGUE)  # ties across full lanes
        position, variance = kalman.smooth_positions(**case, passes=passes, anneal=0.15)
        order = stream(0, "test", "order").permutation(11)
        turned = kalman.smooth_positions(**taken(case, order), passes=passes, anneal=0.15)
        rows = np.concatenate([np.arange(*case["offsets"][i : i + 2]) for i in order])
        np.testing.assert_array_equal(turned[0], position[rows])
        np.testing.assert_array_equal(turned[1], variance[rows])

    @pytest.mark.parametrize("n_tracks", range(1, 18))
    def test_full_and_partly_filled_lanes_give_every_track_its_own_result(self, n_tracks):
        case = batch(*[5, 2, 11, 1, 7, 3][:n_tracks], *[6] * (n_tracks - 6))
        assert case["offsets"].size == n_tracks + 1
        position, variance = kalman.smooth_positions(**case, passes=3, anneal=0.15)
        for i, (lo, hi) in enumerate(pairwise(case["offsets"])):
            alone = kalman.smooth_positions(**taken(case, [i]), passes=3, anneal=0.15)
            np.testing.assert_allclose(position[lo:hi], alone[0], rtol=1e-12)
            np.testing.assert_allclose(variance[lo:hi], alone[1], rtol=1e-12)

    def test_no_track_at_all(self):
        none = taken(batch(3, 4), [0])
        none |= {name: none[name][:0] for name in ("t", "xy", "variance")}
        none |= {"initial_mean": np.empty((0, 2, 2)), "initial_cov": np.empty((0, 2, 2))}
        position, variance = kalman.smooth_positions(**none | {"offsets": np.array([0])})
        assert position.shape == (0, 2)
        assert variance.shape == (0,)


@reproducible
@given(
    sizes=st.lists(st.integers(1, 40), min_size=1, max_size=10),
    log_sigma=st.floats(-3.0, 2.0),
    log_step=st.floats(-3.0, 1.0),
    passes=st.integers(1, 7),
    anneal=st.floats(0.0, 0.95),
    seed=st.integers(0, 9),
)
def test_any_noise_and_any_step_give_a_sound_result(
    sizes, log_sigma, log_step, passes, anneal, seed
):
    square, step_s = 10.0 ** (2 * log_sigma), 10.0**log_step
    case = batch(
        *sizes,
        seed=seed,
        cov=VAGUE,
        step_s=(0.1 * step_s, step_s),
        variance=(0.01 * square, square),
    )
    position, variance = kalman.smooth_positions(**case, passes=passes, anneal=anneal)
    assert np.isfinite(position).all()
    assert (variance > 0).all()
    # A sample's weight is at least 1 / sigma^2 per axis in every pass, 2 / sigma^2 in the first.
    bound = case["variance"] * (1.0 if passes == 1 else 2.0)
    assert (variance <= bound * (1 + 1e-9)).all()


@pytest.mark.parametrize("passes", [1, 5])
def test_turned_and_shifted_walks_are_turned_and_shifted_alike(passes):
    case = batch(*SIZES, cov=VAGUE)
    case["initial_mean"] = np.zeros_like(case["initial_mean"])
    case["initial_mean"][:, :, 0] = case["xy"][case["offsets"][:-1]]
    turn = np.array([[np.cos(2.1), -np.sin(2.1)], [np.sin(2.1), np.cos(2.1)]])
    moved = case | {"xy": case["xy"] @ turn.T + [300.0, -70.0]}
    moved["initial_mean"] = np.zeros_like(case["initial_mean"])
    moved["initial_mean"][:, :, 0] = moved["xy"][case["offsets"][:-1]]
    position, variance = kalman.smooth_positions(**case, passes=passes, anneal=0.15)
    there, spread = kalman.smooth_positions(**moved, passes=passes, anneal=0.15)
    np.testing.assert_allclose(there, position @ turn.T + [300.0, -70.0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(spread, variance, rtol=1e-9)


def test_inputs_stay_as_they_are_and_may_be_read_only():
    case = batch(*SIZES)
    expected = kalman.smooth_positions(**case, passes=3)
    kept = {name: np.copy(value) for name, value in case.items()}
    for value in case.values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    for one, other in zip(kalman.smooth_positions(**case, passes=3), expected, strict=True):
        np.testing.assert_array_equal(one, other)
    for name, value in kept.items():
        np.testing.assert_array_equal(case[name], value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"passes": 0}, "passes >= 1"),
        ({"passes": -1}, "passes >= 1"),
        ({"anneal": 1.0}, "anneal < 1"),
        ({"anneal": -0.1}, "0 <= anneal"),
        ({"anneal": np.nan}, "0 <= anneal"),
        ({"q": 0.0}, "q must be positive"),
        ({"xy": np.zeros((6, 2))}, r"xy must have shape \(7, 2\)"),
        ({"xy": np.zeros((7, 3))}, r"xy must have shape \(7, 2\)"),
        ({"variance": np.ones(6)}, r"variance must have shape \(7,\)"),
        ({"variance": np.zeros(7)}, "variance must be positive"),
        ({"t": np.zeros(7)}, "strictly increasing"),
        ({"offsets": np.array([0, 3, 3, 7])}, "at least one sample"),
        ({"offsets": np.array([0, 3, 6])}, "from 0 to 7"),
        ({"initial_mean": np.zeros((2, 2, 3))}, r"initial_mean must have shape \(2, 2, 2\)"),
        ({"initial_cov": np.zeros((2, 2, 2))}, "positive definite"),
    ],
)
def test_what_cannot_be_smoothed_is_refused(change, message):
    case = batch(3, 4)
    with pytest.raises(ValueError, match=message):
        kalman.smooth_positions(**case | change)
