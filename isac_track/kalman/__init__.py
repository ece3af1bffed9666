"""Kalman filters and smoothers of many tracks at once, in compiled loops.

`linear` has one model, `imm` two that interact. Nothing imports numba before the first call;
that call compiles, or loads what was compiled (see `prepare`).
"""

from importlib import import_module

from isac_track.kalman.imm import ImmStates, Moods, imm_last, imm_smoother
from isac_track.kalman.linear import (
    MAX_REJECTIONS,
    Batch,
    LastState,
    kalman_last,
    smooth_positions,
)

__all__ = [
    "MAX_REJECTIONS",
    "Batch",
    "ImmStates",
    "LastState",
    "Moods",
    "imm_last",
    "imm_smoother",
    "kalman_last",
    "prepare",
    "smooth_positions",
]


def prepare() -> None:
    """Compile everything, or load it from the cache.

    Otherwise the first call does, for what it needs. The machine code is cached beside the
    package, or in the user's cache if that is read-only; where neither can be written it is
    compiled in every process. Worth a call before a timing or before workers start.
    """
    for loops in ("linear", "imm"):
        import_module(f"isac_track.kalman._{loops}_loops")
