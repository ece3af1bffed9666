"""Choosing by other people: the default without them, the best with them, the first of equals."""

import numpy as np
import pytest
from helpers.walks import context, flat_release, smooth_walks

from attacks.reconstruction import (
    gaussian_process,
    imm_rts,
    kalman_rts,
    moving_average,
    radial_rts,
    savgol,
)
from attacks.reconstruction.learning import choose, exposure_loss
from isac_track.protocols import TrainingSet
from isac_track.rng import stream

EPSILON_M = 0.5


def training():
    """Two people; what was shared lies 1 m to the right of the truth."""
    truth = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [9.0, 9.0]])
    release = flat_release(
        np.array([0.0, 1.0, 2.0, 0.0]), truth + np.array([1.0, 0.0]), np.array([0, 3, 4])
    )
    return TrainingSet(release, truth)


def shifted(left_m, release):
    return release.xy - [left_m, 0.0]


def test_without_training_it_is_the_default_and_nothing_is_tried():
    def never(_candidate, _release):
        raise AssertionError

    assert choose(context(), default="d", candidates=("a", "b"), reconstruct=never) == "d"


def test_with_training_the_best_candidate_even_if_the_default_is_none_of_them():
    found = choose(
        context(training(), epsilon_m=EPSILON_M),
        default=7.0,
        candidates=(0.0, 0.6, 1.1, 2.0),
        reconstruct=shifted,
    )
    assert found == 1.1


def test_of_equals_the_first():
    found = choose(
        context(training(), epsilon_m=EPSILON_M),
        default=None,
        candidates=((3.0, "far"), (0.5, "short"), (1.5, "long")),  # half a metre off, both
        reconstruct=lambda candidate, release: shifted(candidate[0], release),
    )
    assert found == (0.5, "short")


def test_the_distance_that_leaks_is_what_counts():
    # One hopeless person against all: a mean square would take the compromise.
    train = training()

    def reconstruct(candidate, release):
        xy = release.xy - [1.0, 0.0]
        if candidate == "exact but for one":
            xy[3] += 100.0
        else:
            xy += 1.0
        return xy

    candidates = ("compromise", "exact but for one")
    found = choose(
        context(train, epsilon_m=EPSILON_M),
        default=None,
        candidates=candidates,
        reconstruct=reconstruct,
    )
    assert found == "exact but for one"


class TestExposureLoss:
    def test_by_hand(self):
        # Squares 0, 0.25, 1 of the first person: 0, 1/2, 4/5; 4 of the second: 16/17.
        gap = np.array([[0.0, 0.0], [0.3, 0.4], [0.0, -1.0], [2.0, 0.0]])
        truth = stream(0, "test", "loss").normal(0, 1, (4, 2))
        loss = exposure_loss(
            xy=truth + gap, truth=truth, offsets=np.array([0, 3, 4]), epsilon_m=EPSILON_M
        )
        assert loss == pytest.approx(((0 + 1 / 2 + 4 / 5) / 3 + 16 / 17) / 2)


LEARNERS = {  # class, candidates, what they are candidates for, and whether more of it smooths more
    "moving_average": (moving_average.MovingAverage, moving_average, ("width_s",), True),
    "savgol": (savgol.Savgol, savgol, ("width_s",), True),
    "kalman_rts": (kalman_rts.KalmanRTS, kalman_rts, ("q",), False),
    "radial_rts": (radial_rts.RadialRTS, radial_rts, ("q",), False),
    "imm_rts": (imm_rts.ImmRTS, imm_rts, ("q", "q_turn"), False),
    "gaussian_process": (
        gaussian_process.GaussianProcess,
        gaussian_process,
        ("length_s", "scale_m"),
        False,
    ),
}


@pytest.mark.parametrize("name", LEARNERS)
def test_training_chooses_for_the_walk_and_the_blind_take_the_default(name):
    attack, module, fields, smooths = LEARNERS[name]
    probe, _ = smooth_walks(400)
    by_choice = [
        attack(**dict(zip(fields, np.atleast_1d(choice).tolist(), strict=True)))
        for choice in module.CANDIDATES
    ]

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
        assert np.mean((learnt(release).xy - truth) ** 2) < 0.4 * np.mean((release.xy - truth) ** 2)
        assert [place(one.fit(train)) for one in by_choice] == [0, 1, 2]  # given, nothing is learnt
    assert (chosen[0.05] > chosen[2.5]) if smooths else (chosen[0.05] < chosen[2.5])
    assert place(attack().fit(context())) == 1


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        *(
            (name, {"width_s": width_s}, "width_s must be positive")
            for name in ("moving_average", "savgol")
            for width_s in (0.0, -1.0, np.nan, np.inf)
        ),
        *(
            (name, {"q": q}, "q must be positive")
            for name in ("kalman_rts", "radial_rts")
            for q in (0.0, -1.0, np.nan, np.inf)
        ),
        ("radial_rts", {"passes": 0}, "passes must be at least 1"),
        *(
            ("radial_rts", {"anneal": anneal}, r"anneal must lie in \[0, 1\)")
            for anneal in (1.0, -0.1, np.nan)
        ),
        ("imm_rts", {"q": 0.1}, "both q and q_turn"),
        ("imm_rts", {"q": 0.0, "q_turn": 0.1}, "q must be positive"),
        ("imm_rts", {"q": 0.1, "q_turn": np.nan}, "q_turn must be positive"),
        ("imm_rts", {"walk_s": -1.0}, "walk_s must be positive"),
        ("imm_rts", {"turn_s": np.inf}, "turn_s must be positive"),
        ("gaussian_process", {"length_s": 1.0}, "both length_s and scale_m"),
        ("gaussian_process", {"length_s": 0.0, "scale_m": 1.0}, "length_s must be positive"),
        ("gaussian_process", {"length_s": 1.0, "scale_m": np.nan}, "scale_m must be positive"),
        ("gaussian_process", {"smoothness": "rbf"}, "smoothness must be one of"),
        ("gaussian_process", {"engine": "gpy"}, "engine must be one of"),
    ],
)
def test_impossible_parameters_are_refused(name, parameters, message):
    with pytest.raises(ValueError, match=message):
        LEARNERS[name][0](**parameters)
