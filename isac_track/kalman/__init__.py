"""Kalman filters and smoothers of many tracks at once, in compiled loops.

`linear` has one model, `imm` two that interact. Nothing imports numba before the first call;
that call compiles, or loads what was compiled (see `prepare`).
"""

from isac_track.kalman.batch import MAX_REJECTIONS, Batch
from isac_track.kalman.caching import prepare
from isac_track.kalman.imm import ImmStates, Moods, imm_last, imm_smoother
from isac_track.kalman.linear import LastState, kalman_last, smooth_positions

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
