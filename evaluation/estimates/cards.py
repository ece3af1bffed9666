"""Cards compared: the strongest reader of each axis, two cards of an entry, the front.

Two cards of an entry agree if no score differs at the protocol's level, two-sided, by
its difference in joint standard errors, with Holm's correction over the scores.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

import numpy as np
from scipy.special import ndtr, ndtri

from evaluation.estimates import pareto
from evaluation.estimates.json_numbers import json_number
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
    changed = [_difference(*pair) for pair in pairs if pair[0] != pair[1]]
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


def _difference(score: CardScore, other: CardScore) -> str:
    """Return the first number in which two scores of a reader differ, in full."""
    ours, others = asdict(score), asdict(other)
    name = next((name for name in ours if ours[name] != others[name]), "value")
    detail = "" if name == "value" else f" ({name})"
    return (
        f"{score.metric} by {score.by}{detail}: card {_full(ours[name])},"
        f" computed {_full(others[name])}"
    )


def _other_rest(card: Card, again: Card) -> str:
    """Return in what cards of equal scores differ: a primary score, or the digits."""
    for axis in AXES:
        if card.primary[axis] != again.primary[axis]:
            return f"{axis}: {_difference(card.primary[axis], again.primary[axis])}"
    return f"low-order digits: card {card.digits}, computed {again.digits}"


def _full(value: object) -> str:
    return "none" if value is None else repr(value)


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
    # Holm's correction at 5 % implies it; it stands since it is in the protocol.
    is_beyond = gaps > protocol.agreement["standard_errors"]
    is_rejected = is_beyond & (holm(p_values) <= protocol.agreement["level"])
    if not is_rejected.any():
        return None
    row = int(np.where(is_rejected, gaps, -1.0).argmax())
    return (
        f"{_difference(*pairs[row])}; {gaps[row]:.1f} joint standard errors, where"
        f" {_most_joint_errors(len(pairs), protocol):.2f} are allowed;"
        f" {int(is_rejected.sum())} of {len(pairs)} scores differ"
    )


@dataclass(frozen=True, eq=False, slots=True)
class Place:
    """The place of a card among the cards of its world."""

    kind: Literal["front", "alone", "beaten", "unmet", "control"]
    """"alone": no other card of its world that enters has its form of answer."""
    beaten_by: tuple[Card, ...] = ()  # The clearest first.
    beats: tuple[Card, ...] = ()
    is_within: bool = False  # Whether its intervals overlap those of the first.
    unmet: tuple[str, ...] = ()  # Attacks that other cards of the world have met.

    @property
    def is_front(self) -> bool:
        """Whether no other card beats it."""
        return self.kind in {"front", "alone"}


def world_key(card: Card) -> tuple[str, str, str]:
    """Return the world of a card: its recording, law and commitment of the seed."""
    return card.recording, card.law, card.seed_commitment


def unmet_attacks(cards: Sequence[Card]) -> list[tuple[str, ...]]:
    """Return for each card of a world the attacks that only others have met."""
    specs = dict.fromkeys(attack.spec for card in cards for attack in card.attacks)
    met = [{attack.spec for attack in card.attacks} for card in cards]
    return [tuple(spec for spec in specs if spec not in own) for own in met]


def places(cards: Sequence[Card]) -> list[Place]:
    """Return the place of each card of a world, over missed, known and followed.

    A card beats another that is no better on any axis and worse on some axis. Only
    answers of one form are compared: a flag warns a robot, but gives it no positions to
    plan by. Controls beat nobody, and are on no front. Neither is a card that has not
    met all attacks of its world: its known share may be too low.
    """
    unmet = unmet_attacks(cards)
    values = np.array(
        [[card.primary[axis].value for axis in AXES] for card in cards], dtype=float
    ).reshape(len(cards), len(AXES))
    # A card without a number on an axis must not be safe from all others.
    values[np.isnan(values)] = np.inf
    enters = np.array(
        [
            not is_control(card) and not lacking
            for card, lacking in zip(cards, unmet, strict=True)
        ],
        dtype=bool,
    )
    forms = np.array([card.form for card in cards])
    is_rival = enters[:, None] & (forms[:, None] == forms)
    wins = pareto.beats(values) & is_rival & enters
    is_alone = (is_rival.sum(axis=0) < 2).tolist()  # noqa: PLR2004 - two compare
    return [
        _place(cards, row, wins, lacking, is_alone=is_alone[row])
        for row, lacking in enumerate(unmet)
    ]


def _place(
    cards: Sequence[Card],
    row: int,
    wins: Bools,
    unmet: tuple[str, ...],
    *,
    is_alone: bool,
) -> Place:
    """Return the place of the card of a row; `wins`, (N, N), says who beats whom."""
    card = cards[row]
    if is_control(card):
        return Place("control", unmet=unmet)
    if unmet:
        return Place("unmet", unmet=unmet)
    beaten = tuple(cards[other] for other in np.flatnonzero(wins[row]).tolist())
    rivals = [cards[other] for other in np.flatnonzero(wins[:, row]).tolist()]
    rivals.sort(key=lambda rival: (is_within_intervals(rival, card), _sum(rival)))
    if not rivals:
        return Place("alone" if is_alone else "front", beats=beaten)
    is_within = is_within_intervals(rivals[0], card)
    return Place("beaten", tuple(rivals), beaten, is_within=is_within)


def _sum(card: Card) -> float:
    """Return an order in which no card that beats another comes behind it."""
    return sum(card.primary[axis].value or 0.0 for axis in AXES)


def is_within_intervals(card: Card, other: Card) -> bool:
    """Whether the intervals overlap on each axis where a card is the better."""
    for axis in AXES:
        high, low = card.primary[axis].ci_high, other.primary[axis].ci_low
        if high is not None and low is not None and high < low:
            return False
    return True


def on_front(cards: Sequence[Card]) -> Bools:
    """Return which cards of a world no other card beats, (N,); see `places`."""
    return np.array([place.is_front for place in places(cards)], dtype=bool)


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
        expected = protocol.recordings.get(card.recording) or "none"
        if card.recording_digest != expected:
            ours, others = cut_digests(card.recording_digest, expected)
            raise DataError(
                f"{card.label}: its recording has the sha256 {ours}, and the protocol's"
                f" {others}; leave the card out"
            )


def cut_digests(digest: str, other: str) -> tuple[str, str]:
    """Return the start of two digests, up to the first digits that differ."""
    pairs = enumerate(zip(digest, other, strict=False))
    first = next((n for n, (ours, others) in pairs if ours != others), len(digest))
    size = max(12, first + 4)
    cut, other_cut = (
        text if len(text) <= size else f"{text[:size]}..." for text in (digest, other)
    )
    return cut, other_cut


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
            return f"{axis}: {_difference(claim, score)}"
    return ""
