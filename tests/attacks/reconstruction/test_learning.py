"""Choosing by other people: the default without them, the best with them."""

from functools import partial

import numpy as np
import pytest
from helpers.walks import context, flat_release, smooth_walks

from attacks.reconstruction.gaussian_process import GaussianProcess
from attacks.reconstruction.kalman_rts import KalmanRTS, RadialRTS
from attacks.reconstruction.learning import (
    candidates_around,
    exposure_loss,
    make_smoother,
)
from attacks.reconstruction.moving_windows import MovingAverage, Savgol
from isac_track.protocols import TrainingSet
from isac_track.rng import stream
from isac_track.types import Reconstruction

EPSILON_M = 0.5


def chosen(candidates, reconstruct):
    """Return the candidate for two people, shared 1 m to the right of the truth."""
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
    make_smoother(known, smooth, candidates=candidates)(release)
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


# The learnt parameters of each candidate, and whether larger ones smooth more.
LEARNERS = {
    MovingAverage: (
        [{"width_s": width_s} for width_s in candidates_around(2.8, factor=2.0)],
        True,
    ),
    Savgol: (
        [{"width_s": width_s} for width_s in candidates_around(6.5, factor=2.0)],
        True,
    ),
    KalmanRTS: ([{"q": q} for q in candidates_around(0.04, factor=4.0)], False),
    partial(RadialRTS, passes=5, own_motion=False): (
        [{"q": q} for q in candidates_around(0.04, factor=4.0)],
        False,
    ),
    GaussianProcess: (
        [{"length_s": 12.0, "scale_m": m} for m in candidates_around(2.5, factor=2.0)],
        False,
    ),
}


@pytest.mark.parametrize("attack", LEARNERS)
def test_training_chooses_for_the_walk_and_the_blind_take_the_default(attack):
    candidates, smooths = LEARNERS[attack]
    probe, _ = smooth_walks(400)
    by_choice = [attack(**parameters) for parameters in candidates]

    def place(fitted):
        """Return the number of the only candidate with the very same result."""
        xy = fitted(probe).xy
        (number,) = (
            number
            for number, candidate in enumerate(by_choice)
            if np.array_equal(candidate.fit(context())(probe).xy, xy)
        )
        return number

    chosen = {}
    for turn in (0.05, 2.5):
        release, truth = smooth_walks(*[200] * 6, turn=turn)
        train = context(TrainingSet(release, truth))
        learnt = attack().fit(train)
        chosen[turn] = place(learnt)
        assert np.mean((learnt(release).xy - truth) ** 2) < 0.4 * np.mean(
            (release.xy - truth) ** 2
        )
        # A given parameter is not learnt.
        places = [place(candidate.fit(train)) for candidate in by_choice]
        assert places == [0, 1, 2]
    assert (chosen[0.05] > chosen[2.5]) if smooths else (chosen[0.05] < chosen[2.5])
    assert place(attack().fit(context())) == 1


REFUSED = [
    (MovingAverage, {"width_s": 0.0}, "width_s must be positive"),
    (MovingAverage, {"width_s": np.nan}, "width_s must be positive"),
    (Savgol, {"width_s": -1.0}, "width_s must be positive"),
    (Savgol, {"width_s": np.inf}, "width_s must be positive"),
    (KalmanRTS, {"q": 0.0}, "q must be positive"),
    (RadialRTS, {"q": 0.0}, "q must be positive"),
    (RadialRTS, {"passes": 0}, "passes must be at least 1"),
    (RadialRTS, {"anneal": 1}, r"anneal must lie in \[0, 1\)"),
    (RadialRTS, {"anneal": -0.1}, r"anneal must lie in \[0, 1\)"),
    (RadialRTS, {"anneal": np.nan}, r"anneal must lie in \[0, 1\)"),
    (GaussianProcess, {"length_s": 1.0}, "both length_s and scale_m"),
    (GaussianProcess, {"length_s": 0.0, "scale_m": 1.0}, "length_s must be positive"),
    (GaussianProcess, {"length_s": 1.0, "scale_m": np.nan}, "scale_m must be positive"),
]


@pytest.mark.parametrize(("attack", "parameters", "message"), REFUSED)
def test_impossible_parameters_are_refused(attack, parameters, message):
    with pytest.raises(ValueError, match=message):
        attack(**parameters)
