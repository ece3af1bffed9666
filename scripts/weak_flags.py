"""How many planted attackers the weak-attack flags find: `python scripts/weak_flags.py`.

A run on a recording holds 20 attackers that are weak by construction and 20 that are
strong (`planted_attacks.py`), and 4 nearly as good as `kalman_rts`, beside the simple
attacks that all are compared with.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from planted_attacks import NEAR, STRONG, WEAK

import evaluation
from evaluation.estimates.weak_attacks import SIMPLER
from isac_track.command_line import DONE, Parser, exit_code

MECHANISMS = ("raw", "fixed:0.3", "fixed:0.7", "fid:1", "ou:0.4")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python scripts/weak_flags.py",
        description="How many planted attackers the weak-attack flags find.",
    )
    command.add_argument("--dataset", metavar="NAME|PATH", default="plaza")
    command.add_argument("--scenes", metavar="N", type=int, default=250)
    command.add_argument("--seed", metavar="N", type=int, default=0)
    command.add_argument("--out", metavar="DIR", type=Path, required=True)
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    results = evaluation.run(
        preset="smoke",
        dataset=options.dataset,
        mechanisms=MECHANISMS,
        predictors=(),
        attacks=[*SIMPLER, *WEAK, *STRONG, *NEAR],
        tasks=(),
        policies=(),
        scenes=options.scenes,
        seed=options.seed,
        out=options.out,
        jobs=1,
        pictures=False,
        progress=False,
        stages={"conflict.horizons_s": ()},
    )
    flagged = set(results.flags["attack"])
    for name, planted in (("weak", WEAK), ("strong", STRONG), ("near", NEAR)):
        is_found = {attack: _spec(attack) in flagged for attack in planted}
        print(f"{name}: {sum(is_found.values())} of {len(planted)} flagged")
        for attack, is_flagged in is_found.items():
            if is_flagged != (name == "weak"):
                rows = results.flags[results.flags["attack"] == _spec(attack)]
                print(f"  {attack}: {'; '.join(rows['sentence'].head(2)) or 'missed'}")
    return DONE


def _spec(attack: object) -> str:
    from isac_track.plugins import resolve_plugins  # noqa: PLC0415 - after the run

    return resolve_plugins("attacks", attack)[0].spec


if __name__ == "__main__":
    sys.exit(main())
