"""Forward-backward smoothing of the log about a person, on a chain of walks."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from attacks.following.walk_chain import Chain
from isac_track.types import Floats


@dataclass(frozen=True, eq=False, slots=True)
class Smoothed:
    """Posterior over the cells at T steps."""

    cells: Floats  # (T, n_cells) probability of each cell.
    log_evidence: float  # Log probability of all likelihoods.


def smooth_chain(
    chain: Chain, likelihood: Callable[[int], Floats], *, n_steps: int
) -> Smoothed:
    """Return the posterior given the likelihood of each step, (S,).

    `likelihood` is called twice for each step and returns the same values. At least a
    state must be possible at every step.
    """
    filtered = np.empty((n_steps, chain.stationary.size))
    log_evidence, ahead = 0.0, chain.stationary
    for step in range(n_steps):
        if step:
            ahead = chain.forward(ahead)
        ahead = ahead * likelihood(step)
        total = float(ahead.sum())
        log_evidence += float(np.log(total))
        ahead = ahead / total
        filtered[step] = ahead
    cells = np.empty((n_steps, chain.n_cells))
    later = np.ones(chain.stationary.size)
    for step in reversed(range(n_steps)):
        if step < n_steps - 1:
            later = chain.backward(later * likelihood(step + 1))
            later /= later.max()
        joint = filtered[step] * later
        cells[step] = chain.by_class(joint / joint.sum()).sum(axis=0)
    return Smoothed(cells, log_evidence)
