"""Cards of the board in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from evaluation.estimates.board_places import intervals_overlap, unmet_attacks
from evaluation.estimates.cards import AXES, FOLLOWED, KNOWN, MISSED
from evaluation.reporting.amounts import counted, listed, share_interval
from evaluation.reporting.table import plugin_label

if TYPE_CHECKING:
    from evaluation.estimates.board_places import Standing
    from evaluation.store.cards import Card, CardScore

HEADS: Final = {MISSED: "missed", KNOWN: "known", FOLLOWED: "followed"}


def score_text(score: CardScore) -> str:
    """Return a share in percent with its interval, without unit."""
    return share_interval(score.value, score.ci_low, score.ci_high, unit="")


def card_line(card: Card) -> str:
    """Return the entry of a card and its three scores, in a line."""
    shown = [
        f"{HEADS[axis]} {score_text(card.primary[axis])} % by {card.primary[axis].by}"
        for axis in AXES
    ]
    text = f"{card.label}: {', '.join(shown)}"
    if card.hides_message:
        text += "; its low-order digits hide a message"
    return text


def attack_line(
    before: Card, after: Card, *, verdict: str, own: Sequence[CardScore]
) -> str:
    """Return what new attacks changed about a card, and what each knows, in a line."""
    ours = before.primary[KNOWN]
    known = f"{_in_percent(ours)} known by {plugin_label(ours.by)}"
    new = [f"{plugin_label(score.by)} knows {_in_percent(score)}" for score in own]
    verb = {"stands": "stands at"}.get(verdict, f"{verdict}:")
    return f"{after.label}: {'; '.join([f'{verb} {known}', *new])}"


def _in_percent(score: CardScore) -> str:
    """Return a share with its interval: `27.7 % [26.3, 29.2]`."""
    return share_interval(score.value, score.ci_low, score.ci_high)


def place_text(place: Standing) -> str:
    """Return the place of a card in its world: `beaten by ou:0.4 (within intervals)`."""
    if place.kind == "unmet":
        return f"has not met {listed([plugin_label(spec) for spec in place.unmet])}"
    if place.kind != "beaten":
        return place.kind
    first, *others = place.beaten_by
    text = f"beaten by {entry_name(first)}"
    if place.is_within:
        text += " (within intervals)"
    return f"{text} and {len(others)} more" if others else text


def place_line(card: Card, place: Standing) -> str:
    """Return the place of a new card, and which entries it beats, in a line."""
    text = {
        "front": "on the front",
        "alone": "alone with its form of answer, nothing to compare",
        "control": "a control, which beats nobody and is on no front",
    }.get(place.kind, place_text(place))
    if place.kind in {"front", "beaten"}:
        beaten = [f"{entry_name(other)}{_within(card, other)}" for other in place.beats]
        text += f"; beats {listed(beaten) or 'no entry'}"
    return f"{card.label}: {text}"


def _within(card: Card, other: Card) -> str:
    return " (within intervals)" if intervals_overlap(card, other) else ""


def entry_name(card: Card) -> str:
    """Return mechanism and policy of a card; the policy that shares all is left out."""
    spec = plugin_label(card.mechanism.spec)
    policy = plugin_label(card.policy.spec)
    return spec if policy == "everything" else f"{spec}, {policy}"


def gap_line(cards: Sequence[Card]) -> str:
    """Return which attacks some cards of a world have not met, and how they meet them.

    Empty if all have met the same.
    """
    unmet = unmet_attacks(cards)
    missing = sorted({spec for specs in unmet for spec in specs})
    if not missing:
        return ""
    n_cards = sum(bool(specs) for specs in unmet)
    options = " ".join(f"--attack {spec}" for spec in missing)
    have = "has" if n_cards == 1 else "have"
    stay = "stays" if n_cards == 1 else "stay"
    return (
        f"{counted(n_cards, 'entry', 'entries')} of {len(cards)} {have} not met"
        f" {listed([plugin_label(spec) for spec in missing])}, and {stay} off the front."
        f" This fills the gap: python -m evaluation.board {options} CARDS"
    )
