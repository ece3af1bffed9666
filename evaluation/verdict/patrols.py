"""What to disclose to robots on patrol: the policy and the mechanism, as data."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from evaluation.estimates.metrics import KNOWN_SHARE, MISSED_FUTURE
from evaluation.estimates.patrols import PatrolNumber
from evaluation.plan.world import parse_world
from isac_track.intervals import Estimate, difference

MOST_LOST: Final = 0.05
"""Largest rise of missed future conflicts, as `evaluation.design` allows by default."""
EVERYTHING: Final = "everything"
RAW: Final = "raw"
_CHAINS: Final = "blind"  # The adversary who joins answers without identities.


def recommend_policy(numbers: Sequence[PatrolNumber]) -> dict[str, Any]:
    """Return the policy and mechanism by which least is known; empty without patrols.

    The robot is the one that misses fewest future conflicts if everything is sent raw,
    at the farthest horizon. Options may cost it at most `MOST_LOST` more. With an
    interval the upper end counts, which is paired: same people, routes and draws.
    `known` is the share of person-time that an adversary knows by its own chains.
    """
    missed, known = _missed(numbers), _known(numbers)
    horizon_s = max((horizon for *_, horizon in missed), default=0.0)
    reference = {
        robot: estimate
        for (mechanism, _, policy, robot, horizon), estimate in missed.items()
        if (mechanism, policy, horizon) == (RAW, EVERYTHING, horizon_s)
        and np.isfinite(estimate.value)
    }
    if not reference:
        return {}
    robot = min(reference, key=lambda name: reference[name].value)
    options = [
        _option(option, estimate, known[option], reference=reference[robot])
        for (*place, name, horizon), estimate in missed.items()
        if (name, horizon) == (robot, horizon_s)
        and (option := tuple(place)) in known
        and np.isfinite(estimate.value)
    ]
    within = [option for option in options if option["lost_most"] <= MOST_LOST]
    best = min(within, key=lambda option: option["known"], default=None)
    everything = next(
        option
        for option in options
        if (option["mechanism"], option["policy"]) == (RAW, EVERYTHING)
    )
    return {
        "robot": robot,
        "horizon_s": horizon_s or None,
        "limit": MOST_LOST,
        "everything": everything,
        "best": best,
        "has_interval": bool(np.isfinite(reference[robot].ci_high)),
    }


def built_in(numbers: Iterable[PatrolNumber]) -> list[dict[str, Any]]:
    """Return the robots whose `withheld_share` follows from the construction."""
    names = ("mechanism", "level", "policy", "consumer", "world")
    return [
        {name: getattr(number, name) for name in names}
        for number in numbers
        if number.is_built_in
    ]


def _missed(
    numbers: Iterable[PatrolNumber],
) -> dict[tuple[str, float | None, str, str, float], Estimate]:
    """Return missed futures by mechanism, level, policy, robot and horizon, s."""
    return {
        (
            number.mechanism,
            number.level,
            number.policy,
            number.consumer,
            _horizon_s(number.world),
        ): number.estimate
        for number in numbers
        if number.metric == MISSED_FUTURE
    }


def _horizon_s(text: str) -> float:
    """Return the horizon of a world, s; 0 is that of the run."""
    world = parse_world(text)
    return (world.horizon_s if world else None) or 0.0


def _known(
    numbers: Iterable[PatrolNumber],
) -> dict[tuple[Any, ...], Estimate]:
    """Return the known share by own chains, by mechanism, level and policy."""
    return {
        (number.mechanism, number.level, number.policy): number.estimate
        for number in numbers
        if (number.metric, number.knowledge) == (KNOWN_SHARE, _CHAINS)
    }


def _option(
    option: tuple[Any, ...], missed: Estimate, known: Estimate, *, reference: Estimate
) -> dict[str, Any]:
    """Return the numbers of a policy with a mechanism."""
    mechanism, level, policy = option
    lost = missed.value - reference.value
    ends: Mapping[str, float | None] = {"lost_low": None, "lost_high": None}
    if np.isfinite(missed.ci_high) and np.isfinite(reference.ci_high):
        paired = difference(missed, reference)
        ends = {"lost_low": paired.ci_low, "lost_high": paired.ci_high}
    high = ends["lost_high"]
    is_same = lost == 0.0 and np.array_equal(missed.replicates, reference.replicates)
    return {
        "mechanism": mechanism,
        "level": level,
        "policy": policy,
        "missed_future": missed.value,
        "known": known.value,
        "known_low": _finite(known.ci_low),
        "known_high": _finite(known.ci_high),
        "lost": lost,
        **ends,
        "lost_most": lost if is_same or high is None else high,
        "n": min(missed.n, known.n),
    }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
