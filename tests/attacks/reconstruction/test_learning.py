"""Choosing by other people: the default without them, the best with them, the first of equals."""

import numpy as np
import pytest

from attacks.reconstruction.learning import choose, exposure_loss
from isac_track.protocols import AttackContext, TrainingSet
from isac_track.rng import stream
from isac_track.types import Knowledge, Release

EPSILON_M = 0.5


def training():
    """Two people; what was shared lies 1 m to the right of the truth."""
    truth = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [9.0, 9.0]])
    release = Release(
        t=np.array([0.0, 1.0, 2.0, 0.0]),
        xy=truth + np.array([1.0, 0.0]),
        sigma=None,
        offsets=np.array([0, 3, 4]),
        pseudonym=("p", "q"),
    )
    return TrainingSet(release, truth)


def context(train):
    return AttackContext(
        rng=stream(0, "test"),
        epsilon_m=EPSILON_M,
        granted=frozenset() if train is None else frozenset({Knowledge.TRAIN}),
        train=train,
    )


def shifted(left_m, release):
    return release.xy - [left_m, 0.0]


def test_without_training_it_is_the_default_and_nothing_is_tried():
    def never(_candidate, _release):
        raise AssertionError

    assert choose(context(None), default="d", candidates=("a", "b"), reconstruct=never) == "d"


def test_with_training_the_best_candidate_even_if_the_default_is_none_of_them():
    found = choose(
        context(training()), default=7.0, candidates=(0.0, 0.6, 1.1, 2.0), reconstruct=shifted
    )
    assert found == 1.1


def test_of_equals_the_first():
    found = choose(
        context(training()),
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
    found = choose(context(train), default=None, candidates=candidates, reconstruct=reconstruct)
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

    def test_nothing_for_the_truth_itself_and_one_for_hopeless_errors(self):
        truth = np.zeros((3, 2))
        offsets = np.array([0, 2, 3])
        assert exposure_loss(xy=truth, truth=truth, offsets=offsets, epsilon_m=EPSILON_M) == 0.0
        far = exposure_loss(xy=truth + 1e6, truth=truth, offsets=offsets, epsilon_m=EPSILON_M)
        assert far == pytest.approx(1.0)
