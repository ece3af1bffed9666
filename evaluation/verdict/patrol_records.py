"""Records of what to disclose to robots on patrol: options, limits and a proposal.

A share is a fraction, with its 95 % interval; an unknown number is NaN. `patrol_json`
writes and reads them.
"""

import math
from dataclasses import dataclass
from typing import Final

from evaluation.estimates.families import RAW
from isac_track.errors import SettingsError
from isac_track.intervals import Estimate

MOST_LOST: Final = 0.05  # Usual limit on the rise of missed future conflicts.
EVERYTHING: Final = "everything"
"""The policy that discloses all people; with raw positions it is the reference."""
SHARES: Final = ("lost", "missed", "known", "followed")
"""Shares of an option that may be limited."""


@dataclass(frozen=True, slots=True)
class PatrolLimits:
    """Largest shares that a policy with a mechanism may have; None: any.

    The upper end of a 95 % interval counts. SettingsError for a share out of range.
    """

    lost: float | None = MOST_LOST
    """Missed future conflicts above those of raw positions of everybody."""
    missed: float | None = None  # Future conflicts that the robot misses.
    known: float | None = None  # Person-time that an adversary knows by its own chains.
    followed: float | None = None  # People whom it follows for 10 s.

    def __post_init__(self) -> None:
        for name, limit in self.named.items():
            if not 0.0 <= limit <= 1.0:
                raise SettingsError(
                    f"--max-{name} is a fraction from 0 to 1 (0.2 for 20 %), got"
                    f" {limit:g}"
                )

    @property
    def named(self) -> dict[str, float]:
        """The limits that are set, by name."""
        limits = {name: getattr(self, name) for name in SHARES}
        return {name: limit for name, limit in limits.items() if limit is not None}


USUAL_LIMITS: Final = PatrolLimits()


@dataclass(frozen=True, slots=True)
class PatrolOption:
    """A robot's cost and its log's knowledge, under a policy with a mechanism."""

    robot: str
    horizon_s: float | None  # Of conflicts; None: the run's own.
    mechanism: str
    level: float | None
    policy: str
    may_be_proposed: bool  # False for a control.
    missed: Estimate  # Future conflicts that the robot misses.
    lost: Estimate  # Missed conflicts above those of raw positions of everybody.
    known: Estimate  # Person-time that the adversary knows by its own chains.
    followed: Estimate  # People whom it follows for 10 s.
    n: int  # Clusters of people.

    @property
    def is_reference(self) -> bool:
        """Whether everybody is disclosed with raw positions."""
        return (self.mechanism, self.policy) == (RAW, EVERYTHING)

    def share(self, name: str) -> Estimate:
        """Return a share by its name in `SHARES`."""
        share: Estimate = getattr(self, name)
        return share

    def upper_end(self, name: str) -> float:
        """Return the upper end of a share, or its value without an interval."""
        share = self.share(name)
        return share.ci_high if math.isfinite(share.ci_high) else share.value

    def exceeded(self, limits: PatrolLimits) -> dict[str, float]:
        """Return by name the limits that the option exceeds, with its upper ends.

        A share that is not known counts as exceeded: NaN.
        """
        uppers = {name: self.upper_end(name) for name in limits.named}
        return {
            name: uppers[name]
            for name, limit in limits.named.items()
            if not uppers[name] <= limit
        }


@dataclass(frozen=True, slots=True)
class PatrolProposal:
    """The option by which least is known within limits, or else the nearest.

    The nearest exceeds fewest limits, and by least.
    """

    robot: str
    horizon_s: float | None
    limits: PatrolLimits
    everything: PatrolOption  # Raw positions of everybody: the reference.
    option: PatrolOption  # The best; or, if no option holds all limits, the nearest.
    is_within: bool  # Whether the option holds all limits.

    @property
    def has_interval(self) -> bool:
        """Whether there are so many routes and people that shares have intervals."""
        return math.isfinite(self.everything.missed.ci_high)
