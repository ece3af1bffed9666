"""Print a board over its worlds: `python scripts/board_worlds.py CARDS...`.

A table for each law has a row for each entry and a column for each recording: missed
conflicts and known person-time in %. The last columns count the worlds where the entry
is on the front, and where it misses less *and* is known less than `--against`.
"""

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, TypeAlias

from evaluation.api.card_checks import load_cards
from evaluation.estimates.board_places import is_control, on_front
from evaluation.plan.protocol import read_protocol
from evaluation.store.cards import Card
from isac_track.command_line import DONE, Parser, exit_code

Entries: TypeAlias = Mapping[str, Card]
"""Cards of a world by the name of their entry."""
AXES: Final = ("missed", "known")


def entry_name(card: Card) -> str:
    """Return mechanism and policy of a card; the policy that shares all is left out."""
    policy = card.policy.spec
    spec = card.mechanism.spec
    return spec if policy == "everything" else f"{spec}, {policy}"


def percent(card: Card, axis: str) -> float:
    """Return a primary score in %; NaN if it was refused."""
    value = card.primary[axis].value
    return float("nan") if value is None else 100.0 * value


def is_better(card: Card, other: Card) -> bool:
    """Return whether a card has fewer misses and a smaller known share than another."""
    return all(percent(card, axis) < percent(other, axis) for axis in AXES)


def law_table(cards: Sequence[Card], *, against: str) -> Iterator[str]:
    """Yield the lines of a table of cards under one law and seed."""
    recordings = list(dict.fromkeys(card.recording for card in cards))
    worlds: dict[str, Entries] = {}
    fronts: dict[str, set[str]] = {}
    for recording in recordings:
        here = [card for card in cards if card.recording == recording]
        worlds[recording] = {entry_name(card): card for card in here}
        fronts[recording] = {
            entry_name(card)
            for card, is_on in zip(here, on_front(here), strict=True)
            if is_on
        }
    yield f"| entry | {' | '.join(recordings)} | on the front | better than {against} |"
    yield f"| :-- |{' --: |' * (len(recordings) + 2)}"
    for name in dict.fromkeys(entry_name(card) for card in cards):
        held = {place: worlds[place][name] for place in worlds if name in worlds[place]}
        scores = [
            " / ".join(f"{percent(held[place], axis):.0f}" for axis in AXES)
            if place in held
            else ""
            for place in recordings
        ]
        is_a_control = all(is_control(card) for card in held.values())
        n_fronts = sum(name in fronts[place] for place in held)
        better = sum(
            against in worlds[place] and is_better(card, worlds[place][against])
            for place, card in held.items()
        )
        place_text = "control" if is_a_control else f"{n_fronts} of {len(held)}"
        cells = [f"`{name}`", *scores, place_text, "" if name == against else better]
        yield f"| {' | '.join(map(str, cells))} |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python scripts/board_worlds.py",
        description="Print a board over its worlds: missed / known, in %.",
    )
    command.add_argument("cards", metavar="CARDS", nargs="+", type=Path)
    command.add_argument("--against", metavar="ENTRY", default="ou:0.4")
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    cards = [*load_cards(options.cards, protocol=read_protocol()).values()]
    for law in dict.fromkeys(card.law for card in cards):
        own = [card for card in cards if card.law == law]
        lines = law_table(own, against=options.against)
        sys.stdout.write("\n".join([f"## Law {law}", "", *lines, "", ""]))
    return DONE


if __name__ == "__main__":
    sys.exit(main())
