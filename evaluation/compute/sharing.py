"""One release of a mechanism, checked: what it holds, and what of it whoever reads it is given.

An adversary gets it as it shows, in a frame and on a clock of its own. What a stranger
wrote is called by `guarded`: their mistakes are named, and by `copied` their hands are
kept off our arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.random import Generator

from attacks.tasks.sessions import Windows
from isac_track.command_line import check_interrupt, may_be_ctrl_c
from isac_track.errors import PluginError, raised_at, told
from isac_track.rng import stream
from isac_track.sharing import names_of
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
OURS = (
    "isac_track.",
    "attacks.",
    "predictors.",
)  # Where plug-ins come from that are no stranger's
SHOWS = frozenset(
    {Knowledge.SIGMA, Knowledge.SCENE}
)  # Knowledge that shows in the release itself.
FAR_M = 1000.0
# How far off, and how long ago, an adversary's frame and clock may begin.
LONG_S = 86_400.0
_PER_SAMPLE = (
    "t",
    "xy",
    "sigma",
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


def guarded(who: str, call: Callable[[], Any]) -> Any:  # noqa: ANN401 - whatever a plug-in returns
    """Return what a plug-in's function returns.

    Raises PluginError for whatever it raises, with who it was and where, but for the
    user's Ctrl-C.
    """
    try:
        with np.errstate():  # as it is after the call, whatever was set within
            return call()
    except BaseException as error:  # a plug-in may do anything
        if isinstance(error, KeyboardInterrupt) and may_be_ctrl_c():
            raise
        check_interrupt()  # it may have caught the user's and raised something else
        raise PluginError(f"{who} failed: {told(error)}{raised_at(error)}") from error


def handed(batch: _Batch, to: Plugin) -> _Batch:
    """Return a batch as a plug-in gets it: a stranger's is a copy, ours write to nothing."""
    return batch if to.origin.startswith(OURS) else copied(batch)


def copied(batch: _Batch) -> _Batch:
    """Return a batch in arrays of its own: a stranger may unlock them and write."""
    values = ((one.name, getattr(batch, one.name)) for one in fields(batch))
    own = {
        name: value.copy() for name, value in values if isinstance(value, np.ndarray)
    }
    return derived(batch, **own)


def share(mechanism: Plugin, sensed: Sensed, *key: str | int, seed: int) -> Release:
    """Return what a mechanism shares of what was sensed.

    `key` names the stream. Every mechanism gets the same one: common random numbers.
    Raises PluginError if the mechanism raises or breaks its contract; the message names
    it.
    """
    who, limit = f"mechanism {mechanism.spec!r}", f"{SHARED_LIMIT_M:g} m"
    rng = stream(seed, "sharing", *key)
    release = guarded(
        who, lambda: mechanism.instance.share(handed(sensed, mechanism), rng)
    )
    if not isinstance(release, Release):
        raise PluginError(f"{who} must return a Release, got {type(release).__name__}")
    try:
        samples_shared(release, sensed)
    except ValueError as error:
        raise PluginError(f"{who} changed the tracks or their times: {error}") from None
    if not within(release.xy, -SHARED_LIMIT_M, SHARED_LIMIT_M):
        raise PluginError(
            f"{who} shared a position that is not within {limit} of the origin"
        )
    if release.sigma is None:
        raise PluginError(
            f"{who} declared no sigma: a standard deviation for every sample, in m"
        )
    if not within(release.sigma, 0.0, SHARED_LIMIT_M):
        wrong = (
            f"above {limit}, the limit"
            if (release.sigma >= 0).all()
            else "below 0 or NaN"
        )
        raise PluginError(f"{who} declared a sigma {wrong}")
    # Fresh for every release: the common stream gives every mechanism the same ones.
    drawn = stream(seed, "pseudonyms", mechanism.spec, *key).bytes(8 * len(release))
    return derived(release, pseudonym=names_of(drawn))


def samples_shared(release: Release, sensed: Sensed) -> Samples | None:
    """Return which samples a release holds; None if it is all of them.

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


def same_samples(one: Sensed | Release, other: Sensed | Release) -> bool:
    """Whether two batches hold the same number of samples of each track, at the same instants."""
    pairs = (one.offsets, other.offsets), (one.t, other.t)
    return all(mine is its or np.array_equal(mine, its) for mine, its in pairs)


def samples_of(offsets: Ints, tracks: Ints) -> Samples:
    """Return the samples of some tracks, one after the other: rows, (n,), of those at `offsets`."""
    return Samples(*stretches(offsets[tracks], np.diff(offsets)[tracks]))


def restricted(batch: _Batch, to: Samples | None) -> _Batch:
    """Return a batch with some of the samples of each of its tracks; None: with all."""
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
    """A frame and a clock, one for all samples or one each: turned by an angle, then shifted."""

    turn: Complexes | complex = 1.0  # (M,) or one: cosine and sine of the angle
    shift_m: Complexes | complex = 0.0  # (M,) or one: x and y, m
    clock_s: Floats | float = 0.0

    def points(self, xy: Floats) -> Floats:
        """Return positions, (M, 2) m, in the frame."""
        points = np.ascontiguousarray(xy).view(np.complex128)[:, 0]
        return (self.turn * points + self.shift_m).view(np.float64).reshape(-1, 2)

    def release(self, release: Release) -> Release:
        """Return a release in the frame and on the clock."""
        return replace(release, xy=self.points(release.xy), t=release.t + self.clock_s)

    def of(self, offsets: Ints) -> Frame:
        """Return the frame of each sample of walks that begin and end at offsets, of their own."""
        arrays = (self.turn, self.shift_m, self.clock_s)
        return Frame(*(np.repeat(one, np.diff(offsets)) for one in arrays))


def view_of(
    release: Release, *, granted: frozenset[Knowledge], rng: Generator
) -> tuple[Release, Frame]:
    """Return a release as it shows, without SCENE in a frame that is drawn; and the frame."""
    release = showing(release, granted)
    if Knowledge.SCENE in granted:
        return release, Frame()
    angle = float(rng.uniform(0.0, 2.0 * np.pi))
    shift_m, clock_s = complex(*rng.uniform(-FAR_M, FAR_M, 2)), rng.uniform(0.0, LONG_S)
    frame = Frame(np.cos(angle) + 1j * np.sin(angle), shift_m, clock_s)
    return frame.release(release), frame


def showing(release: Release, granted: frozenset[Knowledge]) -> Release:
    """Return a release with its standard deviations for who is granted SIGMA alone."""
    return release if Knowledge.SIGMA in granted else release.without_sigma()


def declared(plugin: Plugin) -> frozenset[Knowledge]:
    """Return what a plug-in says that it needs or takes."""
    return frozenset(plugin.instance.requires | plugin.instance.uses)


def reconstructed(
    attack: Callable[[Release], object], release: Release, *, who: str
) -> Reconstruction:
    """Return what a fitted attack makes of a release, in its frame.

    Raises PluginError if it raises or returns anything else; the message names it.
    """
    expected = release.xy.shape
    found = guarded(who, lambda: attack(release))
    if not isinstance(found, Reconstruction) or found.xy.shape != expected:
        got = getattr(getattr(found, "xy", None), "shape", type(found).__name__)
        raise PluginError(
            f"{who} must return a Reconstruction with xy {expected}, got {got}"
        )
    return found
