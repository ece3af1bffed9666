"""Trackers as plug-ins: a frozen dataclass of parameters with a method `track`.

`gnn` and `jpda` read detections alone, as a user's own tracker does. Two references
read the truth besides; nothing else is given it.
"""

from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from isac_track.errors import PluginError
from isac_track.protocols import Tracker
from isac_track.tracking.association import UNASSIGNED, Likelihood
from isac_track.tracking.detections import DetectedPatrol, Detections
from isac_track.tracking.trackers import (
    Method,
    Tracked,
    TrackerSettings,
    run_tracker,
    track_detections,
)


@dataclass(frozen=True, slots=True)
class GNN:
    """Join each scan by its most probable assignment (global nearest neighbour)."""

    confirm_hits: int = 3  # A track is confirmed at this many detections ...
    confirm_scans: int = 5  # ... within so many scans, its first included.
    most_misses: int = 5  # A confirmed track ends after more scans in a row.
    q: float = 0.04  # m^2/s^3, of people's acceleration.

    def __post_init__(self) -> None:
        _settings("gnn", self, Likelihood())

    def track(self, detections: Detections, likelihood: Likelihood) -> Tracked:
        """Return the tracks of unlabelled detections."""
        return track_detections(detections, settings=_settings("gnn", self, likelihood))


@dataclass(frozen=True, slots=True)
class JPDA:
    """Weigh all assignments of a scan (joint probabilistic data association)."""

    confirm_hits: int = 3  # A track is confirmed at this many detections ...
    confirm_scans: int = 5  # ... within so many scans, its first included.
    most_misses: int = 5  # A confirmed track ends after more scans in a row.
    q: float = 0.04  # m^2/s^3, of people's acceleration.

    def __post_init__(self) -> None:
        _settings("jpda", self, Likelihood())

    def track(self, detections: Detections, likelihood: Likelihood) -> Tracked:
        """Return the tracks of unlabelled detections."""
        return track_detections(
            detections, settings=_settings("jpda", self, likelihood)
        )


def _settings(
    method: Method, tracker: GNN | JPDA, likelihood: Likelihood
) -> TrackerSettings:
    """Return the settings of a tracker; SettingsError for a parameter out of range."""
    return TrackerSettings(
        method=method,
        q=tracker.q,
        confirm_hits=tracker.confirm_hits,
        confirm_scans=tracker.confirm_scans,
        most_misses=tracker.most_misses,
        likelihood=likelihood,
    )


@dataclass(frozen=True, slots=True)
class Oracle:
    """Know who is behind each detection: a reference, one track for each person."""

    def track(self, detected: DetectedPatrol, likelihood: Likelihood) -> Tracked:
        """Return the tracks of detections whose people are known."""
        return _by_truth("oracle", detected, likelihood)


@dataclass(frozen=True, slots=True)
class Genie:
    """Assign each scan given true places: a reference, a track for each person."""

    def track(self, detected: DetectedPatrol, likelihood: Likelihood) -> Tracked:
        """Return the tracks of the most probable assignment to true places."""
        return _by_truth("genie", detected, likelihood)


def _by_truth(
    method: Method, detected: DetectedPatrol, likelihood: Likelihood
) -> Tracked:
    settings = TrackerSettings(method=method, likelihood=likelihood)
    return run_tracker(detected, settings=settings)


Reference: TypeAlias = Oracle | Genie
REFERENCE_TYPES: Final = (Oracle, Genie)


def track_patrol(
    tracker: Tracker | Reference, detected: DetectedPatrol, *, likelihood: Likelihood
) -> Tracked:
    """Return the tracks of a patrol's detections, checked (`check_tracked`).

    Only the two references are given the truth. PluginError if a tracker returns
    anything else than tracks of these detections.
    """
    if isinstance(tracker, Oracle | Genie):
        return tracker.track(detected, likelihood)
    detections = detected.detections
    tracked: object = tracker.track(detections, likelihood)
    name = f"tracker {type(tracker).__name__}"
    if not isinstance(tracked, Tracked):
        got = type(tracked).__name__
        raise PluginError(f"{name} must return a Tracked, got {got}")
    try:
        check_tracked(tracked, detections)
    except ValueError as error:
        raise PluginError(f"{name} returned tracks that do not fit: {error}") from None
    return tracked


def check_tracked(tracked: Tracked, detections: Detections) -> None:
    """Raise ValueError unless tracks are possible tracks of detections.

    Each has a state at every scan from its first to its last, with a detection of that
    scan or none; it begins with a detection, and is confirmed between its ends.
    """
    offsets, n = tracked.offsets, tracked.scan.size
    if offsets.ndim != 1 or not offsets.size or offsets[0] != 0 or offsets[-1] != n:
        raise ValueError(f"offsets must run from 0 to the {n} states")
    if (np.diff(offsets) < 1).any():
        raise ValueError("a track must have a state")
    if tracked.xy.shape != (n, 2) or tracked.detection.shape != (n,):
        raise ValueError(f"xy must be ({n}, 2) and detection ({n},)")
    if tracked.confirmed.shape != (offsets.size - 1,):
        raise ValueError("confirmed must have a scan for each track")
    whole = (tracked.scan, tracked.detection, tracked.confirmed, offsets)
    if any(values.dtype.kind not in "iu" for values in whole):
        raise ValueError("scan, detection, confirmed and offsets must be whole numbers")
    if not np.isfinite(tracked.xy).all():
        raise ValueError("positions must be finite")
    if n:
        _check_scans(tracked, detections)


def _check_scans(tracked: Tracked, detections: Detections) -> None:
    """Raise ValueError for scans and detections that are no tracks'."""
    scan, detection, first = tracked.scan, tracked.detection, tracked.offsets[:-1]
    last = tracked.offsets[1:] - 1
    inner = np.ones(scan.size, dtype=bool)
    inner[first] = False
    if (np.diff(scan, prepend=0)[inner] != 1).any():
        raise ValueError("a track must have a state at every scan between its ends")
    if scan[first].min() < 0 or scan[last].max() >= detections.scan_s.size:
        raise ValueError(f"scans must lie in 0 to {detections.scan_s.size - 1}")
    if detection.min() < UNASSIGNED or detection.max() >= len(detections):
        raise ValueError(f"detections must lie in -1 to {len(detections) - 1}")
    is_hit = detection != UNASSIGNED
    if (detections.scan[detection[is_hit]] != scan[is_hit]).any():
        raise ValueError("the detection of a state must be of its scan")
    if not is_hit[first].all():
        raise ValueError("a track must begin with a detection")
    outside = (tracked.confirmed < scan[first]) | (tracked.confirmed > scan[last])
    if outside.any():
        raise ValueError("a track must be confirmed between its first and last scan")
