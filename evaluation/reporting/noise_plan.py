"""Noise that keeps a privacy limit, by closed forms without a run.

Imports nothing heavy before it is asked for `shaped`.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from functools import partial
from typing import TYPE_CHECKING

from isac_track.kalman import steady

if TYPE_CHECKING:
    from isac_track.types import Floats

_TAU_S = 5.0  # Time constant of slow noise.
_SEEN_S = 30.0  # Duration of a walk in view.
_MOST_M = 1e5  # Noise per axis beyond which nothing is proposed.
_STEP_M = 0.01  # Proposals are rounded up to it, so that they keep the limit.


def plan_lines(*, plr: float, epsilon_m: float, q: float, dt_s: float) -> list[str]:
    """Return which noise keeps an attacked PLR below a limit, line by line.

    There are white noise, slow noise, and smooth noise; then the run that tries them.
    `plr` is the limit, `q` in m^2/s^3 the spectral density of the people's
    acceleration, `dt_s` the time between samples. ValueError for a limit that is not
    between 0 and 1, or another number that is not positive.
    """
    white_m, lines = _white(plr=plr, epsilon_m=epsilon_m, q=q, dt_s=dt_s)
    # The motion-free bound, solved for its standard deviation.
    slow = epsilon_m * math.sqrt((2.0 + _SEEN_S / _TAU_S) / (-4.0 * math.log1p(-plr)))
    slow = math.ceil(slow / _STEP_M) * _STEP_M
    floor_m, smooth = _smooth(plr=plr, epsilon_m=epsilon_m, q=q, dt_s=dt_s)
    shaped = [] if floor_m is None else [f"    --mechanism shaped:{floor_m:.2f} \\"]
    return [
        *lines,
        f"Slow noise (ou, tau_s = {_TAU_S:g}): {slow:.2f} m per axis.",
        (
            f"  No attack knows more on average over {_SEEN_S:g} s, however well it"
            " knows walking."
        ),
        "  A map, a known position, repeats or companions void this (mechanisms.md).",
        *smooth,
        "Only a run tells how many conflicts a robot then misses:",
        f"  python -m evaluation.matrix --mechanism raw --mechanism ou:{slow:.2f} \\",
        *shaped,
        f"    --mechanism fixed:{white_m:.2f},adding=independent,law=isotropic",
    ]


def short_lines(*, plr: float, epsilon_m: float, q: float, dt_s: float) -> list[str]:
    """Return the white noise of a limit, and the level of `shaped` if one keeps it."""
    numbers = {"plr": plr, "epsilon_m": epsilon_m, "q": q, "dt_s": dt_s}
    _, white = _white(**numbers)
    _, smooth = _smooth(**numbers)
    return [*white[:2], *smooth[:2]]


def _white(
    *, plr: float, epsilon_m: float, q: float, dt_s: float
) -> tuple[float, list[str]]:
    """Return the standard deviation of white noise per axis, m, and what it gives."""
    for name, value in (("epsilon", epsilon_m), ("q", q), ("dt", dt_s)):
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"--{name} must be positive, got {value:g}")
    try:
        needed = steady.variance_for(plr=plr, dt_s=dt_s, q=q, epsilon_m=epsilon_m)
    except ArithmeticError:  # overflow
        needed = math.inf
    if not 0.0 < needed <= _MOST_M**2:
        raise ValueError(
            f"a limit of {plr:g} with these numbers takes no noise, or noise beyond "
            f"{_MOST_M / 1000:g} km: the closed forms do not reach that far"
        )
    filtered = steady.filtered_variance_m2(variance_m2=needed, dt_s=dt_s, q=q)
    shared = steady.plr_of_variance(variance_m2=needed, epsilon_m=epsilon_m)
    total_m, known_m = math.sqrt(needed), math.sqrt(filtered)
    return total_m, [
        (
            f"White noise: {total_m:.2f} m per axis in all, raw error and added noise"
            " together."
        ),
        (
            f"  A smoother knows {plr:.1%} of positions to {epsilon_m:g} m"
            f" ({shared:.1%} as sent)."
        ),
        f"  A robot that filters knows positions to {known_m:.2f} m per axis.",
        f"  Closed form, steady state: q = {q:g} m^2/s^3, dt = {dt_s:g} s.",
    ]


def _smooth(
    *, plr: float, epsilon_m: float, q: float, dt_s: float
) -> tuple[float | None, list[str]]:
    """Return the level of `shaped` that keeps a limit, m, and what it gives.

    It is the lowest with which a smoother of a single release keeps within the limit;
    None if there is no such level.
    """
    from isac_track.kalman import spectra  # noqa: PLC0415 - heavy
    from isac_track.mechanisms.shaped import (  # noqa: PLC0415 - as above
        OPTIMA,
        Shaped,
    )

    world = spectra.World(q=q, dt_s=dt_s)
    least, most = (round(row[0] / _STEP_M) for row in (OPTIMA[0], OPTIMA[-1]))
    levels = [Shaped(step * _STEP_M) for step in range(least, most + 1)]
    shares = partial(spectra.known_shares, epsilon_m=epsilon_m, world=world)

    def density(level: Shaped) -> Floats:
        return spectra.matern_density(
            std_m=level.std_m, theta_s=0.5 * level.tau_s, order=spectra.SMOOTH_ORDER
        )

    place = bisect_left(
        levels, True, key=lambda level: shares(density(level), releases=1)[0] <= plr
    )
    if place == len(levels):
        return None, [
            f"No level of shaped is that large ({OPTIMA[-1][0]:g} m at most)."
        ]
    level = levels[place]
    noise = density(level)
    alone, _ = shares(noise, releases=1)
    _, strong = shares(noise)
    error_m, least_m = (
        spectra.predicted_rms_m(size * noise, world=world) for size in (1.0, 0.0)
    )
    return level.floor_m, [
        (
            f"Smooth noise (shaped:{level.floor_m:.2f}): {level.std_m:.2f} m per axis,"
            f" correlated over {level.tau_s:.1f} s."
        ),
        f"  A smoother knows {alone:.1%} of positions to {epsilon_m:g} m.",
        (
            f"  With {world.releases} releases and a known position it knows"
            f" {strong:.1%}."
        ),
        (
            f"  A robot errs by {error_m:.2f} m per axis {world.horizon_s:g} s ahead"
            f" ({least_m:.2f} m without noise)."
        ),
        "  Among stationary Gaussian noise it is the best known (shaped.md).",
        f"  Closed form in a model world, raw error {world.raw_m:g} m per axis.",
    ]
