"""Words and numbers that cells depend on, apart from the presets, on which they do not."""

from typing import Final

SHARED = "shared"  # Consumer of the descriptors as shared.
IDENTITY = "identity"  # The attack that reproduces what was shared.
WINDOWS = "windows"  # Consumer of the same of a linkage task, window by window, after the task.
OTHER_LAW: Final = "isotropic"  # Error law under which the preset's `other_law` is computed as well
OTHER_LAW_WORLD: Final = f"law={OTHER_LAW}"
MODEL: Final = "model"  # Walks of the fitted motion in place of the recorded ones.
WORLDS: Final = (OTHER_LAW_WORLD, MODEL, f"{MODEL},{OTHER_LAW_WORLD}")
"""What else than the run's own: as in `dataset`, after the name."""
BOUND = "bound"  # Consumer of what no attack can exceed.
BLOCK_SCENES = 250  # Of a unit of work. Part of the keys of sharing: a change changes the draws.
MOST_SCENES = 10_000_000
MOST_JOBS: Final = 256  # Worker processes: more than machines have cores, and each takes 130 MB.
