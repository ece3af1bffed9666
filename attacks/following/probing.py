"""Probing: queries about routes that no robot walks, to learn where a person is.

The adversary knows where a target is at an instant. It then invents a route, asks, and
chooses the next route by the answer (`belief`). Under a policy that sends samples it
asks where it most likely meets the target; under a flag it asks what tells it most,
which halves its belief.

Two countermeasures. A *commitment* fixes the route of a robot for some seconds ahead,
so that the adversary can only continue a route. A *limit* refuses queries above a rate.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.random import Generator
from scipy.special import ndtr

from attacks.following.belief import (
    Belief,
    Crowd,
    Motion,
    make_crowd,
    route_gaps,
    standing_gaps,
    updated_by_flag,
    updated_by_states,
)
from attacks.following.logs import first_half
from attacks.following.walk_chain import walk_states
from isac_track.errors import DataError
from isac_track.patrols import Patrol
from isac_track.patrols.answers import Network
from isac_track.policies.query import Query, View
from isac_track.policies.samples import Ahead
from isac_track.protocols import Policy
from isac_track.rng import stream
from isac_track.types import Bools, Floats, Ints, Prediction, squared_lengths

_MAP_STATES: Final = 1500  # States of other people that stand for the map.
_STEP_S: Final = 0.5  # Around an instant, for the velocities of other people.
_LATE_S: Final = 1.0  # Of the start after a person's first instant.
_LEAST_S: Final = 10.0  # Time for which a target is present after its start.
_BEGIN_M: Final = 5.0  # Distance at which a committed robot begins.
_FIT_SCANS: Final = 15  # Scans before the last of the samples that are sent.


@dataclass(frozen=True, slots=True)
class ProbingOptions:
    """Parameters of an adversary who probes."""

    motion: Motion = field(default_factory=Motion)
    n_particles: int = 300
    n_routes: int = 32  # Routes among which each probe is chosen.
    soft_m: float = 0.2  # Error of the assumed distance to a route.
    longest_s: float = 30.0  # Time after the start that is scored.
    robot_speed_mps: float = 1.4  # Of a committed robot.


@dataclass(frozen=True, slots=True)
class Rules:
    """Countermeasures of a network; None: without."""

    commitment_s: float | None = None  # Time for which a route is fixed ahead.
    limit_per_s: float | None = None  # Answers per second; more queries are refused.


@dataclass(frozen=True, eq=False, slots=True)
class Probed:
    """Result of probing P targets."""

    instants: Ints  # (P,) scored instants of each target.
    known: Ints  # (P,) instants at which the target's place is known.
    claimed: Floats  # (P,) sum of the stated probabilities.
    answered: Ints  # (P,) queries that were answered.


@dataclass(frozen=True, eq=False, slots=True)
class _Scene:
    """People present at a query, as the network sees them."""

    t: float
    samples: Ints  # (P,) last sample of each.
    view: View


@dataclass(frozen=True, eq=False, slots=True)
class _Task:
    """What the probes of all targets have in common."""

    network: Network
    policy: Ahead  # The rule that decides who is sent, or who raises a flag.
    is_flag: bool
    rules: Rules
    options: ProbingOptions
    epsilon_m: float
    probes_per_s: float

    @property
    def horizon_s(self) -> float:
        """Horizon of the rule, s."""
        return self.policy.horizon_s


def choose_probed(patrol: Patrol, *, n_people: int, seed: int) -> Ints:
    """Draw people who stay long enough to be probed, rising (P,); DataError if none."""
    grid = patrol.grid
    stay_s = grid.t[grid.offsets[1:] - 1] - grid.t[grid.offsets[:-1]]
    people = np.flatnonzero(stay_s >= _LATE_S + _LEAST_S)
    if not people.size:
        raise DataError(
            f"nobody of {len(grid)} people stays the {_LATE_S + _LEAST_S:g} s that a"
            " target of probes needs; record longer"
        )
    rng = stream(seed, "following", "probing", "targets")
    return np.sort(rng.permutation(people)[:n_people])


def probe_targets(
    network: Network,
    policy: Policy,
    *,
    targets: Ints,
    probes_per_s: float,
    rules: Rules,
    safety_radius_m: float,
    epsilon_m: float,
    options: ProbingOptions,
    seed: int,
) -> Probed:
    """Probe P people, one after the other.

    The answer to a probe is that of the patrol's last query instant before it. With a
    rate of 0 the adversary only extrapolates from the start. DataError for a policy
    other than `ahead` and `flag`, or without other people to learn from.
    """
    patrol = network.patrol
    is_flag = policy.form == "flag"
    rule = Ahead(safety_radius_m) if is_flag else policy
    if not isinstance(rule, Ahead):
        raise DataError("probing is defined for the policies ahead and flag")
    if rules.limit_per_s is not None:
        probes_per_s = min(probes_per_s, rules.limit_per_s)
    task = _Task(network, rule, is_flag, rules, options, epsilon_m, probes_per_s)
    is_first = first_half(patrol.people.group)
    crowds = {
        half: _learn_crowd(task, people=is_first != half, seed=seed)
        for half in np.unique(is_first[targets]).tolist()
    }
    results = [
        _probe_target(
            task,
            target,
            crowd=crowds[bool(is_first[target])],
            rng=stream(seed, "following", "probing", target, f"{probes_per_s:g}"),
        )
        for target in targets.tolist()
    ]
    instants, known, claimed, answered = np.array(results, dtype=np.float64).T
    return Probed(
        instants.astype(np.int64),
        known.astype(np.int64),
        claimed,
        answered.astype(np.int64),
    )


def _learn_crowd(task: _Task, *, people: Bools, seed: int) -> Crowd:
    """Return the crowd of some people, (N,); DataError if they are too few."""
    patrol = task.network.patrol
    grid_s = float(np.min(np.diff(patrol.grid.t)[np.diff(patrol.grid.t) > 0.0]))
    states = walk_states(patrol.grid, people=people, step_s=_STEP_S, grid_s=grid_s)
    if not len(states.xy):
        raise DataError(
            "the adversary who probes learns from other people, and there are none in"
            " the other half of the groups; record more people"
        )
    rng = stream(seed, "following", "probing", "crowd")
    rows = rng.permutation(len(states.xy))[:_MAP_STATES]
    return make_crowd(
        states.xy[rows],
        states.velocity_mps[rows],
        n_present=len(patrol.presences) / patrol.query_scan.size,
        margin_m=task.policy.metres,
        horizon_s=task.horizon_s,
        soft_m=task.options.soft_m,
    )


def _probe_target(
    task: _Task, target: int, *, crowd: Crowd, rng: Generator
) -> tuple[float, ...]:
    """Return instants, known instants, stated probabilities and answers of a target."""
    grid, options = task.network.patrol.grid, task.options
    t = grid.t[grid.offsets[target] : grid.offsets[target + 1]]
    xy = grid.xy[grid.offsets[target] : grid.offsets[target + 1]]
    start = int(np.searchsorted(t, t[0] + _LATE_S - 1e-9))
    belief = Belief(
        float(t[start]),
        np.repeat(xy[start : start + 1], options.n_particles, axis=0),
        rng.choice(crowd.velocity_mps, options.n_particles),
    )
    routes = _invent_routes(task, float(t[start]), xy[start], rng)
    asked_s = _probe_times(float(t[start]), float(t[-1]), task.probes_per_s)
    due_s = next(asked_s, np.inf)
    n_known, claimed, n_answered = 0, 0.0, 0
    last = int(np.searchsorted(t, t[start] + options.longest_s, side="right"))
    for row in range(start + 1, last):
        while due_s <= t[row]:
            belief = belief.moved(due_s, crowd.velocity_mps, options.motion, rng)
            belief = _ask(task, belief, routes, crowd=crowd, rng=rng)
            n_answered += 1
            due_s = next(asked_s, np.inf)
        belief = belief.moved(float(t[row]), crowd.velocity_mps, options.motion, rng)
        if routes is not None:
            routes.follow(belief)
        place, share = belief.best_place(task.epsilon_m)
        n_known += bool(squared_lengths(place - xy[row]) < task.epsilon_m**2)
        claimed += share
    return float(last - start - 1), float(n_known), claimed, float(n_answered)


def _probe_times(start_s: float, end_s: float, per_s: float) -> Iterator[float]:
    """Yield the times of probes after a start, s."""
    number = 1
    while per_s > 0.0 and start_s + number / per_s <= end_s:
        yield start_s + number / per_s
        number += 1


@dataclass(slots=True)
class CommittedRoute:
    """The route of a single robot, which it can only continue; it grows by `follow`."""

    t: list[float]  # s, rising.
    xy: list[Floats]  # (2,) m
    ahead_s: float  # Time for which the route is fixed.
    speed_mps: float

    def follow(self, belief: Belief) -> None:
        """Continue the route towards where the target is expected to be."""
        aim = (belief.xy + self.ahead_s * belief.velocity_mps).mean(axis=0)
        end_s = belief.t + self.ahead_s
        way = aim - self.xy[-1]
        length = float(np.hypot(way[0], way[1]))
        reach = self.speed_mps * max(end_s - self.t[-1], 0.0)
        self.xy.append(self.xy[-1] + way * min(1.0, reach / max(length, 1e-9)))
        self.t.append(end_s)

    def places(self, t: Floats) -> Floats:
        """Return the places at times, (H,) s -> (H, 2) m."""
        xy = np.array(self.xy)
        return np.stack([np.interp(t, self.t, xy[:, axis]) for axis in range(2)], 1)


def _invent_routes(
    task: _Task, start_s: float, xy: Floats, rng: Generator
) -> CommittedRoute | None:
    """Return the robot of an adversary bound by a commitment, or None."""
    if task.rules.commitment_s is None:
        return None
    angle = 2.0 * np.pi * rng.random()
    place = xy + _BEGIN_M * np.array([np.cos(angle), np.sin(angle)])
    end_s = start_s + task.rules.commitment_s
    return CommittedRoute(
        [start_s, end_s],
        [place, place],
        task.rules.commitment_s,
        task.options.robot_speed_mps,
    )


def _ask(
    task: _Task,
    belief: Belief,
    committed: CommittedRoute | None,
    *,
    crowd: Crowd,
    rng: Generator,
) -> Belief:
    """Return the belief after a probe."""
    patrol = task.network.patrol
    scene = _scene_at(task.network, belief.t)
    if committed is None:
        place = _choose_place(task, belief, crowd=crowd, rng=rng)
        route = np.repeat(place[None], patrol.ahead_s.size, axis=0)
        gap_m = standing_gaps(
            place[None], belief.xy, belief.velocity_mps, task.horizon_s
        )[0]
        others = float(crowd.at(crowd.near_standing, place[None])[0])
    else:
        route = committed.places(belief.t + patrol.ahead_s)
        ahead_s = patrol.ahead_s[patrol.ahead_s <= task.horizon_s]
        used = route[: ahead_s.size]
        gap_m = route_gaps(used, ahead_s, belief.xy, belief.velocity_mps)
        crowd_gap_m = route_gaps(used, ahead_s, crowd.xy, crowd.velocity_mps)
        others = crowd.n_present * float(_inside(task, crowd_gap_m).mean())
    selected = _selected_people(task, scene, route)
    inside = _inside(task, gap_m)
    if task.is_flag:
        return updated_by_flag(
            belief, inside, others=others, is_yes=bool(selected.any()), rng=rng
        )
    xy, velocity = _sent_states(task.network, scene.samples[selected])
    return updated_by_states(
        belief, inside, xy=xy, velocity_mps=velocity, crowd=crowd, rng=rng
    )


def _inside(task: _Task, gap_m: Floats) -> Floats:
    """Return the probability that the rule selects people at distances."""
    return np.asarray(ndtr((task.policy.metres - gap_m) / task.options.soft_m))


def _choose_place(
    task: _Task, belief: Belief, *, crowd: Crowd, rng: Generator
) -> Floats:
    """Return where an invented robot stands, (2,) m.

    Of random places near the particles' ways it is, for samples, the likeliest to meet
    the target; for a flag, the most informative about the target.
    """
    row = rng.integers(len(belief.xy), size=task.options.n_routes)
    late_s = task.horizon_s * rng.random(row.size)
    angle = 2.0 * np.pi * rng.random(row.size)
    away = 1.5 * task.policy.metres * rng.random(row.size)
    places = belief.xy[row] + late_s[:, None] * belief.velocity_mps[row]
    places += away[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    gap_m = standing_gaps(places, belief.xy, belief.velocity_mps, task.horizon_s)
    meets = _inside(task, gap_m).mean(axis=1)
    others = crowd.at(crowd.near_standing, places)
    if not task.is_flag:
        # Among places that meet the target for sure, the emptier is better.
        return np.asarray(places[(meets - 0.02 * others).argmax()])
    by_others = 1.0 - np.exp(-others)
    yes = meets + (1.0 - meets) * by_others
    information = _bits(yes) - (1.0 - meets) * _bits(by_others)
    return np.asarray(places[information.argmax()])


def _bits(probability: Floats) -> Floats:
    """Return the entropy of a yes or no, bits."""
    p = np.clip(probability, 1e-12, 1.0 - 1e-12)
    return np.asarray(-p * np.log2(p) - (1.0 - p) * np.log2(1.0 - p))


def _scene_at(network: Network, t: float) -> _Scene:
    """Return the people present at the last query instant up to a time."""
    patrol = network.patrol
    query_s = patrol.scan_s[patrol.query_scan]
    number = max(int(np.searchsorted(query_s, t + 1e-9, side="right")) - 1, 0)
    rows = slice(*np.searchsorted(patrol.presences.query, [number, number + 1]))
    samples = patrol.presences.sample[rows]
    forecast = Prediction(network.raw_forecast.mean[rows], None)
    return _Scene(
        float(query_s[number]), samples, View(network.sensed.xy[samples], forecast)
    )


def _selected_people(task: _Task, scene: _Scene, route: Floats) -> Bools:
    """Return whom the rule selects for a robot on a route, (P,)."""
    n_people, patrol = scene.samples.size, task.network.patrol
    if not n_people:
        return np.zeros(0, dtype=bool)
    query = Query(
        t=np.full(n_people, scene.t),
        offsets=np.arange(n_people + 1),
        raw=scene.view,
        shared=scene.view,
        robot_xy=route,
        ahead_s=patrol.ahead_s,
        rng=np.random.default_rng(0),  # Neither rule draws.
    )
    return task.policy.select(query)


def _sent_states(network: Network, samples: Ints) -> tuple[Floats, Floats]:
    """Return place and velocity from the samples that are sent, (J, 2) each.

    They are a line through the last samples of each person.
    """
    people, release = network.patrol.people, network.release
    xy, velocity = np.zeros((samples.size, 2)), np.zeros((samples.size, 2))
    for row, last in enumerate(samples.tolist()):
        owner = int(np.searchsorted(people.offsets, last, side="right")) - 1
        first = max(int(people.offsets[owner]), last - _FIT_SCANS)
        late_s = release.t[first : last + 1] - release.t[last]
        shared = release.xy[first : last + 1]
        middle_s = late_s.mean()
        spread = float(((late_s - middle_s) ** 2).sum())
        if spread > 0.0:
            velocity[row] = (late_s - middle_s) @ shared / spread
        xy[row] = shared.mean(axis=0) - middle_s * velocity[row]
    return xy, velocity
