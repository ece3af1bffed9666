"""Estimators of a position at any instant, from the entries of a log."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from isac_track.kalman import Batch, smooth_positions
from isac_track.kalman.slow_errors import SlowError, filter_tracks
from isac_track.patrols.fleet_logs import Log
from isac_track.patrols.reports import smooth_reports
from isac_track.types import Floats, Ints

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
# m^2/s^3, of people's acceleration, as in the robot's `kalman_cv`.
_ACCELERATION_DENSITY: Final = 0.04
_PRIOR_STD: Final = (100.0, 10.0)  # m and m/s, more than in any walk.
UNINFORMATIVE_M2: Final = 1e12  # Variance of a measurement without information.
# Added to every instant, so that an entry at the same time comes first.
APART_S: Final = 1e-6
RADIAL_PASSES: Final = 5  # Of the smoother for errors of the radial law.
RADIAL_ANNEAL: Final = 0.15  # Of the same smoother.


def estimate_positions(
    log: Log, *, t: Floats, offsets: Ints, estimator: str, fallback_xy: Floats
) -> Floats:
    """Estimate positions at instants of N walks by one of `ESTIMATORS`, (G, 2) m.

    The instants of walk n are ``t[offsets[n]:offsets[n + 1]]``, rising. Walks without
    an entry in the log take their positions from `fallback_xy`, (G, 2) m.
    """
    estimate = fallback_xy.copy()
    in_log = np.diff(log.offsets) > 0
    if not in_log.any():
        return estimate
    sizes = np.diff(offsets)
    row = np.flatnonzero(np.repeat(in_log, sizes))
    walk = np.repeat(np.cumsum(in_log) - 1, sizes)[row]
    entries = np.append(log.offsets[:-1][in_log], log.offsets[-1])
    if estimator in ("radial", "radial_smooth"):
        log = _smooth_entries(log, entries)
    instants = LogInstants(log, entries, t[row], walk)
    if estimator in ("smooth", "radial_smooth", "extrapolate"):
        estimate[row] = _filter_instants(instants, is_causal=estimator == "extrapolate")
    else:
        estimate[row] = instants.interpolate(is_held=estimator == "hold")
    return estimate


def _smooth_entries(log: Log, offsets: Ints) -> Log:
    """Return the log with its entries smoothed for errors of the radial law."""
    batch = Batch(log.t, log.xy, log.variance, offsets, _PRIOR_STD, log.ellipse)
    smoothed = smooth_reports(
        batch, q=_ACCELERATION_DENSITY, passes=RADIAL_PASSES, anneal=RADIAL_ANNEAL
    )
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
class LogInstants:
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


def _filter_instants(instants: LogInstants, *, is_causal: bool) -> Floats:
    """Estimate positions at the instants by a smoother, or a causal filter, (G, 2) m.

    The model is constant velocity. The instants are added as measurements with a
    variance so large that they carry no information.
    """
    log, n_entries = instants.log, instants.log.t.size
    before = instants.neighbours().before
    owner = np.repeat(np.arange(instants.offsets.size - 1), np.diff(instants.offsets))
    person = np.concatenate([owner, instants.person])
    t = np.concatenate([log.t, instants.t + APART_S])
    order = np.lexsort((t, person))
    no_information = np.full(instants.t.size, UNINFORMATIVE_M2)
    ellipse = log.ellipse
    if ellipse is not None:
        round_shapes = np.tile(np.eye(2), (instants.t.size, 1, 1))
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
        positions = filter_tracks(
            batch, SlowError(0.0, 0.0), q=_ACCELERATION_DENSITY
        ).causal_xy
    else:
        positions, _ = smooth_positions(batch, q=_ACCELERATION_DENSITY)
    unsorted = np.empty_like(positions)
    unsorted[order] = positions
    return unsorted[n_entries:]
