"""What a default run takes: ``python -m benchmarks.default_run --json FILE``.

Each run is a fresh process that writes into a folder of its own, after a run of few
scenes that fills the caches. With ``--cold`` no loop is compiled before: the cache is a
folder of its own. Seconds depend on the machine and on the hour; so a fixed piece of
work is timed before and after, and what a run takes is told in units of that as well:
these numbers compare across machines. With ``--tree DIR`` another checkout is measured
in the same sitting.
"""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from threading import Event, Thread
from time import perf_counter, process_time, time
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.processes import check_memory_is_known, tree_pss_mb
from evaluation.reporting.terminal import aligned
from isac_track.command_line import DONE, Parser, exit_code
from isac_track.errors import DataError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

ROOT = Path(__file__).resolve().parent.parent
EVERY_S = 0.2
FEW = "40"  # Scenes of a run that calls every loop.
STAGES = {
    "cells": "cells/*",
    "tables and verdict": "verdict.json",
    "page": "report.html",
}
"""A stage ends with the last of these files; before the first cell is the start."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and show; return the exit code."""
    return exit_code(lambda: _measure_all(parser().parse_args(arguments)))


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    command = Parser(
        prog="python -m benchmarks.default_run", description=__doc__.splitlines()[0]
    )
    add = command.add_argument
    add(
        "--dataset",
        nargs="+",
        default=["students03", "plaza"],
        metavar="NAME",
        help="recordings",
    )
    add(
        "--tree",
        nargs="+",
        type=Path,
        default=[ROOT],
        metavar="DIR",
        help="checkouts to measure",
    )
    add(
        "--cold",
        action="store_true",
        help="measure a run that has to compile its loops",
    )
    add("--json", type=Path, metavar="FILE", help="write the figures there, too")
    add("options", nargs="*", metavar="OPTION", help="options of the matrix, after --")
    return command


def calibration_s() -> float:
    """Return the CPU seconds of fixed work: a Python loop, a sort, a product."""
    rng = np.random.default_rng(0)
    values, square = rng.random(2_000_000), rng.random((400, 400))
    started, total = process_time(), 0
    for number in range(10_000_000):
        total += number & 7
    np.sort(values)
    for _ in range(20):
        np.einsum("ij,jk->ik", square, square)  # never more than one thread
    return process_time() - started


def _measure_all(options: argparse.Namespace) -> int:
    check_memory_is_known()
    results = []
    for tree in options.tree:
        for dataset in options.dataset:
            with tempfile.TemporaryDirectory(
                prefix="isac-track-default-run-"
            ) as folder:
                command = ["-m", "evaluation.matrix", "--dataset", dataset]
                cache = Path(folder) / "cache" if options.cold else None
                if not options.cold:
                    small = [*options.options, "--scenes", FEW]
                    measure([*command, *small, "--out", f"{folder}/small"], tree=tree)
                before_s = calibration_s()
                words = [*command, *options.options, "--out", f"{folder}/run"]
                result = measure(words, tree=tree, cache=cache)
            calibration = statistics.mean([before_s, calibration_s()])
            result |= {
                "dataset": dataset,
                "tree": tree.resolve().name,
                "calibration_s": calibration,
                "ratio": result["wall_s"] / calibration,
                "cpu_ratio": result["cpu_s"] / calibration,
            }
            results.append(result)
            print(
                f"{result['tree']}, {dataset}: {result['wall_s']:.0f} s",
                file=sys.stderr,
            )
    columns = [
        "tree",
        "dataset",
        "wall_s",
        "cpu_s",
        "peak_mb",
        "files",
        "disk_mb",
        "calibration_s",
        "ratio",
        "cpu_ratio",
        "load",
    ]
    rows = [[_shown(result[name]) for name in columns] for result in results]
    print("\n".join(aligned([columns, *rows])))
    for result in results:
        stages = ", ".join(f"{name} {s:.1f} s" for name, s in result["stages"].items())
        print(f"{result['tree']}, {result['dataset']}: {stages}")
    if options.json is not None:
        options.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    return DONE


def _shown(value: Any) -> str:  # noqa: ANN401 - a cell of a table
    return f"{value:,.1f}" if isinstance(value, float) else str(value)


def measure(
    arguments: Sequence[str], *, tree: Path, cache: Path | None = None
) -> dict[str, Any]:
    """Run a command of a checkout; its last argument is the folder that it makes.

    Compiled loops are cached in the folder `cache`, by default where numba puts them.

    Returns
    -------
    dict
        Seconds of wall clock and of CPU, of all processes together; their peak memory,
        MB, shared pages once; files and MB in the folder; the load before; and seconds
        by stage.

    Raises
    ------
    DataError
        If it fails; the message ends in its last line on standard error.
    """
    folder, load = Path(arguments[-1]), os.getloadavg()[0]
    environment = {**os.environ, "PYTHONPATH": str(tree.resolve())}
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began, started, finished, peak = time(), perf_counter(), Event(), [0.0]
    process = subprocess.Popen(
        [sys.executable, *arguments],
        cwd=tree,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )

    def watch() -> None:
        while not finished.wait(EVERY_S):
            peak[0] = max(peak[0], tree_pss_mb(process.pid))

    watcher = Thread(target=watch)
    watcher.start()
    _, complaints = process.communicate()
    wall_s = perf_counter() - started
    finished.set()
    watcher.join()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if process.returncode != 0:
        last = (complaints.splitlines() or [""])[-1]
        raise DataError(
            f"`{' '.join(arguments)}` ended with {process.returncode}: {last}"
        )
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {
        "wall_s": wall_s,
        "cpu_s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        "peak_mb": peak[0],
        "files": len(files),
        "disk_mb": sum(path.stat().st_size for path in files) / 1e6,
        "load": load,
        "stages": _stages(folder, began=began, ended=began + wall_s),
    }


def _stages(folder: Path, *, began: float, ended: float) -> dict[str, float]:
    """Return the duration of each stage of a run, s, from the times of its files."""
    cells = [path.stat().st_mtime for path in folder.glob("cells/*")]
    first = min(cells, default=began)
    stages, last = {"start": first - began}, first
    for name, pattern in STAGES.items():
        times = [path.stat().st_mtime for path in folder.glob(pattern)]
        end = max([last, *times])
        stages[name], last = end - last, end
    return stages | {"end": ended - last}


if __name__ == "__main__":
    sys.exit(main())
