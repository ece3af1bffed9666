"""What the closed forms say of a limit, before anything is run; imports nothing heavy."""

import math

from isac_track.kalman import steady

_TAU_S, _SEEN_S = 5.0, 30.0  # Of the slow error that is proposed; how long a walk is seen.
_MOST_M = 1e5  # Noise per axis beyond which nothing is proposed: that is to share nothing.


def told(*, plr: float, epsilon_m: float, q: float, dt_s: float) -> list[str]:
    """Return the answer to a limit on the PLR after attack, line by line.

    `q` in m^2/s^3 is that of the people, `dt_s` the time between samples. ValueError for a limit
    that is not between 0 and 1, or another number that is not positive.
    """
    for name, value in (("epsilon", epsilon_m), ("q", q), ("dt", dt_s)):
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"--{name} must be positive, got {value:g}")
    try:
        needed = steady.variance_for(plr=plr, dt_s=dt_s, q=q, epsilon_m=epsilon_m)
    except ArithmeticError:  # beyond what a number can hold
        needed = math.inf
    if not 0.0 < needed <= _MOST_M**2:
        beyond = f"takes a noise beyond {_MOST_M / 1000:g} km or below any: closed forms end here"
        raise ValueError(f"a limit of {plr:g} with these numbers {beyond}")
    filtered = steady.filtered_variance_m2(variance_m2=needed, dt_s=dt_s, q=q)
    shared = steady.plr_of_variance(variance_m2=needed, epsilon_m=epsilon_m)
    # The motion-free bound, solved for its standard deviation.
    slow = epsilon_m * math.sqrt((2.0 + _SEEN_S / _TAU_S) / (-4.0 * math.log1p(-plr)))
    # Up to the next centimetre: what is proposed must not leave more than was asked for.
    slow = math.ceil(100.0 * slow) / 100.0
    total_m, known_m = math.sqrt(needed), math.sqrt(filtered)
    return [
        f"total std per axis, raw and added: {total_m:.2f} m of white Gaussian noise",
        f"  leaves a smoother {plr:.1%} of positions to {epsilon_m:g} m ({shared:.1%} as shared).",
        f"  A robot that filters knows positions to {known_m:.2f} m per axis.",
        f"  Closed form, steady state: q = {q:g} m^2/s^3, dt = {dt_s:g} s.",
        f"A slow error (ou, tau_s = {_TAU_S:g}) of {slow:.2f} m per axis leaves no attack",
        f"  more than that on average, whatever it knows of how people move, over {_SEEN_S:g} s.",
        "  Void with a map, a known position, repeats, or companions: docs/mechanisms.md.",
        "How many conflicts a robot misses under it only a run tells:",
        f"  python -m evaluation.matrix --mechanism raw --mechanism ou:{slow:.2f} \\",
        f"    --mechanism fixed:{total_m:.2f},adding=independent,law=isotropic",
    ]
