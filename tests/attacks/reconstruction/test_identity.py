"""The control hands back what it was given."""

import numpy as np
from helpers.walks import context, smooth_walks

from attacks.reconstruction.identity import Identity


def test_the_very_positions_come_back():
    release, _ = smooth_walks(1, 8)
    found = Identity().fit(context())(release)
    np.testing.assert_array_equal(found.xy, release.xy)
    assert found.std is None
