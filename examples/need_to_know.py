"""Compare disclosure policies on patrols of robots through a recording.

    python examples/need_to_know.py --dataset plaza
    python examples/need_to_know.py --dataset students03 --policy ahead:1..2/3

The script prints how much a log discloses, how much an adversary knows from it, and how
long the adversary can follow people by it; then the conflicts that each robot misses.
Intervals are 95 % over people and routes. docs/explanation/need-to-know.md explains
every column.
"""

# ruff: noqa: T201 - a comparison is printed

import argparse
from dataclasses import dataclass

from attacks.following.followed import following_metrics
from attacks.following.logs import follow_fleets
from isac_track import datasets
from isac_track.config import StageSettings
from isac_track.errors import IsacTrackError
from isac_track.intervals import Estimate
from isac_track.patrols import horizon_scans, make_patrol
from isac_track.patrols.answers import Network, disclose, share_patrol
from isac_track.patrols.knowledge import ESTIMATORS, guesses_from_map, known_places
from isac_track.patrols.metrics import (
    RobotTask,
    is_by_construction,
    knowledge_metrics,
    robot_task,
    utility_metrics,
)
from isac_track.place import placed
from isac_track.plugins import Plugin, parse
from isac_track.policies.samples import Everything
from isac_track.sharing import Raw
from predictors.kalman import KalmanCV

POLICIES = (
    "everything",
    "window:1.3",
    "window:4",
    "near:4.5",
    "near:3.5",
    "ahead:2",
    "ahead:1.2",
    "ahead:2,window_s=4,horizon_s=4.1",
    "state",
    "state:2",
    "flag",
    "random:0.2",
)
MECHANISMS, PREDICTORS = ("raw", "fid:1"), ("least_squares", "kalman_cv")
KNOWLEDGE = (
    "disclosed_share",
    "known_share",
    "known_worst_tenth",
    "known_undisclosed",
    "people_seen",
    "plr_walk",
)
UTILITY = (
    "missed_conflict_rate",
    "missed_future_rate",
    "missed_future_at_equal_alarms",
    "missed_encounter_rate",
    "withheld_share",
    "false_alarms_per_min",
)
FOLLOWED = (
    "known_share",
    "followed_s",
    "followed_ceiling_s",
    "followed_90_s",
    "followed_10s",
    "followed_30s",
    "time_to_confusion_s",
    "confident_wrong_share",
)
NO_SHARES = (
    "false_alarms_per_min",
    "followed_s",
    "followed_ceiling_s",
    "followed_90_s",
    "time_to_confusion_s",
)
ADVERSARIES = ("blind", "informed", "shuffled")
"""Blind; knowing routes, times and the policy; the control of shuffled first states."""


@dataclass(frozen=True)
class Row:
    """Metrics of a policy with a mechanism: of a robot at a horizon, or of a log."""

    mechanism: str
    policy: str
    metrics: dict[str, Estimate]
    predictor: str = ""
    horizon_s: float = 0.0
    adversary: str = ""  # The adversary who follows people by the log.
    # Estimator of the adversary, or a remark that `withheld_share` is by construction.
    note: str = ""


@dataclass(frozen=True)
class Sharing:
    """A network with a mechanism, and the task of each robot on it."""

    network: Network
    tasks: dict[str, RobotTask]


def share_with_tasks(patrol, mechanism, predictors, *, settings, seed, reference=None):
    """Share a patrol with a mechanism, and set up the task of each robot.

    `reference` are the tasks at whose false alarms the robots are compared.
    """
    network = share_patrol(
        patrol, mechanism=mechanism, forecaster=KalmanCV(), settings=settings, seed=seed
    )
    everything = disclose(network, Everything())
    tasks = {
        predictor.spec: robot_task(
            network,
            everything,
            predictor=predictor.instance,
            settings=settings,
            reference=reference[predictor.spec] if reference else None,
        )
        for predictor in predictors
    }
    return Sharing(network, tasks)


def compare(tracks, *, mechanisms, policies, predictors, adversaries, settings, seed):
    """Yield the rows of a recording: of the log, of each adversary, of each robot."""
    patrol = make_patrol(
        placed(tracks, settings=settings), settings=settings, seed=seed
    )
    guesses = guesses_from_map(patrol, epsilon_m=settings.privacy.epsilon_m)
    reference = share_with_tasks(
        patrol, Raw(), predictors, settings=settings, seed=seed
    )
    for mechanism in mechanisms:
        sharing = share_with_tasks(
            patrol,
            mechanism.instance,
            predictors,
            settings=settings,
            seed=seed,
            reference=reference.tasks,
        )
        network, tasks = sharing.network, sharing.tasks
        for policy in policies:
            disclosure = disclose(network, policy.instance, name=policy.spec)
            known = known_places(
                network,
                disclosure,
                guesses=guesses,
                epsilon_m=settings.privacy.epsilon_m,
            )
            yield Row(
                mechanism.spec,
                policy.spec,
                knowledge_metrics(known, group=patrol.people.group, seed=seed),
                note=ESTIMATORS[known.best],
            )
            for adversary in adversaries:
                following = follow_fleets(
                    network,
                    disclosure,
                    estimator=ESTIMATORS[known.best],
                    guesses=guesses,
                    epsilon_m=settings.privacy.epsilon_m,
                    seed=seed,
                    knows_policy=policy.instance if adversary == "informed" else None,
                    shuffled=adversary == "shuffled",
                )
                yield Row(
                    mechanism.spec,
                    policy.spec,
                    following_metrics(following, group=patrol.people.group, seed=seed),
                    adversary=adversary,
                    note=adversary,
                )
            for predictor, task in tasks.items():
                is_built_in = is_by_construction(
                    network, policy.instance, task.predictor
                )
                for horizon in horizon_scans(settings):
                    yield Row(
                        mechanism.spec,
                        policy.spec,
                        utility_metrics(task, disclosure, horizon=horizon, seed=seed),
                        predictor=predictor,
                        horizon_s=horizon * settings.patrol.scan_s,
                        note="by construction" if is_built_in else "",
                    )


def written(name, estimate):
    """Format a number and its interval, as percent unless it is a time or a rate."""
    scale, digits = (1.0, 2) if name in NO_SHARES else (100.0, 1)
    value, low, high = (
        f"{scale * number:.{digits}f}"
        for number in (estimate.value, estimate.ci_low, estimate.ci_high)
    )
    return value if low == "nan" else f"{value} [{low}, {high}]"


def table(rows, names, *, note):
    """Return the lines of a markdown table."""
    heads = ["mechanism", "policy", *names, note]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in rows:
        numbers = [written(name, row.metrics[name]) for name in names]
        lines.append(
            "| " + " | ".join([row.mechanism, row.policy, *numbers, row.note]) + " |"
        )
    return lines


def report(rows, *, settings):
    """Yield the lines of all tables."""
    epsilon_m = settings.privacy.epsilon_m
    logs = [row for row in rows if not row.predictor and not row.adversary]
    by_map = written("known_by_map", logs[0].metrics["known_by_map"])
    n = logs[0].metrics["known_share"].n
    yield (
        "Log of a fleet, in % of person-time (people_seen, plr_walk: of people; n ="
        f" {n})."
    )
    yield (
        f"Known: within {epsilon_m:g} m, true identities. Known by the map alone:"
        f" {by_map} %."
    )
    yield ""
    yield from table(logs, KNOWLEDGE, note="estimator")
    if followed_rows := [row for row in rows if row.adversary]:
        yield ""
        yield (
            "Followed by the log alone: no identities, pseudonyms fresh in every"
            " answer."
        )
        yield ""
        yield from table(followed_rows, FOLLOWED, note="adversary")
    tasks = dict.fromkeys(
        (row.predictor, row.horizon_s) for row in rows if row.predictor
    )
    for predictor, horizon_s in tasks:
        robot_rows = [
            row
            for row in rows
            if (row.predictor, row.horizon_s) == (predictor, horizon_s)
        ]
        n = robot_rows[0].metrics["missed_future_rate"].n
        yield ""
        yield (
            f"Robot {predictor}, horizon {horizon_s:.2f} s, in % (n = {n} clusters of"
            " people)."
        )
        yield ""
        yield from table(robot_rows, UTILITY, note="note")


def options(words):
    parser = argparse.ArgumentParser(
        description=(
            "What robots need to know: disclosure policies compared on patrols through"
            " a recording."
        )
    )
    parser.add_argument("--dataset", default="plaza")
    parser.add_argument("--seed", type=int, default=0)
    for name, usual in (
        ("mechanism", MECHANISMS),
        ("policy", POLICIES),
        ("predictor", PREDICTORS),
    ):
        parser.add_argument(
            f"--{name}", action="append", metavar="SPEC", help=" ".join(usual)
        )
    about = (
        f"who follows people by the log: {' '.join(ADVERSARIES)} (default: blind), or"
        " none"
    )
    parser.add_argument(
        "--adversary", action="append", choices=[*ADVERSARIES, "none"], help=about
    )
    parser.add_argument("--set", action="append", default=[], metavar="STAGE.KEY=VALUE")
    return parser.parse_args(words)


def plugins_named(kind, specs) -> list[Plugin]:
    return [plugin for spec in specs for plugin in parse(kind, spec)]


def main(words=None):
    given = options(words)
    try:
        changes = dict(change.partition("=")[::2] for change in given.set)
        settings = StageSettings().changed(changes)
        dataset = datasets.load(given.dataset)
        rows = list(
            compare(
                dataset.tracks,
                mechanisms=plugins_named("mechanisms", given.mechanism or MECHANISMS),
                policies=plugins_named("policies", given.policy or POLICIES),
                predictors=plugins_named("predictors", given.predictor or PREDICTORS),
                adversaries=[
                    name for name in given.adversary or ["blind"] if name != "none"
                ],
                settings=settings,
                seed=given.seed,
            )
        )
    except IsacTrackError as error:
        raise SystemExit(f"error: {error}") from None
    patrol = settings.patrol
    print(f"{dataset.name}: {patrol.fleets} fleets of {patrol.robots} robot(s)")
    print("\n".join(report(rows, settings=settings)))


if __name__ == "__main__":
    main()
