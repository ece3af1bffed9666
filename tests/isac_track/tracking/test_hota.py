"""HOTA by hand and against its authors' program."""

import numpy as np
import pytest

from isac_track.tracking.blocks import block_hota
from isac_track.tracking.hota import LEVELS, Places, hota_parts

PEOPLE = [
    *((0, 0, 0.17, 0.47), (0, 1, 1.6, 1.16), (0, 2, 0.19, 0.87)),
    *((1, 1, 1.52, 1.5), (1, 2, 0.21, 0.83)),
    *((2, 0, -0.23, 0.43), (2, 1, 1.43, 1.83), (2, 2, 0.23, 0.8)),
    *((3, 1, 1.34, 2.16), (3, 2, 0.26, 0.76)),
    *((4, 0, -0.64, 0.38), (4, 1, 1.26, 2.49), (4, 2, 0.28, 0.73)),
    *((5, 0, -0.84, 0.36), (5, 1, 1.17, 2.83), (5, 2, 0.3, 0.69)),
]
TRACKS = [
    *((0, 0, -0.07, 0.4), (0, 2, 0.21, 1.04)),
    *((1, 1, 1.78, 1.26), (1, 2, 0.28, 1.01)),
    *((2, 0, -0.5, 0.44), (2, 1, 1.78, 2.02), (2, 2, 0.51, 0.75)),
    *((3, 0, 1.49, 2.31), (3, 3, 0.06, 0.82)),
    *((4, 1, -0.47, 0.5), (4, 0, 1.28, 2.25)),
    *((5, 1, -1.07, 0.54), (5, 3, 0.05, 0.15)),
]
TRACKEVAL_1_3_0 = 0.39153725630871933
"""Mean of `HOTA().eval_sequence` over its levels; tracks swap and end at scan 3."""


def places(rows):
    """Rows of scan, number, x and y."""
    table = np.array(rows, dtype=float).reshape(-1, 4)
    scan, number = table[:, :2].astype(int).T
    return Places(scan, number, table[:, 2:])


def standing(*tracks, n_scans=10):
    """HOTA of tracks (first scan, end, x) of a person who stands at 0 all the time."""
    person = [(scan, 0, 0.0, 0.0) for scan in range(n_scans)]
    rows = [
        (scan, number, x, 0.0)
        for number, (first, end, x) in enumerate(tracks)
        for scan in range(first, end)
    ]
    return hota_parts(places(person), places(rows), n_scans=n_scans)


def test_is_that_of_its_authors_program():
    parts = hota_parts(places(PEOPLE), places(TRACKS), n_scans=6)
    assert parts.hota == pytest.approx(TRACKEVAL_1_3_0, rel=1e-12)


def test_by_hand():
    assert standing((0, 10, 0.0)).hota == pytest.approx(1.0)
    # Two tracks of 6 and 4 scans: AssA is 0.6^2 + 0.4^2, DetA is 1.
    assert standing((0, 6, 0.0), (6, 10, 0.0)).hota == pytest.approx(0.52**0.5)
    # Half of the scans are missed: DetA and AssA are 0.5.
    assert standing((0, 5, 0.0)).hota == pytest.approx(0.5)
    # A track of nobody halves DetA.
    assert standing((0, 10, 0.0), (0, 10, 9.0)).hota == pytest.approx(0.5**0.5)
    # Of 19 least similarities 15 are below 0.78.
    assert standing((0, 10, 0.22)).hota == pytest.approx(15 / 19)


def test_without_tracks_it_is_0_and_without_people_unknown():
    assert standing().hota == 0.0
    assert np.isnan(hota_parts(places([]), places([]), n_scans=3).hota)


def test_blocks_add_up_to_the_recording():
    parts = hota_parts(places(PEOPLE), places(TRACKS), n_scans=6)
    association, n_union = (
        np.stack([part[:3].sum(0), part[3:].sum(0)], axis=1)[..., None]
        for part in (parts.association, parts.n_union)
    )
    assert n_union.shape == (LEVELS.size, 2, 1)
    estimate = block_hota(association=association, n_union=n_union, seed=0)
    assert estimate.value == pytest.approx(TRACKEVAL_1_3_0)
    assert np.isnan(estimate.ci_low)  # Two blocks are too few.


def test_refuses_a_cut_off_of_0():
    with pytest.raises(ValueError, match="cutoff_m"):
        hota_parts(places(PEOPLE), places(TRACKS), n_scans=6, cutoff_m=0.0)
