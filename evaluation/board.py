"""The board of cards: `python -m evaluation.board CARDS... --out DIR`; see docs/how-to/board.md."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isac_track.command_line import DONE, Parser, exit_code
from isac_track.errors import SettingsError

_EPILOG = """\
exit codes: 0 done, 2 wrong usage or data, 130 interrupted

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
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    if options.policy and not options.mechanism:
        raise SettingsError("--policy goes with --mechanism")
    if options.attack and options.mechanism:
        raise SettingsError("--attack and --mechanism: first the one, then the other")
    from evaluation.api import (  # noqa: PLC0415 - --help answers at once
        boarding,
        card_checks,
        card_entries,
    )
    from evaluation.reporting.cards import card_line, fall_line  # noqa: PLC0415 - as above

    seeds = [card_entries.read_secret_seed(Path(name)) for name in options.secret_seed]
    cards = [*card_checks.load_cards(options.cards).values()]
    if options.attack:
        attacked = []
        for item in boarding.attack_cards(cards, options.attack, seeds=seeds):
            print(fall_line(item.before, item.after), flush=True)
            attacked.append(item)
        fallen = [item for item in attacked if item.has_fallen]
        beyond = [item for item in fallen if item.is_beyond_interval]
        print(
            f"{len(fallen)} of {len(attacked)} scores fell, {len(beyond)} of them beyond"
            " the interval of the score before"
        )
        cards = [item.after for item in attacked]
    joined = boarding.join_mechanisms(
        cards, options.mechanism, options.policy or ["everything"], seeds=seeds
    )
    for card in joined if options.mechanism else ():
        print(card_line(card), flush=True)
        cards = [other for other in cards if other.file_name != card.file_name]
        cards.append(card)
    print(f"Board: {boarding.write_board(cards, options.out)}")
    return DONE


if __name__ == "__main__":
    sys.exit(main())
