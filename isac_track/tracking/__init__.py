"""From detections to tracks: a network that must associate points by itself."""

from isac_track.tracking.association import Likelihood
from isac_track.tracking.detections import (
    DetectedPatrol,
    Detections,
    DetectionSettings,
    clutter_density,
    detect_people,
)
from isac_track.tracking.trackers import (
    METHODS,
    Tracked,
    TrackerSettings,
    run_tracker,
    track_detections,
)

__all__ = ["METHODS", "DetectedPatrol", "DetectionSettings", "Detections"]
__all__ += ["Likelihood", "Tracked", "TrackerSettings", "clutter_density"]
__all__ += ["detect_people", "run_tracker", "track_detections"]
