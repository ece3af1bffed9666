"""Tables of linkage: who links at the levels that tell, task by task, and what is to be doubted."""

from __future__ import annotations

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
    table,
    word,
    words,
)
from evaluation.reporting.texts import shortened
from isac_track.linkability import LEVEL

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas as pd

    from evaluation.analysis.families import Family
    from evaluation.analysis.keys import Source, Where
    from evaluation.analysis.linkability import LinkedTask
    from evaluation.reporting.table import Table

MARKS = dict(zip(REMARKS, "~?!", strict=True))
"""Of what is to be said of a cell that does not simply link."""
_MEANING = {mark: REMARKS[remark] for remark, mark in MARKS.items()}
TOO_WEAK = "attack too weak"
_USUAL = "informed"
_COHORTS = {WITHOUT_GROUPS: "walking groups", WITHOUT_FROZEN: "frozen annotations"}
_LABEL_WIDTH = 30


def rank_table(
    task: LinkedTask, known: Mapping[str, Family], *, people: int | None = None
) -> Table:
    """Return rank 1 of the attacks of a task, a row each, at the levels that tell.

    Parameters
    ----------
    task : LinkedTask
    known : mapping
        The mechanisms of the run.
    people : int, optional
        How many are linked.
    """
    wheres = telling(task.cells, known, controls=False)
    families = [family_of(known, name) for name, _ in wheres]
    columns = [
        Column(
            f"{one.name} {level_text(at)}".rstrip(),
            above=one.adding,
            # A level of the default rule keeps its interval longest.
            weight=2.0 * (one.adding != "independent") + (at is not None),
        )
        for one, (_, at) in zip(families, wheres, strict=True)
    ]
    cells = [
        [
            word(shortened(_label(source), room=_LABEL_WIDTH)),
            *(_rank(task.cells[where].get(source)) for where in wheres),
        ]
        for source in task.attacks
    ]
    some = [next(iter(task.cells[where].values())) for where in wheres]
    cells.append([word("chance"), *(amount(SUCCESS, row["chance"]) for row in some)])
    notes = [_size(some[0], people=people), _confounders(task, wheres, known), _controls(task)]
    notes.append("Unmarked cells link, by the ranks of all mates.")
    if (CLEAN, None) in wheres:
        notes[-1] += " clean: no error at all, the ceiling."
    return table(
        f"linkage-{task.name}",
        f"{_title(task)}; rank 1 in %, 95 % intervals",
        [*words("attack"), *columns],
        cells,
        notes=list(filter(None, notes)),
        marks=_MEANING,
    )


def cells_table(task: LinkedTask, known: Mapping[str, Family]) -> Table:
    """Return every attack and adversary of a task at the levels that tell, a row each."""
    return built(
        f"cells-{task.name}",
        f"{_title(task)}, every adversary; 95 % intervals",
        [
            {**row, "attack": source.consumer}
            for where in telling(task.cells, known)
            for source, row in task.cells[where].items()
        ],
        [
            *mechanism_columns(known),
            said("attack"),
            said("adversary", "knowledge"),
            measured("rank 1", "rank1", "ci_low", "ci_high", metric=SUCCESS),
            measured("chance", "chance", metric=SUCCESS),
            said("outcome"),
            said("shortcut", "invalid"),
            counted("candidates", "", "gallery_mean", digits=0),
            counted("people", "", "n_clusters", digits=0),
        ],
        n_headings=3,
        n_keys=5,
    )


def doubt_table(linkability: pd.DataFrame, known: Mapping[str, Family]) -> Table:
    """Return the linkage cells that measure nothing: invalid ones, and too weak attacks."""
    of = linkability[linkability["cohort"] == "all"]
    of = of.assign(**of[["knowledge", "outcome", "invalid"]].astype(object).fillna(""))
    of = of[(of["knowledge"] != "") & ((of["invalid"] != "") | (of["outcome"] == TOO_WEAK))]
    return built(
        "doubts",
        "Linkage cells that measure nothing",
        of.to_dict("records"),
        [
            said("task/attack", "consumer"),
            said("adversary", "knowledge"),
            *mechanism_columns(known),
            said(
                "why",
                lambda row: (
                    f"invalid: {row['invalid']} tells people apart"
                    if row["invalid"]
                    else REMARKS[TOO_WEAK]
                ),
            ),
        ],
        n_keys=5,
    )


def _title(task: LinkedTask) -> str:
    return f"{task.name}: {task.about}" if task.about else task.name


def _label(source: Source) -> str:
    return source.consumer if source.knowledge == _USUAL else source.label


def _rank(row: Mapping[str, Any] | None) -> Cell:
    if row is None:
        return Cell()
    mark = "".join(MARKS[one] for one in remarks(row))
    return amount(SUCCESS, row["rank1"], row["ci_low"], row["ci_high"], mark=mark)


def _size(row: Mapping[str, Any], *, people: int | None) -> str:
    """Return how many people and candidates there are."""
    low, high = int(row["gallery_min"]), int(row["gallery_max"])
    candidates = str(low) if low == high else f"{low} to {high} (mean {row['gallery_mean']:.1f})"
    who = "" if people is None else f"{people} people; "
    probes, mated = int(row["n_probes"]), int(row["n_mated"])
    among = f"all {probes}" if probes == mated else f"{mated} of {probes}"
    return (
        f"{who}{among} releases have a mate among {candidates} candidates. The adversary is "
        f"{_USUAL} where none is named."
    )


def _confounders(task: LinkedTask, wheres: Sequence[Where], known: Mapping[str, Family]) -> str:
    """Return what the best attack of one level links without each confounder."""
    # A level of the mechanisms under test before raw and the ceiling.
    for where in sorted(wheres, key=lambda where: where[1] is None):
        rows = {
            source: row
            for source in task.attacks
            if (row := task.cells[where].get(source)) is not None and row["rank1"] >= 0
        }
        if not rows:
            continue
        best = max(rows, key=lambda source: rows[source]["rank1"])
        parts = [
            f"without {what} {_against_chance(cohort)}"
            for name, what in _COHORTS.items()
            if (cohort := task.cohorts.get(name, {}).get(where, {}).get(best)) is not None
        ]
        if parts:
            one = family_of(known, where[0])
            rule = f" ({one.adding})" if one.adding == "independent" else ""
            place = f"{one.name} {level_text(where[1])}".rstrip()
            value = _against_chance(rows[best], before="chance ")
            return f"{place}{rule}, {best.consumer}: {value}; {', '.join(parts)}"
    return ""


def _against_chance(row: Mapping[str, Any], *, before: str = "") -> str:
    value, chance = (amount(SUCCESS, row[key]).text or "-" for key in ("rank1", "chance"))
    return f"{value} ({before}{chance})"


def _controls(task: LinkedTask) -> str:
    """Return how many controls beat chance, and which audits leak at how many levels."""
    tests: dict[str, list[float]] = {}
    for row in task.controls:
        name = row["consumer"].partition("/control-")[2]
        p_values = tests.setdefault(name, [])
        # One that only sees times says the same at every level.
        if not (p_values and name in CONTROLS and CONTROLS[name].sees_times_only):
            p_values.append(row["p_value"])
    beaten = {name: sum(p <= LEVEL for p in p_values) for name, p_values in tests.items()}
    often = [
        f"{name} {count} of {len(tests[name])}"
        for name, count in beaten.items()
        if count > len(tests[name]) / 2
    ]
    parts = []
    if tests:
        n_tests = sum(map(len, tests.values()))
        told = "; ".join([f"{LEVEL * n_tests:.1f} expected", *often])
        count = f"{sum(beaten.values())} of {n_tests}"
        parts.append(f"controls: {count} beat chance at {100 * LEVEL:g} % ({told})")
    leaks: dict[str, int] = {}
    for block in task.cells.values():
        names = {row[INVALID] for row in block.values() if row[INVALID]}
        for name in sorted({part for one in names for part in one.split(", ")}):
            leaks[name] = leaks.get(name, 0) + 1
    leaky = [f"{name} at {count} of {len(task.cells)} levels" for name, count in leaks.items()]
    if leaky or tests:
        parts.append(f"audits that leak: {', '.join(leaky) or 'none'}")
    return "; ".join(parts)
