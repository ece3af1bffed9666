"""Folds of people: whom an adversary attacks, is trained on and is calibrated on.

People of one walking group always have one role: their walks resemble each other.
"""

import numpy as np
from numpy.random import Generator

from isac_track.types import Bools, Ints

N_FOLDS = 2
# Share of the people to learn from that is set aside to calibrate scores.
CALIBRATING_SHARE = 1 / 3


def split_people(group: tuple[str, ...], *, rng: Generator) -> Ints:
    """Return the fold of each person, (K,) 0 or 1: whole groups, similar sizes."""
    names, cluster, sizes = np.unique(group, return_inverse=True, return_counts=True)
    fold = np.empty(names.size, dtype=np.int64)
    count = [0, 0]
    # Large groups first, each to the smaller fold.
    drawn = rng.permutation(names.size)
    for name in drawn[np.argsort(-sizes[drawn], kind="stable")]:
        fold[name] = int(count[1] < count[0])
        count[fold[name]] += sizes[name]
    return fold[cluster]


def present_in_other_fold(
    present: Bools, *, fold: Ints, group: tuple[str, ...]
) -> Bools:
    """Return the people on whom the adversary of each fold may be trained, (2, K).

    They, and all people who walk with them, are present in the other fold only.
    `present`, (S, K), are the people at each rotation, `fold`, (S,), is its fold.
    """
    cluster = np.unique(group, return_inverse=True)[1]
    seen = np.stack([present[fold == number].any(axis=0) for number in range(N_FOLDS)])
    company_seen = np.stack([np.bincount(cluster, people) > 0 for people in seen])
    return np.asarray(seen[::-1] & ~company_seen[:, cluster])


def set_calibrators_aside(
    may_train_on: Bools, group: tuple[str, ...], *, rng: Generator
) -> tuple[Bools, Bools]:
    """Return the people to train on, and those to calibrate on, (2, K) each.

    `may_train_on`, (2, K), are both together, by fold. Groups stay whole.
    """
    cluster = np.unique(group, return_inverse=True)[1]
    calibrated_on = np.zeros_like(may_train_on)
    for fold, people in enumerate(may_train_on):
        clusters = rng.permutation(np.unique(cluster[people]))
        # At least one group calibrates, if another group remains to learn from.
        few = min(max(round(CALIBRATING_SHARE * clusters.size), 1), clusters.size - 1)
        calibrated_on[fold] = people & np.isin(cluster, clusters[: max(few, 0)])
    return may_train_on & ~calibrated_on, calibrated_on
