"""What the best adversary keeps of each noise, and what a wrong model costs.

`python scripts/noise_spectra.py` prints the table of the page on the mechanisms of the
literature, and the losses of docs/explanation/shaped.md; ten seconds.
"""

import math

import numpy as np
from scipy.linalg import toeplitz

from isac_track.kalman import spectra
from isac_track.mechanisms.literature import LeastInformation, Qclm
from isac_track.mechanisms.protections import Ou
from isac_track.mechanisms.shaped import Shaped
from isac_track.types import Floats

_STD_M = 0.5  # Size at which mechanisms are compared.
_WHITE_S = 0.042  # Half the interval of sensing: in effect white.
_LAGS_S = (1.0, 4.0, 8.0, 15.0, 22.0)  # From a position to the known position.
_WORLD = spectra.WORLD


def noises() -> dict[str, Floats]:
    """Return the spectral densities of mechanisms of one size, (F,) m^2 s."""
    w = spectra.frequencies()
    smooth_s = 0.5 * Qclm(_STD_M).tau_s
    corner = w / LeastInformation(_STD_M).corner_per_s
    shapes = {
        "white": spectra.matern_density(std_m=1.0, theta_s=_WHITE_S, order=1.0),
        "ou": spectra.matern_density(std_m=1.0, theta_s=Ou(1.0).tau_s, order=1.0),
        "ou 15 s": spectra.matern_density(std_m=1.0, theta_s=15.0, order=1.0),
        "gp_prior, qclm": np.exp(-np.square(w * smooth_s)),
        # A long series has the variances E_k^(2/3) at its frequencies.
        "fourier": np.exp(-2.0 / 3.0 * np.square(w * smooth_s)),
        "least_information": 2.0 / (1.0 + np.sqrt(1.0 + 4.0 * corner**4)),
    }
    return {
        name: density * (_STD_M / spectra.std_of_density(density)) ** 2
        for name, density in shapes.items()
    }


def price_m(noise: Floats, assumed: Floats) -> float:
    """Return the price for a robot that assumes another noise; (n, n) m^2 both."""
    n = len(noise)
    t = np.append(np.linspace(0.0, _WORLD.seen_s, n), _WORLD.seen_s + _WORLD.horizon_s)
    walk = walk_covariance(t)
    white = _WORLD.raw_m**2 * _WORLD.dt_s / _WORLD.step_s * np.eye(n)
    seen, ahead = walk[:-1, :-1] + white, walk[:-1, -1]
    gain = np.linalg.solve(seen + assumed, ahead)
    return math.sqrt(walk[-1, -1] - 2.0 * gain @ ahead + gain @ (seen + noise) @ gain)


def attacked_m(noise: Floats, assumed: Floats) -> float:
    """Return the adversary's error in mid-walk, who assumes another noise."""
    n, k = len(noise), _WORLD.releases
    t = np.arange(n) * _WORLD.step_s
    walk, middle, errors = walk_covariance(t), n // 2, []
    white = _WORLD.raw_m**2 * _WORLD.dt_s / _WORLD.step_s * np.eye(n)
    for lag_s in _LAGS_S:
        rows = np.append(np.arange(n), middle + round(lag_s / _WORLD.step_s))
        joint = walk[np.ix_(rows, rows)]
        known, truth = joint.copy(), joint.copy()
        known[:n, :n] += (assumed + white) / k
        truth[:n, :n] += (noise + white) / k
        known[n, n] += 1e-4
        truth[n, n] += 1e-4
        target = walk[rows, middle]
        gain = np.linalg.solve(known, target)
        left = walk[middle, middle] - 2.0 * gain @ target + gain @ truth @ gain
        errors.append(left)
    return math.sqrt(np.mean(errors))


def walk_covariance(t: Floats) -> Floats:
    """Return the covariance of a walk's positions from anywhere, (n, n) m^2."""
    early, late = np.minimum(t[:, None], t), np.maximum(t[:, None], t)
    walk = 1e4 + 1e2 * np.outer(t, t)
    return np.asarray(walk + _WORLD.q * early**2 * (3.0 * late - early) / 6.0)


def noise_covariance(
    *, std_m: float, tau_s: float, is_smooth: bool, n: int = 151
) -> Floats:
    """Return the covariance of smooth or Ornstein-Uhlenbeck noise, (n, n) m^2."""
    lag = np.arange(n) * _WORLD.step_s / tau_s
    return np.asarray(std_m**2 * toeplitz(np.exp(-(lag**2) if is_smooth else -lag)))


def main() -> None:
    """Print a row a mechanism, then a row a floor."""
    for name, density in noises().items():
        alone, anchored = spectra.smoothed_rms_m(density, releases=1)
        floor, price = spectra.floor_m(density), spectra.predicted_rms_m(density)
        print(f"{name}: {alone:.3f} {anchored:.3f} {floor:.3f} {price:.3f}")
    for floor in (0.1, 0.15, 0.21, 0.3):
        mechanism = Shaped(floor)
        law = {"std_m": mechanism.std_m, "tau_s": mechanism.tau_s}
        true, wrong = (noise_covariance(**law, is_smooth=s) for s in (True, False))
        robot = price_m(true, wrong) / price_m(true, true) - 1.0
        naive = price_m(true, 0.0 * true) / price_m(true, true) - 1.0
        true, wrong = (
            noise_covariance(**law, is_smooth=s, n=301) for s in (True, False)
        )
        attack = attacked_m(true, wrong) / attacked_m(true, true) - 1.0
        print(
            f"floor {floor:g} m: taking it for ou costs a robot {robot:.1%},"
            f" an adversary {attack:.1%}; not knowing of it costs a robot {naive:.1%}"
        )
    ou = spectra.matern_density(std_m=1.0, theta_s=Ou(1.0).tau_s, order=1.0)
    std_m = spectra.std_of_density(spectra.scaled_to(ou, floor=0.3))
    true = noise_covariance(std_m=std_m, tau_s=Ou(1.0).tau_s, is_smooth=False)
    naive = price_m(true, 0.0 * true) / price_m(true, true) - 1.0
    print(f"ou of 5 s, floor 0.3 m: not knowing of it costs a robot {naive:.1%}")


if __name__ == "__main__":
    main()
