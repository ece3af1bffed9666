"""Hypothesis strategies for ragged batches, and the profile under which they run."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

# The same examples on every run: a failure is the code's, and mutants die or live for good.
reproducible = settings(derandomize=True, deadline=None, max_examples=100, database=None)

lengths_m = st.floats(-100.0, 100.0, allow_subnormal=False)
steps_s = st.floats(0.01, 3.0)


@st.composite
def batches(draw, *, min_samples=1):
    """Draw (leaked, t, offsets) of one to six tracks, each on its own clock."""
    sizes = draw(st.lists(st.integers(min_samples, 12), min_size=1, max_size=6))
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    total = int(offsets[-1])
    leaked = np.array(draw(st.lists(st.booleans(), min_size=total, max_size=total)))
    t = np.empty(total)
    for lo, hi in pairwise(offsets):
        gaps = draw(st.lists(steps_s, min_size=int(hi - lo), max_size=int(hi - lo)))
        t[lo:hi] = draw(st.floats(-50.0, 50.0)) + np.cumsum(gaps)
    return leaked, t, offsets


def points(shape):
    """Arrays of positions, m."""
    size = int(np.prod(shape))
    numbers = st.lists(lengths_m, min_size=size, max_size=size)
    return numbers.map(lambda values: np.array(values).reshape(shape))
