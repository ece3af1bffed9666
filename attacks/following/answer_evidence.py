"""Evidence from the presence or absence of an answer, for the posterior adversary.

The adversary knows routes, times and the policy. For every state of a chain it asks the
policy itself: would a person who walks like this be sent? The network's forecast is
noisy and a cell is coarse, so that the policy's answer is not certain. How often it
comes true is counted on other people.
"""

from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from attacks.following.walk_chain import (
    Chain,
    ChainOptions,
    nominal_velocities,
    velocity_classes,
)
from isac_track.patrols import Patrol
from isac_track.patrols.answers import Disclosure
from isac_track.patrols.network import Network
from isac_track.patrols.utility import answer_forecasts, conflicts_in
from isac_track.policies.query import Query, View
from isac_track.policies.samples import HORIZON_S, Ahead
from isac_track.protocols import Policy, Predictor
from isac_track.rng import stream
from isac_track.types import Bools, Floats, Ints, Prediction

Levels: TypeAlias = NDArray[np.uint8]
"""Levels of agreement of a state's neighbourhood with being sent, 0 to 4."""
_LEVEL_EDGES: Final = (1e-9, 1.0 / 3.0, 2.0 / 3.0, 1.0 - 1e-9)
_N_LEVELS: Final = len(_LEVEL_EDGES) + 1
_NEIGHBOURS: Final = (
    3  # Cells along an axis over which the policy's answer is averaged.
)
_EVERY: Final = 4  # Of the scans of a forecast; the others add little.
_AROUND: Final = 2  # Scans before and after a query that give a true velocity.


@dataclass(frozen=True, eq=False, slots=True)
class Answers:
    """Which answers count as positive for each presence, and the rule behind them."""

    positive: Bools  # (E, R)
    policy: Policy  # Selects the states for which an answer would be positive.

    @property
    def is_constant(self) -> bool:
        """Whether all answers are equal, so that they tell nothing."""
        return bool(self.positive.all() or not self.positive.any())


def sent_answers(network: Network, disclosure: Disclosure, policy: Policy) -> Answers:
    """Return whether each robot was sent something of each present person."""
    n_pairs, n_robots = len(network.patrol.presences), network.patrol.n_robots
    positive = np.zeros((n_pairs, n_robots), dtype=bool)
    positive[disclosure.presence, disclosure.robot] = True
    return Answers(positive, policy)


def flag_answers(
    network: Network,
    disclosure: Disclosure,
    *,
    predictor: Predictor,
    safety_radius_m: float,
    horizon: int,
    is_named: bool,
) -> Answers:
    """Return the flags of a disclosure: yes if anybody comes inside within a horizon.

    The horizon is in scans. With `is_named` the adversary learns of every person
    whether she raised the flag: a ceiling.
    """
    patrol = network.patrol
    forecasts = answer_forecasts(network, disclosure, predictor)
    wait = conflicts_in(patrol, forecasts, safety_radius_m=safety_radius_m)
    positive = wait <= horizon
    if not is_named:
        anybody = np.zeros((patrol.query_scan.size, patrol.n_robots), dtype=bool)
        np.logical_or.at(anybody, patrol.presences.query, positive)
        positive = anybody[patrol.presences.query]
    horizon_s = min(HORIZON_S, float(patrol.ahead_s[horizon]))
    return Answers(positive, Ahead(safety_radius_m, horizon_s=horizon_s))


def state_levels(
    patrol: Patrol, chain: Chain, policy: Policy, *, options: ChainOptions, seed: int
) -> Levels:
    """Return how far the policy would send a person in each state, (Q, R, S).

    Level 0: nobody in the state or in the cells around it would be sent; 4: everybody.
    Only the grid of the chain counts; people walk on with the nominal velocities.
    """
    velocities = nominal_velocities(options)
    ahead = slice(None, None, _EVERY)
    ahead_s = patrol.ahead_s[ahead]
    xy = np.tile(chain.centres(), (len(velocities), 1))
    velocity = np.repeat(velocities, chain.n_cells, axis=0)
    mean = xy[:, None, :] + ahead_s[:, None] * velocity[:, None, :]
    view = View(xy, Prediction(mean, np.zeros((*mean.shape, 2))))
    offsets = np.arange(len(xy) + 1)
    shape = patrol.query_scan.size, patrol.n_robots, len(xy)
    levels = np.zeros(shape, dtype=np.uint8)
    for number, now in enumerate(patrol.query_scan.tolist()):
        t = np.full(len(xy), patrol.scan_s[now])
        for robot in range(patrol.n_robots):
            route = patrol.robot_xy[robot, now : now + patrol.ahead_s.size]
            query = Query(
                t=t,
                offsets=offsets,
                raw=view,
                shared=view,
                robot_xy=route[ahead],
                ahead_s=ahead_s,
                rng=stream(seed, "following", "levels", robot, number),
            )
            selected = np.asarray(policy.select(query), dtype=np.float32)
            near = uniform_filter(
                selected.reshape(-1, *chain.shape), (0, _NEIGHBOURS, _NEIGHBOURS)
            )
            levels[number, robot] = np.digitize(near.ravel(), _LEVEL_EDGES)
    return levels


def presence_states(patrol: Patrol, chain: Chain, options: ChainOptions) -> Ints:
    """Return the true state of each present person at each query, (E,)."""
    people, pairs = patrol.people, patrol.presences
    first, last = people.offsets[pairs.person], people.offsets[pairs.person + 1] - 1
    before = np.maximum(pairs.sample - _AROUND, first)
    after = np.minimum(pairs.sample + _AROUND, last)
    span_s = np.maximum(people.t[after] - people.t[before], 1e-9)
    velocity = (people.xy[after] - people.xy[before]) / span_s[:, None]
    kind = velocity_classes(velocity, options)
    return kind * chain.n_cells + chain.cells_at(people.xy[pairs.sample])


def positive_rates(
    answers: Answers, levels: Levels, *, query: Ints, state: Ints, rows: Bools
) -> Floats:
    """Return the probability of a positive answer at each level, (5,).

    It is counted on some presences: `rows`, (E,), with `query` and true `state`, (E,).
    """
    level = levels[query[rows], :, state[rows]]  # (E', R)
    total = np.bincount(level.ravel(), minlength=_N_LEVELS)
    hits = np.bincount(level[answers.positive[rows]], minlength=_N_LEVELS)
    return np.asarray((hits + 0.5) / (total + 1.0))
