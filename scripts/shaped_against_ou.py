"""Compare `shaped` with `ou` where a robot misses as many conflicts.

    python scripts/shaped_against_ou.py --dataset students03 --out runs/shaped-students03

It runs both at levels about +3 and +10 points of missed future conflicts, and prints
what the strongest attack knows there, and whom the strongest linker links. Attacks are
chosen on one half of the people and scored on the other. Differences are paired by
person. A second call with the same folder continues the run, or reads it.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

import evaluation
from evaluation.api.estimated import (
    SceneEstimates,
    compare_attacks,
    link_estimates,
    scene_estimates,
)
from evaluation.estimates.families import entry_families
from evaluation.estimates.frontier import Quantity, frontier_quantities
from evaluation.estimates.keys import judged_at
from evaluation.estimates.matching import (
    CRITERIA,
    FUTURE,
    Places,
    Sweeps,
    interpolated,
    places,
    with_ends,
)
from evaluation.estimates.metrics import DESCRIPTORS
from evaluation.plan.address import parse_consumer
from evaluation.store.manifest import read_manifest
from isac_track.command_line import DONE, Parser, exit_code
from isac_track.types import Floats

SHAPED: Final = (0.07, 0.075, 0.08, 0.085, 0.09, 0.1, 0.11, 0.12, 0.13, 0.145, 0.16)
OU: Final = (0.08, 0.11, 0.14, 0.17, 0.2, 0.23, 0.27, 0.32)
TIMES_S: Final = (5, 15)
ROBOTS: Final = ("kalman_cv", "kalman_cv:aware=true")
TARGETS: Final = (0.03, 0.1)  # Rises of missed future conflicts over raw.
HORIZON_S: Final = 3.0
COMPARED: Final = "shaped"
_ENDS: Final = ("value", "ci_low", "ci_high")


def mechanisms() -> list[str]:
    """Return the SPECs of all levels."""
    shaped = [f"shaped:{floor:g}" for floor in SHAPED]
    slow = [f"ou:{std:g},tau_s={time:g}" for time in TIMES_S for std in OU]
    return ["raw", *shaped, *slow]


@dataclass(frozen=True, eq=False, slots=True)
class Curves:
    """A run's curves over levels, and where each robot's misses rise by `TARGETS`."""

    sweeps: Sweeps
    quantities: Sequence[Quantity]  # PLR after attack, and rank 1 of linkers.
    price: str = CRITERIA[FUTURE]  # What rises by `TARGETS`.

    def reached(self, robot: str) -> dict[str, Places]:
        """Return the place of every target on the curve of each mechanism."""
        price = parse_consumer(robot).measured(self.price)
        costs = self.sweeps.together(dict.fromkeys(self.sweeps.families, price))
        targets = np.array(TARGETS)
        return {
            name: places(targets, np.abs(curve - curve[:, -1:]))
            for name, curve in costs.items()
        }

    def at_targets(
        self, quantity: Quantity, reached: dict[str, Places]
    ) -> dict[str, Floats]:
        """Return a quantity of each mechanism at the targets, (1 + B, P)."""
        curves = self.sweeps.together(
            {
                name: source.measured(quantity.metric)
                for name, source in quantity.source_by_mechanism.items()
            }
        )
        is_log = quantity.metric in DESCRIPTORS
        return {
            name: interpolated(reached[name], curve, log=is_log)
            for name, curve in curves.items()
            if name in reached
        }


def read_curves(out: Path) -> Curves:
    """Return the curves of a finished run; DataError if a cell cannot be read."""
    manifest = read_manifest(out)
    families = entry_families(manifest["cells"])
    scenes: SceneEstimates = scene_estimates(out, manifest)
    compared = compare_attacks(scenes, link_estimates(out, manifest), families)
    quantities, crossed = frontier_quantities(compared.sweeps, compared.by_mechanism)
    estimates = {**compared.sweeps.estimates, **crossed}
    at_horizon = judged_at(estimates, scenes.later[HORIZON_S].all_estimates)
    axes = [quantity for quantity in quantities if quantity.is_axis]
    return Curves(Sweeps(at_horizon, families), axes)


def lines(
    curves: Curves,
    *,
    compared: str = COMPARED,
    rivals: Sequence[str],
    robots: Sequence[str] = ROBOTS,
) -> Iterator[str]:
    """Yield the lines of a table in Markdown: values and paired differences in %.

    Each robot and rise has a line for each adversary and linkage task. There are the
    values of the rivals and of the mechanism `compared`, then its value less theirs.
    """
    heads = [*rivals, compared, *(f"less {name}" for name in rivals)]
    yield f"| robot, rise | after | {' | '.join(heads)} |"
    yield f"|:--|:--|{'--:|' * len(heads)}"
    for robot in robots:
        reached = curves.reached(robot)
        for place, target in enumerate(TARGETS):
            for quantity in curves.quantities:
                left = curves.at_targets(quantity, reached)
                values = [left[name] for name in (*rivals, compared)]
                gaps = [_difference(left[compared], left[name]) for name in rivals]
                cells = [_text(value, place) for value in [*values, *gaps]]
                source = quantity.source_by_mechanism[compared]
                about = f"{robot}, +{100 * target:.0f}"
                reader = source.task or source.adversary
                yield f"| {about} | {reader} | {' | '.join(cells)} |"


def _difference(first: Floats, second: Floats) -> Floats:
    n_rows = min(len(first), len(second))
    return first[:n_rows] - second[:n_rows]


def _text(values: Floats, place: int) -> str:
    """Return an estimate with its interval, in %; empty out of reach."""
    ends = with_ends(_ENDS, values, np.ones(values.shape[1], dtype=bool))
    value, low, high = (100.0 * ends[name][place] for name in _ENDS)
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
    add("--dataset", metavar="NAME|PATH", default="students03")
    add("--seed", metavar="N", type=int, default=0)
    add("--out", metavar="DIR", type=Path, required=True, help="folder of the run")
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    evaluation.run(
        preset="quick",
        dataset=options.dataset,
        seed=options.seed,
        mechanisms=mechanisms(),
        predictors=ROBOTS,
        attacks=["radial_rts", "ou_rts", "kinematic@radial_rts"],
        tasks=["handover-1s", "handover-5s"],
        policies=[],
        adversaries=["anchor", "repeats"],
        stages={"attacks.repeats": 3, "linkage.most_people": 300},
        out=options.out,
        pictures=False,
        walks=False,
    )
    curves = read_curves(options.out)
    rivals = [name for name in curves.sweeps.families if name.startswith("ou")]
    print(*lines(curves, rivals=rivals), sep="\n")
    return DONE


if __name__ == "__main__":
    sys.exit(main())
