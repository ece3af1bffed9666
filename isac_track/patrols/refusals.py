"""The cost of a route commitment for robots that ask in good faith.

A network that answers only about routes which were fixed some time ahead refuses a
robot that has just changed its route. A robot changes it when it foresees a conflict.
"""

import numpy as np

from isac_track.patrols.patrol import Patrol
from isac_track.patrols.utility import Counts
from isac_track.types import TIME_TOLERANCE_S, Bools, Ints


def refused_queries(
    patrol: Patrol, foreseen: Ints, *, horizon: int, commitment_s: float
) -> Bools:
    """Return which queries are refused under a commitment, (Q, R).

    A robot changes its route at each answered query at which it foresees a conflict
    within the horizon, in scans. For `commitment_s` after that it gets no answer.
    `foreseen` is (E, R), as of `foreseen_conflicts`.
    """
    n_queries = patrol.query_scan.size
    alarm = np.zeros((n_queries, patrol.n_robots), dtype=bool)
    np.logical_or.at(alarm, patrol.presences.query, foreseen <= horizon)
    query_s = patrol.scan_s[patrol.query_scan]
    refused = np.zeros_like(alarm)
    for robot in range(patrol.n_robots):
        free_s = -np.inf
        for number in range(n_queries):
            if query_s[number] < free_s - TIME_TOLERANCE_S:
                refused[number, robot] = True
            elif alarm[number, robot]:
                free_s = query_s[number] + commitment_s
    return refused


def refused_conflicts(
    patrol: Patrol, actual: Ints, foreseen: Ints, refused: Bools, *, horizon: int
) -> Counts:
    """Count future conflicts that a robot would foresee at a query that is refused.

    `actual` and `foreseen` are (E, R) scans, `refused` (Q, R). Trials are the future
    conflicts within the horizon that the robot foresees.
    """
    is_future = (actual > 0) & (actual <= horizon) & (foreseen <= horizon)
    return Counts(hits=refused[patrol.presences.query], trials=is_future)
