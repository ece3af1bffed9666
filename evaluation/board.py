"""The board of cards: `python -m evaluation.board CARDS... --out DIR`; see docs/how-to/board.md."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from isac_track.command_line import DONE, Parser, exit_code
from isac_track.errors import SettingsError

if TYPE_CHECKING:
    from evaluation.api.card_entries import Seed
    from evaluation.store.cards import Card

_EPILOG = """\
exit codes: 0 done, 2 wrong usage or data, 130 interrupted (finished cards stay; the same
command continues)

examples:
  python -m evaluation.board cards --out board
  python -m evaluation.board --attack my_module:MyAttack cards --out board
  python -m evaluation.board --mechanism my_module:Mine:0.5 cards --out board
"""
_LISTS = (
    ("--attack", "SPEC", "a new attack, against all cards"),
    ("--mechanism", "SPEC", "a new mechanism, in all worlds of the cards"),
    ("--policy", "SPEC", "a policy with the new mechanism (default: everything)"),
    ("--secret-seed", "FILE", "file with the secret seed of some of the cards"),
)
"""Options that may be given several times."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python -m evaluation.board",
        description=(
            "Write the page of a board from cards. With an attack, run it against every"
            " mechanism of the board; with a mechanism, run every attack against it."
        ),
        epilog=_EPILOG,
    )
    add = command.add_argument
    about = "files of cards, or folders of them"
    add("cards", type=Path, nargs="+", metavar="CARDS", help=about)
    for option, metavar, about in _LISTS:
        command.add_repeated(option, about, metavar=metavar)
    about = "folder of the page and its cards (default: board)"
    add("--out", type=Path, metavar="DIR", default=Path("board"), help=about)
    interrupted = "interrupted; finished cards stay, the same command continues"
    return exit_code(
        lambda: _run(command.parse_args(arguments)), interrupted=interrupted
    )


def _run(options: argparse.Namespace) -> int:
    if options.policy and not options.mechanism:
        raise SettingsError("--policy goes with --mechanism")
    if options.attack and options.mechanism:
        raise SettingsError("--attack and --mechanism: first the one, then the other")
    from evaluation.api import (  # noqa: PLC0415 - --help answers at once
        card_checks,
        card_entries,
    )
    from evaluation.api.board import write_board  # noqa: PLC0415 - as above
    from evaluation.estimates.board_places import world_key  # noqa: PLC0415 - as above
    from evaluation.reporting.cards import gap_line  # noqa: PLC0415 - as above

    seeds = [card_entries.read_secret_seed(Path(name)) for name in options.secret_seed]
    cards = [*card_checks.load_cards(options.cards).values()]
    if options.attack:
        cards = _attack(cards, options, seeds)
    if options.mechanism:
        cards = _join(cards, options, seeds)
    for world in dict.fromkeys(map(world_key, cards)):
        own = [card for card in cards if world_key(card) == world]
        if line := gap_line(own):
            print(f"{own[0].recording}, {own[0].law}: {line}")
    print(f"Board: {write_board(cards, options.out)}")
    return DONE


def _attack(
    cards: Sequence["Card"], options: argparse.Namespace, seeds: Sequence["Seed"]
) -> list["Card"]:
    """Run new attacks against all cards; return the new cards."""
    from evaluation.api.board import attack_cards  # noqa: PLC0415 - --help answers at once
    from evaluation.reporting.amounts import counted  # noqa: PLC0415 - as above
    from evaluation.reporting.cards import attack_line  # noqa: PLC0415 - as above
    from evaluation.reporting.progress import counting  # noqa: PLC0415 - as above

    attacked = []
    for item in counting(
        attack_cards(cards, options.attack, folder=options.out / "cards", seeds=seeds),
        total=len(cards),
        noun="card",
    ):
        line = attack_line(
            item.before, item.after, verdict=item.verdict, own=item.new_scores
        )
        print(line, flush=True)
        attacked.append(item)
    verdicts = [item.verdict for item in attacked]
    print(
        f"Broken: {verdicts.count('broken')} of"
        f" {counted(len(attacked), 'entry', 'entries')}. Slightly more known, within the"
        f" interval: {verdicts.count('slightly more known')}."
        f" Stands: {verdicts.count('stands')}."
    )
    return [item.after for item in attacked]


def _join(
    cards: Sequence["Card"], options: argparse.Namespace, seeds: Sequence["Seed"]
) -> list["Card"]:
    """Run all attacks against new mechanisms; return all cards, and print places."""
    from evaluation.api.board import (  # noqa: PLC0415 - --help answers at once
        join_mechanisms,
        n_joined,
    )
    from evaluation.estimates.board_places import standings, world_key  # noqa: PLC0415 - as above
    from evaluation.reporting.cards import card_line, place_line  # noqa: PLC0415 - as above
    from evaluation.reporting.progress import counting  # noqa: PLC0415 - as above

    policies = options.policy or ["everything"]
    joined: dict[str, Card] = {}
    for card in counting(
        join_mechanisms(
            cards,
            options.mechanism,
            policies,
            folder=options.out / "cards",
            seeds=seeds,
        ),
        total=n_joined(cards, options.mechanism, policies),
        noun="card",
    ):
        print(card_line(card), flush=True)
        joined[card.file_name] = card
    together = [*({card.file_name: card for card in cards} | joined).values()]
    for world in dict.fromkeys(map(world_key, joined.values())):
        own = [card for card in together if world_key(card) == world]
        for card, place in zip(own, standings(own), strict=True):
            if card.file_name in joined:
                print(place_line(card, place))
    return together


if __name__ == "__main__":
    sys.exit(main())
