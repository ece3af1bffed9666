"""Standings of cards among those of their world, and the cards that share a board."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from evaluation.estimates import pareto
from evaluation.estimates.cards import AXES
from isac_track.errors import DataError
from isac_track.types import Bools

if TYPE_CHECKING:
    from evaluation.plan.protocol import Protocol
    from evaluation.store.cards import Card


@dataclass(frozen=True, eq=False, slots=True)
class Standing:
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


def standings(cards: Sequence[Card]) -> list[Standing]:
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
) -> Standing:
    """Return the place of the card of a row; `wins`, (N, N), says who beats whom."""
    card = cards[row]
    if is_control(card):
        return Standing("control", unmet=unmet)
    if unmet:
        return Standing("unmet", unmet=unmet)
    beaten = tuple(cards[other] for other in np.flatnonzero(wins[row]).tolist())
    rivals = [cards[other] for other in np.flatnonzero(wins[:, row]).tolist()]
    rivals.sort(key=lambda rival: (intervals_overlap(rival, card), _score_total(rival)))
    if not rivals:
        return Standing("alone" if is_alone else "front", beats=beaten)
    is_within = intervals_overlap(rivals[0], card)
    return Standing("beaten", tuple(rivals), beaten, is_within=is_within)


def _score_total(card: Card) -> float:
    """Return an order in which no card that beats another comes behind it."""
    return sum(card.primary[axis].value or 0.0 for axis in AXES)


def intervals_overlap(card: Card, other: Card) -> bool:
    """Whether the intervals overlap on each axis where a card is the better."""
    for axis in AXES:
        high, low = card.primary[axis].ci_high, other.primary[axis].ci_low
        if high is not None and low is not None and high < low:
            return False
    return True


def on_front(cards: Sequence[Card]) -> Bools:
    """Return which cards of a world no other card beats, (N,); see `standings`."""
    return np.array([place.is_front for place in standings(cards)], dtype=bool)


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
