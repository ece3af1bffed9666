"""Frames and clocks in which an adversary sees a release."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from isac_track.types import Complexes, Floats, Ints, Knowledge, Release

# How far off, and how long ago, an adversary's frame and clock may begin.
FAR_M = 1000.0
LONG_S = 86_400.0


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
