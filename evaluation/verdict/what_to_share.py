"""The recommended levels of a site: decided only here, from `levels.csv`.

First screen, page, `evaluation.design` and the notebook read the result of `recommend`.
A `Question` has the limits (`question`), a `KnownLevel` the numbers of a level in the
run (`level_rows`), an `Offer` the level's cost, its privacy and a `Check` for each limit
(`offers`, made in `level_checks`). A limit is met only if the upper end of the interval
meets it; a limit that was not tried is not met. Nothing is interpolated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pandas as pd

from evaluation.estimates.best_robot import BEST
from evaluation.estimates.families import RAW, Family
from evaluation.estimates.pareto import beats
from evaluation.verdict.level_checks import UNKNOWN_SCENES, LevelChecker, SceneCounts
from evaluation.verdict.level_rows import (
    check_families,
    chosen_robots,
    leading_handover,
    read_levels,
    robot_names,
)
from evaluation.verdict.offers import Offer, Unknown
from evaluation.verdict.question import Question
from isac_track.errors import SettingsError

MOST_PROPOSALS: Final = 5


@dataclass(frozen=True, slots=True)
class Recommendation:
    """The answer: the levels that hold all limits, or the nearest."""

    question: Question
    robots: tuple[str, ...]
    """The robot named, or the best of the run: the choices of the first and the second
    half of the people, each scored on the other half. Empty: no robot has the
    criterion."""
    raw: Offer | None
    proposals: tuple[Offer, ...]  # Non-dominated, cheapest first.
    refused: tuple[Offer, ...]  # Levels that do not hold, nearest first.
    missing: tuple[Unknown, ...]  # Reasons that no level has an answer to some limit.
    task: str  # The leading handover; empty if there is none.

    @property
    def robot(self) -> str:
        """The robot behind the costs; two names if the halves chose two robots."""
        return " or ".join(dict.fromkeys(self.robots))

    @property
    def met(self) -> bool:
        """Whether some level holds all limits."""
        return bool(self.proposals)

    @property
    def nearest(self) -> Offer | None:
        """The level that comes closest, if none holds."""
        return None if self.proposals or not self.refused else self.refused[0]

    @property
    def unsettled(self) -> tuple[Offer, ...]:
        """The few best levels with no limit broken, if no level holds all of them."""
        undecided = [
            offer
            for offer in self.refused
            if not offer.lacks_rule
            and all(check.status != "not met" for check in offer.checks)
        ]
        return () if self.proposals else tuple(cheapest(non_dominated(undecided)))

    @property
    def candidates(self) -> tuple[Offer, ...]:
        """Levels on which adversaries that know more should be tried."""
        return self.proposals or self.unsettled or self.refused[:1]


def recommend(
    table: pd.DataFrame,
    question: Question,
    *,
    dataset: str,
    scenes: SceneCounts = UNKNOWN_SCENES,
) -> Recommendation:
    """Return the levels that hold the limits of a question, or the nearest.

    `table` is `levels.csv` of a run, `scenes` the scenes behind it. Raises
    SettingsError for a family or a robot that the run does not have.
    """
    known = read_levels(table, dataset)
    raw_rows = next((level for level in known if level.family.family == RAW), None)
    rivals = [
        level for level in known if level.family.protects and level.family.is_added
    ]
    check_families(rivals, question)
    robots = robot_names(known)
    _check_robot(question, robots)
    robot = question.robot or BEST[question.criterion.metric]
    task = leading_handover({row.reader.task for level in known for row in level.rows})
    checker = LevelChecker(question, robot, task, scenes, robots=robots)
    asked = [level for level in rivals if _is_asked(level.family, question)]
    offers = _under_all_rules(
        [checker.offer(level) for level in asked], question.adding
    )
    fitting = [offer for offer in offers if offer.met and not offer.lacks_rule]
    proposals = cheapest(non_dominated(fitting))
    refused = sorted(
        (offer for offer in offers if not offer.met or offer.lacks_rule), key=_distance
    )
    return Recommendation(
        question=question,
        robots=(
            (robot,) if question.robot else chosen_robots(known, question.criterion)
        ),
        raw=checker.offer(raw_rows) if raw_rows else None,
        proposals=tuple(proposals),
        refused=tuple(refused),
        missing=_missing_everywhere(offers),
        task=task,
    )


def _check_robot(question: Question, robots: Sequence[str]) -> None:
    """Raise SettingsError for a robot that is asked for and that a run does not have."""
    if question.robot and question.robot not in robots:
        raise SettingsError(
            f"--predictor {question.robot}: the run has {', '.join(robots) or 'none'};"
            " name one of these or add it with the command of the run"
        )


def _is_asked(family: Family, question: Question) -> bool:
    """Return whether a question is about a family, and about a rule that it has."""
    is_named = not question.only or {family.family, family.name} & {*question.only}
    return bool(is_named and {*family.rules} & {*question.adding})


def non_dominated(offers: Sequence[Offer]) -> list[Offer]:
    """Return the offers that no other beats: as low in all coordinates, lower in any.

    Only an offer under the same adding rules can beat another: a network that cannot
    add linearly has no use for a level that does. Of equal offers the first stays.
    """
    values = np.array([offer.coordinates for offer in offers]).reshape(len(offers), 3)
    rules = [{*offer.family.rules} for offer in offers]
    is_rival = np.array(
        [[own <= others for own in rules] for others in rules], dtype=bool
    ).reshape(len(offers), len(offers))
    is_beaten = (beats(values) & is_rival).any(axis=0)
    is_equal = (values[:, None] == values[None]).all(axis=2)
    # Above the diagonal: of an earlier offer.
    is_repeated = np.triu(is_equal & is_rival, k=1).any(axis=0)
    is_out = (is_beaten | is_repeated).tolist()
    return [offer for offer, out in zip(offers, is_out, strict=True) if not out]


def cheapest(offers: Sequence[Offer]) -> list[Offer]:
    """Return the few cheapest offers, in order of cost."""
    return sorted(offers, key=lambda offer: offer.coordinates)[:MOST_PROPOSALS]


def _distance(offer: Offer) -> tuple[int, float, float]:
    """Return an offer's distance: number of limits missed, worst excess, and cost."""
    excess = [check.excess for check in offer.checks]
    n_missed = sum(
        check.status == "not met" or check.excess > 0.0 for check in offer.checks
    )
    return n_missed, max(excess, default=0.0), offer.coordinates[0]


def _under_all_rules(offers: Sequence[Offer], adding: Sequence[str]) -> list[Offer]:
    """Return offers, each with a rule under which its mechanism holds nowhere."""
    rules_met: dict[str, set[str]] = {}
    for offer in offers:
        if offer.met:
            rules_met.setdefault(offer.family.name, set()).update(offer.family.rules)
    marked = []
    for offer in offers:
        needed = (
            () if offer.family.has_fixed_rule or not offer.family.adding else adding
        )
        lacking = [
            rule
            for rule in needed
            if rule not in rules_met.get(offer.family.name, set())
        ]
        rule = lacking[0] if offer.met and lacking else ""
        marked.append(replace(offer, lacks_rule=rule))
    return marked


def _missing_everywhere(offers: Sequence[Offer]) -> tuple[Unknown, ...]:
    """Return the reasons of limits that can be judged at no level at all."""
    by_name: dict[tuple[str, str], list[Unknown | None]] = {}
    for offer in offers:
        for check in offer.checks:
            by_name.setdefault((check.name, check.adversary), []).append(check.unknown)
    codes = (
        code
        for unknowns in by_name.values()
        if all(unknowns)
        for code in unknowns
        if code
    )
    return tuple(dict.fromkeys(codes))
