"""Cards of the board: `python -m evaluation.card`; see docs/how-to/board.md."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from isac_track.command_line import DONE, LIMIT_NOT_MET, Parser, exit_code
from isac_track.errors import SettingsError

_EPILOG = """\
exit codes: 0 done, or the card is confirmed; 1 the card is not confirmed; 2 wrong usage or
data; 130 interrupted (finished cards stay; the same command continues)

examples:
  python -m evaluation.card runs/plaza-quick-0
  python -m evaluation.card --dataset plaza --mechanism ou:0.4 --out cards
  python -m evaluation.card --dataset plaza --out cards         # all that the protocol names
  python -m evaluation.card --mechanism my_module:Mine:0.5 --secret-seed seed.txt --out cards
  python -m evaluation.card --verify cards/plaza-radial-ou-0.4-everything-0-1f0c8a2b.json
  python -m evaluation.card --verify CARD.json --seed 7
"""
_LISTS = (
    ("--dataset", "NAME", "a recording of the protocol (default: plaza)"),
    ("--law", "LAW", "law of the sensing error (default: radial)"),
    (
        "--mechanism",
        "SPEC",
        "a mechanism (default: those of the protocol, and raw with all its policies)",
    ),
    ("--policy", "SPEC", "a policy with each mechanism (default: everything)"),
    ("--attack", "SPEC", "a further attack, beside those of the protocol"),
)
"""Options that may be given several times."""
_VERDICTS = {"equal": "equal", "agrees": "agreeing", "differs": "NOT CONFIRMED"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python -m evaluation.card",
        description=(
            "Score mechanisms under the protocol of the board, a card each; or compute"
            " a card again and say whether it stands."
        ),
        epilog=_EPILOG,
    )
    add = command.add_argument
    about = "folder of a run: cards of its mechanisms with its policies, under its seed"
    add("run", type=Path, nargs="?", metavar="OUT", help=about)
    about = "a card to compute again, instead of making cards"
    add("--verify", type=Path, metavar="CARD", help=about)
    for option, metavar, about in _LISTS:
        command.add_repeated(option, about, metavar=metavar)
    add("--seed", type=int, metavar="N", help="base seed (default: 0)")
    about = "file with a secret seed: the card holds a commitment instead"
    add("--secret-seed", type=Path, metavar="FILE", help=about)
    about = "folder of the cards (default: OUT/cards, or cards)"
    add("--out", type=Path, metavar="DIR", help=about)
    interrupted = "interrupted; finished cards stay, the same command continues"
    return exit_code(
        lambda: _run(command.parse_args(arguments)), interrupted=interrupted
    )


def _run(options: argparse.Namespace) -> int:
    if options.seed is not None and options.secret_seed is not None:
        raise SettingsError("--seed and --secret-seed: give either")
    if options.seed is not None and options.seed < 0:
        raise SettingsError(f"--seed {options.seed}: it must not be negative")
    return _verify(options) if options.verify else _make(options)


def _verify(options: argparse.Namespace) -> int:
    """Compute a card again, and print the verdict."""
    refused = ("run", "dataset", "law", "mechanism", "policy", "attack", "out")
    for name in refused:
        if getattr(options, name):
            raise SettingsError(f"--verify takes the card's own {name}: leave it out")
    from evaluation.api import (  # noqa: PLC0415 - --help answers at once
        card_checks,
        card_entries,
    )
    from evaluation.store.cards import read_card  # noqa: PLC0415 - as above

    card = read_card(options.verify)
    seed = None if options.seed is None else card_entries.Seed(options.seed)
    if options.secret_seed is not None:
        seed = card_entries.read_secret_seed(options.secret_seed)
    answer = card_checks.verify_card(card, seed=seed)
    print(f"{card.label}: {_VERDICTS[answer.verdict]}: {answer.reason}")
    return DONE if answer.is_confirmed else LIMIT_NOT_MET


def _make(options: argparse.Namespace) -> int:
    """Make the cards of a run, of named mechanisms, or of the protocol."""
    from evaluation.api import (  # noqa: PLC0415 - --help answers at once
        card_entries,
        card_maker,
    )
    from evaluation.plan.protocol import read_protocol  # noqa: PLC0415 - as above
    from evaluation.reporting.cards import card_line  # noqa: PLC0415 - as above
    from isac_track.plugins import parse_all  # noqa: PLC0415 - as above

    protocol, seed = read_protocol(), card_entries.Seed(options.seed or 0)
    recordings, laws = options.dataset or ["plaza"], options.law or ["radial"]
    folder = options.out or Path("cards")
    if options.run is not None:
        for name in ("dataset", "law", "mechanism", "policy"):
            if getattr(options, name):
                raise SettingsError(f"OUT has its own {name}: leave out --{name}")
        entries, run_seed = card_entries.run_entries(options.run, protocol=protocol)
        seed = card_entries.Seed(run_seed if options.seed is None else options.seed)
        folder = options.out or options.run / "cards"
    elif options.mechanism or options.policy:
        entries = card_entries.cross_entries(
            recordings,
            laws,
            options.mechanism or ["raw"],
            options.policy or ["everything"],
        )
    else:
        entries = card_entries.protocol_entries(recordings, laws, protocol=protocol)
    if options.secret_seed is not None:
        seed = card_entries.read_secret_seed(options.secret_seed)
    maker = card_maker.CardMaker(seed, parse_all("attacks", options.attack))
    maker.check(entries)
    for card, path in card_maker.make_cards(maker, entries, folder=folder):
        print(f"{card_line(card)}: {path}", flush=True)
    return DONE


if __name__ == "__main__":
    sys.exit(main())
