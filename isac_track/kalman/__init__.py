"""Kalman filters and smoothers of many tracks at once, in compiled loops.

`linear` has one model, `imm` several that interact. Nothing imports numba before the first call;
that call compiles, or loads what was compiled (see `prepare`).
"""

from isac_track.kalman.caching import prepare
from isac_track.kalman.imm import (
    ImmFiltered,
    ImmLastState,
    ImmSmoothed,
    imm_filter,
    imm_last,
    imm_smoother,
)
from isac_track.kalman.linear import (
    MAX_REJECTIONS,
    Filtered,
    LastState,
    Smoothed,
    kalman_filter,
    kalman_last,
    kalman_smoother,
    rts_smoother,
    smooth_positions,
)

__all__ = [
    "MAX_REJECTIONS",
    "Filtered",
    "ImmFiltered",
    "ImmLastState",
    "ImmSmoothed",
    "LastState",
    "Smoothed",
    "imm_filter",
    "imm_last",
    "imm_smoother",
    "kalman_filter",
    "kalman_last",
    "kalman_smoother",
    "prepare",
    "rts_smoother",
    "smooth_positions",
]
