"""How much of people's time an adversary knows who holds the log of a fleet of robots.

The adversary of this file knows which entries of the log are of one person: a ceiling.
For every instant of every person present it states a position; the instant is known if
that lies within epsilon of the truth.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from isac_track.kalman import Batch, smooth_positions
from isac_track.kalman.slow_errors import SlowError, filter_tracks
from isac_track.noise import (
    MIN_VARIANCE_M2,
    UNKNOWN_VARIANCE_M2,
    innovation_variance_m2,
)
from isac_track.patrols.answers import Disclosure, Network
from isac_track.patrols.patrol import Patrol
from isac_track.patrols.utility import scans_left
from isac_track.patrols.walked_map import map_guesses
from isac_track.types import Bools, Floats, Ints, squared_lengths

ESTIMATORS: Final = (
    "smooth",
    "radial",
    "radial_smooth",
    "interpolate",
    "hold",
    "extrapolate",
)
"""Ways to state a position between the entries of a log:

- `smooth`: Rauch-Tung-Striebel at constant velocity, entries and instants together.
- `radial`: lines between the entries, after a smoother for errors of the radial law.
- `radial_smooth`: as `smooth`, of what that smoother returns.
- `interpolate`: lines between the entries.
- `hold`: the last entry; before the first, that.
- `extrapolate`: the Kalman filter moves on at constant velocity.
"""
_Q: Final = 0.04  # m^2/s^3, of people's acceleration; that of the robot's `kalman_cv`.
_PRIOR_STD: Final = (100.0, 10.0)  # m and m/s, more than any walk.
_NOTHING_M2: Final = 1e12  # Variance of a measurement that says nothing.
_APART_S: Final = 1e-6  # Between an entry and an instant of the grid at the same time.
_PASSES, _ANNEAL = 5, 0.15  # Of the radial smoother.


@dataclass(frozen=True, eq=False, slots=True)
class Log:
    """What a fleet was sent: entries of a patrol's samples, each person's in turn."""

    sample: Ints  # (L,) sample at whose instant the entry is, rising.
    t: Floats  # (L,) s
    xy: Floats  # (L, 2) m
    variance: Floats  # (L,) m^2 per axis, as the network declares it.
    offsets: Ints  # (N + 1,) entries of each person; there may be none.


@dataclass(frozen=True, eq=False, slots=True)
class FleetKnown:
    """What one fleet knows of N people, in instants of the grid; see `Known`."""

    disclosed: Ints  # (N,)
    known: Ints  # (K, N) by estimator.
    known_undisclosed: Ints  # (K, N) by estimator.
    leaked: Floats  # (N,)
    seen: Bools  # (N,)


@dataclass(frozen=True, eq=False, slots=True)
class Known:
    """What F fleets know of N people, in instants of the grid.

    The K estimators are `ESTIMATORS`.
    """

    instants: Ints  # (N,) instants at which a person is present.
    disclosed: Ints  # (N, F) ... at which a position of her was sent.
    known: Ints  # (K, N, F) ... at which the adversary knows her place.
    known_undisclosed: Ints  # (K, N, F) ... of these, without a position sent.
    known_by_map: Ints  # (N,) ... known without a log.
    leaked: Floats  # (N, F) share of the samples of a walk that were sent and leak.
    seen: Bools  # (N, F) whether the log has an entry of a person.

    @property
    def best(self) -> int:
        """Number of the estimator that knows most over all people and fleets."""
        return int(self.known.sum(axis=(1, 2)).argmax())


def guesses_from_map(patrol: Patrol, *, epsilon_m: float) -> Floats:
    """Return where an adversary without a log guesses each person to be, (N, 2) m."""
    grid = patrol.grid
    return map_guesses(grid.xy, grid.offsets, group=grid.group, epsilon_m=epsilon_m)


def known_places(
    network: Network, disclosure: Disclosure, *, guesses: Floats, epsilon_m: float
) -> Known:
    """Count what the log of each fleet tells an adversary with true identities.

    A person without an entry is where `guesses`, (N, 2) m, have her: those of the map
    (`guesses_from_map`). An instant counts as disclosed if the nearest scan of the
    person was sent.
    """
    patrol = network.patrol
    grid = patrol.grid
    guess = np.repeat(guesses, np.diff(grid.offsets), axis=0)
    by_log: dict[
        bytes, FleetKnown
    ] = {}  # Of this call alone: fleets often hold equal logs.
    fleets = []
    for fleet in range(patrol.n_fleets):
        robots = np.arange(patrol.robots_per_fleet) + fleet * patrol.robots_per_fleet
        sent = disclosure.sent(patrol, robots=robots)
        key = np.packbits(sent).tobytes()
        if key not in by_log:
            log = fleet_log(network, disclosure, sent=sent)
            by_log[key] = _fleet_known(network, log, sent, guess, epsilon_m=epsilon_m)
        fleets.append(by_log[key])
    near_guess = squared_lengths(guess - grid.xy) < epsilon_m**2
    return Known(
        instants=np.diff(grid.offsets),
        disclosed=np.stack([fleet.disclosed for fleet in fleets], axis=-1),
        known=np.stack([fleet.known for fleet in fleets], axis=-1),
        known_undisclosed=np.stack(
            [fleet.known_undisclosed for fleet in fleets], axis=-1
        ),
        known_by_map=_per_person(near_guess, grid.offsets),
        leaked=np.stack([fleet.leaked for fleet in fleets], axis=-1),
        seen=np.stack([fleet.seen for fleet in fleets], axis=-1),
    )


def _fleet_known(
    network: Network, log: Log, sent: Bools, guess: Floats, *, epsilon_m: float
) -> FleetKnown:
    patrol = network.patrol
    grid, people = patrol.grid, patrol.people
    is_disclosed = sent[nearest_samples(patrol)]
    known, undisclosed = [], []
    for estimator in ESTIMATORS:
        stated = state_positions(
            log, t=grid.t, offsets=grid.offsets, estimator=estimator, otherwise=guess
        )
        is_known = squared_lengths(stated - grid.xy) < epsilon_m**2
        known.append(_per_person(is_known, grid.offsets))
        undisclosed.append(_per_person(is_known & ~is_disclosed, grid.offsets))
    leaks = np.zeros(people.t.size, dtype=bool)
    leaks[log.sample] = squared_lengths(log.xy - people.xy[log.sample]) < epsilon_m**2
    return FleetKnown(
        disclosed=_per_person(is_disclosed, grid.offsets),
        known=np.stack(known),
        known_undisclosed=np.stack(undisclosed),
        leaked=_per_person(leaks & sent, people.offsets) / np.diff(people.offsets),
        seen=np.diff(log.offsets) > 0,
    )


def _per_person(flags: Bools, offsets: Ints) -> Ints:
    return np.asarray(np.add.reduceat(flags.astype(np.int64), offsets[:-1]))


def nearest_samples(patrol: Patrol) -> Ints:
    """Return the sample of the same person nearest to each instant of the grid, (G,)."""
    people, grid = patrol.people, patrol.grid
    owner = np.repeat(np.arange(len(grid)), np.diff(grid.offsets))
    first_s, interval_s = people.t[people.offsets[:-1]], patrol.ahead_s[1]
    number = np.rint((grid.t - first_s[owner]) / interval_s).astype(np.int64)
    sample: Ints = people.offsets[owner] + np.clip(
        number, 0, np.diff(people.offsets)[owner] - 1
    )
    return sample


def fleet_log(network: Network, disclosure: Disclosure, *, sent: Bools) -> Log:
    """Return the log of a fleet that was `sent` some samples, (M,), or states at them.

    A state has an entry at every scan until the next query: position and velocity tell
    them. A later state takes the place of an earlier one.
    """
    people = network.patrol.people
    if disclosure.form == "state":
        xy, variance, is_entry = _state_entries(network, sent)
    else:
        xy, variance, is_entry = network.release.xy, declared_variance(network), sent
    sample = np.flatnonzero(is_entry)
    return Log(
        sample=sample,
        t=people.t[sample],
        xy=xy[sample],
        variance=np.maximum(variance[sample], MIN_VARIANCE_M2),
        offsets=np.searchsorted(sample, people.offsets),
    )


def declared_variance(network: Network) -> Floats:
    """Return the variance per axis of each shared sample, (M,) m^2, declared or estimated."""
    release, sigma = network.release, network.release.sigma
    if sigma is None:
        variance = innovation_variance_m2(
            t=release.t, xy=release.xy, offsets=release.offsets
        )
        return np.repeat(variance, np.diff(release.offsets))
    return np.asarray(sigma**2 * (1.0 if network.sensed.law == "isotropic" else 0.5))


def _state_entries(network: Network, sent: Bools) -> tuple[Floats, Floats, Bools]:
    """Return position, variance and presence of the entries that states make, (M,) each."""
    patrol, forecast = network.patrol, network.shared_forecast
    n_samples = patrol.people.t.size
    xy, variance = np.zeros((n_samples, 2)), np.full(n_samples, UNKNOWN_VARIANCE_M2)
    is_entry = np.zeros(n_samples, dtype=bool)
    rows = np.flatnonzero(sent[patrol.presences.sample])
    sample, stay = patrol.presences.sample[rows], scans_left(patrol)[rows]
    n_scans = int(np.diff(patrol.query_scan).max(initial=1))
    for step in reversed(
        range(n_scans)
    ):  # The latest state is the one with the fewest steps.
        there = stay >= step
        entry, row = sample[there] + step, rows[there]
        xy[entry], is_entry[entry] = forecast.mean[row, step], True
        if forecast.cov is not None:
            variance[entry] = (
                np.trace(forecast.cov[row, step], axis1=-2, axis2=-1) / 2.0
            )
    return xy, variance, is_entry


def state_positions(
    log: Log, *, t: Floats, offsets: Ints, estimator: str, otherwise: Floats
) -> Floats:
    """Return a position for every instant of N walks, (G, 2) m, by one of `ESTIMATORS`.

    Walk n of the log is asked about at the times ``t[offsets[n]:offsets[n + 1]]``,
    rising. At the instants of walks without an entry people are where `otherwise`, (G,
    2) m, says.
    """
    stated = otherwise.copy()
    in_log = np.diff(log.offsets) > 0
    if not in_log.any():
        return stated
    sizes = np.diff(offsets)
    row = np.flatnonzero(np.repeat(in_log, sizes))
    walk = np.repeat(np.cumsum(in_log) - 1, sizes)[row]
    entries = np.append(log.offsets[:-1][in_log], log.offsets[-1])
    if estimator in ("radial", "radial_smooth"):
        log = _smoothed(log, entries)
    gaps = Gaps(log, entries, t[row], walk)
    if estimator in ("smooth", "radial_smooth", "extrapolate"):
        stated[row] = _filtered(gaps, is_causal=estimator == "extrapolate")
    else:
        stated[row] = gaps.joined(is_held=estimator == "hold")
    return stated


def _smoothed(log: Log, offsets: Ints) -> Log:
    """Return a log whose entries are smoothed for errors of the radial law."""
    batch = Batch(log.t, log.xy, log.variance, offsets, _PRIOR_STD)
    xy, variance = smooth_positions(batch, q=_Q, passes=_PASSES, anneal=_ANNEAL)
    return replace(log, xy=xy, variance=np.maximum(variance, MIN_VARIANCE_M2))


@dataclass(frozen=True, eq=False, slots=True)
class Gaps:
    """Instants between the entries of a log, of people who have an entry each."""

    log: Log
    offsets: Ints  # (P + 1,) entries of each person in the log, none without.
    t: Floats  # (G,) s, instants.
    person: Ints  # (G,) whose instants, rising.

    def neighbours(self) -> tuple[Ints, Ints, Floats]:
        """Return the entry before, that after, and the share of the way between them, (G,).

        Outside of a person's entries both are her first or her last.
        """
        first, last = self.offsets[self.person], self.offsets[self.person + 1] - 1
        owner = np.repeat(np.arange(self.offsets.size - 1), np.diff(self.offsets))
        # One rising axis for all people: nobody's times reach the next person's.
        start_s = min(self.log.t.min(), self.t.min())
        span_s = max(self.log.t.max(), self.t.max()) - start_s + 1.0
        place = owner * span_s + (self.log.t - start_s)
        after = np.searchsorted(
            place, self.person * span_s + (self.t - start_s), side="right"
        )
        before = np.clip(after - 1, first, last)
        after = np.clip(after, first, last)
        gap_s = self.log.t[after] - self.log.t[before]
        share = np.zeros(self.t.size)
        np.divide(self.t - self.log.t[before], gap_s, out=share, where=gap_s > 0)
        return before, after, share

    def joined(self, *, is_held: bool) -> Floats:
        """Return the places on lines between the entries, or of the entry before, (G, 2) m."""
        before, after, share = self.neighbours()
        xy = self.log.xy
        return (
            xy[before]
            if is_held
            else xy[before] + share[:, None] * (xy[after] - xy[before])
        )


def _filtered(gaps: Gaps, *, is_causal: bool) -> Floats:
    """Return the positions at the instants by a smoother, or a filter, at constant velocity.

    The instants are measurements of a variance so large that they say nothing.
    """
    log, n_entries = gaps.log, gaps.log.t.size
    before, _, _ = gaps.neighbours()
    owner = np.repeat(np.arange(gaps.offsets.size - 1), np.diff(gaps.offsets))
    person = np.concatenate([owner, gaps.person])
    t = np.concatenate([log.t, gaps.t + _APART_S])
    order = np.lexsort((t, person))
    silence = np.full(gaps.t.size, _NOTHING_M2)
    batch = Batch(
        t=t[order],
        xy=np.concatenate([log.xy, log.xy[before]])[order],
        variance=np.concatenate([log.variance, silence])[order],
        offsets=np.concatenate([[0], np.cumsum(np.bincount(person))]),
        prior_std=_PRIOR_STD,
    )
    if is_causal:
        _, positions = filter_tracks(batch, SlowError(0.0, 0.0), q=_Q)
    else:
        positions, _ = smooth_positions(batch, q=_Q)
    unsorted = np.empty_like(positions)
    unsorted[order] = positions
    return unsorted[n_entries:]
