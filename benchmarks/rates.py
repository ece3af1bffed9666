"""CPU seconds of each part of a run: ``python -m benchmarks.rates`` writes what `--dry-run` reads.

Cells of two levels are computed in this process, one after the other, after the same cells of a
smaller run have compiled all loops. Every consumer's time is divided by the samples of its scenes,
or by the pairs that it compares. A fixed piece of work is timed between the pieces: rates are those
of an idle machine on which that takes `REFERENCE_S`, as in `docs/results/default_run.json`.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from pathlib import Path
from statistics import mean
from time import process_time
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from benchmarks.default_run import calibration_s
from evaluation.cells.work import cells
from evaluation.experiment.plan import Plan, plan
from evaluation.experiment.settings import Settings
from evaluation.runs.duration import name_of, rates_path, setup_of, size_of
from evaluation.runs.pieces import pieces_of
from isac_track.command_line import DONE, Parser, exit_code

if TYPE_CHECKING:
    from collections.abc import Sequence

ROOT = Path(__file__).resolve().parent.parent
REFERENCE_S = 0.66
"""CPU seconds of `benchmarks.default_run.calibration_s` on the reference machine, idle."""
ATTACKS = ("+ou_rts", "+shape@kalman_rts", "+shape@ou_rts")
"""Beside those of preset smoke."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write, and return the exit code."""
    return exit_code(lambda: _measure(arguments))


def _measure(arguments: Sequence[str] | None) -> int:
    command = Parser(prog="python -m benchmarks.rates", description=__doc__.splitlines()[0])
    command.add_argument("--dataset", default="plaza", metavar="NAME", help="recording")
    options = command.parse_args(arguments)
    settings = Settings(
        preset="smoke",
        dataset=options.dataset,
        mechanisms=("raw", "fixed:1"),
        tasks=("rerelease", "rerelease-framed", "split", "handover-1s"),
        predictors=("+kalman_cv:aware=true",),
        attacks=ATTACKS,
        jobs=1,
        out=Path("not-written"),
    )
    with threadpool_limits(limits=1, user_api="blas"):
        few = {"linkage.most_people": 40, "linkage.handover_instants": 3}
        _spent(plan(settings.changed(scenes=8, stages=settings.stages.changed(few))))
        rates = _spent(plan(settings.changed(scenes=100)))
    text = json.dumps(rates, indent=1, sort_keys=True) + "\n"
    rates_path(ROOT).write_text(text, encoding="utf-8")
    sys.stdout.write(text)
    return DONE


def _spent(ready: Plan) -> dict[str, float]:
    """Return CPU seconds by part, per million samples or pairs, to four digits.

    What all levels of a piece of work share is made before its first: that is its `setup`.
    """
    slower = [calibration_s() / REFERENCE_S]
    spent_s, sizes = defaultdict[str, float](float), defaultdict[str, float](float)
    first_s, first_cells = defaultdict[str, float](float), list[tuple[str, str, float]]()
    whole = defaultdict[str, float](float)
    for work in pieces_of(ready.units, ready):
        size, setup, before = size_of(work, ready), setup_of(work), process_time()
        whole[setup] += size
        stages, seed = ready.settings.stages, ready.settings.seed
        for _, mechanism, consumer, _ in cells(work, tracks=ready.tracks, stages=stages, seed=seed):
            now, name = process_time(), name_of(consumer)
            if mechanism is work.levels[0][0]:
                first_s[setup] += now - before
                first_cells.append((setup, name, size))
            else:
                spent_s[name] += now - before
                sizes[name] += size
            before = now
        slower.append(calibration_s() / REFERENCE_S)
    factor = 1.0 / mean(slower)
    sys.stderr.write(f"this machine takes {1 / factor:.2f} times as long as the reference\n")
    rates = {name: factor * spent_s[name] / sizes[name] for name in sizes}
    for setup, total_s in first_s.items():
        usual_s = sum(rates[name] * size for of, name, size in first_cells if of == setup)
        rates[setup] = max(factor * total_s - usual_s, 0.0) / whole[setup]
    return {name: float(f"{rate:.4g}") for name, rate in rates.items()}


if __name__ == "__main__":
    sys.exit(main())
