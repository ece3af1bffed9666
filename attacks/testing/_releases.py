"""Made-up people under pseudonyms, and the same release seen otherwise: shared by all cases."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, ClassVar, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from isac_track.protocols import AttackContext, LinkageTrainingSet, TrainingSet
from isac_track.rng import stream
from isac_track.sensing import fisher_information_density, unit_errors
from isac_track.sharing import Fixed
from isac_track.testing.engine import call
from isac_track.types import ErrorLaw, Floats, Knowledge, Release, Sensed

Person: TypeAlias = Callable[[Floats], Floats]
Walk: TypeAlias = tuple[
    Floats, Floats
]  # Times, (n,) s, and where somebody then was, (n, 2) m.
Theirs: TypeAlias = Any  # A plug-in, or what is called of it.
Holder = TypeVar("Holder", bound=Any)  # A case, or a training set.

EPSILON_M = 0.3
RAW_SIGMA_M = 0.05  # Of the sensing; all else is added by the mechanism.
BOX_M = 20.0  # Side of the square in which walks start.
STEADY_S, IRREGULAR_S = (1 / 16, 1 / 8), (1e-3, 30.0)  # Shortest and longest step.
SPEEDS_MPS = (0.6, 2.0)  # Slowest and fastest of the people.
_GRID_S = 0.02
_FARTHEST_M, _LATEST_S = 100.0, 1000.0


def draws(*name: str | int) -> np.random.Generator:
    """Return the random stream of that name."""
    return stream(0, "attacks", "testing", *name)


def instants(
    rng: np.random.Generator, size: int, steps_s: tuple[float, float]
) -> Floats:
    """Return so many instants after 0, s, whose steps are drawn evenly in their logarithm."""
    shortest, longest = np.log(steps_s)
    return np.cumsum(np.exp(rng.uniform(shortest, longest, size)))


def person(speed_mps: float, rng: np.random.Generator) -> Person:
    """Return where somebody is at times before and after 0, (M,) s -> (M, 2) m."""
    round_rad = 2.0 * np.pi
    # By what share of itself the speed rises and falls, and how often.
    sway, sway_s, sway_phase = rng.uniform([0.05, 2.0, 0.0], [0.3, 6.0, round_rad])
    # How fast a person turns on the whole, and by how much more or less on the way, how
    # often.
    turn_radps, wind_radps, wind_s = rng.uniform([-0.25, 0.1, 3.0], [0.25, 0.8, 8.0])
    wind_phase, heading_rad = rng.uniform(0.0, round_rad, 2)
    start_m = rng.uniform(-BOX_M / 2, BOX_M / 2, 2)

    def positions(t: Floats) -> Floats:
        first, last = min(float(t[0]), 0.0) - _GRID_S, max(float(t[-1]), 0.0) + _GRID_S
        grid = np.linspace(first, last, 2 + int((last - first) / _GRID_S))
        cycle = round_rad / np.array([sway_s, wind_s])
        speed = speed_mps * (1.0 + sway * np.sin(cycle[0] * grid + sway_phase))
        wind = wind_radps / cycle[1] * -np.cos(cycle[1] * grid + wind_phase)
        heading = heading_rad + turn_radps * grid + wind
        velocity = speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        way = cumulative_trapezoid(velocity, grid, axis=0, initial=0)
        xy = np.column_stack([np.interp([0.0, *t], grid, axis) for axis in way.T])
        return np.asarray(xy[1:] - xy[0] + start_m)

    return positions


def walks(*name: str, sizes: Iterable[int], steps_s: tuple[float, float]) -> list[Walk]:
    """Return walks of so many samples each, on clocks of their own."""
    found = []
    for row, size in enumerate(sizes):
        rng = draws(*name, row)
        t = instants(rng, size, steps_s)
        xy = person(rng.uniform(*SPEEDS_MPS), rng)(t)
        found.append((t + rng.uniform(0.0, 60.0), xy))
    return found


def shared(
    walks: Sequence[Walk], name: tuple[str | int, ...], *, mechanism: Fixed
) -> Release:
    """Return walks as the mechanism shares them, under new pseudonyms."""
    found = sensed(walks, name, law=mechanism.law or "radial")
    return mechanism.share(found, draws("share", *name))


def sensed(
    walks: Sequence[Walk], of: tuple[str | int, ...], *, law: ErrorLaw = "radial"
) -> Sensed:
    """Return walks as the network senses them, with errors of `RAW_SIGMA_M`."""
    t, xy = (np.concatenate(arrays) for arrays in zip(*walks, strict=True))
    unit = unit_errors(n_samples=t.size, law=law, rng=draws("errors", *of))
    offsets = np.cumsum([0, *(times.size for times, _ in walks)])
    sigma, information = np.full(t.size, RAW_SIGMA_M), np.full(t.size, RAW_SIGMA_M**-2)
    fid = fisher_information_density(information=information, t=t, offsets=offsets)
    return Sensed(
        t, xy + RAW_SIGMA_M * unit, unit, sigma, information, fid, offsets, law=law
    )


def frames(rng: np.random.Generator, count: int) -> Floats:
    """Return frames, (count, 4): turned by, rad, then shifted by x and y, m; how much later, s."""
    low, high = (
        (0.0, -_FARTHEST_M, -_FARTHEST_M, 0.0),
        (2 * np.pi, *[_FARTHEST_M] * 2, _LATEST_S),
    )
    return rng.uniform(low, high, (count, 4))


def turned(xy: Floats, frame: Floats) -> Floats:
    """Return points, (M, 2) m, in another frame, or each in one of its own, (4,) or (M, 4)."""
    angle_rad, *shift_m, _ = frame.T
    cos, sin, (x, y) = np.cos(angle_rad), np.sin(angle_rad), xy.T
    return np.stack(
        [cos * x - sin * y + shift_m[0], sin * x + cos * y + shift_m[1]], axis=1
    )


def moved(release: Release, frames: Floats) -> Release:
    """Return a release in another frame and on another clock, or each track in its own, (N, 4)."""
    of_track = np.broadcast_to(frames, (len(release), 4))
    frame = np.repeat(of_track, np.diff(release.offsets), axis=0)
    return replace(release, t=release.t + frame[:, 3], xy=turned(release.xy, frame))


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """What a plug-in is asked, for checks that hold for several kinds: as an attack is, mostly."""

    asked: ClassVar[tuple[str, ...]]  # Names of what it is called with.
    everything: ClassVar[frozenset[Knowledge]] = frozenset(
        Knowledge
    )  # All that there is to grant.
    compared: ClassVar[str]  # What an answer is made of.
    unit: ClassVar[str]

    about: str  # For messages.

    def prepared(
        self,
        plugin: Theirs,
        granted: frozenset[Knowledge],
        rng: np.random.Generator,
        who: str,
    ) -> Theirs:
        """Return what is called: of an attack the function from `fit`, given what is granted."""
        names = ("mechanism", "train", "repeats", "anchor", "companions")
        held = {name: getattr(self, name, None) for name in names}
        context = AttackContext(rng=rng, epsilon_m=EPSILON_M, granted=granted, **held)
        return call(plugin.fit, context, who=f"{who} fit(context)")

    def fault(self, _result: Any) -> str:  # noqa: ANN401 - as the contract says
        """Return what is wrong with a result that can be read all the same; empty if nothing."""
        return ""

    out_of_bounds = fault  # The same of an answer that flies off.

    def gaps(self, one: Floats, other: Floats) -> Floats:
        """Return how far apart the numbers of two answers are, a row for each sort of number."""
        return (
            np.abs(one - other).T if one.shape == other.shape else np.array([[np.inf]])
        )


# The same case, seen otherwise; what is said of cases holds for the training sets in
# them


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
    for _, array in arrays_of(own):
        array.flags.writeable = False  # as `Release` has it
    return own


def arrays_of(held: object, name: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield every array in a case or a part of it, behind the path to it."""
    if isinstance(held, np.ndarray):
        yield name, held
    elif isinstance(held, tuple):
        for place, one in enumerate(held):
            yield from arrays_of(one, f"{name}[{place}]")
    elif is_dataclass(held):
        for item in fields(held):
            yield from arrays_of(getattr(held, item.name), f"{name}.{item.name}")
