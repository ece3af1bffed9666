"""In a large gallery, let a linker score only the best candidates of each probe.

A cheap linker, which knows nothing of the mechanism, ranks the gallery of each probe.
The linker itself scores the first few; all others come below them, in that order. Some
probes are searched in full as well, to measure what the short cut costs.
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
"""Probes per call of a built-in linker; a call takes 1 to 2 ms however few they are.

Similar probes have nearly the same candidates: together they are compared with six
times as many as alone."""
_ITERATIONS = 10


class Approximated(NamedTuple):
    """Scores of a search, some by the linker, and the hits that show the loss."""

    scores: Floats  # (P, G) as the linker gave them, or lower than any of these.
    exact: Floats  # (n,) `rank1` of the probes that are searched in full, by all pairs.
    approximate: Floats  # (n,) of the same probes, by `scores`.


def first_stage(task: Task) -> Histogram | Kinematic | MeanDistance:
    """Return the cheap linker of a task: five times as fast as `shape`, least loss."""
    # Measured: docs/explanation/linkage.md.
    if task.is_open:
        return Kinematic()
    return MeanDistance() if task.shows_scene else Histogram()


def among_candidates(
    score: Callable[[Release, Release], Floats],
    probe: Release,
    gallery: Release,
    *,
    mate: Ints,
    first_scores: Floats,
    n_candidates: int,
    n_checked: int,
    n_at_once: int,
    rng: Generator,
) -> Approximated:
    """Return the scores of a search where a linker scores some candidates per probe.

    `score` is the fitted linker of two releases of P and G walks. `mate`, (P,), are the
    rows of the mates, used only to measure the loss. `first_scores`, (P, G), are those
    of the first stage; ties are put in a random order. Of each probe `n_candidates` are
    scored, at most G; `n_checked` probes with a mate are searched in full, if there are
    as many. `n_at_once`, `AT_ONCE` or 1, is the number of probes per call: each of them
    is compared with the candidates of all.
    """
    n_probes, n_gallery = first_scores.shape
    n_candidates = min(n_candidates, n_gallery)
    shuffled = rng.permutation(n_gallery)
    computed = np.empty((n_probes, n_candidates))
    columns = np.empty((n_probes, n_candidates), dtype=np.int64)
    # In single precision, to which linkers' scores are rounded: half the memory.
    scores: Any = np.empty((n_probes, n_gallery), dtype=np.float32)
    # At first a score is the rank by the first stage, in (0, 1], best first.
    ranks = np.arange(1.0, n_gallery + 1.0) / n_gallery
    similar_together = _order_by_similarity(first_scores, rng)
    for start in range(0, n_probes, n_at_once):
        rows = similar_together[start : start + n_at_once]
        order = shuffled[np.argsort(-first_scores[rows][:, shuffled], axis=1)]
        scores[rows[:, None], order] = ranks
        columns[rows] = order[:, :n_candidates]
        union, place = np.unique(columns[rows], return_inverse=True)
        union_scores = score(probe.tracks(rows), gallery.tracks(union))
        computed[rows] = np.take_along_axis(
            union_scores, place.reshape(rows.size, -1), axis=1
        )
    lowest = float(computed.min())
    if lowest < -np.finfo(np.float32).max / 4:  # lower scores need double precision
        scores = scores.astype(np.float64)
    # Ranks become scores below all that were computed: better ranks less far below.
    scores *= -max(1.0, abs(lowest))
    scores += lowest
    np.put_along_axis(scores, columns, computed, axis=1)
    mated = np.flatnonzero(mate >= 0)
    rows = np.sort(rng.choice(mated, min(n_checked, mated.size), replace=False))
    if not rows.size:
        return Approximated(scores, np.zeros(0), np.zeros(0))
    exact = rank1(scores=score(probe.tracks(rows), gallery), mate=mate[rows])
    return Approximated(scores, exact, rank1(scores=scores[rows], mate=mate[rows]))


def _order_by_similarity(scores: Floats, rng: Generator) -> Ints:
    """Return the probes, (P,), by the first principal component of their scores."""
    mean, direction = scores.mean(axis=0), rng.standard_normal(scores.shape[1])
    component = np.zeros(len(scores))
    for _ in range(_ITERATIONS):  # power iteration
        component = scores @ direction - mean @ direction
        direction = component @ scores - component.sum() * mean
        direction /= np.linalg.norm(direction) or 1.0
    return np.argsort(component, kind="stable")
