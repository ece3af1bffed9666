"""The board: a page of cards, new attacks on all of them, new mechanisms on all worlds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from evaluation.api.card_entries import Entry, Seed, card_entry, cross_entries
from evaluation.api.carding import Maker, is_of_this_code
from evaluation.estimates.cards import KNOWN
from evaluation.plan.protocol import Protocol, read_protocol
from evaluation.reporting import board_page
from evaluation.reporting.figures.figure import write as write_figures
from evaluation.store.cards import Card, write_card
from evaluation.store.files import write_whole
from isac_track.errors import DataError, SettingsError
from isac_track.plugins import Plugin, parse_all


@dataclass(frozen=True, slots=True)
class Attacked:
    """A card before and after it met new attacks."""

    before: Card
    after: Card

    @property
    def has_fallen(self) -> bool:
        """Whether a new attack knows more than all attacks before."""
        before, after = (
            card.primary[KNOWN].value for card in (self.before, self.after)
        )
        return (after or 0.0) > (before or 0.0)

    @property
    def is_beyond_interval(self) -> bool:
        """Whether it knows more than the interval of the score before."""
        high = self.before.primary[KNOWN].ci_high
        return high is not None and (self.after.primary[KNOWN].value or 0.0) > high


def write_board(cards: Sequence[Card], out: Path) -> Path:
    """Write page, figures, tables in Markdown and cards; return the path of the page.

    DataError if they cannot be written, or if there is no card.
    """
    if not cards:
        raise DataError("a board needs a card; isac-track card OUT makes cards")
    for card in cards:
        write_card(card, out / "cards")
    board = board_page.make_board(cards)
    write_figures(
        [world.figure for world in board.worlds], folder=out, dataset="board", pdf=False
    )
    write_whole(out / "board.md", board_page.as_markdown(board).encode())
    path = out / "index.html"
    write_whole(path, board_page.render(board).encode())
    return path


def attack_cards(
    cards: Iterable[Card],
    attacks: Sequence[str],
    *,
    seeds: Sequence[Seed] = (),
    protocol: Protocol | None = None,
) -> Iterator[Attacked]:
    """Yield each card before and after it met the attacks of some SPECs.

    A card of this code and machine gets further scores; any other is computed anew.
    SettingsError if a secret seed of a card is not among `seeds`.
    """
    protocol = protocol or read_protocol()
    by_world = sorted(
        cards,
        key=lambda card: (
            card.recording,
            card.law,
            card.seed_commitment,
            card.mechanism.spec,
        ),
    )
    asked = parse_all("attacks", attacks)
    known = _seeds(by_world, seeds, protocol)
    makers: dict[tuple[str, tuple[str, ...]], Maker] = {}
    for card in by_world:
        extra = _extra_attacks([card], protocol)
        key = card.seed_commitment, tuple(plugin.spec for plugin in extra)
        if key not in makers:
            makers = {key: _maker(known[key[0]], [*extra, *asked], protocol)}
        maker, entry = makers[key], card_entry(card)
        is_ours = is_of_this_code(card, maker)
        after = maker.attacked(card, entry) if is_ours else maker.card(entry)
        yield Attacked(card, after)


def join_mechanisms(
    cards: Sequence[Card],
    mechanisms: Sequence[str],
    policies: Sequence[str],
    *,
    seeds: Sequence[Seed] = (),
    protocol: Protocol | None = None,
) -> Iterator[Card]:
    """Yield the cards of mechanisms in all worlds of a board, under all its attacks."""
    protocol = protocol or read_protocol()
    known = _seeds(cards, seeds, protocol)
    extra = _extra_attacks(cards, protocol)
    worlds = dict.fromkeys(
        (card.seed_commitment, card.recording, card.law) for card in cards
    )
    for commitment, recording, law in sorted(worlds):
        maker = _maker(known[commitment], extra, protocol)
        entries = cross_entries([recording], [law], mechanisms, policies)
        maker.check(entries)
        yield from map(maker.card, entries)


def _maker(seed: Seed, attacks: Sequence[Plugin], protocol: Protocol) -> Maker:
    maker = Maker(seed, attacks, protocol)
    maker.check(list[Entry]())
    return maker


def _extra_attacks(cards: Iterable[Card], protocol: Protocol) -> list[Plugin]:
    """Return the attacks of cards beyond those of the protocol, each once."""
    specs = dict.fromkeys(attack.spec for card in cards for attack in card.attacks)
    return list(parse_all("attacks", [s for s in specs if s not in protocol.attacks]))


def _seeds(
    cards: Iterable[Card], given: Iterable[Seed], protocol: Protocol
) -> Mapping[str, Seed]:
    """Return the seed of each card by its commitment; SettingsError without it."""
    seeds = {seed.commitment(protocol): seed for seed in given}
    for card in cards:
        if card.seed is not None:
            seeds.setdefault(card.seed_commitment, Seed(card.seed))
        if card.seed_commitment not in seeds:
            raise SettingsError(
                f"{card.label}: give the file of its seed by --secret-seed FILE"
            )
    return seeds
