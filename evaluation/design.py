"""Choose a level for a site: `python -m evaluation.design --max-missed 0.20 OUT`."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from evaluation.reporting import noise_plan
from isac_track.command_line import DONE, LIMIT_NOT_MET, Parser, exit_code
from isac_track.errors import SettingsError
from isac_track.kalman import steady

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from evaluation.verdict.what_to_share import Question

_EPILOG = """\
Levels of mechanisms that claim to protect are held against every limit, after the strongest attack
of each adversary that counts. A limit holds only if the upper end of the 95 % interval is at or
below it; what was not tried does not hold. Of the levels that hold everything those are shown that
no other one beats (in missed conflicts, PLR after attack, and linkage), at most five, cheapest
first. No level is interpolated.

exit codes: 0 some level holds everything under every adding rule asked for; 1 none does, or it
cannot be said; 2 wrong usage or data.

examples:
  python -m evaluation.design runs/students03-paper-0
  python -m evaluation.design --max-missed 0.20 --max-plr 0.3 --family ou runs/students03-paper-0
  python -m evaluation.design --against repeats --against anchor runs/students03-paper-0
  python -m evaluation.design --criterion missed --horizon run --json OUT | jq .met
  python -m evaluation.design --plan --max-plr 0.2    (without a run, from closed forms)
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    given = (sys.argv or [])[1:] if arguments is None else list(arguments)
    answer = _plan if "--plan" in given else _run
    return exit_code(lambda: answer(given))


def _plan(arguments: Sequence[str]) -> int:
    """Answer from closed forms; what takes a second to import is not."""
    command = Parser(
        prog="python -m evaluation.design --plan",
        description="Which noise a limit on the PLR after attack takes, from closed forms.",
        epilog="exit codes: 0 it is said, 1 another limit is asked for, which only a run can tell "
        "of; 2 wrong usage.",
    )
    add = command.add_argument
    add("--plan", action="store_true", help="answer without a run")
    about = "share of positions that a smoother may know"
    add("--max-plr", type=float, required=True, metavar="X", help=about)
    add("--max-missed", type=float, metavar="X", help="no closed form tells: a run is proposed")
    add("--max-rank1", type=float, metavar="X", help="likewise")
    for name, default, about in (
        ("epsilon", steady.EPSILON_M, "distance below which a position is known, m"),
        ("q", steady.Q_M2_PER_S3, "spectral density of the people's acceleration, m^2/s^3"),
        ("dt", steady.INTERVAL_S, "time between samples, s"),
    ):
        shown = f"{about} (default: {default:g})"
        add(f"--{name}", type=float, default=default, metavar="X", help=shown)
    given = command.parse_args(arguments)
    others = {"missed": given.max_missed, "rank1": given.max_rank1}
    for name, limit in others.items():
        if limit is not None and not 0.0 <= limit <= 1.0:
            what = "fraction from 0 to 1 (0.2 for 20 %)"
            raise SettingsError(f"--max-{name} is a {what}, got {limit:g}")
    try:
        told = noise_plan.told(plr=given.max_plr, epsilon_m=given.epsilon, q=given.q, dt_s=given.dt)
    except ValueError as error:
        raise SettingsError(f"design --plan: {error}") from None
    print(*told, sep="\n")
    return DONE if {*others.values()} == {None} else LIMIT_NOT_MET


def _run(arguments: Sequence[str]) -> int:
    """Answer from a run."""
    from evaluation.reporting.design_words import answer_of, show, to_json  # noqa: PLC0415 - heavy

    options = _parser().parse_args(arguments)
    answer = answer_of(options.out, _question(options))
    if options.json:
        print(json.dumps(to_json(answer), indent=1, allow_nan=False))
    else:
        show(answer)
    return DONE if answer.recommendation.met else LIMIT_NOT_MET


def _parser() -> Parser:
    from evaluation.analysis.families import ADDING_RULES  # noqa: PLC0415 - heavy
    from evaluation.analysis.metrics import METRICS  # noqa: PLC0415 - heavy
    from evaluation.verdict.what_to_share import HORIZON_S, LIMITS, USUAL  # noqa: PLC0415 - heavy

    words = {
        "missed": "missed conflicts of the robot at raw's false-alarm rate, a fraction",
        "false_alarm": "false alarms, a fraction of the scenes without a conflict",
        "plr": "PLR, a fraction, at epsilon and at 4/3 of it",
        "rank1": "rank 1 of the strongest attack, a fraction: in every task but those of simulated "
        "people",
        "linkage_share": "rank 1 above chance in the leading handover, as a fraction of raw's; 1: "
        "not asked",
    }
    command = Parser(
        prog="python -m evaluation.design",
        description="Choose a level for a site: which levels of a run hold limits of privacy and "
        "utility, what each costs, and who breaks it.",
        epilog=_EPILOG,
    )
    add = command.add_argument
    add("out", type=Path, metavar="OUT", help="folder of a run")
    for name, metric in LIMITS.items():
        shown = METRICS[metric]
        kind, unit = ("a fraction", "X") if shown.is_share else ("in s", "S")
        about = words.get(name, f"{shown.head}, {kind}")
        usual = USUAL.get(name)
        default = "" if usual is None else f" (default: {usual:g})"
        option = f"--max-{name.replace('_', '-')}"
        add(option, type=float, default=usual, metavar=unit, help=f"{about}{default}")
    about = "an adversary that counts beside blind and informed: repeats, anchor, companions, "
    add("--against", action="append", default=[], metavar="NAME", help=f"{about}insider")
    about = "conflicts to choose by: those still to come, or all (default: missed_future)"
    choices = ("missed_future", "missed")
    add("--criterion", choices=choices, default=choices[0], help=about)
    about = f"within how many s they are; `run`: the run's own horizon (default: {HORIZON_S:g})"
    add("--horizon", default=f"{HORIZON_S:g}", metavar="S", help=about)
    add("--predictor", metavar="NAME", default="", help="the robot's (default: the run's best)")
    about = "a mechanism's family, such as fid; repeatable (default: every one of the run)"
    add("--family", action="append", default=[], metavar="NAME", help=about)
    about = "hold PLR, AEL and MEL against what was shared, not against the best reconstruction "
    add("--as-shared", action="store_true", help=f"{about}(highest PLR)")
    about = "adding rule to answer for (default: both must hold); a network can do independent only"
    add("--adding", choices=[*ADDING_RULES, "both"], default="both", help=about)
    add("--json", action="store_true", help="print one JSON object and nothing else")
    add("--plan", action="store_true", help="answer without a run: --plan --help")
    return command


def _question(options: argparse.Namespace) -> Question:
    """Return the question that was typed; SettingsError for what no question can be."""
    from evaluation.analysis.families import ADDING_RULES  # noqa: PLC0415 - heavy
    from evaluation.verdict.what_to_share import LIMITS, Criterion, Question  # noqa: PLC0415 - heavy

    horizon_s = None
    if options.horizon != "run":
        try:
            horizon_s = float(options.horizon)
        except ValueError:
            horizon_s = math.nan
        if not 0.0 < horizon_s < math.inf:
            raise SettingsError(f"--horizon takes a time in s or `run`, got {options.horizon!r}")
    asked = {name: getattr(options, f"max_{name}") for name in LIMITS}
    return Question(
        limits={name: limit for name, limit in asked.items() if limit is not None},
        against=tuple(dict.fromkeys(options.against)),
        criterion=Criterion(options.criterion, horizon_s),
        robot=options.predictor,
        adding=ADDING_RULES if options.adding == "both" else (options.adding,),
        only=tuple(options.family),
        as_shared=options.as_shared,
    )


if __name__ == "__main__":
    sys.exit(main())
