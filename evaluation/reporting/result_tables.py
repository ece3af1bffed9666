"""Tables of what was measured: every level as shared, after each attack, and linked."""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from functools import partial
from operator import itemgetter
from typing import Any, Final

import pandas as pd

from attacks.tasks.controls import CONTROLS
from evaluation.estimates.families import CLEAN, LEVEL_UNITS, families_in
from evaluation.estimates.keys import (
    AS_SHARED,
    Source,
    is_attack,
    rows_of,
    where_text,
    worlds_of,
)
from evaluation.estimates.linkability import INVALID, REMARKS, LinkedTask, remarks
from evaluation.estimates.metrics import (
    DESCRIPTORS,
    EXPOSURE,
    METRICS,
    MISSED_FUTURE,
    MISSED_RATE,
    RECONSTRUCTION,
    SUCCESS,
    SUCCESS_OF_100,
    UTILITY,
)
from evaluation.estimates.strongest import most_knowing
from evaluation.plan.constants import ORACLE, horizon_of
from evaluation.plan.presets import IDENTITY, SHARED
from evaluation.reporting import rows as picked
from evaluation.reporting import table as make
from evaluation.reporting.lookups import family_of
from evaluation.reporting.notices import approximation
from evaluation.reporting.table import Cell, Column, Table
from isac_track.linkability import LEVEL
from isac_track.mechanisms.protections import Laplace

PAPER_REPORTS: Final = 366  # Of a track of the paper.
MARKS = dict(zip(REMARKS, "~^!", strict=True))
"""Of what is to be said of a cell that does not simply link."""
MEANING = {mark: REMARKS[remark] for remark, mark in MARKS.items()}
TOO_WEAK = "attack too weak"
_USUAL = "informed"
_LABEL_WIDTH = 30
_FUTURE = (
    "Missed future: of conflicts in which nobody is inside the safety radius at step 0."
)
_STILL = (
    "Standing still: constant_position, which expects nobody to move; each interval by"
    " itself."
)


def laplace_notes(rows: pd.DataFrame, *, n_reports: int = PAPER_REPORTS) -> list[str]:
    """Return what planar Laplace noise promises at each of its levels: a report, and a track.

    A track has `n_reports` samples.
    """
    levels = rows.loc[rows["family"] == "laplace", "level"].dropna().unique()
    known = [Laplace(float(level)) for level in sorted(levels) if level > 0]
    return [
        f"{where_text('laplace', one.std_m)}: epsilon {one.epsilon_per_m:.2f} 1/m a"
        f" report, {one.epsilon_over(n_reports):.0f} 1/m over {n_reports}."
        for one in known
    ]


def sweep_tables(
    summary: pd.DataFrame, *, n_reports: int = PAPER_REPORTS
) -> list[Table]:
    """Return every level: descriptors as shared with the first predictor, then the others'.

    A track has `n_reports` samples on average.
    """
    is_shown = summary["metric"].isin(
        [*UTILITY, *DESCRIPTORS]
    )  # a control of linkage has neither
    others = summary[is_shown & ~is_attack(summary)]
    predictors = list(others.loc[others["consumer"] != SHARED, "consumer"].unique())
    found = []
    for place, predictor in enumerate(predictors or [SHARED]):
        # As shared stands beside the first.
        drawn = {Source(predictor): UTILITY} | (
            {} if place else {AS_SHARED: DESCRIPTORS}
        )
        rows = others[others["consumer"].isin([one.consumer for one in drawn])]
        columns = [
            Column(
                f"{METRICS[metric].head}{', shared' * (one == AS_SHARED)}",
                partial(_cell, one, metric),
                METRICS[metric].unit,
            )
            for one, metrics in drawn.items()
            for metric in metrics
            if (rows["metric"] == metric).any()
        ]
        name, title = (f"sweep-{place}", "") if place else ("sweep", " as shared")
        title += f", predictor {predictor}" if predictor != SHARED else ""
        units = "; ".join(f"{family}: {unit}" for family, unit in LEVEL_UNITS.items())
        notes = (
            []
            if place
            else [f"Levels: {units}.", *laplace_notes(rows, n_reports=n_reports)]
        )
        found.append(_by_level(name, f"All levels{title}", rows, columns, notes=notes))
    return [one for one in found if one.rows]


def horizon_tables(summary: pd.DataFrame) -> list[Table]:
    """Return what robots miss at every further horizon, a table each."""
    worlds, tables = worlds_of(summary), []
    for world in worlds.unique():
        if (horizon_s := horizon_of(world)) is None:
            continue
        rows = summary[worlds == world]
        columns = [
            Column(
                f"{METRICS[metric].head}, {robot}",
                partial(_cell, Source(robot), metric),
                "%",
            )
            for robot in rows["consumer"].unique()
            for metric in (MISSED_RATE, MISSED_FUTURE, "false_alarm_rate")
        ]
        name, title = (
            f"horizon-{horizon_s:g}s",
            f"Conflicts made for {horizon_s:g} s ahead",
        )
        tables.append(_by_level(name, title, rows, columns, notes=[_FUTURE]))
    return tables


def standing_table(robots: Iterable[Mapping[str, Any]]) -> Table:
    """Return where a robot surely misses more than standing still, as `verdict.json` has it."""
    records = [
        {**level, "robot": record["robot"], "horizon_s": record["horizon_s"]}
        for record in robots
        for level in record["loses"]
    ]
    ends = ("difference", "ci_low", "ci_high")
    columns = [
        make.said("robot"),
        make.said("horizon", _horizon_text),
        make.said("level", lambda row: where_text(row["mechanism"], row["level"])),
        make.counted("missed", "%", "missed", scale=100.0, digits=1),
        make.counted("standing still", "%", "standing_still", scale=100.0, digits=1),
        make.counted("more", "points", *ends, scale=100.0, digits=1, sign="+"),
    ]
    title = "Robots that miss more than standing still; 95 % intervals, paired"
    return make.built(
        "standing-still", title, records, columns, notes=[_STILL], n_keys=3
    )


def _horizon_text(row: Mapping[str, Any]) -> str:
    return "the run's own" if row["horizon_s"] is None else f"{row['horizon_s']:g} s"


def _by_level(
    name: str,
    title: str,
    rows: pd.DataFrame,
    columns: list[Column],
    *,
    notes: list[str],
) -> Table:
    records = [
        {"mechanism": mechanism, "level": at, "of": of}
        for (mechanism, at), of in picked.by_level(rows).items()
    ]
    columns = [*picked.mechanism_columns(families_in(rows)), *columns]
    title = f"{title}; 95 % intervals"
    return make.built(
        name, title, records, columns, notes=notes, n_headings=2, n_keys=3
    )


def _cell(source: Source, metric: str, level: Mapping[str, Any]) -> Cell:
    return make.estimated(metric, level["of"].get(source, {}).get(metric))


def after_attack(summary: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of descriptors as shared and after attacks; none without attacks."""
    is_attacked = is_attack(summary)
    is_shown = (is_attacked | (summary["consumer"] == SHARED)) & bool(is_attacked.any())
    rows = summary[is_shown & summary["metric"].isin(RECONSTRUCTION)]
    return rows.assign(knowledge=rows["knowledge"].where(is_attack(rows), ""))


def sources_of(rows: pd.DataFrame) -> list[Source]:
    """Return whose positions the rows are of, in the order of the run."""
    first = rows[["consumer", "knowledge"]].drop_duplicates()
    return [Source(*one) for one in first.itertuples(index=False)]


def exposure_table(summary: pd.DataFrame, *, slow: Collection[str] = ()) -> Table:
    """Return PLR as shared and after each attack; a note tells which are `slow` and saw less."""
    rows = after_attack(summary)
    rows = rows[rows["metric"] == EXPOSURE]
    shown = most_knowing(sources_of(rows))
    columns = [
        Column(source.label, partial(_cell, source, EXPOSURE)) for source in shown
    ]
    oracle = (
        "The oracle is a reference: it stands where nobody less can run the attack."
    )
    notes = [oracle] * any(source.knowledge == ORACLE for source in shown)
    ran = [source.consumer for source in shown if source.consumer in slow]
    notes += [
        f"{name} saw only the first release of each source track." for name in ran
    ]
    title = "After attack: PLR in % at all levels"
    return _by_level(
        "exposure", title, rows if len(shown) > 1 else rows[:0], columns, notes=notes
    )


def attack_table(summary: pd.DataFrame, *, only: Source | None = None) -> Table:
    """Return what all attacks and adversaries leave, at levels that tell; or `only` one, at all."""
    rows = after_attack(summary)
    rows = rows if only is None else picked.of_source(rows, only)
    known, blocks = families_in(rows), picked.by_level(rows)
    title = "After attack, every adversary" if only is None else f"After {only.label}"
    title = "As shared" if only == AS_SHARED else title
    wheres = picked.telling(blocks, known) if only is None else blocks
    told = [row for where in wheres for row in _merged(*where, blocks[where])]
    # What every level refuses, such as the worst tenth of few people, has no column.
    measured = [name for name in RECONSTRUCTION if any(row[name].text for row in told)]
    columns = [
        *picked.mechanism_columns(known),
        *map(make.said, ("positions", "adversary")),
        *(
            make.held(METRICS[name].head, name, unit=METRICS[name].unit)
            for name in measured
        ),
    ]
    return make.built(
        "attacks", f"{title}; 95 % intervals", told, columns, n_headings=3, n_keys=5
    )


def _merged(
    name: str, at: float | None, found: Mapping[Source, Any]
) -> list[dict[str, Any]]:
    """Return the rows of a level; one for adversaries whose numbers are the same."""
    cells = {
        source: {one: make.estimated(one, of.get(one)) for one in RECONSTRUCTION}
        for source, of in found.items()
    }
    consumers = [source.consumer for source in found]
    shared = cells.get(AS_SHARED, {})
    groups: dict[tuple[str, tuple[str, ...]], list[Source]] = {}
    for source, of in cells.items():
        # Only an attack has a ratio to the benchmark. A control that says the same is
        # left out.
        is_same = all(
            of[one].text == cell.text for one, cell in shared.items() if cell.text
        )
        if source.consumer != IDENTITY or not (shared and is_same):
            key = source.consumer, tuple(cell.full for cell in of.values())
            groups.setdefault(key, []).append(source)
    rows = []
    for (consumer, _), sources in groups.items():
        knows = [source.knowledge for source in sources]
        is_any = len(sources) == consumers.count(consumer) > 1
        row: dict[str, Any] = {"mechanism": name, "level": at, **cells[sources[0]]}
        row["positions"] = "as shared" if knows == [""] else consumer
        row["adversary"] = "any" if is_any else ", ".join(knows)
        rows.append(row)
    return rows


def rank_table(run: picked.Results, task: LinkedTask) -> Table:
    """Return rank 1 of the attacks of a task, a row each, at the levels that tell."""
    known = run.families
    wheres = picked.telling(task.cells, known, controls=False)
    columns = [make.said("attack", itemgetter(0))]
    for place, (name, at) in enumerate(wheres, start=1):
        one = family_of(known, name)
        columns.append(
            Column(where_text(one.name, at), itemgetter(place), above=one.adding)
        )
    records = list[list[Any]]()
    for source in task.attacks:
        label = make.shortened(
            source.label.removesuffix(f" ({_USUAL})"), room=_LABEL_WIDTH
        )
        records.append(
            [label, *(_rank(task.cells[where].get(source)) for where in wheres)]
        )
    some = [next(iter(task.cells[where].values())) for where in wheres]
    records.append(["chance", *(make.amount(SUCCESS, row["chance"]) for row in some)])
    people = (
        (run.manifest.get("linkage") or {})
        .get("tasks", {})
        .get(task.name, {})
        .get("people")
    )
    notes = [
        _people_note(some[0], people),
        *filter(None, [approximation(run.manifest, task.name)]),
        *_control_notes(task),
        "Cells without a mark link people, by the ranks of all mates.",
    ]
    if (CLEAN, None) in wheres:
        notes.append("clean: no error at all, the ceiling.")
    title = f"{task.name}: {task.about}; rank 1 in %, 95 % intervals"
    name = f"linkage-{task.name}"
    return make.built(name, title, records, columns, notes=notes, marks=MEANING)


def _people_note(row: Mapping[str, Any], people: int | None) -> str:
    """Return how many people a task rests on, and how large its galleries are."""
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


def _control_notes(task: LinkedTask) -> list[str]:
    """Return how many controls link people, and which shortcuts give them away."""
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
            f" {100 * LEVEL:g} % ({'; '.join([expected, *worst])})."
        )
    cells = (
        ",".join(row[INVALID] for row in block.values())
        for block in task.cells.values()
    )
    leaks = Counter(name for text in cells for name in {*re.split(", *", text)} if name)
    told = [
        f"{name} at {n} of {len(task.cells)} levels"
        for name, n in sorted(leaks.items())
    ]
    if outcomes or told:
        texts.append(f"Shortcuts that give people away: {', '.join(told) or 'none'}.")
    return texts


def strength_table(run: picked.Results) -> Table:
    """Return what each task's headline linker finds at the levels that tell: ranks and scores."""
    ranks, told = (SUCCESS, SUCCESS_OF_100), "1 - Cllr_min"
    records: list[dict[str, Any]] = []
    for task, (consumer, knowledge) in run.strongest.items():
        source = Source(f"{task}/{consumer}", knowledge)
        found = picked.by_level(picked.of_source(run.ours, source)) if task else {}
        for where in (
            picked.telling(found, run.families, controls=False) if found else ()
        ):
            of = found[where][source]
            row: dict[str, Any] = dict(zip(("mechanism", "level"), where, strict=True))
            row |= {name: make.estimated(name, of.get(name)) for name in ranks}
            if lost := of.get("cllr_min"):
                ends = (1.0 - one for one in (lost.value, lost.ci_high, lost.ci_low))
                row[told] = make.amount("cllr_min", *ends)
            row["chance"] = make.amount("chance", of["chance"].value)
            records.append({"task": task, "linker": source.attack.label, **row})
    columns = [
        *map(make.said, ("task", "linker")),
        *picked.mechanism_columns(run.families),
        *(make.held(METRICS[one].head, one, unit="%") for one in (*ranks, "chance")),
        make.held(told, unit=METRICS["cllr_min"].unit),
    ]
    title = (
        "What the headline linker of each task tells, by ranks and by scores; 95 %"
        " intervals"
    )
    notes = [
        "1 - Cllr_min: what its scores tell of a pair at best, 0 nothing, 1 bit all."
    ]
    notes.append("Rank 1 of 100 is empty with fewer candidates.")
    return make.built(
        "strength", title, records, columns, notes=notes, n_headings=2, n_keys=5
    )


def doubt_table(run: picked.Results) -> Table:
    """Return the linkage cells that measure nothing: invalid ones, and too weak attacks."""
    of = run.linkability[run.linkability["cohort"] == "all"]
    of = of.assign(**of[["knowledge", "outcome", "invalid"]].astype(object).fillna(""))
    of = of[
        (of["knowledge"] != "") & ((of["invalid"] != "") | (of["outcome"] == TOO_WEAK))
    ]

    def why(row: Mapping[str, Any]) -> str:
        name = row["invalid"]
        return f"invalid: {name} tells people apart" if name else REMARKS[TOO_WEAK]

    columns = [
        make.said("task/attack", "consumer"),
        make.said("adversary", "knowledge"),
        *picked.mechanism_columns(run.families),
        make.said("why", why),
    ]
    title = "Linkage cells that measure nothing"
    return make.built("doubts", title, rows_of(of), columns, n_keys=5)


def _rank(row: Mapping[str, Any] | None) -> Cell:
    if row is None:
        return Cell()
    mark = "".join(MARKS[one] for one in remarks(row))
    return make.amount(SUCCESS, row["rank1"], row["ci_low"], row["ci_high"], mark=mark)


def control_tests(task: LinkedTask) -> dict[str, list[bool]]:
    """Return of each control whether it beats chance, at every level where that may differ."""
    tests: dict[str, list[bool]] = {}
    for row in task.controls:
        name = row["consumer"].partition("/control-")[2]
        found = tests.setdefault(name, [])
        # One that only sees times says the same at every level.
        if not (found and name in CONTROLS and CONTROLS[name].sees_times_only):
            found.append(row["p_value"] <= LEVEL)
    return tests
