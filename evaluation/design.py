"""Choose a level for a site: `python -m evaluation.design --max-missed 0.20 OUT`."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from evaluation.reporting import noise_plan
from isac_track.command_line import DONE, LIMIT_NOT_MET, Parser, exit_code
from isac_track.errors import SettingsError
from isac_track.kalman import steady

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
    from evaluation.analysis.families import ADDING_RULES  # noqa: PLC0415 - heavy
    from evaluation.analysis.metrics import METRICS, SUCCESS  # noqa: PLC0415 - heavy
    from evaluation.reporting.design_words import show, to_json  # noqa: PLC0415 - heavy
    from evaluation.verdict.choose_level import ASKED, Limits, choose  # noqa: PLC0415 - heavy

    words = {
        "missed": "missed conflicts, a fraction of all conflicts",
        "false_alarm": "false alarms, a fraction of the scenes without a conflict",
        SUCCESS: "rank 1 of the strongest attack, a fraction: in every task but those of simulated "
        "people",
    }
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
        about = words.get(name, f"{shown.head}, {what}")
        option = f"--max-{name.replace('_', '-')}"
        add(option, type=float, required=name == "missed", metavar=unit, help=about)
    add("--predictor", metavar="NAME", help="the robot's predictor (default: the run's first)")
    about = "a mechanism's family, such as fid; repeatable (default: every one of the run)"
    add("--family", action="append", default=[], metavar="NAME", help=about)
    about = "hold PLR, AEL and MEL against what was shared, not against the best reconstruction "
    add("--as-shared", action="store_true", help=f"{about}(highest PLR)")
    about = "adding rule to answer for (default: both must hold); a network can do independent only"
    add("--adding", choices=[*ADDING_RULES, "both"], default="both", help=about)
    add("--json", action="store_true", help="print one JSON object and nothing else")
    add("--plan", action="store_true", help="answer without a run: --plan --help")
    options = command.parse_args(arguments)

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
        print(json.dumps(to_json(choice), indent=1, allow_nan=False))
    else:
        show(choice)
    return DONE if choice.met else LIMIT_NOT_MET


if __name__ == "__main__":
    sys.exit(main())
