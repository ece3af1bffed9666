"""The strongest attack: one definition."""

import numpy as np
import pytest
from helpers.mechanisms import families_of

from evaluation.analysis.keys import Source
from evaluation.analysis.strongest import cross_fitted, strongest, strongest_of
from evaluation.runs.cell_files import Summed
from isac_track.intervals import Estimate, cluster_weights
from isac_track.rng import stream

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


def test_what_one_half_chose_is_scored_on_the_other():
    """Against sums by hand: who is good on one half of the people is not that good on the other."""
    rng = np.random.default_rng(0)
    n, first, second = 60, Source("kalman_rts", "blind"), Source("radial_rts", "blind")
    weights = cluster_weights(n_clusters=n, n_replicates=50, seed=0)
    tracks = rng.integers(0, 5, n).astype(float)
    used = np.flatnonzero(tracks)  # the others are in no scene, and are not kept
    assert used.size < n
    is_first = stream(7, "strongest", "halves").permutation(n) < n / 2
    own = {first: np.where(is_first, 0.9, 0.1), second: np.where(is_first, 0.2, 0.8)}
    shares = {source: share * tracks for source, share in own.items()}
    every = {
        source.measure(metric).at(*where): np.stack([share * rng.random(n), tracks])
        for where in LEVELS
        for source, share in shares.items()
        for metric in ("plr", "mel")
    }
    sums = {key: Summed(one[:, used], weights, used) for key, one in every.items()}
    found, halves = cross_fitted(sums, known := families_of(sums), first, seed=7)
    assert halves == [first, second]
    for key in (first.measure(metric).at(*where) for where in LEVELS for metric in ("plr", "mel")):
        theirs = every[second.measure(key.metric).at(*key.where)][0]
        scored = np.where(is_first, theirs, every[key][0])
        assert found[key].value == pytest.approx(scored.sum() / tracks.sum())
        assert found[key].replicates == pytest.approx(weights @ scored / (weights @ tracks))
    assert found[first.measure("plr").at("raw", None)].value < 0.2
    # Where both halves choose the headline its own estimates stand.
    alone = {key: one for key, one in sums.items() if key.consumer == "kalman_rts"}
    assert cross_fitted(alone, known, first, seed=7) == ({}, [])
