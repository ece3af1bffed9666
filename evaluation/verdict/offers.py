"""Offers: the cost and privacy of a level, checked against the limits of a question."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias

from evaluation.estimates.families import Family
from evaluation.estimates.metrics import PLR, PLR_WIDE, RANK1
from evaluation.plan.address import Address, MechanismLevel
from isac_track.intervals import FEWEST_EFFECTIVE, Estimate

# Up to so many times the scenes of a run, new scenes still show new people.
MOST_TIMES: Final = 10.0
Unknown: TypeAlias = Literal[
    "no horizon",
    "no robot",
    "no attack",
    "no handover",
    "no task",
    "adversary not tried",
    "shortcut",
    "attack too weak",
    "no value",
    "too few people",
]
"""Reason that a check has no answer."""
Status: TypeAlias = Literal["met", "not met", "cannot say"]
"""Answer of a check."""
WEAK: Final = "attack too weak"
UNKNOWN: Final = Estimate(math.nan)


@dataclass(frozen=True, slots=True)
class Check:
    """A limit of the question, put to a level."""

    name: str  # As in `LIMITS`, `plr_wide`, or `rank1/TASK`.
    limit: float  # Infinite: the number must be known.
    measured: Estimate
    reader: Address | None = None  # The robot, positions or linker of the number.
    adversary: str = ""  # `SINGLE_RELEASE` or a name, for a number after attack.
    scenes: int = 0  # Number of scenes behind it; 0: it is not about scenes.
    missing: Unknown | None = None

    @property
    def unknown(self) -> Unknown | None:
        """Reason that there is no answer; None with an answer."""
        if self.missing is not None:
            return self.missing
        if math.isnan(self.measured.value):
            return "no value"
        is_few = 0 < self.measured.n < FEWEST_EFFECTIVE
        if is_few or not math.isfinite(self.measured.ci_high):
            return "too few people"
        return None

    @property
    def status(self) -> Status:
        """The answer: met (the upper end is at most the limit), not met, or cannot say."""
        if self.unknown:
            return "cannot say"
        return "met" if self.measured.ci_high <= self.limit else "not met"

    @property
    def excess(self) -> float:
        """Relative excess of the upper end, or else of the value, over the limit."""
        ends = (self.measured.ci_high, self.measured.value)
        upper = next((end for end in ends if math.isfinite(end)), self.limit)
        if not upper > self.limit:
            return 0.0
        return upper / self.limit - 1.0 if self.limit > 0.0 else math.inf

    @property
    def times_more(self) -> float:
        """Factor of data that would part the value from its limit.

        An interval narrows with the root of the factor. NaN unless the limit is within
        the interval.
        """
        measured = self.measured
        value, low, high = measured.value, measured.ci_low, measured.ci_high
        if self.status != "not met" or not low < self.limit:
            return math.nan
        side = high - value if value <= self.limit else value - low
        gap = abs(self.limit - value)
        return (side / gap) ** 2 if gap > 0.0 else math.inf

    @property
    def asks(self) -> str:
        """Data that would give an answer: more scenes, or other people."""
        return "scenes" if self.scenes and self.times_more <= MOST_TIMES else "people"


@dataclass(frozen=True, slots=True)
class AttackNumbers:
    """Numbers after the strongest attack of an adversary at a level."""

    adversary: str  # `SINGLE_RELEASE`, or a name.
    reader: Address | None = None  # None: it was not tried.
    numbers: Mapping[str, Estimate] = field(default_factory=dict)  # By metric.

    def value(self, metric: str) -> Estimate:
        """Return a number, unknown if there is none."""
        return self.numbers.get(metric, UNKNOWN)

    def breaks(self, limit: float) -> bool | None:
        """Return whether PLR, at epsilon or wider, breaks a limit.

        None: the adversary was not tried, or too few people tell.
        """
        statuses = {
            Check(name, limit, self.value(name)).status for name in (PLR, PLR_WIDE)
        }
        if "not met" in statuses:
            return True
        return None if "cannot say" in statuses else False


@dataclass(frozen=True, slots=True)
class TaskLinkage:
    """Success of the strongest linker in a task."""

    task: str
    reader: Address | None = None  # None: it was not run at this level.
    metric: str = RANK1  # Rank 1, or that of 100 candidates.
    rank1: Estimate = UNKNOWN
    chance: float = math.nan
    share: Estimate = UNKNOWN  # Of raw's rank 1 above chance.
    missing: Unknown | None = None


@dataclass(frozen=True, slots=True)
class Offer:
    """Cost and privacy of a level, and its checks against the limits."""

    mechanism_level: MechanismLevel
    family: Family
    cost: Estimate  # Missed conflicts of the robot, by the criterion.
    robots: Mapping[str, Estimate]  # Cost of every robot of the run by its name.
    shared: AttackNumbers
    attacked: AttackNumbers  # After one release.
    beyond: tuple[
        AttackNumbers, ...
    ]  # After each adversary that knows more, tried or not.
    linked: TaskLinkage | None  # In the leading handover; None: the run has none.
    tasks: tuple[TaskLinkage, ...]
    checks: tuple[Check, ...] = ()
    lacks_rule: str = ""  # Adding rule under which its mechanism does not hold.

    @property
    def met(self) -> bool:
        """Whether every limit holds."""
        return all(check.status == "met" for check in self.checks)

    @property
    def failing(self) -> tuple[Check, ...]:
        """Limits that do not hold, or have no answer."""
        return tuple(check for check in self.checks if check.status != "met")

    @property
    def coordinates(self) -> tuple[float, float, float]:
        """Cost, PLR after attack, and linkage: less is better.

        An unknown number is infinite: it beats no known number, and equals another
        unknown one. A level with an unknown limit is never proposed (`met`).
        """
        exposed = self.attacked if self.attacked.reader else self.shared
        linked = self.linked.rank1.value if self.linked else math.nan
        plr = exposed.value(PLR).value
        cost, plr, rank1 = (
            math.inf if math.isnan(value) else value
            for value in (self.cost.value, plr, linked)
        )
        return cost, plr, rank1
