"""Noise that keeps a privacy limit, by closed forms without a run.

Imports nothing heavy.
"""

import math

from isac_track.kalman import steady

_TAU_S = 5.0  # Time constant of slow noise.
_SEEN_S = 30.0  # Duration of a walk in view.
_MOST_M = 1e5  # Noise per axis beyond which nothing is proposed.


def plan_lines(*, plr: float, epsilon_m: float, q: float, dt_s: float) -> list[str]:
    """Return which noise keeps an attacked PLR below a limit, line by line.

    `plr` is the limit, `q` in m^2/s^3 the spectral density of the people's
    acceleration, `dt_s` the time between samples. ValueError for a limit that is not
    between 0 and 1, or another number that is not positive.
    """
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
    # The motion-free bound, solved for its standard deviation.
    slow = epsilon_m * math.sqrt((2.0 + _SEEN_S / _TAU_S) / (-4.0 * math.log1p(-plr)))
    # Rounded up to the next centimetre: the proposal must keep the limit.
    slow = math.ceil(100.0 * slow) / 100.0
    total_m, known_m = math.sqrt(needed), math.sqrt(filtered)
    return [
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
        f"Slow noise (ou, tau_s = {_TAU_S:g}): {slow:.2f} m per axis.",
        (
            f"  No attack knows more on average over {_SEEN_S:g} s, however well it"
            " knows walking."
        ),
        "  A map, a known position, repeats or companions void this (mechanisms.md).",
        "Only a run tells how many conflicts a robot then misses:",
        f"  python -m evaluation.matrix --mechanism raw --mechanism ou:{slow:.2f} \\",
        f"    --mechanism fixed:{total_m:.2f},adding=independent,law=isotropic",
    ]
