"""The question of a site: limits on a robot's misses and on disclosure."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

from evaluation.estimates.families import ADDING_RULES, Family
from evaluation.estimates.metrics import (
    DESCRIPTORS,
    EQUAL_ALARMS,
    FALSE_ALARMS,
    FUTURE_EQUAL_ALARMS,
    METRICS,
    MISSED_RATE,
    PLR,
    RANK1,
    Metric,
)
from evaluation.estimates.strongest import BEYOND
from evaluation.plan.world import World
from isac_track.errors import SettingsError, did_you_mean

MOST_PLR: Final = 0.5  # After attack: below it most positions stay private.
MOST_LINKAGE_SHARE: Final = 0.5  # Of raw's rank 1 above chance.
HORIZON_S: Final = 3.0
MISSED, LINKED = "missed", "linkage_share"
# Metric by the name of a limit, in a question and in an answer.
LIMITS: Final = {
    MISSED: MISSED_RATE,
    "false_alarm": FALSE_ALARMS,
    **dict(zip(DESCRIPTORS, DESCRIPTORS, strict=True)),
    RANK1: RANK1,
    LINKED: RANK1,
}
"""Metrics that may be limited; `rank1` is of every task of the recording."""
USUAL: Final[Mapping[str, float]] = {PLR: MOST_PLR, LINKED: MOST_LINKAGE_SHARE}
"""Default limits."""


@dataclass(frozen=True, slots=True)
class Criterion:
    """The conflicts by which levels are chosen, at raw's false-alarm rate."""

    conflicts: Literal["missed_future", "missed"] = "missed_future"  # To come, or all.
    horizon_s: float | None = HORIZON_S  # None: the run's own.

    @property
    def metric(self) -> str:
        """The metric of `levels.csv`."""
        return (
            FUTURE_EQUAL_ALARMS if self.conflicts == "missed_future" else EQUAL_ALARMS
        )

    @property
    def world(self) -> World:
        """The world of the robots' numbers."""
        return World(horizon_s=self.horizon_s)


@dataclass(frozen=True, slots=True)
class Question:
    """Limits that a level must hold, against which adversaries, and for which robot.

    Raises SettingsError for a limit out of range or an unknown adversary.
    """

    limits: Mapping[str, float] = field(default_factory=lambda: dict(USUAL))
    """By name of `LIMITS`: fractions or s. A linkage share of 1 is no limit."""
    against: tuple[str, ...] = ()  # Adversaries beyond one release that also count.
    criterion: Criterion = Criterion()
    robot: str = ""  # Predictor; empty: the best robot of the run, cross-fitted.
    adding: tuple[str, ...] = ADDING_RULES  # All of them must hold.
    only: tuple[str, ...] = ()  # Families; empty: all.
    as_shared: bool = False  # Descriptors are limited as shared, not as reconstructed.

    def __post_init__(self) -> None:
        for name, limit in self.limits.items():
            metric = METRICS[LIMITS[name]]
            if not 0.0 <= limit <= (1.0 if metric.is_share else sys.float_info.max):
                kind = _limit_kind(metric)
                option = f"--max-{name.replace('_', '-')}"
                raise SettingsError(f"{option} is a {kind}, got {limit:g}")
        for name in self.against:
            if name not in BEYOND:
                hint = (
                    did_you_mean(name, BEYOND, quote="'")
                    or f"; known: {', '.join(BEYOND)}"
                )
                raise SettingsError(f"--against {name}: no such adversary{hint}")

    @property
    def asks_linkage(self) -> bool:
        """Whether linkage after a silence is limited."""
        return self.limits.get(LINKED, 1.0) < 1.0


def _limit_kind(metric: Metric) -> str:
    """Return what the option of a limit takes, behind "is a"."""
    if metric.is_share:
        return "fraction from 0 to 1 (0.2 for 20 %)"
    if metric.unit == "s":
        return "time in s, 0 or more"
    unit = f" in {metric.unit}" if metric.unit else ""
    return f"number{unit}, 0 or more"


def default_question(known: Mapping[str, Family]) -> Question:
    """Return the first screen's question; it asks only for adding rules of the run."""
    rules = {
        family.adding for family in known.values() if family.adding and family.protects
    }
    usual = Question()
    fitting = tuple(rule for rule in usual.adding if rule in rules)
    return Question(adding=fitting or usual.adding)
