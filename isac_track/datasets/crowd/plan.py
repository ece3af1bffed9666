"""Plan of the simulated plaza: the people's traits, groups, routes and stops."""

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.random import Generator

from isac_track.rng import stream
from isac_track.types import Floats, Ints


@dataclass(frozen=True, slots=True)
class CrowdSettings:
    """Scenario of the simulated crowd. The physics are constants of `model`."""

    duration_s: float = 600.0  # length of the recording
    n_people: int = 1100  # people, each with one walk in every session
    # scale of the spread of every trait: 0 makes all people the same
    trait_strength: float = 1.0
    frame_s: float = 0.4  # time between recorded positions
    substeps: int = 5  # simulated steps per recorded position
    # people may arrive this long before the start and be under way by then
    lead_s: float = 20.0
    # nobody arrives in the last seconds, so that every walk has some length
    tail_s: float = 4.0
    # x_min, y_min, x_max, y_max
    area_m: tuple[float, float, float, float] = (-6.1, -6.1, 7.5, 7.4)


# (N,) lasting traits of people: the table below.
Traits: TypeAlias = "np.recarray[Any, Any]"
TRAIT_MEDIAN_AND_SPREAD = {
    "speed_mps": (1.14, 0.24),  # desired speed when alone
    "sway_m": (0.02, 0.35),  # standard deviation of the lateral body sway,
    "sway_hz": (0.7, 0.2),  # ... its frequency
    "sway_s": (2.0, 0.3),  # ... and its coherence time
    # short stops per metre walked; scales the chance of a chat, too
    "stops_per_m": (0.065, 0.6),
    "turn_rad": (0.24, 0.6),  # standard deviation of the heading's wandering
}
"""Median and standard deviation of the logarithm, in the order of the draws:
median * exp(strength * spread * N(0, 1))."""

# Shares of arriving singles, pairs, threes and fours.
GROUP_SIZE_SHARES = (0.65, 0.28, 0.045, 0.025)
# Speed of a party over its members' mean: groups walk slower [Moussaid 2010].
GROUP_PACE = (1.0, 0.82, 0.76, 0.72)
# Standard deviation of the logarithm of a person's speed between sessions.
MOOD_SPREAD = 0.08
SPACING_M = 0.58  # Shoulder to shoulder in a group that walks abreast.
VIA_CHANCE = 0.35  # Share of parties that walk by way of a place on the plaza.
# Probability to stand there, by party size, at the median habit.
CHAT_CHANCE = (0.03, 0.14, 0.19, 0.19)
CHAT_MEDIAN_S, CHAT_SPREAD, CHAT_MAX_S = 40.0, 0.7, 180.0
STOP_MEAN_S, STOP_MIN_S = 0.9, 0.4
SIDE_CENTRES = ((0, 0.65), (1, 0.25), (1, 0.75), (2, 0.45), (3, 0.3), (3, 0.72))
"""Gates: side (0 west, 1 south, 2 east, 3 north) and centre as a share of the side."""
GATE_WIDTH = 0.4  # Width of a gate as a share of the side.
GATE_WEIGHTS = (0.2, 0.18, 0.18, 0.12, 0.16, 0.16)


@dataclass(frozen=True, eq=False, slots=True)
class Party:
    """People who walk together in a session, or a single walker."""

    members: Ints  # (K,) row of each person
    slots_m: Floats  # (K, 2) place in the formation: ahead of and left of its centre
    arrival_s: float
    # (C, 2) candidate points of entry; the clearest is taken on arrival
    entry_m: Floats
    targets_m: Floats  # (T, 2) waypoints; the last lies beyond the gate of exit
    exit_side: int
    chat_s: float  # time to stand at the first waypoint if there are two; 0 passes by
    stop_at_m: Floats  # (S,) walked distances of short stops, increasing
    stop_s: Floats  # (S,) and how long they last


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """A session: its parties, their routes and times, and the people's speeds."""

    settings: CrowdSettings
    traits: Traits
    parties: tuple[Party, ...]
    speed_mps: Floats  # (N,) desired speed in this session


def person_id(row: int) -> str:
    """Return the persistent id of a person: ``p0001`` is row 0."""
    return f"p{row + 1:04d}"


def streams(settings: CrowdSettings, seed: int, *key: str | int) -> list[Generator]:
    """Return each person's random stream, which depends on no other person."""
    return [
        stream(seed, "crowd", *key, person_id(row)) for row in range(settings.n_people)
    ]


def draw_traits(settings: CrowdSettings, *, seed: int) -> Traits:
    """Draw the traits of all people, each person's from a stream of their own."""
    columns = np.array(list(TRAIT_MEDIAN_AND_SPREAD.values()))
    everybody = streams(settings, seed, "traits")
    draws = np.array([rng.standard_normal(len(columns)) for rng in everybody])
    values = columns[:, 0] * np.exp(settings.trait_strength * columns[:, 1] * draws)
    return np.rec.fromarrays(
        values.T, dtype=[(name, float) for name in TRAIT_MEDIAN_AND_SPREAD]
    )


def plan_session(
    settings: CrowdSettings, traits: Traits, *, seed: int, session: int
) -> Plan:
    """Draw the parties, routes, arrivals and stops of a session.

    Parties are drawn anew in every session: lasting parties would identify people even
    if all traits were equal.
    """
    draws = streams(settings, seed, "session", session)
    order = np.argsort([rng.random() for rng in draws], kind="stable")
    mood = np.array([rng.standard_normal() for rng in draws])
    parties: list[Party] = []
    start = 0
    while start < settings.n_people:
        # The party's first member, in the session's order, draws for all of it.
        rng = draws[order[start]]
        size = 1 + int(np.searchsorted(np.cumsum(GROUP_SIZE_SHARES), rng.random()))
        members = order[start : start + min(size, len(GROUP_SIZE_SHARES))]
        parties.append(_party(settings, traits, members, rng))
        start += members.size
    speed_mps = traits.speed_mps * np.exp(MOOD_SPREAD * mood)
    for party in parties:
        pace = GROUP_PACE[party.members.size - 1]
        speed_mps[party.members] = speed_mps[party.members].mean() * pace
    return Plan(settings, traits, tuple(parties), speed_mps)


def _party(
    settings: CrowdSettings, traits: Traits, members: Ints, rng: Generator
) -> Party:
    """Draw route, arrival and stops of a party."""
    start_s, end_s = -settings.lead_s, settings.duration_s - settings.tail_s
    arrival_s = start_s + (end_s - start_s) * rng.random()
    weights = np.array(GATE_WEIGHTS)
    entry = int(rng.choice(weights.size, p=weights))
    sides = np.array([side for side, _ in SIDE_CENTRES])
    weights = np.where(sides == sides[entry], 0.0, weights)
    leave = int(rng.choice(weights.size, p=weights / weights.sum()))
    targets = [_gate_point(settings, leave, float(rng.random()), beyond_m=2.0)]
    low, high = np.array(settings.area_m[:2]), np.array(settings.area_m[2:])
    via = low + (high - low) * (0.2 + 0.6 * rng.random(2))
    habit = float(traits.stops_per_m[members].mean())
    usual = TRAIT_MEDIAN_AND_SPREAD["stops_per_m"][0]
    chat_s = min(
        CHAT_MEDIAN_S * float(np.exp(CHAT_SPREAD * rng.standard_normal())), CHAT_MAX_S
    )
    goes_via, chats = rng.random(2)
    stands = chats < CHAT_CHANCE[members.size - 1] * habit / usual
    if stands or goes_via < VIA_CHANCE:
        targets.insert(0, via)
    # Stops follow a Poisson process along the way, drawn well past any route's length.
    gaps_m = rng.exponential(1.0, 40) / habit
    stop_s = STOP_MIN_S + rng.exponential(STOP_MEAN_S, 40)
    return Party(
        members=members,
        slots_m=_formation(members.size),
        arrival_s=float(arrival_s),
        entry_m=np.array(
            [
                _gate_point(settings, entry, share, beyond_m=0.0)
                for share in rng.random(8)
            ]
        ),
        targets_m=np.array(targets),
        exit_side=int(sides[leave]),
        chat_s=chat_s if stands else 0.0,  # read only where there is such a place
        stop_at_m=np.cumsum(gaps_m),
        stop_s=stop_s,
    )


def _gate_point(
    settings: CrowdSettings, gate: int, share: float, *, beyond_m: float
) -> Floats:
    """Return a point (2,) of a gate, `beyond_m` outside the plaza."""
    low, high = np.array(settings.area_m[:2]), np.array(settings.area_m[2:])
    side, centre = SIDE_CENTRES[gate]
    point: Floats = low + (centre + GATE_WIDTH * (share - 0.5)) * (high - low)
    across = side % 2
    point[across] = (
        low[across] - beyond_m if side in {0, 1} else high[across] + beyond_m
    )
    return point


def _formation(size: int) -> Floats:
    """Return places, (K, 2) m, ahead and left of the centre: rows of up to three."""
    rows = [size] if size <= 3 else [size - size // 2, size // 2]  # noqa: PLR2004 - more than three abreast split
    places = [
        (-0.9 * SPACING_M * behind, SPACING_M * (place - (width - 1) / 2))
        for behind, width in enumerate(rows)
        for place in range(width)
    ]
    slots = np.array(places, dtype=np.float64)
    return np.asarray(slots - slots.mean(axis=0))
