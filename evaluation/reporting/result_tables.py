"""Tables of measurements: every level as shared, after each attack, and linked."""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from functools import partial
from operator import itemgetter
from typing import Any, Final

import pandas as pd

from attacks.tasks.controls import CONTROLS
from evaluation.estimates.families import CLEAN, LEVEL_UNITS, families_in
from evaluation.estimates.keys import is_attack, row_dicts, row_worlds, where_text
from evaluation.estimates.linkability import INVALID, REMARKS, TaskOutcomes, remarks
from evaluation.estimates.metrics import (
    DESCRIPTORS,
    METRICS,
    MISSED_FUTURE,
    MISSED_RATE,
    PLR,
    RANK1,
    RANK1_AMONG_100,
    RECONSTRUCTION,
    UTILITY,
)
from evaluation.estimates.strongest import most_knowing
from evaluation.plan.address import AS_SHARED, Address, MechanismLevel, parse_consumer
from evaluation.plan.constants import ORACLE
from evaluation.plan.presets import IDENTITY, SHARED
from evaluation.reporting import table as make
from evaluation.reporting.amounts import PERCENT
from evaluation.reporting.lookups import find_family
from evaluation.reporting.notices import approximation
from evaluation.reporting.rows import (
    Results,
    estimates_by_level,
    mechanism_columns,
    reader_rows,
    representative_levels,
)
from evaluation.reporting.table import Cell, Column, Table
from evaluation.verdict.offers import WEAK
from isac_track.intervals import Estimate
from isac_track.linkability import LEVEL
from isac_track.mechanisms.protections import Laplace

PAPER_REPORTS: Final = 366  # Samples of a track of the paper.
REMARK_SIGNS = dict(zip(REMARKS, "~^!", strict=True))
"""By remark: the mark of a linkage cell that does not simply link."""
MEANING = {mark: REMARKS[remark] for remark, mark in REMARK_SIGNS.items()}
_SCORES_TELL = "1 - Cllr_min"
_USUAL = "informed"
_LABEL_WIDTH = 30
_FUTURE = (
    "Missed future: of conflicts in which nobody is inside the safety radius at step 0."
)
_ORACLE = (
    "The oracle is a reference. It has a column only for attacks that a weaker"
    " adversary cannot run."
)
_STILL = (
    "Standing still: constant_position, which expects nobody to move; each interval by"
    " itself."
)


def laplace_notes(rows: pd.DataFrame, *, n_reports: int = PAPER_REPORTS) -> list[str]:
    """Return the promise of planar Laplace noise at each level: per report, per track.

    A track has `n_reports` samples.
    """
    levels = rows.loc[rows["family"] == "laplace", "level"].dropna().unique()
    known = [Laplace(float(level)) for level in sorted(levels) if level > 0]
    return [
        f"{where_text('laplace', noise.std_m)}: epsilon {noise.epsilon_per_m:.2f} 1/m a"
        f" report, {noise.epsilon_over(n_reports):.0f} 1/m over {n_reports}."
        for noise in known
    ]


def sweep_tables(
    summary: pd.DataFrame, *, n_reports: int = PAPER_REPORTS
) -> list[Table]:
    """Return the tables of all levels, a table for each predictor.

    Descriptors as shared stand beside the first predictor. A track has `n_reports`
    samples on average.
    """
    # A control of linkage has neither.
    is_shown = summary["metric"].isin([*UTILITY, *DESCRIPTORS])
    rows = summary[is_shown & ~is_attack(summary)]
    predictors = list(rows.loc[rows["consumer"] != SHARED, "consumer"].unique())
    tables = [
        _sweep_table(rows, predictor, place, n_reports=n_reports)
        for place, predictor in enumerate(predictors or [SHARED])
    ]
    return [table for table in tables if table.rows]


def _sweep_table(
    rows: pd.DataFrame, predictor: str, place: int, *, n_reports: int
) -> Table:
    """Return utility of a predictor at all levels; at place 0 also descriptors."""
    metrics = {parse_consumer(predictor): UTILITY}
    if place == 0:
        metrics |= {AS_SHARED: DESCRIPTORS}
    rows = rows[rows["consumer"].isin([reader.consumer for reader in metrics])]
    measured = set(rows["metric"])
    columns = [
        Column(
            f"{METRICS[metric].head}{', shared' if reader == AS_SHARED else ''}",
            partial(_cell, reader, metric),
            METRICS[metric].unit,
        )
        for reader in metrics
        for metric in metrics[reader]
        if metric in measured
    ]
    name, title, notes = f"sweep-{place}", "All levels", list[str]()
    if place == 0:
        name, title = "sweep", "All levels as shared"
        units = "; ".join(f"{family}: {unit}" for family, unit in LEVEL_UNITS.items())
        notes = [f"Levels: {units}.", *laplace_notes(rows, n_reports=n_reports)]
    if predictor != SHARED:
        title += f", predictor {predictor}"
    return _level_table(name, title, rows, columns, notes=notes)


def horizon_tables(summary: pd.DataFrame) -> list[Table]:
    """Return missed conflicts of robots at every further horizon, a table each."""
    worlds, tables = row_worlds(summary), []
    for world in worlds.unique():
        if (horizon_s := world.horizon_s) is None:
            continue
        rows = summary[worlds == world]
        columns = [
            Column(
                f"{METRICS[metric].head}, {robot}",
                partial(_cell, parse_consumer(robot), metric),
                "%",
            )
            for robot in rows["consumer"].unique()
            for metric in (MISSED_RATE, MISSED_FUTURE, "false_alarm_rate")
        ]
        name = f"horizon-{horizon_s:g}s"
        title = f"Conflicts made for {horizon_s:g} s ahead"
        tables.append(_level_table(name, title, rows, columns, notes=[_FUTURE]))
    return tables


def standing_table(robots: Iterable[Mapping[str, Any]]) -> Table:
    """Return the levels where a robot surely misses more than standing still.

    `robots` are the records of `verdict.json`.
    """
    records = [
        {**level, "robot": record["robot"], "horizon_s": record["horizon_s"]}
        for record in robots
        for level in record["loses"]
    ]
    ends = ("difference", "ci_low", "ci_high")
    columns = [
        make.text_column("robot"),
        make.text_column("horizon", _horizon_text),
        make.text_column(
            "level", lambda row: where_text(row["mechanism"], row["level"])
        ),
        make.share_column("missed", "missed"),
        make.share_column("standing still", "standing_still"),
        make.share_column("more", *ends, unit="points", sign="+"),
    ]
    title = "Robots that miss more than standing still; 95 % intervals, paired"
    return make.build_table(
        "standing-still", title, records, columns, notes=[_STILL], n_keys=3
    )


def _horizon_text(row: Mapping[str, Any]) -> str:
    return "the run's own" if row["horizon_s"] is None else f"{row['horizon_s']:g} s"


def _level_table(
    name: str,
    title: str,
    rows: pd.DataFrame,
    columns: list[Column],
    *,
    notes: list[str],
) -> Table:
    records = [
        {"mechanism": mechanism, "level": level, "readers": readers}
        for (mechanism, level), readers in estimates_by_level(rows).items()
    ]
    columns = [*mechanism_columns(families_in(rows)), *columns]
    title = f"{title}; 95 % intervals"
    return make.build_table(
        name, title, records, columns, notes=notes, n_headings=2, n_keys=3
    )


def _cell(reader: Address, metric: str, level: Mapping[str, Any]) -> Cell:
    return make.estimate_cell(metric, level["readers"].get(reader, {}).get(metric))


def after_attack(summary: pd.DataFrame) -> pd.DataFrame:
    """Return descriptors as shared and after attacks; no rows without attacks."""
    is_attacked = is_attack(summary)
    is_shown = (is_attacked | (summary["consumer"] == SHARED)) & bool(is_attacked.any())
    rows = summary[is_shown & summary["metric"].isin(RECONSTRUCTION)]
    return rows.assign(knowledge=rows["knowledge"].where(is_attack(rows), ""))


def list_readers(rows: pd.DataFrame) -> list[Address]:
    """Return the readers of positions in some rows, in the order of the run."""
    first = rows[["consumer", "knowledge"]].drop_duplicates()
    return [parse_consumer(*pair) for pair in first.itertuples(index=False)]


def exposure_table(summary: pd.DataFrame, *, slow: Collection[str] = ()) -> Table:
    """Return PLR as shared and after each attack.

    A note names the `slow` attacks: they saw only part of the releases.
    """
    rows = after_attack(summary)
    rows = rows[rows["metric"] == PLR]
    shown = most_knowing(list_readers(rows))
    columns = [Column(reader.label, partial(_cell, reader, PLR)) for reader in shown]
    notes = []
    if any(reader.adversary == ORACLE for reader in shown):
        notes.append(_ORACLE)
    notes += [
        f"{reader.consumer} saw only the first release of each source track."
        for reader in shown
        if reader.consumer in slow
    ]
    title = "After attack: PLR in % at all levels"
    rows = rows if len(shown) > 1 else rows[:0]
    return _level_table("exposure", title, rows, columns, notes=notes)


def attack_table(summary: pd.DataFrame, *, only: Address | None = None) -> Table:
    """Return descriptors after all attacks at representative levels.

    With `only` they are those of a single reader, at all levels.
    """
    rows = after_attack(summary)
    if only is not None:
        rows = reader_rows(rows, only)
    known, blocks = families_in(rows), estimates_by_level(rows)
    if only is None:
        title = "After attack, every adversary"
        levels = representative_levels(blocks, known)
    else:
        title = f"After {only.label}"
        levels = list(blocks)
    if only == AS_SHARED:
        title = "As shared"
    records = [row for where in levels for row in _merged(*where, blocks[where])]
    # A metric that every level refuses, such as the worst tenth of few people, has no
    # column.
    measured = [
        name for name in RECONSTRUCTION if any(row[name].text for row in records)
    ]
    columns = [
        *mechanism_columns(known),
        make.text_column("positions"),
        make.text_column("adversary"),
    ]
    columns += [
        make.cell_column(METRICS[name].head, name, unit=METRICS[name].unit)
        for name in measured
    ]
    title = f"{title}; 95 % intervals"
    return make.build_table("attacks", title, records, columns, n_headings=3, n_keys=5)


def _merged(
    mechanism: str, level: float | None, readers: Mapping[Address, Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Return the rows of a level; adversaries with the same numbers share a row."""
    cells = {
        reader: {
            metric: make.estimate_cell(metric, estimates.get(metric))
            for metric in RECONSTRUCTION
        }
        for reader, estimates in readers.items()
    }
    consumers = [reader.consumer for reader in readers]
    shared = cells.get(AS_SHARED, {})
    groups: dict[tuple[str, tuple[str, ...]], list[Address]] = {}
    for reader, own in cells.items():
        # Only an attack has a ratio to the benchmark. A control that says the same is
        # left out.
        is_same = all(
            own[metric].text == cell.text
            for metric, cell in shared.items()
            if cell.text
        )
        if reader.consumer != IDENTITY or not (shared and is_same):
            key = reader.consumer, tuple(cell.full for cell in own.values())
            groups.setdefault(key, []).append(reader)
    rows = []
    for (consumer, _), members in groups.items():
        knowledge = [reader.adversary for reader in members]
        is_any = len(members) == consumers.count(consumer) > 1
        row: dict[str, Any] = {"mechanism": mechanism, "level": level}
        row |= cells[members[0]]
        row["positions"] = "as shared" if knowledge == [""] else consumer
        row["adversary"] = "any" if is_any else ", ".join(knowledge)
        rows.append(row)
    return rows


def rank_table(run: Results, task: TaskOutcomes) -> Table:
    """Return rank 1 of the attacks of a task, a row each, at representative levels."""
    known = run.families
    levels = representative_levels(task.cells, known, controls=False)
    columns = [make.text_column("attack", itemgetter(0))]
    for place, (mechanism, level) in enumerate(levels, start=1):
        family = find_family(known, mechanism)
        heading = where_text(family.name, level)
        columns.append(Column(heading, itemgetter(place), above=family.adding))
    records = list[list[Any]]()
    for reader in task.attacks:
        label = reader.label.removesuffix(f" ({_USUAL})")
        label = make.shorten_name(label, room=_LABEL_WIDTH)
        cells = [_rank(task.cells[where].get(reader)) for where in levels]
        records.append([label, *cells])
    first_rows = [next(iter(task.cells[where].values())) for where in levels]
    chances = [make.metric_cell(RANK1, row["chance"]) for row in first_rows]
    records.append(["chance", *chances])
    tasks = (run.manifest.get("linkage") or {}).get("tasks", {})
    people = tasks.get(task.name, {}).get("people")
    notes = [
        _people_note(first_rows[0], people),
        approximation(run.manifest, task.name),
        *_control_notes(task),
        "Cells without a mark link people, by the ranks of all mates.",
    ]
    if MechanismLevel(CLEAN) in levels:
        notes.append("clean: no error at all, an upper limit.")
    return make.build_table(
        f"linkage-{task.name}",
        f"{task.name}: {task.about}; rank 1 in %, 95 % intervals",
        records,
        columns,
        notes=[note for note in notes if note],
        marks=MEANING,
    )


def _people_note(row: Mapping[str, Any], people: int | None) -> str:
    """Return the number of people of a task, and the sizes of its galleries."""
    low, high = int(row["gallery_min"]), int(row["gallery_max"])
    size = (
        f"{low}" if low == high else f"{low} to {high} (mean {row['gallery_mean']:.1f})"
    )
    n_probes, n_mated = int(row["n_probes"]), int(row["n_mated"])
    mated = f"all {n_probes}" if n_probes == n_mated else f"{n_mated} of {n_probes}"
    start = "" if people is None else f"{people} people; "
    return (
        f"{start}{mated} releases have a mate among {size} candidates. The adversary is"
        f" {_USUAL} unless another is named."
    )


def _control_notes(task: TaskOutcomes) -> list[str]:
    """Return how many controls link people, and which shortcuts tell people apart."""
    tests = control_tests(task)
    outcomes = [is_linked for control in tests.values() for is_linked in control]
    texts = []
    if outcomes:
        worst = [
            f"{name} {sum(control)} of {len(control)}"
            for name, control in tests.items()
            if 2 * sum(control) > len(control)
        ]
        expected = f"{LEVEL * len(outcomes):.1f} expected"
        texts.append(
            f"Controls: {sum(outcomes)} of {len(outcomes)} beat chance at"
            f" {PERCENT * LEVEL:g} % ({'; '.join([expected, *worst])})."
        )
    cells = (
        ",".join(row[INVALID] for row in block.values())
        for block in task.cells.values()
    )
    leaks = Counter(name for text in cells for name in {*re.split(", *", text)} if name)
    shortcuts = [
        f"{name} at {n} of {len(task.cells)} levels"
        for name, n in sorted(leaks.items())
    ]
    if outcomes or shortcuts:
        listed = ", ".join(shortcuts) or "none"
        texts.append(f"Shortcuts that give people away: {listed}.")
    return texts


def strength_table(run: Results) -> Table:
    """Return ranks and scores of each task's headline linker at a few levels."""
    records: list[dict[str, Any]] = []
    for task, attack in run.strongest.items():
        if not task:
            continue
        reader = replace(attack, task=task)
        by_level = estimates_by_level(reader_rows(run.ours, reader))
        for where in representative_levels(by_level, run.families, controls=False):
            row = _strength_cells(by_level[where][reader])
            row |= {"mechanism": where.mechanism, "level": where.level}
            records.append(row | {"task": task, "linker": attack.label})
    columns = [
        make.text_column("task"),
        make.text_column("linker"),
        *mechanism_columns(run.families),
    ]
    columns += [
        make.cell_column(METRICS[metric].head, metric, unit="%")
        for metric in (RANK1, RANK1_AMONG_100, "chance")
    ]
    columns.append(make.cell_column(_SCORES_TELL, unit=METRICS["cllr_min"].unit))
    return make.build_table(
        "strength",
        "What the headline linker of each task tells, by ranks and by scores; 95 %"
        " intervals",
        records,
        columns,
        notes=[
            (
                "1 - Cllr_min: what its scores tell of a pair at best, 0 nothing, 1 bit"
                " all."
            ),
            "Rank 1 of 100 is empty with fewer candidates.",
        ],
        n_headings=2,
        n_keys=5,
    )


def _strength_cells(estimates: Mapping[str, Estimate]) -> dict[str, Any]:
    """Return the cells of a linker at a level, by metric."""
    cells: dict[str, Any] = {
        metric: make.estimate_cell(metric, estimates.get(metric))
        for metric in (RANK1, RANK1_AMONG_100)
    }
    if lost := estimates.get("cllr_min"):
        values = 1.0 - lost.value, 1.0 - lost.ci_high, 1.0 - lost.ci_low
        cells[_SCORES_TELL] = make.metric_cell("cllr_min", *values)
    cells["chance"] = make.metric_cell("chance", estimates["chance"].value)
    return cells


def doubt_table(run: Results) -> Table:
    """Return the linkage cells that measure nothing: invalid cells and weak attacks."""
    rows = run.linkability[run.linkability["cohort"] == "all"]
    texts = rows[["knowledge", "outcome", "invalid"]].astype(object).fillna("")
    rows = rows.assign(**texts)
    is_doubtful = (rows["invalid"] != "") | (rows["outcome"] == WEAK)
    rows = rows[(rows["knowledge"] != "") & is_doubtful]

    def reason(row: Mapping[str, Any]) -> str:
        name = row["invalid"]
        return f"invalid: {name} tells people apart" if name else REMARKS[WEAK]

    columns = [
        make.text_column("task/attack", "consumer"),
        make.text_column("adversary", "knowledge"),
        *mechanism_columns(run.families),
        make.text_column("why", reason),
    ]
    title = "Linkage cells that measure nothing"
    return make.build_table("doubts", title, row_dicts(rows), columns, n_keys=5)


def _rank(row: Mapping[str, Any] | None) -> Cell:
    """Return rank 1 of a linkage cell with its marks; empty without a cell."""
    if row is None:
        return Cell()
    mark = "".join(REMARK_SIGNS[remark] for remark in remarks(row))
    return make.metric_cell(
        RANK1, row["rank1"], row["ci_low"], row["ci_high"], mark=mark
    )


def control_tests(task: TaskOutcomes) -> dict[str, list[bool]]:
    """Return whether each control beats chance, at the levels where that may differ."""
    tests: dict[str, list[bool]] = {}
    for row in task.controls:
        name = parse_consumer(row["consumer"]).control
        outcomes = tests.setdefault(name, [])
        # A control that sees only times gives the same result at every level.
        if not (outcomes and name in CONTROLS and CONTROLS[name].sees_times_only):
            outcomes.append(row["p_value"] <= LEVEL)
    return tests
