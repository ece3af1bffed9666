"""What each level of a run comes to, for `evaluation.design`: read from its files as they are."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import pandas as pd

from evaluation.analysis.keys import AS_SHARED, Source
from evaluation.analysis.levels import linked_tasks, most_knowing
from evaluation.analysis.linkability import dataset_of
from evaluation.analysis.metrics import DESCRIPTORS
from isac_track.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from evaluation.analysis.keys import Where
    from evaluation.analysis.levels import LinkedTask

METRIC_OF: Final = {
    "missed": "missed_conflict_rate",
    "false_alarm": "false_alarm_rate",
    **dict(zip(DESCRIPTORS, DESCRIPTORS, strict=True)),
}
"""By what it is called in the question and in the answer."""
WEAK: Final = "attack too weak"
_KNOWING = ("blind", "informed")
"""Adversaries that count; the oracle is a reference."""
_TEXTS = ("mechanism", "consumer", "knowledge", "metric")
_NUMBERS = ("level", "value", "ci_low", "ci_high")
_LINKED_TEXTS = ("mechanism", "consumer", "knowledge", "cohort", "outcome", "invalid")
_LINKED_NUMBERS = ("level", "rank1", "ci_low", "ci_high", "chance")


@dataclass(frozen=True, slots=True)
class Measured:
    """A value with its 95 % interval; NaN where it is unknown."""

    value: float = math.nan
    ci_low: float = math.nan
    ci_high: float = math.nan


@dataclass(frozen=True, slots=True)
class Attacked:
    """The descriptors after the reconstruction attack with the highest PLR."""

    attack: str
    knowledge: str
    plr: Measured
    ael: Measured
    mel: Measured


@dataclass(frozen=True, slots=True)
class Linked:
    """The strongest attack in a linkage task: the strongest valid one if there is one."""

    task: str
    dataset: str
    limited: bool
    """Whether a limit of rank 1 is about it: it links people of the recording."""
    attack: str = ""
    """Empty: the task was not run at this level."""
    knowledge: str = ""
    rank1: Measured = Measured()
    chance: float = math.nan
    outcome: str = ""
    invalid: str = ""
    """Shortcuts that give people away here; empty: none."""


@dataclass(frozen=True, slots=True)
class Level:
    """What one level of the run comes to."""

    mechanism: str
    level: float | None
    missed: Measured
    false_alarm: Measured
    plr: Measured
    ael: Measured
    mel: Measured
    after_attack: Attacked | None
    tasks: tuple[Linked, ...]


def read_levels(out: Path, *, dataset: str, predictor: str) -> dict[Where, Level]:
    """Return what each level of a run comes to that a predictor was run on, and raw.

    `dataset` is the recording of the run. Every level has all tasks of the run.

    Raises
    ------
    DataError
        If a file of the run is missing or broken.
    """
    again = f"python -m evaluation.report {shlex.quote(str(out))} writes it anew"
    summary = _table(out / "summary.csv", texts=_TEXTS, numbers=_NUMBERS, way_out=again)
    if summary is None:
        raise DataError(f"{out / 'summary.csv'} is missing; {again} if the run has finished")
    blocks: dict[Where, dict[Source, dict[str, Measured]]] = {}
    wanted = summary[summary["metric"].isin(METRIC_OF.values())]
    for row in wanted.itertuples(index=False, name=None):
        mechanism, consumer, knowledge, metric, level, *found = row
        where = mechanism, None if math.isnan(level) else level
        of = blocks.setdefault(where, {}).setdefault(Source(consumer, knowledge), {})
        of[metric] = Measured(*found)
    linkability = _table(
        out / "linkability.csv", texts=_LINKED_TEXTS, numbers=_LINKED_NUMBERS, way_out=again
    )
    tasks = [] if linkability is None else linked_tasks(linkability)
    return {
        where: Level(
            mechanism=where[0],
            level=where[1],
            **_of(block.get(Source(predictor), {}), "missed", "false_alarm"),
            **_of(block[AS_SHARED], *DESCRIPTORS),
            after_attack=_best_reconstruction(block),
            tasks=tuple(_strongest(task, where, dataset=dataset) for task in tasks),
        )
        for where, block in blocks.items()
        if AS_SHARED in block and (where[0] == "raw" or Source(predictor) in block)
    }


def _table(
    path: Path, *, texts: Sequence[str], numbers: Sequence[str], way_out: str
) -> pd.DataFrame | None:
    """Return some columns of a table, texts first; None if there is no such file."""
    columns = [*texts, *numbers]
    try:
        # A name may be "NA": only an empty number is unknown.
        return pd.read_csv(
            path,
            usecols=columns,
            dtype=dict.fromkeys(texts, str) | dict.fromkeys(numbers, float),
            keep_default_na=False,
            na_values={name: [""] for name in numbers},
        )[columns]
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise DataError(f"{path} cannot be read ({reason}); {way_out}") from None


def _best_reconstruction(block: Mapping[Source, Mapping[str, Measured]]) -> Attacked | None:
    """Return the attack with the highest PLR."""
    plr = {source: _of(block[source], "plr")["plr"].value for source in _counting(block)}
    best = max((one for one in plr if math.isfinite(plr[one])), key=plr.__getitem__, default=None)
    if best is None:
        return None
    return Attacked(best.consumer, best.knowledge, **_of(block[best], *DESCRIPTORS))


def _strongest(task: LinkedTask, where: Where, *, dataset: str) -> Linked:
    """Return the attack with the highest rank 1, of the valid ones if there are any."""
    own = dataset_of(task.name, dataset=dataset)
    rows = task.cells.get(where, {})
    known = [source for source in _counting(rows) if math.isfinite(rows[source]["rank1"])]
    valid = [one for one in known if rows[one]["outcome"] != WEAK and not rows[one]["invalid"]]
    if not known:
        return Linked(task.name, own, own == dataset)
    best = max(valid or known, key=lambda one: (rows[one]["rank1"], rows[one]["ci_high"]))
    row = rows[best]
    return Linked(
        *(task.name, own, own == dataset, best.consumer, best.knowledge),
        rank1=Measured(row["rank1"], row["ci_low"], row["ci_high"]),
        **{name: row[name] for name in ("chance", "outcome", "invalid")},
    )


def _counting(sources: Iterable[Source]) -> list[Source]:
    """Return of each attack the adversary that knows most, without the oracle."""
    return most_knowing(source for source in sources if source.knowledge in _KNOWING)


def _of(numbers: Mapping[str, Measured], *names: str) -> dict[str, Measured]:
    return {name: numbers.get(METRIC_OF[name], Measured()) for name in names}
