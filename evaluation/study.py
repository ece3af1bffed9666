"""Several recordings, one answer: `python -m evaluation.study`; see docs/how-to/compare.md.

A run folder for each recording, seed and law, and over all of them `study.csv` and
`study.html`.
"""

import argparse
import sys
import warnings
from collections.abc import Sequence
from itertools import groupby, product
from operator import attrgetter
from pathlib import Path

from evaluation.plan.presets import DEFAULT, PRESETS
from evaluation.plan.settings import READING_OPTIONS, Settings, parse_stage_values
from isac_track.command_line import DONE, FAILED_CELLS, Parser, exit_code
from isac_track.config import StageSettings
from isac_track.errors import SettingsError

LAWS = ("radial", "isotropic")
_LAW = "sensing.law"
_EPILOG = """\
exit codes: 0 done, 2 wrong usage or data, 3 some cells failed (the others are done),
130 interrupted (finished runs stay; the same command continues)

examples:
  python -m evaluation.study --dataset students03 --dataset zara01 --out runs/study
  python -m evaluation.study --dataset students03 --dataset gc --seed 0 --seed 1 \\
      --law radial --law isotropic --out runs/study
  python -m evaluation.study --dataset students03 --dataset gc --set sensing.bs_y_m=60 \\
      --out runs/study-far
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python -m evaluation.study",
        description=(
            "Run the matrix over several recordings, seeds and laws; answer them"
            " together."
        ),
        epilog=_EPILOG,
    )
    add = command.add_argument
    about = "a recording; repeatable"
    add("--dataset", action="append", metavar="NAME|PATH", required=True, help=about)
    about = "of every run (default: %(default)s)"
    add("--preset", default=DEFAULT, choices=list(PRESETS), help=about)
    add(
        "--seed",
        action="append",
        metavar="N",
        type=int,
        help="base seed; repeatable (default: 0)",
    )
    about = "law of the sensing error; repeatable (default: radial)"
    add("--law", action="append", choices=LAWS, help=about)
    about = "change a stage setting of every run, as in evaluation.matrix; repeatable"
    add("--set", action="append", metavar="STAGE.KEY=VALUE", default=[], help=about)
    for option, about in {
        "--columns": "as in evaluation.matrix, of every file",
        "--on-duplicate": "error, first or mean, as in evaluation.matrix",
        "--crs": "degrees, as in evaluation.matrix",
    }.items():
        add(option, help=about)
    add("--drop-frozen", metavar="S", type=float, help="as in evaluation.matrix")
    add("--out", metavar="DIR", type=Path, required=True, help="folder of the study")
    add("--jobs", metavar="N", type=int, help="worker processes of a run")
    add(
        "--executor",
        metavar="local|dask",
        default="local",
        help="as in evaluation.matrix",
    )
    add("--scheduler", metavar="ADDRESS", help="address of the Dask cluster")
    interrupted = "interrupted; finished runs stay, the same command continues"
    return exit_code(
        lambda: _study(command.parse_args(arguments)), interrupted=interrupted
    )


def _study(options: argparse.Namespace) -> int:
    """Run all combinations of recording, seed and law, and print the answers."""
    lists = options.dataset, options.seed or [0], options.law or LAWS[:1]
    same = {
        name: getattr(options, name)
        for name in ("preset", "jobs", "executor", "scheduler")
    }
    for name in READING_OPTIONS:
        if getattr(options, name) is not None:
            same[name] = getattr(options, name)
    changed = parse_stage_values(options.set)
    if _LAW in changed:
        raise SettingsError(f"--set {_LAW}: the laws of a study are named by --law")
    asked = []
    # Each combination once; all are checked before the first run begins.
    for dataset, seed, law in product(*map(dict.fromkeys, lists)):
        out = options.out / f"{Path(dataset).stem}-{options.preset}-{seed}-{law}"
        # No question of a study is about patrols.
        stages = StageSettings().changed(changed | {_LAW: law})
        settings = Settings(
            dataset=dataset, seed=seed, policies=(), stages=stages, out=out, **same
        )
        asked.append((law, settings))
    from evaluation.api import study  # noqa: PLC0415 - --help answers at once
    from evaluation.estimates.pooled import QUESTIONS  # noqa: PLC0415 - as said
    from evaluation.pool.execute import FailedCellsWarning  # noqa: PLC0415 - as said

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FailedCellsWarning)  # the exit code shows it
        pooled, n_failed = study(asked, out=options.out)
    for question, answers in groupby(pooled, key=attrgetter("question")):
        print(QUESTIONS[question])
        for answer in answers:
            print(f"  {answer.adding} adding, {answer.law} error: {answer.sentence}")
    print(f"Page: {options.out / 'study.html'}; numbers: {options.out / 'study.csv'}")
    return FAILED_CELLS if n_failed else DONE


if __name__ == "__main__":
    sys.exit(main())
