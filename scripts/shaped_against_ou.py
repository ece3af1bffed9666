"""Compare `shaped` with `ou` where a robot misses as many conflicts.

    python scripts/shaped_against_ou.py --dataset students03 --dataset gc --out runs/shaped

It runs both at levels about +3 and +10 points of missed future conflicts, and prints
what the strongest attack knows there, and whom the strongest linker links. Attacks are
chosen on one half of the people and scored on the other. Differences are paired by
person. Several recordings also have a mean. A second call with the same folder
continues the runs, or reads them.
"""

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

import evaluation
from evaluation.api.run_estimates import link_estimates
from evaluation.estimates.decisions import decisions
from evaluation.estimates.families import RAW, entry_families
from evaluation.estimates.frontier import Quantity, frontier_quantities
from evaluation.estimates.interpolation import (
    interpolated,
    positions_at_change,
    with_ends,
)
from evaluation.estimates.keys import judged_at
from evaluation.estimates.metrics import DESCRIPTORS
from evaluation.estimates.strongest_table import strongest_attacks
from evaluation.estimates.summary import scene_numbers
from evaluation.estimates.sweeps import CRITERIA, FUTURE, Sweeps
from evaluation.plan.address import parse_consumer
from evaluation.plan.world import World
from evaluation.store.manifest import read_manifest
from isac_track.command_line import DONE, Parser, exit_code
from isac_track.types import Floats

SHAPED: Final = (0.07, 0.075, 0.08, 0.085, 0.09, 0.1, 0.11, 0.12, 0.13, 0.145, 0.16)
OU: Final = (0.08, 0.11, 0.14, 0.17, 0.2, 0.23, 0.27, 0.32, 0.4)
TIMES_S: Final = (5, 15)
ROBOTS: Final = ("kalman_cv", "kalman_cv:aware=true")
TARGETS: Final = (0.03, 0.1)  # Rises of missed future conflicts over raw.
HORIZON_S: Final = 3.0
COMPARED: Final = "shaped"
RIVALS: Final = ("ou", "ou:tau_s=15")
_ENDS: Final = ("value", "ci_low", "ci_high")
_LABELS: Final = {
    "kalman_cv": "unaware",
    "kalman_cv:aware=true": "aware",
    "informed": "one release",
    "repeats": "four releases",
    "anchor": "a known position",
    "handover-1s": "links over 1 s",
    "handover-5s": "links over 5 s",
}
"""Names of robots, adversaries and tasks in the table."""


def mechanisms() -> list[str]:
    """Return the SPECs of all levels."""
    shaped = [f"shaped:{floor:g}" for floor in SHAPED]
    slow = [f"ou:{std:g},tau_s={time:g}" for time in TIMES_S for std in OU]
    return ["raw", *shaped, *slow]


Readings: TypeAlias = "dict[tuple[str, float, str], dict[str, Floats]]"
"""By robot, rise, and adversary or task: a mechanism's value and replicates, (1 + B,)."""


def read_run(out: Path) -> Readings:
    """Return the readings of a finished run; DataError if a cell cannot be read."""
    manifest = read_manifest(out)
    families = entry_families(manifest["cells"])
    now = scene_numbers(out, manifest)
    ahead = scene_numbers(out, manifest, world=World(horizon_s=HORIZON_S))
    robots = decisions(ahead, manifest, dataset=manifest["dataset"]["name"])
    links = link_estimates(out, manifest)
    estimates = {**now.estimates, **links.estimates}
    attacks = strongest_attacks(estimates, {**links.sums, **now.attacked}, families)
    quantities, crossed = frontier_quantities(Sweeps(estimates, families), attacks)
    at_horizon = judged_at(
        {**estimates, **crossed}, {**ahead.estimates, **robots.at_raw_alarms}
    )
    return readings(Sweeps(at_horizon, families), quantities, robots=ROBOTS)


def readings(
    sweeps: Sweeps,
    quantities: Iterable[Quantity],
    *,
    robots: Iterable[str],
    price: str = CRITERIA[FUTURE],
) -> Readings:
    """Return PLR after attack and rank 1 where a robot's `price` rises by `TARGETS`."""
    values_at: Readings = {}
    targets = np.array(TARGETS)
    for robot in robots:
        cost = parse_consumer(robot).measured(price)
        rises = sweeps.together(dict.fromkeys(sweeps.families, cost))
        reached = {
            name: positions_at_change(targets, np.abs(curve - curve[:, -1:]))
            for name, curve in rises.items()
        }
        for quantity in quantities:
            if not quantity.is_axis:
                continue
            readers = quantity.reader_by_mechanism
            curves = sweeps.together(
                {name: readers[name].measured(quantity.metric) for name in readers}
            )
            reader = readers[RAW]
            for name in curves.keys() & reached.keys():
                is_log = quantity.metric in DESCRIPTORS
                values = interpolated(reached[name], curves[name], log=is_log)
                for place, target in enumerate(TARGETS):
                    key = robot, target, reader.task or reader.adversary
                    values_at.setdefault(key, {})[name] = values[:, place]
    return values_at


def mean_readings(runs: Sequence[Readings]) -> Readings:
    """Return the means over runs of other people, which are drawn independently."""
    shared = set.intersection(*(set(run) for run in runs))
    return {
        key: {
            name: _mean([run[key][name] for run in runs])
            for name in runs[0][key]
            if all(name in run[key] for run in runs)
        }
        for key in runs[0]
        if key in shared
    }


def _mean(values: Sequence[Floats]) -> Floats:
    """Return the mean of values and replicates, (1 + B,) each.

    Runs of one seed draw their clusters from one stream: replicates are moved apart.
    """
    n_drawn = min(map(len, values)) - 1
    moved = [
        np.append(value[:1], np.roll(value[1 : n_drawn + 1], place * n_drawn // 7))
        for place, value in enumerate(values)
    ]
    return np.asarray(np.mean(moved, axis=0))


def lines(
    values: Readings, *, compared: str = COMPARED, rivals: Sequence[str] = RIVALS
) -> Iterator[str]:
    """Yield the lines of a table in Markdown: values and paired differences, in %."""
    heads = [*rivals, compared, *(f"less {name}" for name in rivals)]
    yield f"| robot, rise | after | {' | '.join(heads)} |"
    yield f"|:--|:--|{'--:|' * len(heads)}"
    order = [*dict.fromkeys(robot for robot, _, _ in values)]
    keys = sorted(values, key=lambda key: (order.index(key[0]), key[1]))
    for robot, target, reader in keys:
        by_name = values[robot, target, reader]
        own = by_name[compared]
        cells = [_text(by_name[name]) for name in (*rivals, compared)]
        for name in rivals:
            n_rows = min(len(own), len(by_name[name]))
            cells.append(_text(own[:n_rows] - by_name[name][:n_rows]))
        about = f"{_LABELS.get(robot, robot)}, +{100 * target:.0f}"
        yield f"| {about} | {_LABELS.get(reader, reader)} | {' | '.join(cells)} |"


def _text(values: Floats) -> str:
    """Return an estimate with its interval, in %; empty out of reach."""
    ends = with_ends(_ENDS, values[:, None], np.array([True]))
    value, low, high = (100.0 * ends[name][0] for name in _ENDS)
    if not np.isfinite(value):
        return ""
    interval = f" [{low:.1f}, {high:.1f}]" if np.isfinite(low) else ""
    return f"{value:.1f}{interval}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python scripts/shaped_against_ou.py",
        description="Compare shaped with ou where a robot misses as many conflicts.",
    )
    add = command.add_argument
    help_text = "a recording; repeatable (default: students03)"
    add("--dataset", metavar="NAME", action="append", help=help_text)
    add("--seed", metavar="N", type=int, default=0)
    add("--out", metavar="DIR", type=Path, required=True, help="folder of the runs")
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    names = options.dataset or ["students03"]
    runs = []
    for name in names:
        _compute(name, seed=options.seed, out=options.out / name)
        runs.append(read_run(options.out / name))
        print(f"\n{name}\n", *lines(runs[-1]), sep="\n", flush=True)
    if len(runs) > 1:
        print("\nmean\n", *lines(mean_readings(runs)), sep="\n")
    return DONE


def _compute(dataset: str, *, seed: int, out: Path) -> None:
    """Run all levels on a recording, or continue."""
    evaluation.run(
        preset="quick",
        dataset=dataset,
        seed=seed,
        mechanisms=mechanisms(),
        predictors=ROBOTS,
        attacks=["radial_rts", "ou_rts", "kinematic@radial_rts"],
        tasks=["handover-1s", "handover-5s"],
        policies=[],
        adversaries=["anchor", "repeats"],
        stages={"attacks.repeats": 3, "linkage.most_people": 300},
        out=out,
        pictures=False,
        walks=False,
    )


if __name__ == "__main__":
    sys.exit(main())
