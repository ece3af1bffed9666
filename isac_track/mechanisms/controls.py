"""Controls: sharing that moves the descriptors and what can be linked apart from each other.

None is meant as a protection. `correlated` hides each sample as well as `fixed` does,
but leaves neighbouring errors alike; `offset` moves a walk as a whole and keeps its
shape; `thin` shares fewer samples. A descriptor that tells how linkable people are must
tell under these as well.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import ClassVar, Final, get_args

import numpy as np
from numpy.random import Generator

from isac_track.mechanisms.perturb import check_at_least, perturb
from isac_track.sensing import track_directions
from isac_track.types import Adding, ErrorLaw, Floats, Ints, Release, Sensed, positive


def correlated_errors(
    *, t: Floats, offsets: Ints, law: ErrorLaw, tau_s: float, rng: Generator
) -> Floats:
    """Draw standardised errors that change slowly along each track, (M, 2).

    Every sample has the law of `isac_track.sensing.unit_errors`; two samples c, d of
    one track have E[c . d] = exp(-|t_c - t_d| / tau_s) E[|c|^2], tracks are independent
    of each other. `isotropic`: two Ornstein-Uhlenbeck processes. `radial`: one of time
    constant 2 tau_s times a direction that moves on the circle as Brownian motion, with
    E[cos turn] = exp(-dt / 2 tau_s). `fixed_direction`: one of time constant tau_s
    times a direction that is drawn once a track. All are exact at any instants, and use
    three draws a sample. `t` are (M,) s, increasing within a track, `offsets` (N + 1,),
    `tau_s` is positive. An unknown law is a ValueError.
    """
    if law not in get_args(ErrorLaw):
        raise ValueError(
            f"unknown error law {law!r}; known: {', '.join(get_args(ErrorLaw))}"
        )
    draws = rng.standard_normal((t.size, 3))
    first = offsets[:-1]
    dt_s = np.diff(t, prepend=t[:1])
    # Stationary from the first sample on: nothing is known from before it.
    elapsed = dt_s / (2.0 * tau_s if law == "radial" else tau_s)
    elapsed[first] = np.inf
    decay, noise = np.exp(-elapsed), np.sqrt(-np.expm1(-2.0 * elapsed))
    if law == "isotropic":
        return _recursion(decay, noise[:, None] * draws[:, 1:])
    amplitude = _recursion(decay, noise[:, None] * draws[:, :1])
    if law == "fixed_direction":
        return amplitude * track_directions(draws[:, 1:], offsets=offsets)
    turn = (
        np.sqrt(np.abs(dt_s) / tau_s) * draws[:, 1]
    )  # |...|: from one track to the next
    turn[first] = np.arctan2(draws[first, 2], draws[first, 1])
    remembers = np.ones(t.size)
    remembers[first] = 0.0
    angle = _recursion(remembers, turn[:, None])
    return np.asarray(amplitude * np.hstack([np.cos(angle), np.sin(angle)]))


def _recursion(decay: Floats, step: Floats) -> Floats:
    """Return x_k = decay_k x_(k-1) + step_k, (M, D), in place of the steps; decay 0 starts anew."""
    import_module("isac_track.kalman._error_loops").recursion(decay, step)
    return step


@dataclass(frozen=True, slots=True)
class Correlated:
    """Add errors as large as those of `fixed`, but alike from sample to sample.

    By itself each sample is as far off as under `fixed` with the same `d_sigma` and
    adding rule. With linear adding the whole error is redrawn, sigma_raw + d_sigma
    times the slow one.
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
        changed = sensed.sigma_raw[:, None] * (unit - sensed.unit_error)
        redrawn = replace(sensed, xy=sensed.xy + changed, unit_error=unit)
        return perturb(redrawn, self.d_sigma, rng, adding=self.adding)


@dataclass(frozen=True, slots=True)
class Offset:
    """Move every track as a whole: the same way for all of its samples, in a random direction.

    Declared is the standard deviation of the raw estimates: the displacement says
    nothing of how far samples scatter, and whoever smooths weighs them by what is
    declared.
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
    """Share every n-th sample only, as `fixed` would; the last of a track is always one of them.

    The error is drawn for all samples first: those that are shared lie where `fixed`
    puts them.
    """

    every: int  # One sample in so many is shared.
    adding: Adding = "linear"
    d_sigma: float = 0.0  # m

    protects: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_at_least("every", self.every, 1)
        check_at_least("d_sigma", self.d_sigma, 0, " m")

    @property
    def adds_error(self) -> bool:
        """Without an error of its own it shares the same under either adding rule."""
        return self.d_sigma > 0

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the thinned release."""
        whole = perturb(sensed, self.d_sigma, rng, adding=self.adding)
        sizes = np.diff(whole.offsets)
        kept = (
            np.repeat(whole.offsets[1:] - 1, sizes) - np.arange(whole.t.size)
        ) % self.every == 0
        assert whole.sigma is not None
        return Release(
            t=whole.t[kept],
            xy=whole.xy[kept],
            sigma=whole.sigma[kept],
            offsets=np.concatenate([[0], np.cumsum(-(-sizes // self.every))]),
            pseudonym=whole.pseudonym,
        )


MECHANISMS: Final[Mapping[str, type]] = {
    "correlated": Correlated,
    "offset": Offset,
    "thin": Thin,
}
"""By the name in a SPEC."""
