"""The summary as rows of text, for every kind of table: same rows, units and digits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from attacks.tasks.task_list import TASKS
from evaluation.analysis.keys import AS_SHARED, ORACLE, Source, Where
from evaluation.analysis.linkability import CLEAN
from evaluation.analysis.matching import ADDING_SUFFIX
from evaluation.analysis.metrics import DESCRIPTORS, METRICS, RECONSTRUCTION, UTILITY
from evaluation.experiment.presets import SHARED
from isac_track.protocols import ADVERSARIES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import pandas as pd

SHOWN = {name: METRICS[name] for name in (*UTILITY, *RECONSTRUCTION, "rank1")}
_READ = ["level", "consumer", "knowledge", "metric", "value", "ci_low", "ci_high"]
LEVEL_UNITS = {"fid": "eta in 1/(m^2 s)", "fixed": "d_sigma in m"}


HEADLINE: tuple[tuple[str, float | None, str], ...] = (
    ("raw", None, "raw"),
    ("fid", 1.0, "FID, η = 1"),
    ("fid", 1000.0, "FID, η = 1000"),
    ("fixed", 0.7, "fixed, 0.7 m"),
    ("fixed", 1.0, "fixed, 1.0 m"),
)
"""The few levels that tell the story: mechanism without its adding rule, level and a name."""


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


After: TypeAlias = "dict[tuple[str, float | None], dict[Source, dict[str, Number]]]"
"""Mechanism and level to source to metric to number."""


INVALID = "invalid"
REMARKS = {
    "no link detected": "no link detected",
    "attack too weak": "attack too weak: it fails on clean too",
    INVALID: "a shortcut leaks: no measure of the attack",
}
"""What is to be said of a linkage cell that does not simply link: its outcome, or that a shortcut
gives people away. With what it means."""


@dataclass(frozen=True, eq=False, slots=True)
class LinkedTask:
    """A linkage task: how well each attack links at each level, and its controls."""

    name: str
    about: str
    attacks: tuple[Source, ...]
    """Of each attack the adversary that knows most, short of the oracle if there is one."""
    cohorts: dict[str, dict[Where, dict[Source, Mapping[str, Any]]]]
    """Rows of `linkability.csv` by cohort, mechanism and level, and attack."""
    controls: tuple[Mapping[str, Any], ...]
    """Rows of the controls, at all levels."""

    @property
    def cells(self) -> dict[Where, dict[Source, Mapping[str, Any]]]:
        """The result: everybody, at each level."""
        return self.cohorts["all"]


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


def shared_head(metric: str) -> str:
    """Return the name and unit of a metric; a descriptor's with whose positions it is of."""
    shown = SHOWN[metric]
    return f"{shown.head}{', shared' * (metric in DESCRIPTORS)} ({shown.unit})"


_MOST_WRITTEN_OUT = 1e7


def level_text(level: float | None) -> str:
    """Return a level, short; empty for a mechanism without one."""
    if level is None or math.isnan(level):
        return ""
    short = f"{level:.4g}"
    # As it is typed: 10000, not 1e+04, as long as it can be read.
    return f"{level:.0f}" if "e+" in short and abs(level) < _MOST_WRITTEN_OUT else short


def is_attack(frame: pd.DataFrame) -> pd.Series[bool]:
    """Return which rows of a summary are of an attack: those that name an adversary.

    Not the name of the consumer tells: an attack and a predictor may bear the same.
    """
    return frame["knowledge"].isin(list(ADVERSARIES))


def sweeps(summary: pd.DataFrame) -> list[Sweep]:
    """Return the tables of a summary: descriptors with the first predictor, then the others'."""
    others = summary[~is_attack(summary)]
    is_shared = others["consumer"] == SHARED
    wanted = others["metric"].isin(DESCRIPTORS).where(is_shared, others["metric"].isin(UTILITY))
    numbers = _numbers(others[wanted])
    consumers = dict.fromkeys(source.consumer for _, _, source, _ in numbers)
    predictors: list[str | None] = [name for name in consumers if name != SHARED]
    found: list[Sweep] = []
    for predictor in predictors or [None]:
        drawn = {predictor} if found else {predictor, SHARED}
        blocks: dict[str, dict[float | None, dict[str, Number]]] = {}
        for (mechanism, level, source, metric), one in numbers.items():
            if source.consumer in drawn:
                blocks.setdefault(mechanism, {}).setdefault(level, {})[metric] = one
        present = {metric for _, _, source, metric in numbers if source.consumer in drawn}
        metrics = tuple(name for name in (*UTILITY, *DESCRIPTORS) if name in present)
        found.append(Sweep(predictor, metrics, blocks))
    return [sweep for sweep in found if sweep.blocks]


def after_attack(summary: pd.DataFrame) -> After:
    """Return the descriptors as shared and after each attack, by level; empty without attacks."""
    attacked = is_attack(summary)
    if not attacked.any():
        return {}
    rows = summary[attacked | (summary["consumer"] == SHARED)]
    rows = rows[rows["metric"].isin(RECONSTRUCTION)]
    found: After = {}
    for (mechanism, level, source, metric), one in _numbers(rows).items():
        found.setdefault((mechanism, level), {}).setdefault(source, {})[metric] = one
    return found


def sources(blocks: Iterable[Iterable[Source]]) -> list[Source]:
    """Return all sources of some levels, each once, in the order of the run."""
    return list(dict.fromkeys(source for block in blocks for source in block))


def most_knowing(of: Iterable[Source]) -> list[Source]:
    """Return for each attack the adversary that knows most, short of the oracle if there is one.

    What was shared stays.
    """
    # The oracle is a reference: it stands for an attack that nobody else can run.
    rank = {"": 0, ORACLE: 0} | {
        name: 1 + place for place, name in enumerate(name for name in ADVERSARIES if name != ORACLE)
    }
    best: dict[str, Source] = {}
    for source in of:
        name = "" if source == AS_SHARED else source.consumer
        if name not in best or rank[source.knowledge] > rank[best[name].knowledge]:
            best[name] = source
    return list(best.values())


def linked_tasks(linkability: pd.DataFrame) -> list[LinkedTask]:
    """Return the tasks in which somebody links, in the order of the run, levels rising."""
    tidy = linkability.sort_values("level", kind="stable", na_position="first")
    for name in ("knowledge", "outcome", "invalid"):
        # Of texts read from a file, those that are empty are missing.
        texts = tidy[name].astype(object)
        tidy = tidy.assign(**{name: texts.where(texts.notna(), "")})
    found = []
    for task in linkability["consumer"].map(_task_name).unique():
        of = tidy[tidy["consumer"].map(_task_name) == task]
        cohorts: dict[str, dict[Where, dict[Source, Mapping[str, Any]]]] = {}
        # In the order of the run, not of their levels.
        for mechanism in linkability["mechanism"].unique():
            rows = of[(of["mechanism"] == mechanism) & (of["knowledge"] != "")]
            for row in rows.to_dict("records"):
                where = mechanism, None if math.isnan(row["level"]) else float(row["level"])
                source = Source(row["consumer"].removeprefix(f"{task}/"), row["knowledge"])
                cohorts.setdefault(row["cohort"], {}).setdefault(where, {})[source] = row
        if "all" not in cohorts:
            continue
        found.append(
            LinkedTask(
                name=task,
                about=TASKS[task].about if task in TASKS else "",
                # The reconstructions that a linker runs behind, next to it.
                attacks=_by_linker(most_knowing(sources(cohorts["all"].values()))),
                cohorts=cohorts,
                controls=tuple(of[of["knowledge"] == ""].to_dict("records")),
            )
        )
    return found


def linked_levels(task: LinkedTask) -> list[Where]:
    """Return the ceiling, raw and the headline levels; all levels of a run without any of these."""
    without_level: tuple[Where, ...] = ((CLEAN, None), ("raw", None))
    alone = [where for where in without_level if where in task.cells]
    headline: list[Where] = [
        where
        for suffix in ADDING_SUFFIX.values()
        for mechanism, level, _ in HEADLINE
        if level is not None and (where := (mechanism + suffix, level)) in task.cells
    ]
    return alone + (headline or [where for where in task.cells if where not in alone])


def remarks(row: Mapping[str, Any]) -> list[str]:
    """Return what is to be said of a linkage cell that does not simply link."""
    return [row["outcome"]] * (row["outcome"] in REMARKS) + [INVALID] * bool(row["invalid"])


def linker(source: Source) -> str:
    """Return the linker of an attack, without the reconstruction that it runs behind."""
    return source.consumer.partition("@")[0]


def adding_of(mechanism: str) -> tuple[str, str]:
    """Return a mechanism without its adding rule, and the rule if it is the independent one."""
    suffix = ADDING_SUFFIX["independent"]
    bare = mechanism.removesuffix(suffix)
    return bare, "independent" if bare != mechanism else ""


def level_unit(mechanism: str) -> str:
    """Return what the level of a mechanism is, as far as it is known."""
    return LEVEL_UNITS.get(mechanism.partition(":")[0], "")


def heading(mechanism: str) -> str:
    """Return a mechanism with what its level is."""
    unit = level_unit(mechanism)
    return f"{mechanism}, {unit}" if unit else mechanism


def shortened(name: str, *, room: int) -> str:
    """Return a name without its middle if it is too long: its settings are at the end."""
    if len(name) <= room:
        return name
    end = (room - 3) // 2
    return f"{name[: room - 3 - end]}...{name[-end:]}"


def printable(text: str) -> str:
    """Return a name without what could move a cursor or break a line."""
    return "".join(character if character.isprintable() else "?" for character in text)


def _numbers(rows: pd.DataFrame) -> dict[tuple[str, float | None, Source, str], Number]:
    """Return the numbers by mechanism, level, source and metric, levels rising."""
    numbers: dict[tuple[str, float | None, Source, str], Number] = {}
    by_adversary = rows.assign(knowledge=rows["knowledge"].where(is_attack(rows), ""))
    for mechanism in by_adversary["mechanism"].unique():
        of = by_adversary[by_adversary["mechanism"] == mechanism]
        ordered = of.sort_values("level", kind="stable")
        for level, consumer, knowledge, metric, value, low, high in ordered[_READ].itertuples(
            index=False, name=None
        ):
            where = str(mechanism), None if math.isnan(level) else float(level)
            source = Source(consumer, knowledge)
            numbers[*where, source, metric] = number(metric, value, low, high)
    return numbers


def _task_name(consumer: str) -> str:
    return consumer.partition("/")[0]


def _by_linker(attacks: Iterable[Source]) -> tuple[Source, ...]:
    by_linker: dict[str, list[Source]] = {}
    for source in attacks:
        by_linker.setdefault(linker(source), []).append(source)
    return tuple(source for behind in by_linker.values() for source in behind)
