"""The mechanisms of the paper: raw, fixed and FID-controlled sharing, and a clean ceiling."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.random import Generator

from isac_track.mechanisms.perturb import check_at_least, draw_pseudonyms, perturb
from isac_track.types import Adding, ErrorLaw, Floats, Release, Sensed, positive


def fid_d_sigma(*, fid: Floats, eta: float, alpha_m: float, beta: float) -> Floats:
    """Return the additional standard deviation of the FID rule, (M,) m.

    Eqs. fid_ratio and fid_error_control: nothing up to the threshold, then alpha *
    (beta - exp(-(rho - 1))), from alpha * (beta - 1) just above it to alpha * beta.
    `fid` and the threshold `eta`, positive, are in 1/(m^2 s), `beta` is at least 1.
    """
    rho = fid / eta
    below = ~(rho > 1.0)
    # The exponent is clipped at 0 where the rule does not apply, lest it overflow
    # there.
    extra: Floats = np.minimum(np.subtract(1.0, rho, out=rho), 0.0, out=rho)
    np.exp(extra, out=extra)
    extra = np.multiply(alpha_m, np.subtract(beta, extra, out=extra), out=extra)
    extra[below] = 0.0
    return extra


@dataclass(frozen=True, slots=True)
class Raw:
    """Share the raw sensing estimates."""

    adds_error: ClassVar[bool] = False
    protects: ClassVar[bool] = False

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the raw estimates under pseudonyms."""
        return perturb(sensed, 0.0, rng)


@dataclass(frozen=True, slots=True)
class Fixed:
    """Add the same standard deviation to every sample (the paper's baseline)."""

    d_sigma: float  # m
    adding: Adding = "linear"
    law: ErrorLaw | None = None  # Law of the added error; None: that of the raw error.

    protects: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_at_least("d_sigma", self.d_sigma, 0, " m")

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the estimates with `d_sigma` more error."""
        return perturb(sensed, self.d_sigma, rng, adding=self.adding, law=self.law)


@dataclass(frozen=True, slots=True)
class Fid:
    """Add error where the Fisher information density exceeds eta (the paper's mechanism)."""

    eta: float  # 1/(m^2 s)
    alpha: float = 0.5  # m
    beta: float = 1.5
    adding: Adding = "linear"
    law: ErrorLaw | None = None  # Law of the added error; None: that of the raw error.

    sweep: ClassVar[str] = "log"
    protects: ClassVar[bool] = True

    def __post_init__(self) -> None:
        positive("eta", self.eta)
        check_at_least("alpha", self.alpha, 0, " m")
        check_at_least("beta", self.beta, 1)

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the estimates with the rule's additional error."""
        d_sigma = fid_d_sigma(
            fid=sensed.fid, eta=self.eta, alpha_m=self.alpha, beta=self.beta
        )
        return perturb(sensed, d_sigma, rng, adding=self.adding, law=self.law)


@dataclass(frozen=True, slots=True)
class Clean:
    """Share the truth: no sensing error, nothing added. The ceiling of every attack."""

    adds_error: ClassVar[bool] = False
    protects: ClassVar[bool] = False

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the true positions, declared with a standard deviation of 0 m."""
        return Release(
            t=sensed.t,
            xy=sensed.xy - sensed.sigma_raw[:, None] * sensed.unit_error,
            sigma=np.zeros_like(sensed.sigma_raw),
            offsets=sensed.offsets,
            pseudonym=draw_pseudonyms(len(sensed), rng),
        )


MECHANISMS: Final[Mapping[str, type]] = {
    "raw": Raw,
    "fixed": Fixed,
    "fid": Fid,
    "clean": Clean,
}
"""By the name in a SPEC."""
