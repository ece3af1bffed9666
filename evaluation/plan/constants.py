"""Words and numbers that cells depend on; cells do not depend on the presets."""

from typing import Final

SHARED = "shared"  # Consumer of the descriptors as shared.
ORACLE: Final = "oracle"
"""The adversary with all knowledge: a reference, never the headline."""
IDENTITY = "identity"  # The attack that reproduces the release.
# Consumer of the descriptors of a linkage task's windows; follows the task's name.
WINDOWS = "windows"
# Error law under which the preset's `other_law_mechanisms` are computed as well.
OTHER_LAW: Final = "isotropic"
BOUND = "bound"  # Consumer of the bounds that no attack can exceed.
# Scenes of a block. Part of every cell's key, for a change changes the draws.
BLOCK_SCENES = 250
MOST_SCENES = 10_000_000
# Worker processes: more than a machine has cores; each takes 130 MB.
MOST_JOBS: Final = 256
TRACK_RELEASES: Final = ("tracks", "detections")  # Values of `tracking.release`.
