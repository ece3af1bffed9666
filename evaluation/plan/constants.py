"""Words and numbers that cells depend on, apart from the presets, on which they do not."""

from typing import Final

SHARED = "shared"  # Consumer of the descriptors as shared.
ORACLE: Final = "oracle"
"""Adversary who is granted all: a reference, never the headline."""
IDENTITY = "identity"  # The attack that reproduces what was shared.
# Consumer of the same of a linkage task, window by window, after the task.
WINDOWS = "windows"
# Error law under which the preset's `other_law` is computed as well
OTHER_LAW: Final = "isotropic"
OTHER_LAW_WORLD: Final = f"law={OTHER_LAW}"
MODEL: Final = "model"  # Walks of the fitted motion in place of the recorded ones.
WORLDS: Final = (OTHER_LAW_WORLD, MODEL, f"{MODEL},{OTHER_LAW_WORLD}")
"""What else than the run's own: as in `dataset`, after the name. So are further horizons."""
_HORIZON: Final = "horizon="
BOUND = "bound"  # Consumer of what no attack can exceed.
# Of a unit of work. Part of the keys of sharing: a change changes the draws.
BLOCK_SCENES = 250
MOST_SCENES = 10_000_000
# Worker processes: more than machines have cores, and each takes 130 MB.
MOST_JOBS: Final = 256


def horizon_world(horizon_s: float) -> str:
    """Return the world in which conflicts are made, and foreseen, for a further horizon."""
    return f"{_HORIZON}{horizon_s:.12g}s"


def horizon_of(world: str) -> float | None:
    """Return the horizon of a world in s; None if it has that of the run."""
    start, is_horizon, number = world.removesuffix("s").partition(_HORIZON)
    try:
        return (
            float(number) if is_horizon and not start and world.endswith("s") else None
        )
    except ValueError:
        return None


def is_world(name: str) -> bool:
    """Tell whether a name is that of another world than the run's own."""
    return name in WORLDS or horizon_of(name) is not None
