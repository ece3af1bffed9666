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


def best(found):
    return strongest(found, families_of(found))


def test_it_has_the_highest_mean_over_raw_fixed_and_fid():
    assert best(values({SHAPE: (0.9, 0.1, 0.1), DTW: 0.4})) == {"rerelease": DTW}


@pytest.mark.parametrize(
    "other", [Source("rerelease/dtw", "oracle"), Source("rerelease/control-times", "")]
)
def test_neither_the_oracle_nor_a_control_is_one(other):
    assert best(values({SHAPE: 0.1, other: 0.9})) == {"rerelease": SHAPE}
    assert best(values({other: 0.9})) == {}


def test_who_takes_positions_as_they_are_is_no_reconstruction():
    smoother = Source("kalman_rts", "informed")
    shared, control = Source("shared"), Source("identity", "blind")
    found = values({shared: 0.9, control: 0.8, smoother: 0.3}, metric="plr")
    assert best(found) == {"": smoother}


def test_it_ran_at_all_levels_that_any_did_and_its_mean_is_a_number():
    assert best(values({SHAPE: 0.3, DTW: (0.9, np.nan, 0.9)})) == {"rerelease": SHAPE}
    rows = [{SHAPE: 0.3, DTW: np.nan}]
    assert strongest_of(rows) == SHAPE
    assert strongest_of([]) is None


def test_other_mechanisms_do_not_move_it_unless_there_is_nothing_else():
    levels = (("raw", None), ("clean", None), ("mine:Ou", 1.0))
    alone = values({SHAPE: (0.5, 0.9, 0.1), DTW: (0.4, 0.1, 0.3)}, levels=levels)
    assert best(alone) == {"rerelease": DTW}
    assert best(alone | values({SHAPE: 0.5, DTW: 0.4})) == {"rerelease": SHAPE}


def test_of_equals_the_first_of_the_run_counts():
    assert best(values({DTW: 0.4, SHAPE: 0.4})) == {"rerelease": DTW}
