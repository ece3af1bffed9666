"""Releases: share with a mechanism, check what it returns, and show it to a reader.

An adversary sees a release in a frame and on a clock of its own. `guarded` calls a
user's plug-in and names its mistakes; `copied` protects our arrays from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.random import Generator

from attacks.tasks.sessions import Windows
from isac_track.command_line import check_interrupt, may_be_ctrl_c
from isac_track.errors import PluginError, error_text, raised_at
from isac_track.measurement import covariance_after
from isac_track.rng import stream
from isac_track.sharing import split_pseudonyms
from isac_track.types import (
    SHARED_LIMIT_M,
    Complexes,
    Floats,
    Ints,
    Knowledge,
    Reconstruction,
    Release,
    Scenes,
    Sensed,
    derived,
    stretches,
    within,
)

if TYPE_CHECKING:
    from isac_track.plugins import Plugin

_Batch = TypeVar("_Batch", Release, Scenes, Sensed, Windows)
# Where the project's own plug-ins come from.
OURS = ("isac_track.", "attacks.", "predictors.")
# Knowledge that shows in the release itself.
SHOWS = frozenset({Knowledge.SIGMA, Knowledge.SCENE})
# How far off, and how long ago, an adversary's frame and clock may begin.
FAR_M = 1000.0
LONG_S = 86_400.0
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


def guarded(name: str, call: Callable[[], Any]) -> Any:  # noqa: ANN401 - whatever a plug-in returns
    """Return what a plug-in's function returns.

    Raises PluginError for whatever it raises, with the plug-in's name and the place in
    its code. The user's Ctrl-C passes.
    """
    try:
        with np.errstate():  # undoes what the call sets
            return call()
    except BaseException as error:  # a plug-in may do anything
        if isinstance(error, KeyboardInterrupt) and may_be_ctrl_c():
            raise
        check_interrupt()  # it may have caught the user's and raised something else
        raise PluginError(
            f"{name} failed: {error_text(error)}{raised_at(error)}"
        ) from error


def copy_for_user_plugin(batch: _Batch, to: Plugin) -> _Batch:
    """Return a batch as a plug-in gets it: a user's own plug-in gets a copy."""
    return batch if to.origin.startswith(OURS) else copied(batch)


def copied(batch: _Batch) -> _Batch:
    """Return a batch in arrays of its own: a plug-in may unlock them and write."""
    values = ((field.name, getattr(batch, field.name)) for field in fields(batch))
    copies = {
        name: value.copy() for name, value in values if isinstance(value, np.ndarray)
    }
    return derived(batch, **copies)


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
    release = _with_covariance(release, restricted(sensed, shared))
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


def restricted(batch: _Batch, to: Samples | None) -> _Batch:
    """Return a batch with only the samples `to` of its tracks; None: with all."""
    if to is None:
        return batch
    samples = {
        name: values.take(to.rows, axis=0)
        for name in _PER_SAMPLE
        if (values := getattr(batch, name, None)) is not None
    }
    return derived(batch, offsets=to.offsets, **samples)


@dataclass(frozen=True, eq=False, slots=True)
class Frame:
    """A frame and a clock, of all samples or of each: turn by an angle, then shift."""

    turn: Complexes | complex = 1.0  # (M,) or a number: cosine and sine of the angle
    shift_m: Complexes | complex = 0.0  # (M,) or a number: x and y, m
    clock_s: Floats | float = 0.0

    def points(self, xy: Floats) -> Floats:
        """Return positions, (M, 2) m, in the frame."""
        points = np.ascontiguousarray(xy).view(np.complex128)[:, 0]
        return (self.turn * points + self.shift_m).view(np.float64).reshape(-1, 2)

    def release(self, release: Release) -> Release:
        """Return a release in the frame and on the clock."""
        return replace(
            release,
            xy=self.points(release.xy),
            t=release.t + self.clock_s,
            cov=None if release.cov is None else self._turned(release.cov),
        )

    def _turned(self, cov: Floats) -> Floats:
        """Return covariances, (M, 2, 2) m^2, in the frame."""
        turn = np.asarray(self.turn)
        rows = np.array([[turn.real, -turn.imag], [turn.imag, turn.real]])
        matrix = np.moveaxis(rows, (0, 1), (-2, -1))
        return np.asarray(matrix @ cov @ np.swapaxes(matrix, -2, -1))

    def per_sample(self, offsets: Ints) -> Frame:
        """Return the frame of each sample from those of walks; `offsets`, (N + 1,)."""
        n_samples = np.diff(offsets)
        return Frame(
            turn=np.repeat(self.turn, n_samples),
            shift_m=np.repeat(self.shift_m, n_samples),
            clock_s=np.repeat(self.clock_s, n_samples),
        )


def adversary_view(
    release: Release, *, granted: frozenset[Knowledge], rng: Generator
) -> tuple[Release, Frame]:
    """Return a release as an adversary sees it, and its frame: drawn without SCENE."""
    release = hide_sigma(release, granted)
    if Knowledge.SCENE in granted:
        return release, Frame()
    angle = float(rng.uniform(0.0, 2.0 * np.pi))
    shift_m, clock_s = complex(*rng.uniform(-FAR_M, FAR_M, 2)), rng.uniform(0.0, LONG_S)
    frame = Frame(np.cos(angle) + 1j * np.sin(angle), shift_m, clock_s)
    return frame.release(release), frame


def hide_sigma(release: Release, granted: frozenset[Knowledge]) -> Release:
    """Return a release, without standard deviations unless SIGMA is granted."""
    return release if Knowledge.SIGMA in granted else release.without_sigma()


def declared(plugin: Plugin) -> frozenset[Knowledge]:
    """Return the knowledge that a plug-in needs or takes."""
    return frozenset(plugin.instance.requires | plugin.instance.uses)


def reconstructed(
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
