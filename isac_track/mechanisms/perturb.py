"""Apply the error law and the adding rule: shared by all mechanisms.

A mechanism decides how much error each sample gets; `perturb` adds it.
"""

import json
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.random import Generator

from isac_track.measurement import (
    axis_share,
    axis_variance,
    grown_covariance,
    mean_variance,
    round_errors,
    scalar_covariance,
)
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

# Cached draws: those of a block, of both halves of the training people, of two repeats.
_MOST_CACHED = 5


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
    true error is scaled, which requires knowledge of the truth. `independent`
    (eq. swarm_shared): the variances add, as a fresh error has a direction of its own.

    `d_sigma` is (M,) m, or one number; `rng` draws the fresh error and the pseudonyms.
    The fresh error has the given `law`, by default that of the raw error. A
    standardised error of that law may be given instead: `unit_error`, (M, 2). The
    release declares the standard deviation of every sample, and the covariance of
    errors with a shape: linear adding lengthens both axes of the ellipse by the same
    standard deviation, an independent error is round. ValueError if `d_sigma` is
    negative,
    not finite or of a wrong shape, if the rule is unknown, or if linear adding is given
    a law or an error.

    Examples
    --------
    A sample 0.3 m off, of a sensor of 0.3 m, gets 0.4 m of noise. Standard deviations
    add under the linear rule, variances under the independent rule:

    >>> import numpy as np
    >>> from isac_track.sharing import perturb
    >>> from isac_track.types import Sensed
    >>> sensed = Sensed(
    ...     t=np.array([0.0]),
    ...     xy=np.array([[0.3, 0.0]]),
    ...     unit_error=np.array([[1.0, 0.0]]),
    ...     sigma_raw=np.array([0.3]),
    ...     information=np.array([11.0]),
    ...     fid=np.array([27.0]),
    ...     offsets=np.array([0, 1]),
    ... )
    >>> linear = perturb(sensed, 0.4, np.random.default_rng(0))
    >>> linear.xy.round(6), linear.sigma.round(6)
    (array([[0.7, 0. ]]), array([0.7]))
    >>> independent = perturb(
    ...     sensed, 0.4, np.random.default_rng(0), adding="independent"
    ... )
    >>> independent.sigma.round(6)
    array([0.5])
    """
    added = np.asarray(d_sigma, dtype=np.float64)
    extra: Floats = np.broadcast_to(added, sensed.t.shape)
    if not within(added, 0.0, np.finfo(np.float64).max):
        raise ValueError("d_sigma must be finite and not negative")
    pseudonym = draw_pseudonyms(len(sensed), rng)
    if adding == "linear":
        if law not in (None, sensed.law):
            raise ValueError("linear adding scales the raw error and so keeps its law")
        if unit_error is not None:
            raise ValueError("linear adding scales the raw error and takes no other")
        if sensed.cov is not None:
            return _grow_ellipses(sensed, sensed.cov, extra, pseudonym)
        unit_error, sigma = sensed.unit_error, sensed.sigma_raw + extra
    elif adding == "independent":
        if unit_error is None:
            unit_error = _fresh_errors(sensed, law or sensed.law, rng)
        sigma = np.sqrt(sensed.sigma_raw**2 + extra**2)
    else:
        raise ValueError(f"unknown adding rule {adding!r}; known: linear, independent")
    xy = _scaled_errors(unit_error, added)
    xy += sensed.xy
    cov = sensed.cov
    if cov is not None:
        variance_m2 = axis_variance(sigma_m=extra, law=law or sensed.law)
        cov = cov + scalar_covariance(variance_m2)
    return Release(
        t=sensed.t,
        xy=xy,
        sigma=sigma,
        offsets=sensed.offsets,
        pseudonym=pseudonym,
        cov=cov,
    )


def add_isotropic(
    sensed: Sensed, std_m: Floats | float, rng: Generator, *, unit_error: Floats
) -> Release:
    """Add an error of a mechanism's own, of standard deviation `std_m` on either axis.

    `std_m` is (M,) m, or one number; `unit_error`, (M, 2), is the standardised error.
    The variances add, whatever the law of the raw error.
    """
    return perturb(
        sensed,
        std_m,
        rng,
        adding="independent",
        law="isotropic",
        unit_error=unit_error,
    )


def _scaled_errors(unit_error: Floats, std_m: Floats) -> Floats:
    """Return standardised errors, (M, 2), times one or (M,) standard deviations."""
    error = np.empty_like(unit_error)
    if std_m.size == 1:
        return np.multiply(unit_error, std_m, out=error)
    for axis in range(2):  # faster than both axes at once
        np.multiply(unit_error[:, axis], std_m, out=error[:, axis])
    return error


def _grow_ellipses(
    sensed: Sensed, cov: Floats, extra_m: Floats, pseudonym: tuple[str, ...]
) -> Release:
    """Return a release whose raw errors of covariance `cov` grew by the linear rule."""
    share = axis_share(sensed.law)
    added_m = np.sqrt(share) * extra_m
    error = sensed.sigma_raw[:, None] * sensed.unit_error
    grown = grown_covariance(cov, added_m)
    return Release(
        t=sensed.t,
        xy=sensed.xy + added_m[:, None] * round_errors(cov=cov, error=error),
        sigma=np.sqrt(mean_variance(grown) / share),
        offsets=sensed.offsets,
        pseudonym=pseudonym,
        cov=grown,
    )


def _fresh_errors(sensed: Sensed, law: ErrorLaw, rng: Generator) -> Floats:
    """Return `unit_errors` of a release, drawn once for all levels.

    The streams of all levels start in the same state.
    """
    state = rng.bit_generator.state
    if state["bit_generator"] != "PCG64" or law == "fixed_direction":
        return unit_errors(
            n_samples=sensed.t.size, law=law, rng=rng, offsets=sensed.offsets
        )
    errors, rng.bit_generator.state = _errors_from(
        json.dumps(state), sensed.t.size, law
    )
    return errors


# Holds the last five draws for the life of the process.
@lru_cache(maxsize=_MOST_CACHED)
def _errors_from(
    state: str, n_samples: int, law: ErrorLaw
) -> tuple[Floats, Mapping[str, Any]]:
    """Return the draws of a generator in a state, as JSON, and its state afterwards."""
    bits = np.random.PCG64(0)
    bits.state = json.loads(state)
    errors = unit_errors(n_samples=n_samples, law=law, rng=np.random.Generator(bits))
    return read_only(errors), bits.state


def draw_pseudonyms(n_tracks: int, rng: Generator) -> tuple[str, ...]:
    """Draw a pseudonym for each track, without a draw from the errors' stream."""
    (child,) = rng.spawn(1)
    return split_pseudonyms(child.integers(0, 256, 8 * n_tracks, np.uint8).tobytes())


def split_pseudonyms(drawn: bytes) -> tuple[str, ...]:
    """Return a pseudonym of 16 hexadecimal digits for every eight bytes.

    >>> from isac_track.sharing import split_pseudonyms
    >>> split_pseudonyms(bytes(range(16)))
    ('0001020304050607', '08090a0b0c0d0e0f')
    """
    text = drawn.hex()
    return tuple([text[start : start + 16] for start in range(0, len(text), 16)])
