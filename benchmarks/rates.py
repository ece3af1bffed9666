"""CPU seconds of each part of a run, for `--dry-run`: ``python -m benchmarks.rates``.

Cells of two levels are computed in this process, one after the other, after the same
cells of a smaller run have compiled all loops. Every consumer's time is divided by the
samples of its scenes, or by the pairs that it compares. Their scale is that of a whole
run on an idle machine, the one of `docs/results/default_run.json`: what is measured
here may share its machine with others.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from evaluation.compute.work import compute_cells
from evaluation.plan.plan import Plan, make_plan
from evaluation.plan.presets import PRESETS
from evaluation.plan.settings import Settings
from evaluation.pool.duration import (
    cells_cpu_s,
    measured_rates,
    rate_name,
    rates_path,
    setup_name,
    work_size,
)
from evaluation.pool.pieces import cut_work
from isac_track.command_line import DONE, Parser, exit_code
from isac_track.config import StageSettings

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

ROOT = Path(__file__).resolve().parent.parent
WHOLE_RUN = ROOT / "docs" / "results" / "default_run.json"
"""Measured by `python -m benchmarks.default_run`, on two idle cores."""
ATTACKS = (
    *PRESETS["paper"].attacks,
    "ou_rts",
    "shape@kalman_rts",
    "shape@ou_rts",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write, and return the exit code."""
    return exit_code(lambda: _measure(arguments))


def _measure(arguments: Sequence[str] | None) -> int:
    command = Parser(
        prog="python -m benchmarks.rates", description=__doc__.splitlines()[0]
    )
    command.add_argument("--dataset", default="plaza", metavar="NAME", help="recording")
    options = command.parse_args(arguments)
    settings = Settings(
        preset="smoke",
        dataset=options.dataset,
        mechanisms=("raw", "fixed:1"),
        tasks=("rerelease", "rerelease-framed", "split", "handover-1s"),
        predictors=("+kalman_cv:aware=true",),
        attacks=ATTACKS,
        policies=("everything", "near:3.5", "ahead:2"),
        stages=StageSettings().changed({"patrol.fleets": 4, "tracking.method": "gnn"}),
        jobs=1,
        out=Path("not-written"),
    )
    with threadpool_limits(limits=1, user_api="blas"):
        few = {"linkage.most_people": 40, "linkage.handover_instants": 3}
        _spent(
            make_plan(settings.changed(scenes=8, stages=settings.stages.changed(few)))
        )
        rates = _spent(make_plan(settings.changed(scenes=100)))
    _write(rates)
    factor = whole_run_factor()
    _write({name: factor * rate for name, rate in rates.items()})
    return DONE


def whole_run_factor() -> float:
    """Return the factor between a whole run of preset paper on plaza and the rates."""
    runs = json.loads(WHOLE_RUN.read_text(encoding="utf-8"))
    measured_s: float = next(
        run["stages"]["cells"] for run in runs if run["dataset"] == "plaza"
    )
    settings = Settings(
        preset="paper", dataset="plaza", jobs=2, out=Path("not-written")
    )
    return 2.0 * measured_s / cells_cpu_s(make_plan(settings))


def _write(rates: Mapping[str, float]) -> None:
    """Write rates beside those of parts that no cell here has: people who come back."""
    rounded = {**measured_rates()}
    rounded |= {name: float(f"{rate:.4g}") for name, rate in rates.items()}
    text = json.dumps(rounded, indent=1, sort_keys=True) + "\n"
    rates_path(ROOT).write_text(text, encoding="utf-8")


def _spent(plan: Plan) -> dict[str, float]:
    """Return CPU seconds by part, per million samples or pairs.

    The `setup` of a piece of work is done before its first level, for all levels.
    """
    spent_s, sizes = defaultdict[str, float](float), defaultdict[str, float](float)
    first_s = defaultdict[str, float](float)
    first_cells = list[tuple[str, str, float]]()
    setup_sizes = defaultdict[str, float](float)
    for work in cut_work(plan.units, plan):
        size, setup, before = work_size(work, plan), setup_name(work), process_time()
        setup_sizes[setup] += size
        stages, seed = plan.settings.stages, plan.settings.seed
        for _, mechanism, consumer, _ in compute_cells(
            work, tracks=plan.scene_tracks, stages=stages, seed=seed
        ):
            now, name = process_time(), rate_name(consumer)
            if mechanism is work.levels[0][0]:
                first_s[setup] += now - before
                first_cells.append((setup, name, size))
            else:
                spent_s[name] += now - before
                sizes[name] += size
            before = now
    rates = {name: spent_s[name] / sizes[name] for name in sizes}
    for setup, total_s in first_s.items():
        usual_s = sum(
            rates[name] * size for cell, name, size in first_cells if cell == setup
        )
        rates[setup] = max(total_s - usual_s, 0.0) / setup_sizes[setup]
    return rates


if __name__ == "__main__":
    sys.exit(main())
