"""Levels of a run, each checked against the limits of a question."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from evaluation.estimates.metrics import (
    CHANCE,
    DESCRIPTORS,
    FALSE_ALARMS,
    LINKAGE_SHARE,
    MEDIAN_ERROR,
    PLR,
    PLR_WIDE,
    RANK1,
    RANK1_AMONG_100,
)
from evaluation.estimates.strongest import BEYOND
from evaluation.estimates.strongest_table import SINGLE_RELEASE
from evaluation.plan.address import AS_SHARED, Address, parse_consumer
from evaluation.verdict.level_rows import KnownLevel, level_tasks
from evaluation.verdict.offers import (
    UNKNOWN,
    WEAK,
    AttackNumbers,
    Check,
    Offer,
    TaskLinkage,
    Unknown,
)
from evaluation.verdict.question import LINKED, MISSED, Question


@dataclass(frozen=True, slots=True)
class SceneCounts:
    """Number of scenes behind the numbers of a run; 0 if it is not known."""

    attacks: int = 0
    robots: int = 0


UNKNOWN_SCENES: Final = SceneCounts()


def scene_counts(manifest: Mapping[str, Any]) -> SceneCounts:
    """Return the scenes of a run, from its manifest."""
    identity = manifest["identity"]
    n_attacked = identity["scenes"]
    return SceneCounts(n_attacked, identity.get("scenes_utility", n_attacked))


@dataclass(frozen=True, slots=True)
class LevelChecker:
    """The question and the run, against which every level is checked."""

    question: Question
    robot: str  # Whose costs count: a name, or one of `BEST`.
    task: str  # The leading handover; empty if the run has none.
    scenes: SceneCounts
    robots: tuple[str, ...]  # Predictors of the run by name.

    def offer(self, level: KnownLevel) -> Offer:
        """Return cost and privacy of a level, with its checks."""
        criterion = self.question.criterion
        robots = {
            row.reader.consumer: row.measured
            for row in level.rows
            if row.world == criterion.world and row.metric == criterion.metric
        }
        cost = robots.get(self.robot, UNKNOWN)
        tasks = tuple(task_linkage(level, task) for task in level_tasks(level))
        offer = Offer(
            mechanism_level=level.mechanism_level,
            family=level.family,
            cost=cost,
            robots={name: rate for name, rate in robots.items() if name in self.robots},
            shared=attack_numbers(level, "", reader=AS_SHARED),
            attacked=attack_numbers(level, SINGLE_RELEASE),
            beyond=tuple(attack_numbers(level, name) for name in BEYOND),
            linked=task_linkage(level, self.task) if self.task else None,
            tasks=tasks,
        )
        checks = (
            *self._cost_checks(offer, level),
            *self._exposure_checks(offer),
            *self._linkage_checks(offer),
        )
        return replace(offer, checks=checks)

    def _cost_checks(self, offer: Offer, level: KnownLevel) -> list[Check]:
        limits, criterion = self.question.limits, self.question.criterion
        n_scenes = self.scenes.robots
        worlds = {row.world for row in level.rows}
        missing: Unknown | None = None
        if not self.robots:
            missing = "no robot"
        elif criterion.world not in worlds:
            missing = "no horizon"
        elif math.isnan(offer.cost.value):
            missing = "no value"
        reader, most = parse_consumer(self.robot), limits.get(MISSED, math.inf)
        checks = [
            Check(MISSED, most, offer.cost, reader, scenes=n_scenes, missing=missing)
        ]
        if "false_alarm" in limits:
            rates = (
                row.measured
                for row in level.rows
                if row.metric == FALSE_ALARMS
                and row.reader == reader
                and row.world == criterion.world
            )
            rate = next(rates, UNKNOWN)
            checks.append(
                Check(
                    "false_alarm",
                    limits["false_alarm"],
                    rate,
                    reader,
                    scenes=n_scenes,
                    missing=missing,
                )
            )
        if MISSED not in limits and not missing:
            # Without a limit any known cost is fine, even without an interval.
            return checks[1:]
        return checks

    def _exposure_checks(self, offer: Offer) -> list[Check]:
        question, checks = self.question, list[Check]()
        sides = [offer.shared if question.as_shared else offer.attacked]
        sides += [side for side in offer.beyond if side.adversary in question.against]
        for side in sides:
            # An adversary that was not tried gets no further check.
            for name in (*DESCRIPTORS, PLR_WIDE) if side.reader else DESCRIPTORS:
                limit = question.limits.get(PLR if name == PLR_WIDE else name)
                if limit is None:
                    continue
                untried: Unknown = (
                    "adversary not tried" if side.adversary in BEYOND else "no attack"
                )
                checks.append(
                    Check(
                        name,
                        limit,
                        side.value(name),
                        side.reader,
                        side.adversary,
                        scenes=self.scenes.attacks,
                        missing=untried if side.reader is None else None,
                    )
                )
        return checks

    def _linkage_checks(self, offer: Offer) -> list[Check]:
        question, checks = self.question, list[Check]()
        if question.asks_linkage:
            linked = offer.linked or TaskLinkage("", missing="no handover")
            limit = question.limits[LINKED]
            reader, missing = linked.reader, linked.missing
            checks.append(Check(LINKED, limit, linked.share, reader, missing=missing))
        if RANK1 in question.limits:
            limit = question.limits[RANK1]
            for task in offer.tasks or (TaskLinkage("", missing="no task"),):
                name = f"{RANK1}/{task.task}"
                checks.append(
                    Check(name, limit, task.rank1, task.reader, missing=task.missing)
                )
        return checks


def attack_numbers(
    level: KnownLevel, adversary: str, *, reader: Address | None = None
) -> AttackNumbers:
    """Return the numbers after an adversary's attack, the strongest by PLR."""
    rows = [
        row
        for row in level.rows
        if row.adversary == adversary
        and not row.reader.task
        and (reader is None or row.reader == reader)
        and row.metric in {*DESCRIPTORS, PLR_WIDE, MEDIAN_ERROR}
    ]
    by_plr = next((row.reader for row in rows if row.metric == PLR), None)
    return AttackNumbers(adversary, by_plr, {row.metric: row.measured for row in rows})


def task_linkage(level: KnownLevel, task: str) -> TaskLinkage:
    """Return the success of a task's strongest linker at a level."""
    rows = {row.metric: row for row in level.rows if row.reader.task == task}
    metric = RANK1_AMONG_100 if RANK1_AMONG_100 in rows else RANK1
    if metric not in rows:
        return TaskLinkage(task, missing="no attack")
    rank1 = rows[metric]
    missing: Unknown | None = None
    if rank1.invalid:
        missing = "shortcut"
    elif rank1.outcome == WEAK:
        missing = WEAK
    numbers = {name: row.measured for name, row in rows.items()}
    share = numbers.get(LINKAGE_SHARE, UNKNOWN)
    chance = numbers.get(CHANCE, UNKNOWN).value
    return TaskLinkage(
        task, rank1.reader, metric, rank1.measured, chance, share, missing
    )
