"""How wall clock, CPU, memory and disk of a run grow: ``python -m benchmarks.scale``.

Each axis is varied alone. Each point is a fresh process that writes into a folder of
its own; repetitions go through all sizes in turn, so that other work on the machine
hits them alike, and the figure is their median. Memory is that of all processes, shared
pages once.

Exponents are least-squares slopes of log(amount) on log(size). The raw one flatters:
most of a small run is start-up (imports, the data set, figures, the page). The one that
is judged is that of what comes on top of the smallest size, (T - T0) on (n - n0): it is
1 for any a + b n, however large a. Points that take less than a tenth of T0 beyond it
are left out, since noise decides there.

Options after ``--`` go to every run: ``python -m benchmarks.scale --axis people --
--set linkage.candidates=100``.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.default_run import ROOT, calibration_s, measure
from benchmarks.processes import check_memory_is_known
from evaluation.reporting.terminal import aligned
from isac_track import datasets
from isac_track.command_line import DONE, LIMIT_NOT_MET, Parser, exit_code
from isac_track.rng import stream

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

AMOUNTS = {
    "wall_s": "wall (s)",
    "cpu_s": "CPU (s)",
    "peak_mb": "peak (MB)",
    "disk_mb": "disk (MB)",
}
LEAST_SHARE = 0.1
"""Share of the smallest run by which a point must exceed it to count."""
MOST_MEMORY_RATIO = 1.25
"""Largest growth of the peak, most of which is libraries.

Memory proportional to the scenes would grow 100 times.
"""
COPY_EVERY_S = 1000.0
"""Shift in time between copies of a recording: the plaza lasts 600 s."""
SMALL = (
    "--dataset",
    "plaza",
    "--predictor",
    "least_squares",
    "--attack",
    "none",
    "--task",
    "none",
)
TWO_LEVELS = ("--mechanism", "raw", "--mechanism", "fixed:0.7")


@dataclass(frozen=True, slots=True)
class Axis:
    """An axis that a run grows along: its sizes and its limits."""

    base: str
    """The settings that stay, in words."""
    sizes: tuple[int, ...]
    """The smallest is the start-up."""
    quick: tuple[int, ...]
    options: Callable[[int, Path, str], list[str]]
    """From size, empty folder and recording to options of the matrix."""
    most_exponent: float
    """Limit for wall clock and CPU."""
    most_memory_ratio: float = math.inf
    """Limit of the peak at the largest size over that at the second smallest."""


@dataclass(frozen=True, slots=True)
class Growth:
    """Fitted exponents; NaN with fewer than two points."""

    raw: float
    net: float
    """Beyond the smallest size."""
    last: float
    """The same, of the last two points alone."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print the tables; return the exit code."""
    return exit_code(lambda: _measure_all(parser().parse_args(arguments)))


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    command = Parser(
        prog="python -m benchmarks.scale",
        description=__doc__,
        epilog=(
            "exit codes: 0 all limits met, 1 a limit not met or not to be told, "
            "2 wrong usage, 130 interrupted"
        ),
    )
    add = command.add_argument
    add(
        "--axis",
        action="append",
        choices=AXES,
        metavar="NAME",
        help=f"of {', '.join(AXES)}",
    )
    add(
        "--size",
        action="append",
        type=positive,
        metavar="N",
        help="in place of the axis' own",
    )
    add(
        "--recording",
        default="plaza",
        metavar="NAME|PATH",
        help="where the people are from",
    )
    add("--quick", action="store_true", help="about a tenth of the sizes")
    add("--repeats", type=positive, default=1, metavar="N", help="default: %(default)s")
    add("--json", type=Path, metavar="FILE", help="write the figures there, too")
    add("options", nargs="*", metavar="OPTION", help="options of the matrix, after --")
    return command


def positive(text: str) -> int:
    """Return an option's value that must be a whole number of at least 1."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(
            f"must be a whole number of at least 1, got {text!r}"
        )
    return int(text)


def _measure_all(options: argparse.Namespace) -> int:
    check_memory_is_known()
    results = []
    for name in dict.fromkeys(options.axis or AXES):
        axis = AXES[name]
        sizes = sorted(
            {*(options.size or (axis.quick if options.quick else axis.sizes))}
        )
        runs: dict[int, list[dict[str, Any]]] = {size: [] for size in sizes}
        before_s = calibration_s()
        # A first run fills the file cache and compiles; its figures do not count.
        _measure_point(axis, sizes[0], options)
        for _ in range(options.repeats):
            for size in sizes:
                runs[size].append(_measure_point(axis, size, options))
                last = runs[size][-1]
                figures = " ".join(f"{last[amount]:.1f}" for amount in AMOUNTS)
                print(f"{name} {size:,}: {figures}", file=sys.stderr)
        heading = {"axis": name, "base": " ".join([axis.base, *options.options])}
        heading["calibration_s"] = (before_s + calibration_s()) / 2.0
        results.append(heading | judged(axis, runs))
    shown = finite(
        {"python": sys.version.split()[0], "cores": os.cpu_count(), "axes": results}
    )
    _show(results)
    if options.json is not None:
        options.json.write_text(json.dumps(shown, indent=1) + "\n", encoding="utf-8")
    return DONE if all(result["ok"] for result in results) else LIMIT_NOT_MET


def _measure_point(
    axis: Axis, size: int, options: argparse.Namespace
) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="isac-track-scale-") as folder:
        words = [*axis.options(size, Path(folder), options.recording), *options.options]
        command = ["-m", "evaluation.matrix", *words, "--out", f"{folder}/run"]
        return measure(command, tree=ROOT)


def judged(
    axis: Axis, runs: Mapping[int, Sequence[Mapping[str, Any]]]
) -> dict[str, Any]:
    """Return points and exponents of an axis, and whether its limits are met, for JSON.

    `runs` are the results of `measure` by size.
    """
    sizes = sorted(runs)
    points = [
        {name: float(np.median([run[name] for run in runs[size]])) for name in AMOUNTS}
        for size in sizes
    ]
    growth = {name: grown(sizes, [point[name] for point in points]) for name in AMOUNTS}
    ratio = points[-1]["peak_mb"] / points[min(1, len(points) - 1)]["peak_mb"]
    # A comparison with NaN is false: an unknown exponent does not keep the limit.
    ok = all(growth[name].net <= axis.most_exponent for name in ("wall_s", "cpu_s"))
    return {
        "points": [
            {"size": size, **point, "load": [run["load"] for run in runs[size]]}
            for size, point in zip(sizes, points, strict=True)
        ],
        "exponents": {name: asdict(exponents) for name, exponents in growth.items()},
        "memory_ratio": ratio,
        "limits": {
            "exponent": axis.most_exponent,
            "memory_ratio": axis.most_memory_ratio,
        },
        "ok": ok and ratio <= axis.most_memory_ratio,
    }


def grown(sizes: Sequence[int], amounts: Sequence[float]) -> Growth:
    """Return the exponents of an amount in size, both ascending in size."""
    n = np.asarray(sizes, dtype=np.float64)
    amount = np.asarray(amounts, dtype=np.float64)
    beyond = amount - amount[0]
    used = (beyond > 0) & (beyond >= LEAST_SHARE * amount[0])
    net_n, net = n[used] - n[0], beyond[used]
    return Growth(
        raw=_slope(n, amount),
        net=_slope(net_n, net),
        last=_slope(net_n[-2:], net[-2:]),
    )


def _slope(n: np.ndarray[Any, Any], amount: np.ndarray[Any, Any]) -> float:
    """Return the slope of log(amount) on log(n); NaN for fewer than two points."""
    if n.size < 2:
        return math.nan
    return float(np.polyfit(np.log(n), np.log(amount), 1)[0])


def _show(results: Sequence[Mapping[str, Any]]) -> None:
    rows = [["axis", "size", *AMOUNTS.values()]]
    for result in results:
        for point in result["points"]:
            figures = [f"{point[name]:,.1f}" for name in AMOUNTS]
            rows.append([result["axis"], f"{point['size']:,}", *figures])
        for kind in Growth.__slots__:
            exponents = [result["exponents"][name][kind] for name in AMOUNTS]
            shown = ["-" if math.isnan(x) else f"{x:.2f}" for x in exponents]
            rows.append([result["axis"], f"exponent, {kind}", *shown])
    print("\n".join(aligned(rows, left={0})))
    for result in results:
        limits, ratio = result["limits"], result["memory_ratio"]
        print(
            f"{result['axis']} ({result['base']}): net exponent of time at most"
            f" {limits['exponent']:g}, memory {ratio:.2f} times (at most"
            f" {limits['memory_ratio']:g}): {'ok' if result['ok'] else 'NOT MET'};"
            f" calibration {result['calibration_s']:.2f} s"
        )


def finite(value: Any) -> Any:  # noqa: ANN401 - anything that JSON has
    """Return a value of JSON with None in place of NaN and infinity."""
    if isinstance(value, dict):
        return {key: finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_people(path: Path, *, n_people: int, recording: str) -> None:
    """Write the first people of a recording as a file, repeated if there are fewer.

    Each copy is in an order of its own and comes later, so that no copy is denser.
    """
    tracks = datasets.load(recording).tracks
    with path.open("w", encoding="utf-8") as file:
        file.write("t,id,x,y\n")
        for copy, first in enumerate(range(0, n_people, len(tracks))):
            order = stream(0, "benchmark", "scale", copy).permutation(len(tracks))
            for row in order[: n_people - first]:
                track = tracks[int(row)]
                file.writelines(
                    f"{t + copy * COPY_EVERY_S:.3f},{copy}-{row},{x:.3f},{y:.3f}\n"
                    for t, (x, y) in zip(track.t, track.xy, strict=True)
                )


def _people_options(size: int, folder: Path, recording: str) -> list[str]:
    write_people(folder / "people.csv", n_people=size, recording=recording)
    return [
        "--dataset",
        str(folder / "people.csv"),
        "--set",
        f"linkage.most_people={size}",
    ]


def _scene_options(size: int, _folder: Path, _recording: str) -> list[str]:
    return [*SMALL, *TWO_LEVELS, "--jobs", "1", "--scenes", str(size)]


def _level_options(size: int, _folder: Path, _recording: str) -> list[str]:
    sweep = "fixed:0.1" if size == 1 else f"fixed:0.1..1/{size}"
    return [*SMALL, "--mechanism", sweep, "--jobs", "1", "--scenes", "2000"]


AXES = {
    "people": Axis(
        base="default axes, everybody in the galleries",
        sizes=(100, 300, 1000, 3000),
        quick=(50, 100, 200),
        options=_people_options,
        most_exponent=2.1,  # every pair is compared
    ),
    "scenes": Axis(
        base="raw and fixed:0.7, 1 job",
        sizes=(2, 500, 1500, 5000, 15_000, 50_000),
        quick=(2, 500, 1500, 5000),
        options=_scene_options,
        most_exponent=1.1,
        most_memory_ratio=MOST_MEMORY_RATIO,
    ),
    "levels": Axis(
        base="2,000 scenes, 1 job",
        sizes=(1, 4, 8, 16, 32),
        quick=(1, 4, 8),
        options=_level_options,
        most_exponent=1.1,
    ),
}


if __name__ == "__main__":
    sys.exit(main())
