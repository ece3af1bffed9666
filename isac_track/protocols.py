"""What a plug-in must offer: a frozen dataclass of its parameters plus one method."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from numpy.random import Generator

    from isac_track.types import Floats, Knowledge, Prediction, Release, Sensed


@runtime_checkable
class Mechanism(Protocol):
    """Turns what was sensed into what is shared.

    A class attribute ``sweep = "log"`` or ``"linear"`` says how ``name:LOW..HIGH/COUNT``
    spaces the first field.
    """

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the release; `rng` starts alike for every mechanism (common random numbers)."""
        ...


@runtime_checkable
class Predictor(Protocol):
    """The robot's forecast of where each pedestrian will be."""

    @property
    def requires(self) -> frozenset[Knowledge]:
        """Knowledge that it cannot run without; a robot has no SIGMA unless this asks for it."""
        ...

    def predict(self, release: Release, t_future: Floats) -> Prediction:
        """Return positions of the N tracks at `t_future`, (N, H) s on each track's clock."""
        ...
