"""The error law and the adding rule, applied to a release: one home for all mechanisms.

A mechanism says how much error each sample gets; `perturb` adds it.
"""

import json
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.random import Generator

from isac_track.sensing import unit_errors
from isac_track.types import (
    Adding,
    ErrorLaw,
    Floats,
    Release,
    Sensed,
    read_only,
    within,
)

# Errors of a block, of both halves of the training people, and of two repeats.
_REMEMBERED = 5


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
    pseudonym = draw_pseudonyms(len(sensed), rng)
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


def check_at_least(name: str, value: float, least: float, unit: str = "") -> None:
    """Raise ValueError if a mechanism's parameter is below `least` or not finite."""
    if not (np.isfinite(value) and value >= least):
        raise ValueError(f"{name} must be {least}{unit} or more, got {value}")


def draw_pseudonyms(n_tracks: int, rng: Generator) -> tuple[str, ...]:
    """Draw a pseudonym for each track; the stream of the errors is left untouched."""
    (child,) = rng.spawn(1)
    return names_of(child.integers(0, 256, 8 * n_tracks, np.uint8).tobytes())


def names_of(drawn: bytes) -> tuple[str, ...]:
    """Return a pseudonym for every eight bytes."""
    text = drawn.hex()
    return tuple([text[start : start + 16] for start in range(0, len(text), 16)])
