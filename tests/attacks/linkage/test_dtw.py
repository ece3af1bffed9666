"""Warped costs against a plain dynamic programme, and what is learnt."""

import numpy as np
import pytest
from dtaidistance import dtw_ndim
from helpers.walks import context, hits, two_releases

from attacks.linkage.dtw import DTW, warped_costs
from attacks.linkage.signals import Signals
from isac_track.protocols import LinkageTrainingSet
from isac_track.rng import stream


def plain(a, b, *, band, psi, penalty):
    """Squared DTW distance of (n, 2) and (m, 2), with the band |i - j| of either diagonal."""
    n, m = len(a), len(b)
    best = np.full((n + 1, m + 1), np.inf)
    best[0, : psi + 1] = 0
    best[: psi + 1, 0] = 0
    for i in range(1, n + 1):
        for j in range(1, m + 1):
            if not -band - max(n - m, 0) <= j - i <= band + max(m - n, 0):
                continue
            cost = ((a[i - 1] - b[j - 1]) ** 2).sum()
            best[i, j] = cost + min(
                best[i - 1, j - 1],
                best[i - 1, j] + penalty**2,
                best[i, j - 1] + penalty**2,
            )
    return min(best[n, m - psi :].min(), best[n - psi :, m].min())


def costs_of(probe, gallery, sizes_p, sizes_g, **settings):
    """Of (P, K, 2) and (G, K, 2) profiles of which every second cell is compared."""
    signals = (
        Signals(np.repeat(each.transpose(2, 0, 1), 2, axis=2), 2 * sizes)
        for each, sizes in ((probe, sizes_p), (gallery, sizes_g))
    )
    return warped_costs(*signals, floor=0.01, **settings)


def cost_by_hand(a, b, *, band, penalty):
    shorter, longer = sorted((len(a), len(b)))
    reach = round(band * longer)
    psi = min(reach, (shorter - 1) // 2)
    square = plain(a, b, band=reach, psi=psi, penalty=penalty)
    return (square / shorter + 0.01) * (24 / shorter) ** 3


@pytest.mark.parametrize("penalty", [1e-9, 0.3])
@pytest.mark.parametrize("band", [0.0, 0.1, 0.3])
def test_it_is_a_plain_dynamic_programme(band, penalty):
    rng = stream(0, "test", "dtw")
    probe, gallery = rng.normal(size=(5, 24, 2)), rng.normal(size=(4, 24, 2))
    sizes_p, sizes_g = np.array([24, 24, 10, 1, 2]), np.array([24, 11, 3, 24])
    costs = costs_of(probe, gallery, sizes_p, sizes_g, band=band, penalty=penalty)
    for i, n in enumerate(sizes_p):
        for j, m in enumerate(sizes_g):
            slow = cost_by_hand(probe[i, :n], gallery[j, :m], band=band, penalty=penalty)
            assert costs[i, j] == pytest.approx(slow, rel=1e-9), (n, m)


@pytest.mark.parametrize(("n", "m"), [(24, 24), (24, 21), (9, 20)])
def test_it_is_dtaidistance(n, m):
    rng = stream(0, "test", "dtw", n)
    probe, gallery = rng.normal(size=(6, n, 2)), rng.normal(size=(5, m, 2))
    costs = costs_of(probe, gallery, np.full(6, n), np.full(5, m), band=0.15, penalty=0.2)
    reach = round(0.15 * max(n, m))
    for i in range(6):
        for j in range(5):
            distance = dtw_ndim.distance(
                probe[i], gallery[j], window=reach + 1, psi=reach, penalty=0.2, use_c=True
            )
            known = (distance**2 / min(n, m) + 0.01) * (24 / min(n, m)) ** 3
            assert costs[i, j] == pytest.approx(known, rel=1e-9)


def test_it_learns_to_smooth():
    # White noise of half a metre in slow walks: twice the usual width does better.
    habits = {"noise_m": 0.5, "sway": 0.6, "turn_rad_s": 0.15, "shift_s": 0.5}
    train = LinkageTrainingSet(*two_releases(48, seed=7, **habits))
    probe, gallery, mate = two_releases(48, seed=8, **habits)
    narrow, wide = (
        hits(DTW(factor=f, penalty=0.1).fit(context())(probe, gallery), mate) for f in (0.5, 2.0)
    )
    learnt = hits(DTW().fit(context(train))(probe, gallery), mate)
    assert wide > narrow
    assert learnt > narrow
