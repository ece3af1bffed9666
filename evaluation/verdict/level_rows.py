"""Levels of a run as read from `levels.csv`: the numbers of each."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import pandas as pd

from attacks.tasks.task_list import TASKS
from evaluation.estimates.best_robot import BEST
from evaluation.estimates.families import Family
from evaluation.estimates.metrics import EQUAL_ALARMS, FALSE_ALARMS
from evaluation.plan.address import Address, Where, parse_row
from evaluation.plan.world import World
from evaluation.verdict.question import Criterion, Question
from isac_track.errors import SettingsError, did_you_mean
from isac_track.intervals import Estimate

LEADING: Final = "handover-1s"


@dataclass(frozen=True, slots=True)
class LevelRow:
    """A number of a level."""

    world: World
    adversary: str
    source: Address
    metric: str
    measured: Estimate
    outcome: str
    invalid: str
    chosen: tuple[str, str]  # By either half of the people.


@dataclass(frozen=True, slots=True)
class KnownLevel:
    """All numbers of a level."""

    where: Where
    family: Family
    rows: tuple[LevelRow, ...]


def read_levels(table: pd.DataFrame, dataset: str) -> list[KnownLevel]:
    """Return the levels of a table, each with its numbers."""
    rows: dict[Where, list[LevelRow]] = {}
    families: dict[Where, Family] = {}
    chosen = ("first_choice", "second_choice")
    texts = (*chosen, "outcome", "invalid", "adversary", "knowledge", "adding")
    tidy = table.assign(
        **{name: table[name].astype(object).fillna("") for name in texts}
    )
    for row in tidy.to_dict("records"):
        address = parse_row(row)
        if address.recording != dataset:
            # Simulated people beside a recording.
            continue
        where = address.where
        families[where] = Family(
            row["mechanism"],
            row["family"],
            row["adding"],
            protects=bool(row["protects"]),
        )
        number = LevelRow(
            world=address.world,
            adversary=row["adversary"],
            source=address.source,
            metric=row["metric"],
            measured=Estimate(
                row["value"], row["ci_low"], row["ci_high"], int(row["n"])
            ),
            outcome=row["outcome"],
            invalid=row["invalid"],
            chosen=(row["first_choice"], row["second_choice"]),
        )
        rows.setdefault(where, []).append(number)
    return [
        KnownLevel(where, families[where], tuple(numbers))
        for where, numbers in rows.items()
    ]


def check_families(levels: Iterable[KnownLevel], question: Question) -> None:
    """Raise SettingsError for a family that is asked for and that no level has."""
    families = [level.family for level in levels]
    known = dict.fromkeys(
        text for family in families for text in (family.family, family.name)
    )
    for name in question.only:
        if name not in known:
            hint = (
                did_you_mean(name, known, quote="'") or f"; it has {', '.join(known)}"
            )
            raise SettingsError(
                f"--family {name}: the run has no such family that protects{hint}"
            )


def robot_names(levels: Sequence[KnownLevel]) -> tuple[str, ...]:
    """Return the predictors of a run by name."""
    names = (
        row.source.consumer
        for metric in (EQUAL_ALARMS, FALSE_ALARMS)
        for level in levels
        for row in level.rows
        if row.metric == metric
    )
    return tuple(name for name in dict.fromkeys(names) if name not in BEST.values())


def chosen_robots(
    levels: Iterable[KnownLevel], criterion: Criterion
) -> tuple[str, ...]:
    """Return the predictor that either half of the people chose; empty without any."""
    best = BEST[criterion.metric]
    chosen = (
        row.chosen
        for level in levels
        for row in level.rows
        if row.source.consumer == best and row.world == criterion.world
    )
    return next(chosen, ())


def leading_handover(names: Collection[str]) -> str:
    """Return the task by which linkage is judged; empty if there is no handover."""
    handovers = [
        name for name, task in TASKS.items() if task.silence_s > 0.0 and name in names
    ]
    return LEADING if LEADING in handovers else next(iter(handovers), "")


def level_tasks(level: KnownLevel) -> list[str]:
    """Return the linkage tasks with a number at a level."""
    return [*dict.fromkeys(row.source.task for row in level.rows if row.source.task)]
