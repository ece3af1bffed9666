"""How much of people's time an adversary knows from the log of a fleet of robots.

This adversary knows which entries of the log belong to the same person: a ceiling. It
estimates the position of every present person at every instant. An instant is known if
the estimate lies within epsilon of the truth.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from isac_track.kalman import Batch, smooth_ellipses, smooth_positions
from isac_track.kalman.slow_errors import SlowError, filter_tracks
from isac_track.measurement import (
    axis_variance,
    covariance_without,
    error_ellipses,
    mean_variance,
)
from isac_track.noise import (
    MIN_VARIANCE_M2,
    UNKNOWN_VARIANCE_M2,
    innovation_variance_m2,
)
from isac_track.patrols.answers import Disclosure, Network
from isac_track.patrols.patrol import Patrol
from isac_track.patrols.utility import scans_left
from isac_track.patrols.walked_map import map_guesses
from isac_track.types import Bools, Floats, Ints, Release, squared_lengths

ESTIMATORS: Final = (
    "smooth",
    "radial",
    "radial_smooth",
    "interpolate",
    "hold",
    "extrapolate",
)
"""Estimators of a position between the entries of a log:

- `smooth`: Rauch-Tung-Striebel at constant velocity, entries and instants together.
- `radial`: lines between the entries, after a smoother for errors of the radial law.
- `radial_smooth`: as `smooth`, applied to the output of that smoother.
- `interpolate`: lines between the entries.
- `hold`: the last entry; before the first entry, the first.
- `extrapolate`: a Kalman filter, extrapolated at constant velocity.
"""
_Q: Final = 0.04  # m^2/s^3, of people's acceleration, as in the robot's `kalman_cv`.
_PRIOR_STD: Final = (100.0, 10.0)  # m and m/s, more than in any walk.
UNINFORMATIVE_M2: Final = 1e12  # Variance of a measurement without information.
# Added to every instant, so that an entry at the same time comes first.
APART_S: Final = 1e-6
PASSES, ANNEAL = 5, 0.15  # Options of the radial smoother.


@dataclass(frozen=True, eq=False, slots=True)
class Log:
    """Entries that a fleet was sent about samples of a patrol, ordered by person."""

    sample: Ints  # (L,) sample with the time of the entry, rising.
    t: Floats  # (L,) s
    xy: Floats  # (L, 2) m
    variance: Floats  # (L,) m^2 per axis, as the network declares it.
    offsets: Ints  # (N + 1,) entries of each person; a person may have none.
    # (L, 2, 2) m^2, of declared errors with a shape; `variance` is their mean then.
    cov: Floats | None = None

    @property
    def ellipse(self) -> Floats | None:
        """Shape of the errors, (L, 2, 2) in units of `variance`; None: round errors."""
        return None if self.cov is None else error_ellipses(self.cov)


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
        sent = disclosure.sent(patrol, robots=robots)
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
        estimate = state_positions(
            log, t=grid.t, offsets=grid.offsets, estimator=estimator, otherwise=guess
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


def fleet_log(network: Network, disclosure: Disclosure, *, robots: Ints) -> Log:
    """Return the log of a fleet of `robots`: samples, or states at their samples.

    A state gives an entry at every scan until the next query, by its position and
    velocity. A later state replaces an earlier state. Several draws of a sample are
    averaged.
    """
    people = network.patrol.people
    if disclosure.form == "state":
        sent = disclosure.sent(network.patrol, robots=robots)
        sample, reports = _state_entries(network, sent)
    else:
        row = _sent_rows(network, disclosure, robots)
        sample, reports = average_draws(
            sent_samples(network, row), sent_reports(network)[row]
        )
    reports = reports.floored()
    return Log(
        sample=sample,
        t=people.t[sample],
        xy=reports.xy,
        variance=reports.variance,
        offsets=np.searchsorted(sample, people.offsets),
        cov=reports.cov,
    )


def _sent_rows(network: Network, disclosure: Disclosure, robots: Ints) -> Ints:
    """Return the rows of `network.sent` that robots were sent, (L,), ascending."""
    is_ours = np.isin(disclosure.robot, robots)
    begins = network.sent_rows(disclosure.presence[is_ours], disclosure.first[is_ours])
    sizes = disclosure.end[is_ours] - disclosure.first[is_ours]
    change = np.zeros(network.sent.t.size + 1, dtype=np.int64)
    np.add.at(change, begins, 1)
    np.add.at(change, begins + sizes, -1)
    return np.flatnonzero(np.cumsum(change[:-1]) > 0)


def sent_samples(network: Network, row: Ints) -> Ints:
    """Return the samples of the patrol at rows of `network.sent`, (L,)."""
    if network.histories is None:
        return row
    offsets, pairs = network.sent.offsets, network.patrol.presences
    presence = np.searchsorted(offsets, row, side="right") - 1
    first = network.patrol.people.offsets[pairs.person[presence]]
    return np.asarray(first + row - offsets[presence])


@dataclass(frozen=True, eq=False, slots=True)
class Reports:
    """L positions with their declared or estimated errors."""

    xy: Floats  # (L, 2) m
    variance: Floats  # (L,) m^2 per axis.
    # (L, 2, 2) m^2, of declared errors with a shape; `variance` is their mean then.
    cov: Floats | None

    def __getitem__(self, rows: Ints) -> "Reports":
        """Return some of the reports."""
        cov = None if self.cov is None else self.cov[rows]
        return Reports(self.xy[rows], self.variance[rows], cov)

    def batch(self, t: Floats, offsets: Ints, *, prior_std: tuple[float, ...]) -> Batch:
        """Return the reports as tracks of a filter, at the times `t`, (L,) s."""
        ellipse = None if self.cov is None else error_ellipses(self.cov)
        return Batch(t, self.xy, self.variance, offsets, prior_std, ellipse)

    def inflated(self, factor: float) -> "Reports":
        """Return the reports with all variances times a factor."""
        cov = None if self.cov is None else factor * self.cov
        return Reports(self.xy, factor * self.variance, cov)

    def floored(self) -> "Reports":
        """Return the reports with at least `MIN_VARIANCE_M2` along every axis."""
        if self.cov is None:
            variance = np.maximum(self.variance, MIN_VARIANCE_M2)
            return Reports(self.xy, variance, None)
        return _with_cov(self.xy, self.cov)


def _with_cov(xy: Floats, cov: Floats) -> Reports:
    """Return reports with covariances, (L, 2, 2) m^2, none of them flat."""
    cov = covariance_without(cov, std_m=0.0, least_m2=MIN_VARIANCE_M2)
    return Reports(xy, mean_variance(cov), cov)


def smooth_reports(
    batch: Batch, *, q: float, passes: int = 1, anneal: float = 0.0
) -> Reports:
    """Return smoothed positions with their posterior variances, none of them 0.

    Parameters are those of `isac_track.kalman.smooth_positions`.
    """
    if batch.ellipse is not None:
        xy, cov = smooth_ellipses(batch, q=q, passes=passes, anneal=anneal)
        return _with_cov(xy, cov)
    xy, variance = smooth_positions(batch, q=q, passes=passes, anneal=anneal)
    return Reports(xy, np.maximum(variance, MIN_VARIANCE_M2), None)


def average_draws(key: Ints, reports: Reports) -> tuple[Ints, Reports]:
    """Return the ascending keys, and the report of each, of several draws.

    Draws, (L,), are weighted by the inverse of their variance, or covariance.
    """
    keys, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    if (count == 1).all():
        return keys, reports[np.argsort(key)]
    if reports.cov is not None:
        return keys, _average_covs(inverse, reports.floored(), keys.size)
    weight = 1.0 / np.maximum(reports.variance, MIN_VARIANCE_M2)
    total = np.bincount(inverse, weights=weight)
    mean = [
        np.bincount(inverse, weights=weight * axis) / total for axis in reports.xy.T
    ]
    return keys, Reports(np.stack(mean, axis=1), 1.0 / total, None)


def _average_covs(group: Ints, reports: Reports, n_groups: int) -> Reports:
    """Return the average report of each group, weighted by information."""
    assert reports.cov is not None
    weight = np.linalg.inv(reports.cov)
    total, pull = np.zeros((n_groups, 2, 2)), np.zeros((n_groups, 2))
    np.add.at(total, group, weight)
    np.add.at(pull, group, np.einsum("lab,lb->la", weight, reports.xy))
    cov = np.linalg.inv(total)
    return _with_cov(np.asarray(np.einsum("lab,lb->la", cov, pull)), np.asarray(cov))


def sent_reports(network: Network) -> Reports:
    """Return the rows of `network.sent`, with declared or estimated errors."""
    return _reports(network, network.sent)


def released_reports(network: Network) -> Reports:
    """Return the samples of the release, (M,), with declared or estimated errors."""
    return _reports(network, network.release)


def _reports(network: Network, release: Release) -> Reports:
    if release.sigma is not None and release.cov is not None:
        return Reports(release.xy, mean_variance(release.cov), release.cov)
    return Reports(release.xy, _variance(network, release), None)


def _variance(network: Network, release: Release) -> Floats:
    sigma = release.sigma
    if sigma is None:
        variance = innovation_variance_m2(
            t=release.t, xy=release.xy, offsets=release.offsets
        )
        return np.repeat(variance, np.diff(release.offsets))
    return axis_variance(sigma_m=sigma, law=network.sensed.law)


def _state_entries(network: Network, sent: Bools) -> tuple[Ints, Reports]:
    """Return the samples at which states give an entry, and the entries.

    Forecasts have a shape if the release declares it.
    """
    patrol, forecast = network.patrol, network.shared_forecast
    n_samples = patrol.people.t.size
    xy, variance = np.zeros((n_samples, 2)), np.full(n_samples, UNKNOWN_VARIANCE_M2)
    cov = UNKNOWN_VARIANCE_M2 * np.tile(np.eye(2), (n_samples, 1, 1))
    is_entry = np.zeros(n_samples, dtype=bool)
    rows = np.flatnonzero(sent[patrol.presences.sample])
    sample, stay = patrol.presences.sample[rows], scans_left(patrol)[rows]
    n_scans = int(np.diff(patrol.query_scan).max(initial=1))
    # Of several states for a scan the latest has the fewest steps: it is written last.
    for step in reversed(range(n_scans)):
        is_present = stay >= step
        entry, row = sample[is_present] + step, rows[is_present]
        xy[entry], is_entry[entry] = forecast.mean[row, step], True
        if forecast.cov is not None:
            variance[entry] = (
                np.trace(forecast.cov[row, step], axis1=-2, axis2=-1) / 2.0
            )
            cov[entry] = forecast.cov[row, step]
    sample = np.flatnonzero(is_entry)
    has_shape = network.release.cov is not None and forecast.cov is not None
    return sample, Reports(
        xy[sample], variance[sample], cov[sample] if has_shape else None
    )


def state_positions(
    log: Log, *, t: Floats, offsets: Ints, estimator: str, otherwise: Floats
) -> Floats:
    """Estimate positions at instants of N walks by one of `ESTIMATORS`, (G, 2) m.

    The instants of walk n are ``t[offsets[n]:offsets[n + 1]]``, rising. Walks without
    an entry in the log take their positions from `otherwise`, (G, 2) m.
    """
    estimate = otherwise.copy()
    in_log = np.diff(log.offsets) > 0
    if not in_log.any():
        return estimate
    sizes = np.diff(offsets)
    row = np.flatnonzero(np.repeat(in_log, sizes))
    walk = np.repeat(np.cumsum(in_log) - 1, sizes)[row]
    entries = np.append(log.offsets[:-1][in_log], log.offsets[-1])
    if estimator in ("radial", "radial_smooth"):
        log = _smooth_entries(log, entries)
    gaps = Gaps(log, entries, t[row], walk)
    if estimator in ("smooth", "radial_smooth", "extrapolate"):
        estimate[row] = _filter_gaps(gaps, is_causal=estimator == "extrapolate")
    else:
        estimate[row] = gaps.interpolate(is_held=estimator == "hold")
    return estimate


def _smooth_entries(log: Log, offsets: Ints) -> Log:
    """Return the log with its entries smoothed for errors of the radial law."""
    batch = Batch(log.t, log.xy, log.variance, offsets, _PRIOR_STD, log.ellipse)
    smoothed = smooth_reports(batch, q=_Q, passes=PASSES, anneal=ANNEAL)
    return replace(log, xy=smoothed.xy, variance=smoothed.variance, cov=smoothed.cov)


@dataclass(frozen=True, eq=False, slots=True)
class _Neighbours:
    """The entries of a log around G instants.

    Outside of a person's entries both are the first or last of them.
    """

    before: Ints  # (G,) entry at the instant or before it
    after: Ints  # (G,) the next entry
    share: Floats  # (G,) place of the instant between both, 0 to 1


@dataclass(frozen=True, eq=False, slots=True)
class Gaps:
    """Instants between the entries of a log, of people with at least one entry."""

    log: Log
    offsets: Ints  # (P + 1,) entries of each person in the log, at least one.
    t: Floats  # (G,) s, instants.
    person: Ints  # (G,) person of each instant, rising.

    def neighbours(self) -> _Neighbours:
        """Return the entries before and after each instant."""
        first, last = self.offsets[self.person], self.offsets[self.person + 1] - 1
        owner = np.repeat(np.arange(self.offsets.size - 1), np.diff(self.offsets))
        # Place all people on one rising axis, where their times do not overlap.
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
        return _Neighbours(before, after, share)

    def interpolate(self, *, is_held: bool) -> Floats:
        """Interpolate between the entries, or hold the entry before, (G, 2) m."""
        near, xy = self.neighbours(), self.log.xy
        start = xy[near.before]
        if is_held:
            return start
        return np.asarray(start + near.share[:, None] * (xy[near.after] - start))


def _filter_gaps(gaps: Gaps, *, is_causal: bool) -> Floats:
    """Estimate positions at the instants by a smoother, or a causal filter, (G, 2) m.

    The model is constant velocity. The instants are added as measurements with a
    variance so large that they carry no information.
    """
    log, n_entries = gaps.log, gaps.log.t.size
    before = gaps.neighbours().before
    owner = np.repeat(np.arange(gaps.offsets.size - 1), np.diff(gaps.offsets))
    person = np.concatenate([owner, gaps.person])
    t = np.concatenate([log.t, gaps.t + APART_S])
    order = np.lexsort((t, person))
    no_information = np.full(gaps.t.size, UNINFORMATIVE_M2)
    ellipse = log.ellipse
    if ellipse is not None:
        round_shapes = np.tile(np.eye(2), (gaps.t.size, 1, 1))
        ellipse = np.concatenate([ellipse, round_shapes])[order]
    batch = Batch(
        t=t[order],
        xy=np.concatenate([log.xy, log.xy[before]])[order],
        variance=np.concatenate([log.variance, no_information])[order],
        offsets=np.concatenate([[0], np.cumsum(np.bincount(person))]),
        prior_std=_PRIOR_STD,
        ellipse=ellipse,
    )
    if is_causal:
        positions = filter_tracks(batch, SlowError(0.0, 0.0), q=_Q).causal_xy
    else:
        positions, _ = smooth_positions(batch, q=_Q)
    unsorted = np.empty_like(positions)
    unsorted[order] = positions
    return unsorted[n_entries:]
