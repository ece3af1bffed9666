"""Learning from mates: what an adversary with a training set of pairs does first."""

from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np

from attacks.remembered import part, remembered
from isac_track.linkability.ranks import standing
from isac_track.protocols import AttackContext, LinkageTrainingSet, Linker
from isac_track.types import Floats, Ints, Knowledge, Release, read_only

_MOST_PAIRS = (
    2**19
)  # Of which all scores are remembered, 4 MB for each linker and adversary.
# Fewer mated pairs teach nothing that could be trusted: defaults are kept.
LEAST_MATES = 8
MARGIN = 0.02  # Of the mean log rank: with 90 pairs a smaller gain is as likely chance.


def linker(score: Callable[..., Floats], *chosen: object) -> Linker:
    """Return what scores two releases by ``score(probe, gallery, *chosen)``.

    Where two adversaries choose alike the same releases are scored once.
    """

    def linked(probe: Release, gallery: Release) -> Floats:
        is_large = len(probe) * len(gallery) > _MOST_PAIRS
        return (_scored_last if is_large else _scored)(probe, gallery, score, *chosen)

    return linked


def _made(
    probe: Release, gallery: Release, score: Callable[..., Floats], *chosen: object
) -> Floats:
    return read_only(score(probe, gallery, *chosen))


_scored = remembered(_made)

# One of each half of the people, in the precision that all are rounded to in the end:
# all of a level would not fit into memory.
_scored_last = lru_cache(maxsize=2)(
    lambda *of: read_only(_made(*of).astype(np.float32))
)


def mated(train: LinkageTrainingSet) -> Ints:
    """Return the probes of a training set that have a mate."""
    return np.flatnonzero(train.mate >= 0)


def among(train: LinkageTrainingSet, rows: Ints) -> LinkageTrainingSet:
    """Return some mated probes of a training set and their mates, nobody else."""
    probe, gallery = part(train.probe, rows), part(train.gallery, train.mate[rows])
    return LinkageTrainingSet(probe, gallery, np.arange(rows.size))


def teaches(context: AttackContext) -> bool:
    """Return whether there is a training set with `LEAST_MATES` mated pairs or more."""
    return (
        Knowledge.TRAIN in context.granted and mated(context.train).size >= LEAST_MATES
    )


def learn(
    context: AttackContext,
    options: Sequence[Sequence[Any]],
    *,
    scores: Callable[[LinkageTrainingSet], Callable[..., Floats]],
    most: int | None = None,
) -> tuple[Any, ...]:
    """Return a value for each of some parameters, chosen one after the other by `log_rank`.

    Another value than the default, the first of a parameter's `options`, is taken if it
    gains `MARGIN`; where the context teaches nothing, none is. `scores` goes from a
    training set to what turns a value for each parameter into its scores, (P, G).
    Learnt from are at the `most` so many mated pairs and nobody else.
    """
    best = tuple(values[0] for values in options)
    if not teaches(context) or all(len(values) == 1 for values in options):
        return best
    train = context.train
    if most is not None:
        train = among(train, mated(train)[:most])
    score = scores(train)

    @cache
    def loss(choice: tuple[Any, ...]) -> float:
        return log_rank(score(*choice), mate=train.mate)

    for which, values in enumerate(options):
        winner = min(
            ((*best[:which], value, *best[which + 1 :]) for value in values), key=loss
        )
        if loss(winner) < loss(best) - MARGIN:
            best = winner
    return best


def log_rank(scores: Floats, *, mate: Ints) -> float:
    """Return the mean log of the rank of each mate among all candidates; ties count half."""
    above, tied = standing(scores, mate)
    return float(np.log1p(above + (tied - 1) / 2.0)[mate >= 0].mean())
