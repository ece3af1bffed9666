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

SHAPED: Final = (
    *(0.07, 0.075, 0.08, 0.09, 0.1, 0.11, 0.12, 0.135),
    *(0.15, 0.165, 0.18, 0.2, 0.22, 0.25),
)
OU: Final = (0.1, 0.16, 0.2, 0.24, 0.28, 0.32, 0.36, 0.4, 0.45, 0.5)
TIMES_S: Final = (5, 10, 15, 20)


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
    add("--scenes", metavar="N", type=int, default=1000)
    add("--out", metavar="DIR", type=Path, required=True)
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    sys.path.insert(0, str(Path(__file__).parent.with_name("examples")))
    evaluation.run(
        preset="frontier",
        dataset=options.dataset,
        mechanisms=mechanisms(),
        predictors=["kalman_cv", "kalman_cv:aware=true"],
        attacks=[
            "radial_rts",
            "ou_rts",
            "matched_smoother:MatchedSmoother",
            "mean_distance",
            "kinematic@radial_rts",
            "likelihood_ratio:one_to_one=true",
        ],
        tasks=["handover-1s", "handover-5s"],
        adversaries=["anchor", "repeats"],
        scenes=options.scenes,
        utility_scenes=5 * options.scenes,
        stages={"attacks.repeats": 3, "linkage.most_people": 300},
        out=options.out,
        jobs=2,
        pictures=False,
        walks=False,
    )
    return DONE


if __name__ == "__main__":
    sys.exit(main())
