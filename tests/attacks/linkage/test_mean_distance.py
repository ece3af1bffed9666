"""The mean distance at equal instants, by hand."""

import numpy as np
import pytest

from attacks.linkage.mean_distance import MeanDistance
from isac_track.protocols import AttackContext
from isac_track.types import Knowledge, Release


def release(*walks):
    """Return a release of walks, each a pair of instants and places."""
    t, xy = (np.concatenate(values) for values in zip(*walks, strict=True))
    offsets = np.cumsum([0, *(len(values) for values, _ in walks)])
    names = tuple(f"p{n}" for n in range(len(walks)))
    return Release(
        t=t.astype(float),
        xy=xy.astype(float),
        sigma=None,
        offsets=offsets,
        pseudonym=names,
    )


def line(start_s, end_s, *, shift_m):
    """Return a walk along x, `shift_m` beside it."""
    t = np.linspace(start_s, end_s, 40)
    return t, np.column_stack([t, np.full(40, shift_m)])


def test_it_is_the_mean_distance_where_both_were_there():
    granted = frozenset({Knowledge.SCENE})
    context = AttackContext(
        rng=np.random.default_rng(0), epsilon_m=0.3, granted=granted
    )
    link = MeanDistance().fit(context)
    probe = release(line(0.0, 10.0, shift_m=0.0), (np.array([3.1]), np.zeros((1, 2))))
    gallery = release(
        line(5.0, 15.0, shift_m=2.0),
        line(9.0, 20.0, shift_m=0.0),
        line(30.0, 40.0, shift_m=0.0),
    )
    scores = link(probe, gallery)
    assert scores[0, 0] == pytest.approx(-2.0)
    assert (scores[0, 1:] < -1e5).all()
    assert (scores[1] < -1e5).all()
