"""Growth of a process that runs again and again: ``python -m benchmarks.soak``.

Runs 0..N-1 differ in their seed; each goes into a folder that is removed after it.
After each, with garbage collected, the process is looked at: memory, descriptors,
threads, children, files. The folder for temporary files and the working directory are
empty ones of its own, so that whatever is left behind shows, and nobody else's files
do.

The first two runs warm up: imports, compiled loops, caches with a bound, pools. From
the third on, growth is the Theil-Sen slope, which no single run moves, times the number
of runs, relative to the fitted level at the third run.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import math
import os
import re
import shutil
import signal
import sys
import tempfile
import threading
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
import psutil
from scipy.stats import theilslopes

import evaluation
from benchmarks.processes import (
    check_memory_is_known,
    command_line,
    descendants,
    rss_mb,
    tree_rss_mb,
)
from benchmarks.scale import finite, positive
from evaluation.plan.presets import PRESETS
from evaluation.reporting.terminal import aligned
from isac_track.command_line import DONE, LIMIT_NOT_MET, Parser, exit_code

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

WARM_UP = 2
LEAST_TIMES = WARM_UP + 2
MOST_GROWTH = 0.05
SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 - looked at, not written
TRACKER = "resource_tracker"
"""Helper of loky or multiprocessing, which lives as long as the process."""
PATH_VARIABLES = ("ISAC_TRACK_DATA", "ISAC_TRACK_CACHE", "PYTHONPATH")


@dataclass(frozen=True, slots=True)
class State:
    """Resources of a process after a run."""

    wall_s: float
    rss_mb: float
    """Resident set of this process."""
    tree_mb: float
    """Summed resident set of this process and its children."""
    heap_mb: float
    """Memory from malloc in use; NaN if the C library does not tell."""
    blocks: int
    """Small objects of Python, in thousands."""
    descriptors: int
    python_threads: int
    threads: int
    """All, those of native libraries included."""
    children: int
    """Child processes after the run, such as the `TRACKER`."""
    files: int
    """Left in the folders watched."""


@dataclass(frozen=True, slots=True)
class Growth:
    """Growth of an amount over all runs, relative to its level at the third."""

    grown: float
    low: float
    high: float
    """95% interval of `grown`."""
    last_over_third: float

    @property
    def ok(self) -> bool:
        """Whether the growth is within the limit."""
        return self.grown <= MOST_GROWTH


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, judge, print; return the exit code."""
    signal.signal(signal.SIGTERM, _end)  # not at once: folders are to be removed
    return exit_code(lambda: _soak(parser().parse_args(arguments)))


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    command = Parser(
        prog="python -m benchmarks.soak",
        description=__doc__,
        epilog=(
            "exit codes: 0 nothing grows or is left, 1 something does, 2 wrong usage, "
            "130 interrupted"
        ),
    )
    add = command.add_argument
    add(
        "--times",
        type=_times,
        default=20,
        metavar="N",
        help=f"runs, at least {LEAST_TIMES}; default: %(default)s",
    )
    add("--preset", choices=PRESETS, default="paper", help="default: %(default)s")
    add("--scenes", type=positive, metavar="N", help="default: the preset's")
    add("--dataset", metavar="NAME|PATH", help="default: as of evaluation.matrix")
    add("--jobs", type=positive, metavar="N", help="default: as of evaluation.matrix")
    add(
        "--json",
        action="store_true",
        help="print what was found as JSON, not as a table",
    )
    return command


def _end(_signal: int, _frame: object) -> NoReturn:
    raise SystemExit(128 + signal.SIGTERM)


def _times(text: str) -> int:
    times = positive(text)
    if times < LEAST_TIMES:
        raise argparse.ArgumentTypeError(
            f"growth is judged from run {WARM_UP + 1} on: at least {LEAST_TIMES} runs,"
            f" got {times}"
        )
    return times


def _soak(options: argparse.Namespace) -> int:
    check_memory_is_known()
    dataset = options.dataset
    if dataset is not None and Path(dataset).exists():
        dataset = str(Path(dataset).resolve())
    threads_before = set(threading.enumerate())
    states = []
    with own_place() as watched:
        shared_before = shared_files()
        for seed in range(options.times):
            settings = evaluation.Settings(
                preset=options.preset,
                dataset=dataset,
                scenes=options.scenes,
                seed=seed,
                jobs=options.jobs,
                out=watched[0] / f"out-{seed}",
            )
            states.append(_run(settings, watched=watched, shared_before=shared_before))
            _report_progress(len(states), times=options.times, state=states[-1])
        gc.collect()
        children = {pid: command_line(pid) for pid in descendants(os.getpid())}
        left = {
            "files": sorted(map(str, files_left(watched, shared_before=shared_before))),
            "children": [name for name in children.values() if TRACKER not in name],
            "threads": sorted(
                thread.name for thread in set(threading.enumerate()) - threads_before
            ),
        }
    trackers = [name for name in children.values() if TRACKER in name]
    judged = _judge(states, left=left)
    if options.json:
        report = {
            "runs": [asdict(state) for state in states],
            "judged": judged,
            "left": left,
            "kept": trackers,
        }
        print(json.dumps(finite(report), indent=1))
    else:
        _show(states, judged=judged, left=left, trackers=trackers)
    return DONE if all(judgement["ok"] for judgement in judged) else LIMIT_NOT_MET


@contextmanager
def own_place() -> Iterator[tuple[Path, Path]]:
    """Give the process an empty working directory and an empty temporary folder.

    Yields both. At the end the old ones are back and these are removed.
    """
    before = {name: os.environ.get(name) for name in ("TMPDIR", *PATH_VARIABLES)}
    old_directory, old_tempdir = Path.cwd(), tempfile.tempdir
    place = Path(tempfile.mkdtemp(prefix="isac-track-soak-"))
    try:
        for name in PATH_VARIABLES:
            if before[name]:
                parts = str(before[name]).split(os.pathsep)
                os.environ[name] = os.pathsep.join(
                    str(Path(part).resolve()) for part in parts
                )
        working, temporary = place / "working", place / "temporary"
        working.mkdir()
        temporary.mkdir()
        os.environ["TMPDIR"] = str(temporary)
        tempfile.tempdir = None  # read TMPDIR again
        os.chdir(working)
        yield working, temporary
    finally:
        os.chdir(old_directory)
        tempfile.tempdir = old_tempdir
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        shutil.rmtree(place, ignore_errors=True)


def _run(
    settings: evaluation.Settings, *, watched: Sequence[Path], shared_before: set[Path]
) -> State:
    """Run once, remove the results, and return the state of the process."""
    started = perf_counter()
    evaluation.run(settings)
    wall_s = perf_counter() - started
    assert settings.out is not None
    shutil.rmtree(settings.out)
    gc.collect()
    return State(
        wall_s=wall_s,
        rss_mb=rss_mb(os.getpid()),
        tree_mb=tree_rss_mb(os.getpid()),
        heap_mb=_heap_mb(),
        blocks=sys.getallocatedblocks() // 1000,
        descriptors=psutil.Process().num_fds(),
        python_threads=threading.active_count(),
        threads=psutil.Process().num_threads(),
        children=len(descendants(os.getpid())),
        files=len(files_left(watched, shared_before=shared_before)),
    )


class _MallInfo(ctypes.Structure):
    """The structure of glibc's mallinfo2: bytes and counts."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in (
            "arena",
            "ordblks",
            "smblks",
            "hblks",
            "hblkhd",
            "usmblks",
            "fsmblks",
            "uordblks",
            "fordblks",
            "keepcost",
        )
    )


def _heap_mb() -> float:
    """Return allocated memory that is not freed, MB.

    A leak grows it, fragmentation does not.
    """
    ask = getattr(ctypes.CDLL(None), "mallinfo2", None)
    if ask is None:
        return math.nan
    ask.restype = _MallInfo
    info = ask()
    return float(info.uordblks + info.hblkhd) / 1e6


def files_left(folders: Sequence[Path], *, shared_before: set[Path]) -> set[Path]:
    """Return the files in some folders, at any depth, and new ones in shared memory."""
    inside = {path for folder in folders for path in folder.rglob("*")}
    return inside | (shared_files() - shared_before)


def shared_files() -> set[Path]:
    """Return this user's entries in shared memory that do not name another process.

    joblib and loky write the id of the process that made them into the name.
    """
    ours = {os.getpid(), *descendants(os.getpid())}
    files = set()
    for path in SHARED_MEMORY.iterdir() if SHARED_MEMORY.is_dir() else ():
        makers = {
            int(text) for text in re.findall(r"(?<=[-_])[0-9]+(?=[-_])", path.name)
        }
        try:
            if path.lstat().st_uid == os.getuid() and (not makers or makers & ours):
                files.add(path)
        except FileNotFoundError:
            continue
    return files


def growth(values: Sequence[float]) -> Growth:
    """Estimate the growth of an amount over runs, of which the first two warm up.

    Parameters
    ----------
    values : sequence of float
        A value for each run, at least four, in any unit.
    """
    runs = np.arange(WARM_UP, len(values))
    slope, level_at_0, low, high = theilslopes(
        np.asarray(values[WARM_UP:], dtype=float), runs
    )
    level = level_at_0 + slope * WARM_UP
    scale = len(values) / level
    return Growth(
        grown=float(slope * scale),
        low=float(low * scale),
        high=float(high * scale),
        last_over_third=float(values[-1] / values[WARM_UP]),
    )


def _judge(
    states: Sequence[State], *, left: dict[str, list[str]]
) -> list[dict[str, Any]]:
    """Return each judged amount with its value, its limit and whether it is met."""
    judged: list[dict[str, Any]] = []
    for name, field in (
        ("memory of the process (RSS)", "rss_mb"),
        ("memory of all (RSS)", "tree_mb"),
        ("of it held from malloc", "heap_mb"),
        ("objects of Python", "blocks"),
    ):
        values = [getattr(state, field) for state in states]
        if np.isnan(values).any():
            continue
        trend = growth(values)
        judged.append(
            {
                "what": name,
                **asdict(trend),
                "value": trend.grown,
                "limit": MOST_GROWTH,
                "ok": trend.ok,
            }
        )
    # Pools of libraries reach their size in the first runs; later runs add none.
    for name, field in (("descriptors", "descriptors"), ("native threads", "threads")):
        third, last = (getattr(states[run], field) for run in (WARM_UP, -1))
        judged.append(
            {
                "what": f"{name} after run 3 and the last",
                "value": last,
                "limit": third,
                "ok": last <= third,
            }
        )
    judged += [
        {
            "what": f"{name} left at the end",
            "value": len(names),
            "limit": 0,
            "ok": not names,
        }
        for name, names in left.items()
    ]
    return judged


def _report_progress(run: int, *, times: int, state: State) -> None:
    print(
        f"run {run} of {times}: {state.wall_s:.1f} s, {state.rss_mb:.0f} MB, "
        f"all {state.tree_mb:.0f} MB, load {os.getloadavg()[0]:.1f}",
        file=sys.stderr,
        flush=True,
    )


def _show(
    states: Sequence[State],
    *,
    judged: Sequence[dict[str, Any]],
    left: dict[str, list[str]],
    trackers: Sequence[str],
) -> None:
    head = ["run", "wall (s)", "RSS (MB)", "all (MB)", "heap (MB)", "objects (k)"]
    rows = [[*head, "fds", "threads", "native", "children", "files"]]
    rows += [
        [
            str(run),
            f"{state.wall_s:.1f}",
            f"{state.rss_mb:.1f}",
            f"{state.tree_mb:.1f}",
            f"{state.heap_mb:.1f}",
            str(state.blocks),
            str(state.descriptors),
            str(state.python_threads),
            str(state.threads),
            str(state.children),
            str(state.files),
        ]
        for run, state in enumerate(states, start=1)
    ]
    print("\n".join(aligned(rows)))
    print(
        "\nRSS: of this process; all: of it and its children; heap: malloc's, in use.\n"
        "RSS that grows over a flat heap is fragmentation, no leak.\n"
    )
    rows = [["judged", "value", "95%", "last / 3rd", "limit", "ok"]]
    rows += [_row(judgement) for judgement in judged]
    print("\n".join(aligned(rows, left={0})))
    for name, texts in left.items():
        for text in texts:
            print(f"left, {name}: {text}")
    for text in trackers:
        print(f"kept until the process ends: {text}")


def _row(judgement: dict[str, Any]) -> list[str]:
    name, value, limit = judgement["what"], judgement["value"], judgement["limit"]
    ok = "yes" if judgement["ok"] else "NO"
    if "grown" not in judgement:
        return [name, str(value), "", "", str(limit), ok]
    interval = f"{100 * judgement['low']:+.1f}..{100 * judgement['high']:+.1f}%"
    ratio = f"{judgement['last_over_third']:.3f}"
    return [name, f"{100 * value:+.1f}%", interval, ratio, f"{100 * limit:.0f}%", ok]


if __name__ == "__main__":
    sys.exit(main())
