"""What a number of a run is about: where it was measured, of whose output, by which metric."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from evaluation.estimates.metrics import MISSED_RATE
from evaluation.plan.constants import SHARED, horizon_of, is_world
from isac_track.protocols import ADVERSARIES

if TYPE_CHECKING:
    import pandas as pd

    from isac_track.intervals import Estimate

INFORMED: Final = "informed"
Where: TypeAlias = "tuple[str, float | None]"  # Mechanism and level.
Found: TypeAlias = "Mapping[Key, Estimate]"  # What is known of a run.
_MOST_WRITTEN_OUT = 1e7


class Source(NamedTuple):
    """Whose positions a descriptor is of: those shared, or an attack's under an adversary."""

    consumer: str
    knowledge: str = ""

    @property
    def label(self) -> str:
        """For people."""
        return (
            f"{self.consumer} ({self.knowledge})" if self.knowledge else self.consumer
        )

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


class Measure(NamedTuple):
    """One thing that is measured at every mechanism level."""

    consumer: str
    metric: str
    knowledge: str = ""

    @property
    def source(self) -> Source:
        """Whose it is."""
        return Source(self.consumer, self.knowledge)

    @property
    def label(self) -> str:
        """For people: whose it is, and whether all are matched at once."""
        return self.source.label + ", joint" * (self.metric == "rank1_assigned")

    def at(self, mechanism: str, level: float | None) -> Key:
        """Return what a row of the summary about it at one level is about."""
        return Key(mechanism, level, *self)


class Key(NamedTuple):
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


def level_text(level: float | None) -> str:
    """Return a level, short; empty for a mechanism without one."""
    if level is None or math.isnan(level):
        return ""
    short = f"{level:.4g}"
    # As it is typed: 10000, not 1e+04, as long as it can be read.
    return f"{level:.0f}" if "e+" in short and abs(level) < _MOST_WRITTEN_OUT else short


def where_text(mechanism: str, level: float | None) -> str:
    """Return a mechanism and its level as people write it."""
    return f"{mechanism} {level_text(level)}".rstrip()


def rows_of(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table as dictionaries, as `to_dict` does in ten times as long."""
    names = list(frame.columns)
    columns = (frame[name].to_numpy(dtype=object).tolist() for name in names)
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def keys_of(rows: pd.DataFrame) -> list[Key]:
    """Return what the rows of a summary are about."""
    texts = rows["knowledge"].astype(object).fillna("")
    columns = [
        *(rows[name] for name in ("mechanism", "level", "consumer", "metric")),
        texts,
    ]
    every = zip(*columns, strict=True)
    return [Key(name, None if math.isnan(at) else at, *of) for name, at, *of in every]


def horizons_in(entries: Iterable[Mapping[str, Any]]) -> list[float]:
    """Return the further horizons of a run, s, ascending, by the cells of its manifest."""
    worlds = {entry.get("world") or "" for entry in entries}
    return sorted(
        seconds for world in worlds if (seconds := horizon_of(world)) is not None
    )


def judged_at(own: Found, at_horizon: Found) -> Found:
    """Return the estimates of a run with its robots judged at another horizon.

    What that horizon has replaces the run's own number: of robots; all else is one for
    both. A robot that is not read there is left out, lest two horizons are compared.
    """
    robots = {key.consumer for key in own if key.metric == MISSED_RATE}
    absent = robots - {key.consumer for key in at_horizon}
    rest = {
        key: estimate for key, estimate in own.items() if key.consumer not in absent
    }
    return {**rest, **at_horizon}


def worlds_of(frame: pd.DataFrame) -> pd.Series[str]:
    """Return of which other world the rows of a summary are; empty: that of the run."""
    names = frame["dataset"]
    parts = {name: name.rpartition(":") for name in names.unique()}
    of = {
        name: end if start and is_world(end) else ""
        for name, (start, _, end) in parts.items()
    }
    return names.map(of).astype(names.dtype)


def is_attack(frame: pd.DataFrame) -> pd.Series[bool]:
    """Return which rows of a summary name an adversary: an attack's name a predictor may bear."""
    return frame["knowledge"].isin(list(ADVERSARIES))
