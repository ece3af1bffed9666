"""Warped costs against those of dtaidistance, and what is learnt."""

import numpy as np
import pytest
from dtaidistance import dtw_ndim
from helpers.walks import context, hits, two_releases

from attacks.linkage.dtw import DTW, warped_costs
from attacks.linkage.signals import Signals
from isac_track.protocols import LinkageTrainingSet
from isac_track.rng import stream


@pytest.mark.parametrize("penalty", [1e-9, 0.3])
@pytest.mark.parametrize("band", [0.0, 0.1, 0.15, 0.3])
def test_it_is_dtaidistance(band, penalty):
    rng = stream(0, "test", "dtw")
    probe, gallery = rng.normal(size=(7, 24, 2)), rng.normal(size=(5, 24, 2))
    sizes_p, sizes_g = (
        np.array([24, 24, 10, 9, 20, 1, 2]),
        np.array([24, 11, 3, 21, 24]),
    )
    # Of (N, K, 2) profiles every second cell is compared.
    signals = (
        Signals(np.repeat(values.transpose(2, 0, 1), 2, axis=2), 2 * sizes)
        for values, sizes in ((probe, sizes_p), (gallery, sizes_g))
    )
    costs = warped_costs(*signals, floor=0.01, band=band, penalty=penalty)
    for (i, j), cost in np.ndenumerate(costs):
        a, b = probe[i, : sizes_p[i]], gallery[j, : sizes_g[j]]
        shorter, longer = sorted((len(a), len(b)))
        reach = round(band * longer)
        psi = min(reach, (shorter - 1) // 2)
        distance = dtw_ndim.distance(
            a, b, window=reach + 1, psi=psi, penalty=penalty, use_c=True
        )
        known = (distance**2 / shorter + 0.01) * (24 / shorter) ** 3
        assert cost == pytest.approx(known, rel=1e-9), (len(a), len(b))


def test_it_learns_to_smooth():
    # White noise of half a metre in slow walks: twice the usual width does better.
    habits = {"noise_m": 0.5, "sway": 0.6, "turn_rad_s": 0.15, "shift_s": 0.5}
    train = LinkageTrainingSet(*two_releases(48, seed=7, **habits))
    probe, gallery, mate = two_releases(48, seed=8, **habits)
    narrow, wide = (
        hits(DTW(factor=f, penalty=0.1).fit(context())(probe, gallery), mate)
        for f in (0.5, 2.0)
    )
    learnt = hits(DTW().fit(context(train))(probe, gallery), mate)
    assert wide > narrow
    assert learnt > narrow
