"""Whether two cards of an entry agree.

They do if no score differs at the protocol's level, two-sided, by its difference in
joint standard errors, with Holm's correction over the scores.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
from scipy.special import ndtr, ndtri

from evaluation.estimates.cards import AXES, score_difference
from isac_track.errors import DataError
from isac_track.linkability.significance import holm

if TYPE_CHECKING:
    from evaluation.plan.protocol import Protocol
    from evaluation.store.cards import Card, CardScore

Verdict: TypeAlias = Literal["equal", "agrees", "differs"]


@dataclass(frozen=True, slots=True)
class Agreement:
    """Whether a card computed again is the same: a verdict, and the reason."""

    verdict: Verdict
    reason: str

    @property
    def is_confirmed(self) -> bool:
        """Whether the card stands."""
        return self.verdict != "differs"


def agreement(card: Card, again: Card, protocol: Protocol) -> Agreement:
    """Return whether a card agrees with the same entry computed again.

    With the same seed, code and environment all numbers must be equal bit for bit. Else
    each score is tested by its difference in joint standard errors, and Holm's
    correction holds over all. Two seeds share the recorded people, whose variance both
    standard errors contain: the test is conservative.
    """
    for name, claim in _claims(card).items():
        computed = _claims(again)[name]
        if claim != computed:
            reason = f"its {name} is not that of the entry"
            return Agreement("differs", f"{reason}: card {claim}, computed {computed}")
    if (card.scores, card.primary, card.digits) == (
        again.scores,
        again.primary,
        again.digits,
    ):
        return Agreement("equal", "all numbers are equal bit for bit")
    pairs = _pairs(card, again)
    changed = [score_difference(*pair) for pair in pairs if pair[0] != pair[1]]
    if _circumstances(card) == _circumstances(again):
        named = "; ".join(changed[:3]) or _other_rest(card, again)
        return Agreement("differs", f"same seed, code and machine, but {named}")
    rejected = _rejected(pairs, protocol)
    if rejected is not None:
        return Agreement("differs", rejected)
    largest = max((_joint_errors(*pair) for pair in pairs), default=0.0)
    others = _other_circumstances(card, again)
    return Agreement(
        "agrees",
        f"{len(changed)} of {len(pairs)} scores differ, by at most {largest:.2f} of"
        f" {_most_joint_errors(len(pairs), protocol):.2f} joint standard errors allowed"
        f" (another {', '.join(others)}). A small change of a number would pass; to be"
        f" sure, verify with the {', '.join(others)} that the card names",
    )


def _most_joint_errors(n_scores: int, protocol: Protocol) -> float:
    """Return the greatest difference that Holm's correction allows a single score."""
    return -float(ndtri(protocol.agreement["level"] / (2.0 * max(n_scores, 1))))


def _other_rest(card: Card, again: Card) -> str:
    """Return in what cards of equal scores differ: a primary score, or the digits."""
    for axis in AXES:
        if card.primary[axis] != again.primary[axis]:
            return (
                f"{axis}: {score_difference(card.primary[axis], again.primary[axis])}"
            )
    return f"low-order digits: card {card.digits}, computed {again.digits}"


def _claims(card: Card) -> Mapping[str, object]:
    """Return what a card says of its plug-ins, whatever the code that computed it."""
    return {
        "mechanism": (card.mechanism.spec, card.mechanism_name, card.level),
        "claim to protect": (card.mechanism.protects, card.policy.protects),
        "policy": card.policy.spec,
        "form of answer": card.form,
        "list of attacks": [(item.spec, item.adversary) for item in card.attacks],
    }


def _circumstances(card: Card) -> Mapping[str, object]:
    """Return what must be the same for equal bits."""
    return {
        "seed": card.seed_commitment,
        "code": card.code_digest,
        **card.environment,
    }


def _other_circumstances(card: Card, again: Card) -> list[str]:
    ours, others = _circumstances(card), _circumstances(again)
    return [name for name in ours if ours[name] != others.get(name)]


def _pairs(card: Card, again: Card) -> list[tuple[CardScore, CardScore]]:
    """Return the scores of both cards by reader; DataError if they differ in readers."""
    ours = {(score.metric, score.by): score for score in card.scores}
    others = {(score.metric, score.by): score for score in again.scores}
    if ours.keys() != others.keys():
        metric, by = min(ours.keys() ^ others.keys())
        raise DataError(f"only one of both cards has {metric} by {by}")
    return [(ours[key], others[key]) for key in ours]


def _joint_errors(score: CardScore, computed: CardScore) -> float:
    """Return a difference in joint standard errors; infinite if it has none.

    A card cannot widen what it is held to: its own error counts as no larger than that
    of the score computed again.
    """
    if score.value is None or computed.value is None:
        return 0.0 if score.value == computed.value else math.inf
    gap = abs(score.value - computed.value)
    error = computed.error or 0.0
    joint = math.hypot(min(score.error or 0.0, error), error)
    if gap == 0.0:
        return 0.0
    return gap / joint if joint > 0.0 else math.inf


def _rejected(
    pairs: Sequence[tuple[CardScore, CardScore]], protocol: Protocol
) -> str | None:
    """Return the score that differs most, if any differs after Holm's correction."""
    gaps = np.array([_joint_errors(*pair) for pair in pairs])
    p_values = 2.0 * ndtr(-gaps)
    # Holm's correction at 5 % implies it; it stands since it is in the protocol.
    is_beyond = gaps > protocol.agreement["standard_errors"]
    is_rejected = is_beyond & (holm(p_values) <= protocol.agreement["level"])
    if not is_rejected.any():
        return None
    row = int(np.where(is_rejected, gaps, -1.0).argmax())
    return (
        f"{score_difference(*pairs[row])}; {gaps[row]:.1f} joint standard errors, where"
        f" {_most_joint_errors(len(pairs), protocol):.2f} are allowed;"
        f" {int(is_rejected.sum())} of {len(pairs)} scores differ"
    )
