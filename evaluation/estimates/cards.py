"""Cards compared: the strongest reader of each axis, two cards of an entry, the front.

Two cards of an entry agree if no score differs by more than the protocol's number of
joint standard errors, with Holm's correction over the scores of the card.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

import numpy as np
from scipy.special import ndtr

from evaluation.store.cards import Card, CardScore
from isac_track.errors import DataError
from isac_track.linkability.significance import holm
from isac_track.types import Bools

if TYPE_CHECKING:
    from evaluation.plan.protocol import Protocol
    from isac_track.intervals import Estimate

MISSED, KNOWN, FOLLOWED = AXES = ("missed", "known", "followed")
Verdict: TypeAlias = Literal["equal", "agrees", "differs"]
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
        value=_known(estimate.value),
        ci_low=_known(estimate.ci_low),
        ci_high=_known(estimate.ci_high),
        error=_known(error),
        n=int(estimate.n),
    )


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def primary_scores(
    scores: Sequence[CardScore], protocol: Protocol
) -> dict[str, CardScore]:
    """Return the score of each axis: of the best robot, and the strongest adversaries.

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
        if claim != _claims(again)[name]:
            return Agreement("differs", f"its {name} is not that of the entry")
    if (card.scores, card.primary, card.digits) == (
        again.scores,
        again.primary,
        again.digits,
    ):
        return Agreement("equal", "all numbers are equal bit for bit")
    pairs = _pairs(card, again)
    changed = [ours for ours, others in pairs if ours != others]
    if _circumstances(card) == _circumstances(again):
        named = ", ".join(_named(score) for score in changed[:3]) or "primary scores"
        return Agreement("differs", f"same seed, code and machine, but not {named}")
    rejected = _rejected(pairs, protocol)
    if rejected is not None:
        return Agreement("differs", rejected)
    largest = max((_joint_errors(*pair) for pair in pairs), default=0.0)
    return Agreement(
        "agrees",
        f"{len(changed)} of {len(pairs)} scores differ, by at most {largest:.2f} joint"
        f" standard errors ({_other_circumstances(card, again)})",
    )


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


def _other_circumstances(card: Card, again: Card) -> str:
    ours, others = _circumstances(card), _circumstances(again)
    return "another " + ", ".join(name for name in ours if ours[name] != others[name])


def _pairs(card: Card, again: Card) -> list[tuple[CardScore, CardScore]]:
    """Return the scores of both cards by reader; DataError if they differ in readers."""
    ours = {(score.metric, score.by): score for score in card.scores}
    others = {(score.metric, score.by): score for score in again.scores}
    if ours.keys() != others.keys():
        metric, by = min(ours.keys() ^ others.keys())
        raise DataError(f"only one of both cards has {metric} by {by}")
    return [(ours[key], others[key]) for key in ours]


def _joint_errors(score: CardScore, other: CardScore) -> float:
    """Return a difference in joint standard errors; infinite if it has none."""
    if score.value is None or other.value is None:
        return 0.0 if score.value == other.value else math.inf
    gap = abs(score.value - other.value)
    joint = math.hypot(score.error or 0.0, other.error or 0.0)
    if gap == 0.0:
        return 0.0
    return gap / joint if joint > 0.0 else math.inf


def _rejected(
    pairs: Sequence[tuple[CardScore, CardScore]], protocol: Protocol
) -> str | None:
    """Return the score that differs most, if any differs after Holm's correction."""
    gaps = np.array([_joint_errors(*pair) for pair in pairs])
    p_values = 2.0 * ndtr(-gaps)
    is_beyond = gaps > protocol.agreement["standard_errors"]
    is_rejected = is_beyond & (holm(p_values) <= protocol.agreement["level"])
    if not is_rejected.any():
        return None
    row = int(np.where(is_rejected, gaps, -1.0).argmax())
    ours, others = pairs[row]
    return (
        f"{_named(ours)} against {_number(others.value)}, {gaps[row]:.1f} joint standard"
        f" errors; {int(is_rejected.sum())} of {len(pairs)} scores differ"
    )


def _named(score: CardScore) -> str:
    return f"{score.metric} by {score.by} {_number(score.value)}"


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.6g}"


def on_front(cards: Sequence[Card]) -> Bools:
    """Return which cards no other card beats, (N,), over missed, known and followed.

    A card beats another that is no better on any axis and worse on some axis. Only
    answers of one form are compared: a flag warns a robot, but gives it no positions to
    plan by. Controls beat nobody, and are on no front.
    """
    values = np.array(
        [[card.primary[axis].value for axis in AXES] for card in cards], dtype=float
    ).reshape(len(cards), len(AXES))
    enters = np.array([not is_control(card) for card in cards], dtype=bool)
    no_worse = (values[:, None] <= values[None]).all(axis=2)
    better = (values[:, None] < values[None]).any(axis=2)
    forms = np.array([card.form for card in cards])
    is_rival = enters[:, None] & (forms[:, None] == forms)
    is_beaten = (no_worse & better & is_rival).any(axis=0)
    return np.asarray(enters & ~is_beaten)


def is_control(card: Card) -> bool:
    """Whether a card is of a control: it claims no protection, and is not raw."""
    is_baseline = card.mechanism.spec == "raw"
    return not (card.mechanism.protects or is_baseline)


def same_board(cards: Iterable[Card], protocol: Protocol) -> None:
    """Check that cards belong on one board; DataError names the card that does not."""
    for card in cards:
        if card.protocol_version != protocol.version:
            raise DataError(
                f"{card.label}: it is of protocol {card.protocol_version}, and this"
                f" board is of {protocol.version}; make the card again"
            )
        if card.protocol_digest != protocol.digest:
            raise DataError(
                f"{card.label}: its protocol {card.protocol_version} has other values"
                " than ours; make the card again with this version"
            )
        expected = protocol.recordings.get(card.recording)
        if card.recording_digest != expected:
            raise DataError(
                f"{card.label}: its recording has the sha256"
                f" {card.recording_digest[:12]}..., and the protocol's"
                f" {(expected or 'none')[:12]}...; leave the card out"
            )


def has_own_primary(card: Card, protocol: Protocol) -> bool:
    """Whether the primary scores of a card follow from its scores."""
    return dict(card.primary) == primary_scores(card.scores, protocol)
