"""Who is attacked, who teaches the adversary and who calibrates it: walking groups stay whole."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.random import Generator

    from isac_track.types import Bools, Ints, Tracks

CALIBRATING_SHARE = 1 / 3
"""Of the people to learn from, who are kept apart for the calibration of scores."""


def joined(first: Sequence[str], second: Sequence[str]) -> tuple[str, ...]:
    """Return the cluster of each person: who shares a group in either session, or over others.

    Each is called by the first name, in alphabetical order, of its groups in the first session.
    """
    names, one = np.unique(first, return_inverse=True)
    names_later, other = np.unique(second, return_inverse=True)
    size = names.size + names_later.size
    people = coo_array((np.ones(one.size), (one, names.size + other)), shape=(size, size))
    component = connected_components(people, directed=False)[1][: names.size]
    first_name = names[np.unique(component, return_index=True)[1]]
    return tuple(first_name[component[one]].tolist())


def halves(group: tuple[str, ...], *, rng: Generator) -> Ints:
    """Return the half of each person, (K,) 0 or 1: groups stay whole, halves are of like size."""
    names, cluster, sizes = np.unique(group, return_inverse=True, return_counts=True)
    half = np.empty(names.size, dtype=np.int64)
    count = [0, 0]
    # Large groups first, each to the smaller half.
    drawn = rng.permutation(names.size)
    for name in drawn[np.argsort(-sizes[drawn], kind="stable")]:
        half[name] = int(count[1] < count[0])
        count[half[name]] += sizes[name]
    return half[cluster]


def roles(group: tuple[str, ...], *, may_teach: Bools, rng: Generator) -> tuple[Bools, Bools]:
    """Return who is learnt from and who calibrates, (2, K) each: groups stay whole."""
    cluster = np.unique(group, return_inverse=True)[1]
    calibrates = np.zeros_like(may_teach)
    for fold, teachers in enumerate(may_teach):
        clusters = rng.permutation(np.unique(cluster[teachers]))
        # One at least, where there is another one to learn from.
        few = min(max(round(CALIBRATING_SHARE * clusters.size), 1), clusters.size - 1)
        calibrates[fold] = teachers & np.isin(cluster, clusters[: max(few, 0)])
    return may_teach & ~calibrates, calibrates


def alone(tracks: Tracks, rows: Ints) -> Bools:
    """Return which of these tracks are the only ones of their group in the recording."""
    _, cluster, sizes = np.unique(tracks.group, return_inverse=True, return_counts=True)
    alone: Bools = sizes[cluster][rows] == 1
    return alone
