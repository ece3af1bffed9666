"""Compare `shaped` with `ou` where a robot misses as many conflicts; see `--help`.

    python scripts/shaped_against_ou.py --dataset students03 --out runs/shaped-students03

A second call with the same folder continues the run, or reads it.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import evaluation
from isac_track.command_line import DONE, Parser, exit_code

SHAPED: Final = (0.07, 0.075, 0.08, 0.085, 0.09, 0.1, 0.11, 0.12, 0.13, 0.145, 0.16)
OU: Final = (0.08, 0.11, 0.14, 0.17, 0.2, 0.23, 0.27, 0.32)
TIMES_S: Final = (5, 15)


def mechanisms() -> list[str]:
    """Return the SPECs of all levels."""
    shaped = [f"shaped:{floor:g}" for floor in SHAPED]
    slow = [f"ou:{std:g},tau_s={time:g}" for time in TIMES_S for std in OU]
    return ["raw", *shaped, *slow]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(prog="python scripts/shaped_against_ou.py", description=__doc__)
    add = command.add_argument
    add("--dataset", metavar="NAME|PATH", default="students03")
    add("--out", metavar="DIR", type=Path, required=True)
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    evaluation.run(
        preset="quick",
        dataset=options.dataset,
        mechanisms=mechanisms(),
        predictors=["kalman_cv", "kalman_cv:aware=true"],
        attacks=["radial_rts", "ou_rts", "kinematic@radial_rts"],
        tasks=["handover-1s", "handover-5s"],
        policies=[],
        adversaries=["anchor", "repeats"],
        stages={"attacks.repeats": 3, "linkage.most_people": 300},
        out=options.out,
        jobs=2,
        pictures=False,
        walks=False,
    )
    return DONE


if __name__ == "__main__":
    sys.exit(main())
