"""Choose a level for a site: `python -m evaluation.design --max-missed 0.20 OUT`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from evaluation.analysis.families import ADDING_RULES
from evaluation.analysis.metrics import METRICS, SUCCESS
from evaluation.reporting.design_words import show, to_json
from evaluation.verdict.choose_level import ASKED, Limits, choose
from isac_track.command_line import DONE, LIMIT_NOT_MET, Parser, exit_code

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

_ABOUT = {
    "missed": "missed conflicts, a fraction of all conflicts",
    "false_alarm": "false alarms, a fraction of the scenes without a conflict",
    SUCCESS: "rank 1 of the strongest attack, a fraction: in every task but those of simulated "
    "people",
}
_EPILOG = """\
Of every family the strictest level of the run (the smallest eta, the largest d_sigma) that meets
--max-missed, and --max-false-alarm if given, is chosen, provided that every less strict one meets
them as well. The other limits are judged at that level, after the strongest attack. All are met
only if the upper end of the 95 % interval is at or below them. No level is interpolated.

exit codes: 0 some family meets everything under every adding rule asked for; 1 none does, or it
cannot be said; 2 wrong usage or data.

examples:
  python -m evaluation.design --max-missed 0.20 runs/students03-paper-0
  python -m evaluation.design --max-missed 0.20 --max-plr 0.5 --family fid \\
      --adding independent runs/students03-paper-0
  python -m evaluation.design --max-missed 0.25 --max-rank1 0.1 --json OUT | jq .met
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python -m evaluation.design",
        description="Choose a level for a site: the smallest eta of a run that meets a target of "
        "utility, what is left of privacy there, and a plain yes or no.",
        epilog=_EPILOG,
    )
    add = command.add_argument
    add("out", type=Path, metavar="OUT", help="folder of a run")
    for name, metric in ASKED.items():
        shown = METRICS[metric]
        what, unit = ("a fraction", "X") if shown.is_share else ("in s", "S")
        about = _ABOUT.get(name, f"{shown.head}, {what}")
        option = f"--max-{name.replace('_', '-')}"
        add(option, type=float, required=name == "missed", metavar=unit, help=about)
    add("--predictor", metavar="NAME", help="the robot's predictor (default: the run's first)")
    about = "a mechanism's family, such as fid; repeatable (default: every one of the run)"
    add("--family", action="append", default=[], metavar="NAME", help=about)
    about = (
        "hold PLR, AEL and MEL against what was shared, not against the best reconstruction "
        "(highest PLR)"
    )
    add("--as-shared", action="store_true", help=about)
    about = (
        "adding rule to answer for (default: both, which must both hold); a network could "
        "implement only the independent one"
    )
    add("--adding", choices=[*ADDING_RULES, "both"], default="both", help=about)
    add("--json", action="store_true", help="print one JSON object and nothing else")
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    asked = {name: getattr(options, f"max_{name}") for name in ASKED}
    given = {name: limit for name, limit in asked.items() if limit is not None}
    choice = choose(
        options.out,
        limits=Limits(given, as_shared=options.as_shared),
        adding=ADDING_RULES if options.adding == "both" else (options.adding,),
        predictor=options.predictor,
        only=options.family,
    )
    if options.json:
        sys.stdout.write(f"{json.dumps(to_json(choice), indent=1, allow_nan=False)}\n")
    else:
        show(choice)
    return DONE if choice.met else LIMIT_NOT_MET


if __name__ == "__main__":
    sys.exit(main())
