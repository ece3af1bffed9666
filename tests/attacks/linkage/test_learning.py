"""Learning from ranks: by hand, and the scores that are asked for."""

import numpy as np
import pytest
from helpers.walks import context, two_releases

from attacks.linkage.learning import MARGIN, learn_parameters, log_rank
from attacks.remembered import find_origin
from isac_track.protocols import LinkageTrainingSet

N = 12
TRAIN = LinkageTrainingSet(*two_releases(N))


def ranked(n_ahead, mate):
    """Scores in which so many people, 0 to N - 1, come before each mate."""
    scores = np.zeros((mate.size, mate.size))
    for row, own in enumerate(mate):
        scores[row, np.delete(np.arange(mate.size), own)[:n_ahead]] = 1.0
        scores[row, own] = 0.5
    return scores


def learnt(options, n_ahead, *, train=TRAIN):
    """Return the learnt values, and the choices whose scores were asked for."""
    asked = []

    def scores(known):
        assert known is train
        return lambda *choice: (
            asked.append(choice) or ranked(n_ahead(*choice), known.mate)
        )

    return learn_parameters(context(train), options, scores=scores), asked


def test_log_rank_by_hand():
    scores = np.array(
        [[3.0, 1.0, 2.0], [0.0, 5.0, 5.0], [1.0, 2.0, 0.0], [9.0, 9.0, 9.0]]
    )
    mate = np.array([0, 1, 2, -1])
    assert log_rank(scores, mate=mate) == pytest.approx(np.log([1.0, 1.5, 3.0]).mean())


def test_learning_takes_one_parameter_after_the_other():
    best, asked = learnt(
        ((1, 4, 9), (7,), (3, 8)), lambda a, b, c: abs(a - 5) + abs(c - 7) + b - 7
    )
    assert best == (4, 7, 8)
    # The first parameter keeps its value while the others are learnt.
    assert asked == [(1, 7, 3), (4, 7, 3), (9, 7, 3), (4, 7, 8)]


@pytest.mark.parametrize(("share", "best"), [(0.5, 1), (2.0, 2)])
def test_only_a_gain_of_the_margin_moves_from_the_default(share, best):
    # One mate of ROWS has one person less before it: a gain of log 2 / rows.
    train = LinkageTrainingSet(*two_releases(int(np.log(2) / (share * MARGIN))))
    default = ranked(1, train.mate)
    better = np.concatenate([ranked(0, train.mate)[:1], default[1:]])
    scores = {1: default, 2: better}.__getitem__
    assert learn_parameters(context(train), ((1, 2),), scores=lambda _: scores) == (
        best,
    )


def test_without_a_choice_or_a_teacher_nothing_is_asked():
    few = LinkageTrainingSet(
        TRAIN.probe, TRAIN.gallery, np.where(np.arange(N) < 7, TRAIN.mate, -1)
    )
    for options, train in (
        (((1,), (3,)), TRAIN),
        (((1, 2), (3, 4)), None),
        (((1, 2), (3,)), few),
    ):
        assert learnt(options, None, train=train) == ((1, 3), [])


def test_few_mates_are_the_mates():
    known, taught = np.where(np.arange(N) % 2 == 0, TRAIN.mate, -1), []
    known[1], known[11] = TRAIN.mate[[1, 11]]  # eight of them

    def scores(few):
        assert few.mate.tolist() == [0, 1, 2, 3]
        taught.extend(
            find_origin(side)[1].tolist() for side in (few.probe, few.gallery)
        )
        return lambda _: ranked(1, few.mate)

    learn_parameters(
        context(LinkageTrainingSet(TRAIN.probe, TRAIN.gallery, known)),
        ((1, 2),),
        scores=scores,
        most=4,
    )
    rows = [0, 1, 2, 4]
    assert taught == [rows, TRAIN.mate[rows].tolist()]
