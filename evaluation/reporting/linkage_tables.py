"""Tables of linkage: who links at the levels that tell, task by task, and what is to be doubted."""

from __future__ import annotations

from collections import Counter
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from attacks.tasks.controls import CONTROLS
from evaluation.analysis.families import CLEAN
from evaluation.analysis.keys import level_text
from evaluation.analysis.linkability import INVALID, REMARKS, remarks
from evaluation.analysis.metrics import SUCCESS
from evaluation.cells.link_scores import WITHOUT_FROZEN, WITHOUT_GROUPS
from evaluation.reporting.rows import family_of, mechanism_columns, telling
from evaluation.reporting.table import (
    Cell,
    Column,
    amount,
    built,
    counted,
    measured,
    said,
    shortened,
)
from isac_track.linkability import LEVEL

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from evaluation.analysis.families import Family
    from evaluation.analysis.keys import Where
    from evaluation.analysis.linkability import LinkedTask
    from evaluation.reporting.rows import Results
    from evaluation.reporting.table import Table

MARKS = dict(zip(REMARKS, "~?!", strict=True))
"""Of what is to be said of a cell that does not simply link."""
MEANING = {mark: REMARKS[remark] for remark, mark in MARKS.items()}
TOO_WEAK = "attack too weak"
_USUAL = "informed"
_COHORTS = {WITHOUT_GROUPS: "walking groups", WITHOUT_FROZEN: "frozen annotations"}
_LABEL_WIDTH = 30


def rank_table(run: Results, task: LinkedTask) -> Table:
    """Return rank 1 of the attacks of a task, a row each, at the levels that tell."""
    known = run.families
    wheres = telling(task.cells, known, controls=False)
    columns = [said("attack", itemgetter(0))]
    for place, (name, at) in enumerate(wheres, start=1):
        one = family_of(known, name)
        # A level of the default rule keeps its interval longest.
        weight = 2.0 * (one.adding != "independent") + (at is not None)
        heading = f"{one.name} {level_text(at)}".rstrip()
        columns.append(Column(heading, itemgetter(place), above=one.adding, weight=weight))
    records: list[list[Any]] = [
        [
            shortened(source.label.removesuffix(f" ({_USUAL})"), room=_LABEL_WIDTH),
            *(_rank(task.cells[where].get(source)) for where in wheres),
        ]
        for source in task.attacks
    ]
    some = [next(iter(task.cells[where].values())) for where in wheres]
    records.append(["chance", *(amount(SUCCESS, row["chance"]) for row in some)])
    about = "Unmarked cells link, by the ranks of all mates."
    if (CLEAN, None) in wheres:
        about += " clean: no error at all, the ceiling."
    people = (run.manifest.get("linkage") or {}).get("tasks", {}).get(task.name, {}).get("people")
    notes = _size(some[0], people=people), _confounders(task, wheres, known), _controls(task), about
    title = f"{_title(task)}; rank 1 in %, 95 % intervals"
    options = {"notes": list(filter(None, notes)), "marks": MEANING}
    return built(f"linkage-{task.name}", title, records, columns, **options)


def cells_table(run: Results, task: LinkedTask) -> Table:
    """Return every attack and adversary of a task at the levels that tell, a row each."""
    records = [
        {**row, "attack": source.consumer}
        for where in telling(task.cells, run.families)
        for source, row in task.cells[where].items()
    ]
    columns = [
        *mechanism_columns(run.families),
        said("attack"),
        said("adversary", "knowledge"),
        measured("rank 1", "rank1", "ci_low", "ci_high", metric=SUCCESS),
        measured("chance", "chance", metric=SUCCESS),
        said("outcome"),
        said("shortcut", "invalid"),
        counted("candidates", "", "gallery_mean", digits=0),
        counted("people", "", "n_clusters", digits=0),
    ]
    title = f"{_title(task)}, every adversary; 95 % intervals"
    return built(f"cells-{task.name}", title, records, columns, n_headings=3, n_keys=5)


def doubt_table(run: Results) -> Table:
    """Return the linkage cells that measure nothing: invalid ones, and too weak attacks."""
    of = run.linkability[run.linkability["cohort"] == "all"]
    of = of.assign(**of[["knowledge", "outcome", "invalid"]].astype(object).fillna(""))
    of = of[(of["knowledge"] != "") & ((of["invalid"] != "") | (of["outcome"] == TOO_WEAK))]

    def why(row: Mapping[str, Any]) -> str:
        shortcut = row["invalid"] and f"invalid: {row['invalid']} tells people apart"
        return shortcut or REMARKS[TOO_WEAK]

    columns = [
        said("task/attack", "consumer"),
        said("adversary", "knowledge"),
        *mechanism_columns(run.families),
        said("why", why),
    ]
    title = "Linkage cells that measure nothing"
    return built("doubts", title, of.to_dict("records"), columns, n_keys=5)


def _title(task: LinkedTask) -> str:
    return f"{task.name}: {task.about}" if task.about else task.name


def _rank(row: Mapping[str, Any] | None) -> Cell:
    if row is None:
        return Cell()
    mark = "".join(MARKS[one] for one in remarks(row))
    return amount(SUCCESS, row["rank1"], row["ci_low"], row["ci_high"], mark=mark)


def _size(row: Mapping[str, Any], *, people: int | None) -> str:
    """Return how many people and candidates there are."""
    low, high, probes, mated = (
        int(row[key]) for key in ("gallery_min", "gallery_max", "n_probes", "n_mated")
    )
    candidates = str(low) if low == high else f"{low} to {high} (mean {row['gallery_mean']:.1f})"
    who = "" if people is None else f"{people} people; "
    return (
        f"{who}{'all' if probes == mated else f'{mated} of'} {probes} releases have a mate among "
        f"{candidates} candidates. The adversary is {_USUAL} where none is named."
    )


def _confounders(task: LinkedTask, wheres: Sequence[Where], known: Mapping[str, Family]) -> str:
    """Return what the best attack of one level links without each confounder."""
    # A level of the mechanisms under test before raw and the ceiling.
    for where in sorted(wheres, key=lambda where: where[1] is None):
        block = task.cells[where]
        ran = [one for one in task.attacks if one in block and block[one]["rank1"] >= 0]
        best = max(ran, key=lambda one: block[one]["rank1"], default=None)
        if best is None:
            continue
        parts = [
            f"without {what} {_against_chance(cohort)}"
            for name, what in _COHORTS.items()
            if (cohort := task.cohorts.get(name, {}).get(where, {}).get(best)) is not None
        ]
        if parts:
            one = family_of(known, where[0])
            rule = f" ({one.adding})" if one.adding == "independent" else ""
            place = f"{one.name} {level_text(where[1])}".rstrip()
            value = _against_chance(block[best], before="chance ")
            return f"{place}{rule}, {best.consumer}: {value}; {', '.join(parts)}"
    return ""


def _against_chance(row: Mapping[str, Any], *, before: str = "") -> str:
    value, chance = (amount(SUCCESS, row[key]).text or "-" for key in ("rank1", "chance"))
    return f"{value} ({before}{chance})"


def _controls(task: LinkedTask) -> str:
    """Return how many controls beat chance, and which audits leak at how many levels."""
    tests: dict[str, list[bool]] = {}
    for row in task.controls:
        name = row["consumer"].partition("/control-")[2]
        found = tests.setdefault(name, [])
        # One that only sees times says the same at every level.
        if not (found and name in CONTROLS and CONTROLS[name].sees_times_only):
            found.append(row["p_value"] <= LEVEL)
    every = [one for found in tests.values() for one in found]
    often = [
        f"{name} {sum(found)} of {len(found)}"
        for name, found in tests.items()
        if sum(found) > len(found) / 2
    ]
    told = "; ".join([f"{LEVEL * len(every):.1f} expected", *often])
    count = f"{sum(every)} of {len(every)}"
    parts = [f"controls: {count} beat chance at {100 * LEVEL:g} % ({told})"] * bool(tests)
    leaks: Counter[str] = Counter()
    for block in task.cells.values():
        names = {name for row in block.values() for name in row[INVALID].split(", ") if name}
        leaks.update(sorted(names))
    leaky = [f"{name} at {count} of {len(task.cells)} levels" for name, count in leaks.items()]
    if leaky or tests:
        parts.append(f"audits that leak: {', '.join(leaky) or 'none'}")
    return "; ".join(parts)
