"""What leaves the network: raw, fixed and FID-controlled sharing, and the clean ceiling.

A mechanism says how much error each sample gets; error law and adding rule live in
`perturb` alone.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Final

import numpy as np
from numpy.random import Generator

from isac_track.sensing import unit_errors
from isac_track.types import (
    Adding,
    ErrorLaw,
    Floats,
    Release,
    Sensed,
    positive,
    read_only,
    within,
)

_REMEMBERED = (
    5  # Errors of a block, of both halves of who is learnt from, and of two repeats.
)


def perturb(
    sensed: Sensed,
    d_sigma: Floats | float,
    rng: Generator,
    *,
    adding: Adding = "linear",
    law: ErrorLaw | None = None,
    unit_error: Floats | None = None,
) -> Release:
    """Add an error of standard deviation `d_sigma` to the raw estimates.

    `linear` (eq. shared_sigma): the standard deviations add, sigma_raw + d_sigma; the
    true error is scaled, which only somebody who knows the truth can do. `independent`
    (eq. swarm_shared): the variances add, as a fresh error has a direction of its own.

    `d_sigma` is (M,) m, or one number; `rng` draws the fresh error and the pseudonyms.
    The fresh error has the `law` of the raw error unless told otherwise, or is itself
    given, standardised: `unit_error`, (M, 2). The release declares the standard
    deviation of every sample. ValueError if `d_sigma` is negative, not finite or
    misshapen, a rule unknown, or linear with another error.
    """
    given = np.asarray(d_sigma, dtype=np.float64)
    extra: Floats = np.broadcast_to(given, sensed.t.shape)
    if not within(given, 0.0, np.finfo(np.float64).max):
        raise ValueError("d_sigma must be finite and not negative")
    pseudonym = _pseudonyms(len(sensed), rng)
    if adding == "linear":
        if law not in (None, sensed.law):
            raise ValueError("linear adding scales the raw error and so keeps its law")
        if unit_error is not None:
            raise ValueError("linear adding scales the raw error and takes no other")
        unit_error, sigma = sensed.unit_error, sensed.sigma_raw + extra
    elif adding == "independent":
        if unit_error is None:
            unit_error = _fresh_errors(sensed, law or sensed.law, rng)
        sigma = np.sqrt(sensed.sigma_raw**2 + extra**2)
    else:
        raise ValueError(f"unknown adding rule {adding!r}; known: linear, independent")
    xy = np.empty_like(sensed.xy)
    if given.size == 1:
        np.multiply(unit_error, given, out=xy)
    else:
        for axis in range(2):  # both at once would take longer
            np.multiply(unit_error[:, axis], extra, out=xy[:, axis])
    xy += sensed.xy
    return Release(
        t=sensed.t, xy=xy, sigma=sigma, offsets=sensed.offsets, pseudonym=pseudonym
    )


def _fresh_errors(sensed: Sensed, law: ErrorLaw, rng: Generator) -> Floats:
    """Return `unit_errors` of a release, made once for all levels: their streams start alike."""
    state = rng.bit_generator.state
    if state["bit_generator"] != "PCG64" or law == "fixed_direction":
        return unit_errors(
            n_samples=sensed.t.size, law=law, rng=rng, offsets=sensed.offsets
        )
    errors, rng.bit_generator.state = _errors_from(
        json.dumps(state), sensed.t.size, law
    )
    return errors


@lru_cache(maxsize=_REMEMBERED)
def _errors_from(
    state: str, n_samples: int, law: ErrorLaw
) -> tuple[Floats, Mapping[str, Any]]:
    """Return what a generator in a state, as JSON, draws, and its state afterwards."""
    bits = np.random.PCG64(0)
    bits.state = json.loads(state)
    errors = unit_errors(n_samples=n_samples, law=law, rng=np.random.Generator(bits))
    return read_only(errors), bits.state


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


def check_at_least(name: str, value: float, least: float, unit: str = "") -> None:
    """Raise ValueError if a mechanism's parameter is below `least` or not finite."""
    if not (np.isfinite(value) and value >= least):
        raise ValueError(f"{name} must be {least}{unit} or more, got {value}")


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
            pseudonym=_pseudonyms(len(sensed), rng),
        )


def _pseudonyms(n_tracks: int, rng: Generator) -> tuple[str, ...]:
    # A spawned child leaves the stream of the errors untouched.
    (child,) = rng.spawn(1)
    return names_of(child.integers(0, 256, 8 * n_tracks, np.uint8).tobytes())


def names_of(drawn: bytes) -> tuple[str, ...]:
    """Return a pseudonym for every eight bytes."""
    text = drawn.hex()
    return tuple([text[start : start + 16] for start in range(0, len(text), 16)])


MECHANISMS: Final[Mapping[str, type]] = {
    "raw": Raw,
    "fixed": Fixed,
    "fid": Fid,
    "clean": Clean,
}
"""By the name in a SPEC."""
