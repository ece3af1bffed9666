"""Releases: share with a mechanism, check what it returns, and select samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from evaluation.compute.guards import Batch, copy_for_user_plugin, guarded
from isac_track.errors import PluginError
from isac_track.measurement import covariance_after
from isac_track.rng import stream
from isac_track.sharing import split_pseudonyms
from isac_track.types import (
    SHARED_LIMIT_M,
    Ints,
    Knowledge,
    Reconstruction,
    Release,
    Sensed,
    derived,
    stretches,
    within,
)

if TYPE_CHECKING:
    from isac_track.plugins import Plugin

# Knowledge that shows in the release itself.
SHOWS = frozenset({Knowledge.SIGMA, Knowledge.SCENE})
# Fields with a value for each sample, of any of the batches.
_PER_SAMPLE = (
    "t",
    "xy",
    "sigma",
    "cov",
    "unit_error",
    "sigma_raw",
    "information",
    "fid",
    "walked_m",
)


class Samples(NamedTuple):
    """Some of the samples of a batch of tracks."""

    rows: Ints  # (m,) which of the M samples.
    offsets: Ints  # (n + 1,) of the tracks among them.


def share(mechanism: Plugin, sensed: Sensed, *key: str | int, seed: int) -> Release:
    """Return the release of a mechanism, checked, with fresh pseudonyms.

    `key` names the stream. Every mechanism gets the same stream: common random numbers.
    Raises PluginError if the mechanism raises or breaks its contract; the message names
    it.
    """
    name, limit = f"mechanism {mechanism.spec!r}", f"{SHARED_LIMIT_M:g} m"
    rng = stream(seed, "sharing", *key)
    release = guarded(
        name,
        lambda: mechanism.instance.share(copy_for_user_plugin(sensed, mechanism), rng),
    )
    if not isinstance(release, Release):
        raise PluginError(f"{name} must return a Release, got {type(release).__name__}")
    try:
        shared = samples_shared(release, sensed)
    except ValueError as error:
        raise PluginError(
            f"{name} changed the tracks or their times: {error}"
        ) from None
    if not within(release.xy, -SHARED_LIMIT_M, SHARED_LIMIT_M):
        raise PluginError(
            f"{name} shared a position that is not within {limit} of the origin"
        )
    if release.sigma is None:
        raise PluginError(
            f"{name} declared no sigma: a standard deviation for every sample, in m"
        )
    if not within(release.sigma, 0.0, SHARED_LIMIT_M):
        fault = "below 0 or NaN"
        if (release.sigma >= 0).all():
            fault = f"above {limit}, the limit"
        raise PluginError(f"{name} declared a sigma {fault}")
    release = _with_covariance(release, take_samples(sensed, shared))
    # A stream for every release: from a common stream all would draw the same.
    drawn = stream(seed, "pseudonyms", mechanism.spec, *key).bytes(8 * len(release))
    return derived(release, pseudonym=split_pseudonyms(drawn))


def _with_covariance(release: Release, sensed: Sensed) -> Release:
    """Return a release with the covariances that its mechanism left out, if any.

    `sensed` has the samples of the release. What a mechanism adds is round unless it
    declares a covariance.
    """
    if sensed.cov is None or release.cov is not None or release.sigma is None:
        return release
    cov = covariance_after(
        raw=sensed.cov,
        raw_sigma_m=sensed.sigma_raw,
        sigma_m=release.sigma,
        law=sensed.law,
    )
    return derived(release, cov=cov)


def samples_shared(release: Release, sensed: Sensed) -> Samples | None:
    """Return the sensed samples that a release holds; None if it holds all.

    Raises ValueError if it holds other tracks, or a sample when nothing was sensed.
    """
    if same_samples(sensed, release):
        return None
    if len(release) != len(sensed):
        raise ValueError(f"of {len(sensed)} tracks it returned {len(release)}")
    tracks = np.arange(len(sensed))
    owner = np.repeat(tracks, np.diff(release.offsets))
    # Complex numbers are ordered by their real parts first: by track, then by time.
    known = np.repeat(tracks, np.diff(sensed.offsets)) + 1j * sensed.t
    place = np.searchsorted(known, owner + 1j * release.t)
    place = np.minimum(place, sensed.offsets[1:][owner] - 1)
    strange = np.flatnonzero(sensed.t[place] != release.t)
    if strange.size:
        raise ValueError(
            f"in track {owner[strange[0]]} nothing was sensed at"
            f" {release.t[strange[0]]:.12g} s; samples may be left out, not moved or"
            " added"
        )
    return Samples(place, release.offsets)


def same_samples(first: Sensed | Release, second: Sensed | Release) -> bool:
    """Whether two batches hold the same numbers of samples, at the same instants."""
    pairs = (first.offsets, second.offsets), (first.t, second.t)
    return all(
        values is others or np.array_equal(values, others) for values, others in pairs
    )


def track_samples(offsets: Ints, tracks: Ints) -> Samples:
    """Return the samples of some tracks, (n,), end to end; `offsets` are of all."""
    return Samples(*stretches(offsets[tracks], np.diff(offsets)[tracks]))


def take_samples(batch: Batch, samples: Samples | None) -> Batch:
    """Return a batch with only some samples of its tracks; None: with all."""
    if samples is None:
        return batch
    arrays = {
        name: values.take(samples.rows, axis=0)
        for name in _PER_SAMPLE
        if (values := getattr(batch, name, None)) is not None
    }
    return derived(batch, offsets=samples.offsets, **arrays)


def declared_knowledge(plugin: Plugin) -> frozenset[Knowledge]:
    """Return the knowledge that a plug-in needs or takes."""
    return frozenset(plugin.instance.requires | plugin.instance.uses)


def call_attack(
    attack: Callable[[Release], object], release: Release, *, name: str
) -> Reconstruction:
    """Return the reconstruction of a fitted attack, in the frame of the release.

    Raises PluginError if the attack raises or returns anything else; the message says
    its `name`.
    """
    expected = release.xy.shape
    reconstruction = guarded(name, lambda: attack(release))
    if (
        not isinstance(reconstruction, Reconstruction)
        or reconstruction.xy.shape != expected
    ):
        got = getattr(
            getattr(reconstruction, "xy", None), "shape", type(reconstruction).__name__
        )
        raise PluginError(
            f"{name} must return a Reconstruction with xy {expected}, got {got}"
        )
    return reconstruction
