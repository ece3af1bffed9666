"""Scorecards of a run's linkage attacks, and their outcomes: `linkability.csv`.

An outcome is one of three: *links*, *no link detected* (with the smallest rank-1 rate
that the test would have detected), *attack too weak* (the attack also fails on clean,
so that its failure shows no privacy). A cell whose shortcut audit beats chance is
invalid, and names the shortcut.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
import pandas as pd

from attacks.tasks.controls import CONTROLS
from attacks.tasks.task_list import TASKS
from evaluation.estimates.families import CLEAN
from evaluation.estimates.keys import row_dicts
from evaluation.estimates.metrics import CHANCE, RANK1
from evaluation.estimates.recordings import in_run
from evaluation.estimates.strongest import most_knowing
from evaluation.plan.address import Address, MechanismLevel, parse_consumer
from evaluation.plan.world import OWN_WORLD, World
from evaluation.store.entries import Entry, entries_in
from evaluation.store.linkage_outcomes import LinkageOutcome, read_outcomes
from isac_track.linkability import significance
from isac_track.linkability.significance import LEVEL, holm

# Two-sided, over all audits of a cell (Holm); set before any was run.
AUDIT_LEVEL: Final = 0.01
_RANK1 = ("rank1", "ci_low", "ci_high")
_SIZES = ("gallery_min", "gallery_max", "gallery_mean")
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
"""Remarks on a linkage cell that does not simply link, each with its meaning."""
Cohorts: TypeAlias = "dict[str, dict[MechanismLevel, dict[Address, Mapping[str, Any]]]]"
LinkageOutcomes: TypeAlias = "Sequence[tuple[Entry, LinkageOutcome]]"


def linkage_outcomes(
    out: Path,
    manifest: Mapping[str, Any],
    *,
    drawn: Collection[str] | None = None,
    world: World = OWN_WORLD,
) -> LinkageOutcomes:
    """Return the outcome of every linkage cell of a world, with its manifest entry.

    `drawn` are the attacks' metrics that need replicates; without it all metrics of
    attacks and controls have them. Raises DataError if a cell cannot be read.
    """
    entries = entries_in(manifest["cells"], world, kinds=("linkage", "control"))
    return list(zip(entries, read_outcomes(out, entries, drawn=drawn), strict=True))


def linkability(outcomes: LinkageOutcomes, *, dataset: str) -> pd.DataFrame:
    """Return the outcome of every linkage cell, a row for each cohort: `COLUMNS`.

    `dataset` is that of the run.
    """
    # The plan adds `clean` to every linkage task.
    ceilings = {
        entry.address.reader: outcome.numbers["p_value"]
        for entry, outcome in outcomes
        if entry.address.mechanism == CLEAN
    }
    leaks = _leaks(outcomes)
    rows = []
    for entry, outcome in outcomes:
        address, numbers = entry.address, outcome.numbers
        p_value = numbers["p_value"]
        if entry.kind == "control":
            result = "beats chance" if p_value <= LEVEL else "at chance"
        else:
            result = significance.outcome(
                p_value=p_value, ceiling_p_value=ceilings[address.reader]
            )
        rank1 = outcome.estimates[RANK1]
        ends = rank1.value, rank1.ci_low, rank1.ci_high
        row = {
            **in_run(address, dataset=dataset).to_columns(),
            "invalid": ", ".join(leaks.get((entry.spec, address.task), ())),
        }
        everybody = {
            **numbers,
            "outcome": result,
            **dict(zip(_RANK1, ends, strict=True)),
            "chance": outcome.estimates[CHANCE].value,
            **dict(zip(_SIZES, numbers["gallery_sizes"], strict=True)),
            "inverted": numbers["is_inverted"],
        }
        cohorts = {"all": everybody, **outcome.cohorts}
        rows += [{**row, "cohort": name, **cohort} for name, cohort in cohorts.items()]
    return pd.DataFrame(rows, columns=COLUMNS)


def _leaks(outcomes: LinkageOutcomes) -> dict[tuple[str, str], list[str]]:
    """Return the shortcuts that beat chance, by SPEC and task (after Holm)."""
    audits: dict[tuple[str, str], dict[str, float]] = {}
    for entry, outcome in outcomes:
        address = entry.address
        task, name = address.task, address.control
        if entry.kind == "control" and CONTROLS[name].audits(TASKS[task]):
            # Two-sided: scores that are low for mates also give them away.
            tails = outcome.numbers["p_value"], outcome.numbers["p_value_low"]
            p_values = audits.setdefault((entry.spec, task), {})
            p_values[name] = min(1.0, 2.0 * min(tails))
    leaks = {}
    for cell, p_values in audits.items():
        names = np.array([*p_values])
        is_leak = holm(np.array([*p_values.values()])) <= AUDIT_LEVEL
        leaks[cell] = sorted(names[is_leak].tolist())
    return leaks


@dataclass(frozen=True, eq=False, slots=True)
class TaskOutcomes:
    """A linkage task: the success of each attack at each level, and its controls."""

    name: str
    about: str
    # Each attack with the adversary that knows most, short of the oracle.
    attacks: tuple[Address, ...]
    cohorts: Cohorts
    """Rows of `linkability.csv` by cohort, mechanism and level, and attack."""
    controls: tuple[Mapping[Any, Any], ...]  # Rows of the controls, at all levels.

    @property
    def cells(self) -> dict[MechanismLevel, dict[Address, Mapping[str, Any]]]:
        """Rows of the cohort of all people, at each level."""
        return self.cohorts["all"]


def task_outcomes(linkability: pd.DataFrame) -> list[TaskOutcomes]:
    """Return the tasks with an attack, in the order of the run, levels rising."""
    # Empty texts are missing where the table was read from a file.
    texts = ["knowledge", "outcome", "invalid"]
    tidy = linkability.assign(**linkability[texts].astype(object).fillna(""))
    # Mechanisms in the order of the run, not of their levels.
    order = {
        name: place for place, name in enumerate(linkability["mechanism"].unique())
    }
    tidy = tidy.sort_values("level", kind="stable", na_position="first")
    tasks = {
        name: parse_consumer(name).task for name in linkability["consumer"].unique()
    }
    task_column = tidy["consumer"].map(tasks)
    tasks_known = []
    for task in dict.fromkeys(tasks.values()):
        rows = tidy[task_column == task]
        linked = rows[rows["knowledge"] != ""]
        linked = linked.sort_values(
            "mechanism", kind="stable", key=lambda name: name.map(order)
        )
        cohorts = _cohorts(linked)
        if "all" not in cohorts:
            continue
        readers = (reader for level in cohorts["all"].values() for reader in level)
        linkers: dict[str, list[Address]] = {}
        for reader in most_knowing(readers):
            # A linker may run behind several reconstructions: keep these together.
            linkers.setdefault(reader.plugin, []).append(reader)
        about = TASKS[task].about if task in TASKS else ""
        controls = tuple(row_dicts(rows[rows["knowledge"] == ""]))
        attacks = tuple(chain(*linkers.values()))
        tasks_known.append(TaskOutcomes(task, about, attacks, cohorts, controls))
    return tasks_known


def _cohorts(linked: pd.DataFrame) -> Cohorts:
    """Return the rows of a task's attacks by cohort, place and attack."""
    cohorts: Cohorts = {}
    for row in row_dicts(linked):
        level = None if math.isnan(row["level"]) else float(row["level"])
        where = MechanismLevel(row["mechanism"], level)
        reader = parse_consumer(row["consumer"], row["knowledge"]).without_task
        cohorts.setdefault(row["cohort"], {}).setdefault(where, {})[reader] = row
    return cohorts


def remarks(row: Mapping[str, Any]) -> list[str]:
    """Return the remarks on a linkage cell that does not simply link."""
    names = []
    if row["outcome"] in REMARKS:
        names.append(row["outcome"])
    if row["invalid"]:
        names.append(INVALID)
    return names
