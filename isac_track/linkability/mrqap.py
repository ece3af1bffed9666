"""Permutation regression of matrices: what a predictor explains beyond controls.

A matrix holds a number for each ordered pair of nodes. Pairs that share a node depend
on each other, so that the usual test of a regression rejects far too often.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from isac_track.types import Bools, Floats, Ints

_ROUNDING: Final = 1e-9
_LEAST: Final = 1e-300


@dataclass(frozen=True, slots=True)
class Regression:
    """Coefficient of the predictor beyond the controls.

    Attributes
    ----------
    coefficient : float
        Unit of the response per unit of the predictor.
    t : float
        The coefficient over its ordinary standard error: a pivot, not a test.
    p_value : float
        One-sided permutation p-value of a positive coefficient.
    n_nodes : int
        Nodes that are permuted.
    """

    coefficient: float
    t: float
    p_value: float
    n_nodes: int


def nested_permutation(
    response: Floats,
    predictor: Floats,
    controls: Floats,
    *,
    counts: Bools,
    block: Ints,
    rng: np.random.Generator,
    n_permutations: int = 999,
) -> Regression:
    """Regress a matrix on a predictor and controls, with double semi-partialling.

    The predictor's residual from the controls is permuted, rows and columns jointly,
    within the blocks of nodes; its t beyond the controls is compared with the observed.
    Every matrix is first centred by row and column within each pair of blocks: a probe
    that scores high with everybody, and a candidate whom everybody resembles, drop out.

    `response` and `predictor` are (U, U), `controls` (C, U, U). `counts`, (U, U), tells
    the pairs that count; it must hold all pairs of two blocks or none. `block`, (U,),
    is the block of each node. ValueError otherwise, or for fewer than 999 permutations.

    References
    ----------
    Dekker, Krackhardt, Snijders, "Sensitivity of MRQAP tests to collinearity and
    autocorrelation conditions", Psychometrika 72, 2007. p-value: Phipson and Smyth,
    Statistical Applications in Genetics and Molecular Biology 9(1), 2010.
    """
    if n_permutations < 999:  # noqa: PLR2004 - p-values to a thousandth
        raise ValueError(f"n_permutations must be at least 999, got {n_permutations}")
    squares = _squares(counts, block)
    y = centre(response, squares)[counts]
    z = np.stack([centre(control, squares)[counts] for control in controls], axis=1)
    basis = _orthonormal(z)
    x = centre(predictor, squares)[counts]
    residual = np.zeros(response.shape)
    residual[counts] = x - basis @ (basis.T @ x)
    # What permuted residuals are multiplied by: the response's rest, and the controls.
    against = np.column_stack([y - basis @ (basis.T @ y), basis])
    free = y.size - basis.shape[1] - 1 - _centred(squares)
    # The controls explain the predictor wholly if they leave no more than rounding.
    least_power = _ROUNDING * float(x @ x)
    coefficient, observed = _slope(residual[counts], against, free, least_power)
    groups = [np.flatnonzero(block == name) for name in np.unique(block)]
    rows, columns = np.nonzero(counts)
    hits, order = 0, np.arange(block.size)
    for _ in range(n_permutations):
        for group in groups:
            order[group] = rng.permutation(group)
        moved = residual[order[rows], order[columns]]
        hits += _slope(moved, against, free, least_power)[1] >= observed - _ROUNDING
    p_value = (1 + int(hits)) / (1 + n_permutations)
    return Regression(coefficient, observed, p_value, block.size)


def _squares(counts: Bools, block: Ints) -> list[tuple[Ints, Ints]]:
    """Return rows and columns of each pair of blocks that counts."""
    squares = []
    for first in np.unique(block):
        for second in np.unique(block):
            rows, columns = (
                np.flatnonzero(block == first),
                np.flatnonzero(block == second),
            )
            part = counts[np.ix_(rows, columns)]
            if part.any() and not part.all():
                raise ValueError("all pairs of two blocks count, or none")
            if part.any():
                squares.append((rows, columns))
    if not squares:
        raise ValueError("no pair counts")
    return squares


def centre(matrix: Floats, squares: list[tuple[Ints, Ints]]) -> Floats:
    """Return a matrix less row and column means within each pair of blocks."""
    result = np.zeros(matrix.shape)
    for rows, columns in squares:
        part = matrix[np.ix_(rows, columns)]
        part = part - part.mean(axis=0) - part.mean(axis=1, keepdims=True) + part.mean()
        result[np.ix_(rows, columns)] = part
    return result


def _centred(squares: list[tuple[Ints, Ints]]) -> int:
    """Return the degrees of freedom that the means take."""
    return sum(rows.size + columns.size - 1 for rows, columns in squares)


def _orthonormal(z: Floats) -> Floats:
    """Return an orthonormal basis, (E, r), of the controls' span."""
    left, size, _ = np.linalg.svd(z, full_matrices=False)
    return np.asarray(
        left[:, size > _ROUNDING * max(float(size.max(initial=0.0)), _LEAST)]
    )


def _slope(
    x: Floats, against: Floats, free: int, least_power: float
) -> tuple[float, float]:
    """Return slope and t beyond the controls of a predictor, (E,).

    `against`, (E, 1 + r), has the response's residual and the controls' basis. Both
    are 0 where the controls leave at most `least_power` of the sum of squares of `x`.
    """
    products = x @ against
    power = float(x @ x - products[1:] @ products[1:])
    if power <= least_power:
        return 0.0, 0.0
    slope = float(products[0]) / power
    left = float(against[:, 0] @ against[:, 0]) - slope**2 * power
    return slope, slope / float(np.sqrt(max(left, _LEAST) / free / power))
