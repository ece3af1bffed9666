"""Several recordings, one answer: `python -m evaluation.study`; see docs/compare.md.

A run folder for each recording, seed and law, and over all of them `study.csv` and `study.html`.
"""

import argparse
import sys
import warnings
from collections.abc import Sequence
from itertools import product
from pathlib import Path

from evaluation.experiment.presets import PRESETS
from evaluation.experiment.settings import Settings
from isac_track.command_line import DONE, FAILED_CELLS, Parser, exit_code
from isac_track.config import StageSettings

LAWS = ("radial", "isotropic")
_EXIT = """\
exit codes: 0 done, 2 wrong usage or data, 3 some cells failed (the others are done),
130 interrupted (finished runs are kept; the same command continues)

examples:
  python -m evaluation.study --dataset students03 --dataset zara01 --out runs/study
  python -m evaluation.study --dataset students03 --dataset gc --seed 0 --seed 1 \\
      --law radial --law isotropic --out runs/study
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python -m evaluation.study",
        description="Run the matrix over several recordings, seeds and laws; answer them as one.",
        epilog=_EXIT,
    )
    add = command.add_argument
    about = "a recording; repeatable"
    add("--dataset", action="append", metavar="NAME|PATH", required=True, help=about)
    add("--preset", default="paper", choices=list(PRESETS), help="of every run (default: paper)")
    add("--seed", action="append", metavar="N", type=int, help="base seed; repeatable (default: 0)")
    about = "law of the sensing error; repeatable (default: radial)"
    add("--law", action="append", choices=LAWS, help=about)
    for option, about in {
        "--columns": "as in evaluation.matrix, of every file",
        "--on-duplicate": "error, first or mean, as in evaluation.matrix",
        "--crs": "degrees, as in evaluation.matrix",
    }.items():
        add(option, help=about)
    add("--drop-frozen", metavar="S", type=float, help="as in evaluation.matrix")
    add("--out", metavar="DIR", type=Path, required=True, help="folder of the study")
    add("--jobs", metavar="N", type=int, help="worker processes of a run")
    add("--executor", metavar="local|dask", default="local", help="as in evaluation.matrix")
    add("--scheduler", metavar="ADDRESS", help="address of the Dask cluster")
    kept = "interrupted; finished runs are kept, the same command continues"
    return exit_code(lambda: _study(command.parse_args(arguments)), interrupted=kept)


def _study(options: argparse.Namespace) -> int:
    axes = options.dataset, options.seed or [0], options.law or LAWS[:1]
    same = {name: getattr(options, name) for name in ("preset", "jobs", "executor", "scheduler")}
    how = ("columns", "on_duplicate", "crs", "drop_frozen")
    asked_of_files = {name: getattr(options, name) for name in how}
    same |= {name: value for name, value in asked_of_files.items() if value is not None}
    asked = []
    # Each once, and all is checked before the first run begins.
    for dataset, seed, law in product(*map(dict.fromkeys, axes)):
        out = options.out / f"{Path(dataset).stem}-{options.preset}-{seed}-{law}"
        stages = StageSettings().changed({"sensing.law": law})
        asked.append((law, Settings(dataset=dataset, seed=seed, stages=stages, out=out, **same)))
    from evaluation.results import study  # noqa: PLC0415 - --help answers at once
    from evaluation.runs.execute import FailedCellsWarning  # noqa: PLC0415 - as said

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FailedCellsWarning)  # told by the code
        of, n_failed = study(asked, out=options.out)
    for one in of:
        print(f"{one.question}, {one.adding}, {one.law}: {one.sentence}")
    print(f"Page: {options.out / 'study.html'}; numbers: {options.out / 'study.csv'}")
    return FAILED_CELLS if n_failed else DONE


if __name__ == "__main__":
    sys.exit(main())
