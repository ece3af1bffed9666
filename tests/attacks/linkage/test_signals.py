"""The common grid, motion on it, the search for the best lag, and learning from ranks."""

from itertools import pairwise

import numpy as np
import pytest
from linkage_walks import moved, odd_release, release_of, training, two_releases
from scipy.optimize import minimize_scalar

from attacks.linkage.signals import (
    FULL_CELLS,
    LEAST_OVERLAP,
    LONGEST_S,
    MARGIN,
    STEP_S,
    WIDTHS_S,
    aligned_costs,
    chosen,
    few_mates,
    learn,
    log_rank,
    motion,
    motions,
    on_grid,
    polynomials,
    product,
    tracks_of,
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


@pytest.mark.parametrize("first", [0, 1])
def test_polynomials_are_orthonormal(first):
    values, begin, ranks = polynomials(20, 5, first)
    for m in range(1, 21):
        assert ranks[m] == min(5, m - first)
        basis = values[begin[m] : begin[m + 1]].reshape(ranks[m], m)
        assert np.allclose(basis @ basis.T, np.eye(ranks[m]))
        if first == 1:
            assert np.allclose(basis.sum(axis=1), 0)
        kept = np.polynomial.Polynomial([1.0, 2.0, 0.5])(np.arange(m))
        if m > 6:
            rest = kept - kept.mean() * first
            assert np.allclose(basis.T @ (basis @ rest), rest)


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


@pytest.mark.parametrize("shape", [(700, 50, 60), (3, 600, 900), (5, 1, 2), (0, 4, 4)])
def test_a_product_in_pieces_is_the_product(shape):
    n, k, m = shape
    rng = stream(0, "test", "product")
    a, b = rng.normal(size=(n, k)), rng.normal(size=(k, m))
    assert np.allclose(product(a, b), a @ b)
    assert np.allclose(product(a, b.T.copy().T), a @ b)


def test_log_rank_by_hand():
    scores = np.array([[3.0, 1.0, 2.0], [0.0, 5.0, 5.0], [1.0, 2.0, 0.0], [9.0, 9.0, 9.0]])
    mate = np.array([0, 1, 2, -1])
    assert log_rank(scores, mate=mate) == pytest.approx(np.log([1.0, 1.5, 3.0]).mean())


def test_only_a_gain_moves_from_the_default():
    assert chosen([1.0, 1.0 - MARGIN / 2, 2.0]) == 0
    assert chosen([1.0, 1.0 - 2 * MARGIN, 0.5]) == 2
    assert chosen([1.0, 1.5]) == 0


def test_learning_takes_one_parameter_after_the_other():
    asked = []

    def loss(choice):
        asked.append(choice)
        return abs(choice[0] - 5.0) + abs(choice[1] - 2.0)

    assert learn(((1.0, 4.0, 9.0), (7.0,), (3.0, 8.0)), loss=lambda c: loss(c[::2])) == (4, 7, 3)
    # What was found for the first is not asked for again.
    assert asked == [(1.0, 3.0), (4.0, 3.0), (9.0, 3.0), (4.0, 8.0)]


def test_learning_keeps_a_default_that_is_as_good():
    assert learn(((1.0, 2.0), (3.0, 4.0)), loss=lambda choice: 1.0 - sum(choice) / 1e4) == (1, 3)
    assert learn(((1.0,), (3.0,)), loss=lambda _: pytest.fail("nothing to choose")) == (1, 3)


def test_few_mates_are_the_mates():
    probe, gallery, mate = two_releases(12)
    known = np.where(np.arange(12) % 2 == 0, mate, -1)
    few = few_mates(training(probe, gallery, known), most=4)
    assert few.probe.pseudonym == tuple(probe.pseudonym[row] for row in (0, 2, 4, 6))
    assert few.gallery.pseudonym == tuple(gallery.pseudonym[mate[row]] for row in (0, 2, 4, 6))
    assert few.mate.tolist() == [0, 1, 2, 3]


def test_tracks_of_a_release():
    release = moved(odd_release(0))
    some = tracks_of(release, np.array([5, 0, 9]))
    for row, source in enumerate((5, 0, 9)):
        assert np.array_equal(some[row].xy, release[source].xy)
        assert np.array_equal(some[row].t, release[source].t)
    assert some.pseudonym == tuple(release.pseudonym[row] for row in (5, 0, 9))
