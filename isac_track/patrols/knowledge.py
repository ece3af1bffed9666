"""How much of people's time an adversary knows from the log of a fleet of robots.

This adversary knows which entries of the log belong to the same person: a ceiling. It
estimates the position of every present person at every instant. An instant is known if
the estimate lies within epsilon of the truth.
"""

from dataclasses import dataclass

import numpy as np

from isac_track.patrols.answers import Disclosure
from isac_track.patrols.estimators import ESTIMATORS, estimate_positions
from isac_track.patrols.fleet_logs import Log, fleet_log
from isac_track.patrols.network import Network
from isac_track.patrols.patrol import Patrol
from isac_track.patrols.walked_map import map_guesses
from isac_track.types import Bools, Floats, Ints, squared_lengths


@dataclass(frozen=True, eq=False, slots=True)
class FleetKnown:
    """Knowledge of a fleet about N people, in instants of the grid; see `Known`."""

    disclosed: Ints  # (N,)
    known: Ints  # (K, N) by estimator.
    known_undisclosed: Ints  # (K, N) by estimator.
    leaked: Floats  # (N,)
    seen: Bools  # (N,)


@dataclass(frozen=True, eq=False, slots=True)
class Known:
    """Knowledge of F fleets about N people, in instants of the grid.

    The K estimators are `ESTIMATORS`.
    """

    instants: Ints  # (N,) instants at which the person is present.
    disclosed: Ints  # (N, F) instants at which a position of the person was sent.
    known: Ints  # (K, N, F) instants at which the adversary knows the position.
    known_undisclosed: Ints  # (K, N, F) known instants at which no position was sent.
    known_by_map: Ints  # (N,) instants that are known without a log.
    leaked: Floats  # (N, F) share of the samples of a walk that were sent and leak.
    seen: Bools  # (N, F) whether the log has an entry of the person.

    @property
    def best(self) -> int:
        """Index of the estimator that knows most over all people and fleets."""
        return int(self.known.sum(axis=(1, 2)).argmax())


def guesses_from_map(patrol: Patrol, *, epsilon_m: float) -> Floats:
    """Return the guesses of an adversary without a log, one per person, (N, 2) m."""
    grid = patrol.grid
    return map_guesses(grid.xy, grid.offsets, group=grid.group, epsilon_m=epsilon_m)


def known_places(
    network: Network, disclosure: Disclosure, *, guesses: Floats, epsilon_m: float
) -> Known:
    """Count the instants that each fleet's log reveals, given true identities.

    A person without an entry is estimated at a guess from the map: `guesses`, (N, 2) m,
    of `guesses_from_map`. An instant counts as disclosed if the person's nearest
    scan was sent.
    """
    patrol = network.patrol
    grid = patrol.grid
    guess = np.repeat(guesses, np.diff(grid.offsets), axis=0)
    # Fleets often hold equal logs: compute each once within this call.
    by_log: dict[bytes, FleetKnown] = {}
    fleets = []
    for fleet in range(patrol.n_fleets):
        robots = np.arange(patrol.robots_per_fleet) + fleet * patrol.robots_per_fleet
        sent = disclosure.sent_mask(patrol, robots=robots)
        key = np.packbits(sent).tobytes()
        if network.histories is not None:
            key = disclosure.key(robots=robots)  # An answer has errors of its own.
        if key not in by_log:
            log = fleet_log(network, disclosure, robots=robots)
            by_log[key] = _count_fleet(network, log, sent, guess, epsilon_m=epsilon_m)
        fleets.append(by_log[key])
    near_guess = squared_lengths(guess - grid.xy) < epsilon_m**2
    return Known(
        instants=np.diff(grid.offsets),
        disclosed=np.stack([fleet.disclosed for fleet in fleets], axis=-1),
        known=np.stack([fleet.known for fleet in fleets], axis=-1),
        known_undisclosed=np.stack(
            [fleet.known_undisclosed for fleet in fleets], axis=-1
        ),
        known_by_map=_count_per_person(near_guess, grid.offsets),
        leaked=np.stack([fleet.leaked for fleet in fleets], axis=-1),
        seen=np.stack([fleet.seen for fleet in fleets], axis=-1),
    )


def _count_fleet(
    network: Network, log: Log, sent: Bools, guess: Floats, *, epsilon_m: float
) -> FleetKnown:
    patrol = network.patrol
    grid, people = patrol.grid, patrol.people
    is_disclosed = sent[nearest_samples(patrol)]
    known, undisclosed = [], []
    for estimator in ESTIMATORS:
        estimate = estimate_positions(
            log, t=grid.t, offsets=grid.offsets, estimator=estimator, fallback_xy=guess
        )
        is_known = squared_lengths(estimate - grid.xy) < epsilon_m**2
        known.append(_count_per_person(is_known, grid.offsets))
        undisclosed.append(_count_per_person(is_known & ~is_disclosed, grid.offsets))
    leaks = np.zeros(people.t.size, dtype=bool)
    leaks[log.sample] = squared_lengths(log.xy - people.xy[log.sample]) < epsilon_m**2
    return FleetKnown(
        disclosed=_count_per_person(is_disclosed, grid.offsets),
        known=np.stack(known),
        known_undisclosed=np.stack(undisclosed),
        leaked=_count_per_person(leaks & sent, people.offsets)
        / np.diff(people.offsets),
        seen=np.diff(log.offsets) > 0,
    )


def _count_per_person(flags: Bools, offsets: Ints) -> Ints:
    """Count the flags of each person, (N,)."""
    return np.asarray(np.add.reduceat(flags.astype(np.int64), offsets[:-1]))


def nearest_samples(patrol: Patrol) -> Ints:
    """Return the nearest sample of the same person for each grid instant, (G,)."""
    people, grid = patrol.people, patrol.grid
    owner = np.repeat(np.arange(len(grid)), np.diff(grid.offsets))
    first_s, interval_s = people.t[people.offsets[:-1]], patrol.ahead_s[1]
    number = np.rint((grid.t - first_s[owner]) / interval_s).astype(np.int64)
    sample: Ints = people.offsets[owner] + np.clip(
        number, 0, np.diff(people.offsets)[owner] - 1
    )
    return sample
