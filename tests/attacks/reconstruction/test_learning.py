"""Choosing by other people: the default without them, the best with them."""

from functools import partial

import numpy as np
import pytest
from helpers.walks import context, flat_release, smooth_walks

from attacks.reconstruction.gaussian_process import GaussianProcess
from attacks.reconstruction.kalman_rts import ImmRTS, KalmanRTS, RadialRTS
from attacks.reconstruction.learning import around, exposure_loss, smoother
from attacks.reconstruction.moving_windows import MovingAverage, Savgol
from isac_track.protocols import TrainingSet
from isac_track.rng import stream
from isac_track.types import Reconstruction

EPSILON_M = 0.5


def chosen(candidates, reconstruct):
    """What is chosen by two people; what was shared lies 1 m to the right of the truth."""
    truth = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [9.0, 9.0]])
    release = flat_release(
        np.array([0.0, 1.0, 2.0, 0.0]),
        truth + np.array([1.0, 0.0]),
        np.array([0, 3, 4]),
    )
    tried = []

    def smooth(release, _variance, candidate):
        tried.append(candidate)
        return Reconstruction(reconstruct(candidate, release))

    known = context(TrainingSet(release, truth), epsilon_m=EPSILON_M)
    smoother(known, smooth, candidates=candidates)(release)
    assert tried[:-1] == list(candidates)
    return tried[-1]


def shifted(left_m, release):
    return release.xy - [left_m, 0.0]


def compromised(candidate, release):
    off = (
        np.ones_like(release.xy)
        if candidate == "compromise"
        else np.zeros_like(release.xy)
    )
    off[3] += 100.0 * (candidate != "compromise")
    return shifted(1.0, release) + off


@pytest.mark.parametrize(
    ("candidates", "reconstruct", "best"),
    [
        ((0.0, 0.6, 1.1, 2.0), shifted, 1.1),
        # Half a metre off, both: the first.
        ((3.0, 0.5, 1.5), shifted, 0.5),
        # One hopeless person against all: a mean square would take the compromise.
        (("compromise", "exact but for one"), compromised, "exact but for one"),
    ],
)
def test_the_candidate_is_chosen_that_lets_least_leak(candidates, reconstruct, best):
    assert chosen(candidates, reconstruct) == best


def test_the_loss_by_hand():
    # Squares 0, 0.25, 1 of the first person: 0, 1/2, 4/5; 4 of the second: 16/17.
    gap = np.array([[0.0, 0.0], [0.3, 0.4], [0.0, -1.0], [2.0, 0.0]])
    truth = stream(0, "test", "loss").normal(0, 1, (4, 2))
    offsets = np.array([0, 3, 4])
    loss = exposure_loss(
        xy=truth + gap, truth=truth, offsets=offsets, epsilon_m=EPSILON_M
    )
    assert loss == pytest.approx(((0 + 1 / 2 + 4 / 5) / 3 + 16 / 17) / 2)


# what is learnt, as a keyword for each candidate, and whether more smooths more
LEARNERS = {
    MovingAverage: ([{"width_s": one} for one in around(2.8, factor=2.0)], True),
    Savgol: ([{"width_s": one} for one in around(6.5, factor=2.0)], True),
    KalmanRTS: ([{"q": one} for one in around(0.04, factor=4.0)], False),
    partial(RadialRTS, passes=5, own_motion=False): (
        [{"q": one} for one in around(0.04, factor=4.0)],
        False,
    ),
    ImmRTS: (
        [{"q": 0.03 * by, "q_turn": 0.12 * by} for by in (1 / 4, 1.0, 4.0)],
        False,
    ),
    GaussianProcess: (
        [{"length_s": 12.0, "scale_m": m} for m in around(2.5, factor=2.0)],
        False,
    ),
}


@pytest.mark.parametrize("attack", LEARNERS)
def test_training_chooses_for_the_walk_and_the_blind_take_the_default(attack):
    candidates, smooths = LEARNERS[attack]
    probe, _ = smooth_walks(400)
    by_choice = [attack(**one) for one in candidates]

    def place(fitted):
        """Which candidate gives the very same result."""
        xy = fitted(probe).xy
        (found,) = (
            number
            for number, one in enumerate(by_choice)
            if np.array_equal(one.fit(context())(probe).xy, xy)
        )
        return found

    chosen = {}
    for turn in (0.05, 2.5):
        release, truth = smooth_walks(*[200] * 6, turn=turn)
        train = context(TrainingSet(release, truth))
        learnt = attack().fit(train)
        chosen[turn] = place(learnt)
        assert np.mean((learnt(release).xy - truth) ** 2) < 0.4 * np.mean(
            (release.xy - truth) ** 2
        )
        assert [place(one.fit(train)) for one in by_choice] == [
            0,
            1,
            2,
        ]  # given, nothing is learnt
    assert (chosen[0.05] > chosen[2.5]) if smooths else (chosen[0.05] < chosen[2.5])
    assert place(attack().fit(context())) == 1


REFUSED = [
    *(
        (MovingAverage, {"width_s": one}, "width_s must be positive")
        for one in (0.0, np.nan)
    ),
    *((Savgol, {"width_s": one}, "width_s must be positive") for one in (-1.0, np.inf)),
    *((one, {"q": 0.0}, "q must be positive") for one in (KalmanRTS, RadialRTS)),
    *(
        (ImmRTS, {name: 0.0}, f"{name} must be positive")
        for name in ("walk_s", "turn_s")
    ),
    (RadialRTS, {"passes": 0}, "passes must be at least 1"),
    *(
        (RadialRTS, {"anneal": one}, r"anneal must lie in \[0, 1\)")
        for one in (1, -0.1, np.nan)
    ),
    (ImmRTS, {"q": 0.1}, "both q and q_turn"),
    (ImmRTS, {"q": 0.0, "q_turn": 0.1}, "q must be positive"),
    (ImmRTS, {"q": 0.1, "q_turn": np.nan}, "q_turn must be positive"),
    (GaussianProcess, {"length_s": 1.0}, "both length_s and scale_m"),
    (GaussianProcess, {"length_s": 0.0, "scale_m": 1.0}, "length_s must be positive"),
    (GaussianProcess, {"length_s": 1.0, "scale_m": np.nan}, "scale_m must be positive"),
]


@pytest.mark.parametrize(("attack", "parameters", "message"), REFUSED)
def test_impossible_parameters_are_refused(attack, parameters, message):
    with pytest.raises(ValueError, match=message):
        attack(**parameters)
