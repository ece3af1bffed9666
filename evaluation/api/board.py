"""The board: a page of cards, new attacks on all of them, new mechanisms on all worlds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from evaluation.api.card_entries import CardEntry, Seed, card_entry, cross_entries
from evaluation.api.card_maker import CardMaker, is_of_this_code, make_cards
from evaluation.compute.board import KNOWN as KNOWN_SHARE
from evaluation.estimates.board_places import world_key
from evaluation.estimates.cards import KNOWN, has_own_primary, primary_scores
from evaluation.plan.protocol import Protocol, read_protocol
from evaluation.reporting import board_page
from evaluation.reporting.figures.figure import write as write_figures
from evaluation.store.cards import Card, CardScore, read_card, write_card
from evaluation.store.files import write_whole
from isac_track.errors import DataError, SettingsError
from isac_track.plugins import Plugin, parse_all


@dataclass(frozen=True, slots=True)
class AttackedCard:
    """A card before and after it met new attacks."""

    before: Card
    after: Card

    @property
    def new_scores(self) -> tuple[CardScore, ...]:
        """What the new attacks know, in the order of the card."""
        met = {attack.spec for attack in self.before.attacks}
        return tuple(
            score
            for score in self.after.scores
            if score.metric == KNOWN_SHARE
            and score.by in {attack.spec for attack in self.after.attacks} - met
        )

    @property
    def verdict(self) -> Literal["broken", "slightly more known", "stands"]:
        """Whether new attacks know more, and beyond the interval of the score before."""
        before, after = self.before.primary[KNOWN], self.after.primary[KNOWN]
        if not (after.value or 0.0) > (before.value or 0.0):
            return "stands"
        high = before.ci_high
        is_beyond = high is not None and (after.value or 0.0) > high
        return "broken" if is_beyond else "slightly more known"


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
    folder: Path,
    seeds: Sequence[Seed] = (),
    protocol: Protocol | None = None,
) -> Iterator[AttackedCard]:
    """Yield each card before and after it met the attacks of some SPECs.

    Each new card is written into a folder at once, and one that stands there already
    is not computed again. A card of this code and machine gets further scores; any
    other is computed anew. SettingsError if a secret seed of a card is not among
    `seeds`.
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
    # Cards with the same seed and attacks follow each other and share a maker.
    maker: CardMaker | None = None
    maker_key: tuple[str, tuple[str, ...]] = ("", ())
    for card in by_world:
        extra = _extra_attacks([card], protocol)
        key = card.seed_commitment, tuple(plugin.spec for plugin in extra)
        if maker is None or key != maker_key:
            maker = _maker(known[card.seed_commitment], [*extra, *asked], protocol)
            maker_key = key
        after = _reusable_attacked_card(folder / card.file_name, card, maker)
        if after is None:
            entry = card_entry(card)
            if is_of_this_code(card, maker):
                after = maker.with_new_attacks(card, entry)
            else:
                after = maker.card(entry)
            write_card(after, folder)
        yield AttackedCard(_without(card, asked, protocol), after)


def _reusable_attacked_card(path: Path, card: Card, maker: CardMaker) -> Card | None:
    """Return the card of a file if a card became it by all attacks of a maker."""
    try:
        made = read_card(path)
    except DataError:
        return None  # Missing or broken: it is made anew.
    specs = {attack.plugin.spec for attack in maker.all_attacks()}
    is_same = (
        made.file_name == card.file_name
        and made.seed_commitment == card.seed_commitment
        and is_of_this_code(made, maker)
        and {attack.spec for attack in made.attacks} == specs
        and has_own_primary(made, maker.protocol)
    )
    if is_same and is_of_this_code(card, maker):
        is_same = {*card.scores} <= {*made.scores}
    return made if is_same else None


def _without(card: Card, attacks: Iterable[Plugin], protocol: Protocol) -> Card:
    """Return a card as it was before it met some attacks."""
    specs = {attack.spec for attack in attacks} - {*protocol.attacks}
    scores = tuple(score for score in card.scores if score.by not in specs)
    return replace(
        card,
        scores=scores,
        primary=primary_scores(scores, protocol),
        attacks=tuple(item for item in card.attacks if item.spec not in specs),
    )


def n_joined(
    cards: Sequence[Card], mechanisms: Sequence[str], policies: Sequence[str]
) -> int:
    """Return how many cards `join_mechanisms` yields."""
    return len({*map(world_key, cards)}) * len(
        cross_entries([""], [""], mechanisms, policies)
    )


def join_mechanisms(
    cards: Sequence[Card],
    mechanisms: Sequence[str],
    policies: Sequence[str],
    *,
    folder: Path,
    seeds: Sequence[Seed] = (),
    protocol: Protocol | None = None,
) -> Iterator[Card]:
    """Yield the cards of mechanisms in all worlds of a board, under all its attacks.

    Each is written into a folder at once; one that stands there already stays.
    """
    protocol = protocol or read_protocol()
    known = _seeds(cards, seeds, protocol)
    extra = _extra_attacks(cards, protocol)
    worlds = dict.fromkeys(map(world_key, cards))
    for recording, law, commitment in sorted(worlds):
        maker = _maker(known[commitment], extra, protocol)
        entries = cross_entries([recording], [law], mechanisms, policies)
        maker.check(entries)
        for card, _ in make_cards(maker, entries, folder=folder):
            yield card


def _maker(seed: Seed, attacks: Sequence[Plugin], protocol: Protocol) -> CardMaker:
    maker = CardMaker(seed, attacks, protocol)
    maker.check(list[CardEntry]())
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
