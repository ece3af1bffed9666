"""From detections to tracks: a network that must associate points by itself."""

from isac_track.tracking.association import Likelihood
from isac_track.tracking.detections import (
    DetectedPatrol,
    Detections,
    DetectionSettings,
    clutter_density,
    detect_people,
)
from isac_track.tracking.methods import GNN, JPDA, Genie, Oracle, track_patrol
from isac_track.tracking.trackers import (
    METHODS,
    Track,
    Tracked,
    TrackerSettings,
    join_tracks,
    run_tracker,
    track_detections,
)

__all__ = ["GNN", "JPDA", "METHODS", "DetectedPatrol", "DetectionSettings"]
__all__ += ["Detections", "Genie", "Likelihood", "Oracle", "Track", "Tracked"]
__all__ += [
    "TrackerSettings",
    "clutter_density",
    "detect_people",
    "join_tracks",
    "run_tracker",
]
__all__ += ["track_detections", "track_patrol"]
