"""Cards of the board in words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from evaluation.estimates.cards import AXES, FOLLOWED, KNOWN, MISSED

if TYPE_CHECKING:
    from evaluation.store.cards import Card, CardScore

HEADS: Final = {MISSED: "missed", KNOWN: "known", FOLLOWED: "followed"}


def score_text(score: CardScore) -> str:
    """Return a share in percent with its interval."""
    if score.value is None:
        return "-"
    text = f"{100 * score.value:.1f}"
    if score.ci_low is not None and score.ci_high is not None:
        text += f" [{100 * score.ci_low:.1f}, {100 * score.ci_high:.1f}]"
    return text


def card_line(card: Card) -> str:
    """Return the entry of a card and its three scores, in a line."""
    shown = [
        f"{HEADS[axis]} {score_text(card.primary[axis])} % by {card.primary[axis].by}"
        for axis in AXES
    ]
    text = f"{card.label}: {', '.join(shown)}"
    if card.digits is not None and card.digits.is_message:
        text += "; its low-order digits hide a message"
    return text


def fall_line(before: Card, after: Card) -> str:
    """Return what new attacks changed about a card, in a line."""
    ours, others = before.primary[KNOWN], after.primary[KNOWN]
    word = "fell" if (others.value or 0.0) > (ours.value or 0.0) else "stands"
    shown = f"known {score_text(ours)} % by {ours.by}"
    if word == "fell":
        shown += f" -> {score_text(others)} % by {others.by}"
    return f"{after.label}: {word}: {shown}"
