"""The control hands back what it was given."""

import numpy as np

from attacks.reconstruction.identity import Identity
from isac_track.protocols import AttackContext
from isac_track.rng import stream
from isac_track.types import Release


def test_the_very_positions_come_back():
    xy = stream(0, "test", "identity").normal(0, 500, (9, 2))
    release = Release(
        t=np.arange(9.0),
        xy=xy,
        sigma=None,
        offsets=np.array([0, 1, 9]),
        pseudonym=("p", "q"),
    )
    context = AttackContext(rng=stream(0, "test"), epsilon_m=0.3)
    found = Identity().fit(context)(release)
    np.testing.assert_array_equal(found.xy, xy)
    assert found.std is None
