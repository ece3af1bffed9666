"""The best candidates of each probe: where a gallery is large, a linker scores these alone.

A cheap linker, which knows nothing of the mechanism, puts the gallery of each probe in
an order. The linker itself is asked about the first few; all others come below them, in
that order. Some probes are searched in full as well: what is lost is measured, not
believed.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from attacks.linkage.histogram import Histogram
from attacks.linkage.kinematic import Kinematic
from attacks.linkage.mean_distance import MeanDistance
from attacks.tasks.task_list import Task
from isac_track.linkability import rank1
from isac_track.types import Floats, Ints, Release

# Probes with a mate that are searched in full as well, over all searches of a cell.
CHECKED = 100
AT_ONCE = 64
"""Probes of a call of a linker of ours, which takes 1 to 2 ms however few they are. Probes that are
alike have much the same candidates: together they are compared with six times as many
as alone."""
_ITERATIONS = 10


class Approximated(NamedTuple):
    """Scores of a search of which a linker gave some, and the hits that shows the loss."""

    scores: Floats  # (P, G) as the linker gave them, or lower than any of these.
    exact: Floats  # (n,) `rank1` of the probes that are searched in full, by all pairs.
    approximate: Floats  # (n,) of the same probes, by `scores`.


def first_stage(task: Task) -> Histogram | Kinematic | MeanDistance:
    """Return the cheap linker of a task: of what takes a fifth of `shape`, it loses the least."""
    # Measured: docs/linkage.md.
    if task.is_open:
        return Kinematic()
    return MeanDistance() if task.shows_scene else Histogram()


def among_candidates(
    score: Callable[[Release, Release], Floats],
    probe: Release,
    gallery: Release,
    *,
    mate: Ints,
    first: Floats,
    n_candidates: int,
    n_checked: int,
    n_at_once: int,
    rng: Generator,
) -> Approximated:
    """Return what a linker makes of a search if it is asked about some candidates of each probe.

    `score` is the linker, fitted, of two releases of P and G walks; the places of the
    mates, (P,), are for what is lost alone. `first`, (P, G), are the scores of the
    first stage; equal ones are put in a random order. Of each probe `n_candidates` are
    scored, at most G; `n_checked` probes with a mate are searched in full, if there are
    as many. `n_at_once`, `AT_ONCE` or 1, are the probes of a call: all of it are
    compared with the candidates of any.
    """
    n_probes, n_gallery = first.shape
    n_candidates = min(n_candidates, n_gallery)
    shuffled = rng.permutation(n_gallery)
    computed = np.empty((n_probes, n_candidates))
    columns = np.empty((n_probes, n_candidates), dtype=np.int64)
    # In single precision, as linkers' scores are rounded to: half the memory.
    scores: Any = np.empty((n_probes, n_gallery), dtype=np.float32)
    falling = np.arange(1.0, n_gallery + 1.0) / n_gallery
    alike = _alike_together(first, rng)
    for start in range(0, n_probes, n_at_once):
        rows = alike[start : start + n_at_once]
        order = shuffled[np.argsort(-first[rows][:, shuffled], axis=1)]
        scores[rows[:, None], order] = falling
        columns[rows] = order[:, :n_candidates]
        union, place = np.unique(columns[rows], return_inverse=True)
        found = score(probe.tracks(rows), gallery.tracks(union))
        computed[rows] = np.take_along_axis(found, place.reshape(rows.size, -1), axis=1)
    lowest = float(computed.min())
    if lowest < -np.finfo(np.float32).max / 4:  # what is below it needs more room
        scores = scores.astype(np.float64)
    scores *= -max(1.0, abs(lowest))
    scores += lowest
    np.put_along_axis(scores, columns, computed, axis=1)
    mated = np.flatnonzero(mate >= 0)
    rows = np.sort(rng.choice(mated, min(n_checked, mated.size), replace=False))
    if not rows.size:
        return Approximated(scores, np.zeros(0), np.zeros(0))
    exact = rank1(scores=score(probe.tracks(rows), gallery), mate=mate[rows])
    return Approximated(scores, exact, rank1(scores=scores[rows], mate=mate[rows]))


def _alike_together(first: Floats, rng: Generator) -> Ints:
    """Return the probes by the first principal component of their scores: neighbours are alike."""
    mean, axis = first.mean(axis=0), rng.standard_normal(first.shape[1])
    component = np.zeros(len(first))
    for _ in range(_ITERATIONS):  # power iteration
        component = first @ axis - mean @ axis
        axis = component @ first - component.sum() * mean
        axis /= np.linalg.norm(axis) or 1.0
    return np.argsort(component, kind="stable")
