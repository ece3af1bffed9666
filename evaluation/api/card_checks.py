"""Cards of strangers: read, checked to fit together, and computed again."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from evaluation.api.card_entries import Seed, card_entry
from evaluation.api.card_maker import CardMaker, card_plugin
from evaluation.estimates.board_places import cut_digests, same_board
from evaluation.estimates.card_agreement import Agreement, agreement
from evaluation.estimates.cards import primary_fault
from evaluation.plan.origins import is_user_plugin
from evaluation.plan.protocol import Protocol, read_protocol
from evaluation.store.cards import Card, read_card
from isac_track.errors import DataError, SettingsError
from isac_track.plugins import Plugin, parse_all


def load_cards(
    paths: Iterable[Path], *, protocol: Protocol | None = None
) -> dict[Path, Card]:
    """Return the cards of files and of folders of cards, checked to fit together.

    DataError, in a line, for a file that is no card of the protocol, and for two cards
    of one entry.
    """
    cards: dict[Path, Card] = {}
    for path in paths:
        if path.is_dir():
            inside = sorted(path.glob("*.json"))
            if not inside:
                raise DataError(f"{path} holds no card (*.json)")
            cards |= {item: read_card(item) for item in inside}
        else:
            cards[path] = read_card(path)
    protocol = protocol or read_protocol()
    same_board(cards.values(), protocol)
    for path, card in cards.items():
        if fault := primary_fault(card, protocol):
            raise DataError(
                f"{path}: its primary scores do not follow from its scores ({fault});"
                " the card was changed"
            )
    first: dict[str, Path] = {}
    for path, card in cards.items():
        other = first.setdefault(card.file_name, path)
        if other != path:
            raise DataError(
                f"{other} and {path} are both of {card.label}; leave out either"
            )
    return cards


def verify_card(
    card: Card, *, seed: Seed | None = None, protocol: Protocol | None = None
) -> Agreement:
    """Compute a card again, and return whether it is the same.

    Without a seed it is the card's own. SettingsError if that is secret and was not
    given, or if a plug-in here is not the card's.
    """
    protocol = protocol or read_protocol()
    same_board([card], protocol)
    if seed is None:
        if card.seed is None:
            raise SettingsError(
                f"{card.label}: give its seed by --secret-seed FILE, or another seed by"
                " --seed N"
            )
        seed = Seed(card.seed)
        if seed.commitment(protocol) != card.seed_commitment:
            return Agreement("differs", "the commitment is not that of its seed")
    if fault := primary_fault(card, protocol):
        reason = f"its primary scores do not follow from its scores: {fault}"
        return Agreement("differs", reason)
    extra = [
        attack.spec for attack in card.attacks if attack.spec not in protocol.attacks
    ]
    maker = CardMaker(seed, parse_all("attacks", extra), protocol)
    entry = card_entry(card)
    _refuse_other_plugins(card, [entry.mechanism, entry.policy, *maker.attacks])
    return agreement(card, maker.card(entry), protocol)


def _refuse_other_plugins(card: Card, plugins: Iterable[Plugin]) -> None:
    """Raise SettingsError if a user's plug-in here has another source than a card's."""
    digests = {
        item.spec: item.digest for item in (card.mechanism, card.policy, *card.attacks)
    }
    for plugin in filter(is_user_plugin, plugins):
        here, claim = card_plugin(plugin).digest, digests.get(plugin.spec, "none")
        if here != claim:
            ours, others = cut_digests(here, claim)
            raise SettingsError(
                f"{plugin.spec} here is not the card's: its source has another digest"
                f" ({ours}, and the card's {others}); get the plug-in that the card was"
                " made with"
            )
