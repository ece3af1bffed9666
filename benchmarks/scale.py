"""How time and memory grow: ``python -m benchmarks.scale``.

Each axis is varied alone, the rest stays at a small base. Each point is a fresh process that
writes into a folder of its own; the figure is the median of several repetitions, which go
through all sizes in turn, so that other work on the machine hits them alike.

Exponents are least-squares slopes of log(time) on log(size). The raw one flatters: most of a
small run is start-up (imports, the data set, figures, the report). The limit is therefore on
that of (T - T0) on (n - n0), where T0 is the time of the axis' smallest run, of size n0: it is 1
for any a + b n, however large a. Points that take less than a tenth of T0 beyond it are left
out of this fit, since noise decides there.

Memory is the largest sum of the proportional set sizes (PSS) of a process and all that it
started, read every 0.1 s, so that a page that several share counts once.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Event, Thread
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.processes import check_memory_is_told, rss_mb, tree_pss_mb
from evaluation.reporting.terminal import aligned
from isac_track import datasets
from isac_track.command_line import DONE, LIMIT_NOT_MET, Parser, exit_code
from isac_track.errors import DataError
from isac_track.rng import stream

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

ROOT = Path(__file__).resolve().parent.parent
EVERY_S = 0.1
LEAST_SHARE = 0.1
"""Of the start-up: what a point must take beyond it to count in the fit."""
MOST_EXPONENT = 1.1
MOST_MEMORY_RATIO = 1.25
"""Peak at the largest size over that at the smallest size that is not start-up.

Most of a peak is libraries. Room is left for what is 8 bytes or so a scene and for the allocator;
memory that followed the scenes would be at 100 times, not at 1.25 times.
"""
BASE = ("--dataset", "plaza", "--predictor", "least_squares", "--attack", "none", "--task", "none")
TWO_LEVELS = ("--mechanism", "raw", "--mechanism", "fixed:0.7")
COPY_EVERY_S = 1000.0
"""Shift in time between copies of the crowd: the plaza lasts 600 s."""


@dataclass(frozen=True, slots=True)
class Axis:
    """What is varied, how far, and what the growth may be."""

    name: str
    base: str
    """What is held, for people."""
    smallest: int
    """Size whose time is the start-up; 0 where a point leaves the start-up out itself."""
    sizes: tuple[int, ...]
    quick: tuple[int, ...]
    command: Callable[[int, Path], list[str]]
    """Size and an empty folder to the arguments of `python -m`."""
    most_exponent: float | None = None
    most_memory_ratio: float | None = None
    tells_time: bool = False
    """Whether the process prints its own time, s, and the start-up is no part of it."""
    is_size: bool = True
    """Whether there is an exponent; more workers are not more work."""


@dataclass(frozen=True, slots=True)
class Usage:
    """What one process took."""

    wall_s: float
    tree_mb: float
    """Peak of the summed PSS of the process and all that it started."""
    own_mb: float
    """Peak of the resident set of the process alone, shared pages and all."""


@dataclass(frozen=True, slots=True)
class Growth:
    """Fitted exponents; NaN where fewer than two points tell."""

    raw: float
    net: float
    """Of the time beyond start-up."""
    last: float
    """The same between the two largest sizes alone: growth that has only begun shows here."""
    used: tuple[int, ...]
    """Sizes in the fit of `net`."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print the tables; return the exit code."""
    return exit_code(lambda: _measure_all(parser().parse_args(arguments)))


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    command = Parser(
        prog="python -m benchmarks.scale",
        description=__doc__,
        epilog="exit codes: 0 all limits met, 1 a limit not met or not to be told, "
        "2 wrong usage, 130 interrupted",
    )
    add = command.add_argument
    add("--axis", action="append", choices=AXES, metavar="NAME", help=f"of {', '.join(AXES)}")
    add("--quick", action="store_true", help="about a tenth of the sizes")
    add("--repeats", type=positive, default=3, metavar="N", help="default: %(default)s")
    add("--json", action="store_true", help="print the measurements as JSON, not as tables")
    add("--gallery", type=positive, metavar="G", help=argparse.SUPPRESS)
    return command


def positive(text: str) -> int:
    """Return an option's value that must be a whole number of at least 1."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number of at least 1, got {text!r}")
    return int(text)


def _measure_all(options: argparse.Namespace) -> int:
    if options.gallery is not None:
        print(gallery_search_s(n=options.gallery))
        return DONE
    check_memory_is_told()
    chosen = [AXES[name] for name in dict.fromkeys(options.axis or AXES)]
    loads = [os.getloadavg()[0]]
    found = {}
    for axis in chosen:
        sizes = axis.quick if options.quick else axis.sizes
        found[axis.name] = measure_axis(axis, sizes=sizes, repeats=options.repeats)
        loads.append(os.getloadavg()[0])
    results = [
        judge(axis, usages=found[axis.name], sizes=axis.quick if options.quick else axis.sizes)
        for axis in chosen
    ]
    environment = {
        "python": sys.version.split()[0],
        "cores": os.cpu_count(),
        "load": [round(load, 2) for load in loads],
        "repeats": options.repeats,
        "quick": options.quick,
    }
    if options.json:
        print(json.dumps(finite({"environment": environment, "axes": results}), indent=1))
    else:
        _show(results, environment=environment)
    return DONE if all(result["ok"] for result in results) else LIMIT_NOT_MET


def measure_axis(axis: Axis, *, sizes: Sequence[int], repeats: int) -> dict[int, list[Usage]]:
    """Return what every size took, repetition by repetition; the smallest run is among them."""
    every = sorted({*sizes, *([axis.smallest] if axis.smallest else [])})
    _measure_point(axis, size=every[0])  # fills the file cache and compiles: not kept
    usages: dict[int, list[Usage]] = {size: [] for size in every}
    for repeat in range(repeats):
        for size in every:
            usage = _measure_point(axis, size=size)
            usages[size].append(usage)
            print(
                f"{axis.name} {size:,}, {repeat + 1} of {repeats}: {usage.wall_s:.2f} s, "
                f"{usage.tree_mb:.0f} MB, load {os.getloadavg()[0]:.1f}",
                file=sys.stderr,
            )
    return usages


def _measure_point(axis: Axis, *, size: int) -> Usage:
    with tempfile.TemporaryDirectory(prefix="isac-track-scale-") as folder:
        command = [sys.executable, "-m", *axis.command(size, Path(folder))]
        return measure(command, folder=Path(folder), tells_time=axis.tells_time)


def measure(command: Sequence[str], *, folder: Path, tells_time: bool = False) -> Usage:
    """Run a command to its end and return what it took.

    Raises
    ------
    DataError
        If it fails; the message ends in the last line of what it complained about.
    """
    environment = _environment(one_thread=tells_time)
    output, complaints = folder / "stdout", folder / "stderr"
    with output.open("wb") as out, complaints.open("wb") as err:
        started = perf_counter()
        process = subprocess.Popen(command, cwd=ROOT, stdout=out, stderr=err, env=environment)
        finished = Event()
        peaks = [0.0, 0.0]
        watcher = Thread(target=_watch, args=(process.pid, peaks, finished))
        watcher.start()
        try:
            code = process.wait()
            wall_s = perf_counter() - started
        finally:
            finished.set()
            watcher.join()
            if process.poll() is None:
                process.terminate()
                process.wait()
    if code != 0:
        lines = complaints.read_text(encoding="utf-8", errors="replace").splitlines() or [""]
        raise DataError(f"`{' '.join(command[1:])}` ended with {code}: {lines[-1]}")
    if tells_time:
        wall_s = float(output.read_text(encoding="utf-8"))
    return Usage(wall_s=wall_s, tree_mb=peaks[0], own_mb=peaks[1])


def _environment(*, one_thread: bool) -> dict[str, str]:
    # The checkout first: a process in another folder must not measure an installed copy.
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    names = ("OPENBLAS", "MKL", "OMP") if one_thread else ()
    return {**os.environ, "PYTHONPATH": path, **{f"{name}_NUM_THREADS": "1" for name in names}}


def _watch(pid: int, peaks: list[float], finished: Event) -> None:
    """Keep the peaks of a process, MB, until it has finished."""
    while True:
        peaks[0] = max(peaks[0], tree_pss_mb(pid))
        peaks[1] = max(peaks[1], rss_mb(pid))
        if finished.wait(EVERY_S):
            return


def judge(axis: Axis, *, usages: dict[int, list[Usage]], sizes: Sequence[int]) -> dict[str, Any]:
    """Return an axis' points, exponents and whether it is within its limits, ready for JSON."""
    median_s = {n: float(np.median([one.wall_s for one in usages[n]])) for n in usages}
    tree_mb = {n: float(np.median([one.tree_mb for one in usages[n]])) for n in usages}
    start_s = median_s[axis.smallest] if axis.smallest else 0.0
    result: dict[str, Any] = {
        "axis": axis.name,
        "base": axis.base,
        "start_up": {"size": axis.smallest, "wall_s": start_s},
        "points": [
            {
                "size": n,
                "wall_s": median_s[n],
                "net_s": median_s[n] - start_s,
                # A unit of the smallest run is in its time already.
                "us_per_unit": 1e6 * (median_s[n] - start_s) / (n - axis.smallest)
                if n > axis.smallest
                else math.nan,
                "tree_mb": tree_mb[n],
                "own_mb": float(np.median([one.own_mb for one in usages[n]])),
                "repetitions": [asdict(one) for one in usages[n]],
            }
            for n in sorted(usages)
        ],
    }
    if not axis.is_size:
        first, *others = sizes
        speed_up = {str(n): median_s[first] / median_s[n] for n in others}
        return result | {"speed_up": speed_up, "ok": True}
    growth = fitted(sizes, [median_s[n] for n in sizes], smallest=axis.smallest, start_s=start_s)
    each = [
        fitted(
            growth.used,
            [usages[n][repeat].wall_s for n in growth.used],
            smallest=axis.smallest,
            start_s=start_s,
            least_share=0.0,
        ).net
        for repeat in range(len(usages[sizes[0]]))
    ]
    ratio = tree_mb[sizes[-1]] / tree_mb[sizes[0]]
    return result | {
        "exponent": {
            "raw": growth.raw,
            "net": growth.net,
            "lowest": min(each),
            "highest": max(each),
            "last": growth.last,
            "used": growth.used,
            "limit": axis.most_exponent,
        },
        "memory": {"ratio": ratio, "limit": axis.most_memory_ratio},
        # A comparison with NaN is false: what cannot be told is not within a limit.
        "ok": (axis.most_exponent is None or growth.net <= axis.most_exponent)
        and (axis.most_memory_ratio is None or ratio <= axis.most_memory_ratio),
    }


def fitted(
    sizes: Sequence[int],
    wall_s: Sequence[float],
    *,
    smallest: int = 0,
    start_s: float = 0.0,
    least_share: float = LEAST_SHARE,
) -> Growth:
    """Return the exponents of time in size, with and without the start-up.

    Parameters
    ----------
    sizes, wall_s
        Points, by size; s.
    smallest, start_s
        Size and time of the run that stands for the start-up; s.
    least_share
        Of `start_s`: what a point must take beyond it.
    """
    n, t = np.asarray(sizes, dtype=np.float64), np.asarray(wall_s, dtype=np.float64)
    net = t - start_s
    used = (n > smallest) & (net > 0) & (net >= least_share * start_s)
    n_net, t_net = n[used] - smallest, net[used]
    return Growth(
        raw=_slope(n, t),
        net=_slope(n_net, t_net),
        last=_slope(n_net[-2:], t_net[-2:]),
        used=tuple(int(one) for one in n[used]),
    )


def _slope(n: np.ndarray[Any, Any], t: np.ndarray[Any, Any]) -> float:
    if n.size < 2:
        return math.nan
    return float(np.polyfit(np.log(n), np.log(t), 1)[0])


def _show(results: Sequence[dict[str, Any]], *, environment: dict[str, Any]) -> None:
    loads = " ".join(f"{load:.1f}" for load in environment["load"])
    print(
        f"Python {environment['python']}, {environment['cores']} cores, load between the axes "
        f"{loads}; medians of {environment['repeats']}\n"
    )
    head = ["axis", "size", "wall (s)", "net (s)", "us per unit", "peak (MB)", "own peak (MB)"]
    rows = [head]
    for result in results:
        has_unit = "exponent" in result
        rows += [
            [
                result["axis"],
                f"{point['size']:,}",
                f"{point['wall_s']:.2f}",
                _number(point["net_s"] if has_unit else None, ".2f"),
                _number(point["us_per_unit"] if has_unit else None, ",.1f"),
                f"{point['tree_mb']:.0f}",
                f"{point['own_mb']:.0f}",
            ]
            for point in result["points"]
        ]
    print("\n".join(aligned(rows, left={0})))
    print(
        "\nnet: beyond the smallest run, so is the time per unit. Peak: PSS of all processes; "
        "own: RSS of the first.\n"
    )
    rows = [
        ["axis", "exponent", "range", "last step", "raw", "limit", "memory", "limit", "ok", "held"]
    ]
    rows += [_verdict_row(result) for result in results]
    print("\n".join(aligned(rows, left={0, 9})))
    print(
        "\nexponent: of net time in size, the limit is on it; range: repetitions one by one; "
        "memory: last over first size."
    )
    for result in results:
        for jobs, ratio in result.get("speed_up", {}).items():
            print(f"{result['axis']}: {jobs} are {ratio:.2f} times as fast as 1")
        if "exponent" in result and math.isnan(result["exponent"]["net"]):
            print(f"{result['axis']}: too little beyond start-up to tell an exponent")


def _verdict_row(result: dict[str, Any]) -> list[str]:
    if "exponent" not in result:
        return [result["axis"], *["-"] * 8, result["base"]]
    exponent, memory = result["exponent"], result["memory"]
    limited = exponent["limit"] is not None or memory["limit"] is not None
    return [
        result["axis"],
        _number(exponent["net"], ".2f"),
        f"{_number(exponent['lowest'], '.2f')}..{_number(exponent['highest'], '.2f')}",
        _number(exponent["last"], ".2f"),
        _number(exponent["raw"], ".2f"),
        _number(exponent["limit"], ".2f"),
        f"x{memory['ratio']:.2f}",
        _number(memory["limit"], ".2f"),
        ("yes" if result["ok"] else "NO") if limited else "-",
        result["base"],
    ]


def _number(value: float | None, form: str) -> str:
    return "-" if value is None or math.isnan(value) else format(value, form)


def finite(value: Any) -> Any:  # noqa: ANN401 - anything that JSON has
    """Return the same with null for what is not a number, which JSON cannot say."""
    if isinstance(value, dict):
        return {key: finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def gallery_search_s(*, n: int) -> float:
    """Return how long all linkers of `benchmarks.linkage` search a gallery of n people, s."""
    from benchmarks import linkage  # noqa: PLC0415 - limits the threads of whoever imports it

    probe = linkage.released(n=linkage.N_PROBES, side="probe")
    gallery = linkage.released(n=n, side="gallery")
    few = gallery.tracks(range(min(n, 100)))
    total_s = 0.0
    for name in linkage.LINKERS:
        search = linkage.fit(name)
        linkage.check_blocks(search, probe, few)  # compiles as well
        total_s += linkage.search_s(search, probe, gallery)
    return total_s


def write_crowd(path: Path, *, n_tracks: int) -> None:
    """Write walks of the simulated plaza as a file of one's own, whole crowds one after another.

    Each copy of the crowd is in an order of its own and comes later: more tracks, no denser.
    """
    tracks = datasets.load("plaza").tracks
    with path.open("w", encoding="utf-8") as file:
        file.write("t,id,x,y\n")
        for copy, first in enumerate(range(0, n_tracks, len(tracks))):
            order = stream(0, "benchmark", "scale", copy).permutation(len(tracks))
            for row in order[: n_tracks - first]:
                track = tracks[int(row)]
                file.writelines(
                    f"{t + copy * COPY_EVERY_S:.3f},{copy}-{row},{x:.3f},{y:.3f}\n"
                    for t, (x, y) in zip(track.t, track.xy, strict=True)
                )


def _matrix(folder: Path, *options: str) -> list[str]:
    return ["evaluation.matrix", *options, "--out", str(folder / "run")]


def _of_scenes(size: int, folder: Path) -> list[str]:
    return _matrix(folder, *BASE, *TWO_LEVELS, "--jobs", "1", "--scenes", str(size))


def _of_levels(size: int, folder: Path) -> list[str]:
    sweep = "fixed:0.1" if size == 1 else f"fixed:0.1..1/{size}"
    return _matrix(folder, *BASE, "--mechanism", sweep, "--jobs", "1", "--scenes", "2000")


def _of_tracks(size: int, folder: Path) -> list[str]:
    write_crowd(folder / "crowd.csv", n_tracks=size)
    own = ("--dataset", str(folder / "crowd.csv"), *BASE[2:])
    return _matrix(folder, *own, *TWO_LEVELS, "--jobs", "1", "--scenes", "500")


def _of_gallery(size: int, folder: Path) -> list[str]:  # noqa: ARG001 - as of every axis
    return ["benchmarks.scale", "--gallery", str(size)]


def _of_workers(size: int, folder: Path) -> list[str]:
    return _matrix(folder, *BASE, *TWO_LEVELS, "--jobs", str(size), "--scenes", "10000")


AXES = {
    axis.name: axis
    for axis in (
        Axis(
            name="scenes",
            base="raw and fixed:0.7, 1 job",
            smallest=2,
            sizes=(500, 1500, 5000, 15_000, 50_000),
            quick=(50, 500, 1500, 5000),
            command=_of_scenes,
            most_exponent=MOST_EXPONENT,
            most_memory_ratio=MOST_MEMORY_RATIO,
        ),
        Axis(
            name="levels",
            base="2,000 scenes, 1 job",
            smallest=1,
            sizes=(4, 8, 16, 32),
            quick=(4, 8),
            command=_of_levels,
            most_exponent=MOST_EXPONENT,
        ),
        Axis(
            name="tracks",
            base="500 scenes, raw and fixed:0.7, 1 job",
            # With fewer people some intervals are refused, and the run is shorter for that.
            smallest=100,
            sizes=(400, 1600, 6400),
            quick=(200, 400, 800),
            command=_of_tracks,
        ),
        Axis(
            name="gallery",
            base="100 probes, 6 linkers, start-up not in it",
            smallest=0,
            sizes=(100, 1000, 10_000),
            quick=(100, 300, 1000),
            command=_of_gallery,
            tells_time=True,
        ),
        Axis(
            name="workers",
            base="10,000 scenes, raw and fixed:0.7",
            smallest=0,
            sizes=(1, 2),
            quick=(1, 2),
            command=_of_workers,
            is_size=False,
        ),
    )
}


if __name__ == "__main__":
    sys.exit(main())
