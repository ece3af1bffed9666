"""The summary as rows of text, for every kind of table: same rows, units and digits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from attacks.tasks.task_list import TASKS
from evaluation.analysis.keys import AS_SHARED, ORACLE, Source, Where
from isac_track.protocols import ADVERSARIES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import pandas as pd

LEVEL_UNITS = {"fid": "eta in 1/(m^2 s)", "fixed": "d_sigma in m"}


HEADLINE: tuple[tuple[str, float | None, str], ...] = (
    ("raw", None, "raw"),
    ("fid", 1.0, "FID, η = 1"),
    ("fid", 1000.0, "FID, η = 1000"),
    ("fixed", 0.7, "fixed, 0.7 m"),
    ("fixed", 1.0, "fixed, 1.0 m"),
)
"""The few levels that tell the story: mechanism without its adding rule, level and a name."""


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


def remarks(row: Mapping[str, Any]) -> list[str]:
    """Return what is to be said of a linkage cell that does not simply link."""
    return [row["outcome"]] * (row["outcome"] in REMARKS) + [INVALID] * bool(row["invalid"])


def linker(source: Source) -> str:
    """Return the linker of an attack, without the reconstruction that it runs behind."""
    return source.consumer.partition("@")[0]


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


def _task_name(consumer: str) -> str:
    return consumer.partition("/")[0]


def _by_linker(attacks: Iterable[Source]) -> tuple[Source, ...]:
    by_linker: dict[str, list[Source]] = {}
    for source in attacks:
        by_linker.setdefault(linker(source), []).append(source)
    return tuple(source for behind in by_linker.values() for source in behind)
