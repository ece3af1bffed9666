"""The best candidates of each probe: where a gallery is large, a linker scores these alone.

A cheap linker, which knows nothing of the mechanism, puts the gallery of each probe in an order.
The linker itself is asked about the first few, probe by probe; all others come below them, in that
order. Some probes are searched in full as well: what is lost is measured, not believed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from attacks.linkage.histogram import Histogram
from attacks.linkage.kinematic import Kinematic
from isac_track.linkability import rank1

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.random import Generator

    from attacks.tasks.task_list import Task
    from isac_track.types import Floats, Ints, Release

CHECKED = 100
"""Probes with a mate that are searched in full as well, over all searches of a cell."""


class Approximated(NamedTuple):
    """Scores of a search of which a linker gave some, and the hits that shows the loss."""

    scores: Floats
    """(P, G) as the linker gave them, or lower than any of these."""
    exact: Floats
    """(n,) `rank1` of the probes that are searched in full, by all pairs."""
    approximate: Floats
    """(n,) of the same probes, by `scores`."""


def first_stage(task: Task) -> Histogram | Kinematic:
    """Return the cheap linker of a task.

    Chosen by measurement (docs/linkage.md): of what takes a fifth of `shape`, it loses the least.
    """
    return Kinematic() if task.shows_scene else Histogram()


def among_candidates(
    score: Callable[[Release, Release], Floats],
    probe: Release,
    gallery: Release,
    *,
    mate: Ints,
    first: Floats,
    n_candidates: int,
    n_checked: int,
    rng: Generator,
) -> Approximated:
    """Return what a linker makes of a search if it is asked about some candidates of each probe.

    Parameters
    ----------
    score : callable
        The linker, fitted: (p, g) of two releases. It is called with one probe at a time.
    probe, gallery : Release
        Of P and G walks.
    mate : (P,)
        Place in the gallery, or -1: for what is lost alone.
    first : (P, G)
        Scores of the first stage. Equal ones are put in a random order.
    n_candidates : int
        How many of each probe are scored; at most G are.
    n_checked : int
        How many probes with a mate are searched in full, if there are as many.
    rng : Generator
    """
    n_probes, n_gallery = first.shape
    n_candidates = min(n_candidates, n_gallery)
    shuffled = rng.permutation(n_gallery)
    computed = np.empty((n_probes, n_candidates))
    columns = np.empty((n_probes, n_candidates), dtype=np.int64)
    scores = np.empty((n_probes, n_gallery))
    falling = -np.arange(1.0, n_gallery + 1.0) / n_gallery
    for row in range(n_probes):
        order = shuffled[np.argsort(-first[row, shuffled], kind="stable")]
        scores[row, order] = falling
        columns[row] = np.sort(order[:n_candidates])  # the order tells nobody anything
        computed[row] = score(probe.tracks([row]), gallery.tracks(columns[row]))[0]
    lowest = float(computed.min())
    scores *= max(1.0, abs(lowest))
    scores += lowest
    np.put_along_axis(scores, columns, computed, axis=1)
    mated = np.flatnonzero(mate >= 0)
    rows = np.sort(rng.choice(mated, min(n_checked, mated.size), replace=False))
    if not rows.size:
        return Approximated(scores, np.zeros(0), np.zeros(0))
    exact = rank1(scores=score(probe.tracks(rows), gallery), mate=mate[rows])
    return Approximated(scores, exact, rank1(scores=scores[rows], mate=mate[rows]))
