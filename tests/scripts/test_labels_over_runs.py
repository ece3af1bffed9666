"""Neighbours in a queue tell whether labels last over runs."""

import numpy as np
from labels_over_runs import compare, neighbours, successors

from isac_track.rng import stream

LAP = ["a", "b", "c", "d", "e", "f", "g", "h"]


def pairs(*texts):
    return frozenset(frozenset(text) for text in texts)


def test_neighbours_are_those_who_mostly_follow_each_other():
    people = [*LAP, *LAP, "c", "a", "unlabelled x", "b"]
    assert successors(people)["a"] == {"b": 2, "unlabelled x": 1}
    assert neighbours(people) == pairs("ab", "bc", "cd", "de", "ef", "fg", "gh", "ha")


def test_company_that_stays_together_is_told_from_labels_that_are_dealt_anew():
    first = neighbours([*LAP, "a"])
    same_company = neighbours(["d", "c", "h", "g", "b", "a", "f", "e"])
    shared = compare(first, same_company, rng=stream(0, "test"), n_draws=2000)
    assert shared.pairs == pairs("cd", "gh", "ab", "ef")
    assert shared.n_people == 8
    # Of 7 pairs each is among 8 of 28 with equal chance.
    np.testing.assert_allclose(shared.expected, 7 * 8 / 28, atol=0.1)
    dealt_anew = neighbours(["a", "c", "e", "g", "b", "d", "f", "h"])
    assert compare(first, dealt_anew, rng=stream(0, "test"), n_draws=2000).p > 0.1
