"""Compiled loops that cells call: each compiled once, in parallel, before the cells.

A loop that is missing here is compiled by the first process that calls it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Final

from evaluation.compute.current_cell import note_cell
from isac_track.kalman.slow_errors import added_error

if TYPE_CHECKING:
    from evaluation.plan.consumer import Consumer
    from isac_track.plugins import Plugin

COMPILING, COMPILED, LOADED = "compiling", "compiled", "loaded"
GAIN: Final = "isac_track._gain_loop:correlated"
"""Loop of the channel: every run senses, and its manifest describes the channel."""
_DESCRIPTORS: Final = ("isac_track._privacy_loop:described",)
_NOISE: Final = ("isac_track.kalman._linear_loops:innovation_level",)
_FILTER: Final = ("isac_track.kalman._linear_loops:cv_last", *_NOISE)
_SMOOTHING_ATTACK: Final = (
    "isac_track.kalman._linear_loops:smooth_positions",
    "isac_track.kalman._error_loops:smooth_lanes",
    "isac_track.kalman._error_loops:log_likelihoods",
    "isac_track.kalman._linear_loops:innovations_by_interval",
    *_NOISE,
)
_SCORECARD: Final = tuple(
    f"isac_track.linkability._loops:{name}"
    for name in (
        "read_scores",
        "assign",
        "rank_rows",
        "mean_shares",
        "shuffle",
        "add_shuffles",
    )
)
_LOG_READER: Final = ("isac_track.kalman._linear_loops:smooth_positions", *_FILTER)
_BY_KIND: Final = {
    "log": _LOG_READER,
    "tracks": _LOG_READER,
    "track_log": _LOG_READER,
    "track_link": ("attacks.linkage._lag_loop:continuation_densities", *_FILTER),
}
"""Loops of an adversary that no plug-in stands for, by the kind of the consumer."""
_SLOW_ERROR_MECHANISM: Final = ("isac_track.kalman._error_loops:recursion",)
"""Further loops of a mechanism whose error changes slowly."""
_SLOW_ERROR_ATTACK: Final = (
    "isac_track.kalman._error_loops:filter_tracks",
    "isac_track.kalman._error_loops:smooth_tracks",
)
_BEHIND_SLOW_ERROR: Final = {
    "predictor": ("isac_track.kalman._error_loops:filter_tracks",),
    "attack": _SLOW_ERROR_ATTACK,
}
"""Further loops of a consumer behind such an error, by its kind."""
_PLUGIN_LOOPS: Final = {
    "kalman_cv": _FILTER,
    "kalman_ca": ("isac_track.kalman._linear_loops:ca_last", *_NOISE),
    "kalman_imm": ("isac_track.kalman._imm_loops:imm_last", *_NOISE),
    "moving_average": ("attacks.reconstruction._window_loops:centred_means",),
    "savgol": ("attacks.reconstruction._window_loops:fit_parabolas",),
    "kalman_rts": _SMOOTHING_ATTACK,
    "radial_rts": _SMOOTHING_ATTACK,
    "ou_rts": _SMOOTHING_ATTACK,
    "gaussian_process": _SMOOTHING_ATTACK,
    "kinematic": ("attacks.linkage._lag_loop:continuation_densities", *_FILTER),
    "shape": (
        "attacks.linkage._lag_loop:least_costs",
        "attacks.linkage._lag_loop:cell_means",
    ),
    "profile": (
        "attacks.linkage._lag_loop:least_costs",
        "attacks.linkage._lag_loop:cell_means",
    ),
    "dtw": ("attacks.linkage._lag_loop:warp", "attacks.linkage._lag_loop:cell_means"),
    "histogram": (
        "attacks.linkage._lag_loop:shared_cells",
        "attacks.linkage._lag_loop:cell_means",
    ),
    "likelihood_ratio": (
        "attacks.linkage._ratio_loop:ratios",
        "attacks.linkage._ratio_loop:take_sides",
        "attacks.linkage._ratio_loop:accumulate_information",
        *_SMOOTHING_ATTACK,
    ),
}
"""By the name of the plug-in, without its parameters."""
_SLOWEST: Final = (
    "read_scores",
    "fit_parabolas",
    "ratios",
    "least_costs",
    "described",
    "centred_means",
)
"""The loops that compile longest: they begin, so that no process waits at the end."""


def list_loops(cells: Iterable[tuple[Plugin, Consumer]]) -> list[str]:
    """Return the loops of some cells, as ``package.module:loop``, the slowest first."""
    loops = {GAIN: None}
    for mechanism, consumer in cells:
        loops |= dict.fromkeys(_cell_loops(mechanism, consumer))
    ranks = {name: rank for rank, name in enumerate(_SLOWEST)}
    return sorted(loops, key=lambda name: ranks.get(name.partition(":")[2], len(ranks)))


def _cell_loops(mechanism: Plugin, consumer: Consumer) -> Iterator[str]:
    std_m, tau_s = added_error(mechanism.instance)
    is_slow = std_m > 0.0 and tau_s > 0.0
    if is_slow:
        yield from _SLOW_ERROR_MECHANISM
        yield from _BEHIND_SLOW_ERROR.get(consumer.kind, ())
    if consumer.kind in {"shared", "attack", "windows"}:
        yield from _DESCRIPTORS
    if consumer.kind in {"linkage", "link_bound", "control"}:
        yield from _SCORECARD
    yield from _BY_KIND.get(consumer.kind, ())
    for plugin in consumer.plugins:
        yield from _PLUGIN_LOOPS.get(plugin.name.partition(":")[0], ())
        if is_slow and consumer.kind != "predictor":
            yield from _SLOW_ERROR_ATTACK


def prepare_loop_in_steps(name: str) -> Iterator[str]:
    """Load a loop or compile it, in a process that may be a worker.

    Yields `COMPILING` before a loop that numba's cache lacks, and at the end `COMPILED`
    if that filled the cache, `LOADED` if not. Errors are ignored here: the first cell
    that calls the loop fails by name.
    """
    note_cell()
    fills_cache = False
    with contextlib.suppress(Exception):
        from isac_track import compiling  # noqa: PLC0415 - imports numba

        if not compiling.is_cached(name):
            yield COMPILING
        fills_cache = compiling.prepare_loop(name, quietly=True)
    yield COMPILED if fills_cache else LOADED
