"""The strongest attack: one definition."""

import numpy as np
import pytest
from helpers.mechanisms import families_of

from evaluation.analysis.keys import Source
from evaluation.analysis.strongest import strongest, strongest_of
from isac_track.intervals import Estimate

SHAPE, DTW = Source("rerelease/shape", "blind"), Source("rerelease/dtw", "informed")
LEVELS = (("raw", None), ("fixed", 1.0), ("fid", 1.0))


def values(by, *, metric="rank1", levels=LEVELS):
    """Return what each attack achieves at each level: a number for all, or one for each."""
    return {
        source.measure(metric).at(*where): Estimate(achieved)
        for source, found in by.items()
        for where, achieved in zip(levels, np.broadcast_to(found, len(levels)), strict=True)
        if np.isfinite(achieved) or metric == "plr"
    }


OTHERS = (("raw", None), ("clean", None), ("mine:Ou", 1.0))
ALONE = values({SHAPE: (0.5, 0.9, 0.1), DTW: (0.4, 0.1, 0.3)}, levels=OTHERS)
ORACLE, CONTROL = Source("rerelease/dtw", "oracle"), Source("rerelease/control-times", "")
SMOOTHER = Source("kalman_rts", "informed")
AS_THEY_ARE = {Source("shared"): 0.9, Source("identity", "blind"): 0.8}


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        # The highest mean over raw, fixed noise and FID; of equals the first of the run.
        (values({SHAPE: (0.9, 0.1, 0.1), DTW: 0.4}), {"rerelease": DTW}),
        (values({DTW: 0.4, SHAPE: 0.4}), {"rerelease": DTW}),
        # Neither the oracle nor a control is one, nor who takes positions as they are.
        *((values({SHAPE: 0.1, other: 0.9}), {"rerelease": SHAPE}) for other in (ORACLE, CONTROL)),
        *((values({other: 0.9}), {}) for other in (ORACLE, CONTROL)),
        (values(AS_THEY_ARE | {SMOOTHER: 0.3}, metric="plr"), {"": SMOOTHER}),
        # It ran at all levels that any did.
        (values({SHAPE: 0.3, DTW: (0.9, np.nan, 0.9)}), {"rerelease": SHAPE}),
        # Other mechanisms do not move it unless there is nothing else.
        (ALONE, {"rerelease": DTW}),
        (ALONE | values({SHAPE: 0.5, DTW: 0.4}), {"rerelease": SHAPE}),
    ],
)
def test_which_it_is(found, expected):
    assert strongest(found, families_of(found)) == expected


def test_its_mean_is_a_number():
    assert strongest_of([{SHAPE: 0.3, DTW: np.nan}]) == SHAPE
    assert strongest_of([]) is None
