"""Trackers of a whole recording: oracle, global nearest neighbour, joint probabilities.

A tracker reads `Detections` scan by scan and knows nothing of later scans. A detection
that no track uses begins a tentative track, which must be detected several times before
it is confirmed; a track that is missed too often ends. Tracks have ids of their own:
they break, and they swap people.

References
----------
Bar-Shalom, Willett, Tian, *Tracking and Data Fusion*, 2011: life cycle (M of N), and
joint probabilistic data association (JPDA).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Final, Literal, TypeAlias, get_args

import numpy as np

from isac_track.errors import SettingsError, did_you_mean
from isac_track.tracking.association import (
    UNASSIGNED,
    Likelihood,
    likelihood_ratios,
    marginal_probabilities,
    nearest_assignment,
    unused_detections,
)
from isac_track.tracking.detections import CLUTTER, DetectedPatrol, Detections
from isac_track.tracking.filters import (
    States,
    first_states,
    join_states,
    mix_states,
    predict,
    update,
)
from isac_track.types import Bools, Floats, Ints

Method: TypeAlias = Literal["oracle", "genie", "gnn", "jpda"]
METHODS: Final[tuple[Method, ...]] = get_args(Method)
REFERENCES: Final[tuple[Method, ...]] = ("oracle", "genie")
"""Methods that read the truth."""
_TENTATIVE: Final = -1
_LEAST_CLAIM: Final = 0.5  # Probability at which tracks use a detection.
_NEGLIGIBLE: Final = 1e-6  # Probability of an association that is left out.


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """Parameters of a tracker. SettingsError for a bad value."""

    method: Method = "gnn"
    q: float = 0.04  # m^2/s^3, of people's acceleration, as in the robot's filter.
    speed_std_mps: float = 1.0  # Per axis, of a new track.
    # A track is confirmed at this many detections ...
    confirm_hits: int = 3
    # ... within so many scans, its first included; otherwise it ends.
    confirm_scans: int = 5
    most_misses: int = 5  # A confirmed track ends after more scans in a row.
    likelihood: Likelihood = field(default_factory=Likelihood)

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            hint = did_you_mean(self.method, METHODS)
            raise SettingsError(
                f"unknown tracker {self.method!r}{hint}; known: {', '.join(METHODS)}"
            )
        if not 1 <= self.confirm_hits <= self.confirm_scans:
            raise SettingsError(
                f"a track is confirmed at 1 to {self.confirm_scans} detections, got"
                f" confirm_hits {self.confirm_hits}"
            )
        for name in ("q", "speed_std_mps"):
            value = getattr(self, name)
            if not (value > 0.0 and np.isfinite(value)):
                raise SettingsError(f"{name} must be positive, got {value}")
        if self.most_misses < 0:
            raise SettingsError(
                f"most_misses must not be negative, got {self.most_misses}"
            )


@dataclass(frozen=True, eq=False, slots=True)
class Tracked:
    """N tracks with S states in all, as a tracker reports them scan by scan.

    The truth about them stays with the detections.
    """

    scan: Ints  # (S,) scan of each state, each scan from the track's first to its last.
    xy: Floats  # (S, 2) m, filtered position, or the prediction if none was detected.
    detection: Ints  # (S,) detection of the track at the scan, or `UNASSIGNED`.
    offsets: Ints  # (N + 1,)
    confirmed: Ints  # (N,) scan at which the track was confirmed.

    def __len__(self) -> int:
        """Return the number of tracks."""
        return self.offsets.size - 1

    @property
    def track(self) -> Ints:
        """Track of each state, (S,)."""
        return np.repeat(np.arange(len(self)), np.diff(self.offsets))

    @property
    def is_reported(self) -> Bools:
        """Whether a state's track was confirmed by its scan, (S,)."""
        return np.asarray(self.scan >= self.confirmed[self.track])


@dataclass(frozen=True, eq=False, slots=True)
class Track:
    """A track of K states at the scans from `first` on, for `join_tracks`."""

    first: int  # Scan of the first state.
    xy: Sequence[Floats] | Floats  # (K, 2) m
    detection: Sequence[int] | Ints  # (K,) detection of each scan, or `UNASSIGNED`.
    confirmed: int  # Scan at which the track was confirmed.


def join_tracks(tracks: Iterable[Track]) -> Tracked:
    """Return tracks as a tracker reports them, in the order in which they begin.

    Examples
    --------
    A track of two detections and a miss between them, confirmed at the second:

    >>> from isac_track.tracking import Track, join_tracks
    >>> track = Track(
    ...     first=3, xy=[(0.0, 0.0), (0.1, 0.0), (0.2, 0.0)], detection=[7, -1, 9],
    ...     confirmed=5,
    ... )
    >>> join_tracks([track]).scan.tolist()
    [3, 4, 5]
    """
    ordered = sorted(tracks, key=attrgetter("first"))
    sizes = [len(track.detection) for track in ordered]
    scans = [
        np.arange(track.first, track.first + size)
        for track, size in zip(ordered, sizes, strict=True)
    ]
    none = np.zeros(0, dtype=np.int64)
    places = [np.asarray(track.xy, dtype=np.float64) for track in ordered]
    points = [np.asarray(track.detection, dtype=np.int64) for track in ordered]
    return Tracked(
        scan=np.concatenate([none, *scans]),
        xy=np.concatenate([np.zeros((0, 2)), *places]),
        detection=np.concatenate([none, *points]),
        offsets=np.cumsum([0, *sizes]),
        confirmed=np.array([track.confirmed for track in ordered], dtype=np.int64),
    )


def run_tracker(detected: DetectedPatrol, *, settings: TrackerSettings) -> Tracked:
    """Return the tracks of a patrol's detections.

    Two references read the truth, and have one track for each person. `oracle` reads
    who is behind a detection, `genie` where everybody is (`assign_by_truth`).
    """
    if settings.method == "oracle":
        return track_by_truth(detected, settings=settings)
    if settings.method == "genie":
        person = assign_by_truth(detected, likelihood=settings.likelihood)
        return track_by_truth(replace(detected, person=person), settings=settings)
    return track_detections(detected.detections, settings=settings)


def track_detections(detections: Detections, *, settings: TrackerSettings) -> Tracked:
    """Return the tracks of unlabelled detections by `gnn` or `jpda`."""
    if settings.method in REFERENCES:
        raise SettingsError(f"{settings.method} needs the truth: use run_tracker")
    live, history, n_begun = _no_tracks(), _History(), 0
    for scan in range(detections.scan_s.size):
        live = _predict_tracks(live, detections, scan, settings)
        points = np.arange(*detections.offsets[scan : scan + 2])
        live, free = _associate(live, detections, points, settings)
        live = _survivors(live, scan, settings)
        numbers = np.arange(n_begun, n_begun + free.size)
        n_begun += free.size
        is_first_enough = settings.confirm_hits == 1
        confirmed = np.full(free.size, scan if is_first_enough else _TENTATIVE)
        live = _join(
            live, _begin(detections, free, numbers, confirmed, settings=settings)
        )
        history.write(scan, live)
    return history.tracked()


def track_by_truth(detected: DetectedPatrol, *, settings: TrackerSettings) -> Tracked:
    """Return a track for each detected person, from the first detection to the last."""
    detections, person = detected.detections, detected.person
    known = np.flatnonzero(person >= 0)
    n_people = int(person.max(initial=-1)) + 1
    first = np.full(n_people, detections.scan_s.size)
    last = np.full(n_people, -1)
    np.minimum.at(first, person[known], detections.scan[known])
    np.maximum.at(last, person[known], detections.scan[known])
    live, history = _no_tracks(), _History()
    for scan in range(detections.scan_s.size):
        live = _predict_tracks(live, detections, scan, settings)
        live = live.take(last[live.number] >= scan)
        point = np.full(n_people, UNASSIGNED)
        points = np.arange(*detections.offsets[scan : scan + 2])
        points = points[person[points] >= 0]
        point[person[points]] = points
        live = _update_tracks(live, detections, point[live.number])
        new = points[first[person[points]] == scan]
        confirmed = np.full(new.size, scan)
        live = _join(
            live, _begin(detections, new, person[new], confirmed, settings=settings)
        )
        history.write(scan, live)
    return history.tracked()


def assign_by_truth(detected: DetectedPatrol, *, likelihood: Likelihood) -> Ints:
    """Return the most probable person of each detection given true places, (D,).

    The places are those of the people who are detected at the scan. With errors that
    are independent between scans, other scans add nothing to true places: no tracker
    assigns a whole scan rightly more often. A detection without a person is `CLUTTER`.
    """
    detections, sensed = detected.detections, detected.sensed
    truth = sensed.xy - sensed.sigma_raw[:, None] * sensed.unit_error
    person = np.full(len(detections), CLUTTER)
    for scan in range(detections.scan_s.size):
        points = np.arange(*detections.offsets[scan : scan + 2])
        present = points[detected.person[points] != CLUTTER]
        places = first_states(
            xy=truth[present],
            cov=np.zeros((present.size, 2, 2)),
            speed_std_mps=1.0,
        )
        ratios = likelihood_ratios(
            places,
            xy=detections.xy[points],
            cov=detections.cov[points],
            likelihood=likelihood,
        )
        column = nearest_assignment(ratios)
        is_hit = column != UNASSIGNED
        person[points[column[is_hit]]] = detected.person[present[is_hit]]
    return person


@dataclass(frozen=True, eq=False, slots=True)
class _Live:
    """T tracks that have not ended."""

    states: States
    number: Ints  # (T,) in the order in which tracks begin.
    hits: Ints  # (T,) scans with a detection.
    age: Ints  # (T,) scans since the first, included.
    misses: Ints  # (T,) scans in a row without a detection.
    confirmed: Ints  # (T,) scan, or `_TENTATIVE`.
    detection: Ints  # (T,) detection at this scan, or `UNASSIGNED`.

    def take(self, rows: Ints | Bools) -> "_Live":
        """Return some of the tracks."""
        return _Live(
            self.states.take(rows),
            self.number[rows],
            self.hits[rows],
            self.age[rows],
            self.misses[rows],
            self.confirmed[rows],
            self.detection[rows],
        )


def _no_tracks() -> _Live:
    none = np.zeros(0, dtype=np.int64)
    states = first_states(
        xy=np.zeros((0, 2)), cov=np.zeros((0, 2, 2)), speed_std_mps=1.0
    )
    return _Live(states, none, none, none, none, none, none)


def _begin(
    detections: Detections,
    points: Ints,
    numbers: Ints,
    confirmed: Ints,
    *,
    settings: TrackerSettings,
) -> _Live:
    """Return tracks that begin with a detection each."""
    states = first_states(
        xy=detections.xy[points],
        cov=detections.cov[points],
        speed_std_mps=settings.speed_std_mps,
    )
    ones = np.ones_like(points)
    return _Live(states, numbers, ones, ones, np.zeros_like(points), confirmed, points)


def _join(first: _Live, second: _Live) -> _Live:
    """Return the tracks of both, in turn."""
    return _Live(
        join_states(first.states, second.states),
        *(
            np.concatenate([getattr(first, name), getattr(second, name)])
            for name in ("number", "hits", "age", "misses", "confirmed", "detection")
        ),
    )


def _predict_tracks(
    live: _Live, detections: Detections, scan: int, settings: TrackerSettings
) -> _Live:
    """Return the tracks as predicted for a scan."""
    if not live.number.size:
        return live
    step_s = float(detections.scan_s[scan] - detections.scan_s[scan - 1])
    return replace(live, states=predict(live.states, step_s=step_s, q=settings.q))


def _associate(
    live: _Live, detections: Detections, points: Ints, settings: TrackerSettings
) -> tuple[_Live, Ints]:
    """Return the tracks after the points of a scan, and the points that none uses.

    Confirmed tracks choose first: `jpda` weighs their points, `gnn` assigns them.
    Tentative tracks are assigned what these leave.
    """
    is_old = live.confirmed != _TENTATIVE
    old, new = live.take(is_old), live.take(~is_old)
    if settings.method == "jpda":
        old, free = _weigh(old, detections, points, settings)
    else:
        old, free = _assign(old, detections, points, settings)
    new, free = _assign(new, detections, free, settings)
    return _join(old, new), free


def _assign(
    live: _Live, detections: Detections, points: Ints, settings: TrackerSettings
) -> tuple[_Live, Ints]:
    """Return the tracks after the best assignment, and the points that none uses."""
    ratios = likelihood_ratios(
        live.states,
        xy=detections.xy[points],
        cov=detections.cov[points],
        likelihood=settings.likelihood,
    )
    column = nearest_assignment(ratios)
    detection = np.full(column.size, UNASSIGNED)
    detection[column >= 0] = points[column[column >= 0]]
    free = points[unused_detections(points.size, column)]
    return _update_tracks(live, detections, detection), free


def _weigh(
    live: _Live, detections: Detections, points: Ints, settings: TrackerSettings
) -> tuple[_Live, Ints]:
    """Return the tracks after weighing all points, and the points that none uses.

    The point of a track is its most probable; it has none if a miss is more probable. A
    point is used if tracks claim half of its probability or more.
    """
    xy, cov = detections.xy[points], detections.cov[points]
    ratios = likelihood_ratios(
        live.states, xy=xy, cov=cov, likelihood=settings.likelihood
    )
    probability = marginal_probabilities(ratios)
    missed, taken = probability[:, 0], probability[:, 1:]
    track, column = np.nonzero(taken > _NEGLIGIBLE)
    after = update(live.states.take(track), xy=xy[column], cov=cov[column])
    # Leaving out small probabilities must not shrink the mixture.
    weight = np.concatenate([missed, taken[track, column]])
    owner = np.concatenate([np.arange(missed.size), track])
    weight /= np.bincount(owner, weights=weight, minlength=missed.size)[owner]
    states = mix_states(
        join_states(live.states, after),
        track=owner,
        n_tracks=missed.size,
        weight=weight,
    )
    detection = np.full(missed.size, UNASSIGNED)
    if points.size:
        best = taken.argmax(axis=1)
        is_hit = taken.max(axis=1) > missed
        detection[is_hit] = points[best[is_hit]]
    free = points[taken.sum(axis=0) < _LEAST_CLAIM]
    return _count_hits(live, states, detection), free


def _update_tracks(live: _Live, detections: Detections, detection: Ints) -> _Live:
    """Return the tracks after a detection each; those without stay as predicted."""
    hit = np.flatnonzero(detection >= 0)
    after = update(
        live.states.take(hit),
        xy=detections.xy[detection[hit]],
        cov=detections.cov[detection[hit]],
    )
    states = States(
        *(
            _replace_rows(getattr(live.states, name), hit, getattr(after, name))
            for name in ("position", "velocity", "pp", "pv", "vv")
        )
    )
    return _count_hits(live, states, detection)


def _replace_rows(values: Floats, rows: Ints, new: Floats) -> Floats:
    """Return values with some of the rows replaced."""
    changed = values.copy()
    changed[rows] = new
    return changed


def _count_hits(live: _Live, states: States, detection: Ints) -> _Live:
    """Return the tracks with new states, and their detections counted."""
    is_hit = detection >= 0
    return _Live(
        states,
        live.number,
        live.hits + is_hit,
        live.age + 1,
        np.where(is_hit, 0, live.misses + 1),
        live.confirmed,
        detection,
    )


def _survivors(live: _Live, scan: int, settings: TrackerSettings) -> _Live:
    """Return the tracks that go on after a scan; those with enough hits are confirmed."""
    confirmed = np.where(
        (live.confirmed == _TENTATIVE) & (live.hits >= settings.confirm_hits),
        scan,
        live.confirmed,
    )
    most_hits = live.hits + settings.confirm_scans - live.age
    is_alive = np.where(
        confirmed == _TENTATIVE,
        most_hits >= settings.confirm_hits,
        live.misses <= settings.most_misses,
    )
    return replace(live, confirmed=confirmed).take(is_alive)


class _History:
    """States of live tracks, written scan by scan."""

    def __init__(self) -> None:
        none = np.zeros(0, dtype=np.int64)
        self._rows: list[tuple[Ints, Ints, Ints, Ints]] = [(none, none, none, none)]
        self._xy: list[Floats] = [np.zeros((0, 2))]

    def write(self, scan: int, live: _Live) -> None:
        """Add the states of a scan."""
        scans = np.full(live.number.size, scan)
        self._rows.append((scans, live.number, live.detection, live.confirmed))
        self._xy.append(live.states.position)

    def tracked(self) -> Tracked:
        """Return the tracks that were confirmed, in the order in which they began."""
        scan, number, detection, confirmed = map(
            np.concatenate, zip(*self._rows, strict=True)
        )
        confirmed_at = np.full(int(number.max(initial=-1)) + 1, _TENTATIVE)
        np.maximum.at(confirmed_at, number, confirmed)
        order = np.lexsort((scan, number))
        order = order[confirmed_at[number[order]] != _TENTATIVE]
        names, first = np.unique(number[order], return_index=True)
        return Tracked(
            scan=scan[order],
            xy=np.concatenate(self._xy)[order],
            detection=detection[order],
            offsets=np.append(first, order.size),
            confirmed=confirmed_at[names],
        )
