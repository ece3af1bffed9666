"""Detections and tracks of each seed of sensing, and what a mechanism shares."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from evaluation.compute.guards import copy_for_user_plugin, guarded
from isac_track.config import LINK
from isac_track.patrols import make_patrol, sense_people
from isac_track.patrols.knowledge import guesses_from_map
from isac_track.patrols.utility import first_entries, true_conflicts
from isac_track.sharing import Raw
from isac_track.tracking.association import Likelihood
from isac_track.tracking.counts import GOSPA_CUTOFF_M, Blocks, RobotCounts
from isac_track.tracking.detections import (
    DetectionSettings,
    clutter_density,
    detect_people,
)
from isac_track.tracking.hota import HotaScans, hota_scans
from isac_track.tracking.methods import track_patrol
from isac_track.tracking.metrics import GospaScans, gospa_scans
from isac_track.tracking.sharing import SharedTracks, perturb_detections, share_tracks

if TYPE_CHECKING:
    from isac_track.config import StageSettings
    from isac_track.patrols import Patrol
    from isac_track.plugins import Plugin
    from isac_track.tracking.detections import DetectedPatrol
    from isac_track.tracking.trackers import Tracked
    from isac_track.types import Floats, Ints, Tracks


CountsByHorizon: TypeAlias = "dict[int, RobotCounts]"
"""What robots miss, by horizon in scans."""
_LEAST_DENSITY_PER_M2: Final = 0.005  # Of new people, assumed without clutter.
# A tracker that is certain of a detection ends a track at the first miss.
_ASSUMED: Final = (0.1, 0.99)
_USUAL_PROBABILITY: Final = 0.9  # That a tracker assumes with the link budget.


@dataclass(frozen=True, eq=False, slots=True)
class SeedTracks:
    """The tracks of a tracker from the detections of a seed."""

    tracked: Tracked
    scans: GospaScans
    hota: HotaScans


@dataclass(frozen=True, eq=False, slots=True)
class SeedRelease:
    """The tracks that a mechanism shares, of a seed."""

    shared: SharedTracks
    scans: GospaScans
    hota: HotaScans
    # The same tracks with the detections as their tracker got them.
    raw: SharedTracks


@dataclass(frozen=True, eq=False)
class TrackingSetup:
    """A patrol, the detections of each seed, and what the consumers of tracks share.

    Detections and tracks without added noise are held as long as this object.
    """

    patrol: Patrol
    stages: StageSettings
    seed: int
    detected: dict[int, DetectedPatrol] = field(default_factory=dict)
    tracked: dict[tuple[str, int], SeedTracks] = field(default_factory=dict)
    references: dict[str, list[CountsByHorizon]] = field(default_factory=dict)

    @property
    def seeds(self) -> range:
        """Seeds of sensing."""
        return range(self.seed, self.seed + self.stages.tracking.seeds)

    @cached_property
    def blocks(self) -> Blocks:
        """Blocks of the recording."""
        return Blocks(self.patrol, self.stages.tracking.block_s)

    @cached_property
    def guesses(self) -> Floats:
        """Guesses from the map of where people stand, (N, 2) m."""
        epsilon_m = self.stages.privacy.epsilon_m
        return guesses_from_map(self.patrol, epsilon_m=epsilon_m)

    @cached_property
    def actual(self) -> Ints:
        """Scans until each true conflict, (E, R)."""
        radius_m = self.stages.conflict.safety_radius_m
        return true_conflicts(self.patrol, safety_radius_m=radius_m)

    @cached_property
    def entries(self) -> Ints:
        """Scans of the first true entries, (N, R)."""
        radius_m = self.stages.conflict.safety_radius_m
        return first_entries(self.patrol, safety_radius_m=radius_m)

    @cached_property
    def likelihood(self) -> Likelihood:
        """What trackers assume about detections."""
        rules = self.stages.tracking
        probability = rules.detection_probability
        if probability == LINK:
            probability = _USUAL_PROBABILITY
        density = clutter_density(self.patrol, settings=_detection(self.stages))
        return Likelihood(
            detection_probability=float(np.clip(float(probability), *_ASSUMED)),
            density_per_m2=max(density, _LEAST_DENSITY_PER_M2),
        )

    def detect(self, seed: int) -> DetectedPatrol:
        """Return the detections of a seed; made at first use."""
        if seed not in self.detected:
            stages = self.stages
            self.detected[seed] = detect_people(
                self.patrol,
                sense_people(self.patrol, settings=stages, seed=seed),
                settings=_detection(stages),
                sensing=stages.sensing,
                seed=seed,
            )
        return self.detected[seed]

    def tracks(self, tracker: Plugin, seed: int) -> SeedTracks:
        """Return the tracks of a seed's detections; made at first use."""
        key = tracker.name, seed
        if key not in self.tracked:
            self.tracked[key] = self.track(tracker, self.detect(seed))
        return self.tracked[key]

    def track(self, tracker: Plugin, detected: DetectedPatrol) -> SeedTracks:
        """Track detections; PluginError names a tracker that fails."""
        tracked = guarded(
            f"tracker {tracker.name!r}",
            lambda: track_patrol(
                tracker.instance, detected, likelihood=self.likelihood
            ),
        )
        scans = gospa_scans(self.patrol, tracked, cutoff_m=GOSPA_CUTOFF_M)
        return SeedTracks(tracked, scans, hota_scans(self.patrol, tracked))


def _detection(stages: StageSettings) -> DetectionSettings:
    """Return how the network of a run detects people."""
    rules, probability = stages.tracking, stages.tracking.detection_probability
    return DetectionSettings(
        probability=None if probability == LINK else float(probability),
        false_alarm_probability=rules.p_false_alarm,
        clutter_per_scan=rules.clutter_per_scan,
    )


def make_tracking_setup(
    recorded: Tracks, *, stages: StageSettings, seed: int
) -> TrackingSetup:
    """Make the patrol through a recording; DataError if nobody is present at a scan."""
    return TrackingSetup(
        make_patrol(recorded, settings=stages, seed=seed), stages, seed
    )


def share_tracked(
    mechanism: Plugin, tracker: Plugin, setup: TrackingSetup
) -> list[SeedRelease]:
    """Return the tracks that a mechanism shares, a release for each seed.

    With `tracking.noise=before` it acts on detections, which are tracked anew.
    PluginError names a mechanism or tracker that fails.
    """
    return [_share_seed(mechanism, tracker, setup, seed=seed) for seed in setup.seeds]


def _share_seed(
    mechanism: Plugin, tracker: Plugin, setup: TrackingSetup, *, seed: int
) -> SeedRelease:
    detected, name = setup.detect(seed), f"mechanism {mechanism.spec!r}"
    instance = mechanism.instance
    if instance == Raw():
        made = setup.tracks(tracker, seed)
        shared = share_tracks(detected, made.tracked, seed=seed)
        return SeedRelease(shared, made.scans, made.hota, raw=shared)
    own = replace(detected, sensed=copy_for_user_plugin(detected.sensed, mechanism))
    if setup.stages.tracking.noise == "before":
        noisy = guarded(
            name, lambda: perturb_detections(own, mechanism=instance, seed=seed)
        )
        made = setup.track(tracker, noisy)
        shared = share_tracks(noisy, made.tracked, seed=seed)
        return SeedRelease(shared, made.scans, made.hota, raw=shared)
    made = setup.tracks(tracker, seed)
    shared = guarded(
        name,
        lambda: share_tracks(own, made.tracked, seed=seed, mechanism=instance),
    )
    raw = share_tracks(detected, made.tracked, seed=seed)
    return SeedRelease(shared, made.scans, made.hota, raw=raw)
