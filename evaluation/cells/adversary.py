"""What an adversary is given: a release as it shows, in a frame and on a clock of its own.

Reconstructions and linkers get theirs by the same rules, wherever they stand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import Generator

from evaluation.cells.sharing import guarded
from isac_track.errors import PluginError
from isac_track.types import Complexes, Floats, Ints, Knowledge, Reconstruction, Release

if TYPE_CHECKING:
    from isac_track.plugins import Plugin

SHOWS = frozenset({Knowledge.SIGMA, Knowledge.SCENE})  # Knowledge that shows in the release itself.
FAR_M = 1000.0
LONG_S = 86_400.0  # How far off, and how long ago, an adversary's frame and clock may begin.


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
    found = guarded(who, lambda: attack(release))
    if not isinstance(found, Reconstruction) or found.xy.shape != release.xy.shape:
        got = getattr(getattr(found, "xy", None), "shape", type(found).__name__)
        raise PluginError(
            f"{who} must return a Reconstruction with xy {release.xy.shape}, got {got}"
        )
    return found
