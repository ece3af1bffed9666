"""Made-up walks under pseudonyms, and the same release seen otherwise: shared by all cases."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, fields, is_dataclass, replace
from math import log
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

import numpy as np

from isac_track.protocols import LinkageTrainingSet, TrainingSet
from isac_track.rng import stream
from isac_track.sensing import unit_errors
from isac_track.types import Release, Sensed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from isac_track.sharing import Fixed
    from isac_track.types import Floats, Ints

Sampling: TypeAlias = Literal["steady", "irregular"]
Walk: TypeAlias = "tuple[Floats, Floats]"
"""Times of one walk, (n,) s, and where somebody truly was then, (n, 2) m."""
Holder = TypeVar("Holder", bound=Any)
"""A case, or a training set."""

EPSILON_M = 0.3
RAW_SIGMA_M = 0.05
"""Of the sensing; all else is added by the mechanism."""
BOX_M = 20.0
"""Side of the square in which walks start."""
STEADY_STEP_S = (1 / 16, 1 / 8)
IRREGULAR_STEP_S = (1e-3, 30.0)


def draws(*name: str | int) -> np.random.Generator:
    """Return the random stream of that name."""
    return stream(0, "attacks", "testing", *name)


def steps(rng: np.random.Generator, size: int, *, sampling: Sampling) -> Floats:
    """Return so many steps, s: at 8 to 16 Hz, or from a millisecond to half a minute."""
    if sampling == "steady":
        return rng.uniform(*STEADY_STEP_S, size)
    low, high = map(log, IRREGULAR_STEP_S)
    step_s: Floats = np.exp(rng.uniform(low, high, size))
    return step_s


def shared(walks: Sequence[Walk], name: tuple[str | int, ...], *, mechanism: Fixed) -> Release:
    """Return walks as the mechanism shares them, under new pseudonyms."""
    t, xy = (np.concatenate(arrays) for arrays in zip(*walks, strict=True))
    offsets = np.concatenate([[0], np.cumsum([times.size for times, _ in walks])])
    law = mechanism.law or "radial"
    unit = unit_errors(n_samples=t.size, law=law, rng=draws("errors", *name))
    nothing = np.zeros(t.size)
    sensed = Sensed(
        t=t,
        xy=xy + RAW_SIGMA_M * unit,
        unit_error=unit,
        sigma_raw=np.full(t.size, RAW_SIGMA_M),
        information=nothing,  # Fixed looks at neither
        fid=nothing,
        offsets=offsets,
        law=law,
    )
    return mechanism.share(sensed, draws("share", *name))


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """A frame and a clock: turned, then shifted. One for all samples, or one for each."""

    angle_rad: float | Floats
    shift_m: tuple[float, float] | Floats
    clock_s: float | Floats

    def of_points(self, xy: Floats) -> Floats:
        """Return points, (M, 2) m, in this frame."""
        cos, sin, (x, y) = np.cos(self.angle_rad), np.sin(self.angle_rad), xy.T
        return np.column_stack([cos * x - sin * y, sin * x + cos * y]) + self.shift_m

    def of_release(self, release: Release) -> Release:
        """Return a release in this frame and on this clock."""
        return replace(release, t=release.t + self.clock_s, xy=self.of_points(release.xy))


def origins(offsets: Ints, order: Sequence[int]) -> Ints:
    """Return where each sample came from, (M,), if tracks come in another order."""
    return np.concatenate([np.arange(offsets[row], offsets[row + 1]) for row in order])


def in_order(release: Release, order: Sequence[int]) -> Release:
    """Return a release with its tracks in another order."""
    origin = origins(release.offsets, order)
    return Release(
        t=release.t[origin],
        xy=release.xy[origin],
        sigma=None if release.sigma is None else release.sigma[origin],
        offsets=np.concatenate([[0], np.cumsum(np.diff(release.offsets)[list(order)])]),
        pseudonym=tuple(release.pseudonym[row] for row in order),
    )


# The same case, seen otherwise; what is said of cases holds for the training sets in them


def of_each(case: Holder, change: Callable[[Release], Release]) -> Holder:
    """Return a case with every release in it changed, in the order of its fields."""

    def changed(held: object) -> object:
        if isinstance(held, Release):
            return change(held)
        if isinstance(held, TrainingSet | LinkageTrainingSet):
            return of_each(held, change)
        return tuple(map(changed, held)) if isinstance(held, tuple) else held

    held = {item.name: changed(getattr(case, item.name)) for item in fields(case)}
    return replace(case, **held)


def copied(case: Holder) -> Holder:
    """Return the case in arrays of its own; nothing done to them reaches another run."""
    own = deepcopy(case)
    for array in arrays_of(own).values():
        array.flags.writeable = False  # as `Release` has it
    return own


def renamed(case: Holder) -> Holder:
    """Return the case with other pseudonyms, whose alphabetical order is another one, too.

    Releases share their pseudonyms then, but not with whom they belong together.
    """

    def change(release: Release) -> Release:
        backwards = sorted(release.pseudonym, reverse=True)
        names = tuple(f"p{backwards.index(name):04}" for name in release.pseudonym)
        return replace(release, pseudonym=names)

    return of_each(case, change)


def arrays_of(held: object, name: str = "") -> dict[str, NDArray[Any]]:
    """Return every array in a case or a part of it, by the path to it behind `name`."""
    if isinstance(held, np.ndarray):
        return {name: held}
    inside: dict[str, object] = {}
    if isinstance(held, tuple):
        inside = {f"{name}[{place}]": one for place, one in enumerate(held)}
    elif is_dataclass(held):
        inside = {f"{name}.{item.name}": getattr(held, item.name) for item in fields(held)}
    deeper = (arrays_of(one, path) for path, one in inside.items())
    return {path: array for found in deeper for path, array in found.items()}
