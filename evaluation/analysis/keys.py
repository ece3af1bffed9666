"""What a number of a run is about: where it was measured, of whose output, by which metric."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

from evaluation.experiment.presets import SHARED

ORACLE: Final = "oracle"
"""Adversary who is granted all: a reference, never the headline."""
Where: TypeAlias = "tuple[str, float | None]"
"""Mechanism and level."""


@dataclass(frozen=True, order=True, slots=True)
class Source:
    """Whose positions a descriptor is of: those shared, or an attack's under an adversary."""

    consumer: str
    knowledge: str = ""

    @property
    def label(self) -> str:
        """For people."""
        return f"{self.consumer} ({self.knowledge})" if self.knowledge else self.consumer

    @property
    def task(self) -> str:
        """What is linked; empty for a reconstruction."""
        task, is_linked, _ = self.consumer.partition("/")
        return task if is_linked else ""

    @property
    def attack(self) -> Source:
        """The same without its task."""
        return Source(self.consumer.removeprefix(f"{self.task}/"), self.knowledge)

    def measure(self, metric: str) -> Measure:
        """Return what it is measured by."""
        return Measure(self.consumer, metric, self.knowledge)


AS_SHARED: Final = Source(SHARED)


@dataclass(frozen=True, slots=True)
class Measure:
    """One thing that is measured at every mechanism level."""

    consumer: str
    metric: str
    knowledge: str = ""

    @property
    def source(self) -> Source:
        """Whose it is."""
        return Source(self.consumer, self.knowledge)


@dataclass(frozen=True, slots=True)
class Key:
    """What a row of the summary is about."""

    mechanism: str
    level: float | None
    consumer: str
    metric: str
    knowledge: str = ""

    @property
    def where(self) -> Where:
        """Mechanism and level."""
        return self.mechanism, self.level

    @property
    def measure(self) -> Measure:
        """What is measured there."""
        return Measure(self.consumer, self.metric, self.knowledge)
