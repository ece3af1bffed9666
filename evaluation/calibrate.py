"""Refit the free constants of the sensing model: `python -m evaluation.calibrate`."""

import argparse
import sys
from collections.abc import Sequence

from isac_track.command_line import DONE, Parser, exit_code
from isac_track.errors import SettingsError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python -m evaluation.calibrate",
        description=(
            "Refit the free constants of the sensing model to the paper's numbers."
        ),
    )
    add = command.add_argument
    add(
        "--dataset",
        metavar="NAME|PATH",
        default="students03",
        help="default: that of the paper",
    )
    about = "scenes for the missed rates (default: 5000, half a minute)"
    add("--scenes", metavar="N", type=int, default=5000, help=about)
    add(
        "--seed",
        metavar="N",
        type=int,
        default=0,
        help="base seed of all draws (default: 0)",
    )
    about = "also fit with other caps and beam fluctuations (takes minutes)"
    add("--ridge", action="store_true", help=about)
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    from evaluation.analysis.calibration import (  # noqa: PLC0415 - for --help
        calibrate,
        ridge,
    )
    from evaluation.reporting.difference_tables import (  # noqa: PLC0415 - for --help
        show_constants,
    )
    from isac_track import datasets  # noqa: PLC0415 - for --help

    if options.scenes < 2 or options.seed < 0:  # noqa: PLR2004 - one scene of each label
        raise SettingsError("--scenes must be at least 2 and --seed not negative")
    recorded = datasets.load(options.dataset).tracks
    cases = {"as committed": dict[str, float]()} | (ridge() if options.ridge else {})
    asked = {"n_scenes": options.scenes, "seed": options.seed}
    show_constants(
        {name: calibrate(recorded, changes=of, **asked) for name, of in cases.items()}
    )
    return DONE


if __name__ == "__main__":
    sys.exit(main())
