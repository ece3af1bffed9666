"""Estimate what patrols cost and tell, from the counts of `patrol_runs.py`.

    python scripts/patrol_estimates.py runs/patrols --out docs/results

It writes `need-to-know.csv`, a row for each number with its interval, and
`need-to-know-matched.csv`, which compares policies with noise (`patrol_matching`).
`scripts/patrol_tables.py` turns both into tables.
"""

import argparse
import csv
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from patrol_matching import MATCHED_FIELDS, Option, compare_options
from patrol_names import MATCHED, MECHANISMS, NUMBERS

from attacks.following.followed import following_metrics
from attacks.following.logs import Following
from isac_track.command_line import DONE, Parser, exit_code
from isac_track.errors import DataError
from isac_track.intervals import Estimate
from isac_track.patrols.equal_alarms import AlarmCounts
from isac_track.patrols.estimators import ESTIMATORS
from isac_track.patrols.knowledge import Known
from isac_track.patrols.metrics import (
    SHARES,
    UtilityCounts,
    estimate_utility,
    knowledge_metrics,
)
from isac_track.policies.compared import COMPARED_POLICIES

SCAN_S: Final = 0.0836
FARTHEST: Final = 36  # Scans, 3 s: the horizon at which equal false alarms are shown.
_AT_EQUAL: Final = "missed_future_at_equal_false_alarms"
_LOG_METRICS: Final = (
    "disclosed_share",
    "people_seen",
    "known_share",
    "known_worst_tenth",
    "known_by_map",
)
_FOLLOWED_METRICS: Final = (
    "known_share",
    "followed_s",
    "followed_10s",
    "followed_30s",
    "time_to_confusion_s",
)
_ROBOT_METRICS: Final = (
    _AT_EQUAL,
    "missed_future_rate",
    "withheld_share",
    "missed_encounter_rate",
    "false_alarms_per_min",
)
"""Metrics that the tables show, and no more."""
_ADVERSARIES: Final = ("blind", "informed", "shuffled")
Array = np.ndarray[Any, np.dtype[Any]]
Record = TypeVar("Record", Known, Following, AlarmCounts)


@dataclass(frozen=True)
class Number:
    """A row of the table of numbers: a metric with its interval."""

    dataset: str
    robots: int  # Robots of a fleet.
    mechanism: str
    policy: str
    consumer: str  # A robot, or `log`.
    knowledge: str  # Of the adversary with the log; `oracle`: true identities.
    horizon_s: float | None
    metric: str
    value: float
    ci_low: float
    ci_high: float
    n: int
    note: str = ""


@dataclass(frozen=True)
class Counts:
    """Counts of a mechanism and a policy, as `patrol_runs.py` wrote them."""

    dataset: str
    arrays: dict[str, Array]

    @property
    def place(self) -> tuple[str, int, str, str]:
        """Recording, robots of a fleet, mechanism and policy."""
        names = (str(self.arrays[name]) for name in ("mechanism", "policy"))
        mechanism, policy = names
        return self.dataset, int(self.arrays["robots"]), mechanism, policy

    @property
    def group(self) -> tuple[str, ...]:
        """Cluster of each person."""
        return tuple(self.arrays["group"].tolist())

    @property
    def seed(self) -> int:
        """Base seed."""
        return int(self.arrays["seed"])

    @property
    def robots(self) -> list[str]:
        """Predictors whose misses were counted."""
        end = ".built_in"
        return [name[: -len(end)] for name in self.arrays if name.endswith(end)]

    def record(self, kind: type[Record], prefix: str) -> Record:
        """Return the record whose fields have a prefix."""
        values = {
            field.name: self.arrays[f"{prefix}.{field.name}"] for field in fields(kind)
        }
        return kind(**values)

    def horizons(self, robot: str) -> list[int]:
        """Return the horizons of a robot, in scans."""
        start, end = f"{robot}@", ".walked_s"
        return sorted(
            int(name[len(start) : -len(end)])
            for name in self.arrays
            if name.startswith(start) and name.endswith(end)
        )

    def utility(self, robot: str, horizon: int) -> UtilityCounts:
        """Return what a robot misses within a horizon."""
        place = f"{robot}@{horizon}"
        return UtilityCounts(
            hits={name: self.arrays[f"{place}.{name}.hits"] for name in SHARES},
            trials={name: self.arrays[f"{place}.{name}.trials"] for name in SHARES},
            false_alarms=self.arrays[f"{place}.false_alarms"],
            walked_s=float(self.arrays[f"{place}.walked_s"]),
            by_distance=self.record(AlarmCounts, f"{place}.by_distance"),
            allowed=self.arrays[f"{place}.allowed"],
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python scripts/patrol_estimates.py",
        description="Estimate what patrols cost and tell, from their counts.",
    )
    command.add_argument("counts", metavar="DIR", type=Path, help="of patrol_runs.py")
    command.add_argument("--out", metavar="DIR", type=Path, required=True)
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    paths = sorted(options.counts.glob("*/robots-*/*.npz"))
    if not paths:
        raise DataError(f"no counts in {options.counts}: run scripts/patrol_runs.py")
    loaded = [load_counts(path) for path in paths]
    _write(
        options.out / NUMBERS,
        [field.name for field in fields(Number)],
        (
            astuple(number)
            for counts in loaded
            if counts.place[2] in MECHANISMS and counts.place[3] in COMPARED_POLICIES
            for number in _numbers(counts)
        ),
    )
    matched = (
        row
        for dataset in dict.fromkeys(counts.dataset for counts in loaded)
        for row in compare_options(dataset, _options(dataset, loaded))
    )
    _write(options.out / MATCHED, MATCHED_FIELDS, map(astuple, matched))
    return DONE


def load_counts(path: Path) -> Counts:
    """Return the counts of a file."""
    with np.load(path) as file:
        return Counts(path.parent.parent.name, {name: file[name] for name in file})


def _write(path: Path, names: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table; numbers have four digits."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(names)
        for row in rows:
            table.writerow([_written(value) for value in row])


def _written(value: object) -> str:
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _numbers(counts: Counts) -> Iterator[Number]:
    """Yield all numbers of a mechanism and a policy."""
    known = counts.record(Known, "log")
    metrics = knowledge_metrics(known, group=counts.group, seed=counts.seed)
    for name in _LOG_METRICS:
        note = ESTIMATORS[known.best] if name == "known_share" else ""
        yield _number(counts, name, metrics[name], knowledge="oracle", note=note)
    for adversary in _ADVERSARIES:
        if f"{adversary}.known" not in counts.arrays:
            continue
        followed = following_metrics(
            counts.record(Following, adversary), group=counts.group, seed=counts.seed
        )
        for name in _FOLLOWED_METRICS:
            yield _number(counts, name, followed[name], knowledge=adversary)
    for robot in counts.robots:
        yield from _robot_numbers(counts, robot)


def _robot_numbers(counts: Counts, robot: str) -> Iterator[Number]:
    """Yield what a robot misses at each horizon."""
    is_built_in = bool(counts.arrays[f"{robot}.built_in"])
    for horizon in counts.horizons(robot):
        metrics = estimate_utility(
            counts.utility(robot, horizon), group=counts.group, seed=counts.seed
        )
        for name in _ROBOT_METRICS:
            if name == _AT_EQUAL and horizon != FARTHEST:
                continue
            estimate = metrics[name]
            is_noted = is_built_in and (name, estimate.value) == ("withheld_share", 0.0)
            yield _number(
                counts,
                name,
                estimate,
                consumer=robot,
                horizon_s=round(horizon * SCAN_S, 2),
                note="by construction" if is_noted else "",
            )


def _number(
    counts: Counts,
    metric: str,
    estimate: Estimate,
    *,
    consumer: str = "log",
    knowledge: str = "",
    horizon_s: float | None = None,
    note: str = "",
) -> Number:
    dataset, robots, mechanism, policy = counts.place
    return Number(
        dataset=dataset,
        robots=robots,
        mechanism=mechanism,
        policy=policy,
        consumer=consumer,
        knowledge=knowledge,
        horizon_s=horizon_s,
        metric=metric,
        value=estimate.value,
        ci_low=estimate.ci_low,
        ci_high=estimate.ci_high,
        n=estimate.n,
        note=note,
    )


def _options(dataset: str, loaded: Sequence[Counts]) -> list[Option]:
    """Return the options of a recording with fleets of a robot, and what they cost."""
    options = []
    for counts in loaded:
        _, robots, mechanism, policy = counts.place
        if (counts.dataset, robots) != (dataset, 1) or not counts.robots:
            continue
        if "blind.known" not in counts.arrays:
            continue
        known = counts.record(Known, "log")
        options.append(
            Option(
                mechanism=mechanism,
                policy=policy,
                group=counts.group,
                seed=counts.seed,
                instants=known.instants,
                known={
                    "true identities": known.known[known.best],
                    "own chains": counts.record(Following, "blind").known,
                },
                misses={
                    robot: counts.utility(robot, FARTHEST) for robot in counts.robots
                },
            )
        )
    return options


if __name__ == "__main__":
    sys.exit(main())
