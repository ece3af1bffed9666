"""The stationary Gaussian noise that costs a robot least for a floor on its adversary.

It is smooth: its spectrum is Gaussian, and holds almost nothing faster than a person's
way across a scene. Derivation and certificate: docs/explanation/shaped.md.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.random import Generator

from isac_track.mechanisms.error_paths import Reuse, check_slow
from isac_track.mechanisms.stationary import add_stationary, smooth_filter
from isac_track.types import Adding, ErrorLaw, Release, Sensed

OPTIMA: Final = (
    (0.07, 0.0938, 7.9978),
    (0.1, 0.1990, 5.7655),
    (0.15, 0.3432, 5.3060),
    (0.2, 0.4779, 5.1893),
    (0.3, 0.7399, 5.1106),
    (0.4, 1.0010, 5.0831),
    (0.6, 1.5355, 5.0928),
    (0.8, 2.0988, 5.1742),
    (1.2, 3.3386, 5.4850),
)
"""Floor, m; standard deviation per axis, m; theta, s: printed by a script.

`scripts/shaped_noise.py` searched them in the world of `isac_track.kalman.spectra`.
"""


@dataclass(frozen=True, slots=True)
class Shaped:
    """Add the smooth noise that keeps a floor on the adversary's error.

    In the model world an adversary with four releases and one known position keeps an
    rms error of the floor, per axis. 0 adds nothing.
    """

    floor_m: float
    """m per axis; 0, or within the floors of `OPTIMA`: between them log-linear."""
    reuse: Reuse = "release"

    plain_name: ClassVar[str] = "shaped noise, floor {level} m"
    about: ClassVar[str] = (
        "Smooth slow noise that costs a robot least for the error, in m, that it"
        " leaves an adversary with four releases and a known position."
    )
    adding: ClassVar[Adding] = "independent"
    law: ClassVar[ErrorLaw] = "isotropic"
    protects: ClassVar[bool] = True
    errors_are_independent: ClassVar[bool] = False

    def __post_init__(self) -> None:
        least, most = OPTIMA[0][0], OPTIMA[-1][0]
        if self.floor_m != 0.0 and not least <= self.floor_m <= most:
            raise ValueError(
                f"floor_m must be 0, or {least:g} to {most:g} m, got {self.floor_m:g}"
            )
        check_slow(self.tau_s, self.reuse)

    @property
    def std_m(self) -> float:
        """Standard deviation of the added error per axis, m."""
        return self._interpolated(1) if self.floor_m else 0.0

    @property
    def tau_s(self) -> float:
        """Time over which the correlation of the error falls to 1/e, s."""
        # The spectrum exp(-(w theta)^2) has the correlation exp(-(dt / 2 theta)^2).
        return 2.0 * self._interpolated(2)

    def _interpolated(self, column: int) -> float:
        table = np.log(OPTIMA)
        place = math.log(max(self.floor_m, OPTIMA[0][0]))
        return math.exp(np.interp(place, table[:, 0], table[:, column]))

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the raw estimates with the smooth noise on top."""
        return add_stationary(
            sensed,
            self.std_m,
            rng,
            shape=smooth_filter(self.tau_s),
            reuse=self.reuse,
        )


MECHANISMS: Final[Mapping[str, type]] = {"shaped": Shaped}
"""By the name in a SPEC."""
