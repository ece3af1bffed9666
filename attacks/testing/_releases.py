"""Made-up people under pseudonyms, and changed views of a release: for all cases."""

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
# Times, (n,) s, and positions, (n, 2) m.
Walk: TypeAlias = tuple[Floats, Floats]
Plugin: TypeAlias = Any  # A plug-in, or a function of it.
Holder = TypeVar("Holder", bound=Any)  # A case, or a training set.

EPSILON_M = 0.3
RAW_SIGMA_M = 0.05  # Of the sensing; the mechanism adds all further error.
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
    """Return `size` instants after 0, s; the logarithms of their steps are uniform."""
    shortest, longest = np.log(steps_s)
    return np.cumsum(np.exp(rng.uniform(shortest, longest, size)))


def person(speed_mps: float, rng: np.random.Generator) -> Person:
    """Return a person: the function from times about 0, (M,) s, to places, (M, 2) m."""
    round_rad = 2.0 * np.pi
    # Share of the speed that rises and falls, its period and its phase.
    sway, sway_s, sway_phase = rng.uniform([0.05, 2.0, 0.0], [0.3, 6.0, round_rad])
    # Mean turning rate, and amplitude and period of its changes.
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
    """Return walks with `sizes` samples each, on clocks of their own."""
    drawn = []
    for row, size in enumerate(sizes):
        rng = draws(*name, row)
        t = instants(rng, size, steps_s)
        xy = person(rng.uniform(*SPEEDS_MPS), rng)(t)
        drawn.append((t + rng.uniform(0.0, 60.0), xy))
    return drawn


def shared(
    walks: Sequence[Walk], name: tuple[str | int, ...], *, mechanism: Fixed
) -> Release:
    """Return walks as the mechanism shares them, under new pseudonyms."""
    sensed_walks = sensed(walks, name, law=mechanism.law or "radial")
    return mechanism.share(sensed_walks, draws("share", *name))


def sensed(
    walks: Sequence[Walk], name: tuple[str | int, ...], *, law: ErrorLaw = "radial"
) -> Sensed:
    """Return walks as the network senses them, with errors of `RAW_SIGMA_M`."""
    t, xy = (np.concatenate(arrays) for arrays in zip(*walks, strict=True))
    unit = unit_errors(n_samples=t.size, law=law, rng=draws("errors", *name))
    offsets = np.cumsum([0, *(times.size for times, _ in walks)])
    sigma, information = np.full(t.size, RAW_SIGMA_M), np.full(t.size, RAW_SIGMA_M**-2)
    fid = fisher_information_density(information=information, t=t, offsets=offsets)
    return Sensed(
        t, xy + RAW_SIGMA_M * unit, unit, sigma, information, fid, offsets, law=law
    )


def frames(rng: np.random.Generator, count: int) -> Floats:
    """Return drawn frames, (count, 4): angle, rad; shift x and y, m; delay, s."""
    low = (0.0, -_FARTHEST_M, -_FARTHEST_M, 0.0)
    high = (2 * np.pi, _FARTHEST_M, _FARTHEST_M, _LATEST_S)
    return rng.uniform(low, high, (count, 4))


def turned(xy: Floats, frame: Floats) -> Floats:
    """Return points, (M, 2) m, in another frame, (4,), or each in its own, (M, 4)."""
    angle_rad, *shift_m, _ = frame.T
    cos, sin, (x, y) = np.cos(angle_rad), np.sin(angle_rad), xy.T
    return np.stack(
        [cos * x - sin * y + shift_m[0], sin * x + cos * y + shift_m[1]], axis=1
    )


def moved(release: Release, frames: Floats) -> Release:
    """Return a release in another frame, (4,), or each track in its own, (N, 4)."""
    frame_per_track = np.broadcast_to(frames, (len(release), 4))
    frame = np.repeat(frame_per_track, np.diff(release.offsets), axis=0)
    return replace(release, t=release.t + frame[:, 3], xy=turned(release.xy, frame))


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """Inputs of a plug-in, for checks of several kinds; the defaults suit attacks."""

    asked: ClassVar[tuple[str, ...]]  # Names of the arguments of its call.
    compared: ClassVar[str]  # The parts of an answer, in words.
    unit: ClassVar[str]

    about: str  # For messages.

    @property
    def everything(self) -> frozenset[Knowledge]:
        """All knowledge that can be granted."""
        return frozenset(Knowledge)

    def prepared(
        self,
        plugin: Plugin,
        granted: frozenset[Knowledge],
        rng: np.random.Generator,
        actor: str,
    ) -> Plugin:
        """Return the function to call: of an attack that from `fit`."""
        names = ("mechanism", "train", "repeats", "anchor", "companions")
        knowledge = {name: getattr(self, name, None) for name in names}
        context = AttackContext(
            rng=rng, epsilon_m=EPSILON_M, granted=granted, **knowledge
        )
        return call(plugin.fit, context, actor=f"{actor} fit(context)")

    def fault(self, _result: Any) -> str:  # noqa: ANN401 - as the contract says
        """Return the fault of a result that could be read, in words; empty if none."""
        return ""

    out_of_bounds = fault  # The same for an answer too far away.

    def gaps(self, first: Floats, second: Floats) -> Floats:
        """Return the distances of two answers, a row for each sort of number."""
        if first.shape != second.shape:
            return np.array([[np.inf]])
        return np.asarray(np.abs(first - second).T)


# Changed views of a case, or of a training set in it.


def map_releases(case: Holder, change: Callable[[Release], Release]) -> Holder:
    """Return a case with every release in it changed, in the order of its fields."""

    def changed(value: object) -> object:
        if isinstance(value, Release):
            return change(value)
        if isinstance(value, TrainingSet | LinkageTrainingSet):
            return map_releases(value, change)
        return tuple(map(changed, value)) if isinstance(value, tuple) else value

    values = {item.name: changed(getattr(case, item.name)) for item in fields(case)}
    return replace(case, **values)


def copied(case: Holder) -> Holder:
    """Return a copy of a case: a plug-in that changes it affects no other run."""
    own = deepcopy(case)
    for _, array in list_arrays(own):
        array.flags.writeable = False  # as `Release` has it
    return own


def list_arrays(value: object, path: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the path to every array in a case or a part of it, and the array."""
    if isinstance(value, np.ndarray):
        yield path, value
    elif isinstance(value, tuple):
        for number, part in enumerate(value):
            yield from list_arrays(part, f"{path}[{number}]")
    elif is_dataclass(value):
        for item in fields(value):
            yield from list_arrays(getattr(value, item.name), f"{path}.{item.name}")
