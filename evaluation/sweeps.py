"""The summary as rows of text, for every kind of table: same rows, units and digits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from evaluation.cell import SHARED

if TYPE_CHECKING:
    import pandas as pd

UTILITY = ("missed_conflict_rate", "false_alarm_rate", "distance_mae")
DESCRIPTORS = ("plr", "ael", "mel")


@dataclass(frozen=True, slots=True)
class Shown:
    """How a metric is shown."""

    head: str
    unit: str
    scale: float
    digits: int


SHOWN = {
    "missed_conflict_rate": Shown("missed", "%", 100.0, 1),
    "false_alarm_rate": Shown("false alarm", "%", 100.0, 1),
    "distance_mae": Shown("distance MAE", "m", 1.0, 2),
    "plr": Shown("PLR", "%", 100.0, 1),
    "ael": Shown("AEL", "s", 1.0, 3),
    "mel": Shown("MEL", "s", 1.0, 3),
}
LEVEL_UNITS = {"fid": "eta in 1/(m^2 s)", "fixed": "d_sigma in m"}


@dataclass(frozen=True, slots=True)
class Number:
    """A value with its interval, as text; empty where it is unknown."""

    value: str
    low: str = ""
    high: str = ""

    @property
    def interval(self) -> str:
        """Both ends; they are never negative, so that a hyphen is clear."""
        return f"{self.low}-{self.high}" if self.low else ""


@dataclass(frozen=True, slots=True)
class Sweep:
    """One table: a predictor's view of every level, grouped by mechanism."""

    predictor: str | None
    metrics: tuple[str, ...]
    blocks: dict[str, dict[float | None, dict[str, Number]]]
    """Mechanism to level to metric to number."""


def number(metric: str, value: float, low: float = math.nan, high: float = math.nan) -> Number:
    """Return a value and its interval in the units shown."""
    if not math.isfinite(value):
        return Number("")
    if not (math.isfinite(low) and math.isfinite(high)):
        return Number(amount(metric, value))
    return Number(amount(metric, value), amount(metric, low), amount(metric, high))


def amount(metric: str, value: float, *, sign: str = "-") -> str:
    """Return a value in the units shown, with `sign` "+" for a difference."""
    shown = SHOWN[metric]
    return f"{value * shown.scale:{sign}.{shown.digits}f}"


def level_text(level: float | None) -> str:
    """Return a level, short; empty for a mechanism without one."""
    return "" if level is None or math.isnan(level) else f"{level:.4g}"


def sweeps(summary: pd.DataFrame) -> list[Sweep]:
    """Return the tables of a summary: descriptors with the first predictor, then the others'."""
    numbers = _numbers(summary)
    consumers = dict.fromkeys(key[2] for key in numbers)
    predictors: list[str | None] = [name for name in consumers if name != SHARED]
    found: list[Sweep] = []
    for predictor in predictors or [None]:
        wanted = [(predictor, metric) for metric in UTILITY if predictor is not None]
        if not found:
            wanted += [(SHARED, metric) for metric in DESCRIPTORS]
        present = {key[2:] for key in numbers}
        wanted = [pair for pair in wanted if pair in present]
        blocks: dict[str, dict[float | None, dict[str, Number]]] = {}
        for mechanism, level, consumer, metric in numbers:
            if (consumer, metric) in wanted:
                row = blocks.setdefault(mechanism, {}).setdefault(level, {})
                row[metric] = numbers[mechanism, level, consumer, metric]
        found.append(Sweep(predictor, tuple(metric for _, metric in wanted), blocks))
    return [sweep for sweep in found if sweep.blocks]


def level_unit(mechanism: str) -> str:
    """Return what the level of a mechanism is, as far as it is known."""
    return LEVEL_UNITS.get(mechanism.partition(":")[0], "")


def printable(text: str) -> str:
    """Return a name without what could move a cursor or break a line."""
    return "".join(character if character.isprintable() else "?" for character in text)


def _numbers(summary: pd.DataFrame) -> dict[tuple[str, float | None, str, str], Number]:
    """Return the numbers of the sweep by mechanism, level, consumer and metric, levels rising."""
    utility = summary["metric"].isin(UTILITY)
    shared = summary["metric"].isin(DESCRIPTORS) & (summary["consumer"] == SHARED)
    rows = summary[utility | shared]
    numbers: dict[tuple[str, float | None, str, str], Number] = {}
    for mechanism in rows["mechanism"].unique():
        ordered = rows[rows["mechanism"] == mechanism].sort_values("level", kind="stable")
        for row in ordered.to_dict("records"):
            level = None if math.isnan(row["level"]) else float(row["level"])
            key = (str(mechanism), level, row["consumer"], row["metric"])
            numbers[key] = number(row["metric"], row["value"], row["ci_low"], row["ci_high"])
    return numbers
