"""From detections to tracks: a network that must associate points by itself.

In the order in which data flow:

1. `detections` are unlabelled points, scan by scan.
2. `trackers` joins them to tracks, by the `association` of each scan and the `filters`
   of all tracks at once; `methods` has the trackers as plug-ins.
3. `sharing` adds a mechanism's noise before tracking or after it; `answers` are those
   of a policy from tracks.
4. `metrics` and `hota` say how good tracks are, `knowledge` what an adversary knows from
   them, `utility` what a robot foresees.
5. `counts` of blocks of a recording make every metric a ratio, with intervals over the
   `blocks`.
"""

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
