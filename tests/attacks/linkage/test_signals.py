"""The common grid, motion on it, and the best lag against brute force."""

from itertools import pairwise

import numpy as np
import pytest
from helpers.walks import context, odd_release, two_releases, walk_release
from scipy.optimize import minimize_scalar

from attacks.linkage.signals import (
    EXPONENT,
    FULL_CELLS,
    LEAST_OVERLAP,
    LONGEST_S,
    STEP_S,
    WIDTHS_S,
    Signals,
    aligned_costs,
    on_grid,
    smooth_motion,
    width_factors,
    widths_s,
)
from isac_track.protocols import LinkageTrainingSet
from isac_track.rng import stream


def circle(radius_m, rad_s, *, length_s=12.0, seed=0):
    """One walk on a circle, sampled irregularly; anticlockwise for rad_s > 0."""
    t = np.cumsum(stream(seed, "test", "circle").uniform(1 / 16, 1 / 8, 300))
    t = t[t < t[0] + length_s]
    return t, radius_m * np.stack([np.cos(rad_s * t), np.sin(rad_s * t)], axis=1)


def test_a_cell_is_the_mean_of_the_line_through_the_samples():
    release = odd_release(5)
    walks = on_grid(release)
    for row, (lo, hi) in enumerate(pairwise(release.offsets)):
        t, xy = release.t[lo:hi] - release.t[lo], release.xy[lo:hi] - release.xy[lo]
        cells = max(int(min(t[-1], LONGEST_S) / STEP_S + 1e-6), 1)
        assert walks.sizes[row] == cells
        if t.size < 2:
            assert np.allclose(walks.values[:, row, 0], 0)
            continue
        start_s = max((min(t[-1], LONGEST_S) - cells * STEP_S) / 2, 0)
        for cell in range(cells):
            low, high = (
                start_s + cell * STEP_S,
                min(start_s + (cell + 1) * STEP_S, t[-1]),
            )
            corners = np.concatenate([[low], t[(t > low) & (t < high)], [high]])
            values = np.interp(corners, t, xy[:, 0])
            mean = np.trapezoid(values, corners) / (high - low)
            assert walks.values[0, row, cell] == pytest.approx(mean, abs=1e-5)


def test_the_longest_walk_is_cut():
    t = np.arange(0.0, 200.0, 0.5)
    assert (
        on_grid(walk_release([(t, np.zeros((t.size, 2)))])).sizes[0]
        == LONGEST_S / STEP_S
    )


@pytest.mark.parametrize(("radius_m", "rad_s"), [(3.0, 0.4), (3.0, -0.4), (8.0, 0.15)])
def test_motion_on_a_circle(radius_m, rad_s):
    walks = on_grid(walk_release([circle(radius_m, rad_s)]))
    speed, turn = smooth_motion(walks, width_s=np.array([0.5])).values[:, 0]
    inside = slice(3, int(walks.sizes[0]) - 3)
    assert np.allclose(speed[inside], radius_m * abs(rad_s), rtol=0.05)
    damped = 1 / (1 + (0.4 / (radius_m * rad_s)) ** 2)
    assert np.allclose(turn[inside], rad_s * damped, rtol=0.15)


def test_noise_asks_for_width():
    probe, _, _ = two_releases(6, noise_m=0.0)
    noisy, _, _ = two_releases(6, noise_m=1.0)
    assert np.array_equal(widths_s(probe), np.full(6, WIDTHS_S[0]))
    usual, half = (widths_s(noisy, factor) for factor in (1.0, 0.5))
    assert (usual > 2.0).all()
    assert (half < usual).all()


def test_widths_that_come_to_the_same_are_tried_once():
    tried = {}
    for noise_m in (0.0, 1.0):
        train = LinkageTrainingSet(*two_releases(12, noise_m=noise_m))
        tried[noise_m] = width_factors(context(train), None)
    assert tried == {0.0: (1.0,), 1.0: (1.0, 0.5, 2.0)}
    assert width_factors(context(train), 3.0) == (3.0,)
    assert width_factors(context(), None) == (1.0,)


def slow_cost(a, b, *, floor, rank, reach, rotated):
    """One pair, lag by lag; the rotation by search."""
    least = min(LEAST_OVERLAP, a.size, b.size)
    best = np.inf
    for start_a in range(a.size):
        for start_b in range(b.size) if start_a == 0 else (0,):
            m = min(a.size - start_a, b.size - start_b)
            lag = start_a - start_b
            allowed = (
                -reach - max(b.size - a.size, 0)
                <= lag
                <= reach + max(a.size - b.size, 0)
            )
            if m < least or not allowed:
                continue
            x, y = a[start_a : start_a + m], b[start_b : start_b + m]
            if rotated:
                x, y = x - x.mean(), y - y.mean()
            degree = min(rank if rotated else rank - 1, m - 1)
            fit = np.polynomial.legendre.legvander(np.linspace(-1, 1, m), degree)
            x, y = (
                fit @ np.linalg.lstsq(fit, values, rcond=None)[0] for values in (x, y)
            )

            def misfit(angle, x=x, y=y):
                return float((np.abs(x - np.exp(1j * angle) * y) ** 2).mean())

            d = misfit(0.0)
            if rotated:
                angles = np.linspace(-np.pi, np.pi, 25)
                start = angles[np.argmin([misfit(angle) for angle in angles])]
                near = {"bounds": (start - 0.3, start + 0.3), "method": "bounded"}
                d = minimize_scalar(misfit, **near, options={"xatol": 1e-9}).fun
            best = min(best, (d + floor) * (FULL_CELLS / m) ** EXPONENT)
    return best


@pytest.mark.parametrize("rotated", [True, False])
def test_the_best_lag_by_brute_force(rotated):
    rng = stream(0, "test", "lags")
    sizes_p, sizes_g = np.array([20, 14, 20, 3, 1]), np.array([20, 9, 26])
    steps = [rng.normal(size=(n, 26)) + 1j * rng.normal(size=(n, 26)) for n in (5, 3)]
    z_p, z_g = (np.cumsum(step, axis=1) for step in steps)
    settings = {"rank": 4, "rotated": rotated}
    probe, gallery = (
        Signals(np.stack([z.real, z.imag]), sizes)
        for z, sizes in ((z_p, sizes_p), (z_g, sizes_g))
    )
    costs = aligned_costs(
        probe, gallery, floors=(0.01, 1.0), reach_s=7 * STEP_S, **settings
    )
    assert costs.shape == (2, 5, 3)
    for (e, i, j), cost in np.ndenumerate(costs):
        a, b = z_p[i, : sizes_p[i]], z_g[j, : sizes_g[j]]
        slow = slow_cost(a, b, floor=(0.01, 1.0)[e], reach=7, **settings)
        assert cost == pytest.approx(slow, rel=1e-6)
