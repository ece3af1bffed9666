"""Made-up walks under pseudonyms, and the same release seen otherwise: shared by all cases."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from isac_track.rng import stream
from isac_track.sensing import fisher_information_density, unit_errors
from isac_track.types import Release, Sensed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isac_track.sharing import Fixed
    from isac_track.types import ErrorLaw, Floats, Ints

Sampling: TypeAlias = Literal["steady", "irregular"]

SEED = 0
EPSILON_M = 0.3
RAW_SIGMA_M = 0.05
"""Of the sensing; all else is added by the mechanism."""
BOX_M = 20.0
"""Side of the square in which walks start."""
STEADY_STEP_S = (1 / 16, 1 / 8)
IRREGULAR_STEP_S = (1e-3, 30.0)


@dataclass(frozen=True, eq=False, slots=True)
class Walks:
    """N true walks, M samples in all."""

    t: Floats
    """(M,) s"""
    xy: Floats
    """(M, 2) m"""
    offsets: Ints
    """(N + 1,)"""


def draws(*name: str | int) -> np.random.Generator:
    """Return the random stream of that name."""
    return stream(SEED, "attacks", "testing", *name)


def steps(rng: np.random.Generator, size: int, *, sampling: Sampling) -> Floats:
    """Return so many steps, s: at 8 to 16 Hz, or from a millisecond to half a minute."""
    if sampling == "steady":
        return rng.uniform(*STEADY_STEP_S, size)
    low, high = map(log, IRREGULAR_STEP_S)
    step_s: Floats = np.exp(rng.uniform(low, high, size))
    return step_s


def joined(tracks: Sequence[tuple[Floats, Floats]]) -> Walks:
    """Return walks end to end, from times and positions of each."""
    return Walks(
        t=np.concatenate([t for t, _ in tracks]),
        xy=np.concatenate([xy for _, xy in tracks]),
        offsets=np.concatenate([[0], np.cumsum([t.size for t, _ in tracks])]),
    )


def shared(
    walks: Walks, name: tuple[str | int, ...], *, mechanism: Fixed, law: ErrorLaw
) -> Release:
    """Return walks as the mechanism shares them, under new pseudonyms."""
    unit = unit_errors(n_samples=walks.t.size, law=law, rng=draws("errors", *name))
    information = np.full(walks.t.size, RAW_SIGMA_M**-2)
    sensed = Sensed(
        t=walks.t,
        xy=walks.xy + RAW_SIGMA_M * unit,
        unit_error=unit,
        sigma_raw=np.full(walks.t.size, RAW_SIGMA_M),
        information=information,
        fid=fisher_information_density(information=information, t=walks.t, offsets=walks.offsets),
        offsets=walks.offsets,
        law=law,
    )
    return mechanism.share(sensed, draws("share", *name))


@dataclass(frozen=True, slots=True)
class Motion:
    """A frame and a clock: turned, then shifted."""

    angle_rad: float
    shift_m: tuple[float, float]
    clock_s: float

    def of_points(self, xy: Floats) -> Floats:
        """Return points, (M, 2) m, in this frame."""
        cos, sin = np.cos(self.angle_rad), np.sin(self.angle_rad)
        moved: Floats = xy @ np.array([[cos, sin], [-sin, cos]]) + self.shift_m
        return moved

    def of_release(self, release: Release) -> Release:
        """Return a release in this frame and on this clock."""
        return replace(release, t=release.t + self.clock_s, xy=self.of_points(release.xy))


def origins(offsets: Ints, order: Sequence[int]) -> Ints:
    """Return where each sample came from, (M,), if tracks come in another order."""
    return np.concatenate([np.arange(offsets[row], offsets[row + 1]) for row in order])


def in_order(release: Release, order: Sequence[int]) -> Release:
    """Return a release with its tracks in another order."""
    origin = origins(release.offsets, order)
    sizes = np.diff(release.offsets)[list(order)]
    return Release(
        t=release.t[origin],
        xy=release.xy[origin],
        sigma=None if release.sigma is None else release.sigma[origin],
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        pseudonym=tuple(release.pseudonym[row] for row in order),
    )


def renamed_release(release: Release) -> Release:
    """Return other pseudonyms, whose alphabetical order is another one, too."""
    ranks = {name: rank for rank, name in enumerate(sorted(release.pseudonym, reverse=True))}
    return replace(release, pseudonym=tuple(f"p{ranks[name]:04}" for name in release.pseudonym))


def copied_release(release: Release) -> Release:
    """Return a release in arrays of its own."""
    return Release(
        t=release.t.copy(),
        xy=release.xy.copy(),
        sigma=None if release.sigma is None else release.sigma.copy(),
        offsets=release.offsets.copy(),
        pseudonym=release.pseudonym,
    )
