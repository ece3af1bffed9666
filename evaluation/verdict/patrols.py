"""What to disclose to robots on patrol: the policy and the mechanism, as data.

First screen, page and `evaluation.design` ask `choose_policy` alone. It reads options as
`verdict.json` holds them.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from evaluation.estimates.families import RAW, Family
from evaluation.estimates.json_numbers import json_interval
from evaluation.estimates.metrics import FOLLOWED, FUTURE_EQUAL_ALARMS, KNOWN_SHARE
from evaluation.estimates.patrols import PatrolNumber
from evaluation.plan.address import Address
from evaluation.plan.constants import ORACLE
from isac_track.errors import SettingsError
from isac_track.intervals import Estimate, difference

Option: TypeAlias = "Mapping[str, Any]"
"""Numbers of a robot, at a horizon, under a policy with a mechanism."""
Proposal: TypeAlias = "dict[str, Any]"
Lacking: TypeAlias = Literal["", "robots", "raw everything", "conflicts"]
"""What a run needs for a proposal: robots, what they are compared with, conflicts."""
MOST_LOST: Final = 0.05  # Usual limit on the rise of missed future conflicts.
EVERYTHING: Final = "everything"
_MEASURED: Final = ("lost", "missed", "known", "followed")
_PLACE: Final = ("mechanism", "level", "policy")


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
        limits = {name: getattr(self, name) for name in _MEASURED}
        return {name: limit for name, limit in limits.items() if limit is not None}


USUAL_LIMITS: Final = PatrolLimits()


def patrol_options(
    numbers: Sequence[PatrolNumber], *, families: Mapping[str, Family]
) -> list[dict[str, Any]]:
    """Return the options of a run, one for each robot, horizon, policy and mechanism.

    `missed` is the share of future conflicts that the robot misses at the false alarms
    that it has if everything is sent raw, `lost` its rise over that case: same people,
    routes and draws. `known` and `followed` are those of the stronger adversary without
    identities. Ends of an interval that is not there are None. An option without a
    conflict, or without the raw case to compare with, is left out.
    """
    missed = {
        number.address: number
        for number in numbers
        if number.address.metric == FUTURE_EQUAL_ALARMS
        and np.isfinite(number.estimate.value)
    }
    logs = {name: _logs(numbers, name) for name in (KNOWN_SHARE, FOLLOWED)}
    options = []
    for address, number in missed.items():
        reference = missed.get(_raw_case(address))
        known = logs[KNOWN_SHARE].get(_place(address))
        if reference is None or known is None:
            continue
        followed = logs[FOLLOWED].get(_place(address), Estimate(np.nan))
        is_candidate = number.claims_protection or address.policy == EVERYTHING
        mechanism = families[address.mechanism]
        options.append(
            {
                "robot": address.consumer,
                "horizon_s": address.world.horizon_s,
                **dict(zip(_PLACE, _place(address), strict=True)),
                "may_be_proposed": is_candidate
                and (mechanism.protects or mechanism.family == RAW),
                **json_interval("missed", number.estimate),
                **_rise(number.estimate, reference.estimate),
                **json_interval("known", known),
                **json_interval("followed", followed),
                "n": min(number.estimate.n, known.n),
            }
        )
    return options


def lacking_part(numbers: Sequence[PatrolNumber]) -> Lacking:
    """Return what a run without options lacks; empty if it has some."""
    missed = [
        number for number in numbers if number.address.metric == FUTURE_EQUAL_ALARMS
    ]
    raw_cases = [
        number for number in missed if number.address == _raw_case(number.address)
    ]
    if not missed:
        return "robots"
    if not raw_cases:
        return "raw everything"
    is_met = any(np.isfinite(number.estimate.value) for number in raw_cases)
    return "" if is_met else "conflicts"


def _raw_case(address: Address) -> Address:
    """Return the same robot and horizon, sent raw positions of everybody."""
    return Address(
        world=address.world,
        mechanism=RAW,
        policy=EVERYTHING,
        plugin=address.plugin,
        metric=address.metric,
    )


def _place(address: Address) -> tuple[str, float | None, str]:
    return address.mechanism, address.level, address.policy


def _logs(
    numbers: Iterable[PatrolNumber], metric: str
) -> dict[tuple[str, float | None, str], Estimate]:
    """Return a share by mechanism, level and policy, of the stronger adversary.

    An adversary that knows identities does not count.
    """
    strongest: dict[tuple[str, float | None, str], Estimate] = {}
    for number in numbers:
        address, share = number.address, number.estimate
        if address.metric != metric or address.adversary in ("", ORACLE):
            continue
        if not np.isfinite(share.value):
            # NaN is below no number: no later adversary would replace it.
            continue
        place = _place(address)
        if place not in strongest or share.value > strongest[place].value:
            strongest[place] = share
    return strongest


def _rise(missed: Estimate, reference: Estimate) -> dict[str, float | None]:
    """Return the rise over the raw case, with its paired interval."""
    lost = missed.value - reference.value
    if lost == 0.0 and np.array_equal(missed.replicates, reference.replicates):
        # The same robot sees the same: no interval is needed.
        return {"lost": 0.0, "lost_low": 0.0, "lost_high": 0.0}
    if np.isfinite(missed.ci_high) and np.isfinite(reference.ci_high):
        return json_interval("lost", difference(missed, reference))
    return {"lost": lost, "lost_low": None, "lost_high": None}


def farthest_horizon(options: Iterable[Option]) -> float | None:
    """Return the farthest horizon of options, s; None: only the run's own."""
    return max((option["horizon_s"] or 0.0 for option in options), default=0.0) or None


def choose_policy(
    options: Sequence[Option],
    limits: PatrolLimits,
    *,
    horizon_s: float | None,
    robot: str = "",
) -> Proposal:
    """Return the policy and mechanism by which least is known, within all limits.

    Without a name the robot is that which misses fewest future conflicts if
    everything is sent raw. Empty if there is no such case at this horizon, s. Controls
    are never proposed. Where no interval is given the value counts. `best` is None if
    nothing holds; `nearest` exceeds fewest limits, and by least.
    """
    judged = [option for option in options if option["horizon_s"] == horizon_s]
    raw_cases = {
        option["robot"]: option
        for option in judged
        if (option["mechanism"], option["policy"]) == (RAW, EVERYTHING)
        and robot in ("", option["robot"])
    }
    if not raw_cases:
        return {}
    served = min(raw_cases, key=lambda name: raw_cases[name]["missed"])
    candidates = [
        option
        for option in judged
        if option["robot"] == served and option["may_be_proposed"]
    ]
    within = [option for option in candidates if not exceeded(option, limits)]
    best = min(within, key=lambda option: option["known"], default=None)
    nearest = min(candidates, key=lambda option: _distance(option, limits))
    return {
        "robot": served,
        "horizon_s": horizon_s,
        "limits": limits.named,
        "everything": raw_cases[served],
        "best": best,
        "nearest": None if best else nearest,
        "has_interval": raw_cases[served]["missed_high"] is not None,
    }


def exceeded(option: Option, limits: PatrolLimits) -> dict[str, float | None]:
    """Return by name the limits that an option exceeds, with its upper ends.

    A share that is not known counts as exceeded: None.
    """
    upper = {name: upper_end(option, name) for name in limits.named}
    return {
        name: upper[name]
        for name, limit in limits.named.items()
        if (value := upper[name]) is None or value > limit
    }


def upper_end(option: Option, name: str) -> float | None:
    """Return the upper end of a share, or its value without an interval."""
    high = option[f"{name}_high"]
    value: float | None = option[name] if high is None else high
    return value


def _distance(option: Option, limits: PatrolLimits) -> tuple[int, float, float]:
    """Return the number of exceeded limits, the largest excess, and what is known."""
    above = [
        1.0 if upper is None else upper - limits.named[name]
        for name, upper in exceeded(option, limits).items()
    ]
    return len(above), max(above, default=0.0), option["known"]


def built_in(numbers: Iterable[PatrolNumber]) -> list[dict[str, Any]]:
    """Return the robots whose `withheld_share` follows from the construction."""
    return [
        {
            **dict(zip(_PLACE, _place(number.address), strict=True)),
            "consumer": number.address.consumer,
            "world": number.address.world.text,
        }
        for number in numbers
        if number.is_by_construction
    ]
