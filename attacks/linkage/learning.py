"""Learning from mates: what an adversary with a training set of pairs does first."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from attacks.linkage.signals import motions
from isac_track.protocols import LinkageTrainingSet
from isac_track.types import Knowledge, Release

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from isac_track.protocols import AttackContext
    from isac_track.types import Floats, Ints

_Value = TypeVar("_Value")

LEAST_MATES = 8
"""Fewer mated pairs teach nothing that could be trusted: defaults are kept."""
MARGIN = 0.02
"""Of the mean log rank: with 90 pairs a smaller gain is as likely chance."""


def mated(train: LinkageTrainingSet) -> Ints:
    """Return the probes of a training set that have a mate."""
    return np.flatnonzero(train.mate >= 0)


def teaches(context: AttackContext) -> bool:
    """Return whether there is a training set with `LEAST_MATES` mated pairs or more."""
    return Knowledge.TRAIN in context.granted and mated(context.train).size >= LEAST_MATES


def tried(given: _Value | None, candidates: Sequence[_Value]) -> Sequence[_Value]:
    """Return what is tried of a parameter: what was given, or else the candidates."""
    return candidates if given is None else (given,)


def few_mates(train: LinkageTrainingSet, *, most: int) -> LinkageTrainingSet:
    """Return the first `most` mated pairs of a training set, and nobody else."""
    rows = mated(train)[:most]
    return LinkageTrainingSet(
        probe=tracks_of(train.probe, rows),
        gallery=tracks_of(train.gallery, train.mate[rows]),
        mate=np.arange(rows.size),
    )


def tracks_of(release: Release, rows: Ints) -> Release:
    """Return some tracks of a release, in the order of `rows`."""
    sizes = np.diff(release.offsets)[rows]
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    samples = np.repeat(release.offsets[rows] - offsets[:-1], sizes) + np.arange(offsets[-1])
    return Release(
        t=release.t[samples],
        xy=release.xy[samples],
        sigma=None if release.sigma is None else release.sigma[samples],
        offsets=offsets,
        pseudonym=tuple(release.pseudonym[row] for row in rows),
    )


def learn(
    options: Sequence[Sequence[float]], *, loss: Callable[[tuple[float, ...]], float]
) -> tuple[float, ...]:
    """Return a value for each of some parameters, chosen one after the other; see `chosen`.

    Of each parameter the first option is the default, which those after it are tried with. All
    combinations would cost their product in place of their sum, and be more likely to find one
    that is best by chance.

    Parameters
    ----------
    options : one sequence for each parameter
    loss : callable
        The `log_rank` under one value for each parameter.
    """
    best = tuple(values[0] for values in options)
    least = None
    for which, values in enumerate(options):
        if len(values) == 1:
            continue
        least = loss(best) if least is None else least
        tried = [(*best[:which], value, *best[which + 1 :]) for value in values[1:]]
        losses = [least, *(loss(choice) for choice in tried)]
        winner = chosen(losses)
        best, least = [best, *tried][winner], losses[winner]
    return best


def chosen(losses: Sequence[float]) -> int:
    """Return which of some `log_rank` is least, but 0, the default, unless the gain is `MARGIN`."""
    best = int(np.argmin(losses))
    return best if losses[best] < losses[0] - MARGIN else 0


def log_rank(scores: Floats, *, mate: Ints) -> float:
    """Return the mean log of the rank of each mate among all candidates, 0 if all come first.

    Unlike the share of first ranks it sees how near a miss was, and unlike the mean rank it does
    not go by the hopeless. Ties count half.
    """
    rows = np.flatnonzero(mate >= 0)
    own = scores[rows, mate[rows]][:, None]
    above = (scores[rows] > own).sum(axis=1) + ((scores[rows] == own).sum(axis=1) - 1) / 2.0
    return float(np.log1p(above).mean())


def learn_motion(
    context: AttackContext,
    options: Sequence[Sequence[float]],
    *,
    most: int,
    score: Callable[..., Floats],
) -> tuple[float, ...]:
    """Return a factor of the widths of smoothing and other parameters, learnt; see `learn`.

    Parameters
    ----------
    context : AttackContext
        Where its training set has too few mates the first options are returned.
    options : one sequence for each parameter
        Of the first, factors in `attacks.linkage.signals.motions`.
    most : int
        Mated pairs to learn from: many candidates on all would cost more than the attack.
    score : callable
        From a probe's `Motion`, a gallery's and the other parameters to scores, (P, G).
    """
    if not teaches(context):
        return tuple(values[0] for values in options)
    train, factors = few_mates(context.train, most=most), options[0]
    probe, gallery = (motions(one, factors=factors) for one in (train.probe, train.gallery))
    walks = dict(zip(factors, zip(probe, gallery, strict=True), strict=True))
    return learn(
        options,
        loss=lambda choice: log_rank(score(*walks[choice[0]], *choice[1:]), mate=train.mate),
    )
