"""Learn a linker's parameters from a training set of mated pairs."""

from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np

from attacks.remembered import memoised, select_tracks
from isac_track.linkability.ranks import standing
from isac_track.protocols import AttackContext, LinkageTrainingSet, Linker
from isac_track.types import Floats, Ints, Knowledge, Release, read_only

MOST_PAIRS = 2**19
"""Pairs of two releases of which all scores are memoised, 4 MB a linker, adversary."""
# With fewer mated pairs learning would be unreliable: defaults stay.
LEAST_MATES = 8
MARGIN = 0.02  # Of the mean log rank: with 90 pairs a smaller gain is as likely chance.


def make_linker(score: Callable[..., Floats], *chosen: object) -> Linker:
    """Return the linker that scores two releases by ``score(probe, gallery, *chosen)``.

    Where two adversaries choose the same parameters, the same releases are scored once.
    """

    def link(probe: Release, gallery: Release) -> Floats:
        if len(probe) * len(gallery) > MOST_PAIRS:
            return _score_many(probe, gallery, score, *chosen)
        return _score_few(probe, gallery, score, *chosen)

    return link


def _score(
    probe: Release, gallery: Release, score: Callable[..., Floats], *chosen: object
) -> Floats:
    return read_only(score(probe, gallery, *chosen))


_score_few = memoised(_score)
"""Memoised for as long as the probe is alive."""


# The last two score matrices, those of either half of the people.
@lru_cache(maxsize=2)
def _score_many(
    probe: Release, gallery: Release, score: Callable[..., Floats], *chosen: object
) -> Floats:
    """Return scores in the precision to which all are rounded in the end.

    The cache holds the last two score matrices, those of each half of the people: all
    matrices of a level would not fit into memory.
    """
    return read_only(_score(probe, gallery, score, *chosen).astype(np.float32))


def mated_rows(train: LinkageTrainingSet) -> Ints:
    """Return the numbers of the probes of a training set that have a mate."""
    return np.flatnonzero(train.mate >= 0)


def select_pairs(train: LinkageTrainingSet, rows: Ints) -> LinkageTrainingSet:
    """Return a training set of some mated probes and their mates, and no other walk."""
    probe = select_tracks(train.probe, rows)
    gallery = select_tracks(train.gallery, train.mate[rows])
    return LinkageTrainingSet(probe, gallery, np.arange(rows.size))


def can_learn(context: AttackContext) -> bool:
    """Return whether there is a training set with `LEAST_MATES` mated pairs or more."""
    return (
        Knowledge.TRAIN in context.granted
        and mated_rows(context.train).size >= LEAST_MATES
    )


def learn_parameters(
    context: AttackContext,
    options: Sequence[Sequence[Any]],
    *,
    scores: Callable[[LinkageTrainingSet], Callable[..., Floats]],
    most: int | None = None,
) -> tuple[Any, ...]:
    """Return a value for each parameter, chosen one after the other by `log_rank`.

    The first of a parameter's `options` is its default. Another value replaces it only
    if it gains `MARGIN`, and only if the context has enough mates to learn from.
    `scores` takes a training set, and returns the function from a value for each
    parameter to the scores, (P, G). At most `most` mated pairs are used.
    """
    best = tuple(values[0] for values in options)
    if not can_learn(context) or all(len(values) == 1 for values in options):
        return best
    train = context.train
    if most is not None:
        train = select_pairs(train, mated_rows(train)[:most])
    score = scores(train)

    # Each parameter is searched with the others' best; it ends with this call.
    @cache
    def loss(choice: tuple[Any, ...]) -> float:
        return log_rank(score(*choice), mate=train.mate)

    for place, values in enumerate(options):
        winner = min(
            ((*best[:place], value, *best[place + 1 :]) for value in values), key=loss
        )
        if loss(winner) < loss(best) - MARGIN:
            best = winner
    return best


def log_rank(scores: Floats, *, mate: Ints) -> float:
    """Return the mean log rank of the mates among all candidates; ties count half."""
    above, tied = standing(scores, mate)
    return float(np.log1p(above + (tied - 1) / 2.0)[mate >= 0].mean())
