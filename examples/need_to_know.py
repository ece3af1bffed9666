"""Compare disclosure policies on patrols of robots through a recording.

    python examples/need_to_know.py --dataset plaza
    python examples/need_to_know.py --dataset students03 --policy ahead:1..2/3
    python examples/need_to_know.py --dataset students03 --posterior 50
    python examples/need_to_know.py --dataset students03 --probing 50

The script prints how much a log discloses, how much an adversary knows from it, and how
long the adversary can follow people by it; then the conflicts that each robot misses.
Intervals are 95 % over people and routes. docs/explanation/need-to-know.md explains
every column. With `--posterior` or `--probing` the script prints the tables of these
adversaries on so many people instead.
"""

# ruff: noqa: T201 - a comparison is printed

import argparse
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from attacks.following.answer_evidence import flag_answers, sent_answers
from attacks.following.experts import PosteriorOptions
from attacks.following.followed import following_metrics
from attacks.following.logs import follow_fleets
from attacks.following.posterior import choose_targets, posterior_scores
from attacks.following.posterior_metrics import posterior_metrics, reliability_table
from attacks.following.probing import (
    ProbingOptions,
    Rules,
    choose_probed,
    probe_targets,
    probing_metrics,
)
from isac_track import datasets
from isac_track.config import StageSettings
from isac_track.errors import IsacTrackError, SettingsError
from isac_track.intervals import Estimate
from isac_track.patrols import horizon_scans, make_patrol
from isac_track.patrols.answers import disclose
from isac_track.patrols.estimators import ESTIMATORS
from isac_track.patrols.intervals import cluster_numbers, sum_clusters, two_way_ratio
from isac_track.patrols.knowledge import guesses_from_map, known_places
from isac_track.patrols.metrics import (
    RobotTask,
    is_by_construction,
    knowledge_metrics,
    robot_task,
    utility_metrics,
)
from isac_track.patrols.network import Network, share_patrol
from isac_track.patrols.refusals import refused_conflicts, refused_queries
from isac_track.place import placed
from isac_track.plugins import Plugin, parse
from isac_track.policies.compared import COMPARED_POLICIES
from isac_track.policies.samples import Everything
from isac_track.sharing import Raw
from predictors.kalman import KalmanCV

POSTERIOR_POLICIES = ("everything", "near:3.5", "ahead:1.2", "flag")
PROBED_POLICIES = ("ahead:1.2", "flag")
PROBE_RATES = (0.0, 1.0, 3.0, 10.0, 30.0, 100.0)  # Per second.
COMMITMENT_S, LIMIT_PER_S = 3.0, 1.0
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
    "missed_future_at_equal_false_alarms",
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
                    metrics = utility_metrics(
                        task, disclosure, horizon=horizon, seed=seed
                    )
                    is_zero = not metrics["withheld_share"].value > 0.0
                    yield Row(
                        mechanism.spec,
                        policy.spec,
                        metrics,
                        predictor=predictor,
                        horizon_s=horizon * settings.patrol.scan_s,
                        note="by construction" if is_built_in and is_zero else "",
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


def group_names(patrol, people):
    return tuple(patrol.people.group[row] for row in people.tolist())


def posterior_report(tracks, *, mechanisms, policies, n_people, settings, seed):
    """Yield the lines of the tables of the posterior adversary."""
    patrol = make_patrol(
        placed(tracks, settings=settings), settings=settings, seed=seed
    )
    epsilon_m = settings.privacy.epsilon_m
    targets = choose_targets(patrol.people.group, n_people=n_people, seed=seed)
    scoring = {
        "group": group_names(patrol, targets),
        "n_fleets": patrol.n_fleets,
        "seed": seed,
    }
    guesses = guesses_from_map(patrol, epsilon_m=epsilon_m)
    reliability = []
    yield (
        f"Posterior adversary on {targets.size} people, true identities. Log score:"
        " nats per person-instant above the map. Shares in %."
    )
    yield ""
    yield (
        "| mechanism | policy | adversary | log score | claimed | known |"
        " known, best estimator | known, own chains |"
    )
    yield "|" + "---|" * 8
    for mechanism in mechanisms:
        network = share_patrol(
            patrol,
            mechanism=mechanism.instance,
            forecaster=KalmanCV(),
            settings=settings,
            seed=seed,
        )
        for policy in policies:
            disclosure = disclose(network, policy.instance, name=policy.spec)
            rivals = rival_shares(
                network, disclosure, guesses, targets, epsilon_m=epsilon_m, seed=seed
            )
            for kind, scores in posterior_rows(
                network, disclosure, policy, targets, settings=settings, seed=seed
            ):
                metrics = posterior_metrics(scores, **scoring)
                score = metrics["log_score"]
                cells = [
                    mechanism.spec,
                    policy.spec,
                    kind,
                    f"{score.value:.2f} [{score.ci_low:.2f}, {score.ci_high:.2f}]",
                    written("claimed_share", metrics["claimed_share"]),
                    written("known_share", metrics["known_share"]),
                    *(written("known_share", rival) for rival in rivals),
                ]
                yield "| " + " | ".join(cells) + " |"
                table = reliability_table(scores, **scoring)
                reliability.append((mechanism.spec, policy.spec, kind, table))
    yield ""
    yield "Stated probability of the best place, and how often it comes true, in %."
    yield ""
    yield (
        "| mechanism | policy | adversary | stated | share of instants | mean stated |"
        " known |"
    )
    yield "|" + "---|" * 7
    for *names, table in reliability:
        for row in table:
            if row.share > 0.0:
                stated = f"{100 * row.low:.0f} to {100 * row.high:.0f}"
                numbers = f"{100 * row.share:.1f} | {100 * row.claimed:.1f}"
                known = written("known_share", row.known)
                yield f"| {' | '.join(names)} | {stated} | {numbers} | {known} |"


def posterior_rows(network, disclosure, policy, targets, *, settings, seed):
    """Yield the scores of each posterior adversary on a policy, by name."""
    shared = {
        "targets": targets,
        "epsilon_m": settings.privacy.epsilon_m,
        "options": PosteriorOptions(),
        "seed": seed,
    }
    if disclosure.form == "flag":
        for kind, is_named in (("informed", False), ("learns whose flag", True)):
            answers = flag_answers(
                network,
                disclosure,
                predictor=KalmanCV(),
                safety_radius_m=settings.conflict.safety_radius_m,
                horizon=horizon_scans(settings)[-1],
                is_named=is_named,
            )
            yield (
                kind,
                posterior_scores(network, disclosure, answers=answers, **shared)[1],
            )
        return
    answers = sent_answers(network, disclosure, policy.instance)
    scores = posterior_scores(network, disclosure, answers=answers, **shared)
    yield from zip(("blind", "informed"), scores, strict=True)


def rival_shares(network, disclosure, guesses, targets, *, epsilon_m, seed):
    """Return what the other adversaries know of the same people: shares."""
    patrol = network.patrol
    known = known_places(network, disclosure, guesses=guesses, epsilon_m=epsilon_m)
    following = follow_fleets(
        network,
        disclosure,
        estimator=ESTIMATORS[known.best],
        guesses=guesses,
        epsilon_m=epsilon_m,
        seed=seed,
    )
    cluster = cluster_numbers(group_names(patrol, targets))
    instants = known.instants[targets, None] * np.ones((1, patrol.n_fleets))
    return [
        two_way_ratio(
            numerator=sum_clusters(counts[targets], cluster),
            denominator=sum_clusters(instants, cluster),
            seed=seed,
        )
        for counts in (known.known[known.best], following.known)
    ]


def probing_report(tracks, *, policies, n_people, rates, settings, seed):
    """Yield the lines of the tables of probing, and of its countermeasures."""
    recorded = placed(tracks, settings=settings)
    scans = {"patrol.query_s": settings.patrol.scan_s, "patrol.fleets": 1}
    patrol = make_patrol(recorded, settings=settings.changed(scans), seed=seed)
    network = share_patrol(
        patrol, mechanism=Raw(), forecaster=KalmanCV(), settings=settings, seed=seed
    )
    targets = choose_probed(patrol, n_people=n_people, seed=seed)
    yield (
        f"Probing {targets.size} people for up to 30 s, raw samples. Known and claimed"
        " in %."
    )
    yield ""
    yield "| policy | rules | probes / s | answered / s | known | claimed |"
    yield "|" + "---|" * 6
    all_rules = {"none": Rules(), "commitment": Rules(commitment_s=COMMITMENT_S)}
    all_rules["limit"] = Rules(limit_per_s=LIMIT_PER_S)
    for policy in policies:
        for name, rules in all_rules.items():
            # With a limit all rates above it are the same.
            tried = rates if rules.limit_per_s is None else [max(rates)]
            for rate in tried:
                probed = probe_targets(
                    network,
                    policy.instance,
                    targets=targets,
                    probes_per_s=rate,
                    rules=rules,
                    safety_radius_m=settings.conflict.safety_radius_m,
                    epsilon_m=settings.privacy.epsilon_m,
                    options=ProbingOptions(),
                    seed=seed,
                )
                metrics = probing_metrics(
                    probed, group=group_names(patrol, targets), seed=seed
                )
                answered = 10.0 * probed.answered.sum() / probed.instants.sum()
                numbers = [written(key, value) for key, value in metrics.items()]
                yield (
                    f"| {policy.spec} | {name} | {rate:g} | {answered:.1f} |"
                    f" {' | '.join(numbers)} |"
                )
    yield ""
    yield from commitment_cost(recorded, settings=settings, seed=seed)


def commitment_cost(recorded, *, settings, seed):
    """Yield what a commitment costs robots that change their route at an alarm."""
    patrol = make_patrol(recorded, settings=settings, seed=seed)
    network = share_patrol(
        patrol, mechanism=Raw(), forecaster=KalmanCV(), settings=settings, seed=seed
    )
    task = robot_task(
        network,
        disclose(network, Everything()),
        predictor=KalmanCV(),
        settings=settings,
    )
    horizon = horizon_scans(settings)[-1]
    refused = refused_queries(
        patrol, task.everything, horizon=horizon, commitment_s=COMMITMENT_S
    )
    lost = refused_conflicts(
        patrol, task.actual, task.everything, refused, horizon=horizon
    )
    cluster = cluster_numbers(patrol.people.group)[patrol.presences.person]
    share = two_way_ratio(
        numerator=sum_clusters(lost.hits & lost.trials, cluster),
        denominator=sum_clusters(lost.trials, cluster),
        seed=seed,
    )
    yield (
        f"Robots on patrol that change their route at every alarm: a commitment of"
        f" {COMMITMENT_S:g} s refuses {100 * refused.mean():.1f} % of their queries, and"
        f" withholds {written('share', share)} % of the conflicts that they foresee."
    )
    excess = max(0.0, 1.0 - LIMIT_PER_S * settings.patrol.query_s)
    yield (
        f"A limit of {LIMIT_PER_S:g} answer(s) per second refuses {100 * excess:.0f} %"
        f" of the queries of robots that ask every {settings.patrol.query_s:g} s."
    )


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
        ("policy", COMPARED_POLICIES),
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
    parser.add_argument(
        "--posterior", type=int, metavar="PEOPLE", help="posterior adversary, slow"
    )
    parser.add_argument(
        "--probing", type=int, metavar="PEOPLE", help="an adversary who probes, slow"
    )
    parser.add_argument(
        "--rate",
        type=float,
        action="append",
        metavar="PER_S",
        help="rate of probes; repeatable",
    )
    parser.add_argument("--set", action="append", default=[], metavar="STAGE.KEY=VALUE")
    return parser.parse_args(words)


def plugins_named(kind, specs) -> list[Plugin]:
    return [plugin for spec in specs for plugin in parse(kind, spec)]


def comparison(given, dataset, settings):
    """Return the lines of the comparison of policies."""
    rows = list(
        compare(
            dataset.tracks,
            mechanisms=plugins_named("mechanisms", given.mechanism or MECHANISMS),
            policies=plugins_named("policies", given.policy or COMPARED_POLICIES),
            predictors=plugins_named("predictors", given.predictor or PREDICTORS),
            adversaries=[
                name for name in given.adversary or ["blind"] if name != "none"
            ],
            settings=settings,
            seed=given.seed,
        )
    )
    patrol = settings.patrol
    yield f"{dataset.name}: {patrol.fleets} fleets of {patrol.robots} robot(s)"
    yield from report(rows, settings=settings)


def chosen_report(given, dataset, settings):
    """Return the lines that the options ask for."""
    for name in ("posterior", "probing"):
        n_people = getattr(given, name)
        if n_people is not None and n_people < 1:
            raise SettingsError(f"--{name} needs at least 1 person, got {n_people}")
    if given.rate and min(given.rate) < 0.0:
        raise SettingsError("--rate must not be negative")
    if given.posterior:
        return posterior_report(
            dataset.tracks,
            mechanisms=plugins_named("mechanisms", given.mechanism or ("raw",)),
            policies=plugins_named("policies", given.policy or POSTERIOR_POLICIES),
            n_people=given.posterior,
            settings=settings,
            seed=given.seed,
        )
    if given.probing:
        return probing_report(
            dataset.tracks,
            policies=plugins_named("policies", given.policy or PROBED_POLICIES),
            n_people=given.probing,
            rates=given.rate or PROBE_RATES,
            settings=settings,
            seed=given.seed,
        )
    return comparison(given, dataset, settings)


def main(words=None):
    given = options(words)
    try:
        changes = dict(change.partition("=")[::2] for change in given.set)
        settings = StageSettings().changed(changes)
        dataset = datasets.load(given.dataset)
        # Threads of many small fits would only wait for each other.
        with threadpool_limits(limits=1, user_api="blas"):
            for line in chosen_report(given, dataset, settings):
                print(line, flush=True)
    except IsacTrackError as error:
        raise SystemExit(f"error: {error}") from None


if __name__ == "__main__":
    main()
