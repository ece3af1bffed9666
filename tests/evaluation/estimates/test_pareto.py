"""Pareto dominance against brute force over pairs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.estimates.pareto import beats, front

# A few values, so that ties are common.
VALUE = st.integers(0, 6).map(float) | st.just(np.nan)


@pytest.mark.parametrize("n_axes", [1, 2, 3])
@given(data=st.data())
def test_the_front_is_what_no_other_point_beats(n_axes, data):
    points = data.draw(st.lists(st.tuples(*[VALUE] * n_axes), max_size=12))
    values = np.array(points, dtype=float).reshape(-1, n_axes)

    def is_better(point, other):
        pairs = list(zip(point, other, strict=True))
        return all(a <= b for a, b in pairs) and any(a < b for a, b in pairs)

    expected = [[is_better(point, other) for other in points] for point in points]
    assert beats(values).tolist() == expected
    on_front = [
        not any(is_better(other, point) for other in points)
        and not any(map(np.isnan, point))
        for point in points
    ]
    assert front(values).tolist() == on_front


def test_equal_points_are_both_on_the_front():
    assert front(np.array([[1.0, 2.0], [1.0, 2.0], [2.0, 2.0]])).tolist() == [
        True,
        True,
        False,
    ]
