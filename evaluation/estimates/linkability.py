"""The scorecards of a run, and what each says: `linkability.csv`.

An outcome is one of three: *links*, *no link detected* (with the rank-1 rate that would
have been found), *attack too weak* (it fails on clean, too: its silence is no privacy).
A cell whose shortcut audit beats chance is invalid, and says which shortcut it was.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
import pandas as pd

from attacks.tasks.controls import CONTROLS
from attacks.tasks.task_list import TASKS
from evaluation.estimates.families import CLEAN
from evaluation.estimates.keys import Source, Where, rows_of
from evaluation.estimates.strongest import most_knowing
from evaluation.store.cell_files import LinkageOutcome, read_outcomes
from isac_track.linkability.significance import LEVEL, holm, outcome

# Two-sided, over all audits of a cell (Holm); set before any was run.
AUDIT_LEVEL: Final = 0.01
_RANK1, _SIZES = (
    ("rank1", "ci_low", "ci_high"),
    ("gallery_min", "gallery_max", "gallery_mean"),
)
COLUMNS = [
    "dataset",
    "mechanism",
    "level",
    "consumer",
    "knowledge",
    "cohort",
    "outcome",
    "invalid",
    "p_value",
    "p_rank1",
    *_RANK1,
    "chance",
    "minimum_detectable_rank1",
    "n_probes",
    "n_mated",
    "n_clusters",
    "gallery_min",
    "gallery_mean",
    "gallery_max",
    "realised_fpr_1pct",
    "realised_fpr_01pct",
    "d_sys_bins",
    "inverted",
]
INVALID = "invalid"
REMARKS = {
    "no link detected": "no link detected",
    "attack too weak": "attack too weak: it fails on clean too",
    INVALID: "a shortcut leaks: no measure of the attack",
}
"""What is to be said of a linkage cell that does not simply link, with what it means."""
TWO_SESSIONS = (  # Data set of the simulated two-session crowd's tasks.
    "plaza-two-sessions"
)
Cards: TypeAlias = "Sequence[tuple[Mapping[str, Any], LinkageOutcome]]"


@lru_cache(maxsize=1024)
def dataset_of(consumer: str, *, dataset: str, world: str = "") -> str:
    """Return the data set that a row is about: a simulated task has its own, and so has a world."""
    task = TASKS.get(consumer.partition("/")[0])
    name = TWO_SESSIONS if task is not None and task.simulated else dataset
    return f"{name}:{world}" if world else name


def cards(
    out: Path,
    manifest: Mapping[str, Any],
    *,
    drawn: Collection[str] | None = None,
    world: str = "",
) -> Cards:
    """Return the card of every linkage cell with its entry in the manifest, of one of `WORLDS`.

    `drawn` are the metrics of attacks that need replicates; without it all have them,
    and controls. Raises DataError if a cell cannot be read.
    """
    linked = (
        entry for entry in manifest["cells"] if entry["kind"] in ("linkage", "control")
    )
    entries = [entry for entry in linked if entry.get("world", "") == world]
    return list(zip(entries, read_outcomes(out, entries, drawn=drawn), strict=True))


def linkability(read: Cards, *, dataset: str) -> pd.DataFrame:
    """Return what every linkage cell says, a row for each cohort; the columns are `COLUMNS`.

    `read` is what `cards` returns, `dataset` that of the run.
    """
    ceilings = {
        (entry["consumer"], entry["knowledge"]): card.numbers["p_value"]
        for entry, card in read
        if entry["mechanism"] == CLEAN
    }
    leaks = _leaks(read)
    rows = []
    for entry, card in read:
        consumer, numbers = entry["consumer"], card.numbers
        p_value = numbers["p_value"]
        if entry["kind"] == "control":
            found = "beats chance" if p_value <= LEVEL else "at chance"
        else:
            found = outcome(
                p_value=p_value, ceiling_p_value=ceilings[consumer, entry["knowledge"]]
            )
        rank1 = card.estimates["rank1"]
        row = {
            **{name: entry[name] for name in ("mechanism", "consumer", "knowledge")},
            "dataset": dataset_of(consumer, dataset=dataset),
            "level": np.nan if entry["level"] is None else entry["level"],
            "invalid": ", ".join(leaks.get((entry["spec"], Source(consumer).task), ())),
        }
        everybody = {
            **numbers,
            "outcome": found,
            **dict(
                zip(_RANK1, (rank1.value, rank1.ci_low, rank1.ci_high), strict=True)
            ),
            "chance": card.estimates["chance"].value,
            **dict(zip(_SIZES, numbers["gallery_sizes"], strict=True)),
            "inverted": numbers["is_inverted"],
        }
        cohorts = {"all": everybody, **card.cohorts}
        rows += [{**row, "cohort": name, **cohort} for name, cohort in cohorts.items()]
    return pd.DataFrame(rows, columns=COLUMNS)


def _leaks(read: Cards) -> dict[tuple[str, str], list[str]]:
    """Return which shortcuts beat chance, by mechanism SPEC and task (Holm over the audits)."""
    audits: dict[tuple[str, str], dict[str, float]] = {}
    for entry, card in read:
        task, _, name = entry["consumer"].partition("/control-")
        if entry["kind"] == "control" and CONTROLS[name].audits(TASKS[task]):
            # Two-sided: who scores mates low gives them away as well.
            tails = card.numbers["p_value"], card.numbers["p_value_low"]
            audits.setdefault((entry["spec"], task), {})[name] = min(
                1.0, 2.0 * min(tails)
            )
    return {
        where: sorted(
            np.array([*p])[holm(np.array([*p.values()])) <= AUDIT_LEVEL].tolist()
        )
        for where, p in audits.items()
    }


@dataclass(frozen=True, eq=False, slots=True)
class LinkedTask:
    """A linkage task: how well each attack links at each level, and its controls."""

    name: str
    about: str
    attacks: tuple[
        Source, ...
    ]  # Of each the adversary that knows most, short of the oracle.
    cohorts: dict[str, dict[Where, dict[Source, Mapping[str, Any]]]]
    """Rows of `linkability.csv` by cohort, mechanism and level, and attack."""
    controls: tuple[Mapping[Any, Any], ...]  # Rows of the controls, at all levels.

    @property
    def cells(self) -> dict[Where, dict[Source, Mapping[str, Any]]]:
        """The result: everybody, at each level."""
        return self.cohorts["all"]


def linked_tasks(linkability: pd.DataFrame) -> list[LinkedTask]:
    """Return the tasks in which somebody links, in the order of the run, levels rising."""
    # Of texts read from a file, those that are empty are missing.
    texts = ["knowledge", "outcome", "invalid"]
    tidy = linkability.assign(**linkability[texts].astype(object).fillna(""))
    # Mechanisms in the order of the run, not of their levels.
    order = {
        name: place for place, name in enumerate(linkability["mechanism"].unique())
    }
    tidy = tidy.sort_values("level", kind="stable", na_position="first")
    tasks = {name: Source(name).task for name in linkability["consumer"].unique()}
    task_of = tidy["consumer"].map(tasks)
    found = []
    for task in dict.fromkeys(tasks.values()):
        of = tidy[task_of == task]
        cohorts: dict[str, dict[Where, dict[Source, Mapping[str, Any]]]] = {}
        linked = of[of["knowledge"] != ""]
        linked = linked.sort_values(
            "mechanism", kind="stable", key=lambda name: name.map(order)
        )
        for row in rows_of(linked):
            where = (
                row["mechanism"],
                None if math.isnan(row["level"]) else float(row["level"]),
            )
            source = Source(row["consumer"], row["knowledge"]).attack
            cohorts.setdefault(row["cohort"], {}).setdefault(where, {})[source] = row
        if "all" not in cohorts:
            continue
        linkers: dict[str, list[Source]] = {}
        for source in most_knowing(
            one for level in cohorts["all"].values() for one in level
        ):
            # The reconstructions that a linker runs behind, next to it.
            linkers.setdefault(source.consumer.partition("@")[0], []).append(source)
        about = TASKS[task].about if task in TASKS else ""
        controls = tuple(rows_of(of[of["knowledge"] == ""]))
        found.append(
            LinkedTask(task, about, tuple(chain(*linkers.values())), cohorts, controls)
        )
    return found


def remarks(row: Mapping[str, Any]) -> list[str]:
    """Return what is to be said of a linkage cell that does not simply link."""
    return [row["outcome"]] * (row["outcome"] in REMARKS) + [INVALID] * bool(
        row["invalid"]
    )
