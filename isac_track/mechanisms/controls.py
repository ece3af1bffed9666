"""Controls: mechanisms that change descriptors and linkability independently.

None is meant as a protection. `correlated` hides each sample as well as `fixed` does,
but neighbouring errors are similar; `offset` moves a walk as a whole and keeps its
shape; `thin` shares fewer samples. A descriptor that predicts how linkable people are
must predict it under these as well.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import ClassVar, Final, get_args

import numpy as np
from numpy.random import Generator

from isac_track.measurement import shaped_errors
from isac_track.mechanisms.perturb import check_at_least, perturb
from isac_track.sensing import track_directions
from isac_track.types import Adding, ErrorLaw, Floats, Ints, Release, Sensed, positive


def correlated_errors(
    *, t: Floats, offsets: Ints, law: ErrorLaw, tau_s: float, rng: Generator
) -> Floats:
    """Draw standardised errors that change slowly along each track, (M, 2).

    Every sample has the law of `isac_track.sensing.unit_errors`. Two samples c, d of a
    track have E[c . d] = exp(-|t_c - t_d| / tau_s) E[|c|^2]; tracks are independent.

    - `isotropic`: two Ornstein-Uhlenbeck (OU) processes.
    - `radial`: an OU process of time constant 2 tau_s times a direction that moves on
      the circle as Brownian motion, with E[cos turn] = exp(-dt / 2 tau_s).
    - `fixed_direction`: an OU process of time constant tau_s times a direction that is
      drawn once a track.

    All are exact at any instants, and use three draws a sample. `t` are (M,) s,
    increasing within a track, `offsets` (N + 1,), `tau_s` is positive. An unknown law
    is a ValueError.
    """
    if law not in get_args(ErrorLaw):
        raise ValueError(
            f"unknown error law {law!r}; known: {', '.join(get_args(ErrorLaw))}"
        )
    draws = rng.standard_normal((t.size, 3))
    first = offsets[:-1]
    dt_s = np.diff(t, prepend=t[:1])
    # Stationary from the first sample on, which depends on no earlier sample.
    elapsed = dt_s / (2.0 * tau_s if law == "radial" else tau_s)
    elapsed[first] = np.inf
    decay, noise = np.exp(-elapsed), np.sqrt(-np.expm1(-2.0 * elapsed))
    if law == "isotropic":
        return _recursion(decay, noise[:, None] * draws[:, 1:])
    amplitude = _recursion(decay, noise[:, None] * draws[:, :1])
    if law == "fixed_direction":
        return amplitude * track_directions(draws[:, 1:], offsets=offsets)
    # The step from one track to the next may be negative.
    turn = np.sqrt(np.abs(dt_s) / tau_s) * draws[:, 1]
    turn[first] = np.arctan2(draws[first, 2], draws[first, 1])
    # A decay of 1 sums the turns; 0 starts a new track.
    no_decay = np.ones(t.size)
    no_decay[first] = 0.0
    angle = _recursion(no_decay, turn[:, None])
    return np.asarray(amplitude * np.hstack([np.cos(angle), np.sin(angle)]))


def _recursion(decay: Floats, step: Floats) -> Floats:
    """Overwrite steps, (M, D), with x_k = decay_k x_(k-1) + step_k, and return them."""
    import_module("isac_track.kalman._error_loops").recursion(decay, step)
    return step


@dataclass(frozen=True, slots=True)
class Correlated:
    """Add errors as large as those of `fixed` that change slowly along a track.

    Each sample has the same error distribution as under `fixed` with the same `d_sigma`
    and adding rule. With linear adding the whole error is redrawn: sigma_raw + d_sigma
    times the slow error.
    """

    d_sigma: float  # m
    tau_s: float = 2.0  # Time over which the error's correlation falls to 1/e, s.
    adding: Adding = "linear"

    # Without that no linear benchmark holds.
    errors_are_independent: ClassVar[bool] = False
    protects: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_at_least("d_sigma", self.d_sigma, 0, " m")
        positive("tau_s", self.tau_s)

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the estimates with an error that changes slowly."""
        unit = correlated_errors(
            t=sensed.t,
            offsets=sensed.offsets,
            law=sensed.law,
            tau_s=self.tau_s,
            rng=rng,
        )
        if self.adding == "independent":
            return perturb(
                sensed, self.d_sigma, rng, adding=self.adding, unit_error=unit
            )
        if sensed.cov is not None:
            shaped = shaped_errors(cov=sensed.cov, unit_error=unit, law=sensed.law)
            unit = shaped / sensed.sigma_raw[:, None]
        changed = sensed.sigma_raw[:, None] * (unit - sensed.unit_error)
        redrawn = replace(sensed, xy=sensed.xy + changed, unit_error=unit)
        return perturb(redrawn, self.d_sigma, rng, adding=self.adding)


@dataclass(frozen=True, slots=True)
class Offset:
    """Displace every track as a whole in a random direction.

    The release declares the standard deviation of the raw estimates: a smoother weighs
    samples by their scatter, which the displacement does not change.
    """

    distance: float  # m

    adds_error: ClassVar[bool] = False
    errors_are_independent: ClassVar[bool] = False
    protects: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_at_least("distance", self.distance, 0, " m")

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the raw estimates, each track displaced."""
        angle = rng.uniform(0.0, 2.0 * np.pi, len(sensed))
        shift_m = self.distance * np.column_stack([np.cos(angle), np.sin(angle)])
        raw = perturb(sensed, 0.0, rng)
        return replace(
            raw, xy=raw.xy + np.repeat(shift_m, np.diff(sensed.offsets), axis=0)
        )


@dataclass(frozen=True, slots=True)
class Thin:
    """Share every n-th sample as `fixed` would, counted back from the last of a track.

    The error is drawn for all samples first, so that shared samples lie where `fixed`
    puts them.
    """

    every: int  # The n of every n-th sample.
    adding: Adding = "linear"
    d_sigma: float = 0.0  # m

    protects: ClassVar[bool] = False
    withholds: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_at_least("every", self.every, 1)
        check_at_least("d_sigma", self.d_sigma, 0, " m")

    @property
    def adds_error(self) -> bool:
        """Whether it adds an error; if not, both adding rules share the same."""
        return self.d_sigma > 0

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the thinned release."""
        full = perturb(sensed, self.d_sigma, rng, adding=self.adding)
        sizes = np.diff(full.offsets)
        samples_left = np.repeat(full.offsets[1:] - 1, sizes) - np.arange(full.t.size)
        is_shared = samples_left % self.every == 0
        offsets = np.concatenate([[0], np.cumsum(-(-sizes // self.every))])
        return full.samples(is_shared, offsets=offsets)


MECHANISMS: Final[Mapping[str, type]] = {
    "correlated": Correlated,
    "offset": Offset,
    "thin": Thin,
}
"""By the name in a SPEC."""
