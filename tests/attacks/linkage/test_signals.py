"""The common grid, and motion on it."""

from itertools import pairwise

import numpy as np
import pytest
from helpers.walks import odd_release, release_of, two_releases

from attacks.linkage.signals import (
    LONGEST_S,
    STEP_S,
    WIDTHS_S,
    motion,
    motions,
    on_grid,
    product,
    widths_s,
)
from isac_track.rng import stream


def circle(radius_m, rad_s, *, length_s=12.0, seed=0):
    """One walk on a circle, sampled irregularly; anticlockwise for rad_s > 0."""
    t = np.cumsum(stream(seed, "test", "circle").uniform(1 / 16, 1 / 8, 300))
    t = t[t < t[0] + length_s]
    return t, radius_m * np.stack([np.cos(rad_s * t), np.sin(rad_s * t)], axis=1)


def test_a_straight_walk_is_straight_on_the_grid():
    t = np.cumsum(stream(0, "test", "line").uniform(1 / 16, 1 / 8, 100))
    walks = on_grid(release_of([(t, np.stack([1.2 * t, -0.5 * t], axis=1))]))
    lasts_s = t[-1] - t[0]
    assert walks.count[0] == int(lasts_s / STEP_S)
    middle_s = (lasts_s - walks.count[0] * STEP_S) / 2 + STEP_S * (np.arange(walks.count[0]) + 0.5)
    # A line's mean over a cell is its value in the middle.
    assert np.allclose(walks.z[0], (1.2 - 0.5j) * middle_s, atol=1e-9)


def test_a_cell_is_the_mean_of_the_line_through_the_samples():
    release = odd_release(5)
    walks = on_grid(release)
    for row, (lo, hi) in enumerate(pairwise(release.offsets)):
        t, xy = release.t[lo:hi] - release.t[lo], release.xy[lo:hi] - release.xy[lo]
        cells = max(int(min(t[-1], LONGEST_S) / STEP_S + 1e-6), 1)
        assert walks.count[row] == cells
        if t.size < 2:
            assert np.allclose(walks.z[row, 0], 0)
            continue
        start_s = max((min(t[-1], LONGEST_S) - cells * STEP_S) / 2, 0)
        for cell in range(cells):
            low, high = start_s + cell * STEP_S, min(start_s + (cell + 1) * STEP_S, t[-1])
            corners = np.concatenate([[low], t[(t > low) & (t < high)], [high]])
            values = np.interp(corners, t, xy[:, 0])
            mean = np.trapezoid(values, corners) / (high - low)
            assert walks.z[row, cell].real == pytest.approx(mean, abs=1e-5)


def test_the_longest_walk_is_cut():
    t = np.arange(0.0, 200.0, 0.5)
    assert on_grid(release_of([(t, np.zeros((t.size, 2)))])).count[0] == LONGEST_S / STEP_S


@pytest.mark.parametrize(("radius_m", "rad_s"), [(3.0, 0.4), (3.0, -0.4), (8.0, 0.15)])
def test_motion_on_a_circle(radius_m, rad_s):
    walks = on_grid(release_of([circle(radius_m, rad_s)]))
    going = motion(walks, width_s=np.array([0.5]))
    inside = slice(3, int(walks.count[0]) - 3)
    assert np.allclose(going.speed[0, inside], radius_m * abs(rad_s), rtol=0.05)
    damped = 1 / (1 + (0.4 / (radius_m * rad_s)) ** 2)
    assert np.allclose(going.turn[0, inside], rad_s * damped, rtol=0.15)


def test_noise_asks_for_width():
    probe, _, _ = two_releases(6, noise_m=0.0)
    noisy, _, _ = two_releases(6, noise_m=1.0)
    assert np.array_equal(widths_s(probe), np.full((1, 6), WIDTHS_S[0]))
    usual, half = widths_s(noisy, factors=(1.0, 0.5))
    assert (usual > 2.0).all()
    assert (half < usual).all()


def test_motions_of_several_factors_are_those_of_each():
    release = odd_release(1)
    several = motions(release, factors=(1.0, 2.0))
    for each, width_s in zip(several, widths_s(release, factors=(1.0, 2.0)), strict=True):
        alone = motion(on_grid(release), width_s=width_s)
        assert np.array_equal(each.speed, alone.speed)
        assert np.array_equal(each.turn, alone.turn)
    assert not np.array_equal(several[0].speed, several[1].speed)


@pytest.mark.parametrize("shape", [(700, 50, 60), (3, 600, 900), (5, 1, 2), (0, 4, 4)])
def test_a_product_in_pieces_is_the_product(shape):
    n, k, m = shape
    rng = stream(0, "test", "product")
    a, b = rng.normal(size=(n, k)), rng.normal(size=(k, m))
    assert np.allclose(product(a, b), a @ b)
    assert np.allclose(product(a, b.T.copy().T), a @ b)
