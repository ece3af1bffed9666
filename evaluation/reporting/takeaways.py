"""Captions of the pictures of the page: the finding of each in a sentence."""

from collections.abc import Sequence
from itertools import combinations
from typing import Final

import numpy as np

from evaluation.estimates.families import AT_RAW
from evaluation.estimates.pareto import front
from evaluation.plan.address import MechanismLevel
from evaluation.reporting.amounts import PERCENT, bare_percent, round_percent
from evaluation.reporting.charts import Point
from evaluation.reporting.headline import Headline
from evaluation.reporting.names import robot_subject, task_phrase

NEARLY_EQUAL: Final = 0.02  # Difference in PLR that counts as none.


def missed_conflicts(table: Headline, where: MechanismLevel) -> str:
    """Tell the share of conflicts that the first robot misses, beside raw positions."""
    if not table.robots:
        return ""
    robot = table.robots[0]
    subject = robot_subject(robot.measure.consumer)
    rate, raw = table.at(where, robot), table.at(AT_RAW, robot)
    if rate is None:
        return ""
    beside = (
        f", {bare_percent(raw)} with raw positions" if raw and where != AT_RAW else ""
    )
    name = table.name(where)
    return f"With {name}, {subject} misses {bare_percent(rate)} of conflicts{beside}."


def known_positions(table: Headline, where: MechanismLevel) -> str:
    """Tell the share of positions known at a level, as sent and after an attack."""
    sent = table.at(where, table.shared)
    if sent is None:
        return ""
    name, distance = table.name(where), f"{table.epsilon_m:g} m"
    rebuilt = table.at(where, table.attacked) if table.attacked else None
    if rebuilt is None:
        return (
            f"With {name}, {bare_percent(sent)} of positions are known to {distance}."
        )
    verb = "raises" if rebuilt.value > sent.value else "lowers"
    return (
        f"With {name}, an attack {verb} the positions known to {distance} from "
        f"{bare_percent(sent)} to {bare_percent(rebuilt)}."
    )


def linked_people(table: Headline, where: MechanismLevel) -> str:
    """Tell the share of people that the strongest linker finds, beside chance."""
    first = next((task for task in table.linked if table.at(where, task)), None)
    rank1 = table.at(where, first) if first else None
    if first is None or rank1 is None:
        return ""
    phrase = task_phrase(first.measure.reader.task)
    beside = ""
    if np.isfinite(first.chance):
        beside = f"; chance is {round_percent(PERCENT * first.chance)} %"
    return (
        f"With {table.name(where)}, an attack re-identifies"
        f" {bare_percent(rank1)} of people {phrase}{beside}."
    )


def unequal_pair(points: Sequence[Point]) -> str:
    """Tell how much linkage (y) differs between two levels of nearly equal PLR (x).

    Of all pairs whose PLR differs by at most two points, it is the pair whose linkage
    differs most.
    """
    pairs = [
        (abs(first.y.value - second.y.value), first, second)
        for first, second in combinations(points, 2)
        if abs(first.x.value - second.x.value) <= NEARLY_EQUAL
    ]
    if not pairs:
        return "No two levels of this picture have nearly the same PLR as shared."
    gap, first, second = max(pairs, key=lambda pair: pair[0])
    return (
        f"At nearly equal PLR, re-identification differs by up to {PERCENT * gap:.0f}"
        f" points: {first.name} against {second.name}."
    )


def within_limit(points: Sequence[Point], limit: float) -> str:
    """Tell how many levels stay below a limit of y, and which misses fewest conflicts (x)."""
    below = [point for point in points if point.y.value < limit]
    bound = f"{PERCENT * limit:g} %"
    if not below:
        lowest = min(points, key=lambda point: point.y.value)
        return (
            f"No level keeps PLR after attack below {bound}; the lowest is "
            f"{bare_percent(lowest.y)} with {lowest.name}."
        )
    cheapest = min(below, key=lambda point: point.x.value)
    return (
        f"{len(below)} of {len(points)} levels keep PLR after attack below {bound}; of"
        f" these, {cheapest.name} misses fewest conflicts, {bare_percent(cheapest.x)}."
    )


def on_the_front(points: Sequence[Point], noun: str) -> str:
    """Tell how many levels are on the front, and which has the lowest y, a `noun`."""
    values = np.array([(point.x.value, point.y.value) for point in points])
    lowest = min(points, key=lambda point: point.y.value)
    on_front = int(front(values).sum())
    share = f"{on_front} of {len(points)}"
    if on_front == len(points):
        share = f"All {on_front}"
    return (
        f"{share} levels are on the front; the lowest {noun} is"
        f" {bare_percent(lowest.y)}, with {lowest.name}."
    )
