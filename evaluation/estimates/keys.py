"""Keys of a run's numbers: mechanism, level, consumer, metric and knowledge."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from evaluation.estimates.metrics import MISSED_RATE
from evaluation.plan.constants import SHARED, is_world, world_horizon_s
from isac_track.protocols import ADVERSARIES

if TYPE_CHECKING:
    import pandas as pd

    from isac_track.intervals import Estimate

INFORMED: Final = "informed"
Where: TypeAlias = "tuple[str, float | None]"  # Mechanism and level.
EstimatesByKey: TypeAlias = "Mapping[Key, Estimate]"
_MOST_WRITTEN_OUT = 1e7


class Source(NamedTuple):
    """Origin of positions: as shared, or rebuilt by an attack of an adversary."""

    consumer: str
    knowledge: str = ""

    @property
    def label(self) -> str:
        """Text for people: the consumer, with the adversary in brackets."""
        if not self.knowledge:
            return self.consumer
        return f"{self.consumer} ({self.knowledge})"

    @property
    def task(self) -> str:
        """Linkage task; empty for a reconstruction."""
        task, is_linked, _ = self.consumer.partition("/")
        return task if is_linked else ""

    @property
    def attack(self) -> Source:
        """The same source without its task."""
        return Source(self.consumer.removeprefix(f"{self.task}/"), self.knowledge)

    def measure(self, metric: str) -> Measure:
        """Return the measure of this source by a metric."""
        return Measure(self.consumer, metric, self.knowledge)


AS_SHARED: Final = Source(SHARED)


class Measure(NamedTuple):
    """A metric of a source, measured at every mechanism level."""

    consumer: str
    metric: str
    knowledge: str = ""

    @property
    def source(self) -> Source:
        """Source whose positions are measured."""
        return Source(self.consumer, self.knowledge)

    @property
    def label(self) -> str:
        """Text for people: the source, and whether all probes are matched at once."""
        label = self.source.label
        return f"{label}, joint" if self.metric == "rank1_assigned" else label

    def at(self, mechanism: str, level: float | None) -> Key:
        """Return the key of this measure at a mechanism's level."""
        return Key(mechanism, level, *self)


class Key(NamedTuple):
    """Identity of a number in the summary."""

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
        """Measure without the mechanism and its level."""
        return Measure(self.consumer, self.metric, self.knowledge)


def level_text(level: float | None) -> str:
    """Return a level as a short text; empty for a mechanism without levels."""
    if level is None or math.isnan(level):
        return ""
    short = f"{level:.4g}"
    # Write it as people type it, 10000 and not 1e+04, as long as it can be read.
    return f"{level:.0f}" if "e+" in short and abs(level) < _MOST_WRITTEN_OUT else short


def where_text(mechanism: str, level: float | None) -> str:
    """Return a mechanism and its level as people write it."""
    return f"{mechanism} {level_text(level)}".rstrip()


def row_dicts(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table as dictionaries, ten times as fast as `to_dict`."""
    names = list(frame.columns)
    columns = (frame[name].to_numpy(dtype=object).tolist() for name in names)
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def row_keys(rows: pd.DataFrame) -> list[Key]:
    """Return the key of each row of a summary."""
    knowledge = rows["knowledge"].astype(object).fillna("")
    names = ("mechanism", "level", "consumer", "metric")
    columns = [*(rows[name] for name in names), knowledge]
    return [
        Key(mechanism, None if math.isnan(level) else level, *measure)
        for mechanism, level, *measure in zip(*columns, strict=True)
    ]


def horizons_in(entries: Iterable[Mapping[str, Any]]) -> list[float]:
    """Return the further horizons of a run, s, ascending, from its manifest's cells."""
    worlds = {entry.get("world") or "" for entry in entries}
    return sorted(
        seconds for world in worlds if (seconds := world_horizon_s(world)) is not None
    )


def judged_at(own: EstimatesByKey, at_horizon: EstimatesByKey) -> EstimatesByKey:
    """Return the estimates of a run with its robots judged at another horizon.

    The numbers of robots at that horizon replace those of the run's own; all other
    numbers are the same for both. A robot without numbers at that horizon is left out,
    so that two horizons are never compared.
    """
    robots = {key.consumer for key in own if key.metric == MISSED_RATE}
    not_judged = robots - {key.consumer for key in at_horizon}
    comparable = {
        key: estimate for key, estimate in own.items() if key.consumer not in not_judged
    }
    return {**comparable, **at_horizon}


def row_worlds(frame: pd.DataFrame) -> pd.Series[str]:
    """Return the world of each row of a summary; empty for the run's own world."""
    names = frame["dataset"]
    parts = {name: name.rpartition(":") for name in names.unique()}
    world_by_name = {
        name: end if start and is_world(end) else ""
        for name, (start, _, end) in parts.items()
    }
    return names.map(world_by_name).astype(names.dtype)


def is_attack(frame: pd.DataFrame) -> pd.Series[bool]:
    """Return which rows of a summary are of an attack.

    Only these name an adversary; a predictor may bear the same name as an attack.
    """
    return frame["knowledge"].isin(list(ADVERSARIES))
