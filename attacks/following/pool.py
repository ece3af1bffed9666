"""A linear pool of experts, weighed by how well they did on other people.

References
----------
Genest, Zidek, "Combining probability distributions", Statistical Science 1, 1986.
"""

from typing import Final

import numpy as np

from attacks.following.experts import N_GAPS
from isac_track.types import Floats, Ints

_EM_STEPS: Final = 200
_PRIOR_COUNT: Final = 1.0  # Instants that each expert has explained beforehand.


def pool_weights(log_density: Floats, gap: Ints) -> Floats:
    """Return the weights of X experts in each bin of gaps, (N_GAPS, X).

    They maximise the likelihood of the truth at K instants, `log_density` (K, X), by
    the EM algorithm. A bin without an instant weighs the experts equally. An expert
    without an opinion in a bin, -inf everywhere, weighs nothing there.
    """
    n_experts = log_density.shape[1]
    weights = np.full((N_GAPS, n_experts), 1.0 / n_experts)
    for number in np.unique(gap).tolist():
        rows = log_density[gap == number]
        density = np.exp(rows - rows.max(axis=1, keepdims=True))
        speaks = np.isfinite(rows).any(axis=0)
        weights[number] = speaks / speaks.sum()
        for _ in range(_EM_STEPS):
            share = density * weights[number]
            share /= share.sum(axis=1, keepdims=True)
            count = share.sum(axis=0) + _PRIOR_COUNT * speaks
            weights[number] = count / count.sum()
    return weights


def pooled_log_density(log_density: Floats, gap: Ints, weights: Floats) -> Floats:
    """Return the log density of the pool at K instants, (K,)."""
    with np.errstate(divide="ignore"):
        terms = log_density + np.log(weights[gap])
    return np.asarray(np.logaddexp.reduce(terms, axis=1))
