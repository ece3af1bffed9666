"""Kalman filters and smoothers of many tracks at once, in compiled loops.

`linear` has one model, `imm` several that interact. Nothing imports numba before the first call;
that call compiles, or loads what was compiled (see `prepare`).
"""

from isac_track.kalman.caching import prepare
from isac_track.kalman.imm import ImmStates, imm_filter, imm_last, imm_smoother
from isac_track.kalman.linear import MAX_REJECTIONS, LastState, kalman_last, smooth_positions

__all__ = [
    "MAX_REJECTIONS",
    "ImmStates",
    "LastState",
    "imm_filter",
    "imm_last",
    "imm_smoother",
    "kalman_last",
    "prepare",
    "smooth_positions",
]
