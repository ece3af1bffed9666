"""The strongest attack: one definition."""

import numpy as np
import pytest
from helpers.mechanisms import make_families

from evaluation.estimates.strongest import (
    choose_strongest,
    cross_fitted,
    first_half,
    naming_rules,
    strongest_by_task,
)
from evaluation.plan.address import parse_consumer
from evaluation.store.linkage_outcomes import ClusterSums
from isac_track.intervals import Estimate, cluster_weights

SHAPE, DTW = (
    parse_consumer("rerelease/shape", "blind"),
    parse_consumer("rerelease/dtw", "informed"),
)
LEVELS = (("raw", None), ("fixed", 1.0), ("fid", 1.0))


def values(by_reader, *, metric="rank1", levels=LEVELS):
    """Return each attack's success by level: a number for all, or a number for each."""
    return {
        reader.measured(metric).at(*where): Estimate(achieved)
        for reader, successes in by_reader.items()
        for where, achieved in zip(
            levels, np.broadcast_to(successes, len(levels)), strict=True
        )
        if np.isfinite(achieved) or metric == "plr"
    }


OTHERS = (("raw", None), ("clean", None), ("mine:Ou", 1.0))
ALONE = values({SHAPE: (0.5, 0.9, 0.1), DTW: (0.4, 0.1, 0.3)}, levels=OTHERS)
ORACLE, CONTROL = (
    parse_consumer("rerelease/dtw", "oracle"),
    parse_consumer("rerelease/control-times", ""),
)
SMOOTHER = parse_consumer("kalman_rts", "informed")
AS_THEY_ARE = {parse_consumer("shared"): 0.9, parse_consumer("identity", "blind"): 0.8}


@pytest.mark.parametrize(
    ("estimates", "expected"),
    [
        # The highest mean over raw, fixed noise and FID; of equals the first of the
        # run.
        (values({SHAPE: (0.9, 0.1, 0.1), DTW: 0.4}), {"rerelease": DTW}),
        (values({DTW: 0.4, SHAPE: 0.4}), {"rerelease": DTW}),
        # Neither the oracle nor a control is one, nor who takes positions as they are.
        *(
            (values({SHAPE: 0.1, other: 0.9}), {"rerelease": SHAPE})
            for other in (ORACLE, CONTROL)
        ),
        *((values({other: 0.9}), {}) for other in (ORACLE, CONTROL)),
        (values(AS_THEY_ARE | {SMOOTHER: 0.3}, metric="plr"), {"": SMOOTHER}),
        # It ran at all levels that any did.
        (values({SHAPE: 0.3, DTW: (0.9, np.nan, 0.9)}), {"rerelease": SHAPE}),
        # Other mechanisms do not move it unless there is nothing else.
        (ALONE, {"rerelease": DTW}),
        (ALONE | values({SHAPE: 0.5, DTW: 0.4}), {"rerelease": SHAPE}),
    ],
)
def test_which_it_is(estimates, expected):
    assert strongest_by_task(estimates, make_families(estimates)) == expected


def test_its_mean_is_a_number():
    assert choose_strongest([{SHAPE: 0.3, DTW: np.nan}]) == SHAPE
    assert choose_strongest([]) is None


def test_what_one_half_chose_is_scored_on_the_other():
    """Against sums by hand: an attack good on one half is not as good on the other."""
    rng = np.random.default_rng(0)
    n, first, second = (
        60,
        parse_consumer("kalman_rts", "blind"),
        parse_consumer("radial_rts", "blind"),
    )
    weights = cluster_weights(n_clusters=n, n_replicates=50, seed=0)
    tracks = rng.integers(0, 5, n).astype(float)
    used = np.flatnonzero(tracks)  # the others are in no scene, and are not kept
    assert used.size < n
    is_first = first_half(tuple(map(str, range(n))))
    own = {first: np.where(is_first, 0.9, 0.1), second: np.where(is_first, 0.2, 0.8)}
    shares = {reader: share * tracks for reader, share in own.items()}
    every = {
        reader.measured(metric).at(*where): np.stack([share * rng.random(n), tracks])
        for where in LEVELS
        for reader, share in shares.items()
        for metric in ("plr", "mel")
    }
    sums = {
        key: ClusterSums(summed[:, used], weights, used)
        for key, summed in every.items()
    }
    crossed = cross_fitted(sums, known := make_families(sums), first)
    result = crossed.estimates
    assert crossed.choices == {"plr": [first.measured("plr"), second.measured("plr")]}
    for key in (
        first.measured(metric).at(*where)
        for where in LEVELS
        for metric in ("plr", "mel")
    ):
        theirs = every[second.measured(key.metric).at(*key.mechanism_level)][0]
        scored = np.where(is_first, theirs, every[key][0])
        assert result[key].value == pytest.approx(scored.sum() / tracks.sum())
        assert result[key].replicates == pytest.approx(
            weights @ scored / (weights @ tracks), abs=1e-6
        )
    assert result[first.measured("plr").at("raw", None)].value < 0.2
    # Where both halves choose the headline its own numbers stand.
    alone = {
        key: summed for key, summed in sums.items() if key.consumer == "kalman_rts"
    }
    crossed = cross_fitted(alone, known, first)
    assert crossed.choices == {"plr": [first.measured("plr")] * 2}
    for key in alone:
        own = every[key][0]
        assert crossed.estimates[key].value == pytest.approx(own.sum() / tracks.sum())


def test_a_linker_counts_by_the_better_way_to_name_mates():
    """Per probe or all at once; rank 1 of a hundred has a choice of its own."""
    n = 90
    weights = cluster_weights(n_clusters=n, n_replicates=30, seed=0)
    rates = {
        SHAPE.measured("rank1"): 0.5,
        SHAPE.measured("rank1_assigned"): 0.6,
        SHAPE.measured("rank1_g100"): 0.3,
        DTW.measured("rank1"): 0.7,
        DTW.measured("rank1_assigned"): 0.8,
        DTW.measured("rank1_g100"): 0.2,
    }
    sums = {
        measure.at(*where): ClusterSums(
            np.stack([np.full(n, rate), np.ones(n)]), weights
        )
        for measure, rate in rates.items()
        for where in LEVELS
    }
    known = make_families(sums)
    crossed = cross_fitted(sums, known, SHAPE, by="rank1")
    joint, per_probe = DTW.measured("rank1_assigned"), SHAPE.measured("rank1_g100")
    assert crossed.choices == {"rank1": [joint] * 2, "rank1_g100": [per_probe] * 2}
    assert joint.label == "rerelease/dtw (informed), joint"
    for where in LEVELS:
        among_all = crossed.estimates[SHAPE.measured("rank1").at(*where)]
        among_100 = crossed.estimates[SHAPE.measured("rank1_g100").at(*where)]
        assert (among_all.value, among_100.value) == pytest.approx((0.8, 0.3))
    result = {key: Estimate(summed.sums[0].mean()) for key, summed in sums.items()}
    assert strongest_by_task(result, known) == {"rerelease": DTW}
    assert naming_rules(result)[DTW] == "rank1_assigned"
