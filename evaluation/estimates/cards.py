"""Scores of a card, and those that count: of the best robot and strongest adversary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

from evaluation.estimates.json_numbers import json_number
from evaluation.store.cards import Card, CardScore
from isac_track.errors import DataError

if TYPE_CHECKING:
    from evaluation.plan.protocol import Protocol
    from isac_track.intervals import Estimate

MISSED, KNOWN, FOLLOWED = AXES = ("missed", "known", "followed")
_NORMAL: Final = 1.959963984540054  # Half-width of a 95 % interval in standard errors.


def card_score(metric: str, by: str, estimate: Estimate) -> CardScore:
    """Return an estimate as a score of a card.

    The standard error is that of the replicates. Where they do not vary, as at a share
    of 0, it is the half-width of the interval over 1.96.
    """
    error = estimate.standard_error
    if not error > 0.0:
        error = (estimate.ci_high - estimate.ci_low) / (2.0 * _NORMAL)
    return CardScore(
        metric=metric,
        by=by,
        value=json_number(estimate.value),
        ci_low=json_number(estimate.ci_low),
        ci_high=json_number(estimate.ci_high),
        error=json_number(error),
        n=int(estimate.n),
    )


def primary_scores(
    scores: Sequence[CardScore], protocol: Protocol
) -> dict[str, CardScore]:
    """Return the score of each axis: of the best robot, and the strongest adversaries.

    These are plain extremes over all readers, not adjusted for the choice, which is made
    on the people that are scored. `known` and `followed` therefore err on the side of
    the adversary, and `missed` errs low: on the side of the mechanism (docs/protocol.md).

    DataError if a metric of the protocol has no score.
    """
    return {
        axis: _extreme(scores, protocol.primary[axis], is_least=axis == MISSED)
        for axis in AXES
    }


def _extreme(scores: Sequence[CardScore], metric: str, *, is_least: bool) -> CardScore:
    """Return the least or the greatest score of a metric; the first of equals."""
    valued = [
        score for score in scores if score.metric == metric and score.value is not None
    ]
    if not valued:
        raise DataError(f"a card needs a score of {metric}, and this has none")
    sign = 1.0 if is_least else -1.0
    return min(valued, key=lambda score: sign * (score.value or 0.0))


def score_difference(score: CardScore, other: CardScore) -> str:
    """Return the first number in which two scores of a reader differ, in full."""
    ours, others = asdict(score), asdict(other)
    name = next((name for name in ours if ours[name] != others[name]), "value")
    detail = "" if name == "value" else f" ({name})"
    return (
        f"{score.metric} by {score.by}{detail}: card {_full(ours[name])},"
        f" computed {_full(others[name])}"
    )


def _full(value: object) -> str:
    return "none" if value is None else repr(value)


def has_own_primary(card: Card, protocol: Protocol) -> bool:
    """Whether the primary scores of a card follow from its scores."""
    return not primary_fault(card, protocol)


def primary_fault(card: Card, protocol: Protocol) -> str:
    """Return the primary score that does not follow from a card's scores, or nothing.

    DataError if a metric of the protocol has no score.
    """
    for axis, score in primary_scores(card.scores, protocol).items():
        claim = card.primary[axis]
        if claim.by != score.by:
            return f"{axis} is by {claim.by} on the card, and by {score.by} computed"
        if claim != score:
            return f"{axis}: {score_difference(claim, score)}"
    return ""
