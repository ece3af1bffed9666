"""Holm's adjustment, against the closed test that it is a short cut for."""

import itertools

import numpy as np
import pytest

from evaluation.analysis.significance import holm


def test_a_hand_example():
    assert holm(np.array([0.01, 0.04, 0.03, 0.005])) == pytest.approx([0.03, 0.06, 0.06, 0.02])


def test_it_is_the_closed_test_by_bonferroni():
    # A number differs if every set that it belongs to holds a difference, by Bonferroni.
    p_values = np.random.default_rng(0).uniform(0, 0.4, 6)
    sets = [list(one) for size in range(1, 7) for one in itertools.combinations(range(6), size)]
    closed = [
        max(min(1.0, len(of) * p_values[of].min()) for of in sets if n in of) for n in range(6)
    ]
    assert holm(p_values) == pytest.approx(closed)


def test_what_is_unknown_stays_so_and_does_not_count():
    found = holm(np.array([0.02, np.nan, 0.01]))
    assert found == pytest.approx([0.02, np.nan, 0.02], nan_ok=True)
