"""White noise that remains after a filter or smoother, and a bound for slow errors.

Closed forms of the steady state: constant velocity driven by white acceleration of
spectral density q (m^2/s^3), measured every dt (s) with the variance r (m^2) per axis.
In the limit of frequent samples only rho = r dt counts (the Wiener-Kolmogorov filter of
a double integrator). Errors are Gaussian. `attacked_plr_bound` holds for any motion and
any attack, within its conditions: docs/explanation/mechanisms.md.

References
----------
Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*,
2001, section 6.5; van Trees, *Detection, Estimation and Modulation Theory* I, 1968, ch.
6.
"""

import math

# Spectral density of the acceleration of pedestrians, as fitted on Students03.
Q_M2_PER_S3 = 0.057
INTERVAL_S = 0.0836  # Mean time between two samples of the paper's histories.
EPSILON_M = 0.3  # Distance below which a sample counts as known: the paper's.


def smoothed_variance_m2(*, variance_m2: float, dt_s: float, q: float) -> float:
    """Return a smoothed position's variance per axis.

    It is q^(1/4) rho^(3/4) / (2 sqrt 2), rho = variance dt.
    """
    return float(q**0.25 * (variance_m2 * dt_s) ** 0.75 / (2.0 * math.sqrt(2.0)))


def filtered_variance_m2(*, variance_m2: float, dt_s: float, q: float) -> float:
    """Return a filtered position's variance per axis: four times the smoothed."""
    return 4.0 * smoothed_variance_m2(variance_m2=variance_m2, dt_s=dt_s, q=q)


def plr_of_variance(*, variance_m2: float, epsilon_m: float) -> float:
    """Return the share of positions known to `epsilon_m` under a Gaussian error.

    The error has the same variance on each axis; the share is in 0..1.
    """
    return (
        -math.expm1(-(epsilon_m**2) / (2.0 * variance_m2)) if variance_m2 > 0 else 1.0
    )


def attacked_plr(
    *, variance_m2: float, dt_s: float, q: float, epsilon_m: float
) -> float:
    """Return the PLR that a smoother reaches against white Gaussian errors, 0..1."""
    smoothed_m2 = smoothed_variance_m2(variance_m2=variance_m2, dt_s=dt_s, q=q)
    return plr_of_variance(variance_m2=smoothed_m2, epsilon_m=epsilon_m)


def variance_for(*, plr: float, dt_s: float, q: float, epsilon_m: float) -> float:
    """Return the error's variance per axis, m^2, with which a smoother reaches a PLR.

    It is that of the whole error, r = [(sqrt 2 eps^2 / -ln(1 - PLR))^4 / (q
    dt^3)]^(1/3). ValueError unless 0 < PLR < 1.
    """
    if not 0.0 < plr < 1.0:
        raise ValueError(f"the limit on PLR must lie between 0 and 1, got {plr:g}")
    smoothed_m2 = math.sqrt(2.0) * epsilon_m**2 / -math.log1p(-plr)
    return float((smoothed_m2**4 / (q * dt_s**3)) ** (1.0 / 3.0))


def attacked_plr_bound(
    *, std_m: float, tau_s: float, duration_s: float, epsilon_m: float
) -> float:
    """Return an upper bound of any attack's expected PLR under a slow error.

    The error is Ornstein-Uhlenbeck of `std_m` per axis and correlation time `tau_s`,
    seen for `duration_s`; an infinite `tau_s` is a constant Gaussian offset. The bound
    holds for any motion, given a prior that a shift of everything does not change: then
    nobody can tell a shift of the walk from a shift of the error. It is 1 - exp(-eps^2
    / 2 V), where V = 2 std^2 / (2 + duration / tau) is the variance of the best
    estimate of a constant in that error.
    """
    spread = 2.0 * std_m**2 / (2.0 + duration_s / tau_s)
    return plr_of_variance(variance_m2=spread, epsilon_m=epsilon_m)
