"""Search the noise that costs a robot least for a floor, and certify the result.

`python scripts/shaped_noise.py` prints the table of `isac_track/mechanisms/shaped.py`
and that of docs/explanation/shaped.md. A few minutes on one core.
"""

import argparse
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np
from scipy.optimize import linprog, minimize, minimize_scalar

from isac_track.kalman import spectra
from isac_track.types import Floats

FLOORS_M = (0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.2)
BAND_EDGES = (0.0, 0.1, 0.3, 0.8, 2.0, 6.0)  # rad/s, of the certificate.
FINE_EDGES = tuple(np.concatenate([np.arange(0.0, 0.61, 0.05), [0.8, 1.5, 3.0, 6.0]]))
_MOST_STD_M = 10.0  # Noise within a band that the certificate covers.
_STARTS = 3
_TOLERANCE = 1e-9  # m^2, of numerical slopes.


@dataclass(frozen=True, eq=False, slots=True)
class Search:
    """The best noise of a family for a floor."""

    density: Floats  # (F,) m^2 s
    robot_m: float  # rms error per axis after the horizon.
    parameters: Floats


def best_order(*, floor: float, order: float) -> Search:
    """Return the best Matern noise of an order; its parameter is theta, s."""

    def density(log_theta: float) -> Floats:
        shape = spectra.matern_density(
            std_m=1.0, theta_s=math.exp(log_theta), order=order
        )
        return spectra.scaled_to(shape, floor=floor)

    result = minimize_scalar(
        lambda log_theta: spectra.predicted_rms_m(density(log_theta)),
        bounds=(math.log(0.5), math.log(100.0)),
        method="bounded",
        options={"xatol": 1e-4},
    )
    return Search(density(result.x), float(result.fun), np.exp([result.x]))


def best_mixture(*, floor: float, n: int) -> Search:
    """Return the best mixture of n Matern processes, searched from a few starts.

    Parameters are n of theta, n of the order, and n - 1 log weights to the first.
    """

    def density(z: Floats) -> Floats:
        theta = np.exp(np.clip(z[:n], math.log(0.2), math.log(300.0)))
        order = np.exp(np.clip(z[n : 2 * n], 0.0, math.log(50.0)))
        weight = np.exp(np.append(0.0, z[2 * n :]))
        parts = [
            share * spectra.matern_density(std_m=1.0, theta_s=time_s, order=power)
            for share, time_s, power in zip(
                weight / weight.sum(), theta, order, strict=True
            )
        ]
        return spectra.scaled_to(np.sum(parts, axis=0), floor=floor)

    rng = np.random.default_rng(0)
    starts = [rng.uniform(0.0, 3.0, 3 * n - 1) for _ in range(_STARTS)]
    return _search(density, starts, method="Nelder-Mead")


def best_bands(*, near: Search, floor: float, edges: tuple[float, ...]) -> Search:
    """Return the best spectrum that is constant within bands, by a local search.

    It begins `near` another spectrum. The certificate says how far the best can be.
    """
    unit = band_densities(edges)
    height = np.array([near.density[band > 0.0].mean() for band in unit])
    start = np.log(np.maximum(height / unit.max(axis=1), 1e-8))

    def density(z: Floats) -> Floats:
        return spectra.scaled_to(np.exp(z - z.max()) @ unit, floor=floor)

    return _search(density, [start], method="Powell")


def _search(
    density: Callable[[Floats], Floats], starts: list[Floats], *, method: str
) -> Search:
    """Return the noise with the least price that a local search reaches."""
    results = [
        minimize(
            lambda z: spectra.predicted_rms_m(density(z)),
            start,
            method=method,
            options={"maxiter": 6 if method == "Powell" else 300},
        )
        for start in starts
    ]
    best = min(results, key=lambda result: float(result.fun))
    return Search(density(best.x), float(best.fun), np.asarray(best.x))


def band_densities(edges: tuple[float, ...]) -> Floats:
    """Return spectra that are constant within a band, of unit variance, (J, F)."""
    frequency = spectra.frequencies()
    inside = [
        ((frequency >= low) & (frequency < high)).astype(float)
        for low, high in itertools.pairwise(edges)
    ]
    return np.array([band / spectra.std_of_density(band) ** 2 for band in inside])


@dataclass(frozen=True, slots=True)
class Certificate:
    """No spectrum of the bands keeps the floor below the bound."""

    bound_m: float  # Lower bound of the robot's rms error.
    nodes: int
    is_closed: bool  # Whether the search ended, not its budget.


class _Bands:
    """Price and floor of variances within bands, (J,) m^2, both squared."""

    def __init__(self, edges: tuple[float, ...]) -> None:
        self.unit = band_densities(edges)
        # Prices at the corners of boxes, which neighbours share; for one certificate.
        self.known: dict[tuple[float, ...], float] = {}

    def price(self, variance: tuple[float, ...]) -> float:
        if variance not in self.known:
            density = np.array(variance) @ self.unit
            self.known[variance] = spectra.predicted_rms_m(density) ** 2
        return self.known[variance]

    def floor(self, variance: Floats) -> float:
        return spectra.floor_m(np.asarray(variance) @ self.unit) ** 2

    def tangent(self, variance: Floats) -> tuple[float, Floats]:
        """Return the floor at a point and its slopes there."""
        here = self.floor(variance)
        steps = 1e-4 * (variance + 1e-3)
        moved = [self.floor(variance + row) for row in np.diag(steps)]
        return here, (np.array(moved) - here) / steps


def certify(
    *,
    floor: float,
    edges: tuple[float, ...],
    best_m: float,
    gap: float = 0.002,
    most_nodes: int = 1000,
) -> Certificate:
    """Bound the robot's error from below over all spectra of the bands.

    Branch and bound over boxes of variances. Price and floor grow with each variance,
    so that the lower corner bounds the price of a box, and the upper corner says
    whether any point keeps the floor. Both are concave: on a box the price is at least
    any mixture of its corners, and the floor at most its tangents. A linear programme
    over mixtures of corners bounds the box. The search ends once no box is below
    `best_m` by more than the share `gap`.
    """
    bands = _Bands(edges)
    least, most = np.zeros(len(bands.unit)), np.full(len(bands.unit), _MOST_STD_M**2)
    target = (best_m * (1.0 - gap)) ** 2
    numbers = itertools.count()
    boxes = [(bands.price(tuple(least)), next(numbers), least, most)]
    nodes = 0
    while boxes and boxes[0][0] < target and nodes < most_nodes:
        _, _, low, high = heappop(boxes)
        for part in _split(bands, low, high):
            nodes += 1
            bound = _box_bound(bands, *part, floor=floor)
            if bound < target:
                heappush(boxes, (bound, next(numbers), *part))
    open_m2 = boxes[0][0] if boxes else target
    return Certificate(math.sqrt(min(open_m2, target)), nodes, open_m2 >= target)


def _split(bands: _Bands, low: Floats, high: Floats) -> list[tuple[Floats, Floats]]:
    """Halve a box, in standard deviation, along the band that changes the price most."""
    rise = []
    for row in range(low.size):
        corner = low.copy()
        corner[row] = high[row]
        rise.append(bands.price(tuple(corner)))
    row = int(np.argmax(rise))
    middle = (0.5 * (math.sqrt(low[row]) + math.sqrt(high[row]))) ** 2
    below, above = high.copy(), low.copy()
    below[row] = above[row] = middle
    return [(low, below), (above, high)]


def _box_bound(bands: _Bands, low: Floats, high: Floats, *, floor: float) -> float:
    """Return a lower bound of the squared price in a box; inf if none keeps the floor."""
    if bands.floor(high) < floor**2:
        return math.inf
    base = bands.price(tuple(low))
    if bands.floor(low) >= floor**2:
        return base
    corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
    prices = [bands.price(tuple(corner)) for corner in corners]
    rows, limits = [], []
    for point in (_crossing(bands, low, high, floor), high, 0.5 * (low + high)):
        here, slope = bands.tangent(point)
        rows.append(-(corners - point) @ slope)
        limits.append(here - floor**2 + _TOLERANCE)
    result = linprog(
        prices,
        A_ub=rows,
        b_ub=limits,
        A_eq=np.ones((1, len(corners))),
        b_eq=[1.0],
    )
    if result.status == 2:  # noqa: PLR2004 - infeasible
        return math.inf
    return max(base, float(result.fun)) if result.success else base


def _crossing(bands: _Bands, low: Floats, high: Floats, floor: float) -> Floats:
    """Return the point of a box's diagonal that keeps the floor exactly, nearly."""
    near, far = 0.0, 1.0
    for _ in range(12):
        middle = 0.5 * (near + far)
        keeps = bands.floor(low + middle * (high - low)) >= floor**2
        near, far = (near, middle) if keeps else (middle, far)
    return np.asarray(low + far * (high - low))


def main() -> None:
    """Print a row for each floor."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--floor", type=float, action="append")
    for floor in parser.parse_args().floor or FLOORS_M:
        smooth = best_order(floor=floor, order=spectra.SMOOTH_ORDER)
        ou = best_order(floor=floor, order=1.0)
        mixture = best_mixture(floor=floor, n=2)
        fine = best_bands(near=smooth, floor=floor, edges=FINE_EDGES)
        coarse = best_bands(near=smooth, floor=floor, edges=BAND_EDGES)
        proof = certify(floor=floor, edges=BAND_EDGES, best_m=coarse.robot_m)
        print(
            f"floor {floor:g} m: smooth theta {smooth.parameters[0]:.4f} s"
            f" std {spectra.std_of_density(smooth.density):.4f} m"
            f" robot {smooth.robot_m:.4f} m; ou tau {ou.parameters[0]:.2f} s"
            f" std {spectra.std_of_density(ou.density):.3f} robot {ou.robot_m:.4f};"
            f" mixture {mixture.robot_m:.4f}; fine bands {fine.robot_m:.4f};"
            f" coarse bands {coarse.robot_m:.4f}, bound {proof.bound_m:.4f}"
            f" ({proof.nodes} boxes, {'closed' if proof.is_closed else 'open'})",
            flush=True,
        )


if __name__ == "__main__":
    main()
