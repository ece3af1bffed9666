"""Motion of simulated people: anticipatory social forces, Ornstein-Uhlenbeck noise.

References
----------
Helbing and Molnar, Phys. Rev. E 51, 4282 (1995): relaxation to a desired velocity and
an exponential repulsion at contact. Karamouzas, Skinner and Guy, Phys. Rev. Lett. 113,
238701 (2014): interaction energy ``k / tau^2 exp(-tau / tau_0)`` in the time to
collision tau. Moussaid, Perozo, Garnier, Helbing and Theraulaz, PLoS ONE 5, e10047
(2010): walking groups.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from isac_track.datasets.crowd.plan import Plan, streams
from isac_track.types import Bools, Floats, Ints, lengths

RELAXATION_S = 0.6  # Time to reach the desired velocity.
# k of the time-to-collision law, in m^2 (energy over mass times time squared).
ENERGY_M2 = 1.2
FORESIGHT_S = 3.0  # tau_0 of the same law.
COLLISION_M = 0.4  # Distance of two centres that counts as a collision.
# Cap of one neighbour's anticipatory force: the law diverges at contact.
AVOID_MAX_MPS2 = 2.0
# The exponential repulsion: strength, distance, range.
CONTACT_MPS2, CONTACT_M, CONTACT_RANGE_M = 2.0, 0.36, 0.1
# Spring to a member's place in the formation, and its cap.
FORMATION_PER_S2, FORMATION_MAX_MPS2 = 1.2, 1.2
# Ornstein-Uhlenbeck noise of the speed: standard deviation, correlation time.
PACE_MPS, PACE_S = 0.18, 1.2
WANDER_S = 1.8  # Correlation time of the heading's wandering; its size is a trait.
# Less 0.1 m/s; slower people hold their heading up to three times less well.
STEADY_MPS = 0.9
# Smoothing time of the body's orientation, which the sway is lateral to.
HEADING_S = 0.6
STANDING = 0.08  # Share of pace noise and sway that a standing person keeps.
FULL_SWAY_MPS = 0.6  # Speed from which on the body sways in full.
TOP_SPEED_MPS = 2.0
# Noise may turn a slow walk into a step back, but no further than this.
BACKWARD_MPS = 0.1
REACHED_M = 1.2  # Distance at which a waypoint counts as reached.
LOST_M = 3.0  # A person who strays this far off the plaza has left it.
# Rounded to 1 um a step: chaos must not amplify the last bits of another machine.
GRID_DIGITS = 6

_Records: TypeAlias = NDArray[np.void]
_PERSON = np.dtype(
    [
        ("xy", float, 2),  # m, without sway
        ("v", float, 2),  # m/s
        ("heading", float, 2),  # unit vector
        # The next three are Ornstein-Uhlenbeck noise of unit variance.
        ("pace", float),
        ("wander", float),
        ("sway", complex),  # in both parts
        ("here", bool),  # on the plaza now; if not, other fields are out of date
        ("party", int),  # number of the party
        ("slot", float, 2),  # m, place in the formation: ahead, left
    ]
)
_PARTY = np.dtype(
    [
        ("target", int),  # current waypoint
        ("walked_m", float),  # mean over the members who are on the plaza
        ("next_stop", int),
        ("stand_until_s", float),  # standing before this time
    ]
)


@dataclass(frozen=True, eq=False, slots=True)
class RecordedFrames:
    """M recorded positions, frame after frame."""

    frame: Ints  # (M,) in order
    person: Ints  # (M,) row of the person
    xy: Floats  # (M, 2) m, of the body with its sway


def simulate(plan: Plan, *, seed: int, session: int) -> RecordedFrames:
    """Walk everybody across the plaza."""
    settings = plan.settings
    crowd = np.zeros(settings.n_people, dtype=_PERSON)
    progress = np.zeros(len(plan.parties), dtype=_PARTY)
    progress["stand_until_s"] = -np.inf
    noise = streams(settings, seed, "noise", session)
    for number, party in enumerate(plan.parties):
        crowd["party"][party.members] = number
        crowd["slot"][party.members] = party.slots_m
    arrival_s = np.array([party.arrival_s for party in plan.parties])
    arrival_frame = np.maximum(0, np.ceil(arrival_s / settings.frame_s))
    frames, people, places = [], [], []
    # The first frame is at time 0.
    for frame in range(round(settings.duration_s / settings.frame_s) + 1):
        for arrived in np.flatnonzero(arrival_frame == frame):
            _enter(crowd, plan, int(arrived), noise)
        rows = np.flatnonzero(crowd["here"])
        frames.append(np.full(rows.size, frame))
        people.append(rows)
        # A recorded position is the walker's, shifted to the side by the sway.
        heading, v = crowd["heading"][rows], crowd["v"][rows]
        side = np.stack([-heading[:, 1], heading[:, 0]], axis=1)
        awake = STANDING + (1 - STANDING) * np.minimum(lengths(v) / FULL_SWAY_MPS, 1.0)
        offset = plan.traits.sway_m[rows] * awake * crowd["sway"][rows].real
        places.append(crowd["xy"][rows] + offset[:, None] * side)
        if rows.size:
            _advance(crowd, progress, plan, rows, noise, frame)
    return RecordedFrames(
        frame=np.concatenate(frames),
        person=np.concatenate(people),
        xy=np.concatenate(places),
    )


def _enter(crowd: _Records, plan: Plan, number: int, noise: list[Generator]) -> None:
    """Put a party at its clearest entry, or part-way if it came before the start."""
    party = plan.parties[number]
    rows, entries, first = party.members, party.entry_m, party.targets_m[0]
    if party.arrival_s < 0:
        way_share = np.linspace(0.05, 0.85, len(entries))[:, None]
        entries = entries + way_share * (first - entries)
    others = crowd["xy"][crowd["here"]]
    gap = lengths(entries[:, None] - others[None]).min(axis=1, initial=2.0)
    entry = entries[int(np.argmax(gap))]
    ahead = (first - entry) / lengths(first - entry)
    draws = np.array([noise[row].standard_normal(4) for row in rows]).T
    crowd["pace"][rows], crowd["wander"][rows] = draws[:2]
    crowd["sway"][rows] = draws[2] + 1j * draws[3]
    crowd["xy"][rows] = entry + _turned(party.slots_m, ahead)
    crowd["heading"][rows], crowd["here"][rows] = ahead, True
    crowd["v"][rows] = ahead * plan.speed_mps[rows, None]


def _advance(
    crowd: _Records,
    progress: _Records,
    plan: Plan,
    rows: Ints,
    noise: list[Generator],
    frame: int,
) -> None:
    """Move the people in `rows` by one frame; people who have arrived leave."""
    settings, traits = plan.settings, plan.traits
    dt = settings.frame_s / settings.substeps
    draws = np.stack(
        [noise[row].standard_normal((settings.substeps, 4)) for row in rows], axis=1
    )
    parties, local = np.unique(crowd["party"][rows], return_inverse=True)
    head_count = np.bincount(local)
    slot = crowd["slot"][rows]
    slot = slot - (_sum_by(local, slot) / head_count[:, None])[local]
    speed = plan.speed_mps[rows]
    keep_pace, keep_wander = np.exp(-dt / PACE_S), np.exp(-dt / WANDER_S)
    keep_sway = np.exp(
        (-1.0 / traits.sway_s[rows] + 2j * np.pi * traits.sway_hz[rows]) * dt
    )
    kick_sway = np.sqrt(1.0 - np.abs(keep_sway) ** 2)
    for step in range(settings.substeps):
        now_s = frame * settings.frame_s + step * dt
        x, v, heading = crowd["xy"][rows], crowd["v"][rows], crowd["heading"][rows]
        centre = _sum_by(local, x) / head_count[:, None]
        target = _steer(progress, plan, parties, centre, now_s)
        standing = (progress["stand_until_s"][parties] > now_s)[local]

        xi = draws[step]
        pace = keep_pace * crowd["pace"][rows] + np.sqrt(1.0 - keep_pace**2) * xi[:, 0]
        wander = (
            keep_wander * crowd["wander"][rows]
            + np.sqrt(1.0 - keep_wander**2) * xi[:, 1]
        )
        sway = keep_sway * crowd["sway"][rows] + kick_sway * (xi[:, 2] + 1j * xi[:, 3])

        ahead = _unit(target[local] - centre[local])
        # The heading of slow people wanders more than by the trait alone.
        unsteady = np.minimum(STEADY_MPS / (lengths(v) + 0.1), 3.0)
        angle = traits.turn_rad[rows] * wander * unsteady
        course = _turned(np.stack([np.cos(angle), np.sin(angle)], axis=1), ahead)
        desired = np.where(
            standing, STANDING * PACE_MPS * pace, speed + PACE_MPS * pace
        )
        desired = np.maximum(desired, -BACKWARD_MPS)
        force = (desired[:, None] * course - v) / RELAXATION_S
        force += _avoidance(x, v, together=local[:, None] == local[None, :])
        front = _unit(_sum_by(local, heading))
        place = FORMATION_PER_S2 * (centre[local] + _turned(slot, front[local]) - x)
        force += _capped(place, FORMATION_MAX_MPS2)

        v = _capped(v + dt * force, TOP_SPEED_MPS)
        heading = _unit(heading + (dt / HEADING_S) * v)
        moved = dt * v
        state = {"xy": x + moved, "v": v, "heading": heading}
        state |= {"pace": pace, "wander": wander, "sway": sway}
        for name, value in state.items():
            crowd[name][rows] = np.round(value, GRID_DIGITS)
        moved_m = np.bincount(local, lengths(moved)) / head_count
        walked_m = progress["walked_m"][parties] + moved_m
        progress["walked_m"][parties] = np.round(walked_m, GRID_DIGITS)
    _leave(crowd, plan, rows)


def _leave(crowd: _Records, plan: Plan, rows: Ints) -> None:
    """Remove people who are beyond the plaza's side of their gate, or lost."""
    x_min, y_min, x_max, y_max = plan.settings.area_m
    px, py = crowd["xy"][rows].T
    beyond = np.stack([x_min - px, y_min - py, px - x_max, py - y_max])
    sides = np.array(
        [plan.parties[number].exit_side for number in crowd["party"][rows]]
    )
    has_left = (beyond[sides, np.arange(rows.size)] > 0) | (beyond.max(axis=0) > LOST_M)
    crowd["here"][rows[has_left]] = False


def _steer(
    progress: _Records, plan: Plan, parties: Ints, centre: Floats, now_s: float
) -> Floats:
    """Return each party's current waypoint, (G, 2) m; begin and end its stops."""
    target = np.empty((parties.size, 2))
    for place, number in enumerate(parties):
        party = plan.parties[number]
        state = progress[number]  # A view: assignments change `progress`.
        aim = party.targets_m[state["target"]]
        on_the_way = state["target"] < len(party.targets_m) - 1
        if on_the_way and lengths(aim - centre[place]) < REACHED_M:
            state["target"] += 1
            aim = party.targets_m[state["target"]]
            state["stand_until_s"] = now_s + party.chat_s
        stop = state["next_stop"]
        if stop < party.stop_at_m.size and state["walked_m"] >= party.stop_at_m[stop]:
            state["next_stop"] += 1
            state["stand_until_s"] = max(
                state["stand_until_s"], now_s + party.stop_s[stop]
            )
        target[place] = aim
    return target


def _avoidance(x: Floats, v: Floats, *, together: Bools) -> Floats:
    """Return the acceleration, (P, 2), away from future collisions and from contact.

    For a pair with separation ``x``, relative velocity ``v`` and collision distance
    ``R``, the time to collision is ``tau = (b - sqrt(d)) / a`` with ``a = v.v``, ``b =
    -x.v``, ``c = x.x - R^2`` and ``d = b^2 - a c``, and the force is minus the gradient
    of ``k / tau^2 exp(-tau / tau_0)``. People who walk together do not anticipate
    collisions with each other.
    """
    dx = x[:, None] - x[None]
    dv = v[:, None] - v[None]
    apart = (dx**2).sum(axis=2)
    distance = np.sqrt(apart)
    np.fill_diagonal(distance, np.inf)
    contact = CONTACT_MPS2 * np.exp((CONTACT_M - distance) / CONTACT_RANGE_M) / distance
    total = (np.minimum(contact, 50.0)[:, :, None] * dx).sum(axis=1)

    a = (dv**2).sum(axis=2)
    b = -(dx * dv).sum(axis=2)
    # People closer than the collision distance still avoid coming closer.
    radius = np.minimum(COLLISION_M, 0.95 * np.minimum(distance, 1e3))
    d = b**2 - a * (apart - radius**2)
    coming = (b > 0) & (d > 1e-9) & (a > 1e-6) & ~together  # noqa: PLR2004 - rounding
    i, j = np.nonzero(coming)
    a, b, root = a[i, j], b[i, j], np.sqrt(d[i, j])
    tau = np.maximum((b - root) / a, 0.05)
    dx, dv = dx[i, j], dv[i, j]
    strength = (
        ENERGY_M2
        * np.exp(-tau / FORESIGHT_S)
        / (a * tau**2)
        * (2 / tau + 1 / FORESIGHT_S)
    )
    sideways = (a[:, None] * dx + b[:, None] * dv) / root[:, None]
    push = _capped(-strength[:, None] * (dv - sideways), AVOID_MAX_MPS2)
    return np.asarray(total + _sum_by(i, push, n=len(x)))


def _turned(vector: Floats, ahead: Floats) -> Floats:
    """Turn vectors given as (ahead, left) to the plane's axes; `ahead` has length 1."""
    left = np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
    return np.asarray(vector[..., :1] * ahead + vector[..., 1:] * left)


def _unit(vector: Floats) -> Floats:
    return np.asarray(vector / np.maximum(lengths(vector), 1e-9)[:, None])


def _capped(vector: Floats, longest: float) -> Floats:
    length = lengths(vector)
    return np.asarray(
        vector * np.minimum(1.0, longest / np.maximum(length, 1e-12))[:, None]
    )


def _sum_by(label: Ints, vector: Floats, *, n: int = 0) -> Floats:
    """Return the sums (G, 2) of the vectors that share a label."""
    return np.stack(
        [np.bincount(label, vector[:, k], minlength=n) for k in (0, 1)], axis=1
    )
