"""Words and numbers that cells depend on; cells do not depend on the presets."""

from typing import Final

SHARED = "shared"  # Consumer of the descriptors as shared.
ORACLE: Final = "oracle"
"""The adversary with all knowledge: a reference, never the headline."""
IDENTITY = "identity"  # The attack that reproduces the release.
# Consumer of the descriptors of a linkage task's windows; follows the task's name.
WINDOWS = "windows"
# Error law under which the preset's `other_law` is computed as well.
OTHER_LAW: Final = "isotropic"
OTHER_LAW_WORLD: Final = f"law={OTHER_LAW}"
MODEL: Final = "model"  # Walks of the fitted motion in place of the recorded ones.
WORLDS: Final = (OTHER_LAW_WORLD, MODEL, f"{MODEL},{OTHER_LAW_WORLD}")
"""Other worlds than the run's own, as in `dataset` after the name; so are horizons."""
_HORIZON: Final = "horizon="
BOUND = "bound"  # Consumer of the bounds that no attack can exceed.
# Of a unit of work. Part of the keys of sharing: a change changes the draws.
BLOCK_SCENES = 250
MOST_SCENES = 10_000_000
# Worker processes: more than a machine has cores; each takes 130 MB.
MOST_JOBS: Final = 256


def horizon_world(horizon_s: float) -> str:
    """Return the world of a further horizon, where conflicts are made and predicted."""
    return f"{_HORIZON}{horizon_s:.12g}s"


def world_horizon_s(world: str) -> float | None:
    """Return the horizon of a world in s; None if it has that of the run."""
    before, is_horizon, number = world.removesuffix("s").partition(_HORIZON)
    if before or not is_horizon or not world.endswith("s"):
        return None
    try:
        return float(number)
    except ValueError:
        return None


def is_world(name: str) -> bool:
    """Whether a name is that of another world than the run's own."""
    return name in WORLDS or world_horizon_s(name) is not None
