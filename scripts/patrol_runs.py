"""Count what robots on patrol miss and what their logs tell: `--help` has the options.

    python scripts/patrol_runs.py --dataset students03 --out runs/patrols
    python scripts/patrol_runs.py --dataset students03 --robots 10 --robot none \
        --policy near:3.5 --policy ahead:1.2 --mechanism raw --out runs/patrols

Each mechanism and policy leaves one file of counts by person and route. A second run
continues. `scripts/patrol_tables.py` turns the files into tables.
"""

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np
from patrol_names import MECHANISMS, ROBOTS
from threadpoolctl import threadpool_limits

from attacks.following.logs import Following, follow_fleets
from isac_track import datasets
from isac_track.command_line import DONE, Parser, exit_code
from isac_track.config import StageSettings
from isac_track.errors import SettingsError
from isac_track.patrols import horizon_scans, make_patrol
from isac_track.patrols.answers import Disclosure, disclose
from isac_track.patrols.equal_alarms import AlarmCounts
from isac_track.patrols.estimators import ESTIMATORS
from isac_track.patrols.knowledge import Known, guesses_from_map, known_places
from isac_track.patrols.metrics import (
    RobotTask,
    count_utility,
    foresee,
    is_by_construction,
    robot_task,
)
from isac_track.patrols.network import Network, sense_patrol, share_sensed
from isac_track.place import placed
from isac_track.plugins import Plugin, parse
from isac_track.policies.samples import Everything
from isac_track.protocols import Policy
from isac_track.types import Tracks
from predictors.kalman import KalmanCV

POLICIES: Final = (
    "everything",
    "window:1.3",
    "near:4.5",
    "near:3.5",
    "ahead:2",
    "ahead:1.2",
    "state:2",
    "flag",
    "random:0.2",
)
Array = np.ndarray[Any, np.dtype[Any]]


@dataclass(frozen=True)
class Job:
    """Options of a call that change no count of a mechanism and a policy."""

    settings: StageSettings
    seed: int
    robots: Sequence[Plugin]
    adversaries: Sequence[str]  # Who follows people by the log.
    out: Path


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python scripts/patrol_runs.py",
        description="Count what robots on patrol miss, and what their logs tell.",
    )
    add = command.add_argument
    add("--dataset", metavar="NAME|PATH", default="students03")
    add("--robots", metavar="N", type=int, default=1, help="robots of a fleet")
    add("--fleets", metavar="N", type=int, default=20, help="fleets (default: 20)")
    add("--segment", metavar="S", type=float, default=300.0, help="s that are walked")
    add("--seed", metavar="N", type=int, default=0, help="base seed (default: 0)")
    for name, default in (
        ("policy", POLICIES),
        ("mechanism", MECHANISMS),
        ("robot", ROBOTS),
    ):
        help_text = f"repeatable, none: without; default: {' '.join(default)}"
        add(f"--{name}", metavar="SPEC", action="append", help=help_text)
    add(
        "--adversary",
        action="append",
        choices=["blind", "informed", "shuffled", "none"],
        help="who follows people by the log; repeatable (default: blind)",
    )
    add("--out", metavar="DIR", type=Path, required=True, help="folder of the counts")
    # Threads of a small fit's linear algebra take twice the time.
    with threadpool_limits(limits=1, user_api="blas"):
        return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    settings = StageSettings().changed(
        {
            "patrol.robots": options.robots,
            "patrol.fleets": options.fleets,
            "patrol.segment_s": options.segment,
        }
    )
    dataset = datasets.load(options.dataset)
    out = options.out / dataset.name / f"robots-{options.robots}"
    if options.seed:
        out = out.with_name(f"{out.name}-seed-{options.seed}")
    job = Job(
        settings=settings,
        seed=options.seed,
        robots=_plugins("predictors", options.robot or tuple(ROBOTS)),
        adversaries=_named(options.adversary or ["blind"]),
        out=out,
    )
    mechanisms = _plugins("mechanisms", options.mechanism or MECHANISMS)
    policies = _plugins("policies", options.policy or POLICIES)
    if not mechanisms or not policies:
        raise SettingsError("--mechanism and --policy need a SPEC each")
    for line in _count(dataset.tracks, mechanisms, policies, job=job):
        print(line, flush=True)
    return DONE


def _named(names: Sequence[str]) -> list[str]:
    return [name for name in names if name != "none"]


def _plugins(kind: str, specs: Sequence[str]) -> list[Plugin]:
    return [plugin for spec in _named(specs) for plugin in parse(kind, spec)]


def _count(
    tracks: Tracks,
    mechanisms: Sequence[Plugin],
    policies: Sequence[Plugin],
    *,
    job: Job,
) -> Iterator[str]:
    """Yield a line for each file of counts that is written."""
    pairs = {
        mechanism.spec: [
            policy
            for policy in policies
            if not file_of(job.out, mechanism.spec, policy.spec).exists()
        ]
        for mechanism in mechanisms
    }
    if not any(pairs.values()):
        return
    job.out.mkdir(parents=True, exist_ok=True)
    settings, seed = job.settings, job.seed
    recorded = placed(tracks, settings=settings)
    patrol = make_patrol(recorded, settings=settings, seed=seed)
    sensed = sense_patrol(patrol, forecaster=KalmanCV(), settings=settings, seed=seed)
    guesses = guesses_from_map(patrol, epsilon_m=settings.privacy.epsilon_m)
    raw = share_sensed(sensed, mechanism=parse("mechanisms", "raw")[0].instance)
    # Robots without noise, at whose false alarms all others are compared.
    reference = _tasks(raw, [None] * len(job.robots), job=job)
    on_raw: dict[str, Disclosure] = {}  # Answers that no mechanism changes.
    for mechanism in mechanisms:
        missing = pairs[mechanism.spec]
        if not missing:
            continue
        network = share_sensed(sensed, mechanism=mechanism.instance)
        tasks = _tasks(network, reference, job=job)
        for policy in missing:
            disclosure = _disclose(network, raw, policy, on_raw)
            counts = _log_counts(network, disclosure, policy.instance, guesses, job=job)
            for robot, task in zip(job.robots, tasks, strict=True):
                counts |= _robot_counts(
                    task, disclosure, policy.instance, name=robot.spec
                )
            counts |= _about(network, mechanism, policy, job=job)
            path = file_of(job.out, mechanism.spec, policy.spec)
            part = path.with_suffix(".part")
            with part.open("wb") as file:
                np.savez_compressed(file, **counts)
            part.rename(path)
            yield f"{path.parent.parent.name} {path.parent.name} {path.stem}"


def _tasks(
    network: Network, reference: Sequence[RobotTask | None], *, job: Job
) -> list[RobotTask]:
    """Return the task of each robot, beside its reference."""
    everything = disclose(network, Everything())
    return [
        robot_task(
            network,
            everything,
            predictor=robot.instance,
            settings=job.settings,
            reference=beside,
        )
        for robot, beside in zip(job.robots, reference, strict=True)
    ]


def file_of(out: Path, mechanism: str, policy: str) -> Path:
    """Return the file of a mechanism and a policy."""
    return out / f"{mechanism}__{policy}.npz".replace(":", "=")


def _disclose(
    network: Network, raw: Network, policy: Plugin, on_raw: dict[str, Disclosure]
) -> Disclosure:
    """Return the answers of a policy; those that rest on raw are made once."""
    if getattr(policy.instance, "select_on", "raw") == "shared":
        return disclose(network, policy.instance, name=policy.spec)
    if policy.spec not in on_raw:
        on_raw[policy.spec] = disclose(raw, policy.instance, name=policy.spec)
    return on_raw[policy.spec]


def _about(
    network: Network, mechanism: Plugin, policy: Plugin, *, job: Job
) -> dict[str, Array]:
    """Return names, clusters and settings."""
    patrol = network.patrol
    return {
        "mechanism": np.array(mechanism.spec),
        "policy": np.array(policy.spec),
        "group": np.array(patrol.people.group),
        "robots": np.array(patrol.robots_per_fleet),
        "seed": np.array(job.seed),
        "duration_s": np.array(patrol.duration_s),
    }


def _log_counts(
    network: Network,
    disclosure: Disclosure,
    policy: Policy,
    guesses: Array,
    *,
    job: Job,
) -> dict[str, Array]:
    """Return what the logs of fleets tell, by `log.FIELD` and `ADVERSARY.FIELD`."""
    epsilon_m = job.settings.privacy.epsilon_m
    known = known_places(network, disclosure, guesses=guesses, epsilon_m=epsilon_m)
    counts = _arrays("log", known)
    for adversary in job.adversaries:
        following = follow_fleets(
            network,
            disclosure,
            estimator=ESTIMATORS[known.best],
            guesses=guesses,
            epsilon_m=epsilon_m,
            seed=job.seed,
            knows_policy=policy if adversary == "informed" else None,
            shuffled=adversary == "shuffled",
        )
        counts |= _arrays(adversary, following)
    return counts


def _robot_counts(
    task: RobotTask, disclosure: Disclosure, policy: Policy, *, name: str
) -> dict[str, Array]:
    """Return what a robot misses, by `ROBOT@HORIZON.FIELD`, horizons in scans."""
    foreseen = foresee(task, disclosure)
    built_in = is_by_construction(task.network, policy, task.predictor)
    counts: dict[str, Array] = {f"{name}.built_in": np.array(built_in)}
    for horizon in horizon_scans(task.settings):
        utility = count_utility(task, foreseen, horizon=horizon)
        place = f"{name}@{horizon}"
        for metric in utility.hits:
            counts[f"{place}.{metric}.hits"] = utility.hits[metric].astype(np.int32)
            counts[f"{place}.{metric}.trials"] = utility.trials[metric].astype(np.int32)
        counts[f"{place}.false_alarms"] = utility.false_alarms
        counts[f"{place}.walked_s"] = np.array(utility.walked_s)
        counts[f"{place}.allowed"] = utility.allowed
        counts |= _arrays(f"{place}.by_distance", utility.by_distance)
    return counts


def _arrays(prefix: str, record: Known | Following | AlarmCounts) -> dict[str, Array]:
    """Return the fields of a record of arrays, whole numbers in four bytes."""
    values: Mapping[str, Array] = {
        field.name: np.asarray(getattr(record, field.name)) for field in fields(record)
    }
    return {
        f"{prefix}.{name}": value.astype(np.int32) if value.dtype.kind == "i" else value
        for name, value in values.items()
    }


if __name__ == "__main__":
    sys.exit(main())
