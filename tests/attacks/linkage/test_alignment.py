"""The search for the best lag against brute force."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from attacks.linkage.alignment import FULL_CELLS, LEAST_OVERLAP, aligned_costs
from attacks.linkage.signals import (
    STEP_S,
)
from isac_track.rng import stream


def slow_cost(a, b, *, floor, rank, exponent, reach, rotated):
    """One pair, lag by lag; the rotation by search."""
    least = min(LEAST_OVERLAP, a.size, b.size)
    best = np.inf
    for start_a in range(a.size):
        for start_b in range(b.size) if start_a == 0 else (0,):
            m = min(a.size - start_a, b.size - start_b)
            lag = start_a - start_b
            allowed = -reach - max(b.size - a.size, 0) <= lag <= reach + max(a.size - b.size, 0)
            if m < least or not allowed:
                continue
            x, y = a[start_a : start_a + m], b[start_b : start_b + m]
            if rotated:
                x, y = x - x.mean(), y - y.mean()
            degree = min(rank if rotated else rank - 1, m - 1)
            fit = np.polynomial.legendre.legvander(np.linspace(-1, 1, m), degree)
            x, y = (fit @ np.linalg.lstsq(fit, each, rcond=None)[0] for each in (x, y))

            def misfit(angle, x=x, y=y):
                return float((np.abs(x - np.exp(1j * angle) * y) ** 2).mean())

            if rotated:
                angles = np.linspace(-np.pi, np.pi, 25)
                start = angles[np.argmin([misfit(angle) for angle in angles])]
                d = minimize_scalar(
                    misfit,
                    bounds=(start - 0.3, start + 0.3),
                    method="bounded",
                    options={"xatol": 1e-9},
                ).fun
            else:
                d = misfit(0.0)
            best = min(best, (d + floor) * (FULL_CELLS / m) ** exponent)
    return best


@pytest.mark.parametrize("rotated", [True, False])
def test_the_best_lag_by_brute_force(rotated):
    rng = stream(0, "test", "lags")
    sizes_p, sizes_g = np.array([20, 14, 20, 3, 1]), np.array([20, 9, 26])
    steps = [rng.normal(size=(n, 26)) + 1j * rng.normal(size=(n, 26)) for n in (5, 3)]
    z_p, z_g = (np.cumsum(step, axis=1) for step in steps)
    costs = aligned_costs(
        probe=np.stack([z_p.real, z_p.imag]),
        probe_count=sizes_p,
        gallery=np.stack([z_g.real, z_g.imag]),
        gallery_count=sizes_g,
        floors=(0.01, 1.0),
        rank=4,
        exponent=2.0,
        reach_s=7 * STEP_S,
        rotated=rotated,
    )
    assert costs.shape == (2, 5, 3)
    for e, floor in enumerate((0.01, 1.0)):
        for i, n_p in enumerate(sizes_p):
            for j, n_g in enumerate(sizes_g):
                slow = slow_cost(
                    z_p[i, :n_p],
                    z_g[j, :n_g],
                    floor=floor,
                    rank=4,
                    exponent=2.0,
                    reach=7,
                    rotated=rotated,
                )
                assert costs[e, i, j] == pytest.approx(slow, rel=1e-6)
