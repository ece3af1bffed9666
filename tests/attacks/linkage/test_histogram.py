"""The statistic against its formula, and what a histogram sees and does not."""

import numpy as np
import pytest
from helpers.walks import context, hits, two_releases, walk_release

from attacks.linkage.histogram import Histogram, count_cells, same_source_ratio
from attacks.linkage.signals import on_grid, smooth_motion
from isac_track.protocols import LinkageTrainingSet
from isac_track.rng import stream


def multinomial(counts, shape):
    """Log likelihood of counts, without the multinomial coefficient."""
    return sum(c * np.log(p) for c, p in zip(counts, shape, strict=True) if c > 0)


def test_it_is_the_likelihood_ratio():
    rng = stream(0, "test", "histogram")
    a = rng.poisson(1.5, (6, 9)) * rng.uniform(0.5, 2.0, (6, 9))
    b = rng.poisson(0.8, (4, 9)) * rng.uniform(0.5, 2.0, (4, 9)) + np.eye(4, 9)
    ratio = same_source_ratio(a, b)
    for i in range(6):
        for j in range(4):
            shape = (a[i] + b[j]) / (a[i].sum() + b[j].sum())
            single_source = multinomial(a[i], shape) + multinomial(b[j], shape)
            two_sources = multinomial(a[i], a[i] / a[i].sum()) + multinomial(
                b[j], b[j] / b[j].sum()
            )
            assert ratio[i, j] == pytest.approx(single_source - two_sources, abs=1e-9)
    assert (ratio <= 1e-9).all()


def test_every_cell_of_the_grid_is_counted_once():
    probe, _, _ = two_releases(6, noise_m=0.3)
    walks = on_grid(probe)
    going = smooth_motion(walks, width_s=np.full(6, 1.0))
    counts = count_cells(going, speeds=12)
    assert counts.shape == (6, 60)
    assert np.allclose(counts.sum(axis=1), walks.sizes)
    # Shares of the centres keep the mean.
    centres = np.repeat(np.linspace(0, 2.2, 12), 5)
    for row, cells in enumerate(walks.sizes):
        mean = going.values[0, row, :cells].mean()
        assert counts[row] @ centres / cells == pytest.approx(mean, abs=1e-9)


def test_order_in_time_does_not_enter():
    t = np.arange(0.0, 12.0, 0.1)
    speed = np.where(t < 6.0, 0.6, 1.4)
    forth = np.stack([np.cumsum(speed) * 0.1, 0 * t], axis=1)
    back = forth[::-1].copy()
    other = np.stack([1.0 * t, 0 * t], axis=1)
    scores = Histogram().fit(context())(
        walk_release([(t, forth)]), walk_release([(t, back), (t, other)])
    )
    assert scores[0, 0] > -1.0
    assert scores[0, 0] > scores[0, 1] + 5.0


def test_it_learns_to_look_closer():
    # Steady walkers whose speeds differ by less than a centre's distance.
    habits = {"sway": 0.03, "turn_rad_s": 0.1, "shift_s": 4.0}
    train = LinkageTrainingSet(*two_releases(48, seed=7, **habits))
    probe, gallery, mate = two_releases(48, seed=8, **habits)
    blind = hits(Histogram().fit(context())(probe, gallery), mate)
    coarse = hits(Histogram(speeds=4).fit(context(train))(probe, gallery), mate)
    learnt = hits(Histogram().fit(context(train))(probe, gallery), mate)
    assert learnt > coarse
    assert learnt >= blind
