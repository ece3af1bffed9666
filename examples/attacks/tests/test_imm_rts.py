"""The smoother of two motions against dense matrices and every path of modes."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import oracles
import pytest
from further_attacks.imm_rts import ImmRTS, smooth_moods
from further_attacks.parameters import PRIOR_STD
from hypothesis import given, settings
from hypothesis import strategies as st
from walks import context, smooth_walks

from attacks.building_blocks import make_attack
from isac_track import kalman
from isac_track.protocols import TrainingSet
from isac_track.rng import stream
from isac_track.types import Knowledge

Q = 0.04
MOODS = kalman.Moods((0.05, 4.0), (2.5, 1.25))
RATES = np.diag(1.0 / np.array(MOODS.stay_s)) @ [[-1, 1], [1, -1]]
TOLERANCE_M = 1e-9


def make_batch(*, sizes=(30, 1, 6), seed=0, prior_std=(1.3, 0.8)):
    """Walks with irregular steps and noise, that now and then dart off."""
    rng, total = stream(seed, "test", "moods"), sum(sizes)
    t = [rng.uniform(-50, 50) + rng.uniform(0.02, 0.9, size).cumsum() for size in sizes]
    darts = (rng.uniform(size=(total, 1)) < 0.2) * rng.normal(0, 1.0, (total, 2))
    walk = rng.normal(0, 0.3, (total, 2)).cumsum(axis=0) + darts.cumsum(axis=0)
    return kalman.Batch(
        t=np.concatenate([np.zeros(0), *t]),
        xy=walk,
        variance=rng.uniform(0.01, 0.3, total),
        offsets=np.cumsum([0, *sizes]),
        prior_std=prior_std,
    )


def tracks(batch, **model):
    """The samples of each track, and the arguments of the dense solution."""
    for low, high in pairwise(batch.offsets):
        rows = slice(low, high)
        arrays = {name: getattr(batch, name)[rows] for name in ("t", "xy", "variance")}
        mean = np.column_stack([batch.xy[low], np.zeros(2)])
        prior = {"mean": mean, "cov": np.diag(batch.prior_std) ** 2}
        yield rows, arrays | prior | model


def close(value, expected, tolerance=TOLERANCE_M):
    np.testing.assert_allclose(value, expected, rtol=0, atol=tolerance)


def test_the_way_back_is_that_of_the_textbook():
    batch = make_batch()
    position, variance = smooth_moods(batch, MOODS)
    states = kalman.imm_states(batch, MOODS)
    for low, high in pairwise(batch.offsets):
        rows = slice(low, high)
        slow = oracles.imm_smooth(
            t=batch.t[rows],
            q=MOODS.q,
            rates=RATES,
            mean=states.mean[rows].reshape(-1, 2, 4),
            cov=states.cov[rows],
            probability=states.probability[rows],
        )
        parts = zip(slow["probability"], slow["mean"], slow["cov"], strict=True)
        for row, part in zip(range(low, high), parts, strict=True):
            mean, cov = oracles.collapse(*part)
            close(position[row], mean[::2])
            close(variance[row], (cov[0, 0] + cov[2, 2]) / 2)


def test_it_is_near_the_sum_over_every_path_of_modes():
    """The only exact answer: 2^8 Kalman smoothers. The filter is far from it."""
    away = {"filter": [], "smoother": []}
    for seed in range(6):
        batch = make_batch(sizes=(8,), seed=seed)
        model = {"q": MOODS.q, "rates": RATES, "probability": MOODS.probability}
        ((_, track),) = tracks(batch, **model)
        exact = oracles.imm_exact(**track)
        states = kalman.imm_states(batch, MOODS)
        filtered = np.einsum("kj,kjad->kad", states.probability, states.mean)[..., 0]
        position, variance = smooth_moods(batch, MOODS)
        for name, estimate in (("filter", filtered), ("smoother", position)):
            error = np.abs(estimate - exact)
            away[name].append(error / np.sqrt(variance)[:, None])
    assert np.mean(away["smoother"]) < 0.25
    assert np.mean(away["smoother"]) < np.mean(away["filter"]) / 3


def test_a_mood_that_never_ends_is_one_model():
    batch = make_batch()
    position, variance = smooth_moods(batch, kalman.Moods((0.5, 4.0), (1e15, 1e-6)))
    for rows, track in tracks(batch, q=0.5):
        mean, cov, _ = oracles.joint_posterior(**track)
        close(position[rows], mean[:, :, 0], 1e-8)
        close(variance[rows], cov[:, 0, 0], 1e-8)


@st.composite
def hard_batches(draw):
    """Two tracks over five decades of noise and four of steps."""
    sizes = draw(st.lists(st.integers(1, 9), min_size=2, max_size=2))
    total = sum(sizes)

    def numbers(low, high):
        values = st.lists(st.floats(low, high), min_size=total, max_size=total)
        return np.array(draw(values))

    return kalman.Batch(
        t=(10.0 ** numbers(-3, 1)).cumsum(),
        xy=np.stack([numbers(-50, 50), numbers(-50, 50)], axis=1),
        variance=(10.0 ** numbers(-3, 2)) ** 2,
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        prior_std=(100.0, 2.0),
    )


@settings(derandomize=True, deadline=None, max_examples=100, database=None)
@given(batch=hard_batches())
def test_sound_over_five_decades_of_noise_and_four_of_steps(batch):
    position, variance = smooth_moods(batch, MOODS)
    assert np.isfinite(position).all()
    assert np.isfinite(variance).all()
    assert (variance > 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_no_bit_depends_on_which_other_tracks_are_there(seed):
    sizes = (1, 2, 3, 7, 7, 30)
    batch = make_batch(sizes=sizes, seed=seed)
    together = smooth_moods(batch, MOODS)
    for rows, track in tracks(batch):
        arrays = {name: track[name] for name in ("t", "xy", "variance")}
        n_samples = rows.stop - rows.start
        alone = replace(batch, **arrays, offsets=np.array([0, n_samples]))
        for values, expected in zip(together, smooth_moods(alone, MOODS), strict=True):
            np.testing.assert_array_equal(values[rows], expected)


def test_no_track_at_all():
    nothing = make_batch(sizes=())
    position, variance = smooth_moods(nothing, MOODS)
    assert (position.shape, variance.shape) == ((0, 2), (0,))


def test_a_prior_of_another_model_is_named():
    with pytest.raises(ValueError, match="prior_std must have two"):
        smooth_moods(make_batch(prior_std=(1.0,)), MOODS)


def test_equal_modes_are_a_single_model():
    release, _ = smooth_walks(60, 1, 2, 3, 150)
    attacks = ImmRTS(q=Q, q_turn=Q), make_attack(f"kalman_rts:q={Q}")
    two_modes, single = (attack.fit(context())(release) for attack in attacks)
    assert np.allclose(two_modes.xy, single.xy, atol=1e-7)
    assert np.allclose(two_modes.std, single.std, atol=1e-7)


def test_the_two_moods_last_as_long_as_the_attack_says():
    release, _ = smooth_walks(60)
    declared = replace(release, sigma=np.full(60, 0.5))
    attack = ImmRTS(q=0.01, q_turn=0.5, walk_s=6.0, turn_s=1.0)
    result = attack.fit(context(granted={Knowledge.SIGMA}))(declared)
    variance = np.full(60, 0.125)
    batch = kalman.Batch(release.t, release.xy, variance, release.offsets, PRIOR_STD)
    position, _ = smooth_moods(batch, kalman.Moods((0.01, 0.5), (6.0, 1.0)))
    assert np.array_equal(result.xy, position)


def test_training_chooses_for_the_walk_and_the_blind_take_the_default():
    choices = [ImmRTS(q=0.03 * by, q_turn=0.12 * by) for by in (1 / 4, 1.0, 4.0)]
    probe, _ = smooth_walks(400)

    def place(fitted):
        """Return the number of the only choice with the very same result."""
        xy = fitted(probe).xy
        (number,) = (
            number
            for number, choice in enumerate(choices)
            if np.array_equal(choice.fit(context())(probe).xy, xy)
        )
        return number

    learnt_place = {}
    for turn in (0.05, 2.5):
        release, truth = smooth_walks(*[200] * 6, turn=turn)
        train = context(TrainingSet(release, truth))
        learnt = ImmRTS().fit(train)
        learnt_place[turn] = place(learnt)
        error_m2 = np.mean((learnt(release).xy - truth) ** 2)
        assert error_m2 < 0.4 * np.mean((release.xy - truth) ** 2)
        # A given parameter is not learnt.
        assert [place(choice.fit(train)) for choice in choices] == [0, 1, 2]
    assert learnt_place[0.05] < learnt_place[2.5]
    assert place(ImmRTS().fit(context())) == 1


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"walk_s": 0.0}, "walk_s must be positive"),
        ({"turn_s": 0.0}, "turn_s must be positive"),
        ({"q": 0.1}, "both q and q_turn"),
        ({"q": 0.0, "q_turn": 0.1}, "q must be positive"),
        ({"q": 0.1, "q_turn": np.nan}, "q_turn must be positive"),
    ],
)
def test_parameters_that_cannot_be_are_named(parameters, message):
    with pytest.raises(ValueError, match=message):
        ImmRTS(**parameters)
