"""Choose a noise level: `python -m evaluation.design --max-missed 0.20 OUT`."""

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

    from evaluation.verdict.patrol_records import PatrolLimits
    from evaluation.verdict.question import Question

_EPILOG = """\
Each level of a mechanism that claims to protect must keep within every limit, after the strongest
attack of each adversary that counts. A level keeps within a limit if the upper end of the 95 %
interval does. An adversary that was not tried counts as a failure. The answer shows at most five
levels, the cheapest first. No other level is better than they are in missed conflicts, known
positions and re-identification at once. No level is interpolated.

exit codes: 0 some level keeps within all limits under every adding rule asked for; 1 none does, or
the run cannot say; 2 wrong usage or data.

examples:
  python -m evaluation.design runs/students03-paper-0
  python -m evaluation.design --max-missed 0.20 --max-plr 0.3 --family ou runs/students03-paper-0
  python -m evaluation.design --against repeats --against anchor runs/students03-paper-0
  python -m evaluation.design --criterion missed --horizon run --json OUT | jq .met
  python -m evaluation.design --max-known 0.3 --max-followed 0.05 runs/students03-paper-0
  python -m evaluation.design --plan --max-plr 0.2    (without a run, from closed forms)
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    words = (sys.argv or [])[1:] if arguments is None else list(arguments)
    if "--plan" in words:
        return exit_code(lambda: _answer_from_closed_forms(words))
    return exit_code(lambda: _answer_from_run(words))


def _answer_from_closed_forms(arguments: Sequence[str]) -> int:
    """Answer from closed forms, without the imports that take a second."""
    command = Parser(
        prog="python -m evaluation.design --plan",
        description=(
            "Find the noise that keeps the attacked PLR below a limit, without a run."
        ),
        epilog=(
            "exit codes: 0 the noise is printed; 1 so it is, but another limit takes a"
            " run; 2 wrong usage."
        ),
    )
    add = command.add_argument
    add("--plan", action="store_true", help="answer without a run")
    about = "largest share of positions that a smoother may know"
    add("--max-plr", type=float, required=True, metavar="X", help=about)
    add(
        "--max-missed",
        type=float,
        metavar="X",
        help="takes a run: the command is printed",
    )
    add("--max-rank1", type=float, metavar="X", help="the same")
    for name, default, about in (
        ("epsilon", steady.EPSILON_M, "distance below which a position is known, m"),
        (
            "q",
            steady.Q_M2_PER_S3,
            "spectral density of the people's acceleration, m^2/s^3",
        ),
        ("dt", steady.INTERVAL_S, "time between samples, s"),
    ):
        help_text = f"{about} (default: {default:g})"
        add(f"--{name}", type=float, default=default, metavar="X", help=help_text)
    options = command.parse_args(arguments)
    run_limits = {"missed": options.max_missed, "rank1": options.max_rank1}
    for name, limit in run_limits.items():
        if limit is not None and not 0.0 <= limit <= 1.0:
            raise SettingsError(
                f"--max-{name} is a fraction from 0 to 1 (0.2 for 20 %), got {limit:g}"
            )
    try:
        lines = noise_plan.plan_lines(
            plr=options.max_plr,
            epsilon_m=options.epsilon,
            q=options.q,
            dt_s=options.dt,
        )
    except ValueError as error:
        raise SettingsError(f"design --plan: {error}") from None
    print(*lines, sep="\n")
    return DONE if {*run_limits.values()} == {None} else LIMIT_NOT_MET


def _answer_from_run(arguments: Sequence[str]) -> int:
    """Answer from a run."""
    from evaluation.reporting.design_words import (  # noqa: PLC0415 - heavy
        answer_question,
        show,
        to_json,
    )

    options = _parser().parse_args(arguments)
    answer = answer_question(
        options.out, _question(options), limits=_patrol_limits(options)
    )
    if options.json:
        print(json.dumps(to_json(answer), indent=1, allow_nan=False))
    else:
        show(answer, verbose=options.verbose)
    return DONE if answer.met else LIMIT_NOT_MET


def _parser() -> Parser:
    from evaluation.estimates.families import ADDING_RULES  # noqa: PLC0415 - heavy
    from evaluation.estimates.metrics import (  # noqa: PLC0415 - heavy
        DESCRIPTORS,
        METRICS,
    )
    from evaluation.reporting.amounts import listed  # noqa: PLC0415 - heavy
    from evaluation.verdict.question import HORIZON_S, LIMITS, USUAL  # noqa: PLC0415 - heavy

    limit_help = {
        "missed": (
            "largest share of conflicts that the robot misses, at the false alarms"
            " of raw"
        ),
        "false_alarm": "largest share of false alarms in the scenes without a conflict",
        "plr": "largest share of positions known (PLR), to epsilon and to 4/3 of it",
        "rank1": (
            "largest share of people that an attack re-identifies (rank 1), in every"
            " task"
        ),
        "linkage_share": (
            "largest share of raw's re-identification after a silence, above chance; "
            "1 asks nothing"
        ),
    }
    command = Parser(
        prog="python -m evaluation.design",
        description=(
            "Choose a noise level for a site: which levels of a run keep within limits"
            " of privacy and utility, what each costs, and which adversary breaks it."
        ),
        epilog=_EPILOG,
    )
    add = command.add_argument
    add("out", type=Path, metavar="OUT", help="folder of a run")
    for name, metric in LIMITS.items():
        row = METRICS[metric]
        kind = "a fraction" if row.is_share else f"in {row.unit}"
        about = limit_help.get(name, f"{row.head}, {kind}".removesuffix(", in "))
        unit = "S" if row.unit == "s" else "X"
        usual = USUAL.get(name)
        default = "" if usual is None else f" (default: {usual:g})"
        option = f"--max-{name.replace('_', '-')}"
        add(option, type=float, default=usual, metavar=unit, help=f"{about}{default}")
    about = (
        "largest share of person-time that a log of answers to robots on patrol reveals"
    )
    add("--max-known", type=float, metavar="X", help=about)
    about = "largest share of people whom such a log follows for 10 s"
    add("--max-followed", type=float, metavar="X", help=about)
    about = (
        "a further adversary that must not break it: repeats, anchor, companions,"
        " insider"
    )
    add("--against", action="append", default=[], metavar="NAME", help=about)
    about = "choose by future conflicts or by all (default: missed_future)"
    choices = ("missed_future", "missed")
    add("--criterion", choices=choices, default=choices[0], help=about)
    about = (
        "horizon of the conflicts, s; `run` for that of the run (default:"
        f" {HORIZON_S:g})"
    )
    add("--horizon", default=f"{HORIZON_S:g}", metavar="S", help=about)
    add(
        "--predictor",
        metavar="NAME",
        default="",
        help="the robot (default: the best of the run)",
    )
    about = "family of mechanisms, such as fid; repeatable (default: all of the run)"
    add("--family", action="append", default=[], metavar="NAME", help=about)
    descriptors = listed([METRICS[name].head for name in DESCRIPTORS])
    about = (
        f"limit {descriptors} of the sent positions, not of the strongest"
        " reconstruction"
    )
    add("--as-shared", action="store_true", help=about)
    about = (
        "adding rule that must hold (default: both); a network can only add independent"
        " noise"
    )
    add("--adding", choices=[*ADDING_RULES, "both"], default="both", help=about)
    add("--json", action="store_true", help="print one JSON object and nothing else")
    add(
        "--verbose",
        action="store_true",
        help="print all numbers and reasons, not 12 lines",
    )
    add("--plan", action="store_true", help="answer without a run; see --plan --help")
    return command


def _patrol_limits(options: argparse.Namespace) -> PatrolLimits:
    """Return the limits on patrols; SettingsError for impossible values."""
    from evaluation.verdict.patrol_records import (  # noqa: PLC0415 - heavy
        MOST_LOST,
        PatrolLimits,
    )

    return PatrolLimits(
        lost=MOST_LOST if options.max_missed is None else None,
        missed=options.max_missed,
        known=options.max_known,
        followed=options.max_followed,
    )


def _question(options: argparse.Namespace) -> Question:
    """Return the question of a command line; SettingsError for impossible values."""
    from evaluation.estimates.families import ADDING_RULES  # noqa: PLC0415 - heavy
    from evaluation.verdict.question import LIMITS, Criterion, Question  # noqa: PLC0415 - heavy

    horizon_s = None
    if options.horizon != "run":
        try:
            horizon_s = float(options.horizon)
        except ValueError:
            horizon_s = math.nan
        if not 0.0 < horizon_s < math.inf:
            raise SettingsError(
                f"--horizon takes a time in s or `run`, got {options.horizon!r}"
            )
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
