"""What to disclose to robots on patrol: the policy and the mechanism, as data.

First screen, page and `evaluation.design` ask `choose_policy` alone.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, TypeAlias

import numpy as np

from evaluation.estimates.families import RAW, Family
from evaluation.estimates.metrics import FOLLOWED, FUTURE_EQUAL_ALARMS, KNOWN_SHARE
from evaluation.estimates.patrols import PatrolNumber
from evaluation.plan.address import Address
from evaluation.plan.constants import ORACLE
from evaluation.verdict.patrol_records import (
    EVERYTHING,
    PatrolLimits,
    PatrolOption,
    PatrolProposal,
)
from isac_track.intervals import Estimate, difference

Lacking: TypeAlias = Literal["", "robots", "raw everything", "conflicts"]
"""What a run needs for a proposal: robots, what they are compared with, conflicts."""
Place: TypeAlias = "tuple[str, float | None, str]"
"""Mechanism, level and policy."""


def patrol_options(
    numbers: Sequence[PatrolNumber], *, families: Mapping[str, Family]
) -> list[PatrolOption]:
    """Return the options of a run, one for each robot, horizon, policy and mechanism.

    `missed` is the share of future conflicts that the robot misses at the false alarms
    that it has if everything is sent raw, `lost` its rise over that case: same people,
    routes and draws. `known` and `followed` are those of the stronger adversary without
    identities. An option without a conflict, or without the raw case to compare with,
    is left out.
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
        is_candidate = number.claims_protection or address.policy == EVERYTHING
        mechanism = families[address.mechanism]
        options.append(
            PatrolOption(
                robot=address.consumer,
                horizon_s=address.world.horizon_s,
                mechanism=address.mechanism,
                level=address.level,
                policy=address.policy,
                may_be_proposed=is_candidate
                and (mechanism.protects or mechanism.family == RAW),
                missed=number.estimate,
                lost=_rise(number.estimate, reference.estimate),
                known=known,
                followed=logs[FOLLOWED].get(_place(address), Estimate(np.nan)),
                n=min(number.estimate.n, known.n),
            )
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


def _place(address: Address) -> Place:
    return address.mechanism, address.level, address.policy


def _logs(numbers: Iterable[PatrolNumber], metric: str) -> dict[Place, Estimate]:
    """Return a share by mechanism, level and policy, of the stronger adversary.

    An adversary that knows identities does not count.
    """
    strongest: dict[Place, Estimate] = {}
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


def _rise(missed: Estimate, reference: Estimate) -> Estimate:
    """Return the rise over the raw case, with its paired interval."""
    lost = missed.value - reference.value
    if lost == 0.0 and np.array_equal(missed.replicates, reference.replicates):
        # The same robot sees the same: no interval is needed.
        return Estimate(0.0, 0.0, 0.0)
    if np.isfinite(missed.ci_high) and np.isfinite(reference.ci_high):
        return difference(missed, reference)
    return Estimate(lost)


def farthest_horizon(options: Iterable[PatrolOption]) -> float | None:
    """Return the farthest horizon of options, s; None: only the run's own."""
    return max((option.horizon_s or 0.0 for option in options), default=0.0) or None


def choose_policy(
    options: Sequence[PatrolOption],
    limits: PatrolLimits,
    *,
    horizon_s: float | None,
    robot: str = "",
) -> PatrolProposal | None:
    """Return the policy and mechanism by which least is known, within all limits.

    Without a name the robot is that which misses fewest future conflicts if
    everything is sent raw. None if there is no such case at this horizon, s. Controls
    are never proposed. Where no interval is given the value counts.
    """
    judged = [option for option in options if option.horizon_s == horizon_s]
    references = {
        option.robot: option
        for option in judged
        if option.is_reference and robot in ("", option.robot)
    }
    if not references:
        return None
    served = min(references, key=lambda name: references[name].missed.value)
    candidates = [
        option for option in judged if option.robot == served and option.may_be_proposed
    ]
    within = [option for option in candidates if not option.exceeded(limits)]
    if within:
        proposed = min(within, key=lambda option: option.known.value)
    else:
        proposed = min(candidates, key=lambda option: _distance(option, limits))
    return PatrolProposal(
        robot=served,
        horizon_s=horizon_s,
        limits=limits,
        everything=references[served],
        option=proposed,
        is_within=bool(within),
    )


def _distance(option: PatrolOption, limits: PatrolLimits) -> tuple[int, float, float]:
    """Return the number of exceeded limits, the largest excess, and what is known."""
    above = [
        1.0 if np.isnan(upper) else upper - limits.named[name]
        for name, upper in option.exceeded(limits).items()
    ]
    return len(above), max(above, default=0.0), option.known.value
